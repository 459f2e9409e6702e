//! `presight simulate`: a simulated log of a robot's depth camera or scanner on a drive.

#[cfg(feature = "ros")]
use super::output_bag::OutputBag;
use super::outputs::OutputFiles;
use super::sensor_args::SensorArgs;
use super::{CommandOutcome, open_scene, print};
use presight::environment::IndexKind;
use presight::files::{self, ImportOptions, LogFrame, StampedPose, load_sensor};
use presight::measured::{Frame, ScanMotion};
#[cfg(feature = "ros")]
use presight::ros::{MessageOrigin, Record, sensed};
use presight::simulate::{Disturbances, GreySimulator, Simulator, Walkers, displace};
use presight::tools::{create_folder, write_atomically};
use presight::{Backend, Error, Images, Options, Pose, Predictor, Result, RobotPose, Scene, Sensor, Threads, Twist};
use presight_pictures as png;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight simulate hall.glb --sensor laser-range-camera --poses drive.tum --out scanned
  presight localize scanned/scans.jsonl --map hall.glb --init reference --out scanned.tum
  presight simulate scenes/docking.rhai --sensor laser-scanner --intensities --poses bay.tum \\
    --out docked
  presight localize docked/scans.jsonl --map scenes/docking.rhai --own-features --init reference \\
    --out docked.tum
  presight features scenes/room.glb --class video --out edges.json
  presight simulate scenes/room.glb --sensor camera.toml --grey video.toml --poses room.tum \\
    --out seen
  presight localize seen --map scenes/room.glb --sensor seen/sensor.toml --layer edges.json \\
    --init reference --out seen.tum";

/// File name of a scanner's log.
const SCANS: &str = "scans.jsonl";
/// Blur of a camera in focus, one standard deviation, pixels.
const BLUR: f64 = 0.7;

/// Simulate a log: depth images or scans of a drive with noise, drop-outs and mixed pixels, and the true poses
///
/// DIR gets the files that `localize` reads - camera.json, depth/*.png, poses.txt, or scans.jsonl for a scanner - and
/// sensor.toml. Depths are in millimetres, rounded. With --grey it also gets grey images of a second camera, grey/*.png
/// and grey.toml, lit from that camera. The same seed gives the same log. A sensor whose rays take time (`turn_s`) is
/// moved while it measures, as the robot moves from each pose to the next.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The model: a .glb or .gltf file, a .rhai script, or a store
    scene: PathBuf,

    /// The camera or scanner, with its noise and mount
    #[arg(long, value_name = "PRESET|FILE")]
    sensor: String,

    #[command(flatten)]
    image: SensorArgs,

    /// Also simulate grey images of this camera
    #[arg(long, value_name = "PRESET|FILE")]
    grey: Option<String>,

    /// Noise of the grey images, one standard deviation; 1 is white
    #[arg(long, value_name = "VALUE", default_value_t = 0.01)]
    grey_noise: f64,

    /// Also write the intensities of a scanner's echoes
    #[arg(long)]
    intensities: bool,

    /// Noise of the intensities, one standard deviation; 1 is a retro-reflector
    #[arg(long, value_name = "VALUE", default_value_t = 0.03, requires = "intensities")]
    intensity_noise: f64,

    /// Poses of the robot: lines of timestamp tx ty tz qx qy qz qw; times at least 0 for cameras, rising for scanners
    #[arg(long, value_name = "FILE.tum")]
    poses: PathBuf,

    /// Write the log into this folder
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Also write the log as a ROS 2 bag: /tf, /tf_static, and scan and points, or depth and camera_info
    #[cfg(feature = "ros")]
    #[arg(long, value_name = "OUT.mcap")]
    mcap: Option<PathBuf>,

    /// Seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,

    /// Fraction of pixels without a measurement
    #[arg(long, value_name = "SHARE", default_value_t = Disturbances::default().drop_outs)]
    drop_outs: f64,

    /// Fraction of edge pixels that measure a range between the two surfaces
    #[arg(long, value_name = "SHARE", default_value_t = Disturbances::default().mixed_pixels)]
    mixed_pixels: f64,

    /// Move every object by this distance in a random direction, so that the scene differs from its model
    #[arg(long, value_name = "METRES", default_value_t = 0.0)]
    displace: f64,

    /// Number of people who walk to and fro near the robot
    #[arg(long, value_name = "N", default_value_t = 0)]
    walkers: usize,

    /// Height of the robot's poses above the floor, on which the people stand
    #[arg(long, value_name = "METRES", default_value_t = 0.0)]
    height: f64,

    /// CPU threads, 0 = all cores
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
}

