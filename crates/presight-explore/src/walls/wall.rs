//! Walls from scans: segments are trimmed by hits and passes, fitted to the rays that end on them, selected by the rays
//! that they explain, and joined at their ends.

use super::scan::{NEAR, Ray, Scan, Wall};
use super::segment;
use crate::observe::{View, Views};
use presight_model::error::{Error, Result};
use rayon::prelude::*;
use std::collections::BinaryHeap;

/// Length of a cell along a wall, metres.
const CELL: f64 = 0.05;
/// The distances of hits and passes for the selection, metres.
const CHOICE: [f64; 2] = [0.04, 0.1];
/// Minimum difference between the explained and the blocked rays of a wall.
const MIN_GAIN: i64 = 4;
/// Distance at which the weight of a ray in a fit is halved, metres.
const SPREAD: f64 = 0.02;
/// Maximum distance between ends that are joined, metres: both walls are uncertain by [`NEAR`].
const MEET: f64 = 2.0 * NEAR;
/// Minimum sine between walls that are joined: 17 degrees.
const MIN_SINE: f64 = 0.3;
/// Maximum number of walls in one task, which bounds the memory.
const BATCH: usize = 64;

/// The walls in the views of level scanners: at most `max`, those first that explain the most rays. `is_used` selects
/// beams by the indices of view and beam.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if no wall is in sight.
pub(crate) fn walls(views: &Views, max: usize, is_used: impl Fn(usize, usize) -> bool) -> Result<Vec<Wall>> {
    let base = views.base().truncate();
    let scan = |(k, view): (usize, &View)| Scan::of(view, base, |pixel| is_used(k, pixel));
    let scans: Vec<Scan> = views.all().iter().enumerate().map(scan).collect();
    let found = trimmed(segment::walls(&scans), &rays(&scans));
    let all: Vec<Scan> = views.all().iter().map(|view| Scan::of(view, base, |_| true)).collect();
    let rays = rays(&all);
    let walls = trimmed(fitted(found, &rays), &rays);
    let walls = fitted(selected(walls, &rays, max), &rays);
    if walls.is_empty() {
        return Err(Error::invalid("no wall is in sight", "give scans of walls of at least 25 cm, with poses"));
    }
    Ok(joined(walls))
}

fn rays(scans: &[Scan]) -> Vec<Ray> {
    let of = |scan: &Scan| {
        let ray = |k: usize| Ray { origin: scan.origin, direction: scan.directions[k], range: scan.ranges[k] };
        (0..scan.ranges.len()).filter(|k| scan.ranges[*k].is_finite()).map(ray).collect::<Vec<_>>()
    };
    scans.iter().flat_map(of).collect()
}

/// The stretches of walls with more hits than passes.
fn trimmed(walls: Vec<Wall>, rays: &[Ray]) -> Vec<Wall> {
    let trim = |wall: &Wall| {
        let count = (wall.along().length() / CELL).ceil().max(1.0) as usize;
        let (mut hits, mut passes) = (vec![0u32; count], vec![0u32; count]);
        for ray in rays {
            let Some((distance, share)) = wall.intersection(ray) else { continue };
            let cell = ((share * count as f64) as usize).min(count - 1);
            hits[cell] += u32::from((ray.range - distance).abs() < NEAR);
            passes[cell] += u32::from(ray.range - distance > 2.0 * NEAR);
        }
        let sum = |of: &[u32], k: usize| of[k.saturating_sub(1)..(k + 2).min(count)].iter().sum::<u32>();
        let is_wall: Vec<bool> = (0..count).map(|k| sum(&hits, k) > sum(&passes, k)).collect();
        let at = |k: usize| wall.ends[0] + wall.along() * (k as f64 / count as f64);
        let runs = is_wall.chunk_by(|a, b| a == b).scan(0, |start, run| {
            let own = (*start, *start + run.len(), run[0]);
            *start += run.len();
            Some(own)
        });
        let long = runs.filter(|(a, b, is_wall)| *is_wall && b - a >= 2);
        long.map(|(a, b, _)| Wall { ends: [at(a), at(b)] }).collect::<Vec<_>>()
    };
    walls.par_iter().flat_map_iter(trim).collect()
}

