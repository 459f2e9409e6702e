//! Drives through rooms that are no longer as the map has them: `cargo bench --bench localize -- changed [FRAMES]
//! [SCENE,..] [CASE,..] [SEED] [MODEL_SIGMA]`. The logs come from the test kit's own ray caster. Each row is one drive; cases and scenes
//! are chosen by a part of their name, `-` for all. `changed 60 hospital 15` takes seconds. `cargo bench --bench localize
//! -- leads [FRAMES] [SCENE,..]` counts by how much the best place of a map leads over the others, for scans of this map,
//! changed, and of another building.

use super::single;
use cpu_time::ProcessTime;
use glam::{DVec3, Vec3};
use presight_localize::estimate::{EstimateOptions, Estimator, nees};
use presight_localize::localize::{LocalizeOptions, Localizer, Phase, Search, SearchOptions};
use presight_model::environment::{Mesh, NewObject};
use presight_model::geometry::{Pose, PoseEstimate, RobotPose};
use presight_model::measured::{Frame, Measurement};
use presight_model::sensor::{Angles, Camera, Geometry, RayTimes, Scanner, Sensor, SensorSpec, StampAt};
use presight_model::world::World;
use presight_read::log::Frames;
use presight_read::preset;
use presight_testkit::caster::Caster;
use presight_testkit::changes::{Shares, changed, with_moved_walls};
use presight_testkit::oracle::Oracle;
use presight_testkit::route::{Driving, Route};
use presight_testkit::{Random, data, scenes};
use std::sync::Arc;

const SCENES: [&str; 6] =
    ["hospital", "factory_hall", "warehouse_small", "office_clearpath", "scenes/factory.rhai", "office_willowgarage"];
/// Unchanged.
const EXACT: Shares = Shares { gone: 0.0, moved: 0.0 };
const SOME: Shares = Shares { gone: 0.15, moved: 0.15 };
const MUCH: Shares = Shares { gone: 0.4, moved: 0.4 };
/// The 99.99 % quantiles of chi squared with three and with six degrees of freedom.
const QUANTILES: [(usize, f64); 2] = [(3, 21.11), (6, 27.86)];

/// What a localizer gets, and the truth.
struct Log {
    map: World,
    frames: Vec<Frame>,
    /// `None` where the robot is nowhere in the map.
    truth: Vec<Option<Pose>>,
    /// `None` for an unknown start.
    start: Option<Pose>,
    /// The frame that begins the search for the robot.
    looked_for: usize,
    /// Estimator options other than the command's.
    model_sigma: Option<f64>,
}

/// The figures of a drive.
#[derive(Default)]
struct Row {
    frames: usize,
    good: usize,
    /// Tracked within 15 cm and 2 degrees.
    near: usize,
    tracking: usize,
    certain_and_wrong: usize,
    /// Tracked, with a NEES over its 99.99 % quantile.
    beyond: usize,
    /// Largest angle that a tracked pose is off, degrees.
    most_deg: f64,
    nees: Vec<f64>,
    /// Frames from the start, or from where the robot was carried to, until it was tracked rightly.
    found: Option<usize>,
    /// Tracking at the frame at which it was carried away.
    tracked_away: bool,
    squares: [f64; 2],
    cpu_ms: Vec<f64>,
    reason: String,
}

const HEAD: &str = "| scene | case | good % | within 15 cm % | tracking % | certain and wrong | NEES a number | found at frame | RMS mm | RMS deg | CPU ms p50 | p95 |\n|---|---|---|---|---|---|---|---|---|---|---|---|";

