//! Results of each consumer of scans.

use super::drive::{Scan, sensor_pose};
use presight_explore::{Exploration, ExploreOptions, Known, Views};
use presight_localize::verdict::{self, Verdict};
use presight_model::environment::Environment;
use presight_model::geometry::{Pose, PoseEstimate, RobotPose};
use presight_model::measured::Frame;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::virtual_sensors::Corridor;
use presight_supervise::{SuperviseOptions, Supervisor};
use presight_testkit::oracle::Oracle;

/// Deviations of the robot's pose: 2 mm and half a milliradian.
const KNOWN: (f64, f64) = (0.002, 5e-4);

/// A frame with the robot's pose at its stamp.
pub type At = (Frame, Pose);

/// The frames of scans.
pub fn frames(scans: &[Scan], of: impl Fn(&Scan) -> Frame) -> Vec<At> {
    scans.iter().map(|scan| (of(scan), scan.pose)).collect()
}

fn known(pose: &Pose) -> PoseEstimate {
    PoseEstimate::of_sigmas(RobotPose::new(*pose), KNOWN.0, KNOWN.1)
}

fn predictor() -> Predictor {
    Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("an engine")
}

/// Share of the decided pixels that confirm the model.
pub fn confirmed(world: &World, frames: &[At]) -> f64 {
    let mut predictor = predictor();
    let (mut confirmed, mut decided) = (0, 0);
    for (frame, pose) in frames {
        let verdicts = verdict::of_frame(&mut predictor, world, frame, &known(pose)).expect("verdicts");
        let counts = verdicts.counts();
        let count = |of: Verdict| counts[of as usize];
        confirmed += count(Verdict::Confirmed);
        decided += count(Verdict::Confirmed) + count(Verdict::Nearer) + count(Verdict::Farther);
    }
    confirmed as f64 / f64::from(u32::try_from(decided).expect("few pixels"))
}

/// The letters of the cells ahead of the robot, frame by frame.
pub fn supervised(world: &World, frames: &[At]) -> Vec<String> {
    let corners = vec![[0.5, -0.5], [3.5, -0.5], [3.5, 0.5], [0.5, 0.5]];
    let corridor = Corridor::polygon(corners, 0.2, 1.2).expect("a corridor");
    let mut supervisor = Supervisor::new(corridor, SuperviseOptions::default()).expect("options");
    let mut predictor = predictor();
    let mut letters = |(frame, pose): &At| {
        let report = supervisor.supervise(&mut predictor, world, &[frame], Some(&known(pose)));
        report.expect("a report").letters()
    };
    frames.iter().map(&mut letters).collect()
}

/// Share of the cells that differ.
pub fn differing(a: &[String], b: &[String]) -> f64 {
    let pairs = || a.iter().zip(b).flat_map(|(a, b)| a.chars().zip(b.chars()));
    pairs().filter(|(a, b)| a != b).count() as f64 / pairs().count().max(1) as f64
}

/// The model explored by frames.
pub fn explored(frames: &[At]) -> Environment {
    let mut views = Views::default();
    for (frame, pose) in frames {
        views.push(frame, sensor_pose(frame.sensor(), pose)).expect("a view");
    }
    let found = Exploration::of(&Environment::new(), Known::Explored, &views, &ExploreOptions::default());
    found.expect("an exploration").environment().clone()
}

/// Errors of predicted ranges.
#[derive(Clone, Copy, Debug)]
pub struct RangeErrors {
    /// Metres.
    pub median: f64,
    /// Share over 2 cm, with rays without a surface in the model.
    pub over_2_cm: f64,
    /// Share over 10 cm.
    pub over_10_cm: f64,
}

/// The errors of a model at poses of a sensor, along every third ray that meets something.
pub fn errors(real: &Environment, model: &Environment, sensor: &Sensor, poses: &[Pose]) -> RangeErrors {
    let origin = poses[0].translation;
    let truth = Oracle::seen_by(real, origin, "laser").expect("surfaces");
    let model = Oracle::new(model, origin).expect("explored surfaces");
    let mut off = Vec::new();
    for pose in poses {
        for i in (0..sensor.width() * sensor.height()).step_by(3) {
            let Some(ray) = sensor.ray(i % sensor.width(), i / sensor.width()) else { continue };
            let direction = pose.rotation * (sensor.body_from_image() * ray);
            let range = truth.distance(pose.translation, direction);
            if range < sensor.spec().range_max {
                off.push((model.distance(pose.translation, direction) - range).abs());
            }
        }
    }
    off.sort_by(f64::total_cmp);
    let over = |limit: f64| (off.len() - off.partition_point(|o| *o <= limit)) as f64 / off.len() as f64;
    RangeErrors { median: off[off.len() / 2], over_2_cm: over(0.02), over_10_cm: over(0.1) }
}

/// Number of findings of an update on the map that was measured, and the share of beams within 0.1 m of it.
#[cfg(feature = "store")]
pub fn found(world: &World, frames: &[At]) -> (usize, f64) {
    use presight_update::{LearnOptions, Learner};
    let mut learner = Learner::new(LearnOptions::default()).expect("options");
    for (frame, pose) in frames {
        learner.observe_at(world, &[frame], &known(pose)).expect("a view");
    }
    learner.end_drive();
    (learner.findings(world).changes.len(), learner.share_explained(world, 0.1))
}
