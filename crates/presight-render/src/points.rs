//! Range images as points.

use crate::plan::{IdScheme, Images, Output, Outputs, PolygonsOfIds};
use glam::{DVec3, Vec3};
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use presight_model::geometry::{SensorPose, plane_of_polygon};
use presight_model::memory;
use presight_model::sensor::{Geometry, Sensor};
use std::collections::HashMap;

/// The frame of the points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PointsFrame {
    /// The sensor's body axes: x forward, y left, z up.
    Sensor,
    /// The world.
    World,
}

/// The points of a range image, one per pixel, row-major, with the values of other images.
///
/// A point has the values of each existing image of range, echo, object_id and polygon_id. It also has its ring (the
/// row of the image) unless the sensor is a camera, and a normal if there is a normal image or after
/// [`PointCloud::with_normals`].
#[derive(Clone, Debug)]
pub struct PointCloud<'a> {
    images: &'a Images,
    outputs: Outputs,
    rings: bool,
    frame: PointsFrame,
    pose: SensorPose,
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
}

impl<'a> PointCloud<'a> {
    /// Computes the points of a range image: the sensor's f64 ray times the range. Pixels without a range become NaN.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the range image is missing, or an image does not have the sensor's
    /// size; errors of [`presight_model::geometry::Pose::check`].
    pub fn new(images: &'a Images, sensor: &Sensor, pose: &SensorPose, frame: PointsFrame) -> Result<Self> {
        let world_from_sensor = pose.world_from_sensor();
        world_from_sensor.check()?;
        let pixels = sensor.width() as usize * sensor.height() as usize;
        let fits = |output| images.samples(output).is_none_or(|samples| samples.len() == pixels);
        let of_size = (images.width, images.height) == (sensor.width(), sensor.height());
        if images.range.len() != pixels || !of_size || !Output::WITH_FEATURES.into_iter().all(fits) {
            return Err(Error::invalid(
                format!("{} ranges for the {pixels} pixels of {:?}", images.range.len(), sensor.spec().name),
                "predict the range image with this sensor",
            ));
        }
        let body_from_image = sensor.body_from_image();
        let mut positions = memory::reserved(pixels)?;
        for row in 0..sensor.height() {
            for column in 0..sensor.width() {
                let range = images.range[row as usize * sensor.width() as usize + column as usize];
                let ray = sensor.ray(column, row).filter(|_| range.is_finite());
                let in_sensor = ray.map(|ray| body_from_image * ray * f64::from(range));
                let point = match frame {
                    PointsFrame::Sensor => in_sensor,
                    PointsFrame::World => in_sensor.map(|p| world_from_sensor.transform_point(p)),
                };
                positions.push(point.unwrap_or(DVec3::NAN));
            }
        }
        let rings = !matches!(sensor.spec().geometry, Geometry::Camera(_));
        let outputs = images.outputs();
        let mut normals = memory::reserved(images.normal.len())?;
        normals.extend(images.normal.iter().map(|n| match frame {
            PointsFrame::Sensor => Vec3::from(*n),
            PointsFrame::World => (world_from_sensor.rotation * DVec3::from(n.map(f64::from))).as_vec3(),
        }));
        Ok(Self { images, outputs, rings, frame, pose: *pose, positions, normals })
    }

    /// Keeps only the fields of these images.
    #[must_use]
    pub fn only(mut self, outputs: Outputs) -> Self {
        let there = self.images.outputs();
        self.outputs = Outputs::of(&there.iter().filter(|o| outputs.has(*o)).collect::<Vec<_>>());
        if there.has(Output::Normal) && !outputs.has(Output::Normal) {
            self.normals.clear();
        }
        self
    }

    /// Adds the unit normals of visible polygons, towards the sensor, in the frame of the points; NaN where nothing is
    /// seen. `ids` is the numbering of the `polygon_id` image.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if there is no image of polygon_id or object_id;
    /// [`presight_model::ErrorKind::System`] if memory is short.
    pub fn with_normals(mut self, environment: &Environment, ids: IdScheme) -> Result<Self> {
        let (objects, polygons) = (&self.images.object_id, &self.images.polygon_id);
        if objects.is_empty() || polygons.is_empty() {
            let remedy = "predict object_id and polygon_id";
            return Err(Error::invalid("normals need the images that identify polygons", remedy));
        }
        let mut found = PolygonsOfIds::new(environment, ids);
        let mut known: HashMap<(u32, u32), Vec3> = HashMap::new();
        let mut last = ((0, 0), Vec3::NAN);
        let mut normals = memory::reserved(polygons.len())?;
        for seen in objects.iter().copied().zip(polygons.iter().copied()) {
            // Neighbouring pixels mostly show the same polygon.
            if seen != last.0 {
                let normal = || found.find(seen.0, seen.1).map_or(Vec3::NAN, |(o, p)| self.normal(environment, o, p));
                last = (seen, *known.entry(seen).or_insert_with(normal));
            }
            normals.push(last.1);
        }
        self.normals = normals;
        Ok(self)
    }