impl Row {
    fn print(&mut self, scene: &str, case: &str) {
        self.cpu_ms.sort_by(f64::total_cmp);
        let at = |share: f64| self.cpu_ms[((self.cpu_ms.len() - 1) as f64 * share).round() as usize];
        let share = |n: usize| 100.0 * n as f64 / self.frames as f64;
        let mean = self.nees.iter().sum::<f64>() / self.nees.len().max(1) as f64;
        let rms = |sum: f64| (sum / self.nees.len().max(1) as f64).sqrt();
        println!(
            "| {scene} | {case} | {:.0} | {:.0} | {:.0} | {} | {mean:.2} | {}{} | {:.1} | {:.3} | {:.1} | {:.1} |",
            share(self.good),
            share(self.near),
            share(self.tracking),
            self.certain_and_wrong,
            self.found.map_or("never".to_owned(), |k| k.to_string()),
            if self.tracked_away { ", tracked where it was" } else { "" },
            1e3 * rms(self.squares[0]),
            rms(self.squares[1]),
            at(0.5),
            at(0.95),
        );
        if std::env::var_os("PRESIGHT_REASONS").is_some() {
            println!("{}", self.reason);
        }
    }
}

fn localized(log: &Log) -> Row {
    let sensor = log.frames[0].sensor();
    // As in the command: the deviation of the map is learnt unless it is stated.
    let estimate = EstimateOptions::of(sensor).with_learns_sigma(true).with_stated_sigma(log.model_sigma);
    let mut estimator = Estimator::new(single(), estimate);
    let (options, search) = (LocalizeOptions::default(), SearchOptions::default());
    let mut robot = match log.start {
        Some(start) => {
            let prior = PoseEstimate::of_sigmas(RobotPose::new(start), 0.05, 2f64.to_radians());
            Localizer::new(estimator, prior, options)
        }
        None => {
            let search = Search::new(&mut estimator, &log.map, sensor, search).expect("a search");
            Localizer::unknown(estimator, search, options)
        }
    };
    let planar = !sensor.is_camera() && sensor.height() == 1;
    let mut may_search = log.start.is_some() && planar;
    let mut row = Row::default();
    for (k, (frame, truth)) in log.frames.iter().zip(&log.truth).enumerate() {
        let before = ProcessTime::now();
        let step = robot.step(&log.map, frame).expect("a step");
        if may_search && matches!(step.phase, Phase::Lost | Phase::Unknown) {
            may_search = false;
            // As in the command: without this search only the surroundings of the last pose are searched.
            robot.search_everywhere(&log.map, sensor, search).ok();
        }
        row.cpu_ms.push(1e3 * before.elapsed().as_secs_f64());
        row.frames += 1;
        let is_tracking = step.phase == Phase::Tracking;
        row.tracking += usize::from(is_tracking);
        let mut line = format!("  {k}: {}: {}", step.phase.name(), step.reason);
        if let Some(truth) = truth {
            let found = &step.pose.world_from_robot;
            let off = (
                (found.translation - truth.translation).length(),
                found.rotation.angle_between(truth.rotation).to_degrees(),
            );
            let (squared, axes) = nees(&step.pose, &RobotPose::new(*truth));
            let is_near = off.0 < 0.05 && off.1 < 1.0;
            line += &format!("; {:.3} m {:.2} deg, NEES {:.1}", off.0, off.1, squared / axes.max(1) as f64);
            if is_tracking {
                row.nees.push(squared / axes.max(1) as f64);
                row.squares[0] += off.0 * off.0;
                row.squares[1] += off.1 * off.1;
                let quantile = QUANTILES.iter().find(|q| q.0 == axes).map_or(0.0, |q| q.1);
                row.beyond += usize::from(squared > quantile);
                row.most_deg = row.most_deg.max(off.1);
                row.good += usize::from(is_near);
                row.near += usize::from(off.0 < 0.15 && off.1 < 2.0);
                row.certain_and_wrong += usize::from(!is_near && squared > quantile);
                row.tracked_away |= log.looked_for == k && k > 0 && !is_near;
            }
            if is_tracking && is_near && k >= log.looked_for && row.found.is_none() {
                row.found = Some(k - log.looked_for);
            }
        } else {
            row.certain_and_wrong += usize::from(is_tracking);
        }
        row.reason += &format!("{line}; {:.0} ms\n", row.cpu_ms[k]);
    }
    row
}

