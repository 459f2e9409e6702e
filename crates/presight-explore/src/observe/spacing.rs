//! Angles between the rays of a sensor, and distances between its points.

use super::view::{View, Views};
use glam::DVec2;
use presight_model::statistics::median;

/// Points are sparse if a square of this side, in units of the detail, holds less than one point of all views together:
/// cubes of the size of the detail would have no neighbours.
const SPARSE: f64 = 4.0;

/// True if the points of all views are too far apart for surfels of this size, metres.
pub(crate) fn are_sparse(views: &Views, detail: f64) -> bool {
    let distance = |view: &View| {
        let spacing = spacing(view, &directions(view));
        let mut ranges: Vec<f64> = view.ranges.iter().filter(|r| r.is_finite()).map(|r| f64::from(*r)).collect();
        median(&mut ranges).unwrap_or(0.0) * spacing.max_element()
    };
    let mut all: Vec<f64> = views.sample().all().iter().map(distance).collect();
    median(&mut all).is_some_and(|distance| distance > SPARSE * detail * (views.all().len() as f64).sqrt())
}

/// Azimuth and elevation of each ray, radians.
pub(crate) fn directions(view: &View) -> Vec<DVec2> {
    let direction = |i: usize| {
        let ray = view.in_body(i);
        DVec2::new(ray.y.atan2(ray.x), ray.z.atan2(ray.x.hypot(ray.y)))
    };
    (0..view.ranges.len()).map(direction).collect()
}

/// Median differences of azimuth and elevation between neighbouring rays, radians.
pub(crate) fn spacing(view: &View, directions: &[DVec2]) -> DVec2 {
    let between = |step: usize, of: fn(DVec2) -> f64| {
        let all = (step..directions.len()).map(|i| of(directions[i] - directions[i - step]).abs());
        // Leaves out the jump between the two ends of a full turn.
        median(&mut all.filter(|a| *a > 0.0 && *a < 1.0).collect::<Vec<f64>>()).unwrap_or(1.0)
    };
    DVec2::new(between(1, |d| d.x), between(view.width(), |d| d.y))
}
