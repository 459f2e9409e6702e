//! Expected pixels: the predicted point and the exact plane of its polygon.

use super::pixel::{ExpectedPixel, NOTHING};
use super::strided::StridedPoints;
use super::surfaces::{ObjectErrors, Surfaces};
use glam::DVec3;
use presight_model::environment::MarkKind;
use presight_model::error::Result;
use presight_model::geometry::{Pose, RobotPose, SensorPose};
use presight_model::sensor::{Geometry, Sensor, body_from_optical_rotation};
use presight_model::world::World;
use presight_predict::predict::Predictor;
use presight_render::plan::{Images, Output, Outputs};
use rayon::prelude::*;
use std::collections::HashMap;

/// Minimum number of pixels in a parallel task.
pub(super) const TASK: usize = 512;

/// A prediction, arranged for comparison with a measurement.
#[derive(Clone, Debug)]
pub struct ExpectedImage {
    /// The sensor.
    pub sensor: Sensor,
    /// Its pose, axes of the image.
    pub world_from_image: Pose,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The pixels, row by row.
    pub pixels: Vec<ExpectedPixel>,
    pub(crate) strided: StridedPoints,
    /// Radians between neighbouring columns and between neighbouring rows; infinite for a single one.
    pub spacing: (f64, f64),
    /// Pose errors of the objects whose covariances are stored.
    pub errors: ObjectErrors,
    /// True for pixels that are marked as uncertain; empty without marks.
    uncertain: Vec<bool>,
    /// The probability that an object exists, by its index; without an entry it is 1.
    existence: HashMap<u32, f64>,
}

/// The image frame of a sensor, in which its rays and points are given, relative to its body axes.
pub fn body_from_image(sensor: &Sensor) -> Pose {
    let optical = || body_from_optical_rotation() * sensor.spec().optical_from_image;
    let rotation = if sensor.is_camera() { optical() } else { glam::DQuat::IDENTITY };
    Pose { rotation, translation: DVec3::ZERO }
}

fn existence_of(world: &World) -> HashMap<u32, f64> {
    let environment = world.environment();
    let known = environment.trusts().filter(|(_, trust)| trust.p0 < 1.0);
    known.filter_map(|(object, trust)| Some((environment.index_of(object).ok()?, trust.p0))).collect()
}

impl ExpectedImage {
    /// Predicts a sensor's image from a robot at a pose, with the plane of each pixel's polygon.
    ///
    /// # Errors
    /// Those of [`Predictor::predict_images`].
    pub fn predict(
        predictor: &mut Predictor,
        world: &World,
        surfaces: &mut Surfaces,
        sensor: &Sensor,
        robot: &RobotPose,
    ) -> Result<Self> {
        let pose = robot.sensor(sensor);
        let outputs = Outputs::of(&[Output::Range, Output::PolygonId]);
        let mut images = Images::default();
        predictor.predict_images(world, sensor, &pose, outputs, &mut images)?;
        Self::of_images(predictor, world, surfaces, sensor, &pose, &images)
    }

    /// Arranges images of [`Output::Range`] and [`Output::PolygonId`] that were predicted at this pose of the sensor,
    /// for example under a deadline.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if threads cannot be started.
    pub fn of_images(
        predictor: &mut Predictor,
        world: &World,
        surfaces: &mut Surfaces,
        sensor: &Sensor,
        pose: &SensorPose,
        images: &Images,
    ) -> Result<Self> {
        surfaces.follow(world);
        let errors = surfaces.object_errors(world, &sensor.spec().class);
        let world_from_image = pose.world_from_sensor() * body_from_image(sensor);
        let image_from_world = world_from_image.inverse();
        let (width, height) = (sensor.width() as usize, sensor.height() as usize);
        images.polygon_id.iter().for_each(|id| surfaces.see(world, *id));
        let pixel = |i: usize| {
            let range = images.range[i];
            let surface = images.polygon_id[i].checked_sub(1).and_then(|slot| surfaces.seen(slot));
            let ray = sensor.ray((i % width) as u32, (i / width) as u32);
            let (Some(surface), Some(ray), true) = (surface, ray, range.is_finite()) else {
                return ExpectedPixel { range, ..NOTHING };
            };
            let normal = image_from_world.rotation * surface.plane.normal;
            let offset = surface.plane.offset - surface.plane.normal.dot(world_from_image.translation);
            ExpectedPixel {
                point: (f64::from(range) * ray).as_vec3(),
                range,
                normal: normal.as_vec3(),
                offset: offset as f32,
                object: surface.object,
                group: surface.group,
            }
        };
        let pixels = (0..width * height).into_par_iter().with_min_len(TASK);
        let pixels: Vec<ExpectedPixel> = predictor.on_threads(|| pixels.map(pixel).collect())?;
        Ok(Self {
            sensor: sensor.clone(),
            world_from_image,
            width,
            height,
            pixels,
            strided: StridedPoints::default(),
            spacing: spacing(sensor),
            errors,
            uncertain: Vec::new(),
            existence: existence_of(world),
        }
        .with_marks(world))
    }

    /// Marks the pixels that see parts of objects marked as uncertain.
    fn with_marks(mut self, world: &World) -> Self {
        let environment = world.environment();
        if environment.marks().any(|(_, mark)| mark.kind == MarkKind::Uncertain) {
            let class = &self.sensor.spec().class;
            let is_uncertain = |pixel: &ExpectedPixel| {
                let p_in_world = self.world_from_image.transform_point(pixel.point.as_dvec3());
                pixel.range.is_finite() && environment.is_uncertain(pixel.object, p_in_world, class)
            };
            self.uncertain = self.pixels.iter().map(is_uncertain).collect();
        }
        self
    }

    /// The stored probability that an object exists; 1 without stored trust.
    pub fn existence(&self, object: u32) -> f64 {
        if self.existence.is_empty() { 1.0 } else { self.existence.get(&object).copied().unwrap_or(1.0) }
    }

    /// True if a pixel sees a part that is marked as uncertain.
    pub fn is_uncertain(&self, pixel: usize) -> bool {
        self.uncertain.get(pixel).is_some_and(|uncertain| *uncertain)
    }

    /// The pixels, row by row.
    pub fn pixels(&self) -> &[ExpectedPixel] {
        &self.pixels
    }
}

/// Radians between neighbouring columns and rows in the middle of the image.
fn spacing(sensor: &Sensor) -> (f64, f64) {
    if let Geometry::Camera(camera) = &sensor.spec().geometry {
        return (1.0 / camera.fx, 1.0 / camera.fy);
    }
    let (column, row) = (sensor.width() / 2, sensor.height() / 2);
    let between = |c: u32, r: u32| match (sensor.ray(column, row), sensor.ray(c, r)) {
        (Some(a), Some(b)) if (c, r) != (column, row) => a.angle_between(b),
        _ => f64::INFINITY,
    };
    (between(column.saturating_sub(1), row), between(column, row.saturating_sub(1)))
}
