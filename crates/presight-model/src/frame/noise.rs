//! The noise of a measured range.

use crate::sensor::Sensor;

/// Standard deviations of one range measurement: `sigma + quadratic * range^2` along the ray, and `angle` across it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeNoise {
    /// Metres.
    pub sigma: f64,
    /// Per metre: the part that grows with the square of the range, as triangulation does.
    pub quadratic: f64,
    /// Radians.
    pub angle: f64,
}

/// What a sensor that states no noise is taken to have, metres.
const UNSTATED_SIGMA: f64 = 0.01;

impl RangeNoise {
    /// As the sensor's specification states it. A sensor that states no range noise is taken to have 1 cm: exact measurements
    /// do not exist, and every weight is relative to a noise. Where no noise of angles is stated it is that of its pixels, or 0.
    pub fn of(sensor: &Sensor) -> Self {
        let spec = sensor.spec();
        let noise = spec.noise;
        let is_stated = noise.range_sigma > 0.0 || noise.range_sigma_quadratic > 0.0;
        let of_pixels = match &spec.geometry {
            crate::Geometry::Camera(camera) => noise.pixel_sigma / camera.fx.min(camera.fy),
            _ => 0.0,
        };
        Self {
            sigma: if is_stated { noise.range_sigma } else { UNSTATED_SIGMA },
            quadratic: noise.range_sigma_quadratic,
            angle: if noise.angle_sigma > 0.0 { noise.angle_sigma } else { of_pixels },
        }
    }

    /// Of a range, along the ray, metres.
    pub fn range_sigma(&self, range: f64) -> f64 {
        self.sigma + self.quadratic * range * range
    }

    /// Variance of the distance of a measured point from a surface that its ray meets at this cosine, square metres: the range's
    /// part along the normal and the angle's part along it.
    ///
    /// # Examples
    /// ```
    /// use presight::frame::RangeNoise;
    /// let noise = RangeNoise { sigma: 0.01, quadratic: 0.0, angle: 0.002 };
    /// assert!((noise.variance_along_normal(5.0, 1.0) - 1e-4).abs() < 1e-18); // head-on the angle has no say
    /// assert!((noise.variance_along_normal(5.0, 0.0) - 1e-4).abs() < 1e-18); // 5 m x 2 mrad across
    /// ```
    pub fn variance_along_normal(&self, range: f64, cos_incidence: f64) -> f64 {
        let cos2 = cos_incidence * cos_incidence;
        let (along, across) = (self.range_sigma(range), range * self.angle);
        cos2 * along * along + (1.0 - cos2) * across * across
    }
}
