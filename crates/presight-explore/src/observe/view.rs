//! Measurements with the poses of their sensors.

use glam::{DMat3, DVec3, Vec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Aabb, Pose, SensorPose};
use presight_model::measured::{Frame, Measurement};
use presight_model::sensor::{RayTimes, Sensor};
use std::sync::Arc;

/// A sensor with its rays. All views of the sensor share them.
#[derive(Debug)]
struct Optics {
    sensor: Sensor,
    /// Unit rays in the image frame, row by row; NaN for a pixel without a ray.
    rays: Vec<Vec3>,
    /// Angle between neighbouring rays, radians.
    pitch: f32,
}

/// One measurement at a known pose.
#[derive(Clone, Debug)]
pub struct View {
    /// Time stamp in the log, seconds.
    pub stamp: f64,
    /// Time of the pose, seconds: the stamp, or the middle of a scan that takes time.
    moment: f64,
    /// The sensor's pose.
    pub pose: SensorPose,
    /// Metres along each ray, row by row: infinite for a ray without a return, NaN without a measurement.
    pub ranges: Vec<f32>,
    optics: Arc<Optics>,
    /// Rotation from the image frame to the world.
    rotation: DMat3,
    /// Position of the sensor relative to [`Views::base`].
    origin: DVec3,
}

/// Measurements at known poses.
#[derive(Clone, Debug, Default)]
pub struct Views {
    /// Origin of all coordinates of points. It keeps the precision of sums far from the world's origin.
    base: DVec3,
    views: Vec<View>,
}

impl Views {
    /// Adds a frame of ranges, with the pose of the sensor at its stamp. A scan that takes time becomes the view from the
    /// middle of the scan ([`Frame::at_one_moment`]).
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a pose that is not rigid; [`presight_model::ErrorKind::Invalid`] for a
    /// grey image; the errors of [`Frame::deskewed`].
    pub fn push(&mut self, frame: &Frame, pose: SensorPose) -> Result<()> {
        pose.world_from_sensor().check()?;
        if frame.grey().is_some() {
            return Err(Error::invalid("a grey image shows no distances", "give a log of ranges or depths"));
        }
        let (stamp, moment) = (frame.stamp, frame.at_one_moment()?);
        let (frame, pose) = (&*moment.frame, moment.sensor(&pose));
        let world_from_sensor = pose.world_from_sensor();
        if self.views.is_empty() {
            self.base = world_from_sensor.translation.round();
        }
        let sensor = frame.sensor();
        let known = self.views.last().map(|v| &v.optics).filter(|o| o.sensor.spec() == sensor.spec());
        let optics = known.cloned().unwrap_or_else(|| Arc::new(Optics::new(sensor.clone())));
        let rotation = world_from_sensor.rotation_matrix() * sensor.body_from_image();
        let origin = world_from_sensor.translation - self.base;
        // An infinite range stays: that ray passed through free space.
        let hit = |r: &f32| if *r > 0.0 { *r } else { f32::NAN };
        let ranges = frame.ranges().iter().map(hit).collect();
        let moment = frame.stamp;
        self.views.push(View { stamp, moment, pose, ranges, optics, rotation, origin });
        Ok(())
    }

    /// Origin of the coordinates of all points, metres in the world.
    pub fn base(&self) -> DVec3 {
        self.base
    }

    /// The views.
    #[doc(hidden)]
    pub fn all(&self) -> &[View] {
        &self.views
    }

    /// The views after all their poses moved by a transform of the world.
    pub(crate) fn moved(self, by: &Pose) -> Self {
        let base = (*by * Pose { translation: self.base, ..Pose::IDENTITY }).translation.round();
        let moved = |view: View| {
            let world_from_sensor = *by * view.pose.world_from_sensor();
            let rotation = world_from_sensor.rotation_matrix() * view.sensor().body_from_image();
            let pose = SensorPose::new(world_from_sensor);
            View { pose, rotation, origin: world_from_sensor.translation - base, ..view }
        };
        Self { base, views: self.views.into_iter().map(moved).collect() }
    }

    /// These views, followed by others.
    pub(crate) fn with(mut self, others: Self) -> Self {
        let shift = others.base - self.base;
        self.views.extend(others.views.into_iter().map(|view| View { origin: view.origin + shift, ..view }));
        self
    }

    /// At most `max` views at even steps, the last one among them.
    pub(crate) fn some(&self, max: usize) -> Self {
        let count = self.views.len();
        let step = count.div_ceil(max.max(1)).max(1);
        let mut views: Vec<View> = self.views.iter().rev().step_by(step).cloned().collect();
        views.reverse();
        Self { base: self.base, views }
    }

    /// A sample of the views that suffices for medians over their pixels and for mirrors.
    pub(crate) fn sample(&self) -> Self {
        self.some(16)
    }

    /// One of the views alone.
    pub(crate) fn only(&self, number: usize) -> Self {
        Self { base: self.base, views: vec![self.views[number].clone()] }
    }

    /// The views without the ranges for which `is_out` is true, and the number of those ranges.
    pub(crate) fn without(&self, is_out: impl Fn(&View, usize) -> bool) -> (Self, usize) {
        let (mut left, mut count) = (self.clone(), 0);
        for (view, own) in left.views.iter_mut().zip(&self.views) {
            for (pixel, range) in view.ranges.iter_mut().enumerate() {
                if range.is_finite() && is_out(own, pixel) {
                    *range = f32::NAN;
                    count += 1;
                }
            }
        }
        (left, count)
    }