/// Runs the command.
///
/// # Errors
/// Errors from reading the scene, sensor and poses, and from writing.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let mut files = OutputFiles::default();
    files.add_folder(&args.out, &["camera.json", "odometry.txt", "poses.txt", "sensor.toml", "grey.toml", SCANS])?;
    #[cfg(feature = "ros")]
    let mut bag = OutputBag::of("--mcap", args.mcap.as_deref(), &mut files)?;
    #[cfg(feature = "ros")]
    let mut driven = Pose::IDENTITY;
    let sensors = [Some(&args.sensor), args.grey.as_ref()].into_iter().flatten().map(Path::new);
    files.check_named([args.scene.as_path(), args.poses.as_path()].into_iter().chain(sensors))?;
    let sensor = args.image.load(&args.sensor)?;
    args.check_flags(&sensor)?;
    let camera = sensor.is_camera().then(|| files::camera_json(&sensor)).transpose()?;
    let poses = files::read_tum(&args.poses)?;
    args.check_times(&poses, &sensor)?;
    let threads = Threads::from(args.threads).started()?;
    let import = ImportOptions { threads: threads.clone(), ..ImportOptions::default() };
    let mut scene = open_scene(&args.scene, &import, IndexKind::default())?;
    print::far_outside(&scene, poses.iter().map(|p| p.pose.translation));
    let disturbances = Disturbances::default().with_drop_outs(args.drop_outs).with_mixed_pixels(args.mixed_pixels);
    let mut grey = args.grey_simulator(&threads)?;
    let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(threads))?;
    let mut simulator = Simulator::new(predictor, sensor.clone(), disturbances, args.seed)?;
    if args.intensities {
        simulator = simulator.with_intensities(args.intensity_noise)?;
    }
    displace(&mut scene.world, args.displace, args.seed)?;
    let path: Vec<RobotPose> = poses.iter().map(|p| RobotPose::new(p.pose)).collect();
    let walkers = Walkers::new(&mut scene.world, &path, args.height, args.walkers, args.seed)?;
    files.check_scene(&scene.files)?;
    create_folder(&args.out)?;
    let mut done = 0;
    let mut next = |scene: &mut Scene, pose: &StampedPose| -> Result<Frame> {
        walkers.walk(&mut scene.world, pose.time)?;
        let motion = motion_at(&poses, done, &sensor);
        done += 1;
        let robot = RobotPose::new(pose.pose);
        let frame = simulator.frame_in_motion(&scene.world, pose.time, &robot, motion.as_ref())?;
        #[cfg(feature = "ros")]
        if let Some(bag) = &mut bag {
            let since = frame.motion.map_or(Pose::IDENTITY, |motion| motion.previous_from_current);
            driven = driven * since;
            bag.add(records(&frame, &pose.pose, driven, bag.is_empty())?)?;
        }
        Ok(frame)
    };
    match &camera {
        None => write_scans(&args.out.join(SCANS), &sensor, &poses, |pose| next(&mut scene, pose))?,
        Some(camera) => {
            create_folder(&args.out.join("depth"))?;
            if grey.is_some() {
                create_folder(&args.out.join("grey"))?;
            }
            let mut odometry =
                String::from("# time tx ty tz qx qy qz qw: the robot by its odometry, body axes, z up, metres\n");
            let mut driven = Pose::IDENTITY;
            for pose in &poses {
                let frame = next(&mut scene, pose)?;
                driven = driven * frame.motion.map_or(Pose::IDENTITY, |motion| motion.previous_from_current);
                let (t, q) = (driven.translation, driven.rotation);
                odometry += &format!("{:.6} {} {} {} {} {} {} {}\n", pose.time, t.x, t.y, t.z, q.x, q.y, q.z, q.w);
                write_images(&args.out, &frame, grey.as_mut(), &scene, pose)?;
            }
            if poses.is_sorted_by(|a, b| a.time < b.time) {
                write_text(&args.out.join("odometry.txt"), &odometry)?;
            }
            write_text(&args.out.join("camera.json"), camera)?;
            write_text(&args.out.join("poses.txt"), &files::poses_txt(&sensor, &poses))?;
        }
    }
    #[cfg(feature = "ros")]
    bag.iter_mut().try_for_each(OutputBag::finish)?;
    write_text(&args.out.join("sensor.toml"), &files::sensor_to_toml(sensor.spec()))?;
    if let Some(grey) = &grey {
        write_text(&args.out.join("grey.toml"), &files::sensor_to_toml(grey.camera().spec()))?;
    }
    Ok(CommandOutcome::Done)
}

/// The messages of a simulated frame: the true pose as the transform from `map`, and its odometry from `odom`.
#[cfg(feature = "ros")]
fn records(frame: &Frame, truth: &Pose, odom_from_robot: Pose, is_first: bool) -> Result<Vec<Record>> {
    let mut origin = MessageOrigin::of_frame(frame, None);
    origin.odom = Some(("odom".into(), odom_from_robot));
    let mount = is_first.then(|| origin.mount(frame.sensor()));
    let transforms = [Some(origin.localization(truth)), origin.odometry()].into_iter().flatten();
    Ok(mount.into_iter().chain(transforms).chain(sensed(frame, &origin)?).collect())
}