fn load(name: &str) -> Option<World> {
    if !name.ends_with(".rhai") {
        return data::scene(name, true);
    }
    #[cfg(feature = "script")]
    {
        let path = data::root().join(name);
        let loaded = presight_read::script::load(&path, &Default::default(), &mut |_| {}).expect("the scene loads");
        Some(World::new(loaded.environment))
    }
    #[cfg(not(feature = "script"))]
    None
}

/// 360 degrees, or the 180 ahead, 0.5 m above the floor.
fn scanner(round: bool) -> Sensor {
    let (start_deg, step_deg, count) = if round { (-180.0, 1.0, 360) } else { (-90.0, 0.5, 361) };
    let azimuth = Angles::Uniform { start_deg, step_deg, count };
    let elevation = Angles::Listed(vec![0.0]);
    let mut spec =
        SensorSpec::new("scanner", "laser", Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None }));
    (spec.range_max, spec.noise.range_sigma) = (30.0, 0.01);
    spec.mount.translation = DVec3::new(0.1, 0.0, 0.5);
    Sensor::new(spec).expect("a scanner")
}

/// 16 rows of 360 beams, as wide as those of a VLP-16.
fn rows() -> Sensor {
    let mut spec = scanner(true).spec().clone();
    if let Geometry::Scanner(scanner) = &mut spec.geometry {
        scanner.elevation = Angles::Uniform { start_deg: 15.0, step_deg: -2.0, count: 16 };
    }
    (spec.range_max, spec.noise.range_sigma) = (100.0, 0.02);
    Sensor::new(spec).expect("a scanner")
}

/// 160 x 120 pixels, 63 degrees wide, at a man's chest.
fn depth_camera() -> Sensor {
    let camera = Camera::pinhole(160, 120, 130.0, 130.0, 79.5, 59.5);
    let mut spec = SensorSpec::new("depth camera", "laser", Geometry::Camera(camera));
    spec.range_max = 10.0;
    (spec.noise.range_sigma, spec.noise.range_sigma_quadratic) = (0.002, 0.002);
    spec.mount.translation = DVec3::new(0.1, 0.0, 1.0);
    Sensor::new(spec).expect("a camera")
}

/// A drive on a route through a changed world.
struct Drive<'a> {
    world: &'a World,
    route: Route,
    sensor: Sensor,
    shares: Shares,
    walkers: usize,
    hertz: f64,
    frames: usize,
    seed: u64,
    /// What is wrong beside the furniture.
    trouble: Trouble,
}

/// What else makes a drive hard.
#[derive(Clone, Copy, Default)]
struct Trouble {
    /// The start that is given is 14 cm and 3 degrees off.
    far_start: bool,
    /// Share of the walls that were moved.
    walls: f64,
    /// Share of the upright surfaces that are glass.
    glass: f64,
    /// People who walk along all round.
    crowd: usize,
}

impl Trouble {
    const FAR: Self = Self { far_start: true, walls: 0.0, glass: 0.0, crowd: 0 };
}

impl<'a> Drive<'a> {
    fn new(world: &'a World, frames: usize, seed: u64) -> Self {
        let driving = Driving { seconds: 0.1 * frames as f64 + 1.0, speed: 0.7, turn: 0.7 };
        let route = wander(world, &driving, seed);
        Self {
            world,
            route,
            sensor: scanner(true),
            shares: EXACT,
            walkers: 3,
            hertz: 10.0,
            frames,
            seed,
            trouble: Trouble::default(),
        }
    }

    fn caster(&self, shares: Shares) -> Caster {
        let (mut real, _) = changed(self.world.environment(), shares, &self.route, self.seed);
        if self.trouble.walls > 0.0 {
            real = with_moved_walls(&real, self.trouble.walls, self.seed);
        }
        let mut caster = Caster::new(&real, self.sensor.clone(), self.seed);
        caster.glass = self.trouble.glass;
        caster.with_walkers(self.walkers, &self.route, self.seed).with_crowd(self.trouble.crowd, self.seed)
    }