    /// Bounds of the measured points, relative to the base, metres.
    pub(crate) fn bounds(&self) -> Aabb {
        let points = |view: &View| {
            Aabb::of((0..view.ranges.len()).filter(|i| view.ranges[*i].is_finite()).map(|i| view.point(i)))
        };
        self.views.iter().map(points).fold(Aabb::EMPTY, Aabb::union)
    }

    /// Number of measured points.
    pub fn hits(&self) -> usize {
        self.views.iter().map(|v| v.ranges.iter().filter(|r| r.is_finite()).count()).sum()
    }
}

impl Optics {
    fn new(sensor: Sensor) -> Self {
        let (width, height) = (sensor.width(), sensor.height());
        let ray = |c, r| sensor.ray(c, r).map_or(Vec3::NAN, |ray| ray.as_vec3());
        let rays: Vec<Vec3> = (0..height).flat_map(|r| (0..width).map(move |c| ray(c, r))).collect();
        let mut angles: Vec<f64> =
            rays.windows(2).map(|p| f64::from(p[0].distance(p[1]))).filter(|a| *a > 0.0).collect();
        let pitch = presight_model::statistics::median(&mut angles).unwrap_or(0.01) as f32;
        Self { sensor, rays, pitch }
    }
}

impl View {
    /// The sensor of the view.
    pub fn sensor(&self) -> &Sensor {
        &self.optics.sensor
    }

    /// The measurement without its pose, at the time of the pose.
    pub(crate) fn frame(&self) -> Result<Frame> {
        let sensor = self.sensor();
        let sensor = match &sensor.spec().times {
            RayTimes::AtOnce => sensor.clone(),
            _ => Sensor::new(sensor.spec().clone().with_times(RayTimes::AtOnce))?,
        };
        Frame::new(self.moment, sensor, Measurement::Range(self.ranges.clone()))
    }

    /// Columns of the image.
    pub(crate) fn width(&self) -> usize {
        self.optics.sensor.width() as usize
    }

    /// Rows of the image.
    pub(crate) fn height(&self) -> usize {
        self.optics.sensor.height() as usize
    }

    /// Pixels with neighbours on all four sides.
    pub(crate) fn inner_pixels(&self) -> impl Iterator<Item = usize> + use<> {
        let (width, height) = (self.width(), self.height());
        (1..height.saturating_sub(1)).flat_map(move |row| row * width + 1..(row + 1) * width - 1)
    }

    /// Angle between neighbouring rays, radians.
    pub(crate) fn pitch(&self) -> f64 {
        f64::from(self.optics.pitch)
    }

    /// The measured point of a pixel in the image frame; NaN without a hit.
    #[inline]
    pub(crate) fn in_image(&self, pixel: usize) -> Vec3 {
        self.optics.rays[pixel] * self.ranges[pixel]
    }

    /// Unit ray of a pixel in body axes.
    pub(crate) fn in_body(&self, pixel: usize) -> DVec3 {
        self.optics.sensor.body_from_image() * self.optics.rays[pixel].as_dvec3()
    }

    /// The measured point of a pixel, relative to the base of the views.
    pub(crate) fn point(&self, pixel: usize) -> DVec3 {
        self.origin + self.ray(pixel) * f64::from(self.ranges[pixel])
    }

    /// Unit ray of a pixel, relative to the base of the views.
    #[inline]
    pub(crate) fn ray(&self, pixel: usize) -> DVec3 {
        self.rotation * self.optics.rays[pixel].as_dvec3()
    }

    /// Position of the sensor relative to the base of the views.
    pub(crate) fn origin(&self) -> DVec3 {
        self.origin
    }

    /// A direction of the image frame in the world.
    #[inline]
    pub(crate) fn direction_to_world(&self, direction: Vec3) -> DVec3 {
        self.rotation * direction.as_dvec3()
    }

    /// A point given relative to the base of the views, in the image frame.
    #[inline]
    pub(crate) fn to_image(&self, p: DVec3) -> DVec3 {
        self.rotation.transpose() * (p - self.origin)
    }

    /// A direction of the world in the image frame.
    #[inline]
    pub(crate) fn direction_to_image(&self, d: DVec3) -> DVec3 {
        self.rotation.transpose() * d
    }

    /// The pixel whose ray is nearest to the direction of a point, given in the image frame; `None` outside the image.
    #[inline]
    pub(crate) fn pixel_towards(&self, p: Vec3) -> Option<usize> {
        let (u, v) = self.optics.sensor.project_nearly(p)?;
        let (u, v) = (u + 0.5, v + 0.5);
        let (width, height) = (self.width(), self.height());
        (u >= 0.0 && v >= 0.0 && u < width as f32 && v < height as f32).then(|| v as usize * width + u as usize)
    }

    /// The unit ray of the nearest pixel, as of [`Self::pixel_towards`], and its range; `None` outside the image and
    /// without a measurement.
    #[inline]
    pub(crate) fn towards(&self, p: Vec3) -> Option<(Vec3, f32)> {
        let pixel = self.pixel_towards(p)?;
        let measured = self.ranges[pixel];
        (!measured.is_nan()).then(|| (self.optics.rays[pixel], measured))
    }

    /// Unit ray of a pixel in the image frame.
    #[inline]
    pub(crate) fn unit_ray(&self, pixel: usize) -> Vec3 {
        self.optics.rays[pixel]
    }
}