    fn normal(&self, environment: &Environment, object: u32, polygon: u32) -> Vec3 {
        let pose = self.pose.world_from_sensor();
        let corners = environment.objects()[object as usize].polygon_in_world(polygon);
        // Positions relative to the sensor keep their digits far from the origin.
        let relative: Vec<DVec3> = corners.iter().map(|p| *p - pose.translation).collect();
        let Some(plane) = plane_of_polygon(&relative) else { return Vec3::NAN };
        let normal = if plane.offset > 0.0 { -plane.normal } else { plane.normal };
        match self.frame {
            PointsFrame::Sensor => (pose.rotation.conjugate() * normal).as_vec3(),
            PointsFrame::World => normal.as_vec3(),
        }
    }

    /// Positions in the requested frame, metres; NaN for pixels without a measurement.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Unit normals towards the sensor, in the requested frame; empty if there are none.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// The images whose values the points have.
    pub fn images(&self) -> &'a Images {
        self.images
    }

    /// The outputs whose values the points have, if there is an image of them.
    pub fn outputs(&self) -> Outputs {
        self.outputs
    }

    /// True if the points have the row of the image: the ring of a scanner.
    pub fn has_rings(&self) -> bool {
        self.rings
    }

    /// Index and position of each pixel that has a position.
    pub fn seen(&self) -> impl Iterator<Item = (usize, DVec3)> + '_ {
        self.positions.iter().copied().enumerate().filter(|(_, p)| !p.is_nan())
    }

    /// The frame of the positions and normals.
    pub fn frame(&self) -> PointsFrame {
        self.frame
    }

    /// The pose of the sensor.
    pub fn pose(&self) -> SensorPose {
        self.pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::sensor::{Angles, Camera, Scanner, SensorSpec};

    /// A 3 x 2 camera image with a miss and a pixel that is too near.
    fn camera_view() -> (Sensor, Images) {
        let geometry = Geometry::Camera(Camera::pinhole(3, 2, 2.0, 2.0, 1.0, 0.0));
        let sensor = Sensor::new(SensorSpec::new("c", "video", geometry)).unwrap();
        let mut images = Images::default();
        images.prepare(3, 2, Outputs::of(&[Output::Range, Output::PolygonId]));
        images.range.copy_from_slice(&[1.0, 2.0, 3.0, f32::INFINITY, 5.0, f32::NEG_INFINITY]);
        images.polygon_id.copy_from_slice(&[1, 2, 3, 0, u32::MAX, 6]);
        (sensor, images)
    }

    #[test]
    fn a_camera_sees_forward_left_and_down() {
        let (sensor, images) = camera_view();
        let cloud = PointCloud::new(&images, &sensor, &SensorPose::IDENTITY, PointsFrame::Sensor).unwrap();
        let p = cloud.positions();
        assert!((p[1] - DVec3::new(2.0, 0.0, 0.0)).length() < 1e-12, "the axis: {}", p[1]);
        assert!(p[0].y > 0.0 && p[2].y < 0.0, "column 0 is the left one");
        assert!(p[4].z < 0.0, "row 1 looks down");
        assert!((p[4].length() - 5.0).abs() < 1e-12);
        assert!(p[3].is_nan() && p[5].is_nan());
        assert_eq!(cloud.seen().count(), 4);
    }

    #[test]
    fn a_scanner_turns_counter_clockwise_and_the_world_moves_with_the_pose() {
        let azimuth = Angles::Uniform { start_deg: 0.0, step_deg: 90.0, count: 2 };
        let scanner = Scanner { azimuth, elevation: Angles::Listed(vec![0.0]), beam_height_deg: None };
        let sensor = Sensor::new(SensorSpec::new("s", "laser", Geometry::Scanner(scanner))).unwrap();
        let mut images = Images::default();
        images.prepare(2, 1, Outputs::of(&[Output::Range]));
        images.range.fill(2.0);
        let pose = SensorPose::from_xyz_rpy(DVec3::new(5e6, 1.0, 1.0), 0.0, 0.0, 0.0);
        let cloud = PointCloud::new(&images, &sensor, &pose, PointsFrame::World).unwrap();
        let off = cloud.positions()[1] - DVec3::new(5e6, 3.0, 1.0);
        assert!(off.length() < 1e-8, "{off}");
    }

    #[test]
    fn images_of_another_size_are_refused() {
        let (sensor, mut images) = camera_view();
        images.range.pop();
        assert!(PointCloud::new(&images, &sensor, &SensorPose::IDENTITY, PointsFrame::Sensor).is_err());
    }
}
