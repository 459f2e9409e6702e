//! The twist of the robot while a scan was measured, from the points of the scan itself.
//!
//! A point that was measured `l` seconds late moves by `l` times the twist's error, so the derivative of its residual
//! by the twist is `l J`. Pose and twist are estimated together: 12 numbers, solved by the Schur complement of the
//! pose. What the scan alone says of the twist is then the information `S M^-1 S`: S is that complement, M the
//! covariance of its gradient by noise, by the errors that residuals share, and by the pose's prior.

use super::normal::{CommonError, Freedom, GroupSum, Normal};
use crate::motion::Vector;
use presight_model::matrix::{Matrix, add_to, apply, inverse, product, restricted, sandwich, scaled, transposed, turn};

/// Covariances of the motion that was undone in a scan, in the robot's axes: metres and radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ScanError {
    /// Covariance of the mean twist, per second.
    pub twist: Matrix,
    /// Covariance of the acceleration, per square second.
    pub acceleration: Matrix,
}

/// Sums over residuals with weights w, derivatives J and times l.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LateSums {
    /// Sums of w l^k J J', k = 1, 2, 3.
    pub moments: [Matrix; 3],
    /// Sums of w^2 s^2 l^k J J', k = 1, 2, with s the standard deviation of the residual.
    pub noise: [Matrix; 2],
    /// Sum of w l J e.
    pub gradient: Vector,
}

impl LateSums {
    /// Adds a residual `e`; `own` is w^2 s^2, or 0 where no covariance is requested.
    #[inline(always)]
    pub(super) fn add_point(&mut self, (w, own, late): (f64, f64, f64), j: &Vector, e: f64) {
        let (w1, n1) = (w * late, own * late);
        for a in 0..6 {
            self.gradient[a] += w1 * j[a] * e;
            for b in a..6 {
                let (p, q) = (w1 * j[a] * j[b], n1 * j[a] * j[b]);
                self.moments[0][a][b] += p;
                self.moments[1][a][b] += late * p;
                self.moments[2][a][b] += late * late * p;
                self.noise[0][a][b] += q;
                self.noise[1][a][b] += late * q;
            }
        }
    }

    /// Adds the sums of other residuals.
    pub fn add(&mut self, other: &Self) {
        self.moments.iter_mut().zip(&other.moments).for_each(|(sum, m)| add_to(sum, m));
        self.noise.iter_mut().zip(&other.noise).for_each(|(sum, m)| add_to(sum, m));
        (0..6).for_each(|i| self.gradient[i] += other.gradient[i]);
    }

    /// Turns sums of upper triangles into other axes, as whole matrices.
    pub(super) fn turned(&self, t: &Matrix) -> Self {
        let whole = |m: &Matrix| -> Matrix {
            sandwich(t, &std::array::from_fn(|a| std::array::from_fn(|b| m[a.min(b)][a.max(b)])))
        };
        Self {
            moments: self.moments.each_ref().map(whole),
            noise: self.noise.each_ref().map(whole),
            gradient: apply(t, &self.gradient),
        }
    }

    /// What the residuals share by an error of the twist, and by one of its change.
    pub(super) fn groups(&self) -> [(CommonError, GroupSum); 2] {
        let [first, second, third] = &self.moments;
        let of =
            |pull: &Matrix, late_pull: &Matrix| GroupSum { pull: *pull, late_pull: *late_pull, ..GroupSum::default() };
        let acceleration = of(&scaled(second, 0.5), &scaled(third, 0.5));
        [(CommonError::Twist, of(first, second)), (CommonError::Acceleration, acceleration)]
    }
}

/// Gauss-Newton steps of the pose and of the twist.
pub(super) struct ScanStep {
    pub(super) pose: Vector,
    pub(super) twist: Vector,
}

/// A step of pose and twist. `pose_prior` has the information of the pose's prior and its gradient, `twist_prior` that
/// of the twist, whose correction so far is `twist`.
pub(super) fn step(
    normal: &Normal,
    pose_prior: (&Matrix, &Vector),
    (twist_prior, twist): (&Matrix, &Vector),
    freedom: Freedom,
) -> ScanStep {
    let axes = freedom.axes();
    let Reduced { known, gain, complement, gradient, of_pose } = reduced(normal, pose_prior, axes);
    let mut complement = complement;
    add_to(&mut complement, &restricted(twist_prior, axes));
    let pull = apply(twist_prior, twist);
    let gradient: Vector = std::array::from_fn(|i| gradient[i] + pull[i]);
    let twist = apply(&inverse(&complement, axes), &gradient).map(|x| -x);
    let (alone, by_twist) = (apply(&known, &of_pose), apply(&transposed(&gain), &twist));
    ScanStep { pose: std::array::from_fn(|i| -alone[i] - by_twist[i]), twist }
}

