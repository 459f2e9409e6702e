//! What an estimate tells.

use super::deviation::SeenDeviation;
use super::normal::{CommonError, Freedom, Normal};
use crate::extract::FeatureFindings;
use crate::verdict::Verdicts;
use presight_model::geometry::{InObject, Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{
    Matrix, add_to, directions, inverse, product, quadratic, restricted, sandwich, scaled, transposed,
};

/// Names of the six numbers of a motion.
const AXES: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];

/// Whether an estimate may be used.
#[derive(Clone, Debug, PartialEq)]
pub enum EstimateState {
    /// The measurement is explained, by one pose.
    Determined,
    /// It is not, for this reason; the pose is the best one found.
    Undetermined(String),
}

/// A pose that explains the measurement about as well as the best one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hypothesis {
    /// The robot's pose.
    pub pose: RobotPose,
    /// Share of the measured points that it explains.
    pub explained: f64,
    /// Robust cost, in variances a point.
    pub cost: f64,
}

/// A direction in which the measurement says less about the pose than was known before.
#[derive(Clone, Debug, PartialEq)]
pub struct WeakDirection {
    /// The numbers of the pose that take part, joined by `+`.
    pub name: String,
    /// Unit motion, x y z and rotations as lengths at the reach of the measurement.
    pub motion: [f64; 6],
    /// Standard deviation along it by the measurement alone, metres; infinite if it says nothing.
    pub sigma: f64,
}

/// The robot's pose, and what is known of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The pose; variances of numbers that were not estimated are 0.
    pub pose: PoseEstimate,
    /// Directions in which the measurement says little.
    pub weak: Vec<WeakDirection>,
    /// Verdicts on each frame of ranges; empty if no frame measured anything.
    pub verdicts: Vec<Verdicts>,
    /// What each grey image, and each scan with intensities, shows of predicted features.
    pub findings: Vec<FeatureFindings>,
    /// Reflectors that the pose explains, and those that were matched.
    pub reflectors: (usize, usize),
    /// Share of the measured points that the prediction explains.
    pub explained: f64,
    /// Robust cost, in variances a point.
    pub cost: f64,
    /// By how much residuals are wider than stated; at least 1.
    pub spread: f64,
    /// Standard deviation of each point of a surface, as stated or as learnt from the frames before, metres.
    pub model_sigma: f64,
    /// Standard deviation of the offsets of polygon groups that the covariance was made with, metres.
    pub offset_sigma: f64,
    /// All poses that explain the measurement about as well, the best first.
    pub hypotheses: Vec<Hypothesis>,
    /// Whether the estimate may be used.
    pub state: EstimateState,
    /// Full predictions that it took.
    pub predictions: usize,
    /// What the residuals say about the deviation of surfaces.
    pub deviation: SeenDeviation,
}

impl Estimate {
    /// True if the pose rests on reflectors, whatever the ranges explain: three at least agree, and more than two thirds of those matched.
    pub fn rests_on_reflectors(&self) -> bool {
        super::reflectors::hold(self.reflectors)
    }

    /// True if the estimate may be used.
    pub fn is_determined(&self) -> bool {
        self.state == EstimateState::Determined
    }

    /// The robot's pose in the frame of an object, and its covariance along the object's axes: what a robot that docks has to know.
    /// The object's own error is in it unless the estimate was made with [`super::EstimateOptions::only`].
    pub fn relative_to(&self, world_from_object: &Pose) -> (Pose, PoseCovariance<InObject>) {
        self.pose.in_object(world_from_object)
    }
}

/// Covariance of a solution with errors that residuals share.
///
/// `H^-1 (N + sum of A P A' + P0^-1) H^-1`: N is the residuals' own noise, A what a shared error pulls, P its covariance, P0 the
/// prior's. `shared` gives P of a shared error.
pub fn covariance(
    normal: &Normal,
    prior: Option<&Matrix>,
    freedom: Freedom,
    spread: f64,
    shared: &impl Fn(CommonError) -> Matrix,
) -> Matrix {
    let axes = freedom.axes();
    let mut information = restricted(&normal.information, axes);
    let mut middle = restricted(&middle_of(normal, spread, shared), axes);
    if let Some(prior) = prior {
        add_to(&mut information, &restricted(prior, axes));
        add_to(&mut middle, &restricted(prior, axes));
    }
    let bread = inverse(&information, axes);
    symmetric(&sandwich(&bread, &middle))
}

/// Noise and shared errors, as pulls on the gradient.
fn middle_of(normal: &Normal, spread: f64, shared: &impl Fn(CommonError) -> Matrix) -> Matrix {
    let mut middle = scaled(&normal.noise, spread * spread);
    for (error, sum) in &normal.groups {
        add_to(&mut middle, &product(&product(&sum.pull, &shared(*error)), &transposed(&sum.pull)));
    }
    middle
}

fn symmetric(m: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (m[i][j] + m[j][i])))
}

/// The directions in which the measurement alone is worse than the prior, or than `loosest` metres where there is no prior.
pub(crate) fn weak_directions(
    normal: &Normal,
    prior_covariance: Option<&Matrix>,
    freedom: Freedom,
    reach: f64,
    spread: f64,
    loosest: f64,
    shared: &impl Fn(CommonError) -> Matrix,
) -> Vec<WeakDirection> {
    let axes = freedom.axes();
    let middle = middle_of(normal, spread, shared);
    let found = directions(&normal.information, axes, reach);
    let most = found.iter().map(|(value, _)| *value).fold(0.0, f64::max);
    let weak = |(value, v): &(f64, [f64; 6])| {
        // As a motion: what is a length at reach is an angle again.
        let motion: [f64; 6] = std::array::from_fn(|i| if i >= 3 { v[i] / reach } else { v[i] });
        let known = *value > 1e-10 * most && most > 0.0;
        let sigma = if known { quadratic(&middle, &motion).max(0.0).sqrt() / value } else { f64::INFINITY };
        let limit = prior_covariance.map_or(loosest, |p| {
            let dual: [f64; 6] = std::array::from_fn(|i| if i >= 3 { v[i] * reach } else { v[i] });
            quadratic(p, &dual).max(0.0).sqrt().min(loosest)
        });
        let part: Vec<&str> = axes.iter().filter(|i| v[**i].abs() > 0.3).map(|i| AXES[*i]).collect();
        (sigma > limit).then(|| WeakDirection { name: part.join("+"), motion: *v, sigma })
    };
    found.iter().filter_map(weak).collect()
}
