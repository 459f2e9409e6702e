//! Angles between the rays of a sensor, and distances between its points.

use super::view::{View, Views};
use glam::DVec2;
use presight_model::statistics::median;

/// Points are sparse if all views together have fewer than one in a square of this side, in units of the detail: cubes of the
/// detail's size would stay alone.
const SPARSE: f64 = 4.0;

/// True if the points of all views are too far apart for pieces of surface of this size, metres.
pub(crate) fn are_sparse(views: &Views, detail: f64) -> bool {
    let apart = |view: &View| {
        let spacing = spacing(view, &directions(view));
        let mut ranges: Vec<f64> = view.ranges.iter().filter(|r| r.is_finite()).map(|r| f64::from(*r)).collect();
        median(&mut ranges).unwrap_or(0.0) * spacing.max_element()
    };
    let mut all: Vec<f64> = views.some(16).all().iter().map(apart).collect();
    median(&mut all).is_some_and(|apart| apart > SPARSE * detail * (views.all().len() as f64).sqrt())
}

/// Azimuth and elevation of each ray, radians.
pub(crate) fn directions(view: &View) -> Vec<DVec2> {
    let direction = |i: usize| {
        let ray = view.in_body(i);
        DVec2::new(ray.y.atan2(ray.x), ray.z.atan2(ray.x.hypot(ray.y)))
    };
    (0..view.ranges.len()).map(direction).collect()
}

/// Medians of the differences of azimuth and elevation between neighbours.
pub(crate) fn spacing(view: &View, directions: &[DVec2]) -> DVec2 {
    let between = |step: usize, of: fn(DVec2) -> f64| {
        let all = (step..directions.len()).map(|i| of(directions[i] - directions[i - step]).abs());
        // Not from one end of a turn to the other.
        median(&mut all.filter(|a| *a > 0.0 && *a < 1.0).collect::<Vec<f64>>()).unwrap_or(1.0)
    };
    DVec2::new(between(1, |d| d.x), between(view.width(), |d| d.y))
}
