//! CPU time of learning and CPU time of localizing, on one log: `cargo bench --bench update -- live`. Ten frames a
//! second at 1 m/s through a changed hall.

use super::case::Case;
use super::{AMOUNTS, scene, sensors};
use cpu_time::ProcessTime;
use presight_localize::estimate::{EstimateOptions, Estimator, Freedom};
use presight_localize::localize::{LocalizeOptions, Localizer, Phase};
use presight_model::geometry::{PoseEstimate, RobotPose};
use presight_predict::predict::{Backend, Options, Predictor};
use presight_testkit::caster::Caster;
use presight_update::{LearnOptions, Learner};

/// Seconds between frames, and their number.
const STEP: f64 = 0.1;
const FRAMES: usize = 400;

/// Prints a row for each sensor.
pub fn run() {
    println!(
        "| sensor | frames tracked | views | localizing, CPU ms a frame | learning | share |\n|---|---|---|---|---|---|"
    );
    let Some(environment) = scene("factory_hall") else { return };
    let case = Case::new(environment, AMOUNTS, 1);
    for (name, sensor) in sensors() {
        let mut caster = Caster::new(case.site.environment(), sensor.clone(), 1);
        let pose = |time: f64| case.route.at(time);
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("a predictor");
        let options = EstimateOptions::of(&sensor);
        let options = if sensor.height() == 1 { options.with_freedom(Freedom::Planar) } else { options };
        let start = PoseEstimate::of_sigmas(RobotPose::new(pose(0.0)), 0.05, 2f64.to_radians());
        let mut robot = Localizer::new(Estimator::new(predictor, options), start, LocalizeOptions::default());
        let mut learner = Learner::new(LearnOptions::default()).expect("sound options");
        let (mut localizing, mut learning, mut tracked) = (0.0, 0.0, 0);
        for k in 0..FRAMES {
            let time = STEP * k as f64;
            let frame = caster.frame(&pose, time, (k > 0).then_some(time - STEP));
            let before = ProcessTime::now();
            let step = robot.step(&case.map, &frame).expect("a step");
            localizing += before.elapsed().as_secs_f64();
            tracked += usize::from(step.phase == Phase::Tracking);
            let before = ProcessTime::now();
            learner.observe(&case.map, &step, &[&frame]).expect("a view");
            learning += before.elapsed().as_secs_f64();
        }
        let ms = |seconds: f64| 1e3 * seconds / FRAMES as f64;
        println!(
            "| {name} | {tracked} of {FRAMES} | {} | {:.1} | {:.1} | {:.0} % |",
            learner.tally().views,
            ms(localizing),
            ms(learning),
            100.0 * learning / localizing
        );
    }
}