/// The equations of the twist without the pose.
struct Reduced {
    /// (H + P0^-1)^-1 of the pose.
    known: Matrix,
    /// What an error of the pose does to the gradient of the twist, times `known`.
    gain: Matrix,
    complement: Matrix,
    gradient: Vector,
    of_pose: Vector,
}

fn reduced(normal: &Normal, (prior, pull): (&Matrix, &Vector), axes: &[usize]) -> Reduced {
    let [cross, own, _] = &normal.late.moments;
    let mut information = restricted(&normal.information, axes);
    add_to(&mut information, &restricted(prior, axes));
    let known = inverse(&information, axes);
    let cross = restricted(cross, axes);
    let gain = product(&cross, &known);
    let mut complement = restricted(own, axes);
    add_to(&mut complement, &scaled(&product(&gain, &transposed(&cross)), -1.0));
    let of_pose: Vector = std::array::from_fn(|i| normal.gradient[i] + pull[i]);
    let through = apply(&gain, &of_pose);
    let gradient = std::array::from_fn(|i| if axes.contains(&i) { normal.late.gradient[i] - through[i] } else { 0.0 });
    Reduced { known, gain, complement, gradient, of_pose }
}

/// A scan's own measurement of the twist, relative to the motion it was deskewed by: an information matrix and its
/// product with the twist, in the robot's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ScanTwist {
    pub information: Matrix,
    pub pull: Vector,
}

impl ScanTwist {
    /// By the residuals at an estimate, whose twist has been corrected by `twist` so far, world axes.
    pub(super) fn of(
        normal: &Normal,
        (prior, pull): (&Matrix, &Vector),
        twist: &Vector,
        spread: f64,
        freedom: Freedom,
        shared: &impl Fn(CommonError) -> Matrix,
    ) -> Self {
        let axes = freedom.axes();
        let Reduced { gain, complement, gradient, .. } = reduced(normal, (prior, pull), axes);
        let [cross, own] = &normal.late.noise;
        let mut noise = restricted(own, axes);
        let through = product(&gain, &restricted(cross, axes));
        add_to(&mut noise, &scaled(&through, -1.0));
        add_to(&mut noise, &scaled(&transposed(&through), -1.0));
        add_to(&mut noise, &sandwich(&gain, &restricted(&normal.noise, axes)));
        let mut middle = scaled(&noise, spread * spread);
        add_to(&mut middle, &sandwich(&gain, &restricted(prior, axes)));
        for (error, sum) in normal.groups.iter().filter(|(error, _)| **error != CommonError::Twist) {
            let mut left = sum.late_pull;
            add_to(&mut left, &scaled(&product(&gain, &sum.pull), -1.0));
            add_to(&mut middle, &restricted(&sandwich(&left, &shared(*error)), axes));
        }
        let known = product(&complement, &inverse(&middle, axes));
        let information = product(&known, &complement);
        let (at, still) = (apply(&information, twist), apply(&known, &gradient));
        Self { information, pull: std::array::from_fn(|i| at[i] - still[i]) }
    }

    /// In the axes of a frame that is turned so against the present one.
    pub(super) fn in_axes(&self, present_from_other: &Matrix) -> Self {
        let t = transposed(present_from_other);
        Self { information: sandwich(&t, &self.information), pull: apply(&t, &self.pull) }
    }

    /// The measurement of the sum of this twist and another one.
    pub fn beyond(&self, twist: &Vector) -> Self {
        let more = apply(&self.information, twist);
        Self { information: self.information, pull: std::array::from_fn(|i| self.pull[i] + more[i]) }
    }

    /// The measurement in a unit of time that is `times` as long.
    pub fn per(&self, times: f64) -> Self {
        Self { information: scaled(&self.information, 1.0 / (times * times)), pull: self.pull.map(|x| x / times) }
    }

    /// The twist and its covariance, by the scan and by prior information.
    pub fn with(&self, information: &Matrix, pull: &Vector, freedom: Freedom) -> (Vector, Matrix) {
        let mut sum = self.information;
        add_to(&mut sum, information);
        let covariance = inverse(&sum, freedom.axes());
        (apply(&covariance, &std::array::from_fn(|i| self.pull[i] + pull[i])), covariance)
    }
}

/// A matrix in the robot's axes, turned into world axes.
pub(super) fn in_world(m: &Matrix, rotation: glam::DQuat) -> Matrix {
    sandwich(&turn(rotation), m)
}