    /// The log by a caster, which changes at a frame to the one of other shares.
    fn log(&self, mut caster: Caster, then: Option<(usize, Shares)>) -> Log {
        let (slip, times, jitter) = (caster.slip, caster.times.clone(), caster.jitter);
        let pose = |t: f64| self.route.at(t);
        let (mut frames, mut truth) = (Vec::new(), Vec::new());
        for k in 0..self.frames {
            if let Some((at, shares)) = then
                && at == k
            {
                caster = self.caster(shares);
                (caster.slip, caster.times, caster.jitter) = (slip, times.clone(), jitter);
            }
            let time = k as f64 / self.hertz;
            frames.push(caster.frame(&pose, time, (k > 0).then(|| time - 1.0 / self.hertz)));
            truth.push(Some(pose(time)));
        }
        let (x, y, yaw) = if self.trouble.far_start { (0.11, -0.09, 0.052) } else { (0.03, -0.02, 0.01) };
        let off = Pose::from_xyz_rpy(DVec3::new(x, y, 0.0), 0.0, 0.0, yaw);
        let start = Some(pose(0.0) * off);
        Log { map: self.world.clone(), frames, truth, start, looked_for: 0, model_sigma: None }
    }

    fn usual(&self) -> Log {
        self.log(self.caster(self.shares), None)
    }
}

fn wander(world: &World, driving: &Driving, seed: u64) -> Route {
    let environment = world.environment();
    let bounds = environment.bounds();
    let oracle = Oracle::new(environment, 0.5 * (bounds.min + bounds.max)).expect("something is there");
    Route::wander(&oracle, &bounds, driving, seed)
}

/// What a case makes of a scene; `other` is another building.
type Maker = fn(&World, &World, usize, u64) -> Log;

const CASES: [(&str, Maker); 21] = [
    ("exact", |w, _, n, s| Drive::new(w, n, s).usual()),
    ("exact, 180 deg", |w, _, n, s| Drive { sensor: scanner(false), ..Drive::new(w, n, s) }.usual()),
    ("exact, 5 Hz without odometry", without_odometry),
    ("15/15, start given", |w, _, n, s| Drive { shares: SOME, ..Drive::new(w, n, s) }.usual()),
    ("40/40, start given", |w, _, n, s| Drive { shares: MUCH, ..Drive::new(w, n, s) }.usual()),
    ("exact for a third, then 40/40", |w, _, n, s| {
        let drive = Drive::new(w, n, s);
        drive.log(drive.caster(EXACT), Some((n / 3, MUCH)))
    }),
    ("15/15, unknown start", |w, _, n, s| Log { start: None, ..Drive { shares: SOME, ..Drive::new(w, n, s) }.usual() }),
    ("40/40, unknown start", |w, _, n, s| Log { start: None, ..Drive { shares: MUCH, ..Drive::new(w, n, s) }.usual() }),
    ("other building, start given", |w, other, n, s| elsewhere(w, other, n, true, s)),
    ("other building, unknown start", |w, other, n, s| elsewhere(w, other, n, false, s)),
    ("other building, depth camera", |w, other, n, s| {
        let drive = Drive { sensor: depth_camera(), ..Drive::new(other, n, s) };
        elsewhere_with(w, drive.usual(), true, s)
    }),
    ("mirrored, start given", mirrored),
    ("far start, exact", |w, _, n, s| Drive { trouble: Trouble::FAR, ..Drive::new(w, n, s) }.usual()),
    ("far start, 40/40", |w, _, n, s| Drive { shares: MUCH, trouble: Trouble::FAR, ..Drive::new(w, n, s) }.usual()),
    ("far start, 40/40, walls moved", |w, _, n, s| {
        let trouble = Trouble { walls: 0.4, ..Trouble::FAR };
        Drive { shares: MUCH, trouble, ..Drive::new(w, n, s) }.usual()
    }),
    ("far start, glass", |w, _, n, s| {
        Drive { trouble: Trouble { glass: 0.5, ..Trouble::FAR }, ..Drive::new(w, n, s) }.usual()
    }),
    ("far start, crowd", |w, _, n, s| {
        Drive { trouble: Trouble { crowd: 12, ..Trouble::FAR }, ..Drive::new(w, n, s) }.usual()
    }),
    ("far start, 16 rows", |w, _, n, s| Drive { sensor: rows(), trouble: Trouble::FAR, ..Drive::new(w, n, s) }.usual()),
    ("carried away", carried_away),
    ("driving lidar, turn time", |w, _, n, s| turning(w, n, 0.1, s)),
    ("driving lidar, no turn time", |w, _, n, s| turning(w, n, 0.0, s)),
];

