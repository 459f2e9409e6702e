//! Noise of a scanned mesh: distances of its corners from its surfaces.
//!
//! A designed mesh has no noise: most of its area is in facets that are exactly coplanar with a neighbour, or its
//! corners lie on smooth surfaces, which a quadratic surface approximates far better than a plane. Noise has no shape,
//! and neither surface approximates it. The comparison needs no scale.

use super::facets::Facets;
use super::fit::{Fit, Frame, PLANE, QUADRATIC, above, deviation};
use crate::geometry::PLANARITY;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashSet;

/// A quadratic surface approximates curvature, and not noise, if it leaves less than this share of a plane's errors.
const CURVED: f64 = 0.5;
/// Maximum number of corners, and of neighbourhoods, to examine.
const MAX_SAMPLES: usize = 1024;
/// Minimum number of corners inside the surface for an estimate of the noise.
const MIN_CORNERS: usize = 64;

/// The neighbourhood of a facet: a plane approximates it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seed {
    pub polygon: u32,
    pub frame: Frame,
    pub plane: [f64; PLANE],
    /// Standard deviation of its corners from the plane, metres.
    pub noise: f64,
    /// True if a quadratic surface is far nearer to its corners: no plane begins there.
    pub curved: bool,
}

/// Returns true if most of the area is in designed facets: more than three corners, or coplanar with a neighbour.
pub(super) fn is_exact(facets: &Facets<'_>) -> bool {
    let edges = facets.edges;
    let far = edges.positions.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let coplanar = |polygon: u32, other: u32| {
        let Some(normal) = edges.normals[polygon as usize] else { return false };
        let at = edges.centers[polygon as usize];
        facets.corners_of(other).all(|c| normal.dot(facets.position(c) - at).abs() <= PLANARITY * far)
    };
    let is_designed = |polygon: u32| {
        edges.edges_of(polygon).len() > 3 || facets.beside(polygon).any(|other| coplanar(polygon, other))
    };
    let all: f64 = facets.areas.iter().sum();
    let designed = (0..facets.areas.len() as u32).filter(|p| is_designed(*p));
    designed.map(|p| facets.areas[p as usize]).sum::<f64>() >= 0.5 * all
}

/// Returns true if the corners inside the surface have errors that no smooth surface explains.
pub(super) fn is_noisy(facets: &Facets<'_>) -> bool {
    let count = facets.edges.positions.len() as u32;
    let inside: Vec<u32> = (0..count).filter(|c| is_inside(facets, *c)).collect();
    let area = |corners: &mut dyn Iterator<Item = u32>| corners.map(|c| facets.corner_areas[c as usize]).sum::<f64>();
    if inside.len() < MIN_CORNERS || area(&mut inside.iter().copied()) < 0.5 * area(&mut (0..count)) {
        return false;
    }
    let step = inside.len().div_ceil(MAX_SAMPLES);
    let errors: Vec<[f64; 2]> = inside.par_iter().step_by(step).filter_map(|c| errors_at(facets, *c)).collect();
    let [plane, quadratic] = [0, 1].map(|k| deviation(errors.iter().map(|e| (e[k], 1.0)).collect()));
    errors.len() >= MIN_CORNERS.min(inside.len() / step) && quadratic >= CURVED * plane && plane > 0.0
}

/// Returns true if two facets meet at each edge of a corner.
fn is_inside(facets: &Facets<'_>, corner: u32) -> bool {
    let edges = facets.edges_at(corner);
    !edges.is_empty() && edges.iter().all(|edge| facets.edges.around(*edge).len() == 2)
}

/// Distances of a corner from a plane and from a quadratic surface through the corners around it, as standard errors
/// of a corner.
fn errors_at(facets: &Facets<'_>, corner: u32) -> Option<[f64; 2]> {
    let mut around: Vec<u32> = facets.corners_beside(corner).collect();
    let second: Vec<u32> = around.iter().flat_map(|c| facets.corners_beside(*c)).collect();
    around.extend(second);
    around.sort_unstable();
    around.dedup();
    around.retain(|c| *c != corner);
    let ring = facets.edges_at(corner).iter().flat_map(|edge| facets.edges.around(*edge)).copied();
    let (at, normal) = (facets.position(corner), facets.normal(ring)?);
    let unit = around.iter().map(|c| facets.position(*c).distance(at)).fold(0.0, f64::max);
    let frame = Frame::new(at, normal, unit);
    let places = || around.iter().map(|c| (frame.place(facets.position(*c)), 1.0));
    // With as many points as terms there is no error.
    let (plane, quadratic) = (Fit::<PLANE>::of(places()).middle()?, Fit::<QUADRATIC>::of(places()).middle()?);
    (around.len() > QUADRATIC)
        .then(|| [plane, quadratic].map(|(height, variance)| height.abs() / (1.0 + variance).sqrt()))
}

