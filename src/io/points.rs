//! Range images as points.

use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::memory;
use crate::plan::Images;
use crate::sensor::Sensor;
use glam::DVec3;

/// The frame of the points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PointsFrame {
    /// The sensor's body axes: x forward, y left, z up.
    Sensor,
    /// The world.
    World,
}

/// The points of a range image, one per pixel, row-major.
#[derive(Clone, Debug)]
pub struct PointCloud {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) frame: PointsFrame,
    pub(super) world_from_sensor: Pose,
    pub(super) positions: Vec<DVec3>,
    pub(super) polygon_id: Vec<u32>,
}

impl PointCloud {
    /// Computes the points of a range image: the sensor's f64 ray times the range. Pixels without a range become NaN. All ids are 0
    /// if there is no `polygon_id` image.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if there is no range image, or an image is not of the sensor's size;
    /// those of [`Pose::check`].
    pub fn new(images: &Images, sensor: &Sensor, world_from_sensor: &Pose, frame: PointsFrame) -> Result<Self> {
        world_from_sensor.check()?;
        let pixels = sensor.width() as usize * sensor.height() as usize;
        let ids_fit = images.polygon_id.is_empty() || images.polygon_id.len() == pixels;
        if images.range.len() != pixels || !ids_fit {
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
        let polygon_id = if images.polygon_id.is_empty() { vec![0; pixels] } else { images.polygon_id.clone() };
        let (width, height) = (sensor.width(), sensor.height());
        Ok(Self { width, height, frame, world_from_sensor: *world_from_sensor, positions, polygon_id })
    }

    /// Positions in the requested frame, metres; NaN where nothing is measured.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Points with a position, and their polygon ids.
    pub(super) fn seen(&self) -> impl Iterator<Item = (DVec3, u32)> + '_ {
        let both = self.positions.iter().copied().zip(self.polygon_id.iter().copied());
        both.filter(|(p, _)| !p.is_nan())
    }

    /// Description of the frame, for the comment in both formats.
    pub(super) fn frame_in_words(&self) -> &'static str {
        match self.frame {
            PointsFrame::Sensor => "sensor body axes: x forward, y left, z up; metres",
            PointsFrame::World => "world: z up; metres",
        }
    }
}

/// A point's bytes, little-endian: f32 in the sensor frame, f64 in the world, where f32 would lose the millimetres of
/// a site in UTM coordinates.
pub(super) fn position_bytes(frame: PointsFrame, p: DVec3) -> Vec<u8> {
    match frame {
        PointsFrame::Sensor => p.to_array().iter().flat_map(|v| (*v as f32).to_le_bytes()).collect(),
        PointsFrame::World => p.to_array().iter().flat_map(|v| v.to_le_bytes()).collect(),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::plan::{Output, Outputs};
    use crate::sensor::{Angles, Camera, Geometry, Scanner, SensorSpec};

    /// A 3 x 2 camera image with a miss and a pixel that is too near.
    pub fn camera_view() -> (Sensor, Images) {
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
        let cloud = PointCloud::new(&images, &sensor, &Pose::IDENTITY, PointsFrame::Sensor).unwrap();
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
        let pose = Pose::from_xyz_rpy(DVec3::new(5e6, 1.0, 1.0), 0.0, 0.0, 0.0);
        let cloud = PointCloud::new(&images, &sensor, &pose, PointsFrame::World).unwrap();
        let off = cloud.positions()[1] - DVec3::new(5e6, 3.0, 1.0);
        assert!(off.length() < 1e-8, "{off}");
        assert_eq!(position_bytes(cloud.frame, cloud.positions()[1]).len(), 24);
    }

    #[test]
    fn images_of_another_size_are_refused() {
        let (sensor, mut images) = camera_view();
        images.range.pop();
        assert!(PointCloud::new(&images, &sensor, &Pose::IDENTITY, PointsFrame::Sensor).is_err());
    }
}
