//! A real building against its architect's model: scans cast in the laser map of the Willow Garage offices teach the
//! model what differs. `cargo bench --bench update -- willow [FOLDER]`; a folder gets the logs and the poses of the
//! first drive, for the command.

use glam::{DMat3, DVec2, DVec3};
use presight_localize::estimate::{EstimateOptions, Estimator, Freedom};
use presight_localize::localize::{LocalizeOptions, Localizer, Phase};
use presight_model::caster::RayCaster;
use presight_model::environment::Environment;
use presight_model::geometry::{Aabb, Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::measured::{Frame, Measurement, Motion, OdometryNoise};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_read::log::{LogFrame, lines};
use presight_read::sensor_toml;
use presight_testkit::{Random, data};
use presight_update::{FindingKind, LearnOptions, Learner, SiteFindings};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::Path;

/// Drives of 40 m that teach, and others that judge.
const DRIVES: (u64, u64) = (6, 4);
/// Seconds and metres between scans, and their number.
const STEP: f64 = 0.5;
const STEP_M: f64 = 0.5;
const SCANS: usize = 80;
/// Radius of the robot, metres. A place of a way is the mean of this number of cells before and after it.
const ROBOT: f64 = 0.3;
const SMOOTH: usize = 5;
const SCANNER: &str = "format = 1\nkind = \"scanner\"\nname = \"scanner\"\nclass = \"laser\"\nrange_min = 0.05\nrange_max = 20\n[azimuth]\nstart_deg = -180\nstep_deg = 1\ncount = 360\n[elevation]\nstart_deg = 0\nstep_deg = 0\ncount = 1\n[noise]\nrange_sigma = 0.01\n[mount]\nxyz = [0.0, 0.0, 0.35]\n";
/// Height of the scanner, metres, and its reach.
const HEIGHT: f64 = 0.35;
const REACH: f64 = 20.0;
/// How far the model's surfaces are off, metres: the median of the registration is 0.23 m.
const MODEL: f64 = 0.15;
/// A beam is explained within so far, metres; a piece of wall farther than the second from anything real is missing.
const NEAR: (f64, f64) = (0.2, 0.3);

/// A laser map: cells of 5 cm, in the frame of the model.
struct Map {
    size: [i64; 2],
    /// `None` for unknown cells, else whether something is there.
    cells: Vec<Option<bool>>,
    model_from_map: DMat3,
    map_from_model: DMat3,
}

const RESOLUTION: f64 = 0.05;

fn matrix(value: &serde_json::Value) -> DMat3 {
    let at = |r: usize, c: usize| value[r][c].as_f64().expect("a number");
    DMat3::from_cols_array_2d(&std::array::from_fn(|c| std::array::from_fn(|r| at(r, c))))
}

impl Map {
    fn open() -> Option<Self> {
        let (about, picture) = (data::file("lidar2d/willow.json")?, data::file("lidar2d/willow_real_map.png")?);
        let about: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(about).expect("text")).expect("JSON");
        let picture = image::open(picture).expect("a picture").to_luma8();
        let size = [picture.width(), picture.height()].map(i64::from);
        // The first row is the farthest along y.
        let cell = |v: u8| if (195..=215).contains(&v) { None } else { Some(v < 128) };
        let cells = picture.rows().rev().flat_map(|row| row.map(|p| cell(p.0[0])).collect::<Vec<_>>()).collect();
        let [model_from_map, map_from_model] = ["model_from_map", "map_from_model"].map(|name| matrix(&about[name]));
        Some(Self { size, cells, model_from_map, map_from_model })
    }

    fn cell(&self, x: i64, y: i64) -> Option<bool> {
        let is_in = x >= 0 && y >= 0 && x < self.size[0] && y < self.size[1];
        if is_in { self.cells[(y * self.size[0] + x) as usize] } else { None }
    }

    fn in_model(&self, p: DVec2) -> DVec2 {
        (self.model_from_map * p.extend(1.0)).truncate()
    }

    /// The range of a beam in the model's frame; NaN where it ends in the unknown.
    fn cast(&self, from: DVec2, direction: DVec2) -> f64 {
        let p = (self.map_from_model * from.extend(1.0)).truncate() / RESOLUTION;
        let d = (self.map_from_model * direction.extend(0.0)).truncate();
        let mut cell = p.floor().to_array().map(|v| v as i64);
        let step = d.to_array().map(|v| if v > 0.0 { 1 } else { -1 });
        let delta = d.to_array().map(|v| 1.0 / v.abs());
        let beyond = |axis: usize| {
            let inside = p[axis] - p[axis].floor();
            delta[axis] * if step[axis] > 0 { 1.0 - inside } else { inside }
        };
        let mut next = [beyond(0), beyond(1)];
        let mut at = 0.0;
        while at * RESOLUTION < REACH {
            match self.cell(cell[0], cell[1]) {
                None => return f64::NAN,
                Some(true) => return at * RESOLUTION,
                Some(false) => {}
            }
            let axis = usize::from(next[1] < next[0]);
            at = next[axis];
            cell[axis] += step[axis];
            next[axis] += delta[axis];
        }
        f64::INFINITY
    }

    /// Metres from a point of the model's frame to the nearest cell that `counts`, up to `most`.
    fn distance(&self, p: DVec2, most: f64, counts: fn(Option<bool>) -> bool) -> f64 {
        let p = (self.map_from_model * p.extend(1.0)).truncate() / RESOLUTION;
        let reach = (most / RESOLUTION).ceil() as i64;
        let [x, y] = p.floor().to_array().map(|v| v as i64);
        let mut best = most;
        for (x, y) in (x - reach..=x + reach).flat_map(|x| (y - reach..=y + reach).map(move |y| (x, y))) {
            if counts(self.cell(x, y)) {
                best = best.min(RESOLUTION * (DVec2::new(x as f64 + 0.5, y as f64 + 0.5) - p).length());
            }
        }
        best
    }

    /// The shortest way between two cells through clear ones, cell by cell.
    fn path(&self, clear: &[bool], from: usize, to: usize) -> Option<Vec<usize>> {
        let width = self.size[0] as usize;
        let mut before = vec![usize::MAX; clear.len()];
        let mut next = VecDeque::from([to]);
        before[to] = to;
        while let Some(cell) = next.pop_front() {
            if cell == from {
                let mut path = vec![from];
                while path[path.len() - 1] != to {
                    path.push(before[path[path.len() - 1]]);
                }
                return Some(path);
            }
            // No clear cell is at the border.
            for beside in [
                cell - 1,
                cell + 1,
                cell - width,
                cell + width,
                cell - width - 1,
                cell - width + 1,
                cell + width - 1,
                cell + width + 1,
            ] {
                if clear[beside] && before[beside] == usize::MAX {
                    before[beside] = cell;
                    next.push_back(beside);
                }
            }
        }
        None
    }

    /// The cells where a robot fits.
    fn clear(&self) -> Vec<bool> {
        let place = |k: i64| DVec2::new((k % self.size[0]) as f64 + 0.5, (k / self.size[0]) as f64 + 0.5) * RESOLUTION;
        let is_clear = |k: i64| {
            self.cells[k as usize] == Some(false)
                && self.distance(self.in_model(place(k)), ROBOT, |cell| cell != Some(false)) >= ROBOT
        };
        (0..self.cells.len() as i64).map(is_clear).collect()
    }

    /// Poses 0.5 m apart on a way of 40 m between places of the published scans, drawn by a seed.
    fn way(&self, clear: &[bool], places: &[DVec2], seed: u64) -> Vec<Pose> {
        let mut random = Random(seed);
        let cell = |p: DVec2| {
            let [x, y] =
                ((self.map_from_model * p.extend(1.0)).truncate() / RESOLUTION).floor().to_array().map(|v| v as i64);
            (y * self.size[0] + x) as usize
        };
        let mut cells: Vec<usize> = Vec::new();
        while (cells.len() as f64) * RESOLUTION < 1.3 * STEP_M * SCANS as f64 {
            let to = cell(places[random.below(places.len())]);
            match cells.last() {
                _ if !clear[to] => {}
                None => cells.push(to),
                // From another part of the building no way leads on: begin there.
                Some(from) => match self.path(clear, *from, to) {
                    Some(path) => cells.extend(&path[1..]),
                    None => cells = vec![to],
                },
            }
        }
        let at = |k: &usize| {
            self.in_model(
                DVec2::new((k % self.size[0] as usize) as f64 + 0.5, (k / self.size[0] as usize) as f64 + 0.5)
                    * RESOLUTION,
            )
        };
        let points: Vec<DVec2> = cells.iter().map(at).collect();
        // Ways through cells turn by 45 degrees; the mean over half a metre does not.
        let smooth = |k: usize| {
            let window = &points[k.saturating_sub(SMOOTH)..(k + SMOOTH + 1).min(points.len())];
            window.iter().sum::<DVec2>() / window.len() as f64
        };
        let points: Vec<DVec2> = (0..points.len()).map(smooth).collect();
        let (mut poses, mut last) = (Vec::new(), points[0]);
        for pair in points.windows(SMOOTH + 1) {
            let (here, ahead) = (pair[0], pair[SMOOTH]);
            if (poses.is_empty() || here.distance(last) >= STEP_M) && ahead.distance(here) > 0.05 && poses.len() < SCANS
            {
                let toward = ahead - here;
                poses.push(Pose::from_xyz_rpy(here.extend(0.0), 0.0, 0.0, toward.y.atan2(toward.x)));
                last = here;
            }
        }
        poses
    }
}

