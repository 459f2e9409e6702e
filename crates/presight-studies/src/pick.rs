//! The point that a pixel sees, and the features near it that a layer may take: edges, corners, planes and smooth
//! surfaces.

use glam::{DMat3, DVec2, DVec3};
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{FeatureSettings, SeenFeature, place, predict_features};
use presight_model::environment::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
use presight_model::error::Result;
use presight_model::geometry::{Aabb, Pose, plane_of_polygon};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::plan::Images;
use std::sync::Arc;

/// The point that a pixel sees.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Slot of the polygon in the environment.
    pub slot: u32,
    /// Index of the object.
    pub object: u32,
    /// The polygon's number in the object's mesh.
    pub polygon: u32,
    /// World, metres.
    pub p_in_world: DVec3,
    /// Unit normal of the polygon in the world, on the sensor's side.
    pub normal: DVec3,
    /// Metres from the sensor.
    pub range: f64,
}

impl Hit {
    /// A point feature (id 1) where the pixel hits the object, with that standard deviation along each axis, metres.
    pub fn point(&self, world: &World, sigma: f64) -> Feature {
        let object = &world.environment().objects()[self.object as usize];
        let object_from_world = object.world_from_object.inverse();
        let at = object_from_world.transform_point(self.p_in_world);
        let normal = (object_from_world.rotation * self.normal).normalize();
        Feature {
            id: 1,
            name: Some(format!("point on polygon {}", self.slot + 1)),
            object: Some(object.name.clone()),
            shape: FeatureShape::Point { at, covariance: DMat3::IDENTITY * (sigma * sigma) },
            existence: Existence::default(),
            properties: Properties { normal: Some(normal), ..Properties::default() },
        }
    }
}

/// An edge or a corner.
#[derive(Clone, Debug)]
pub struct NearbyFeature {
    /// As generated.
    pub feature: Arc<Feature>,
    /// Distance from the point that the pixel sees, metres.
    pub metres: f64,
    /// Distance in the image from the pixel to the visible part, pixels; `None` if not visible or not known.
    pub pixels: Option<f64>,
}

/// The features that may be made near a hit.
#[derive(Clone, Debug)]
pub struct Candidates {
    /// Edges and corners.
    pub near: Vec<NearbyFeature>,
    /// Planes and smooth surfaces under the hit.
    pub surfaces: Vec<Arc<Feature>>,
    /// Distance of all of these from their polygons, metres; a layer that takes one needs it.
    pub tolerance: f64,
}

/// A prediction at a pose.
#[derive(Clone, Copy, Debug)]
pub struct PickView<'a> {
    /// The world.
    pub world: &'a World,
    /// The sensor.
    pub sensor: &'a Sensor,
    /// Its pose, body axes.
    pub pose: &'a Pose,
    /// The predicted images, with `polygon_id`.
    pub images: &'a Images,
}

impl PickView<'_> {
    /// The point that a pixel (column, row) sees; `None` if it sees nothing.
    pub fn hit(&self, (column, row): (u32, u32)) -> Option<Hit> {
        let (pose, environment) = (self.pose, self.world.environment());
        let at = row as usize * self.images.width as usize + column as usize;
        let slot = self.images.polygon_id.get(at)?.checked_sub(1)?;
        let (object, polygon) = environment.locate(slot)?;
        let plane = plane_of_polygon(&environment.polygon_in_world(slot)?)?;
        let direction = pose.rotation * (self.sensor.body_from_image() * self.sensor.ray(column, row)?);
        // Intersect with the polygon's plane in f64, because the predicted range is f32.
        let range = (plane.offset - plane.normal.dot(pose.translation)) / plane.normal.dot(direction);
        let normal = if plane.normal.dot(direction) > 0.0 { -plane.normal } else { plane.normal };
        let p_in_world = pose.translation + direction * range;
        p_in_world.is_finite().then_some(Hit { slot, object, polygon, p_in_world, normal, range })
    }

    /// The features of a class that are generated within `reach` metres of a hit: edges and corners as
    /// [`PickView::near`] sorts them, and the planes and smooth surfaces under the hit.
    ///
    /// # Errors
    /// Errors of [`generate`] and of predicting features.
    pub fn candidates(
        &self,
        class: &str,
        hit: &Hit,
        pixel: DVec2,
        reach: f64,
        options: &GenerateOptions,
    ) -> Result<Candidates> {
        let region = Aabb { min: hit.p_in_world - reach, max: hit.p_in_world + reach };
        let options = GenerateOptions { region: Some(region), ..options.clone() };
        let layer = generate(self.world.environment(), class, &options)?.layer;
        let wide = |f: &Arc<Feature>| matches!(f.shape, FeatureShape::Patch { .. } | FeatureShape::Contour { .. });
        let features = layer.features.iter().filter(|f| wide(f)).cloned().collect();
        let surfaces = place(self.world, &FeatureLayer { features, ..layer.clone() })?;
        let under = surfaces.into_iter().filter(|placed| placed.slots.contains(&hit.slot)).map(|placed| placed.feature);
        let (surfaces, tolerance) = (under.collect(), layer.tolerance);
        Ok(Candidates { near: self.near(layer, hit.p_in_world, pixel, reach)?, surfaces, tolerance })
    }

    /// Edges and corners of a layer within `reach` metres of the point that a pixel sees: first the visible ones,
    /// sorted by distance in the image, then the others, sorted by distance in space.
    ///
    /// # Errors
    /// Errors of placing and predicting features.
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