/// The index of the first wall on a ray, and its distance, metres.
fn first(walls: &[Wall], ray: &Ray) -> Option<(usize, f64)> {
    let met = walls.iter().enumerate().filter_map(|(k, wall)| Some((k, wall.intersection(ray)?.0)));
    met.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Moves and turns the walls to the ends of their rays, by iterated least squares.
fn fitted(mut walls: Vec<Wall>, rays: &[Ray]) -> Vec<Wall> {
    for _ in 0..4 {
        let met: Vec<Option<(usize, f64)>> = rays.par_iter().map(|ray| first(&walls, ray)).collect();
        // By wall: the normal equations of its offset and slope.
        let mut sums = vec![[0.0; 5]; walls.len()];
        for (ray, (k, distance)) in rays.iter().zip(met).filter_map(|(ray, met)| Some((ray, met?))) {
            if (distance - ray.range).abs() > 0.15 {
                continue;
            }
            let (along, middle) = (walls[k].along().normalize(), 0.5 * (walls[k].ends[0] + walls[k].ends[1]));
            let p = ray.origin + ray.direction * ray.range - middle;
            let (off, at) = (p.dot(along.perp()), p.dot(along));
            let weight = ray.direction.dot(along.perp()).abs() / (1.0 + (off / SPREAD).powi(2));
            let terms = [1.0, at, at * at, off, off * at];
            sums[k].iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
        }
        for (wall, [one, along, squares, off, off_along]) in walls.iter_mut().zip(sums) {
            let length = wall.along().length();
            let (a, c) = (one + 1e-3, squares + 0.02 * length * length);
            let det = a * c - along * along;
            let move_by = ((c * off - along * off_along) / det).clamp(-0.05, 0.05);
            let turn_by = ((a * off_along - along * off) / det).clamp(-0.1, 0.1) * 0.5 * length;
            let normal = wall.along().normalize().perp();
            wall.ends[0] += normal * (move_by - turn_by);
            wall.ends[1] += normal * (move_by + turn_by);
        }
    }
    walls
}

/// Greedy selection of at most `max` walls. The gain of a wall is the number of rays that it explains and no selected
/// wall does, minus the number of rays that it blocks and no selected wall does.
fn selected(walls: Vec<Wall>, rays: &[Ray], max: usize) -> Vec<Wall> {
    let of = |wall: &Wall| {
        let (mut hits, mut blocked) = (Vec::new(), Vec::new());
        for (ray, k) in rays.iter().zip(0u32..) {
            let Some((distance, _)) = wall.intersection(ray) else { continue };
            if (ray.range - distance).abs() < CHOICE[0] {
                hits.push(k);
            } else if ray.range - distance > CHOICE[1] {
                blocked.push(k);
            }
        }
        (hits, blocked)
    };
    let rays_of: Vec<(Vec<u32>, Vec<u32>)> = walls.par_iter().with_max_len(BATCH).map(of).collect();
    let (mut explained, mut blocked) = (vec![false; rays.len()], vec![false; rays.len()]);
    let gain = |k: usize, explained: &[bool], blocked: &[bool]| {
        let new = |of: &[u32], known: &[bool]| of.iter().filter(|r| !known[**r as usize]).count() as i64;
        new(&rays_of[k].0, explained) - new(&rays_of[k].1, blocked)
    };
    // Selected walls lower the gains of others, or raise them by blocking the same rays, so an old gain is computed
    // again.
    let mut heap: BinaryHeap<(i64, usize)> = (0..walls.len()).map(|k| (gain(k, &explained, &blocked), k)).collect();
    let mut selected = Vec::new();
    while let Some((old, k)) = heap.pop() {
        let now = gain(k, &explained, &blocked);
        if now < old && heap.peek().is_some_and(|(next, _)| *next > now) {
            heap.push((now, k));
            continue;
        }
        if now < MIN_GAIN || selected.len() == max {
            break;
        }
        rays_of[k].0.iter().for_each(|r| explained[*r as usize] = true);
        rays_of[k].1.iter().for_each(|r| blocked[*r as usize] = true);
        selected.push(walls[k]);
    }
    selected
}

/// Moves nearby ends of walls to the intersection of their lines.
fn joined(mut walls: Vec<Wall>) -> Vec<Wall> {
    for i in 0..2 * walls.len() {
        let (a, end) = (i / 2, i % 2);
        let p = walls[a].ends[end];
        let others = (0..2 * walls.len()).filter(|j| j / 2 != a);
        let distance = |j: &usize| walls[j / 2].ends[j % 2].distance(p);
        let Some(j) = others.min_by(|x, y| distance(x).total_cmp(&distance(y))) else { break };
        let (b, q) = (j / 2, walls[j / 2].ends[j % 2]);
        let (u, v) = (walls[a].along().normalize(), walls[b].along().normalize());
        let sine = u.perp_dot(v);
        if i < j && p.distance(q) < MEET && sine.abs() > MIN_SINE {
            let corner = p + u * ((q - p).perp_dot(v) / sine);
            if corner.distance(p) < MEET && corner.distance(q) < MEET {
                (walls[a].ends[end], walls[b].ends[j % 2]) = (corner, corner);
            }
        }
    }
    walls
}
