//! Reduces the many points of a curve to the points that may be outermost under errors.

use super::image::Image;
use crate::roi::{BodyPoint, FeatureErrorModel, Projection};
use glam::DVec3;

/// Directions per axis run from -STEPS to STEPS.
const STEPS: i32 = 2;

/// Number of directions, opposites included.
const DIRECTIONS: usize = 98;

/// Keeps the points along curves that are farthest in some direction of the space of image and inverse range. Position
/// errors move near points more than far ones. At most 98 points are left.
pub(super) fn keep(image: &Image<'_>, uncertain: &FeatureErrorModel, points: &mut Vec<BodyPoint>) {
    if points.len() <= DIRECTIONS {
        return;
    }
    let mut last: Option<f64> = None;
    let place = |(i, point): (usize, &BodyPoint)| {
        let p = uncertain.nominal(point).p;
        let [mut u, v] = image.project(p)?;
        if let (Some(turn), Some(last)) = (image.turn(), last) {
            u += turn * ((last - u) / turn).round();
        }
        last = Some(u);
        Some((i, DVec3::new(u, v, p.length().recip())))
    };
    let mut places: Vec<(usize, DVec3)> = points.iter().enumerate().filter_map(place).collect();
    let (low, high) =
        places.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), (_, p)| (l.min(*p), h.max(*p)));
    let size = (high - low).max(DVec3::splat(f64::MIN_POSITIVE));
    places.iter_mut().for_each(|(_, p)| *p = (*p - low) / size);
    let mut keep = vec![false; points.len()];
    for direction in half_of_directions() {
        // The farthest points in this direction and its opposite.
        let (mut most, mut least) = ((f64::NEG_INFINITY, None), (f64::INFINITY, None));
        for (i, place) in &places {
            let far = place.dot(direction);
            most = if far > most.0 { (far, Some(*i)) } else { most };
            least = if far < least.0 { (far, Some(*i)) } else { least };
        }
        [most.1, least.1].into_iter().flatten().for_each(|i| keep[i] = true);
    }
    let mut kept = keep.into_iter();
    points.retain(|_| kept.next().unwrap_or(false));
}

/// Directions to grid points on the faces of a cube, one of each opposite pair.
fn half_of_directions() -> impl Iterator<Item = DVec3> {
    let line = || -STEPS..=STEPS;
    let grid = line().flat_map(move |x| line().flat_map(move |y| line().map(move |z| [x, y, z])));
    let half = grid.filter(|at| at.iter().any(|x| x.abs() == STEPS) && *at > [0; 3]);
    half.map(|at| DVec3::from_array(at.map(f64::from)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_and_their_opposites_are_all() {
        let half: Vec<DVec3> = half_of_directions().collect();
        assert_eq!(2 * half.len(), DIRECTIONS);
        assert!(half.iter().all(|d| !half.contains(&-*d)));
    }
}