fn scanner() -> Sensor {
    let spec = sensor_toml::parse(SCANNER, "willow", None).expect("a sensor");
    Sensor::new(spec).expect("a sound sensor")
}

/// The scans of a drive, with the true poses.
fn drive(map: &Map, way: &[Pose], sensor: &Sensor, seed: u64) -> Vec<(Frame, Pose)> {
    let mut random = Random(seed ^ 0x7769_6c6c);
    let mut frames: Vec<(Frame, Pose)> = Vec::new();
    for (k, pose) in way.iter().enumerate() {
        let pose = *pose;
        let ranges = (0..sensor.width()).map(|c| {
            let ray = pose.rotation * sensor.ray(c, 0).expect("a ray");
            let z = map.cast(pose.translation.truncate(), ray.truncate());
            (z + random.normal(0.01)) as f32
        });
        let ranges = ranges.map(|z| if z < 0.05 { f32::NEG_INFINITY } else { z }).collect();
        let mut frame = Frame::new(STEP * k as f64, sensor.clone(), Measurement::Range(ranges)).expect("a sound frame");
        frame.motion = frames.last().map(|(_, before)| {
            let mut motion = before.inverse() * pose;
            motion.translation *= 1.0 + random.normal(0.02);
            Motion::of_odometry(motion, &OdometryNoise::default())
        });
        frames.push((frame, pose));
    }
    frames
}

