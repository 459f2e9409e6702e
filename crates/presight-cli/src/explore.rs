//! `presight explore`: a model of an environment from what a sensor measured there.

use super::bag_args::LogArgs;
#[cfg(feature = "ros")]
use super::output_bag::OutputBag;
use super::outputs::{OutputFiles, check_no_dash};
use super::pose::parse_pose;
use super::sensor_args::SensorArgs;
use super::{CommandOutcome, open_scene, print};
use presight::environment::{Environment, IndexKind};
use presight::explore::{Exploration, ExploreOptions, Follower, Known, Views};
use presight::files::{self, ImportOptions, LogFrames, Observation, StampedPose};
#[cfg(feature = "ros")]
use presight::ros::model;
use presight::store::{self, Note, Store};
use presight::{Error, Pose, Result, RobotPose, Sensor, Threads};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

const EXAMPLES: &str = "Examples:
  presight explore livingroom --sensor camera.toml --out room.presight
  presight explore monday.jsonl tuesday.jsonl --sensor monday/sensor.toml --map scenes/room.glb \\
    --out rough.presight
  presight explore wednesday.jsonl --sensor monday/sensor.toml --out rough.presight
  presight explore scans.json --wall-height 2.5 --polygons 200 --out corridor.presight
  presight localize thursday.jsonl --map rough.presight --sensor monday/sensor.toml \\
    --init reference --out followed.tum";

/// A rough model that leaves this share of the points unexplained may show another place.
const STRANGE: f64 = 0.8;

/// Explore an environment: logs with poses become a stored model of convex polygons
///
/// Measured points become planes, planes become convex polygons where rays ended on them, and connected polygons become
/// objects: floor/0001, wall/0001, ceiling/0001, explored/0001 and so on. Space that rays crossed, and space that no
/// ray reached, gets no surface. Scans of one row become upright walls. With --map a rough model is corrected first. An
/// existing STORE is extended. The exploration is one change of the store, which `presight env undo` takes back.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The logs, whose poses are in one frame
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,

    /// A rough model: its surfaces move to the ends of the rays, and surfaces that rays cross are opened
    #[arg(long, value_name = "SCENE")]
    map: Option<PathBuf>,

    /// The store (.presight); an existing one is extended
    #[arg(long, value_name = "STORE")]
    out: PathBuf,

    /// Write a ROS 2 bag: the polygons as markers on /presight/model, as they stand after each log; with --init at the
    /// end
    #[cfg(feature = "ros")]
    #[arg(long, value_name = "OUT.mcap")]
    mcap: Option<PathBuf>,

    /// Poses of the robot: `log` for the poses in the log, or lines of timestamp tx ty tz qx qy qz qw
    #[arg(long, value_name = "log|FILE.tum", default_value = "log")]
    poses: String,

    /// Compute the poses, each frame against the model so far, from this pose of the robot at the first frame:
    /// x,y,z,roll_deg,pitch_deg,yaw_deg or x,y,z,qx,qy,qz,qw, or `reference` for the log's first pose
    #[arg(long, value_name = "POSE", allow_hyphen_values = true, conflicts_with = "poses")]
    init: Option<String>,

    /// The sensor, with its noise and mount [default: from the log]
    #[arg(long, value_name = "PRESET|FILE")]
    sensor: Option<String>,

    #[command(flatten)]
    image: SensorArgs,

    #[command(flatten)]
    reading: LogArgs,

    /// Use every N-th column and row
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    stride: u32,

    /// Maximum number of polygons that a run adds
    #[arg(long, value_name = "N", default_value_t = 2000)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    polygons: u32,

    /// Size of the smallest pieces of surface that are distinguished, metres [default: what the noise of the ranges,
    /// the distance of neighbouring points and the number of frames allow, 0.02 at least]
    #[arg(long, value_name = "METRES")]
    detail: Option<f64>,

    /// Height of the walls that scans of one row show, metres
    #[arg(long, value_name = "METRES", default_value_t = 2.5)]
    wall_height: f64,

    /// Height of the floor below these walls, and of the poses of a document of planar scans, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.0, allow_hyphen_values = true)]
    floor: f64,

    /// Time of the change, UTC seconds, for the log of the store [default: now]
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    time: Option<f64>,

    /// CPU threads, 0 = all cores
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
}

