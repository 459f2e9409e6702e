//! Edges and corners near the point that a pixel sees.

use glam::{DVec2, DVec3};
use presight_features::{FeatureSettings, SeenFeature, place, predict_features};
use presight_model::environment::{Feature, FeatureLayer, FeatureShape};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::plan::Images;
use std::sync::Arc;

/// An edge or a corner.
pub struct NearbyFeature {
    pub feature: Arc<Feature>,
    /// Distance from the point that the pixel sees, metres.
    pub metres: f64,
    /// Distance in the image from the pixel to the visible part, pixels; `None` if not visible or not known.
    pub pixels: Option<f64>,
}

/// A prediction at a pose.
pub struct PickView<'a> {
    pub world: &'a World,
    pub sensor: &'a Sensor,
    pub pose: &'a Pose,
    pub images: &'a Images,
}

impl PickView<'_> {
    /// Edges and corners of a layer within `reach` metres of the point that a pixel sees: first the visible ones,
    /// sorted by distance in the image, then the others, sorted by distance in space.
    pub fn near(&self, layer: FeatureLayer, p_in_world: DVec3, pixel: DVec2, reach: f64) -> Result<Vec<NearbyFeature>> {
        let metres = |f: &Feature| distance(self.world, f, p_in_world).filter(|d| *d <= reach);
        let (found, features): (Vec<f64>, Vec<Arc<Feature>>) =
            layer.features.into_iter().filter_map(|f| Some((metres(&f)?, f))).unzip();
        let layer = FeatureLayer { features, ..layer };
        let pixels = self.pixels(&layer, pixel)?;
        let all = layer.features.into_iter().zip(found).zip(pixels);
        let mut near: Vec<NearbyFeature> =
            all.map(|((feature, metres), pixels)| NearbyFeature { feature, metres, pixels }).collect();
        // Rounded to whole pixels, so that edges that meet in a corner are sorted by their distance in space.
        let by_image = |n: &NearbyFeature| n.pixels.map_or(f64::INFINITY, f64::round);
        near.sort_by(|a, b| {
            let in_image = by_image(a).total_cmp(&by_image(b));
            in_image.then(a.metres.total_cmp(&b.metres)).then(a.feature.id.cmp(&b.feature.id))
        });
        Ok(near)
    }

    /// For each feature, the distance in the image from a pixel to its visible part.
    fn pixels(&self, layer: &FeatureLayer, pixel: DVec2) -> Result<Vec<Option<f64>>> {
        if self.sensor.check_projection().is_err() {
            // A ray table without a projection, such as a single ray, has no image around the pixel.
            return Ok(vec![None; layer.features.len()]);
        }
        let placed = place(self.world, layer)?;
        let options = FeatureSettings::default();
        let seen = predict_features(self.world, self.sensor, self.pose, self.images, &placed, &options)?;
        Ok(seen.features.iter().map(|f| self.pixels_to(f, pixel)).collect())
    }

    fn pixels_to(&self, seen: &SeenFeature, pixel: DVec2) -> Option<f64> {
        /// The number of straight pieces that approximate the image of a segment.
        const PIECES: u32 = 64;
        let image_from_world = (self.pose.rotation_matrix() * self.sensor.body_from_image()).transpose();
        let points: Vec<DVec3> =
            seen.points_world.iter().map(|p| image_from_world * (*p - self.pose.translation)).collect();
        let ends = [points[0], points[points.len() - 1]];
        let off = |at: f64| {
            let on_image = DVec2::from(self.sensor.project(ends[0] + at * (ends[1] - ends[0]))?);
            let mut by = on_image - pixel;
            if let Some(turn) = self.sensor.columns_of_a_turn() {
                by.x -= turn * (by.x / turn).round();
            }
            Some(by)
        };
        let to_piece = |a: DVec2, b: DVec2| {
            let t = (-a.dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            if t.is_finite() { a.lerp(b, t).length() } else { a.length() }
        };
        let along = |[from, to]: [f64; 2]| {
            let at = move |i: u32| from + (to - from) * f64::from(i) / f64::from(PIECES);
            (0..PIECES).filter_map(move |i| Some(to_piece(off(at(i))?, off(at(i + 1))?)))
        };
        seen.visible.iter().flat_map(|v| along(v.t)).reduce(f64::min)
    }
}

/// Distance from a point to a point or segment feature, metres; `None` for patches.
fn distance(world: &World, feature: &Feature, p_in_world: DVec3) -> Option<f64> {
    let object = world.environment().object(feature.object.as_deref()?)?;
    let p = object.world_from_object.inverse().transform_point(p_in_world);
    match &feature.shape {
        FeatureShape::Point { at, .. } => Some(at.distance(p)),
        FeatureShape::Segment { ends: [a, b], .. } => {
            let t = ((p - *a).dot(*b - *a) / (*b - *a).length_squared()).clamp(0.0, 1.0);
            Some(a.lerp(*b, t).distance(p))
        }
        _ => None,
    }
}