/// The share of beams that end within [`NEAR`] of the model, per cent.
fn explained(world: &World, drives: &[Vec<(Frame, Pose)>]) -> f64 {
    let caster = RayCaster::new(world, "laser");
    let (mut all, mut near) = (0usize, 0usize);
    for (frame, pose) in drives.iter().flatten() {
        let sensor = frame.sensor();
        let pose = *pose * sensor.spec().mount;
        for (c, z) in (0..sensor.width()).zip(frame.ranges()).filter(|(_, z)| z.is_finite()) {
            let ray = pose.rotation * sensor.ray(c, 0).expect("a ray");
            let met = caster.cast(pose.translation, ray, REACH, None);
            all += 1;
            near += usize::from(met.is_some_and(|met| (met.range - f64::from(*z)).abs() <= NEAR.0));
        }
    }
    100.0 * near as f64 / all.max(1) as f64
}

/// The share of beams that end within [`NEAR`] of where beams of other drives ended, per cent.
fn seen_before(drives: &[Vec<(Frame, Pose)>], others: &[Vec<(Frame, Pose)>]) -> f64 {
    let ends = |drives: &[Vec<(Frame, Pose)>]| -> Vec<DVec2> {
        let of_frame = |(frame, pose): &(Frame, Pose)| -> Vec<DVec2> {
            let sensor = frame.sensor();
            let read = (0..sensor.width()).zip(frame.ranges()).filter(|(_, z)| z.is_finite());
            let end = |(c, z): (u32, &f32)| {
                *pose
                    * sensor.spec().mount
                    * Pose { translation: f64::from(*z) * sensor.ray(c, 0).expect("a ray"), ..Pose::IDENTITY }
            };
            read.map(|at| end(at).translation.truncate()).collect()
        };
        drives.iter().flatten().flat_map(of_frame).collect()
    };
    let cell = |p: DVec2| (p / NEAR.0).floor().to_array().map(|v| v as i64);
    let known: BTreeSet<[i64; 2]> = ends(others).into_iter().map(cell).collect();
    let all = ends(drives);
    let near = |p: &&DVec2| {
        let [x, y] = cell(**p);
        (x - 1..=x + 1).any(|x| (y - 1..=y + 1).any(|y| known.contains(&[x, y])))
    };
    100.0 * all.iter().filter(near).count() as f64 / all.len().max(1) as f64
}