/// Runs the command.
///
/// # Errors
/// Errors from reading the logs, the model and the store, from exploring, and from writing.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    args.check()?;
    check_no_dash(&args.out)?;
    let exists = args.out.exists();
    let mut files = OutputFiles::default();
    files.add_any(&args.out)?;
    #[cfg(feature = "ros")]
    let mut bag = OutputBag::of("--mcap", args.mcap.as_deref(), &mut files)?;
    let poses = (args.poses != "log").then(|| PathBuf::from(&args.poses));
    let sensor = args.sensor.iter().map(Path::new);
    let inputs = args.logs.iter().chain(&args.map).chain(&poses).map(PathBuf::as_path);
    files.check_named(inputs.chain(sensor))?;
    let threads = Threads::from(args.threads).started()?;
    let options = ExploreOptions::default()
        .with_polygons(args.polygons as usize)
        .with_detail(args.detail)
        .with_wall_height(args.wall_height)
        .with_floor(args.floor)
        .with_threads(threads.clone());
    let (known, kind) = args.known(exists, &threads)?;
    let sensor = args.sensor.as_deref().map(|sensor| args.image.load(sensor)).transpose()?;
    let poses = poses.map(|file| files::read_tum(&file).map_err(|e| e.in_file(&file))).transpose()?;
    let mut views = Views::default();
    match &args.init {
        Some(init) => views = args.follow(init, sensor.as_ref(), (&known, kind), &options)?,
        None => {
            for log in &args.logs {
                args.add(log, sensor.as_ref(), poses.as_deref(), &mut views).map_err(|e| e.in_file(log))?;
                #[cfg(feature = "ros")]
                if let Some(bag) = bag.as_mut().filter(|_| args.logs.last() != Some(log)) {
                    // A first log alone may show nothing flat.
                    let found = Exploration::of(&known, kind, &views, &options).ok();
                    found.map_or(Ok(()), |found| show(bag, &found))?;
                }
            }
        }
    }
    let found = Exploration::of(&known, kind, &views, &options)?;
    if kind == Known::Rough && found.unexplained > STRANGE {
        print::notices(&[format!(
            "the model explains {:.0} % of the points: is it of this place, in metres, and in the frame of the poses?",
            100.0 * (1.0 - found.unexplained)
        )]);
    }
    #[cfg(feature = "ros")]
    if let Some(bag) = &mut bag {
        show(bag, &found)?;
        bag.finish()?;
    }
    let note = args.note()?;
    drop(files);
    if !exists {
        let from = args.map.as_ref().map_or_else(String::new, |map| format!(" from {}", map.display()));
        store::create(&args.out, &known, &Note::new(format!("exploration{from}"), note.time))?;
    }
    let mut store = Store::open(&args.out)?;
    let number = store.apply(found.change(&store)?, &note)?;
    print::data(&report(&found, &views, number))?;
    Ok(CommandOutcome::Done)
}

/// Adds the polygons so far.
#[cfg(feature = "ros")]
fn show(bag: &mut OutputBag, found: &Exploration) -> Result<()> {
    bag.add([model(found.environment(), "map", (found.stamp() * 1e9).round() as i64)?])
}

impl Args {
    fn check(&self) -> Result<()> {
        let lengths =
            self.detail.map(|detail| ("--detail", detail)).into_iter().chain([("--wall-height", self.wall_height)]);
        if let Some((flag, length)) = lengths.into_iter().find(|(_, l)| !(*l > 0.0 && l.is_finite())) {
            return Err(Error::usage(format!("{flag} {length}"), "give a finite length above 0, metres"));
        }
        if !self.floor.is_finite() {
            return Err(Error::usage(format!("--floor {}", self.floor), "give a finite height, metres"));
        }
        match self.time.filter(|t| !t.is_finite()) {
            Some(time) => Err(Error::usage(format!("--time {time}"), "give finite UTC seconds")),
            None => Ok(()),
        }
    }

