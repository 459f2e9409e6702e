//! Kalman filter for the position and speed of one image point.

use glam::{DMat2, DVec2};

/// State of an image point whose speed an unknown acceleration changes between frames. Units are pixels and seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PointFilter {
    pub position: DVec2,
    pub speed: DVec2,
    /// Covariance of the position, of position and speed, and of the speed.
    pub position_covariance: DMat2,
    cross_covariance: DMat2,
    speed_covariance: DMat2,
}

fn isotropic(variance: f64) -> DMat2 {
    DMat2::from_diagonal(DVec2::splat(variance))
}

fn symmetric(m: DMat2) -> DMat2 {
    (m + m.transpose()) * 0.5
}

impl PointFilter {
    /// A point whose speed is 0 with the given standard deviation.
    pub fn new(position: DVec2, covariance: DMat2, speed_sigma: f64) -> Self {
        Self {
            position,
            speed: DVec2::ZERO,
            position_covariance: covariance,
            cross_covariance: DMat2::ZERO,
            speed_covariance: isotropic(speed_sigma * speed_sigma),
        }
    }

    /// Predicts the state `interval` seconds later. A constant unknown acceleration acts over the interval, with the
    /// standard deviation `acceleration_sigma` along each axis.
    pub fn advance(&mut self, interval: f64, acceleration_sigma: f64) {
        let t = interval;
        let cross = self.cross_covariance;
        // An acceleration a displaces the point by a t^2 / 2 and changes its speed by a t.
        let [shift, change] = [0.5 * t * t * acceleration_sigma, t * acceleration_sigma];
        self.position_covariance +=
            (cross + cross.transpose()) * t + self.speed_covariance * (t * t) + isotropic(shift * shift);
        self.cross_covariance += self.speed_covariance * t + isotropic(shift * change);
        self.speed_covariance += isotropic(change * change);
        self.position += self.speed * t;
    }

    /// Corrects the state by a measured position with its covariance.
    pub fn correct(&mut self, measured: DVec2, covariance: DMat2) {
        let (pp, pv) = (self.position_covariance, self.cross_covariance);
        let inverse = (pp + covariance).inverse();
        let [gain, speed_gain] = [pp * inverse, pv.transpose() * inverse];
        let innovation = measured - self.position;
        self.position += gain * innovation;
        self.speed += speed_gain * innovation;
        self.position_covariance = symmetric(pp - gain * pp);
        self.cross_covariance = pv - gain * pv;
        self.speed_covariance = symmetric(self.speed_covariance - speed_gain * pv);
    }

    /// False after numerical overflow.
    pub fn is_finite(&self) -> bool {
        let covariances = [self.position_covariance, self.cross_covariance, self.speed_covariance];
        self.position.is_finite() && self.speed.is_finite() && covariances.iter().all(DMat2::is_finite)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;

    type Dense = [[f64; 4]; 4];

    fn times(a: &Dense, b: &Dense) -> Dense {
        std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
    }

    /// State and covariance in the textbook order: x and y of position, then of speed.
    fn dense(f: &PointFilter) -> ([f64; 4], Dense) {
        let blocks =
            [[f.position_covariance, f.cross_covariance], [f.cross_covariance.transpose(), f.speed_covariance]];
        let at = |i: usize, j: usize| blocks[i / 2][j / 2].col(j % 2)[i % 2];
        let state = [f.position.x, f.position.y, f.speed.x, f.speed.y];
        (state, std::array::from_fn(|i| std::array::from_fn(|j| at(i, j))))
    }

    /// Compares the block form with the textbook's Kalman filter in 4 x 4 matrices.
    #[test]
    fn blocks_are_the_textbooks_filter() {
        let mut random = SplitMix64(11);
        let mut filter = PointFilter::new(DVec2::new(100.0, 50.0), isotropic(4.0), 30.0);
        let (mut x, mut p) = dense(&filter);
        for _ in 0..60 {
            let (t, sigma) = (0.02 + 0.1 * random.unit(), 100.0 * random.unit());
            let mut f: Dense = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
            (f[0][2], f[1][3]) = (t, t);
            let g = [0.5 * t * t, 0.5 * t * t, t, t];
            let transposed: Dense = std::array::from_fn(|i| std::array::from_fn(|j| f[j][i]));
            x = std::array::from_fn(|i| (0..4).map(|k| f[i][k] * x[k]).sum());
            p = times(&times(&f, &p), &transposed);
            for i in 0..4 {
                (i % 2..4).step_by(2).for_each(|j| p[i][j] += sigma * sigma * g[i] * g[j]);
            }
            filter.advance(t, sigma);

            let r = DMat2::from_cols_array(&[0.1 + random.unit(), 0.05, 0.05, 0.1 + random.unit()]);
            let innovation = DVec2::new(random.unit() - 0.5, random.unit() - 0.5);
            let inverse = (DMat2::from_cols_array(&[p[0][0], p[1][0], p[0][1], p[1][1]]) + r).inverse();
            let gain: [DVec2; 4] = std::array::from_fn(|i| inverse.transpose() * DVec2::new(p[i][0], p[i][1]));
            x = std::array::from_fn(|i| x[i] + gain[i].dot(innovation));
            p = std::array::from_fn(|i| std::array::from_fn(|j| p[i][j] - gain[i].x * p[0][j] - gain[i].y * p[1][j]));
            filter.correct(filter.position + innovation, r);

            let (state, covariance) = dense(&filter);
            for i in 0..4 {
                assert!((state[i] - x[i]).abs() <= 1e-9 * x[i].abs().max(1.0), "{state:?} {x:?}");
                for j in 0..4 {
                    let scale = (p[i][i] * p[j][j]).sqrt();
                    assert!((covariance[i][j] - p[i][j]).abs() <= 1e-9 * scale, "{i} {j}: {covariance:?} {p:?}");
                }
            }
        }
    }
}
