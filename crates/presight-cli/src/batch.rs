//! `presight batch`: predictions of one sensor at many poses, written into a folder.

mod record;

use super::engine_args::EngineArgs;
use super::motion_args::{MotionArgs, ScanMotions};
use super::outputs::check_no_dash;
use super::pose::{PoseFrame, PoseOf, WorldFrame, given_pose};
use super::sensor_args::SensorArgs;
use super::series::SeriesProgress;
use super::{CommandOutcome, bar, open_scene, print};
use presight::environment::{Aabb, IndexKind};
use presight::files::{self, ImportOptions, StampedPose, files_named_by};
use presight::measured::{Frame, Measurement, ScanMotion};
use presight::predict::{BatchItem, BatchRequest, Headings, PoseCell, RangeLikelihood};
use presight::sensor::ExternalPose;
use presight::tools::{self, create_folder};
use presight::{
    Backend, Error, IdScheme, ImageRequest, Output, Outputs, Pose, Predictor, Result, Scene, Sensor, SensorPose,
    Threads, Twist, blake3_of,
};
use rayon::prelude::*;
use record::{Choice, JOB, check_job, keep_job};
use std::fmt::Write as _;
use std::ops::Range;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  All images at the poses of a trajectory, as 000000.exr, 000001.exr, .., and poses.csv:
    presight batch hall.glb --poses drive.tum --sensor vlp-16 --out images

  The log-likelihood of scan 3 of a log at each pose:
    presight batch corridor.glb --poses corridor.tum --sensor scanner.toml \\
      --likelihood scans.json#3 --out weights

  The same at 360 headings of each place, with places 0.25 m apart:
    presight batch corridor.glb --poses places.tum --sensor scanner.toml \\
      --likelihood scans.json#3 --headings 360 --cell-m 0.25 --out headings

  The second half of a batch, on another machine:
    presight batch hall.glb --poses drive.tum --sensor vlp-16 --out half --shard 2/2

After an interruption, run the same command again to continue.";

/// Predict a sensor's images at many poses, or weigh a measured image at each pose
///
/// Writes an image for each pose and poses.csv (with --shard poses-I-of-N.csv). Files are complete as soon as they
/// appear. With --likelihood the table has the log-likelihood of the measured image at each pose, and images are
/// written only if --outputs is given.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The model: a .glb or .gltf file, a .rhai script, or a store
    scene: PathBuf,

    /// The poses: lines of timestamp tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE.tum")]
    poses: PathBuf,

    /// A preset (see `presight sensors`) or a sensor file
    #[arg(long, value_name = "PRESET|FILE")]
    sensor: String,

    #[command(flatten)]
    image: SensorArgs,

    /// The folder to write
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Weigh this measured image: an OpenEXR file with a range image, or FILE#INDEX for a frame of a log, from 0
    #[arg(long, value_name = "FRAME")]
    likelihood: Option<String>,

    /// Weigh it at N headings at each position, evenly spaced over a full turn; the poses' own headings are ignored
    #[arg(long, value_name = "N", requires = "likelihood")]
    headings: Option<u32>,

    /// Width of the cell that each pose represents, metres
    #[arg(long, value_name = "X", default_value_t = 0.0, requires = "likelihood")]
    cell_m: f64,

    /// Range of headings that each pose represents, degrees [default: 0, with --headings the step between them]
    #[arg(long, value_name = "X", requires = "likelihood")]
    cell_deg: Option<f64>,

    /// Images to write, from range, depth_z, polygon_id, object_id, cos_incidence, echo, normal [default:
    /// range,polygon_id,object_id,cos_incidence, with --likelihood none]
    #[arg(long, value_name = "LIST")]
    outputs: Option<Outputs>,

    /// Process the I-th of N parts of the poses, from 1
    #[arg(long, value_name = "I/N", value_parser = parse_shard)]
    shard: Option<(u32, u32)>,

    /// The axes of the frame that the poses describe
    #[arg(long, value_enum, default_value_t = PoseFrame::Body)]
    pose_frame: PoseFrame,

    /// Poses of the sensor or of the robot
    #[arg(long, value_enum, default_value_t = PoseOf::Sensor)]
    pose_of: PoseOf,

    /// The world frame of the poses
    #[arg(long, value_enum, default_value_t = WorldFrame::ZUp)]
    world_frame: WorldFrame,

    #[command(flatten)]
    motion: MotionArgs,

    #[command(flatten)]
    engine: EngineArgs,

    /// CPU threads, 0 = all cores
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
}

