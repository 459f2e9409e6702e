//! The part of the motion that all features share: the sensor turns, and shakes.
//!
//! A turning or shaking camera moves its whole image, nearly as an affine map. Each track alone would take frames to tell such
//! a motion from noise; all tracks together tell it at once and far better than any of them. The shared part is a filter of its
//! own for the three coefficients of an affine displacement field,
//!
//! ```text
//! d(x, y) = c0 + c1 (x - centre) / width + c2 (y - centre) / height
//! ```
//!
//! each a [`PointMotion`]; tracks follow what is left.

use super::motion::{PointMotion, isotropic};
use super::options::ImageExtent;
use glam::{DMat2, DVec2};

/// Frames over which the shaking is learnt.
const SHAKE_FRAMES: f64 = 30.0;
/// Squared deviations (of two coordinates) beyond which a coefficient's motion has changed: chi-squared, 1 in 3,000.
const CHANGED: f64 = 16.0;
/// What is left of a change's process noise a frame later.
const FADE: f64 = 0.03;
/// Variance of shaking at least, pixels squared.
const LEAST_SHAKE: f64 = 1e-4;
/// Residuals beyond so many standard deviations count less.
const OUTLIER: f64 = 2.0;

/// What one track's point tells about the field.
#[derive(Clone, Copy, Debug)]
pub(super) struct Witness {
    pub at: DVec2,
    /// Measured less predicted position.
    pub innovation: DVec2,
    /// Inverse of its covariance; 0 in directions that tell nothing.
    pub information: DMat2,
}

/// The shared motion and what is known of it.
#[derive(Clone, Debug)]
pub(super) struct CommonMotion {
    centre: DVec2,
    size: DVec2,
    coefficients: [PointMotion; 3],
    /// Variance of each coefficient from frame to frame that is no motion, pixels squared.
    shake: [f64; 3],
    /// Process noise after a change, pixels squared: of a position by one interval.
    changed: [f64; 3],
}

impl CommonMotion {
    pub fn new(image: &ImageExtent) -> Self {
        let size = DVec2::new(f64::from(image.width), f64::from(image.height));
        let still = PointMotion::new(DVec2::ZERO, DMat2::ZERO, 0.0, 0.0);
        Self { centre: (size - 1.0) / 2.0, size, coefficients: [still; 3], shake: [LEAST_SHAKE; 3], changed: [0.0; 3] }
    }

    fn basis(&self, p: DVec2) -> [f64; 3] {
        let d = (p - self.centre) / self.size;
        [1.0, d.x.clamp(-1.0, 1.0), d.y.clamp(-1.0, 1.0)]
    }

    /// The shared motion `interval` seconds later; its positions are displacements since the last frame.
    pub fn propagated(&self, interval: f64, usual: f64, memory: f64) -> Self {
        let mut moved = self.clone();
        if usual <= 0.0 {
            return moved;
        }
        for (j, c) in moved.coefficients.iter_mut().enumerate() {
            let jerk = (memory.powi(-6) * self.shake[j] + 20.0 * self.changed[j]) / usual.powi(5);
            *c = c.propagated(interval, jerk);
        }
        moved
    }

    /// Displacement at a place.
    pub fn displacement(&self, p: DVec2) -> DVec2 {
        let basis = self.basis(p);
        (0..3).map(|j| self.coefficients[j].position * basis[j]).sum()
    }

    /// Speed and acceleration at a place.
    pub fn speed(&self, p: DVec2) -> [DVec2; 2] {
        let basis = self.basis(p);
        let sum = |of: fn(&PointMotion) -> DVec2| (0..3).map(|j| of(&self.coefficients[j]) * basis[j]).sum();
        [sum(|c| c.speed), sum(|c| c.acceleration)]
    }

    /// Something unknown has displaced everything, with this variance (pixels squared) in `interval` seconds.
    pub fn disturb(&mut self, variance: f64, interval: f64) {
        self.coefficients[0].disturb(interval, 20.0 * variance / interval.powi(5));
        self.changed[0] = self.changed[0].max(variance);
    }

    /// Covariance of a detection's displacement at a place, shaking included.
    pub fn covariance(&self, p: DVec2) -> DMat2 {
        let basis = self.basis(p);
        (0..3).map(|j| (self.coefficients[j].pp + isotropic(self.shake[j])) * (basis[j] * basis[j])).sum()
    }