/// Where drives put the robot: scans within 0.5 m and 5 degrees of the truth, all, and those said to be tracked that
/// are farther off.
fn localized(world: &World, drives: &[Vec<(Frame, Pose)>]) -> (usize, usize, usize) {
    let (mut good, mut all, mut wrong) = (0, 0, 0);
    for drive in drives {
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("a predictor");
        let options =
            EstimateOptions::of(drive[0].0.sensor()).with_freedom(Freedom::Planar).with_stated_sigma(Some(MODEL));
        let prior = PoseEstimate::of_sigmas(RobotPose::new(drive[0].1), 0.05, 2f64.to_radians());
        let mut robot = Localizer::new(Estimator::new(predictor, options), prior, LocalizeOptions::default());
        for (frame, truth) in drive {
            let step = robot.step(world, frame).expect("a step");
            let pose = step.pose.world_from_robot;
            let off = (pose.translation.distance(truth.translation), pose.rotation.angle_between(truth.rotation));
            let is_good = off.0 < 0.5 && off.1 < 5f64.to_radians();
            all += 1;
            good += usize::from(is_good && step.phase == Phase::Tracking);
            wrong += usize::from(!is_good && step.phase == Phase::Tracking);
        }
    }
    (good, all, wrong)
}

/// Points every 0.1 m where an object is cut at the height of the scanner, with the number of its part's cell of 0.5 m.
fn cut(environment: &Environment, object: &str, bounds: &Aabb) -> Vec<DVec2> {
    let o = environment.object(object).expect("the object exists");
    let mut points = Vec::new();
    for polygon in 0..o.mesh.polygon_count() as u32 {
        let corners = o.polygon_in_world(polygon);
        let sides = (0..corners.len()).map(|k| (corners[k], corners[(k + 1) % corners.len()]));
        let crossing = sides.filter(|(a, b)| (a.z - HEIGHT) * (b.z - HEIGHT) < 0.0);
        let ends: Vec<DVec3> = crossing.map(|(a, b)| a + (HEIGHT - a.z) / (b.z - a.z) * (b - a)).collect();
        let [a, b] = ends[..] else { continue };
        let count = (a.distance(b) / 0.1).ceil().max(1.0) as u32;
        let all = (0..=count).map(|k| a + f64::from(k) / f64::from(count) * (b - a));
        let back = o.world_from_object.inverse();
        let inside = |p: &DVec3| {
            let q = back.transform_point(*p);
            q.cmpge(bounds.min - 1e-6).all() && q.cmple(bounds.max + 1e-6).all()
        };
        points.extend(all.filter(inside).map(|p| p.truncate()));
    }
    points
}

