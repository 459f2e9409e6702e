//! Walls from planar scans: segments, trimmed by hits and passes, fitted to the rays that end on them, chosen by what
//! they explain, and joined at their ends.

use super::scan::{Ray, Scan, Wall};
use super::segment;
use crate::observe::{View, Views};
use presight_model::error::{Error, Result};
use rayon::prelude::*;
use std::collections::BinaryHeap;

/// Side of a cell along a wall, metres.
const CELL: f64 = 0.05;
/// A ray this near ended on a wall when it is trimmed, metres.
const HIT: f64 = 0.06;
/// A ray this far behind went through, metres.
const PASS: f64 = 0.12;
/// The same two distances when walls are chosen, metres.
const CHOICE: [f64; 2] = [0.04, 0.1];
/// Rays that a wall must explain more than it blocks.
const LEAST_GAIN: i64 = 4;
/// Distance of a ray at which it counts half in a fit, metres.
const SPREAD: f64 = 0.02;
/// Ends this near meet, metres.
const MEET: f64 = 0.12;
/// Least sine between walls that meet.
const LEAST_ANGLE: f64 = 0.3;
/// Walls at a time, which bounds the memory.
const AT_ONCE: usize = 64;

/// The walls that views of level scanners show, at most `most`, those first that explain most. `is_used` says which
/// beams count, by the number of the view and of the beam.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if no wall is in sight.
pub(crate) fn walls(views: &Views, most: usize, is_used: impl Fn(usize, usize) -> bool) -> Result<Vec<Wall>> {
    let base = views.base().truncate();
    let scan = |(k, view): (usize, &View)| Scan::of(view, base, |pixel| is_used(k, pixel));
    let scans: Vec<Scan> = views.all().iter().enumerate().map(scan).collect();
    let found = trimmed(segment::walls(&scans), &rays(&scans));
    let all: Vec<Scan> = views.all().iter().map(|view| Scan::of(view, base, |_| true)).collect();
    let rays = rays(&all);
    let walls = trimmed(fitted(found, &rays), &rays);
    let walls = fitted(chosen(walls, &rays, most), &rays);
    if walls.is_empty() {
        return Err(Error::invalid("no wall is in sight", "give scans of walls of at least 25 cm, with poses"));
    }
    Ok(joined(walls))
}

fn rays(scans: &[Scan]) -> Vec<Ray> {
    let of = |scan: &Scan| {
        let ray = |k: usize| Ray { origin: scan.origin, way: scan.ways[k], range: scan.ranges[k] };
        (0..scan.ranges.len()).filter(|k| scan.ranges[*k].is_finite()).map(ray).collect::<Vec<_>>()
    };
    scans.iter().flat_map(of).collect()
}

