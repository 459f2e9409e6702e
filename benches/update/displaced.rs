//! A site whose objects all stand a little off their places. One drive teaches their poses, and another one judges
//! them.

use super::case::{Amounts, Case, Off};
use presight_localize::estimate::{EstimateOptions, Estimator, nees};
use presight_localize::simulate::displace;
use presight_model::change::Change;
use presight_model::environment::Environment;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::measured::Frame;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_update::{LearnOptions, Learner, RefinedPose};

/// How far every object is off, metres.
pub const OFF: f64 = 0.01;
/// A thousandth: objects are displaced, not turned; a covariance has no zeros where estimates divide.
const TURN: f64 = 1e-4;

/// Positions of a robot against the truth.
#[derive(Clone, Copy, Debug, Default)]
pub struct Judged {
    pub views: usize,
    squares: f64,
    nees: f64,
    axes: usize,
}

impl Judged {
    pub fn add(&mut self, other: &Self) {
        (self.views, self.axes) = (self.views + other.views, self.axes + other.axes);
        (self.squares, self.nees) = (self.squares + other.squares, self.nees + other.nees);
    }

    /// Root mean square of the error of the place, metres.
    pub fn rms(&self) -> f64 {
        (self.squares / self.views.max(1) as f64).sqrt()
    }

    /// Normalized estimation error squared, of one number of the pose.
    pub fn nees(&self) -> f64 {
        self.nees / self.axes.max(1) as f64
    }
}

/// The model states that objects may be 1 cm off along each axis by a third of its variance: together 1 cm.
fn stated(map: Environment, class: &str) -> World {
    let s = OFF / 3f64.sqrt();
    let names: Vec<String> = map.objects().iter().filter(|o| !o.is_deleted()).map(|o| o.name.clone()).collect();
    let mut world = World::new(map);
    let covariance = Some(PoseCovariance::from_sigmas([s, s, s, TURN, TURN, TURN]));
    let own = |object: String| Change::SetPoseCovariance { class: class.to_owned(), object, covariance };
    world.apply(Change::Group(names.into_iter().map(own).collect())).expect("sound covariances");
    world
}

/// Learns from a drive of a sensor with poses that are off as stated; returns the world with the poses that it taught,
/// and these poses.
pub fn learn(case: &Case, sensor: &Sensor, off: Off) -> (World, Vec<RefinedPose>) {
    let mut learner = Learner::new(LearnOptions::default()).expect("sound options");
    for (frame, pose, _) in &case.drive(sensor, off) {
        learner.observe_at(&case.map, &[frame], pose).expect("a view");
    }
    learner.end_drive();
    let findings = learner.findings(&case.map);
    let refined = learner.refined(case.map.environment(), &findings);
    let mut after = case.map.clone();
    for r in &refined {
        let (name, object, class) = (r.object.clone(), r.object.clone(), r.class.clone());
        let pose = Change::SetPose { name, world_from_object: r.world_from_object };
        let own = Change::SetPoseCovariance { class, object, covariance: Some(r.covariance) };
        after.apply(Change::Group(vec![pose, own])).expect("a sound pose");
    }
    (after, refined)
}

/// A map that states 1 cm, and the site that is displaced by as much.
pub fn case(map: Environment, sensor: &Sensor, views: usize, seed: u64) -> Case {
    let map = stated(map, &sensor.spec().class);
    let none = Amounts { removed: 0, moved: 0, added: 0, walkers: 0, views };
    let mut case = Case::new(Environment::clone(map.environment()), none, seed);
    displace(&mut case.site, OFF, seed).expect("a sound distance");
    case
}

/// Estimates the poses of frames in a world.
pub fn judge(world: &World, frames: &[(Frame, PoseEstimate, Pose)]) -> Judged {
    let mut judged = Judged::default();
    let Some((first, ..)) = frames.first() else { return judged };
    let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("a predictor");
    let mut estimator = Estimator::new(predictor, EstimateOptions::of(first.sensor()));
    for (frame, prior, truth) in frames {
        let found = estimator.estimate(world, &[frame], prior).expect("an estimate");
        if !found.is_determined() {
            continue;
        }
        let (squared, axes) = nees(&found.pose, &RobotPose::new(*truth));
        let off = found.pose.world_from_robot.translation.distance_squared(truth.translation);
        judged.add(&Judged { views: 1, squares: off, nees: squared, axes });
    }
    judged
}