/// How the robot moves during the scan at a pose: constantly, as between this pose and its neighbour on the side of the
/// scan. `None` if the sensor measures all rays at once, and for a single pose.
fn motion_at(poses: &[StampedPose], index: usize, sensor: &Sensor) -> Option<ScanMotion> {
    let [first, last] = sensor.scan_interval();
    let after = index + 1 < poses.len() && (first + last >= 0.0 || index == 0);
    let pair = if after { index..index + 2 } else { index.checked_sub(1)?..index + 1 };
    let [from, to] = poses.get(pair)? else { return None };
    let seconds = to.time - from.time;
    let moves = !sensor.spec().times.is_at_once() && seconds > 0.0;
    moves.then(|| ScanMotion::Twist(Twist::to(&(from.pose.inverse() * to.pose), seconds)))
}

fn write_text(path: &Path, text: &str) -> Result<()> {
    write_atomically(path, |file| file.write_all(text.as_bytes()))
}

/// Writes the log of a scanner. If a frame fails, no file is written.
fn write_scans(
    path: &Path,
    sensor: &Sensor,
    poses: &[StampedPose],
    mut next: impl FnMut(&StampedPose) -> Result<Frame>,
) -> Result<()> {
    let mut failed = None;
    let written = write_atomically(path, |file| {
        let mut file = BufWriter::new(file);
        writeln!(file, "{}", files::range_log_header(sensor.spec()))?;
        for pose in poses {
            match next(pose)
                .and_then(|frame| files::range_log_line(&LogFrame::of(&frame, Some(RobotPose::new(pose.pose)))))
            {
                Ok(line) => writeln!(file, "{line}")?,
                Err(e) => {
                    failed = Some(e);
                    return Err(std::io::Error::other("a frame was not simulated"));
                }
            }
        }
        file.flush()
    });
    failed.map_or(written, Err)
}

/// Writes the images of one time.
fn write_images(
    out: &Path,
    frame: &Frame,
    grey: Option<&mut GreySimulator>,
    scene: &Scene,
    pose: &StampedPose,
) -> Result<()> {
    let path = out.join("depth").join(files::image_name(pose.time));
    print::notices(&png::write_depth(&path, &images(frame), frame.sensor())?);
    let Some(grey) = grey else { return Ok(()) };
    let frame = grey.frame(&scene.world, pose.time, &RobotPose::new(pose.pose))?;
    let image = frame.grey().expect("a grey simulator gives grey images");
    png::write_grey(&out.join("grey").join(files::image_name(pose.time)), image)
}

impl Args {
    fn check_flags(&self, sensor: &Sensor) -> Result<()> {
        if self.intensities && sensor.is_camera() {
            let remedy = "drop it; --grey writes grey images of a camera";
            return Err(Error::usage("--intensities: depth images cannot store intensities", remedy));
        }
        if self.grey.is_some() && !sensor.is_camera() {
            return Err(Error::usage("--grey: logs of scans cannot store images", "give a depth camera as --sensor"));
        }
        Ok(())
    }

    fn check_times(&self, poses: &[StampedPose], sensor: &Sensor) -> Result<()> {
        if let Some(early) = poses.iter().find(|p| p.time < 0.0 && sensor.is_camera()) {
            let what = format!("a time of {} s", early.time);
            return Err(Error::invalid(what, "give times of at least 0: they name the images").in_file(&self.poses));
        }
        if sensor.is_camera() {
            let mut named: Vec<(String, f64)> = poses.iter().map(|p| (files::image_name(p.time), p.time)).collect();
            named.sort_unstable_by(|a, b| a.0.cmp(&b.0));
            if let Some([a, b]) = named.array_windows().find(|[a, b]| a.0 == b.0) {
                let what = format!("the images at {} s and {} s would both be named {}", a.1, b.1, a.0);
                return Err(Error::invalid(what, "give times at least 2 us apart").in_file(&self.poses));
            }
        }
        let falling = poses.windows(2).find(|pair| !(pair[1].time > pair[0].time));
        if let Some([a, b]) = falling.filter(|_| !sensor.is_camera()) {
            let what = format!("a time of {} s after one of {} s", b.time, a.time);
            return Err(Error::invalid(what, "sort the poses by time, without duplicates").in_file(&self.poses));
        }
        Ok(())
    }

    /// The simulator of grey images. Its seed differs from that of the ranges, so that their noise is independent.
    fn grey_simulator(&self, threads: &Threads) -> Result<Option<GreySimulator>> {
        let Some(name) = &self.grey else { return Ok(None) };
        let (camera, notices) = load_sensor(name)?;
        print::notices(&notices);
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(threads.clone()))?;
        GreySimulator::new(predictor, camera, BLUR, self.grey_noise, self.seed ^ 0x6772_6579).map(Some)
    }
}

/// The ranges of a frame as depths.
fn images(frame: &Frame) -> Images {
    let sensor = frame.sensor();
    let width = sensor.width();
    let depth = |(i, range): (usize, &f32)| {
        let ray = sensor.ray(i as u32 % width, i as u32 / width);
        ray.map_or(f32::NAN, |ray| (f64::from(*range) * ray.z) as f32)
    };
    let depth_z = frame.ranges().iter().enumerate().map(depth).collect();
    Images { width, height: sensor.height(), depth_z, ..Images::default() }
}