/// The stretches of walls on which more rays ended than went through.
fn trimmed(walls: Vec<Wall>, rays: &[Ray]) -> Vec<Wall> {
    let trim = |wall: &Wall| {
        let count = (wall.way().length() / CELL).ceil().max(1.0) as usize;
        let (mut hits, mut passes) = (vec![0u32; count], vec![0u32; count]);
        for ray in rays {
            let Some((distance, share)) = wall.met(ray) else { continue };
            let cell = ((share * count as f64) as usize).min(count - 1);
            hits[cell] += u32::from((ray.range - distance).abs() < HIT);
            passes[cell] += u32::from(ray.range - distance > PASS);
        }
        let sum = |of: &[u32], k: usize| of[k.saturating_sub(1)..(k + 2).min(count)].iter().sum::<u32>();
        let is_wall: Vec<bool> = (0..count).map(|k| sum(&hits, k) > sum(&passes, k)).collect();
        let at = |k: usize| wall.ends[0] + wall.way() * (k as f64 / count as f64);
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

/// For each ray the wall that it meets first, with the distance.
fn first(walls: &[Wall], ray: &Ray) -> Option<(usize, f64)> {
    let met = walls.iter().enumerate().filter_map(|(k, wall)| Some((k, wall.met(ray)?.0)));
    met.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Moves and turns each wall so that the rays which end on it end on it.
fn fitted(mut walls: Vec<Wall>, rays: &[Ray]) -> Vec<Wall> {
    for _ in 0..4 {
        let met: Vec<Option<(usize, f64)>> = rays.par_iter().map(|ray| first(&walls, ray)).collect();
        // The normal equations of each wall's offset and slope.
        let mut sums = vec![[0.0; 5]; walls.len()];
        for (ray, (k, distance)) in rays.iter().zip(met).filter_map(|(ray, met)| Some((ray, met?))) {
            if (distance - ray.range).abs() > 0.15 {
                continue;
            }
            let (way, middle) = (walls[k].way().normalize(), 0.5 * (walls[k].ends[0] + walls[k].ends[1]));
            let p = ray.origin + ray.way * ray.range - middle;
            let (off, along) = (p.dot(way.perp()), p.dot(way));
            let weight = ray.way.dot(way.perp()).abs() / (1.0 + (off / SPREAD).powi(2));
            let terms = [1.0, along, along * along, off, off * along];
            sums[k].iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
        }
        for (wall, [one, along, squares, off, off_along]) in walls.iter_mut().zip(sums) {
            let length = wall.way().length();
            let (a, c) = (one + 1e-3, squares + 0.02 * length * length);
            let det = a * c - along * along;
            let move_by = ((c * off - along * off_along) / det).clamp(-0.05, 0.05);
            let turn_by = ((a * off_along - along * off) / det).clamp(-0.1, 0.1) * 0.5 * length;
            let normal = wall.way().normalize().perp();
            wall.ends[0] += normal * (move_by - turn_by);
            wall.ends[1] += normal * (move_by + turn_by);
        }
    }
    walls
}

/// The best walls: each explains most rays that no better one does, less the rays that it alone blocks.
fn chosen(walls: Vec<Wall>, rays: &[Ray], most: usize) -> Vec<Wall> {
    let of = |wall: &Wall| {
        let (mut hits, mut blocked) = (Vec::new(), Vec::new());
        for (ray, k) in rays.iter().zip(0u32..) {
            let Some((distance, _)) = wall.met(ray) else { continue };
            if (ray.range - distance).abs() < CHOICE[0] {
                hits.push(k);
            } else if ray.range - distance > CHOICE[1] {
                blocked.push(k);
            }
        }
        (hits, blocked)
    };
    let rays_of: Vec<(Vec<u32>, Vec<u32>)> = walls.par_iter().with_max_len(AT_ONCE).map(of).collect();
    let (mut explained, mut blocked) = (vec![false; rays.len()], vec![false; rays.len()]);
    let gain = |k: usize, explained: &[bool], blocked: &[bool]| {
        let new = |of: &[u32], known: &[bool]| of.iter().filter(|r| !known[**r as usize]).count() as i64;
        new(&rays_of[k].0, explained) - new(&rays_of[k].1, blocked)
    };
    // Gains fall while others are chosen, or rise where others block the same rays: old ones are worked out again.
    let mut heap: BinaryHeap<(i64, usize)> = (0..walls.len()).map(|k| (gain(k, &explained, &blocked), k)).collect();
    let mut chosen = Vec::new();
    while let Some((old, k)) = heap.pop() {
        let now = gain(k, &explained, &blocked);
        if now < old && heap.peek().is_some_and(|(next, _)| *next > now) {
            heap.push((now, k));
            continue;
        }
        if now < LEAST_GAIN || chosen.len() == most {
            break;
        }
        rays_of[k].0.iter().for_each(|r| explained[*r as usize] = true);
        rays_of[k].1.iter().for_each(|r| blocked[*r as usize] = true);
        chosen.push(walls[k]);
    }
    chosen
}

/// Moves ends that nearly meet to the common point of their lines.
fn joined(mut walls: Vec<Wall>) -> Vec<Wall> {
    for i in 0..2 * walls.len() {
        let (a, end) = (i / 2, i % 2);
        let p = walls[a].ends[end];
        let others = (0..2 * walls.len()).filter(|j| j / 2 != a);
        let distance = |j: &usize| walls[j / 2].ends[j % 2].distance(p);
        let Some(j) = others.min_by(|x, y| distance(x).total_cmp(&distance(y))) else { break };
        let (b, q) = (j / 2, walls[j / 2].ends[j % 2]);
        let (u, v) = (walls[a].way().normalize(), walls[b].way().normalize());
        let sine = u.perp_dot(v);
        if i < j && p.distance(q) < MEET && sine.abs() > LEAST_ANGLE {
            let corner = p + u * ((q - p).perp_dot(v) / sine);
            if corner.distance(p) < MEET && corner.distance(q) < MEET {
                (walls[a].ends[end], walls[b].ends[j % 2]) = (corner, corner);
            }
        }
    }
    walls
}
