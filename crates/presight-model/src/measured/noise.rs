//! The noise of a measured range.

use crate::sensor::Sensor;

/// Standard deviations of a range measurement: `sigma + quadratic * range^2` along the ray, and `angle` across it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeNoise {
    /// Metres.
    pub sigma: f64,
    /// 1 / metre: the part that grows with the square of the range, as for triangulation.
    pub quadratic: f64,
    /// Radians.
    pub angle: f64,
}

/// Range noise of a sensor that states none, metres.
const UNSTATED_SIGMA: f64 = 0.01;

impl RangeNoise {
    /// The noise from the sensor's specification. A sensor without range noise gets 1 cm, because every weight is
    /// relative to a noise. Without a stated angle noise, it follows from the pixel noise, or is 0.
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

    /// Standard deviation of a range along the ray, metres.
    pub fn range_sigma(&self, range: f64) -> f64 {
        self.sigma + self.quadratic * range * range
    }

    /// Variance of the distance between a measured point and the surface that its ray meets at this cosine of
    /// incidence, square metres: the range error projected on the normal, plus the angle error projected on it.
    ///
    /// # Examples
    /// ```
    /// use presight::measured::RangeNoise;
    /// let noise = RangeNoise { sigma: 0.01, quadratic: 0.0, angle: 0.002 };
    /// assert!((noise.variance_along_normal(5.0, 1.0) - 1e-4).abs() < 1e-18); // head-on the angle has no say
    /// assert!((noise.variance_along_normal(5.0, 0.0) - 1e-4).abs() < 1e-18); // 5 m x 2 mrad across
    /// ```
    #[inline]
    pub fn variance_along_normal(&self, range: f64, cos_incidence: f64) -> f64 {
        let cos2 = cos_incidence * cos_incidence;
        let (along, across) = (self.range_sigma(range), range * self.angle);
        cos2 * along * along + (1.0 - cos2) * across * across
    }
}
