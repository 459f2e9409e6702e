//! Simulated drives through the factory hall: how often a correctly localized robot is reported as lost, how large its
//! errors are, and how much more exact sensor models improve the estimate.

use super::{map, predictor, single};
use cpu_time::ProcessTime;
use glam::DVec3;
use presight_localize::estimate::{
    Estimate, EstimateOptions, Estimator, Freedom, measured_points, motion_between, moved, nees,
};
use presight_localize::localize::{ErrorRates, LocalizeOptions, Localizer, Phase, Step};
use presight_localize::simulate::{Disturbances, Simulator};
use presight_model::geometry::{Pose, PoseEstimate, RobotPose};
use presight_model::measured::{Frame, Measurement};
use presight_model::sensor::{Camera, Distortion, Geometry, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::free_poses::free_poses;
use presight_read::preset;
use presight_testkit::{Random, data};
use std::sync::atomic::{AtomicU64, Ordering};

/// Frames of one drive.
const FRAMES: usize = 200;

pub fn hall() -> Option<World> {
    Some(map(&data::file("env/factory_hall.glb")?))
}

pub fn laser() -> Sensor {
    with_sigma("laser-range-camera", 0.01)
}

fn with_sigma(name: &str, range_sigma: f64) -> Sensor {
    let mut spec = preset(name).expect("a preset").spec().clone();
    spec.noise.range_sigma = range_sigma;
    Sensor::new(spec).expect("a sensor")
}

/// Level poses on a circle of 1/8 m radius through a place. The circle stays within the free space around the place.
fn on_the_way(place: &Pose, k: usize) -> Pose {
    let (yaw, a) = (place.rotation.to_euler(glam::EulerRot::ZYX).0, 0.1 * k as f64);
    let aside = DVec3::new(0.125 * a.cos() - 0.125, 0.125 * a.sin(), 0.0);
    Pose::from_xyz_rpy(place.translation + aside, 0.0, 0.0, yaw + 0.5 * (0.35 * a).sin())
}

/// The upper limit of the event rate per frame, one-sided, 95 %: the mean of the Poisson distribution that gives at
/// most the counted events with a probability of 5 %.
fn upper_bound(events: u64, frames: u64) -> f64 {
    let at_most = |mean: f64| {
        let mut term = (-mean).exp();
        let mut sum = term;
        for k in 1..=events {
            term *= mean / k as f64;
            sum += term;
        }
        sum
    };
    let (mut low, mut high) = (0.0, 10.0 + 4.0 * events as f64);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if at_most(middle) > 0.05 { low = middle } else { high = middle }
    }
    high / frames as f64
}

/// Drives with 361 beams and odometry from many places, for at least this many frames. Counts how often the robot is
/// reported as lost, with a stated rate of robots that are carried away.
pub fn alarms(least: u64, rate: f64) {
    let Some(world) = hall() else { return };
    let scanner = with_sigma("laser-scanner", 0.02);
    let count = least.div_ceil(FRAMES as u64) as usize;
    let places = free_poses(&world, count, 17).expect("free poses");
    let (frames, lost, next) = (AtomicU64::new(0), AtomicU64::new(0), AtomicU64::new(0));
    let rates = ErrorRates { carried_away: rate, ..ErrorRates::default() };
    let options = LocalizeOptions::default().with_rates(rates);
    let drive = |seed: u64, place: &Pose| {
        let mut simulator =
            Simulator::new(single(), scanner.clone(), Disturbances::default(), seed).expect("a simulator");
        let planar = EstimateOptions::planar().with_model_sigma(0.01);
        let prior = PoseEstimate::of_sigmas(RobotPose::new(on_the_way(place, 0)), 0.03, 0.02);
        let mut robot = Localizer::new(Estimator::new(single(), planar), prior, options);
        for k in 0..FRAMES {
            let frame = simulator.frame(&world, k as f64, &RobotPose::new(on_the_way(place, k))).expect("a frame");
            let step = robot.step(&world, &frame).expect("a step");
            frames.fetch_add(1, Ordering::Relaxed);
            if step.phase == Phase::Lost {
                lost.fetch_add(1, Ordering::Relaxed);
                println!("place {seed}, frame {k}: {}", step.reason);
                return;
            }
        }
    };
    std::thread::scope(|scope| {
        let work = || {
            while let i = next.fetch_add(1, Ordering::Relaxed)
                && let Some(place) = places.get(i as usize)
            {
                drive(i, place);
            }
        };
        (0..2).for_each(|_| drop(scope.spawn(work)));
    });
    let (frames, lost) = (frames.into_inner(), lost.into_inner());
    println!(
        "{lost} false alarms in {frames} frames of {count} drives: at most 1 in {:.0} frames (95 %; aim: 1 in 30000)",
        1.0 / upper_bound(lost, frames)
    );
}