    fn note(&self) -> Result<Note> {
        let now = || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64());
        let logs: Vec<String> = self.logs.iter().map(|log| log.display().to_string()).collect();
        Ok(Note::new(format!("explore of {}", logs.join(", ")), self.time.unwrap_or_else(now)))
    }

    /// The model before the run: the store, the rough model, or nothing.
    fn known(&self, exists: bool, threads: &Threads) -> Result<(Environment, Known)> {
        let import = ImportOptions { threads: threads.clone(), ..ImportOptions::default() };
        if exists {
            let info = store::info(&self.out)?;
            let Some(map) = &self.map else { return Ok((info.environment, Known::Explored)) };
            // A run that was killed before its change leaves the store as it was created.
            if info.changes > 0 || info.cause != format!("exploration from {}", map.display()) {
                let remedy = "leave out --map to explore on in the store, or give another --out";
                return Err(Error::usage("--map: the store has a model already", remedy).in_file(&self.out));
            }
            return Ok((info.environment, Known::Rough));
        }
        let Some(map) = &self.map else { return Ok((Environment::new(), Known::Explored)) };
        let scene = open_scene(map, &import, IndexKind::None)?;
        Ok((std::sync::Arc::unwrap_or_clone(scene.world.into_environment()), Known::Rough))
    }

    /// The frames of the logs, each at the pose that the model so far gives.
    fn follow(
        &self,
        init: &str,
        sensor: Option<&Sensor>,
        (known, kind): (&Environment, Known),
        options: &ExploreOptions,
    ) -> Result<Views> {
        let mut start = if init == "reference" {
            None
        } else {
            Some(RobotPose::new(parse_pose(init).map_err(|e| e.at("--init"))?))
        };
        let mut follower: Option<Follower> = None;
        for log in &self.logs {
            let mut frames = self.reading.open(log, sensor, &Default::default())?;
            for observation in frames.by_ref() {
                let Observation { frame, reference, .. } = observation?;
                let frame = if self.stride > 1 { frame.thinned(self.stride)? } else { frame };
                let first = match start.or(reference) {
                    Some(pose) => *start.insert(pose),
                    None => {
                        let remedy = "give --init x,y,z,roll_deg,pitch_deg,yaw_deg";
                        return Err(Error::invalid("the first frame has no pose", remedy).in_file(log));
                    }
                };
                let follower = match &mut follower {
                    Some(follower) => follower,
                    None => follower.insert(Follower::new(first, known.clone(), kind, options)?),
                };
                let place = |e: Error| e.at(format!("the frame at {} s", frame.stamp)).in_file(log);
                follower.add(&frame).map_err(place)?;
            }
            notices_of(log, &frames);
        }
        let Some(mut follower) = follower else {
            return Err(Error::invalid("the log has no frames", "give a log with frames").in_file(&self.logs[0]));
        };
        follower.finish()?;
        print::notices(&apart(&follower.apart()));
        let [x, y, z, a, b, c] = follower.drift();
        let (metres, degrees) = ((x * x + y * y + z * z).sqrt(), (a * a + b * b + c * c).sqrt().to_degrees());
        print::notices(&[format!(
            "drift from the first frame to the last, one standard deviation: {metres:.4} m, {degrees:.3} deg"
        )]);
        Ok(follower.into_views())
    }

    /// Adds the frames of a log that have a pose.
    fn add(&self, log: &Path, sensor: Option<&Sensor>, poses: Option<&[StampedPose]>, views: &mut Views) -> Result<()> {
        let frames = self.reading.open(log, sensor, &Default::default())?;
        // The poses that place the scans also say how the robot moved meanwhile.
        let mut frames = match poses {
            None => frames.moving_by_reference(),
            Some(poses) => frames.moving_along(poses).map_err(|e| e.at("--poses"))?,
        };
        let is_planar = frames.has_planar_poses();
        let (mut without, mut count, mut steps) = (0, 0, Vec::new());
        let mut before: Option<(f64, Pose)> = None;
        for observation in frames.by_ref() {
            let Observation { frame, reference, .. } = observation?;
            let pose = match poses {
                None => reference.map(|robot| robot.world_from_robot()),
                Some(poses) => pose_at(poses, frame.stamp),
            };
            let Some(mut pose) = pose else {
                without += 1;
                continue;
            };
            if is_planar {
                pose.translation.z = self.floor;
            }
            if let Some((_, earlier)) = before.replace((frame.stamp, pose)) {
                steps.push((earlier.translation.distance(pose.translation), frame.stamp));
            }
            let frame = if self.stride > 1 { frame.thinned(self.stride)? } else { frame };
            views.push(&frame, RobotPose::new(pose).sensor(frame.sensor()))?;
            count += 1;
        }
        if count == 0 {
            let remedy = "give --poses FILE.tum with the robot's poses at the times of the frames";
            return Err(Error::invalid("no frame has a pose", remedy));
        }
        notices_of(log, &frames);
        if without > 0 {
            print::notices(&[format!("{}: {without} frames without a pose are left out", log.display())]);
        }
        if let Some((step, stamp)) = jump(&steps) {
            let what = format!("{}: the poses jump by {step:.2} m at {stamp} s; surfaces may be double", log.display());
            print::notices(&[what]);
        }
        Ok(())
    }
}

