//! Lidars that turn while the robot drives: `cargo bench --bench localize -- scans [DRIVES] [SCENE,..] [CASE,..]
//! [SENSOR,..]`. The scans come from the test kit's own ray caster, 25 turns of 0.1 s a drive, up to 2 m/s and 1.5
//! rad/s with changing speed; the start is exact and stated to 5 cm and 2 degrees. Each row is the mean over the
//! drives. `-- turns [DRIVES]` counts how often a drive of scans measured at once is said to turn, and `-- turns learn`
//! shows the times that the localizer learns from 18 kinds of logs.

use super::single;
use cpu_time::ProcessTime;
use glam::DVec3;
use presight_localize::estimate::{EstimateOptions, Estimator, nees};
use presight_localize::localize::{LocalizeOptions, Localizer, Phase};
use presight_localize::verdict::Verdict;
use presight_model::geometry::{Pose, PoseEstimate, RobotPose};
use presight_model::measured::{Frame, ScanMotion};
use presight_model::sensor::{Angles, Geometry, RayTimes, Scanner, Sensor, SensorSpec, StampAt};
use presight_model::world::World;
use presight_testkit::caster::Caster;
use presight_testkit::data;
use presight_testkit::oracle::Oracle;
use presight_testkit::route::{Driving, Route};

/// Turns of a drive.
const TURNS: usize = 25;
/// Seconds of a route before its first frame: the robot drives already.
const BEFORE: f64 = 2.5;
/// The 99.99 % quantile of chi squared with six degrees of freedom.
const QUANTILE: f64 = 27.86;

/// The motion of the robot, and the motion and times that the log states.
#[derive(Clone, Copy, PartialEq)]
enum Case {
    Standing,
    StandingAlone,
    Told,
    Alone,
    Given,
    NotTold,
    Fast,
}

const CASES: [(&str, Case); 7] = [
    ("standing at each stamp", Case::Standing),
    ("standing, no odometry", Case::StandingAlone),
    ("driving, stated", Case::Told),
    ("driving, alone", Case::Alone),
    ("driving, motion given", Case::Given),
    ("driving, not stated", Case::NotTold),
    ("driving at 3 rad/s, stated", Case::Fast),
];

/// 64 x 512 rays or the preset, 1 m above the floor.
fn lidar(name: &str, times: RayTimes) -> Sensor {
    let mut spec = if name == "vlp-16" {
        presight_read::preset(name).expect("a preset").spec().clone()
    } else {
        let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 360.0 / 512.0, count: 512 };
        let elevation = Angles::Uniform { start_deg: 22.5, step_deg: -45.0 / 63.0, count: 64 };
        let geometry = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
        let mut spec = SensorSpec::new(name, "laser", geometry);
        (spec.range_max, spec.noise.range_sigma) = (60.0, 0.01);
        spec
    };
    spec.mount.translation = DVec3::new(0.1, 0.0, 1.0);
    Sensor::new(spec.with_times(times)).expect("a sensor")
}

/// Sums over the frames of drives.
#[derive(Default)]
struct Sums {
    nees: f64,
    squares: [f64; 2],
    told: [f64; 2],
    frames: f64,
}

impl Sums {
    fn add(&mut self, told: &PoseEstimate, truth: &Pose) {
        let (squared, axes) = nees(told, &RobotPose::new(*truth));
        let found = &told.world_from_robot;
        let turned = found.rotation.angle_between(truth.rotation).to_degrees();
        self.nees += squared / axes as f64;
        self.squares[0] += (found.translation - truth.translation).length_squared();
        self.squares[1] += turned * turned;
        self.told[0] += (0..3).map(|i| told.covariance[i][i]).sum::<f64>();
        self.told[1] += (3..6).map(|i| told.covariance[i][i]).sum::<f64>().to_degrees().to_degrees();
        self.frames += 1.0;
    }

    fn nees(&self) -> f64 {
        self.nees / self.frames
    }