fn without_odometry(world: &World, _: &World, frames: usize, seed: u64) -> Log {
    let driving = Driving { seconds: 0.2 * frames as f64 + 1.0, speed: 0.7, turn: 0.7 };
    let drive = Drive { route: wander(world, &driving, seed), hertz: 5.0, ..Drive::new(world, frames, seed) };
    let mut caster = drive.caster(EXACT);
    caster.slip = None;
    drive.log(caster, None)
}

/// The robot is in another building than the map.
fn elsewhere(world: &World, other: &World, frames: usize, given: bool, seed: u64) -> Log {
    elsewhere_with(world, Drive::new(other, frames, seed).usual(), given, seed)
}

fn elsewhere_with(world: &World, log: Log, given: bool, seed: u64) -> Log {
    let driving = Driving { seconds: 1.0, speed: 0.3, turn: 0.3 };
    let start = given.then(|| wander(world, &driving, 4 + seed).at(0.0));
    Log { map: world.clone(), truth: vec![None; log.frames.len()], start, ..log }
}

/// The map shows the building from behind: each scan is mirrored.
fn mirrored(world: &World, _: &World, frames: usize, seed: u64) -> Log {
    let log = Drive { walkers: 0, ..Drive::new(world, frames, seed) }.usual();
    Log { truth: vec![None; frames], ..from_behind(log) }
}

/// The frames as if the building were mirrored.
fn from_behind(log: Log) -> Log {
    let turned = |frame: &Frame| {
        let mut ranges = frame.ranges().to_vec();
        // Column 0 looks back and stays.
        ranges[1..].reverse();
        let mut mirror =
            Frame::new(frame.stamp, frame.sensor().clone(), Measurement::Range(ranges)).expect("a sound frame");
        mirror.motion = frame.motion.map(|mut motion| {
            let step = &mut motion.previous_from_current;
            step.translation.y = -step.translation.y;
            step.rotation = step.rotation.conjugate();
            motion
        });
        mirror
    };
    Log { frames: log.frames.iter().map(turned).collect(), ..log }
}

/// Halfway the robot is put elsewhere, and its odometry has not noticed.
fn carried_away(world: &World, _: &World, frames: usize, seed: u64) -> Log {
    let (half, other) = (frames / 2, Drive::new(world, frames, 6 + seed));
    let (here, there) = (Drive::new(world, frames, seed).usual(), other.usual());
    let frames = here.frames[..half].iter().chain(&there.frames[half..]).cloned().collect();
    let truth = here.truth[..half].iter().chain(&there.truth[half..]).copied().collect();
    Log { frames, truth, looked_for: half, ..here }
}

/// A scanner that takes a tenth of a second for a turn, on a fast robot.
fn turning(world: &World, frames: usize, turn_s: f64, seed: u64) -> Log {
    let driving = Driving { seconds: 0.1 * frames as f64 + 1.0, speed: 1.5, turn: 1.0 };
    let sensor = Sensor::new(scanner(true).spec().clone().with_times(RayTimes::turning(turn_s, StampAt::First)))
        .expect("a scanner");
    let drive = Drive { route: wander(world, &driving, seed), walkers: 0, sensor, ..Drive::new(world, frames, seed) };
    let mut caster = drive.caster(EXACT);
    caster.times = RayTimes::turning(turn_s, StampAt::First);
    drive.log(caster, None)
}