fn parse_shard(text: &str) -> Result<(u32, u32)> {
    let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    match numbers {
        Some((i, n)) if 1 <= i && i <= n => Ok((i, n)),
        _ => Err(Error::usage("invalid shard", "give I/N with I from 1 to N, such as 1/4")),
    }
}

/// Runs the command.
///
/// # Errors
/// Errors from reading the scene, sensor, poses and measured image, from the engine, and from writing; a folder that
/// holds another batch. Finished files are kept, and the same command continues.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    check_no_dash(&args.out)?;
    let threads = Threads::from(args.threads).started()?;
    let sensor = args.image.load(&args.sensor)?;
    let mut request = args.request(&sensor)?;
    let import = ImportOptions { threads: threads.clone(), ..ImportOptions::default() };
    let scene = open_scene(&args.scene, &import, IndexKind::default())?;
    let poses = PoseFile::read(&args.poses, &scene.world.environment().bounds(), |pose| {
        let pose = args.given(pose)?.of_sensor(sensor.spec(), &scene.world_from_gltf)?;
        request.headings.as_ref().map_or(Ok(()), |headings| headings.place(&pose).map(drop))?;
        Ok(pose)
    })?;
    print::notices(&poses.far_outside);
    // All shards must use the same height.
    request.height = Some(poses.first.world_from_sensor().translation.z);
    request.motions = args.motions(&scene, &sensor)?;
    let items = args.items(poses.count);
    args.check_inputs(&scene.files)?;
    create_folder(&args.out)?;
    let record = args.job(&scene, &sensor, &poses)?;
    let chosen =
        check_job(&args.out, &record, Choice { backend: args.engine.backend(), raster: args.engine.raster() })?;
    let mut job = Job::new(args, scene, sensor, request)?;
    let table = args.table();
    if table.exists() {
        print::message(&format!("note: {} is already finished", table.display()));
        return Ok(CommandOutcome::Done);
    }
    let raster = chosen.raster.unwrap_or_default();
    let options = args.engine.options(threads.clone()).with_backend(chosen.backend.unwrap_or_default());
    let mut predictor = Predictor::new(options.with_raster(raster))?;
    let backend = if predictor.engine_mut().0.device().is_some() { Backend::Gpu } else { Backend::Cpu };
    keep_job(&args.out, record, Choice { backend: Some(backend), raster: Some(raster) })?;
    let mut progress = job.progress(&table, items.clone())?;
    print::finished_before(&progress, items.len());
    job.write(&mut predictor, &threads, &mut progress, items)?;
    progress.rename(&table)?;
    Ok(CommandOutcome::Done)
}

impl Args {
    fn given(&self, pose: Pose) -> Result<ExternalPose> {
        given_pose(pose, self.pose_frame, self.pose_of, self.world_frame)
    }

    fn request(&self, sensor: &Sensor) -> Result<BatchRequest> {
        let headings = self.headings.map(|count| Headings::new(sensor, count)).transpose()?;
        if headings.is_some() && self.pose_of == PoseOf::Robot {
            let what = "--headings with --pose-of robot: the sensor's position on the robot changes with the heading";
            return Err(Error::usage(what, "give poses of the sensor"));
        }
        let outputs = match (self.outputs, &self.likelihood) {
            (None, Some(_)) => None,
            (outputs, _) => Some(outputs.unwrap_or_default()),
        };
        if let Some(outputs) = outputs {
            self.check_outputs(outputs, sensor)?;
        }
        let step = self.headings.map_or(0.0, |n| 360.0 / f64::from(n));
        let cell = PoseCell { side: self.cell_m, turn: self.cell_deg.unwrap_or(step).to_radians() };
        let likelihood = match &self.likelihood {
            Some(frame) => Some(read_sensed(frame, sensor, cell).map_err(|e| e.at(format!("--likelihood {frame}")))?),
            None => None,
        };
        let images = outputs.map(ImageRequest::from);
        // Image files name the rasterizer.
        let statistics = images.is_some();
        Ok(BatchRequest { images, likelihood, headings, statistics, ..BatchRequest::default() })
    }

    /// The motion during the scan at each pose: none, one for all, or one for each.
    fn motions(&self, scene: &Scene, sensor: &Sensor) -> Result<Vec<ScanMotion>> {
        match self.motion.motions(scene, sensor, None, |pose| self.given(pose))? {
            ScanMotions::Still => Ok(Vec::new()),
            ScanMotions::Alike(motion) => Ok(vec![motion]),
            along @ ScanMotions::Along(..) => {
                let of_scan = |stamped: Result<StampedPose>| {
                    let motion = along.at(sensor, stamped?.time)?;
                    Ok(motion.unwrap_or(ScanMotion::Twist(Twist::default())))
                };
                files::stream_tum(&self.poses)?.map(of_scan).collect()
            }
        }
    }

