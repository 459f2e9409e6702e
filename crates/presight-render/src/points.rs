//! Range images as points.

use crate::plan::{IdScheme, Images, Output, Outputs, PolygonsOfIds};
use glam::{DQuat, DVec3, Vec3};
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, SensorPose, plane_of_polygon};
use presight_model::measured::{ScanMotion, ScanPoses};
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
    scan: Scan,
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
}

/// How the sensor moves while it measures the points.
#[derive(Clone, Debug, Default)]
struct Scan {
    /// Poses of bundles in the frame of the sensor at the stamp; `None` if one pose holds for all rays.
    poses: Option<ScanPoses>,
    /// From the frame of the sensor at the stamp to that of the points, if they are all in one.
    then_from_stamp: Option<Pose>,
    width: u32,
}

impl Scan {
    /// Pose of the bundle of a pixel in the frame of the sensor at the stamp.
    fn stamp_from_ray(&self, pixel: usize) -> Option<&Pose> {
        let width = self.width as usize;
        self.poses.as_ref().map(|poses| poses.of_pixel((pixel % width) as u32, (pixel / width) as u32))
    }

    /// The bundle of a pixel.
    fn bundle(&self, pixel: usize) -> u32 {
        let (column, row) = (pixel as u32 % self.width, pixel as u32 / self.width);
        self.poses.as_ref().map_or(0, |poses| poses.bundles().of_pixel(column, row))
    }
}

impl<'a> PointCloud<'a> {
    /// Computes the points of a range image: the sensor's f64 ray times the range. Pixels without a range become NaN.
    /// The robot stands; see [`PointCloud::of_scan`].
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the range image is missing, or an image does not have the sensor's
    /// size; errors of [`presight_model::geometry::Pose::check`].
    pub fn new(images: &'a Images, sensor: &Sensor, pose: &SensorPose, frame: PointsFrame) -> Result<Self> {
        Self::of_scan(images, sensor, pose, frame, None, None)
    }

    /// Computes the points of a range image that the sensor measured while the robot moved; `pose` is the sensor's at
    /// the stamp. Points in the frame of the sensor are as sensed, each in the frame at the time of its own ray, or
    /// deskewed: all in the frame at `moment`, seconds after the stamp. Points in the world need no moment.
    ///
    /// # Errors
    /// The errors of [`PointCloud::new`]; [`presight_model::ErrorKind::Invalid`] if the motion does not reach over the
    /// scan or to the moment.
    pub fn of_scan(
        images: &'a Images,
        sensor: &Sensor,
        pose: &SensorPose,
        frame: PointsFrame,
        motion: Option<&ScanMotion>,
        moment: Option<f64>,
    ) -> Result<Self> {
        let world_from_sensor = pose.world_from_sensor();
        world_from_sensor.check()?;
        let then = motion.zip(moment).map(|(motion, at)| motion.sensor_at(sensor, &Pose::IDENTITY, at)).transpose()?;
        let scan = Scan {
            poses: ScanPoses::new(sensor, &Pose::IDENTITY, motion)?,
            then_from_stamp: then.map(|pose| pose.inverse()),
            width: sensor.width(),
        };
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
                let from_origin = ray.map(|ray| body_from_image * ray * f64::from(range));
                let of_ray = scan.poses.as_ref().map(|poses| poses.of_pixel(column, row));
                // Ranges count from behind the point at which the ray leaves the sensor.
                let lead = ray.map_or(DVec3::ZERO, |ray| body_from_image * ray * sensor.range_lead());
                let at_stamp = |p| of_ray.map_or(p, |pose| pose.transform_point(p - lead));
                let point = match (frame, &scan.then_from_stamp) {
                    (PointsFrame::Sensor, None) if of_ray.is_none() => from_origin,
                    (PointsFrame::Sensor, None) => from_origin.map(|p| sensor.origin(column, row) + p),
                    (PointsFrame::Sensor, Some(then)) => from_origin.map(|p| then.transform_point(at_stamp(p))),
                    (PointsFrame::World, _) => from_origin.map(|p| world_from_sensor.transform_point(at_stamp(p))),
                };
                positions.push(point.unwrap_or(DVec3::NAN));
            }
        }
        let rings = !matches!(sensor.spec().geometry, Geometry::Camera(_));
        let outputs = images.outputs();
        let mut normals = memory::reserved(images.normal.len())?;
        normals.extend(images.normal.iter().enumerate().map(|(pixel, n)| {
            let turn = scan.stamp_from_ray(pixel).map_or(DQuat::IDENTITY, |pose| pose.rotation);
            match (frame, &scan.then_from_stamp) {
                (PointsFrame::Sensor, None) => Vec3::from(*n),
                (PointsFrame::Sensor, Some(then)) => (then.rotation * turn * DVec3::from(n.map(f64::from))).as_vec3(),
                (PointsFrame::World, _) => {
                    (world_from_sensor.rotation * (turn * DVec3::from(n.map(f64::from)))).as_vec3()
                }
            }
        }));
        Ok(Self { images, outputs, rings, frame, pose: *pose, scan, positions, normals })
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
        let mut known: HashMap<(u32, u32, u32), Vec3> = HashMap::new();
        let mut last = ((0, 0, 0), Vec3::NAN);
        let mut normals = memory::reserved(polygons.len())?;
        for (pixel, (object, polygon)) in objects.iter().zip(polygons).enumerate() {
            let seen = (*object, *polygon, self.scan.bundle(pixel));
            // Neighbouring pixels mostly show the same polygon.
            if seen != last.0 {
                let normal =
                    || found.find(seen.0, seen.1).map_or(Vec3::NAN, |(o, p)| self.normal(environment, o, p, pixel));
                last = (seen, *known.entry(seen).or_insert_with(normal));
            }
            normals.push(last.1);
        }
        self.normals = normals;
        Ok(self)
    }

    /// Normal of a polygon on the side of the ray of a pixel.
    fn normal(&self, environment: &Environment, object: u32, polygon: u32, pixel: usize) -> Vec3 {
        let at_stamp = self.pose.world_from_sensor();
        let pose = self.scan.stamp_from_ray(pixel).map_or(at_stamp, |pose| at_stamp * *pose);
        let corners = environment.objects()[object as usize].polygon_in_world(polygon);
        // Positions relative to the sensor keep their digits far from the origin.
        let relative: Vec<DVec3> = corners.iter().map(|p| *p - pose.translation).collect();
        let Some(plane) = plane_of_polygon(&relative) else { return Vec3::NAN };
        let normal = if plane.offset > 0.0 { -plane.normal } else { plane.normal };
        match (self.frame, &self.scan.then_from_stamp) {
            (PointsFrame::Sensor, None) => (pose.rotation.conjugate() * normal).as_vec3(),
            (PointsFrame::Sensor, Some(then)) => (then.rotation * (at_stamp.rotation.conjugate() * normal)).as_vec3(),
            (PointsFrame::World, _) => normal.as_vec3(),
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
