//! Of the many points of a curve those that may be outermost, wherever errors bring them.

use super::image::Image;
use crate::features::roi::{BodyPoint, FeatureErrorModel, Projection};
use glam::DVec3;

/// Directions along each axis: -2 to 2.
const STEPS: i32 = 2;

/// Keeps of points along curves those that are farthest in some direction of the image and of the inverse range: errors of the
/// position move near points more than far ones. No more than 98 are left.
pub(super) fn keep(image: &Image<'_>, uncertain: &FeatureErrorModel, points: &mut Vec<BodyPoint>) {
    let directions = directions();
    if points.len() <= directions.len() {
        return;
    }
    let mut last: Option<f64> = None;
    let place = |point: &BodyPoint| {
        let p = uncertain.nominal(point).p;
        let [mut u, v] = image.project(p)?;
        if let (Some(turn), Some(last)) = (image.turn(), last) {
            u += turn * ((last - u) / turn).round();
        }
        last = Some(u);
        Some(DVec3::new(u, v, p.length().recip()))
    };
    let places: Vec<Option<DVec3>> = points.iter().map(place).collect();
    let some = places.iter().flatten();
    let (low, high) = some.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
    let size = (high - low).max(DVec3::splat(f64::MIN_POSITIVE));
    let mut keep = vec![false; points.len()];
    for direction in &directions {
        let far = |place: &DVec3| ((place - low) / size).dot(*direction);
        let all = places.iter().enumerate().filter_map(|(i, place)| Some((i, far(place.as_ref()?))));
        if let Some((farthest, _)) = all.reduce(|a, b| if b.1 > a.1 { b } else { a }) {
            keep[farthest] = true;
        }
    }
    let mut kept = keep.into_iter();
    points.retain(|_| kept.next().unwrap_or(false));
}

/// To the places of a grid on the faces of a cube.
fn directions() -> Vec<DVec3> {
    let line = || -STEPS..=STEPS;
    let grid = line().flat_map(move |x| line().flat_map(move |y| line().map(move |z| [x, y, z])));
    grid.filter(|at| at.iter().any(|x| x.abs() == STEPS)).map(|at| DVec3::from_array(at.map(f64::from))).collect()
}