    fn check_outputs(&self, outputs: Outputs, sensor: &Sensor) -> Result<()> {
        if outputs.has(Output::FeatureId) {
            return Err(Error::usage("--outputs feature_id: a batch predicts no features", "drop it"));
        }
        if outputs.has(Output::DepthZ) && !sensor.is_camera() {
            let what = format!("depth_z: sensor {:?} is not a camera and has no optical axis", sensor.spec().name);
            return Err(Error::usage(what, "use range"));
        }
        Ok(())
    }

    /// The indices of the poses of this shard.
    fn items(&self, count: usize) -> Range<usize> {
        let (i, n) = self.shard.map_or((1, 1), |(i, n)| (i as usize, n as usize));
        let at = |k: usize| (count as u128 * k as u128 / n as u128) as usize;
        at(i - 1)..at(i)
    }

    fn table(&self) -> PathBuf {
        self.out.join(self.shard.map_or("poses.csv".into(), |(i, n)| format!("poses-{i}-of-{n}.csv")))
    }

    /// Checks that no input file would be overwritten. `scene` are the files of the scene.
    fn check_inputs(&self, scene: &[PathBuf]) -> Result<()> {
        let Ok(folder) = self.out.canonicalize() else { return Ok(()) };
        let sensor = PathBuf::from(&self.sensor);
        let table = files_named_by(&sensor);
        let frame = self.likelihood.as_deref().map(|frame| frame_of(frame).0);
        let trajectory = self.motion.inputs().map(Path::to_path_buf);
        let named = table.iter().chain([&sensor, &self.poses]).chain(&frame).chain(&trajectory);
        for input in scene.iter().chain(named) {
            let Ok(path) = input.canonicalize() else { continue };
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if path.parent() == Some(&folder) && may_write(&name) {
                let what =
                    format!("--out {}: this would overwrite {}, an input file", self.out.display(), input.display());
                return Err(Error::usage(what, "write elsewhere"));
            }
        }
        Ok(())
    }

    /// The inputs of the batch, by name. They must not change between its runs and shards.
    fn job(&self, scene: &Scene, sensor: &Sensor, poses: &PoseFile) -> Result<serde_json::Value> {
        let hash = |text: String| blake3::hash(text.as_bytes()).to_hex().to_string();
        let environment = scene.world.environment();
        let sensed = match &self.likelihood {
            Some(frame) => blake3_of(&frame_of(frame).0)?,
            None => String::new(),
        };
        let moving = match self.motion.inputs() {
            Some(path) => format!(" along {}", blake3_of(path)?),
            None if self.motion.is_given() => format!(" {:?}", self.motion),
            None => String::new(),
        };
        let request = format!(
            "{:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?} {sensed}{moving}",
            self.likelihood.as_deref().map(frame_of).map(|(_, index)| index),
            self.headings,
            self.cell_m,
            self.cell_deg,
            self.outputs,
            self.pose_frame,
            self.pose_of,
            self.world_frame
        );
        Ok(serde_json::json!({
            "format": 1,
            "presight": env!("CARGO_PKG_VERSION"),
            "scene": format!("{} {}", blake3_of(&self.scene)?, environment.content_hash()),
            "sensor": hash(files::sensor_to_toml(sensor.spec())),
            "poses": poses.blake3,
            "request": hash(request),
        }))
    }
}

/// Returns true if a batch writes files of this name.
fn may_write(name: &str) -> bool {
    let image = name.strip_suffix(".exr").is_some_and(|n| n.len() >= 6 && n.bytes().all(|b| b.is_ascii_digit()));
    image || name == JOB || name.starts_with("poses") && (name.ends_with(".csv") || name.ends_with(".part"))
}

/// Splits `FILE#INDEX` of a measured image into file and index.
fn frame_of(frame: &str) -> (PathBuf, Option<usize>) {
    let numbered = frame.rsplit_once('#').and_then(|(file, index)| Some((file, index.parse().ok()?)));
    numbered.map_or_else(|| (frame.into(), None), |(file, index)| (file.into(), Some(index)))
}

fn read_sensed(frame_name: &str, sensor: &Sensor, cell: PoseCell) -> Result<RangeLikelihood> {
    RangeLikelihood::new(&read_measured(frame_name, sensor)?, cell).map_err(|e| e.in_file(frame_of(frame_name).0))
}