    fn text(&self) -> String {
        let root = |x: f64| (x / self.frames).sqrt();
        let (mm, deg) = (1e3 * root(self.squares[0]), root(self.squares[1]));
        format!("{mm:.2} mm, {deg:.3} deg | {:.2} mm, {:.3} deg", 1e3 * root(self.told[0]), root(self.told[1]))
    }
}

/// One drive: its route, its caster's frames.
struct Drive<'a> {
    world: &'a World,
    route: Route,
    case: Case,
    sensor: Sensor,
    times: RayTimes,
}

impl<'a> Drive<'a> {
    fn new(world: &'a World, case: Case, lidar_name: &str, times: RayTimes, seed: u64) -> Self {
        let turn = if case == Case::Fast { 3.0 } else { 1.5 };
        let driving = Driving { seconds: BEFORE + 0.1 * TURNS as f64 + 1.0, speed: 2.0, turn };
        let bounds = world.environment().bounds();
        let oracle = Oracle::new(world.environment(), 0.5 * (bounds.min + bounds.max)).expect("something is there");
        let route = Route::wander(&oracle, &bounds, &driving, seed);
        let is_told = !matches!(case, Case::NotTold);
        let stated = if is_told { times.clone() } else { RayTimes::AtOnce };
        Self { world, route, case, sensor: lidar(lidar_name, stated), times }
    }

    fn frames(&self, seed: u64, period: f64, count: usize) -> Vec<(Frame, Pose)> {
        let mut caster = Caster::new(self.world.environment(), self.sensor.clone(), seed);
        caster.times = self.times.clone();
        if matches!(self.case, Case::StandingAlone | Case::Alone) {
            caster.slip = None;
        }
        let pose = |t: f64| self.route.at(t);
        let frame = |k: usize| {
            let time = BEFORE + period * k as f64;
            let frame = caster.frame(&pose, time, (k > 0).then_some(time - period));
            let at = |i: i32| f64::from(i) * 0.01;
            let course = || (-12..=12).map(|i| (at(i), pose(time).inverse() * pose(time + at(i)))).collect();
            let is_given = self.case == Case::Given;
            let frame =
                if is_given { frame.with_scan_motion(ScanMotion::path(course()).expect("a course")) } else { frame };
            (frame, pose(time))
        };
        (0..count).map(frame).collect()
    }

    fn localizer(&self) -> Localizer {
        let estimate = EstimateOptions::of(&self.sensor).with_learns_sigma(true);
        let prior = PoseEstimate::of_sigmas(RobotPose::new(self.route.at(BEFORE)), 0.05, 2f64.to_radians());
        Localizer::new(Estimator::new(single(), estimate), prior, LocalizeOptions::default())
    }
}

fn turning() -> RayTimes {
    RayTimes::turning(0.1, StampAt::First)
}

