//! The drives of `changed.rs`: logs of the test kit's own ray caster in rooms that differ from their map.

use glam::{DVec3, Vec3};
use presight_model::environment::{Mesh, NewObject};
use presight_model::geometry::Pose;
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

/// Unchanged.
pub const EXACT: Shares = Shares { gone: 0.0, moved: 0.0 };
pub const SOME: Shares = Shares { gone: 0.15, moved: 0.15 };
pub const MUCH: Shares = Shares { gone: 0.4, moved: 0.4 };

/// What a localizer gets, and the truth.
pub struct Log {
    pub map: World,
    pub frames: Vec<Frame>,
    /// `None` where the robot is nowhere in the map.
    pub truth: Vec<Option<Pose>>,
    /// `None` for an unknown start.
    pub start: Option<Pose>,
    /// The frame that begins the search for the robot.
    pub looked_for: usize,
    /// Estimator options other than the command's.
    pub model_sigma: Option<f64>,
}

pub fn load(name: &str) -> Option<World> {
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
pub fn scanner(round: bool) -> Sensor {
    let (start_deg, step_deg, count) = if round { (-180.0, 1.0, 360) } else { (-90.0, 0.5, 361) };
    let azimuth = Angles::Uniform { start_deg, step_deg, count };
    let elevation = Angles::Listed(vec![0.0]);
    let mut spec =
        SensorSpec::new("scanner", "laser", Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None }));
    (spec.range_max, spec.noise.range_sigma) = (30.0, 0.01);
    spec.mount.translation = DVec3::new(0.1, 0.0, 0.5);
    Sensor::new(spec).expect("a scanner")
}

/// A lidar of 16 rows with the elevations of a VLP-16 and 360 beams a row.
pub fn rows() -> Sensor {
    let mut spec = scanner(true).spec().clone();
    if let Geometry::Scanner(scanner) = &mut spec.geometry {
        scanner.elevation = Angles::Uniform { start_deg: 15.0, step_deg: -2.0, count: 16 };
    }
    (spec.range_max, spec.noise.range_sigma) = (100.0, 0.02);
    Sensor::new(spec).expect("a scanner")
}

/// 160 x 120 pixels, 63 degrees wide, at a man's chest.
pub fn depth_camera() -> Sensor {
    let camera = Camera::pinhole(160, 120, 130.0, 130.0, 79.5, 59.5);
    let mut spec = SensorSpec::new("depth camera", "laser", Geometry::Camera(camera));
    spec.range_max = 10.0;
    (spec.noise.range_sigma, spec.noise.range_sigma_quadratic) = (0.002, 0.002);
    spec.mount.translation = DVec3::new(0.1, 0.0, 1.0);
    Sensor::new(spec).expect("a camera")
}

/// A drive on a route through a changed world.
pub struct Drive<'a> {
    pub world: &'a World,
    pub route: Route,
    pub sensor: Sensor,
    pub shares: Shares,
    pub walkers: usize,
    pub hertz: f64,
    pub frames: usize,
    pub seed: u64,
    /// Differences between map and room in addition to moved furniture.
    pub trouble: Trouble,
}

/// Further difficulties of a drive.
#[derive(Clone, Copy, Default)]
pub struct Trouble {
    /// The start that is given is 14 cm and 3 degrees off.
    pub far_start: bool,
    /// Share of the walls that were moved.
    pub walls: f64,
    /// Share of the upright surfaces that are glass.
    pub glass: f64,
    /// People who walk along all round.
    pub crowd: usize,
}

impl Trouble {
    pub const FAR: Self = Self { far_start: true, walls: 0.0, glass: 0.0, crowd: 0 };
}