/// Pieces of wall of 0.5 m that were found missing, and the number of pieces that are farther than [`NEAR`] from
/// anything real, in the median.
fn missing(map: &Map, environment: &Environment, findings: &SiteFindings) -> (usize, usize) {
    let (mut all, mut right) = (0, 0);
    for finding in &findings.changes {
        let bounds = match &finding.kind {
            FindingKind::Part(bounds) => *bounds,
            FindingKind::Gone => Aabb { min: DVec3::splat(-1e6), max: DVec3::splat(1e6) },
            _ => continue,
        };
        let mut pieces: BTreeMap<[i64; 2], Vec<f64>> = BTreeMap::new();
        for p in cut(environment, &finding.object, &bounds) {
            pieces.entry((p / 0.5).floor().to_array().map(|v| v as i64)).or_default().push(map.distance(
                p,
                1.0,
                |cell| cell == Some(true),
            ));
        }
        for mut distances in pieces.into_values() {
            distances.sort_by(f64::total_cmp);
            all += 1;
            right += usize::from(distances[distances.len() / 2] > NEAR.1);
        }
    }
    (all, right)
}

fn published() -> serde_json::Value {
    let path = data::file("lidar2d/willow.json").expect("the data were there");
    serde_json::from_str(&std::fs::read_to_string(path).expect("text")).expect("JSON")
}

fn pose_of(scan: &serde_json::Value) -> (DVec2, f64) {
    let [x, y, yaw] = ["x", "y", "yaw"].map(|name| scan["pose_in_model"][name].as_f64().expect("a number"));
    (DVec2::new(x, y), yaw)
}

/// The places of the scans that were published with the map.
fn places() -> Vec<DVec2> {
    published()["scans"].as_array().expect("a list").iter().map(|scan| pose_of(scan).0).collect()
}

/// The median difference between ranges cast here and those published with the map, metres: the casts are right if it
/// is a cell or less.
fn beside_published(map: &Map) -> f64 {
    let mut off = Vec::new();
    for scan in published()["scans"].as_array().expect("a list") {
        let (place, yaw) = pose_of(scan);
        let valid = scan["valid"].as_str().expect("text").chars().enumerate().filter(|(_, valid)| *valid == '1');
        for (k, _) in valid {
            let ray = DVec2::from_angle(yaw + (k as f64 - 180.0).to_radians());
            off.push((map.cast(place, ray) - scan["ranges"][k].as_f64().expect("a number")).abs());
        }
    }
    off.sort_by(f64::total_cmp);
    off[off.len() / 2]
}