/// One person always stands 1.8 m before a depth camera; without odometry.
fn person(world: &World, frames: usize, model_sigma: Option<f64>, seed: u64) -> Log {
    let driving = Driving { seconds: 0.1 * frames as f64 + 1.0, speed: 0.4, turn: 0.4 };
    let route = wander(world, &driving, seed);
    let drive = Drive { route, sensor: depth_camera(), walkers: 0, ..Drive::new(world, frames, seed) };
    let mut caster = drive.caster(EXACT).with_person_before(1.8);
    caster.slip = None;
    Log { model_sigma, ..drive.log(caster, None) }
}

/// A corridor whose ends are out of reach, without odometry.
fn corridor(frames: usize) -> Log {
    let mut environment = scenes::empty();
    let walls = Mesh::cuboid("walls", Vec3::new(-60.0, -1.1, 0.0), Vec3::new(60.0, 1.1, 2.5), 0).expect("a box");
    environment.insert(NewObject::new("walls", Pose::IDENTITY, Arc::new(walls))).expect("a sound object");
    let world = World::new(environment);
    let route = Route::straight([-10.0, 0.2, 0.0], 0.5, 0.1 * frames as f64 + 1.0);
    let mut spec = scanner(true).spec().clone();
    spec.range_max = 8.0;
    let sensor = Sensor::new(spec).expect("a scanner");
    let drive = Drive {
        world: &world,
        route,
        sensor,
        shares: EXACT,
        walkers: 0,
        hertz: 10.0,
        frames,
        seed: 1,
        trouble: Trouble::default(),
    };
    let mut caster = drive.caster(EXACT);
    caster.slip = None;
    drive.log(caster, None)
}

/// Views half a metre apart with turns of up to 150 degrees, one a second, of the paper's laser range camera.
fn hard_views(world: &World, shares: Shares, walkers: usize, seed: u64) -> Log {
    let environment = world.environment();
    let bounds = environment.bounds();
    let oracle = Oracle::new(environment, 0.5 * (bounds.min + bounds.max)).expect("something is there");
    let driving = Driving { seconds: 1.0, speed: 0.3, turn: 0.3 };
    let start = Route::wander(&oracle, &bounds, &driving, seed).at(0.0);
    let mut random = Random(seed);
    let is_free = |at: DVec3| {
        (0..24).all(|k| {
            let azimuth = std::f64::consts::TAU * f64::from(k) / 24.0;
            oracle.distance(at + DVec3::Z * 0.5, DVec3::new(azimuth.cos(), azimuth.sin(), 0.0)) > 0.4
        })
    };
    let (mut poses, mut yaw) = (vec![start], 0.0);
    while poses.len() < 60 {
        let azimuth = random.uniform(0.0, std::f64::consts::TAU);
        let at = poses[poses.len() - 1].translation + 0.5 * DVec3::new(azimuth.cos(), azimuth.sin(), 0.0);
        if is_free(at) {
            yaw += random.uniform(-150f64.to_radians(), 150f64.to_radians());
            poses.push(Pose::from_xyz_rpy(at, 0.0, 0.0, yaw));
        }
    }
    let mut spec = preset("laser-range-camera").expect("a preset").spec().clone();
    spec.mount.translation = DVec3::new(0.0, 0.0, 1.7);
    let route = Route::straight([start.translation.x, start.translation.y, 0.0], 0.0, 1.0);
    let (real, _) = changed(environment, shares, &route, seed);
    let mut caster = Caster::new(&real, Sensor::new(spec).expect("a camera"), seed).with_walkers(walkers, &route, seed);
    let pose = |t: f64| poses[(t.round() as usize).min(59)];
    let frames = (0..60).map(|k| caster.frame(&pose, f64::from(k), (k > 0).then(|| f64::from(k - 1)))).collect();
    let truth = poses.iter().copied().map(Some).collect();
    Log { map: world.clone(), frames, truth, start: Some(start), looked_for: 0, model_sigma: None }
}

