//! Sides of patches, to draw their visible parts.

use super::{FeaturePrediction, PlacedFeature};
use glam::DMat3;
use presight_model::environment::{Feature, FeatureShape};

/// Returns the sides of all partly visible patches and fiducials as segments with the id and the polygons of their
/// patch. They show which part of its outline is visible, which the visible share of its area leaves open.
///
/// `placed` are the predicted features in order.
///
/// ```
/// use presight::features::{Existence, Feature, FeatureShape, Properties};
/// use presight::features::{FeaturePrediction, PlacedFeature, SeenFeature, sides_seen_in_part};
/// use glam::{DMat3, DVec3};
///
/// let shape = FeatureShape::Patch { corners: vec![DVec3::ZERO, DVec3::X, DVec3::Y], covariance: DMat3::ZERO };
/// let (existence, properties) = (Existence::default(), Properties::default());
/// let feature = Feature { id: 7, name: None, object: None, shape, existence, properties };
/// let half = SeenFeature { visible_fraction: 0.5, ..SeenFeature::whole(&feature) };
/// let prediction = FeaturePrediction { features: vec![half], ..Default::default() };
/// let placed = PlacedFeature { feature: feature.into(), object: None, slots: vec![3] };
/// let sides = sides_seen_in_part(&[placed], &prediction);
/// assert_eq!(sides.len(), 3);
/// assert_eq!((sides[2].feature.id, sides[2].slots.as_slice()), (7, [3].as_slice()));
/// assert_eq!(sides[2].feature.shape.points(), [DVec3::Y, DVec3::ZERO]);
/// ```
pub fn sides_seen_in_part(placed: &[PlacedFeature], prediction: &FeaturePrediction) -> Vec<PlacedFeature> {
    let in_part = |share: f64| share > 0.0 && share < 1.0;
    let of_one = |placed: &PlacedFeature| {
        let corners = placed.feature.shape.points().to_vec();
        let side = |k: usize| FeatureShape::Segment {
            ends: [corners[k], corners[(k + 1) % corners.len()]],
            covariances: [DMat3::ZERO; 2],
            cross: DMat3::ZERO,
        };
        let of = |shape| {
            let feature = Feature { shape, ..Feature::clone(&placed.feature) };
            PlacedFeature { feature: feature.into(), ..placed.clone() }
        };
        (0..corners.len()).map(|k| of(side(k))).collect::<Vec<_>>()
    };
    let given = |(i, seen)| (&placed[prediction.given_at(i)], seen);
    let areas = prediction.features.iter().enumerate().map(given).filter(|(placed, seen)| {
        matches!(placed.feature.shape, FeatureShape::Patch { .. } | FeatureShape::Fiducial { .. })
            && in_part(seen.visible_fraction)
    });
    areas.flat_map(|(placed, _)| of_one(placed)).collect()
}