/// The errors over a drive.
#[derive(Default)]
struct Errors {
    squares: [f64; 2],
    nees: Vec<(f64, usize)>,
    cpu_ms: f64,
    undetermined: usize,
}

impl Errors {
    fn add(&mut self, found: &Estimate, truth: &Pose) {
        let off = motion_between(&found.pose.world_from_robot, truth);
        self.undetermined += usize::from(!found.is_determined());
        self.squares[0] += off[..3].iter().map(|x| x * x).sum::<f64>();
        self.squares[1] += off[5].to_degrees().powi(2);
        self.nees.push(nees(&found.pose, &RobotPose::new(*truth)));
    }

    fn row(&self, name: &str) {
        let n = self.nees.len() as f64;
        let [metres, degrees] = self.squares.map(|s| (s / n).sqrt());
        let (sum, numbers) = self.nees.iter().fold((0.0, 0), |(s, k), (e, m)| (s + e, k + m));
        // A sum of squares of `numbers` standard normal variables, which is about Gaussian.
        let half = 1.96 * (2.0 / numbers as f64).sqrt();
        let worst = self.nees.iter().map(|(e, m)| e / *m as f64).fold(0.0, f64::max);
        println!(
            "| {name} | {:.2} | {:.4} | {:.2} ({:.2} to {:.2}) | {worst:.1} | {} | {:.2} |",
            1e3 * metres,
            degrees,
            sum / numbers as f64,
            1.0 - half,
            1.0 + half,
            self.undetermined,
            self.cpu_ms / n
        );
    }
}

const HEAD: &str = "| | position RMS mm | heading RMS deg | NEES a number (95 % bounds) | worst frame | undetermined | CPU ms a frame |\n|---|---|---|---|---|---|---|";

/// The halls of the drives, each with a level pose at a robot's height.
fn halls() -> Vec<(&'static str, World, Pose)> {
    #[cfg(feature = "script")]
    let factory = {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/factory.rhai");
        let loaded = presight_read::script::load(path, &Default::default(), &mut |_| {}).expect("the scene loads");
        Some(("scenes/factory.rhai", World::new(loaded.environment)))
    };
    #[cfg(not(feature = "script"))]
    let factory = None;
    let worlds = hall().map(|world| ("factory_hall", world)).into_iter().chain(factory);
    let with_place = |(name, world): (&'static str, World)| {
        let places = free_poses(&world, 60, 11).expect("free poses");
        let floor = world.environment().bounds().min.z;
        let low = |place: &&Pose| (0.8..2.5).contains(&(place.translation.z - floor));
        let place = *places.iter().step_by(2).find(low).expect("a place at a robot's height");
        (name, world, place)
    };
    worlds.into_iter().map(with_place).collect()
}

/// Frames of one drive by radar scan, by laser range camera, and by both. The prior of each has errors of its stated
/// size.
pub fn accuracy(frames: usize) {
    for (hall, world, place) in halls() {
        println!("{frames} frames in {hall}, exact map, around {:.1}\n{HEAD}", place.translation);
        let radar = with_sigma("microwave-radar-scan", 0.03);
        for (name, sensors) in [
            ("radar scan", vec![radar.clone()]),
            ("laser range camera", vec![laser()]),
            ("both together", vec![radar, laser()]),
        ] {
            drive(&world, &place, sensors, frames).row(name);
        }
    }
}

fn drive(world: &World, place: &Pose, sensors: Vec<Sensor>, frames: usize) -> Errors {
    let is_row = sensors.iter().all(|s| s.height() == 1);
    let simulator =
        |s: &Sensor| Simulator::new(predictor(), s.clone(), Disturbances::default(), 3).expect("a simulator");
    let mut simulators: Vec<Simulator> = sensors.iter().map(simulator).collect();
    let options = if is_row {
        EstimateOptions::planar().with_model_sigma(0.0).with_offset_sigma(0.003)
    } else {
        EstimateOptions::default()
    };
    let mut estimator = Estimator::new(single(), options);
    let (mut random, mut errors) = (Random(7), Errors::default());
    for k in 0..frames {
        let truth = on_the_way(place, k);
        let seen: Vec<Frame> =
            simulators.iter_mut().map(|s| s.frame(world, k as f64, &RobotPose::new(truth)).expect("a frame")).collect();
        let all: Vec<&Frame> = seen.iter().collect();
        let prior = drawn_around(&truth, (0.02, 0.01), options.freedom, &mut random);
        let start = ProcessTime::now();
        let found = estimator.estimate(world, &all, &prior).expect("an estimate");
        errors.cpu_ms += 1e3 * start.elapsed().as_secs_f64();
        errors.add(&found, &truth);
    }
    errors
}