/// Real scans, in the map of the corridor with shares of its walls gone and moved.
fn malaga(given: bool, shares: Shares, seed: u64) -> Option<Log> {
    let log = data::file("lidar2d/malaga_corridor_run_scans.json")?;
    let map = super::map(&data::file("lidar2d/malaga_corridor_map.glb")?);
    let map = World::new(changed(map.environment(), shares, &Route::straight([0.0; 3], 0.0, 1.0), seed).0);
    let read: Vec<_> =
        Frames::open(&log, None, &Default::default()).expect("a log").map(|o| o.expect("a scan")).collect();
    let truth: Vec<Option<Pose>> = read.iter().map(|o| o.reference.map(|robot| robot.world_from_robot())).collect();
    let start = truth[0].filter(|_| given);
    Some(Log {
        map,
        frames: read.into_iter().map(|o| o.frame).collect(),
        truth,
        start,
        looked_for: 0,
        model_sigma: None,
    })
}

/// True if a name contains one of the requested parts, or if none are given.
fn is_asked(asked: Option<&String>, name: &str) -> bool {
    asked.is_none_or(|a| a == "-" || a.split(',').any(|part| name.contains(part)))
}

/// Prints a row for each requested drive.
pub fn all(words: &[String]) {
    let frames = words.first().map_or(300, |n| n.parse().expect("a number of frames"));
    let (scenes, cases) = (words.get(1), words.get(2));
    let seed = words.get(3).map_or(1, |n| n.parse().expect("a seed"));
    let stated = words.get(4).map(|n| n.parse().expect("a deviation of the map, metres"));
    println!("{frames} frames a drive, seed {seed}\n{HEAD}");
    let asked: Vec<&str> = SCENES.into_iter().filter(|name| is_asked(scenes, name)).collect();
    for name in asked {
        let Some(world) = load(name) else { continue };
        let is_needed = CASES.iter().any(|(case, _)| case.contains("other") && is_asked(cases, case));
        let next = SCENES[(SCENES.iter().position(|s| *s == name).unwrap_or(0) + 1) % SCENES.len()];
        let other = if is_needed { load(next) } else { None };
        for (case, make) in CASES.iter().filter(|(case, _)| is_asked(cases, case)) {
            let log = make(&world, other.as_ref().unwrap_or(&world), frames, seed);
            localized(&Log { model_sigma: stated, ..log }).print(name, case);
        }
        for sigma in [None, Some(0.0), Some(0.01), Some(0.03)] {
            let case = format!(
                "person before a depth camera, model sigma {}",
                sigma.map_or("unset".into(), |s| s.to_string())
            );
            if is_asked(cases, &case) {
                localized(&person(&world, frames, sigma, seed)).print(name, &case);
            }
        }
        let (mut views, mut beyond, mut most_deg) = (0, 0, 0.0f64);
        for (seed, (shares, walkers)) in (1..=5).flat_map(|seed| [(seed, (EXACT, 0)), (seed, (SOME, 5))]) {
            let case = format!("hard views, {} {seed}", if shares == EXACT { "unchanged" } else { "changed" });
            if name == "factory_hall" && is_asked(cases, &case) {
                let mut row = localized(&hard_views(&world, shares, walkers, seed));
                row.print(name, &case);
                (views, beyond) = (views + row.tracking, beyond + row.beyond);
                most_deg = most_deg.max(row.most_deg);
            }
        }
        if views > 0 {
            println!(
                "{views} hard views are tracked, {beyond} with a NEES over the 99.99 % quantile, the worst {most_deg:.2} deg off"
            );
        }
    }
    if is_asked(scenes, "corridor") && is_asked(cases, "corridor without odometry") {
        localized(&corridor(frames)).print("corridor", "corridor without odometry");
    }
    for (case, given, shares) in [
        ("real scans, start given", true, EXACT),
        ("real scans, unknown start", false, EXACT),
        ("real scans, 15/15 of the walls, start given", true, SOME),
        ("real scans, 15/15 of the walls, unknown start", false, SOME),
    ] {
        if is_asked(scenes, "malaga") && is_asked(cases, case) {
            malaga(given, shares, seed).iter().for_each(|log| localized(log).print("malaga corridor", case));
        }
    }
}