/// Prints how the readings of a log were interpreted, and which times or motions of its scans are unknown.
fn notices_of(log: &Path, frames: &LogFrames) {
    let notices = frames.notices();
    print::notices(&notices.iter().map(|notice| format!("{}: {notice}", log.display())).collect::<Vec<_>>());
}

/// The notices of frames outside of the first one's group.
fn apart(groups: &[Vec<f64>]) -> Vec<String> {
    let (alone, together): (Vec<&Vec<f64>>, Vec<_>) = groups.iter().partition(|group| group.len() == 1);
    let group = |stamps: &Vec<f64>| {
        let (first, last) = stamps.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(*t), b.max(*t)));
        format!(
            "{} frames from {first} s to {last} s are left out, because no frame connects them with the first frame: \
             explore them into another store",
            stamps.len()
        )
    };
    let mut notices: Vec<String> = together.into_iter().map(group).collect();
    if !alone.is_empty() {
        let stamps: Vec<String> = alone.iter().map(|stamps| format!("{} s", stamps[0])).collect();
        let what = format!("{} frames show no known surface and are left out: {}", alone.len(), stamps.join(", "));
        notices.push(what);
    }
    notices
}

/// A step that is far longer than the others, with its time.
fn jump(steps: &[(f64, f64)]) -> Option<(f64, f64)> {
    let mut lengths: Vec<f64> = steps.iter().map(|s| s.0).collect();
    let usual = presight::tools::median(&mut lengths)?;
    let longest = *steps.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    (longest.0 > 10.0 * usual + 0.5).then_some(longest)
}

/// The pose at a time: of the line with that time, or between the lines before and after it, at most a second apart.
fn pose_at(poses: &[StampedPose], time: f64) -> Option<Pose> {
    let after = poses.partition_point(|p| p.time < time - 1e-6);
    let next = poses.get(after)?;
    if (next.time - time).abs() <= 1e-6 {
        return Some(next.pose);
    }
    let last = poses.get(after.checked_sub(1)?)?;
    let share = (time - last.time) / (next.time - last.time);
    (next.time - last.time <= 1.0).then(|| last.pose.between(&next.pose, share))
}

fn report(found: &Exploration, views: &Views, number: u64) -> String {
    let mut text = format!(
        "{} frames: {} objects with {} polygons are new; {:.1} % of the points were not known\n",
        views.all().len(),
        found.objects.len(),
        found.polygons(),
        100.0 * found.unexplained
    );
    let areas = found.areas;
    text += &format!(
        "surface {:.2} m2; adjacent: open {:.2} m2, unobserved {:.2} m2\n",
        areas.surface, areas.open, areas.unseen
    );
    if found.parts.len() > 1 {
        let areas: Vec<String> = found.parts.iter().take(5).map(|area| format!("{area:.2} m2")).collect();
        text += &format!("{} parts that no chain of frames joins: {}\n", found.parts.len(), areas.join(", "));
    }
    if found.mirrored > 0 {
        text += &format!("{} points are images in mirrors and are left out\n", found.mirrored);
    }
    if found.opened > 0.0 {
        text += &format!("{:.2} m2 of the known surfaces are open now\n", found.opened);
    }
    for path in &found.gone {
        text += &format!("{path}: no surface is left\n");
    }
    text += &format!("change {number}\n");
    text
}