/// A prior with these deviations, in metres and radians, and with random errors of that size. A prior better than it
/// states would also make the estimate better than it states.
fn drawn_around(truth: &Pose, (metres, radians): (f64, f64), freedom: Freedom, random: &mut Random) -> PoseEstimate {
    let mut off = [0.0; 6];
    for axis in freedom.axes() {
        // The Box-Muller transform.
        let radius = (-2.0 * random.uniform(1e-300, 1.0).ln()).sqrt();
        let normal = radius * random.uniform(0.0, std::f64::consts::TAU).cos();
        off[*axis] = normal * if *axis < 3 { metres } else { radians };
    }
    PoseEstimate::of_sigmas(RobotPose::new(moved(truth, &off)), metres, radians)
}

/// A depth camera with lens distortion, noise that grows with the square of the range, and angular noise.
fn depth_camera() -> SensorSpec {
    let distorted = Distortion::PlumbBob([-0.12, 0.03, 0.0, 0.0, 0.0]);
    let camera = Camera { distortion: distorted, ..Camera::pinhole(160, 120, 130.0, 130.0, 79.5, 59.5) };
    let mut spec = SensorSpec::new("depth camera", "laser", Geometry::Camera(camera));
    spec.range_max = 10.0;
    (spec.noise.range_sigma, spec.noise.range_sigma_quadratic, spec.noise.angle_sigma) = (0.004, 0.002, 0.002);
    spec
}

/// That camera around six places, among objects closer together than its noise, with an exact sensor model. The prior
/// of each frame has errors of its stated size.
pub fn noise(frames: usize) {
    let Some(world) = hall() else { return };
    let sensor = Sensor::new(depth_camera()).expect("a camera");
    println!("{frames} frames of a noisy depth camera around each of six places of the factory hall\n{HEAD}");
    let mut all = Errors::default();
    for place in free_poses(&world, 6, 11).expect("free poses") {
        let mut simulator =
            Simulator::new(predictor(), sensor.clone(), Disturbances::default(), 5).expect("a simulator");
        let mut estimator = Estimator::new(predictor(), EstimateOptions::default());
        let (mut random, mut errors) = (Random(7), Errors::default());
        for k in 0..frames {
            let truth = on_the_way(&place, k);
            let frame = simulator.frame(&world, k as f64, &RobotPose::new(truth)).expect("a frame");
            let prior = drawn_around(&truth, (0.02, 0.01), Freedom::Full, &mut random);
            let start = ProcessTime::now();
            let found = estimator.estimate(&world, &[&frame], &prior).expect("an estimate");
            let cpu_ms = 1e3 * start.elapsed().as_secs_f64();
            for errors in [&mut errors, &mut all] {
                errors.cpu_ms += cpu_ms;
                errors.add(&found, &truth);
            }
        }
        errors.row(&format!("{:.1}", place.translation));
    }
    all.row("all");
}

/// The value of a sensor model: frames of a camera with lens distortion, range-dependent noise and angular noise,
/// estimated with models that include more and more of these (the 1995 paper's Fig. 15).
pub fn fidelity(frames: usize) {
    let Some(world) = hall() else { return };
    let place = free_poses(&world, 6, 11).expect("free poses")[2];
    let real = depth_camera();
    let simulated = Sensor::new(real.clone()).expect("a camera");
    let (mut pinhole, mut flat, mut growing) = (real.clone(), real.clone(), real.clone());
    for spec in [&mut pinhole, &mut flat] {
        (spec.noise.range_sigma, spec.noise.range_sigma_quadratic) = (0.01, 0.0);
    }
    for spec in [&mut pinhole, &mut flat, &mut growing] {
        spec.noise.angle_sigma = 0.0;
    }
    if let Geometry::Camera(camera) = &mut pinhole.geometry {
        camera.distortion = Distortion::None;
    }
    println!("{frames} frames of a depth camera in the factory hall, by what its model knows\n{HEAD}");
    for (name, spec) in [
        ("a pinhole, 1 cm at any range", pinhole),
        ("and the lens", flat),
        ("and noise that grows with the range", growing),
        ("and angular noise: all of it", real),
    ] {
        let model = Sensor::new(spec).expect("a model");
        let mut simulator =
            Simulator::new(predictor(), simulated.clone(), Disturbances::default(), 5).expect("a simulator");
        let mut estimator = Estimator::new(single(), EstimateOptions::default());
        let mut errors = Errors::default();
        for k in 0..frames {
            let truth = on_the_way(&place, k);
            let seen = simulator.frame(&world, k as f64, &RobotPose::new(truth)).expect("a frame");
            let frame = Frame::new(k as f64, model.clone(), Measurement::Range(seen.ranges().to_vec()));
            let start = ProcessTime::now();
            let before = on_the_way(&place, k.saturating_sub(1));
            let found = estimator
                .estimate(
                    &world,
                    &[&frame.expect("a frame")],
                    &PoseEstimate::of_sigmas(RobotPose::new(before), 0.03, 0.03),
                )
                .expect("an estimate");
            errors.cpu_ms += 1e3 * start.elapsed().as_secs_f64();
            errors.add(&found, &truth);
        }
        errors.row(name);
    }
}