    /// Takes in what tracks tell after a frame of `interval` seconds, and tells by what field this frame's detections are displaced from
    /// where they were predicted, shaking included.
    pub fn correct(&mut self, witnesses: &[Witness], interval: f64) -> Field {
        let prior: [f64; 3] = std::array::from_fn(|j| {
            let c = self.coefficients[j].pp;
            0.5 * (c.x_axis.x + c.y_axis.y) + self.shake[j]
        });
        let mut field = Field { common: self.clone(), shift: [DVec2::ZERO; 3] };
        if witnesses.len() < 4 || interval <= 0.0 {
            return field;
        }
        // Where the motion has changed, what was expected says nothing: the witnesses alone are asked first.
        let wide = prior.map(|p| 1e4 * p);
        let (rough, _) = self.solve(witnesses, &wide, None);
        let (first, certain) = self.solve(witnesses, &wide, Some(&rough));
        let mut widened = prior;
        for j in 0..3 {
            let squared = first[j].length_squared();
            if squared > CHANGED * (prior[j] + certain[j]) {
                widened[j] = 0.5 * squared;
            }
        }
        let (shift, variances) = self.solve(witnesses, &widened, Some(&first));
        for j in 0..3 {
            // What the witnesses alone say of this coefficient.
            let told = 1.0 / (1.0 / variances[j] - 1.0 / widened[j]).max(1e-12);
            let seen = shift[j] * (told / variances[j]);
            self.learn(j, seen, told, prior[j], interval);
        }
        field.shift = shift;
        field
    }

    fn learn(&mut self, j: usize, seen: DVec2, told: f64, prior: f64, interval: f64) {
        let squared = seen.length_squared();
        self.changed[j] *= FADE;
        let c = &mut self.coefficients[j];
        if squared > CHANGED * (prior + told) {
            let excess = 0.5 * squared;
            c.disturb(interval, 20.0 * excess / interval.powi(5));
            self.changed[j] = self.changed[j].max(excess);
        } else {
            let step = (0.5 * squared - (prior - self.shake[j]) - told) / SHAKE_FRAMES;
            self.shake[j] = (self.shake[j] + step).max(LEAST_SHAKE);
        }
        c.correct(seen, isotropic(told + self.shake[j]));
    }

    /// Mean and variance of each coefficient by weighted least squares, each beside what was expected of it.
    fn solve(&self, witnesses: &[Witness], prior: &[f64; 3], before: Option<&[DVec2; 3]>) -> ([DVec2; 3], [f64; 3]) {
        let mut normal = [[0.0; 6]; 6];
        let mut right = [0.0; 6];
        for w in witnesses {
            let basis = self.basis(w.at);
            let mut information = w.information;
            if let Some(before) = before {
                let left = w.innovation - (0..3).map(|j| before[j] * basis[j]).sum::<DVec2>();
                let deviation = left.dot(information * left).max(0.0).sqrt();
                information *= (OUTLIER / deviation).min(1.0);
            }
            let pulled = information * w.innovation;
            for j in 0..3 {
                right[2 * j] += basis[j] * pulled.x;
                right[2 * j + 1] += basis[j] * pulled.y;
                for k in 0..=j {
                    let block = information * (basis[j] * basis[k]);
                    for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                        normal[2 * j + a][2 * k + b] += block.col(b)[a];
                    }
                }
            }
        }
        for j in 0..3 {
            normal[2 * j][2 * j] += 1.0 / prior[j];
            normal[2 * j + 1][2 * j + 1] += 1.0 / prior[j];
        }
        let (x, inverse) = solve_symmetric(&normal, &right);
        let at = |j: usize| DVec2::new(x[2 * j], x[2 * j + 1]);
        let variance = |j: usize| (0.5 * (inverse[2 * j] + inverse[2 * j + 1])).min(prior[j] * (1.0 - 1e-9));
        ([at(0), at(1), at(2)], [variance(0), variance(1), variance(2)])
    }

    /// Displacements count from here on.
    pub fn rebase(&mut self) {
        self.coefficients.iter_mut().for_each(|c| c.position = DVec2::ZERO);
    }
}

/// The displacement of one frame's detections.
#[derive(Clone, Debug)]
pub(super) struct Field {
    common: CommonMotion,
    shift: [DVec2; 3],
}

impl Field {
    pub fn at(&self, p: DVec2) -> DVec2 {
        let basis = self.common.basis(p);
        (0..3).map(|j| self.shift[j] * basis[j]).sum()
    }
}

/// x of A x = b, and the diagonal of A's inverse, by Cholesky; the lower half of A counts, which is positive definite.
fn solve_symmetric(a: &[[f64; 6]; 6], b: &[f64; 6]) -> ([f64; 6], [f64; 6]) {
    let mut l = [[0.0; 6]; 6];
    for i in 0..6 {
        for j in 0..=i {
            let rest = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = if i == j { rest.max(1e-300).sqrt() } else { rest / l[j][j] };
        }
    }
    let solve = |b: &[f64; 6]| {
        let mut y = *b;
        for i in 0..6 {
            y[i] = (y[i] - (0..i).map(|k| l[i][k] * y[k]).sum::<f64>()) / l[i][i];
        }
        for i in (0..6).rev() {
            y[i] = (y[i] - (i + 1..6).map(|k| l[k][i] * y[k]).sum::<f64>()) / l[i][i];
        }
        y
    };
    let unit = |i: usize| std::array::from_fn(|j| f64::from(u8::from(i == j)));
    (solve(b), std::array::from_fn(|i| solve(&unit(i))[i]))
}