/// Learns from six drives, and judges by four others.
pub fn run(folder: &str, (model_sigma, metres): (f64, f64)) {
    let (Some(map), Some(model)) = (Map::open(), data::scene("office_willowgarage", true)) else { return };
    let (sensor, clear, places) = (scanner(), map.clear(), places());
    let made = |seed: u64| drive(&map, &map.way(&clear, &places, seed), &sensor, seed);
    let drives: Vec<_> = (1..=DRIVES.0 + DRIVES.1).map(made).collect();
    println!("casts differ from published ones by {:.3} m in the median", beside_published(&map));
    let (teaching, judging) = drives.split_at(DRIVES.0 as usize);
    if folder != "-" {
        write(Path::new(folder), teaching).expect("logs can be written");
    }
    let options = LearnOptions::default().with_model_sigma(model_sigma).with_views(SCANS * DRIVES.0 as usize);
    let mut learner = Learner::new(options).expect("sound options");
    let radians = 0.1 * metres;
    let covariance = PoseCovariance::from_sigmas([metres, metres, 1e-3, 1e-3, 1e-3, radians]);
    for drive in teaching {
        for (frame, pose) in drive {
            learner
                .observe_at(&model, &[frame], &PoseEstimate::new(RobotPose::new(*pose), covariance))
                .expect("a view");
        }
        learner.end_drive();
    }
    let findings = learner.findings(&model);
    let mut after = model.clone();
    findings.changes.iter().for_each(|finding| drop(after.apply_unchecked(finding.change(&after))));
    let count = |is: fn(&FindingKind) -> bool| findings.changes.iter().filter(|f| is(&f.kind)).count();
    let news = findings.changes.iter().filter_map(|f| if let FindingKind::New(b) = &f.kind { Some(b) } else { None });
    // A box without anything real in it, or at its sides, is wrong.
    let is_wrong = |b: &&presight_update::UprightBox| {
        let (half, rotation) = (0.5 * b.size + 0.1, b.pose.rotation);
        let steps = |h: f64| (-20..=20).map(move |k| h * f64::from(k) / 20.0);
        !steps(half.x).any(|x| {
            steps(half.y).any(|y| {
                map.distance((b.pose.translation + rotation * DVec3::new(x, y, 0.0)).truncate(), 0.1, |cell| {
                    cell == Some(true)
                }) < 0.05
            })
        })
    };
    let (all, wrong) = (news.clone().count(), news.filter(is_wrong).count());
    println!("wrong: {:?}; {:?}", findings.wrong, learner.tally());
    println!(
        "{} gone, {} moved, {} parts gone, {} doubts, {} confirmed, {} never seen",
        count(|w| matches!(w, FindingKind::Gone)),
        count(|w| matches!(w, FindingKind::Moved { .. })),
        count(|w| matches!(w, FindingKind::Part(_))),
        findings.doubts.len(),
        findings.confirmed.len(),
        findings.unseen
    );
    println!(
        "beams of {} other drives within {} m: {:.1} % before, {:.1} % after",
        DRIVES.1,
        NEAR.0,
        explained(&model, judging),
        explained(&after, judging)
    );
    println!("of these, {:.1} % end where the drives that teach saw something", seen_before(judging, teaching));
    let (pieces, right) = missing(&map, model.environment(), &findings);
    println!("pieces of wall found missing: {pieces}, {right} farther than {} m from anything real", NEAR.1);
    println!("new boxes: {all}, {wrong} without anything real");
    for (name, world) in [("before", &model), ("after", &after)] {
        let (good, all, wrong) = localized(world, judging);
        println!(
            "localization {name}: {good} of {all} scans tracked within 0.5 m and 5 degrees, {wrong} tracked elsewhere"
        );
    }
}

/// The logs and poses of drives, for `presight update`.
pub fn write(folder: &Path, drives: &[Vec<(Frame, Pose)>]) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    let mut poses = String::new();
    for (number, drive) in drives.iter().enumerate() {
        // One list of poses holds all drives.
        let shift = 1000.0 * number as f64;
        let mut text = lines::header(drive[0].0.sensor().spec()) + "\n";
        for (frame, pose) in drive {
            let (t, q, time) = (pose.translation, pose.rotation, frame.stamp + shift);
            poses += &format!("{time} {} {} {} {} {} {} {}\n", t.x, t.y, t.z, q.x, q.y, q.z, q.w);
            let odometry = frame.motion.as_ref().map(|motion| motion.previous_from_current);
            let range = frame.ranges().to_vec();
            let frame = LogFrame { odometry, reference: Some(RobotPose::new(*pose)), ..LogFrame::new(time, range) };
            text += &(lines::line(&frame).expect("a sound frame") + "\n");
        }
        std::fs::write(folder.join(format!("drive{}.jsonl", number + 1)), text)?;
    }
    std::fs::write(folder.join("poses.tum"), poses)
}
