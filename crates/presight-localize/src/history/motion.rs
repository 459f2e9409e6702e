//! Kalman filter for position, speed and acceleration of one image point.

use glam::{DMat2, DVec2};

/// State of a moving image point: constant acceleration disturbed by white jerk. Units are pixels and seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PointMotion {
    pub position: DVec2,
    pub speed: DVec2,
    pub acceleration: DVec2,
    /// Covariances of position (p), speed (v) and acceleration (a), by pairs.
    pub pp: DMat2,
    pub pv: DMat2,
    pub pa: DMat2,
    pub vv: DMat2,
    pub va: DMat2,
    pub aa: DMat2,
}

pub(super) fn isotropic(variance: f64) -> DMat2 {
    DMat2::from_diagonal(DVec2::splat(variance))
}

fn symmetric(m: DMat2) -> DMat2 {
    (m + m.transpose()) * 0.5
}

impl PointMotion {
    /// A point at rest, with the given variances of its unknown speed and acceleration.
    pub fn new(position: DVec2, covariance: DMat2, speed_variance: f64, acceleration_variance: f64) -> Self {
        let zero = DMat2::ZERO;
        Self {
            position,
            speed: DVec2::ZERO,
            acceleration: DVec2::ZERO,
            pp: covariance,
            pv: zero,
            pa: zero,
            vv: isotropic(speed_variance),
            va: zero,
            aa: isotropic(acceleration_variance),
        }
    }

    /// Returns the state `interval` seconds later. `jerk` is a spectral density, pixels squared per s^5.
    pub fn propagated(&self, interval: f64, jerk: f64) -> Self {
        let mut moved = *self;
        moved.advance(interval, jerk);
        moved
    }

    /// Same as [`Self::propagated`], in place.
    pub fn advance(&mut self, interval: f64, jerk: f64) {
        let t = interval;
        let half = 0.5 * t * t;
        let twice = |m: DMat2| m + m.transpose();
        self.pp = self.pp
            + twice(self.pv) * t
            + twice(self.pa) * half
            + self.vv * (t * t)
            + twice(self.va) * (t * half)
            + self.aa * (half * half);
        self.pv =
            self.pv + (self.pa + self.vv) * t + self.va * (t * t) + self.va.transpose() * half + self.aa * (t * half);
        self.pa = self.pa + self.va * t + self.aa * half;
        self.vv = self.vv + twice(self.va) * t + self.aa * (t * t);
        self.va += self.aa * t;
        self.position = self.position + self.speed * t + self.acceleration * half;
        self.speed += self.acceleration * t;
        self.disturb(interval, jerk);
    }

    /// Adds the process noise of white jerk over `interval` seconds.
    fn disturb(&mut self, interval: f64, jerk: f64) {
        let t = interval;
        let (t2, t3) = (t * t, t * t * t);
        self.pp += isotropic(jerk * t2 * t3 / 20.0);
        self.pv += isotropic(jerk * t2 * t2 / 8.0);
        self.pa += isotropic(jerk * t3 / 6.0);
        self.vv += isotropic(jerk * t3 / 3.0);
        self.va += isotropic(jerk * t2 / 2.0);
        self.aa += isotropic(jerk * t);
    }

    /// Adds an unknown change of acceleration at the start of the interval that adds `variance` to the position.
    pub fn change_acceleration(&mut self, variance: f64, interval: f64) {
        if variance <= 0.0 || interval <= 0.0 {
            return;
        }
        // A change of acceleration a displaces the point by a t^2 / 2 and changes the speed by a t.
        let rate = 2.0 / interval;
        let rate_squared = rate / interval;
        self.pp += isotropic(variance);
        self.pv += isotropic(variance * rate);
        self.pa += isotropic(variance * rate_squared);
        self.vv += isotropic(variance * rate * rate);
        self.va += isotropic(variance * rate * rate_squared);
        self.aa += isotropic(variance * rate_squared * rate_squared);
    }

    /// Kalman update with an innovation (measured minus predicted position) and the covariance of the measurement.
    pub fn correct(&mut self, innovation: DVec2, covariance: DMat2) {
        let inverse = (self.pp + covariance).inverse();
        let gains = [self.pp, self.pv.transpose(), self.pa.transpose()].map(|m| m * inverse);
        self.position += gains[0] * innovation;
        self.speed += gains[1] * innovation;
        self.acceleration += gains[2] * innovation;
        let (pp, pv, pa) = (self.pp, self.pv, self.pa);
        self.pp = symmetric(pp - gains[0] * pp);
        self.pv = pv - gains[0] * pv;
        self.pa = pa - gains[0] * pa;
        self.vv = symmetric(self.vv - gains[1] * pv);
        self.va -= gains[1] * pa;
        self.aa = symmetric(self.aa - gains[2] * pa);
    }

    /// Adds an independent motion.
    pub fn add(&mut self, other: &Self) {
        self.position += other.position;
        self.speed += other.speed;
        self.acceleration += other.acceleration;
        self.pp += other.pp;
        self.pv += other.pv;
        self.pa += other.pa;
        self.vv += other.vv;
        self.va += other.va;
        self.aa += other.aa;
    }