/// Reads a measured image of a sensor: an EXR file, or `FILE#INDEX` of a log.
///
/// # Errors
/// Those of the readers; [`presight::ErrorKind::Invalid`] for an image of another sensor.
pub(super) fn read_measured(frame_name: &str, sensor: &Sensor) -> Result<Frame> {
    let (path, index) = frame_of(frame_name);
    let range = match index {
        Some(index) => {
            let (of_log, sensed) = files::read_frame(&path, index)?;
            let (logged, given) = (of_log.spec(), sensor.spec());
            if logged.geometry != given.geometry || logged.optical_from_image != given.optical_from_image {
                let what = format!("the rays of the log's sensor differ from {:?}", sensor.spec().name);
                return Err(Error::invalid(what, "give a sensor with the log's rays").in_file(&path));
            }
            sensed.range
        }
        None => {
            let range = files::read_exr(&path)?.images.range;
            if range.is_empty() {
                let remedy = "give a file with a range image, or FILE#INDEX of a log";
                return Err(Error::invalid("the file has no range image", remedy).in_file(&path));
            }
            range
        }
    };
    let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(range)).map_err(|e| e.in_file(&path))?;
    let notice = files::notice_of_readings(&frame);
    print::notices(&notice.map(|notice| format!("{frame_name}: {notice}")));
    Ok(frame)
}

/// A summary of the pose file, which is read in full at the start so that errors in it are found before any work.
struct PoseFile {
    count: usize,
    /// The sensor's first pose.
    first: SensorPose,
    /// The notice on poses far outside of the model.
    far_outside: Option<String>,
    blake3: String,
}

impl PoseFile {
    fn read(path: &Path, bounds: &Aabb, of_sensor: impl Fn(Pose) -> Result<SensorPose>) -> Result<Self> {
        let mut hasher = blake3::Hasher::new();
        let (mut count, mut first, mut far_outside) = (0, None, None);
        for stamped in files::stream_tum(path)? {
            let StampedPose { time, pose } = stamped?;
            let placed = of_sensor(pose).map_err(|e| e.at(format!("pose {count}")).in_file(path))?;
            first.get_or_insert(placed);
            let far = || tools::poses_far_outside(bounds, [placed.world_from_sensor().translation]);
            far_outside = far_outside.or_else(|| Some(format!("{}: pose {count}: {}", path.display(), far()?)));
            count += 1;
            let numbers = [&[time][..], &pose.translation.to_array(), &pose.rotation.to_array()].concat();
            for number in numbers {
                hasher.update(&number.to_bits().to_le_bytes());
            }
        }
        let Some(first) = first else {
            let remedy = "give at least one line of timestamp tx ty tz qx qy qz qw";
            return Err(Error::invalid("the file has no poses", remedy).in_file(path));
        };
        Ok(Self { count, first, far_outside, blake3: hasher.finalize().to_hex().to_string() })
    }
}

/// The inputs shared by all poses.
struct Job<'a> {
    args: &'a Args,
    scene: Scene,
    sensor: Sensor,
    request: BatchRequest,
    attributes: files::ExrAttributes,
}

impl<'a> Job<'a> {
    fn new(args: &'a Args, scene: Scene, sensor: Sensor, request: BatchRequest) -> Result<Self> {
        let objects = scene.world.environment().objects();
        let seen_by = request.headings.as_ref().map_or(&sensor, Headings::panorama);
        let attributes = files::ExrAttributes {
            sensor: Some(files::sensor_to_toml(seen_by.spec())),
            pose: None,
            motion: None,
            scene: Some(args.scene.display().to_string()),
            scene_blake3: Some(blake3_of(&args.scene)?),
            scene_content: Some(scene.world.environment().content_hash().to_string()),
            ids: Some(IdScheme::Model),
            given_up: None,
            raster: None,
            objects: (1..).zip(objects.iter().map(|o| o.name.clone())).collect(),
            // `given_up` is empty because a batch has no deadline.
        };
        Ok(Self { args, scene, sensor, request, attributes })
    }

    /// Opens the table, keeping the rows of an earlier run.
    fn progress(&self, table: &Path, items: Range<usize>) -> Result<SeriesProgress> {
        let per_item = self.request.headings.as_ref().map_or(1, |h| h.count() as usize);
        let mut progress = SeriesProgress::open(&table.with_added_extension("part"), HEADER, items, per_item)?;
        if self.request.images.is_some() {
            progress.keep_while(|index| self.args.out.join(image_name(index)).is_file())?;
        }
        Ok(progress)
    }