/// Returns true if a step's pose is within 0.1 m of the truth, except in directions reported as weak (rotations count
/// as lengths at the reach of the beams), and if its squared error is within the 99.99 % quantile for three variables.
fn is_right(frame: &Frame, step: &Step, truth: &Pose) -> bool {
    let squares = measured_points(frame).iter().map(|p| f64::from(p.point.length_squared())).collect::<Vec<f64>>();
    let reach = (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt();
    let off = motion_between(&step.pose.world_from_robot, truth);
    let mut off: [f64; 6] = std::array::from_fn(|i| if i < 3 { off[i] } else { off[i] * reach });
    // A direction that the beams determine well must not be exempt, however much better it was known before.
    for weak in step.estimate.weak.iter().filter(|w| w.sigma > 0.05) {
        let along: f64 = off.iter().zip(&weak.motion).map(|(a, b)| a * b).sum();
        (0..6).for_each(|i| off[i] -= along * weak.motion[i]);
    }
    let (squared, _) = nees(&step.pose, &RobotPose::new(*truth));
    off[..3].iter().map(|x| x * x).sum::<f64>().sqrt() < 0.1 && squared < 21.1
}

/// Carries the robot four metres away from many places without odometry: counts the frames until it reports that, and
/// until it is localized again.
pub fn kidnapped() {
    let Some(world) = hall() else { return };
    let scanner = with_sigma("laser-scanner", 0.02);
    let places = free_poses(&world, 200, 23).expect("free poses");
    // The search for a level scanner covers one height only.
    let level: Vec<&Pose> = places.iter().step_by(2).collect();
    let options = EstimateOptions::planar().with_model_sigma(0.01);
    let (mut lost, mut found, mut drives) = (0, 0, 0);
    for pair in level.chunks_exact(2).take(10) {
        let height = pair[0].translation.z;
        let search = presight_localize::localize::SearchOptions::default().with_floor(height).with_cell(0.5);
        let mut robot = Localizer::new(
            Estimator::new(predictor(), options),
            PoseEstimate::of_sigmas(RobotPose::new(on_the_way(pair[0], 0)), 0.03, 0.02),
            LocalizeOptions::default(),
        );
        if robot.search_everywhere(&world, &scanner, search).is_err() {
            continue;
        }
        drives += 1;
        let there = Pose { translation: pair[1].translation.with_z(height), ..*pair[1] };
        let mut simulator =
            Simulator::new(predictor(), scanner.clone(), Disturbances::default(), drives).expect("a simulator");
        let (mut lost_at, mut found_at, mut reason) = (None, None, String::new());
        for k in 0..35 {
            let truth = if k < 15 { on_the_way(pair[0], k) } else { on_the_way(&there, k) };
            let mut frame = simulator.frame(&world, k as f64, &RobotPose::new(truth)).expect("a frame");
            if let Some(motion) = frame.motion.as_mut().filter(|_| k == 15) {
                motion.previous_from_current = Pose::IDENTITY;
            }
            let step = robot.step(&world, &frame).expect("a step");
            if k >= 15 && step.phase == Phase::Lost {
                lost_at.get_or_insert(k - 14);
            }
            if lost_at.is_some() && step.phase == Phase::Tracking && is_right(&frame, &step, &truth) {
                found_at.get_or_insert(k - 14);
            }
            let off = (step.pose.world_from_robot.translation - truth.translation).length();
            let weak: Vec<&str> = step.estimate.weak.iter().map(|w| w.name.as_str()).collect();
            reason = format!("{}, {off:.2} m off, weak {weak:?}: {}", step.phase.name(), step.reason);
        }
        println!("drive {drives}: lost after {lost_at:?} frames, found after {found_at:?}; at last {reason}");
        lost += usize::from(lost_at.is_some_and(|k| k <= 5));
        found += usize::from(lost_at.zip(found_at).is_some_and(|(l, f)| f - l <= 10));
    }
    println!("carried away: {lost} of {drives} lost within 5 frames, {found} found within 10 more");
}