/// Short drives in maps of other buildings, for this number of seconds: how many have a frame that is tracked.
pub fn wrong(words: &[String]) {
    let seconds = words.first().map_or(300.0, |n| n.parse().expect("a number of seconds"));
    let began = std::time::Instant::now();
    let worlds: Vec<(&str, World)> = SCENES.into_iter().filter_map(|name| Some((name, load(name)?))).collect();
    let (mut drives, mut frames, mut tracked) = (0, 0, Vec::new());
    'drives: for seed in 1.. {
        for (k, (name, world)) in worlds.iter().enumerate() {
            // Each other building in turn.
            let (other, building) = &worlds[(k + 1 + seed as usize % (worlds.len() - 1)) % worlds.len()];
            for given in [true, false] {
                if began.elapsed().as_secs_f64() > seconds {
                    break 'drives;
                }
                let row = localized(&elsewhere(world, building, 20, given, seed));
                (drives, frames) = (drives + 1, frames + row.frames);
                if row.tracking > 0 {
                    tracked.push(format!("{other} in the map of {name}, given {given}, seed {seed}: {}", row.tracking));
                }
            }
        }
    }
    println!("{drives} drives of {frames} frames in other buildings, {} with a tracked frame", tracked.len());
    tracked.iter().for_each(|line| println!("{line}"));
}

/// For single scans: the odds by which the best place of the map leads over all others, as the localizer counts them.
pub fn leads(words: &[String]) {
    let frames = words.first().map_or(100, |n| n.parse().expect("a number of frames"));
    println!(
        "| map | scans | number | lead p5 | p50 | p95 | over 3 | over 4.6 | over 6.9 | right |\n|---|---|---|---|---|---|---|---|---|---|"
    );
    for (k, name) in SCENES.into_iter().enumerate().filter(|(_, name)| is_asked(words.get(1), name)) {
        let (Some(world), Some(other)) = (load(name), load(SCENES[(k + 1) % SCENES.len()])) else { continue };
        let sensor = scanner(true);
        let mut estimator = Estimator::new(single(), EstimateOptions::of(&sensor));
        let search = Search::new(&mut estimator, &world, &sensor, SearchOptions::default()).expect("a search");
        // Three seconds apart: other views.
        let driving = Driving { seconds: frames as f64 / 0.3 + 1.0, speed: 0.7, turn: 0.7 };
        let scans = |w: &World, shares| {
            Drive { hertz: 0.3, shares, route: wander(w, &driving, 1), ..Drive::new(w, frames, 1) }.usual()
        };
        for (kind, log) in [
            ("of another building", scans(&other, EXACT)),
            ("mirrored", from_behind(scans(&world, EXACT))),
            ("15/15", scans(&world, SOME)),
            ("40/40", scans(&world, MUCH)),
        ] {
            let (mut leads, mut right) = (Vec::new(), 0);
            for (frame, truth) in log.frames.iter().zip(&log.truth) {
                let estimator = Estimator::new(single(), EstimateOptions::of(&sensor));
                let mut robot = Localizer::unknown(estimator, search.clone(), LocalizeOptions::default());
                let step = robot.step(&world, frame).expect("a step");
                let Some(best) = step.candidates.first() else { continue };
                let off = truth.map(|truth| best.pose.world_from_robot.translation.distance(truth.translation));
                right += usize::from(kind.contains('/') && off.is_some_and(|off| off < 0.3));
                leads.push(best.log_likelihood);
            }
            leads.sort_by(f64::total_cmp);
            let at = |share: f64| leads[((leads.len() - 1) as f64 * share).round() as usize];
            let over = |x: f64| leads.iter().filter(|lead| **lead > x).count();
            println!(
                "| {name} | {kind} | {} | {:.1} | {:.1} | {:.1} | {} | {} | {} | {right} |",
                leads.len(),
                at(0.05),
                at(0.5),
                at(0.95),
                over(3.0),
                over(4.6),
                over(6.9)
            );
        }
    }
}