    /// Computes and writes all missing items, starting at the table's next row.
    fn write(
        &mut self,
        predictor: &mut Predictor,
        threads: &Threads,
        progress: &mut SeriesProgress,
        items: Range<usize>,
    ) -> Result<()> {
        let first = progress.next();
        let stream = || Ok::<_, Error>(files::stream_tum(&self.args.poses)?.skip(first).take(items.end - first));
        let mut times = stream()?.map(|stamped| stamped.map(|s| s.time));
        // The poses were checked before; an error here means that the file has changed, and ends the batch.
        let mut fault = None;
        let place = |pose| self.args.given(pose)?.of_sensor(self.sensor.spec(), &self.scene.world_from_gltf);
        let poses = stream()?.map_while(|stamped| match stamped.and_then(|s| place(s.pose)) {
            Ok(pose) => Some(pose),
            Err(e) => {
                fault = Some(e);
                None
            }
        });
        let bar = bar::bar(items.len() as u64);
        bar.set_position((first - items.start) as u64);
        let mut request = self.request.clone();
        if request.motions.len() > 1 {
            request.motions.drain(..first.min(request.motions.len()));
        }
        let mut batch = predictor.batch(&self.scene.world, &self.sensor, poses, &request)?;
        loop {
            let (some, failed) = take(&mut batch, 4 * threads.run(rayon::current_num_threads)?);
            let last = some.last().map(|item| first + item.index);
            if self.request.images.is_some() {
                let write = |item: &BatchItem| self.write_image(first + item.index, item);
                threads.run(|| some.par_iter().try_for_each(write))??;
            }
            let mut lines = String::new();
            for item in &some {
                self.tell(&mut lines, first + item.index, times.next().transpose()?.unwrap_or(f64::NAN), item);
            }
            if let Some(last) = last {
                progress.append(last, &lines)?;
                bar.set_position((last + 1 - items.start) as u64);
            }
            match failed {
                Some(e) => return Err(e.in_file(&self.args.poses)),
                None if last.is_none() => break,
                None => {}
            }
        }
        drop(batch);
        bar.finish_and_clear();
        match fault {
            Some(e) => Err(e),
            None if progress.next() < items.end => {
                let what = "the file has fewer poses than when this batch began";
                Err(Error::invalid(what, "choose another --out").in_file(&self.args.poses))
            }
            None => Ok(()),
        }
    }

    fn write_image(&self, index: usize, item: &BatchItem) -> Result<()> {
        let raster = item.stats.as_ref().and_then(|stats| stats.raster);
        let motion = self.request.motions.get(index.min(self.request.motions.len().saturating_sub(1))).cloned();
        let attributes = files::ExrAttributes { pose: Some(item.pose), motion, raster, ..self.attributes.clone() };
        files::write_exr(&self.args.out.join(image_name(index)), &item.images, Outputs::ALL, &attributes)
    }

    /// Appends the table rows of an item to `text`.
    fn tell(&self, text: &mut String, index: usize, time: f64, item: &BatchItem) {
        let image = if self.request.images.is_some() { image_name(index) } else { String::new() };
        let mut row = |pose: &SensorPose, heading: &str, weight: &str| {
            let Pose { translation: p, rotation: q } = pose.world_from_sensor();
            let numbers = format!("{},{},{},{},{},{},{}", p.x, p.y, p.z, q.x, q.y, q.z, q.w);
            // Writing into a string cannot fail.
            let _ = writeln!(text, "{index},{time},{numbers},{image},{heading},{weight}");
        };
        match &self.request.headings {
            Some(headings) => {
                let place = item.pose.world_from_sensor().translation;
                for (k, weight) in (0..headings.count()).zip(&item.headings) {
                    let pose = headings.pose(place, k);
                    row(&pose, &headings.degrees(k).to_string(), &weight.to_string());
                }
            }
            None => {
                let weight = item.log_likelihood.map_or(String::new(), |weight| weight.to_string());
                row(&item.pose, "", &weight);
            }
        }
    }
}

const HEADER: &str = "pose,time,x,y,z,qx,qy,qz,qw,image,heading_deg,log_likelihood";

fn image_name(index: usize) -> String {
    format!("{index:06}.exr")
}

/// Takes the next `count` items. If an item fails, returns the ones before it and the error.
fn take(batch: &mut impl Iterator<Item = Result<BatchItem>>, count: usize) -> (Vec<BatchItem>, Option<Error>) {
    let mut some = Vec::with_capacity(count);
    for item in batch.take(count) {
        match item {
            Ok(item) => some.push(item),
            Err(e) => return (some, Some(e)),
        }
    }
    (some, None)
}