impl<'a> Drive<'a> {
    pub fn new(world: &'a World, frames: usize, seed: u64) -> Self {
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

    pub fn caster(&self, shares: Shares) -> Caster {
        let (mut real, _) = changed(self.world.environment(), shares, &self.route, self.seed);
        if self.trouble.walls > 0.0 {
            real = with_moved_walls(&real, self.trouble.walls, self.seed);
        }
        let mut caster = Caster::new(&real, self.sensor.clone(), self.seed);
        caster.glass = self.trouble.glass;
        caster.with_walkers(self.walkers, &self.route, self.seed).with_crowd(self.trouble.crowd, self.seed)
    }

    /// The log by a caster, which changes at a frame to the one of other shares.
    pub fn log(&self, mut caster: Caster, then: Option<(usize, Shares)>) -> Log {
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

    pub fn usual(&self) -> Log {
        self.log(self.caster(self.shares), None)
    }
}

pub fn wander(world: &World, driving: &Driving, seed: u64) -> Route {
    let environment = world.environment();
    let bounds = environment.bounds();
    let oracle = Oracle::new(environment, 0.5 * (bounds.min + bounds.max)).expect("something is there");
    Route::wander(&oracle, &bounds, driving, seed)
}

/// What a case makes of a scene; `other` is another building.
pub type Maker = fn(&World, &World, usize, u64) -> Log;

pub const CASES: [(&str, Maker); 21] = [
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

pub fn without_odometry(world: &World, _: &World, frames: usize, seed: u64) -> Log {
    let driving = Driving { seconds: 0.2 * frames as f64 + 1.0, speed: 0.7, turn: 0.7 };
    let drive = Drive { route: wander(world, &driving, seed), hertz: 5.0, ..Drive::new(world, frames, seed) };
    let mut caster = drive.caster(EXACT);
    caster.slip = None;
    drive.log(caster, None)
}

/// The robot is in another building than the map.
pub fn elsewhere(world: &World, other: &World, frames: usize, given: bool, seed: u64) -> Log {
    elsewhere_with(world, Drive::new(other, frames, seed).usual(), given, seed)
}

pub fn elsewhere_with(world: &World, log: Log, given: bool, seed: u64) -> Log {
    let driving = Driving { seconds: 1.0, speed: 0.3, turn: 0.3 };
    let start = given.then(|| wander(world, &driving, 4 + seed).at(0.0));
    Log { map: world.clone(), truth: vec![None; log.frames.len()], start, ..log }
}

/// The map shows the building from behind: each scan is mirrored.
pub fn mirrored(world: &World, _: &World, frames: usize, seed: u64) -> Log {
    let log = Drive { walkers: 0, ..Drive::new(world, frames, seed) }.usual();
    Log { truth: vec![None; frames], ..from_behind(log) }
}

/// The frames as if the building were mirrored.
pub fn from_behind(log: Log) -> Log {
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
pub fn carried_away(world: &World, _: &World, frames: usize, seed: u64) -> Log {
    let (half, other) = (frames / 2, Drive::new(world, frames, 6 + seed));
    let (here, there) = (Drive::new(world, frames, seed).usual(), other.usual());
    let frames = here.frames[..half].iter().chain(&there.frames[half..]).cloned().collect();
    let truth = here.truth[..half].iter().chain(&there.truth[half..]).copied().collect();
    Log { frames, truth, looked_for: half, ..here }
}

/// A scanner that takes a tenth of a second for a turn, on a fast robot.
pub fn turning(world: &World, frames: usize, turn_s: f64, seed: u64) -> Log {
    let driving = Driving { seconds: 0.1 * frames as f64 + 1.0, speed: 1.5, turn: 1.0 };
    let sensor = Sensor::new(scanner(true).spec().clone().with_times(RayTimes::turning(turn_s, StampAt::First)))
        .expect("a scanner");
    let drive = Drive { route: wander(world, &driving, seed), walkers: 0, sensor, ..Drive::new(world, frames, seed) };
    let mut caster = drive.caster(EXACT);
    caster.times = RayTimes::turning(turn_s, StampAt::First);
    drive.log(caster, None)
}

/// One person always stands 1.8 m before a depth camera; without odometry.
pub fn person(world: &World, frames: usize, model_sigma: Option<f64>, seed: u64) -> Log {
    let driving = Driving { seconds: 0.1 * frames as f64 + 1.0, speed: 0.4, turn: 0.4 };
    let route = wander(world, &driving, seed);
    let drive = Drive { route, sensor: depth_camera(), walkers: 0, ..Drive::new(world, frames, seed) };
    let mut caster = drive.caster(EXACT).with_person_before(1.8);
    caster.slip = None;
    Log { model_sigma, ..drive.log(caster, None) }
}

/// A corridor whose ends are out of reach, without odometry.
pub fn corridor(frames: usize) -> Log {
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
pub fn hard_views(world: &World, shares: Shares, walkers: usize, seed: u64) -> Log {
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
pub fn malaga(given: bool, shares: Shares, seed: u64) -> Option<Log> {
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
