//! Finds the polygons along a segment.

use super::local::Local;
use super::{LYING, Support};
use glam::DVec3;

/// Finds the support of a segment from the origin to `end`.
pub(super) fn lie(near: &[Local], end: DVec3) -> Support {
    let length = end.length();
    let (mut on, mut covered) = (Vec::new(), Vec::new());
    let (mut along, mut covered_along) = (Vec::new(), Vec::new());
    for local in near {
        let Some((from, to)) = local.stretch(DVec3::ZERO, end) else { continue };
        let rise = local.normal.map_or(0.0, |n| n.dot(end).abs());
        if rise > (LYING * length).max(2.0 * local.reach) {
            continue;
        }
        covered.push((from, to));
        let crosses = local.is_left_within(DVec3::ZERO, end, (from, to));
        if !crosses {
            covered_along.push((from, to));
        }
        // A polygon that begins where the segment ends shares only the tolerance with it.
        if (to - from) * length > (2.0 * local.reach).min(0.5 * length) {
            on.push(local.slot);
            if !crosses {
                along.push(local.slot);
            }
        }
    }
    // A polygon that the segment crosses hides it, unless no other polygon supports the segment there.
    if widest_gap(&mut covered_along).is_none() {
        return Support::On(along);
    }
    match widest_gap(&mut covered) {
        None => Support::On(on),
        Some((from, to)) => Support::Off(end * farthest(near, end, from, to)),
    }
}

/// The widest part of 0..=1 that no interval covers.
pub(super) fn widest_gap(covered: &mut [(f64, f64)]) -> Option<(f64, f64)> {
    covered.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut gap = (0.0, 0.0);
    let mut reached = 0.0;
    for &(from, to) in covered.iter().chain([&(1.0, 1.0)]) {
        if from - reached > gap.1 - gap.0 {
            gap = (reached, from);
        }
        reached = reached.max(to);
    }
    // An empty list leaves everything; rounding of t leaves less than this between neighbours.
    (gap.1 - gap.0 > 16.0 * f64::EPSILON).then_some(gap)
}

/// The place in the gap farthest from the polygons, by a few samples. Only for the message: no result depends on it.
fn farthest(near: &[Local], end: DVec3, from: f64, to: f64) -> f64 {
    const SAMPLES: usize = 9;
    let at = |k: usize| from + (to - from) * k as f64 / (SAMPLES - 1) as f64;
    let distance = |t: f64| near.iter().map(|l| l.distance(end * t)).fold(f64::INFINITY, f64::min);
    let middle = 0.5 * (from + to);
    let better = |best: f64, k: usize| if distance(at(k)) > distance(best) { at(k) } else { best };
    (0..SAMPLES).fold(middle, better)
}