fn row(scene: &str, world: &World, (name, case): (&str, Case), lidar_name: &str, drives: u64) {
    let (mut first, mut rest) = ([(); 3].map(|_| Sums::default()), Sums::default());
    let (mut tracking, mut beyond, mut frames, mut milliseconds) = (0, 0, 0, Vec::new());
    let (mut confirmed, mut decided, mut notes) = (0usize, 0usize, 0);
    let times = if matches!(case, Case::Standing | Case::StandingAlone) { RayTimes::AtOnce } else { turning() };
    for seed in 1..=drives {
        let drive = Drive::new(world, case, lidar_name, times.clone(), seed);
        let mut robot = drive.localizer();
        for (k, (frame, truth)) in drive.frames(seed, 0.1, TURNS).iter().enumerate() {
            let before = ProcessTime::now();
            let step = robot.step(world, frame).expect("a step");
            milliseconds.push(1e3 * before.elapsed().as_secs_f64());
            first.get_mut(k).unwrap_or(&mut rest).add(&step.pose, truth);
            let is_tracking = step.phase == Phase::Tracking;
            let (squared, _) = nees(&step.pose, &RobotPose::new(*truth));
            (tracking, frames) = (tracking + usize::from(is_tracking), frames + 1);
            beyond += usize::from(is_tracking && squared > QUANTILE);
            if std::env::var_os("PRESIGHT_REASONS").is_some() {
                println!("  {seed} {k}: {}: {}; NEES {:.1}", step.phase.name(), step.reason, squared / 6.0);
            }
            if let Some(verdicts) = step.estimate.verdicts.first() {
                let counts = verdicts.counts();
                let of = |verdict: Verdict| counts[verdict as usize];
                confirmed += of(Verdict::Confirmed);
                decided += of(Verdict::Confirmed) + of(Verdict::Nearer) + of(Verdict::Farther);
            }
        }
        notes += robot.warnings().iter().filter(|line| line.contains("scans seem to take")).count();
    }
    milliseconds.sort_by(f64::total_cmp);
    let starts = first.each_ref().map(|sums| format!("{:.2}", sums.nees())).join(", ");
    println!(
        "| {scene} | {lidar_name} | {name} | {} | {starts} | {:.2} | {tracking} of {frames} | {beyond} | {:.1} % | {notes} | {:.0} |",
        rest.text(),
        rest.nees(),
        100.0 * confirmed as f64 / decided.max(1) as f64,
        milliseconds[milliseconds.len() / 2],
    );
}

/// Prints a row for each requested kind of drive.
pub fn all(words: &[String]) {
    let drives = words.first().map_or(4, |n| n.parse().expect("a number of drives"));
    let is_asked =
        |k: usize, name: &str| words.get(k).is_none_or(|a| a == "-" || a.split(',').any(|part| name.contains(part)));
    println!(
        "| scene | lidar | drive | RMS from frame 3 on | stated | NEES a number, frames 0, 1, 2 | from 3 on | tracking | beyond 99.99 % | confirmed | notes | CPU ms p50 |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
    );
    for scene in ["factory_hall", "hospital"].into_iter().filter(|scene| is_asked(1, scene)) {
        let Some(world) = data::scene(scene, true) else { continue };
        for lidar_name in ["64 x 512", "vlp-16"].into_iter().filter(|name| is_asked(3, name)) {
            for case in CASES.iter().filter(|(name, _)| is_asked(2, name)) {
                row(scene, &world, *case, lidar_name, drives);
            }
        }
    }
}

/// The times that the localizer learns where the log states none.
pub fn turns(words: &[String]) {
    let Some(world) = data::scene("factory_hall", true) else { return };
    if words.first().is_some_and(|word| word == "learn") {
        for (turn_s, stamp) in [0.05, 0.1, 0.2, -0.05, -0.1, -0.2]
            .into_iter()
            .flat_map(|turn_s| [StampAt::First, StampAt::Middle, StampAt::Last].map(|stamp| (turn_s, stamp)))
        {
            let times = RayTimes::turning(turn_s, stamp);
            let drive = Drive::new(&world, Case::NotTold, "64 x 512", times, 2);
            let period = f64::max(0.1, turn_s.abs());
            println!("{turn_s} s, {stamp:?}: {:?}", said(&drive, period, 23));
        }
        return;
    }
    let drives = words.first().map_or(100, |n| n.parse().expect("a number of drives"));
    let noted = (1..=drives).filter(|seed| {
        let drive = Drive::new(&world, Case::Standing, "64 x 512", RayTimes::AtOnce, *seed);
        let lines = said(&drive, 0.1, TURNS);
        lines.iter().any(|line| line.contains("scans seem to"))
    });
    println!("{} of {drives} drives of scans measured at once have a note", noted.count());
}

/// The warnings after a drive.
fn said(drive: &Drive<'_>, period: f64, count: usize) -> Vec<String> {
    let mut robot = drive.localizer();
    for (frame, _) in drive.frames(3, period, count) {
        robot.step(drive.world, &frame).expect("a step");
    }
    robot.warnings()
}
