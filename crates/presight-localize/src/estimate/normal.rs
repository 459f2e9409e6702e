//! Normal equations: what a source of residuals says about a small motion of the robot.

use super::Kernel;
use super::deviation::SeenDeviation;
use super::scan_twist::LateSums;
use crate::motion::{NormalEquations, Vector};
use presight_model::matrix::{Matrix, add_to};
use std::collections::BTreeMap;

/// Errors that many residuals share: all surfaces of one object, or the polygons that lie about in one plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum CommonError {
    /// The error of an object's pose, by index; six numbers.
    Object(u32),
    /// The offset of polygons along their normal, by [`crate::verdict::Surface::group`]; one number.
    Offset(u32),
    /// How far an edge is beside where the model has it, by the number of the feature; one number.
    Edge(u32),
    /// How far a point or a fiducial is from where the model has it, by the number of the feature; three numbers, world axes.
    Place(u32),
    /// The error of the robot's mean twist during a scan; six numbers, metres and radians per second, world axes.
    Twist,
    /// The change of this twist; six numbers, metres and radians per square second, world axes.
    Acceleration,
}

/// What residuals e with weights w and Jacobians J say about a motion of the robot. The motion `(t, r)` takes a point x of the
/// world, seen from the robot at c, to `x + t + r cross (x - c)`; all are world axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Normal {
    /// Sum of w J J'.
    pub information: Matrix,
    /// Sum of w J e.
    pub gradient: Vector,
    /// Sum of w^2 s^2 J J', s the standard deviation of e: the part of the noise that is each residual's own.
    pub noise: Matrix,
    /// Sum of robust costs, in units of variances; a residual that is nothing like the prediction costs a constant.
    pub chi2: f64,
    /// Residuals that were looked at.
    pub measured: usize,
    /// Those with a prediction near enough to be compared.
    pub compared: usize,
    /// Those that the prediction explains.
    pub explained: usize,
    /// Median of |e| / s of those that were compared.
    pub spread: f64,
    /// What residuals of ranges say about the deviation of surfaces; only with the parts of a covariance.
    pub deviation: SeenDeviation,
    /// What residuals say of the twist during a scan.
    pub late: LateSums,
    /// What residuals with a shared error add up to.
    pub groups: BTreeMap<CommonError, GroupSum>,
}

/// Sums over the residuals that share one error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GroupSum {
    /// Sum of w J g', g the derivative of e by the shared error; columns past the error's own numbers are 0.
    pub pull: Matrix,
    /// Sum of w l J g', with l the seconds by which a point was measured late.
    pub late_pull: Matrix,
    /// Sum of w.
    pub weight: f64,
    /// Sum of w e, metres times weight.
    pub residual: f64,
    /// Sum of w^2 s^2.
    pub variance: f64,
}

impl GroupSum {
    /// Adds the sums of another part of the residuals.
    pub fn add(&mut self, other: &Self) {
        add_to(&mut self.pull, &other.pull);
        add_to(&mut self.late_pull, &other.late_pull);
        self.weight += other.weight;
        self.residual += other.residual;
        self.variance += other.variance;
    }
}

impl Normal {
    /// The normal equations alone.
    pub(super) fn equations(&self) -> NormalEquations {
        NormalEquations { information: self.information, gradient: self.gradient }
    }

    /// Adds a residual with its derivatives, both in standard deviations. `wide` is the gate in standard deviations. Returns the
    /// weight that it got.
    pub(super) fn add_residual(&mut self, e: f64, j: &Vector, wide: f64, kernel: Kernel) -> f64 {
        let (weight, cost) = kernel.weigh(e, wide);
        self.compared += 1;
        self.chi2 += cost;
        self.explained += usize::from(e.abs() <= super::range::EXPLAINED);
        for a in 0..6 {
            self.gradient[a] += weight * j[a] * e;
            for b in 0..6 {
                self.information[a][b] += weight * j[a] * j[b];
                self.noise[a][b] += weight * weight * j[a] * j[b];
            }
        }
        weight
    }

    /// Adds what another source says.
    pub fn add(&mut self, other: &Self) {
        add_to(&mut self.information, &other.information);
        add_to(&mut self.noise, &other.noise);
        (0..6).for_each(|i| self.gradient[i] += other.gradient[i]);
        self.chi2 += other.chi2;
        // The larger number of residuals decides what a typical one is.
        if other.compared > self.compared {
            self.spread = other.spread;
        }
        self.measured += other.measured;
        self.compared += other.compared;
        self.explained += other.explained;
        self.deviation.add(&other.deviation);
        self.late.add(&other.late);
        for (shared, sum) in &other.groups {
            self.groups.entry(*shared).or_default().add(sum);
        }
    }

    /// Share of the residuals that the prediction explains; 0 without any.
    pub fn explained_share(&self) -> f64 {
        self.explained as f64 / self.measured.max(1) as f64
    }
}

/// Which numbers of a pose are looked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Freedom {
    /// x, y and yaw: a robot on a level floor.
    Planar,
    /// All six.
    #[default]
    Full,
}

impl Freedom {
    /// Indices into a [`Vector`].
    pub fn axes(self) -> &'static [usize] {
        match self {
            Self::Planar => &[0, 1, 5],
            Self::Full => &[0, 1, 2, 3, 4, 5],
        }
    }
}