/// Neighbourhoods of a radius all over the surface, those nearest to a plane first.
pub(super) fn seeds(facets: &Facets<'_>, radius: f64) -> Vec<Seed> {
    let mut taken = HashSet::new();
    let cell = |p: DVec3| (p / (0.5 * radius)).floor().to_array().map(|x| x as i64);
    let is_first = |polygon: &u32| {
        facets.areas[*polygon as usize] > 0.0 && taken.insert(cell(facets.edges.centers[*polygon as usize]))
    };
    let first: Vec<u32> = (0..facets.areas.len() as u32).filter(is_first).collect();
    let mut seeds: Vec<Seed> = first.into_par_iter().filter_map(|polygon| seed(facets, polygon, radius)).collect();
    seeds.sort_by(|a, b| a.noise.total_cmp(&b.noise).then(a.polygon.cmp(&b.polygon)));
    seeds
}

/// Standard deviation of corners from the planes among some neighbourhoods, metres: the median. 0 if all are curved.
pub(super) fn typical(seeds: &[Seed]) -> f64 {
    let step = seeds.len().div_ceil(MAX_SAMPLES).max(1);
    deviation(
        seeds.iter().filter(|s| !s.curved).step_by(step).map(|s| (s.noise * 0.674_489_750_196_082, 1.0)).collect(),
    )
}

fn seed(facets: &Facets<'_>, polygon: u32, radius: f64) -> Option<Seed> {
    let center = facets.edges.centers[polygon as usize];
    let near = connected(facets, polygon, |p| facets.edges.centers[p as usize].distance(center) <= radius);
    let inner = near.iter().copied().filter(|p| facets.edges.centers[*p as usize].distance(center) <= 0.5 * radius);
    let frame = Frame::new(center, facets.normal(inner)?, radius);
    let mut corners: Vec<u32> = near.iter().flat_map(|p| facets.corners_of(*p)).collect();
    corners.sort_unstable();
    corners.dedup();
    let places: Vec<([f64; 3], f64)> =
        corners.iter().map(|c| (frame.place(facets.position(*c)), facets.corner_areas[*c as usize])).collect();
    let (plane, noise) = fitted::<PLANE>(&places)?;
    let curved = fitted::<QUADRATIC>(&places).is_none_or(|(_, rest)| rest < CURVED * noise);
    Some(Seed { polygon, frame, plane, noise, curved })
}

/// A surface fitted to points without outliers, and the standard deviation of the points from it.
fn fitted<const N: usize>(places: &[([f64; 3], f64)]) -> Option<([f64; N], f64)> {
    let mut c = Fit::<N>::of(places.iter().copied()).solve()?;
    let spread = |c: &[f64; N]| deviation(places.iter().map(|(p, weight)| (above(*p, c).abs(), *weight)).collect());
    // Normal errors beyond three standard deviations are one in 370.
    for _ in 0..3 {
        let most = 3.0 * spread(&c);
        c = Fit::<N>::of(places.iter().copied().filter(|(p, _)| above(*p, &c).abs() <= most)).solve()?;
    }
    Some((c, spread(&c)))
}

/// The polygons connected with one of them over edges, as far as `holds`.
pub(super) fn connected(facets: &Facets<'_>, from: u32, holds: impl Fn(u32) -> bool) -> Vec<u32> {
    let mut reached = HashSet::from([from]);
    let mut all = vec![from];
    let mut next = 0;
    while let Some(polygon) = all.get(next).copied() {
        next += 1;
        all.extend(facets.beside(polygon).filter(|other| holds(*other) && reached.insert(*other)));
    }
    all
}
