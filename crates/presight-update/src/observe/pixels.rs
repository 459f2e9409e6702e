//! The pixels of a sensor that are compared.

use glam::DVec3;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;

/// Maximum number of rows of a sensor whose rows are all used.
const MAX_FULL_ROWS: u32 = 64;

/// A regular sample of a sensor's pixels.
#[derive(Clone, Debug)]
pub(crate) struct SampledPixels {
    pub sensor: Sensor,
    /// Unit rays in the image frame, row by row; NaN where the sensor has no ray.
    pub rays: Vec<DVec3>,
    /// Angle between neighbouring pixels of the sensor, radians.
    pub spacing: f64,
    /// Columns and rows between neighbours of the sample.
    stride: [u32; 2],
    columns: u32,
}

impl SampledPixels {
    /// Selects at most about `max` pixels: every n-th column, and every n-th row of a sensor with more than 64.
    pub fn new(sensor: &Sensor, max: usize) -> Self {
        let (width, height) = (sensor.distinct_columns(), sensor.height());
        let has_many_rows = height > MAX_FULL_ROWS;
        let ratio = f64::from(width) * f64::from(height) / max.max(1) as f64;
        let step = if has_many_rows { ratio.sqrt().ceil() } else { ratio.ceil() }.max(1.0) as u32;
        let stride = [step, if has_many_rows { step } else { 1 }];
        let (columns, mut rays) = (width.div_ceil(stride[0]), Vec::new());
        for row in (0..height).step_by(stride[1] as usize) {
            rays.extend((0..width).step_by(stride[0] as usize).map(|c| sensor.ray(c, row).unwrap_or(DVec3::NAN)));
        }
        let (c, r) = (width / 2, height / 2);
        let angle = |a: Option<DVec3>, b: Option<DVec3>| a.zip(b).map_or(0.0, |(a, b)| a.angle_between(b));
        let spacing = angle(sensor.ray(c, r), sensor.ray(c.saturating_sub(1), r));
        Self { sensor: sensor.clone(), rays, spacing, stride, columns }
    }

    /// Column and row of a sampled pixel in the sensor's image.
    pub fn pixel(&self, at: usize) -> (u32, u32) {
        let (c, r) = (at as u32 % self.columns, at as u32 / self.columns);
        (c * self.stride[0], r * self.stride[1])
    }

    /// The sampled pixel nearest to a direction of the image frame.
    pub fn nearest(&self, p_in_image: DVec3) -> Option<usize> {
        let (u, v) = self.sensor.project(p_in_image)?;
        let (u, v) = ((u / f64::from(self.stride[0])).round(), (v / f64::from(self.stride[1])).round());
        let at = (u >= 0.0 && v >= 0.0 && u < f64::from(self.columns))
            .then(|| (v as usize) * self.columns as usize + u as usize)?;
        (at < self.rays.len()).then_some(at)
    }

    /// Index and direction (world frame) of the rays from a pose of the image frame that may meet a ball.
    pub fn rays_at(
        &self,
        world_from_image: Pose,
        (middle, radius): (DVec3, f64),
    ) -> impl Iterator<Item = (usize, DVec3)> {
        let toward = world_from_image.inverse().transform_point(middle);
        let distance = toward.length();
        // The cosine of the ball's angular radius.
        let cone = (radius / distance.max(radius)).asin().cos();
        let rays = self.rays.iter().enumerate().filter(move |(_, ray)| ray.dot(toward) >= cone * distance);
        rays.map(move |(at, ray)| (at, world_from_image.rotation * *ray))
    }
}