    /// False after numerical overflow.
    pub fn is_finite(&self) -> bool {
        let vectors = self.position.is_finite() && self.speed.is_finite() && self.acceleration.is_finite();
        vectors && [self.pp, self.pv, self.pa, self.vv, self.va, self.aa].iter().all(DMat2::is_finite)
    }

    /// Returns true if the covariances of position, speed and acceleration are valid.
    #[cfg(test)]
    pub fn is_sound(&self) -> bool {
        let positive =
            |m: &DMat2| m.x_axis.x >= 0.0 && m.y_axis.y >= 0.0 && m.determinant() >= -1e-9 * m.x_axis.x * m.y_axis.y;
        self.is_finite() && [&self.pp, &self.vv, &self.aa].into_iter().all(positive)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;

    type Dense = [[f64; 6]; 6];

    fn times(a: &Dense, b: &Dense) -> Dense {
        std::array::from_fn(|i| std::array::from_fn(|j| (0..6).map(|k| a[i][k] * b[k][j]).sum()))
    }

    fn transposed(a: &Dense) -> Dense {
        std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
    }

    /// State and covariance in the textbook order: x and y of position, speed, acceleration.
    fn dense(m: &PointMotion) -> ([f64; 6], Dense) {
        let blocks = [[m.pp, m.pv, m.pa], [m.pv.transpose(), m.vv, m.va], [m.pa.transpose(), m.va.transpose(), m.aa]];
        let at = |i: usize, j: usize| blocks[i / 2][j / 2].col(j % 2)[i % 2];
        let state = [m.position.x, m.position.y, m.speed.x, m.speed.y, m.acceleration.x, m.acceleration.y];
        (state, std::array::from_fn(|i| std::array::from_fn(|j| at(i, j))))
    }

    fn close(a: &PointMotion, x: &[f64; 6], p: &Dense) {
        let (state, covariance) = dense(a);
        for i in 0..6 {
            assert!((state[i] - x[i]).abs() <= 1e-9 * x[i].abs().max(1.0), "{state:?} {x:?}");
            for j in 0..6 {
                let scale = (p[i][i] * p[j][j]).sqrt().max(1e-12);
                assert!((covariance[i][j] - p[i][j]).abs() <= 1e-9 * scale, "{i} {j}: {covariance:?} {p:?}");
            }
        }
    }

    /// Compares the block form with the textbook's Kalman filter in 6 x 6 matrices.
    #[test]
    fn blocks_are_the_textbooks_filter() {
        let mut random = SplitMix64(11);
        let mut motion = PointMotion::new(DVec2::new(100.0, 50.0), isotropic(4.0), 900.0, 400.0);
        let (mut x, mut p) = dense(&motion);
        for _ in 0..60 {
            let (t, jerk) = (0.02 + 0.1 * random.unit(), 1e4 * random.unit());
            let mut f: Dense = [[0.0; 6]; 6];
            let mut q: Dense = [[0.0; 6]; 6];
            for axis in 0..2 {
                let at = [axis, axis + 2, axis + 4];
                for i in 0..3 {
                    for j in i..3 {
                        f[at[i]][at[j]] = t.powi((j - i) as i32) / [1.0, 1.0, 2.0][j - i];
                    }
                    for j in 0..3 {
                        // Integral over s of the product of the responses to a unit of jerk after s seconds.
                        let [m, n] = [2 - i, 2 - j];
                        let factorial = |n: usize| [1.0, 1.0, 2.0][n];
                        q[at[i]][at[j]] =
                            jerk * t.powi((m + n + 1) as i32) / ((m + n + 1) as f64 * factorial(m) * factorial(n));
                    }
                }
            }
            let moved = std::array::from_fn(|i| (0..6).map(|k| f[i][k] * x[k]).sum());
            x = moved;
            p = times(&times(&f, &p), &transposed(&f));
            (0..6).for_each(|i| (0..6).for_each(|j| p[i][j] += q[i][j]));
            motion = motion.propagated(t, jerk);
            close(&motion, &x, &p);

            let (a, b) = (0.1 + random.unit(), 0.1 + random.unit());
            let r = DMat2::from_cols_array(&[a, 0.05, 0.05, b]);
            let innovation = DVec2::new(random.unit() - 0.5, random.unit() - 0.5);
            let s = DMat2::from_cols_array(&[p[0][0], p[1][0], p[0][1], p[1][1]]) + r;
            let inverse = s.inverse();
            let gain: [[f64; 2]; 6] = std::array::from_fn(|i| {
                std::array::from_fn(|j| p[i][0] * inverse.col(j)[0] + p[i][1] * inverse.col(j)[1])
            });
            x = std::array::from_fn(|i| x[i] + gain[i][0] * innovation.x + gain[i][1] * innovation.y);
            let rest: Dense =
                std::array::from_fn(|i| std::array::from_fn(|j| p[i][j] - gain[i][0] * p[0][j] - gain[i][1] * p[1][j]));
            p = rest;
            motion.correct(innovation, r);
            close(&motion, &x, &p);
            assert!(motion.is_sound());
        }
    }
}
