//! `presight predict`: the images of a sensor at one or more poses.

#[cfg(feature = "ros")]
mod bag;
mod files;
mod one;
mod poses;

pub use files::Shown;

use crate::deadline::DeadlineArgs;
use crate::engine_args::{EngineArgs, WayArg};
use crate::file_names::FileNames;
use crate::frame_args::FrameArgs;
use crate::layers::{LayerArgs, NamedRequest};
use crate::motion_args::{MotionArgs, ScanMotions, meaning_of};
#[cfg(feature = "ros")]
use crate::output_bag::OutputBag;
use crate::outputs::OutputFiles;
use crate::pose::{PoseArgs, PoseOf};
use crate::pose_series::Poses;
use crate::sensor_args::SensorArgs;
use crate::virtual_sensor::VirtualArgs;
use crate::{CommandOutcome, open_scene_without, print};
use clap::ValueEnum;
use presight::files::{ImportOptions, load_robot};
use presight::sensor::{ExternalPose, Geometry};
use presight::tools::{self, FrameMemory};
use presight::{Error, IdScheme, Options, Output, Outputs, Predictor, Request, Result, Scene, Sensor, Threads};
use presight_pictures as png;
use presight_studies::index::Scheme;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  A preview image of a radar 1.2 m above the point (2, 1), looking along +y:
    presight predict hall.glb --sensor microwave-radar-image --pose 2,1,1.2,0,0,90 --png view.png

  All images of a camera looking 10 degrees down, as OpenEXR:
    presight predict hall.glb --sensor video-camera --pose 0,0,1.5,0,10,0 --out view.exr

  A point cloud in world coordinates, and a depth image for ROS:
    presight predict hall.glb --sensor realsense-d435 --pose 0,0,1,0,0,0 \\
      --points cloud.ply --points-frame world --depth-png depth.png

  The visible features, their regions of interest, and a preview of them:
    presight predict hall.glb --sensor video-camera --pose 0,0,1.5,0,10,0 \\
      --layer hall.video.layer.json --pose-cov 0.05,0.05,0,0,0,2 --features seen.json --png seen.png

  The free floor as polygons in the robot's frame, and a preview of it:
    presight predict hall.glb --sensor video-camera --pose 0,0,1.5,0,20,0 \\
      --virtual free-floor --features floor.json --png floor.png

  Depth images along a trajectory as one NumPy array of (poses, rows, columns), and a preview of each:
    presight predict hall.glb --sensor realsense-d435 --poses drive.tum \\
      --outputs depth_z --npy depth.npy --png 'depth-{i:06}.png'

  Scans along a trajectory as a ROS 2 bag for RViz and Foxglove:
    presight predict hall.glb --sensor laser-scanner --poses drive.tum --mcap drive.mcap

  A lidar on a robot that drives at 1.5 m/s and turns by 60 degrees/s, and its points put to the end of the scan:
    presight predict hall.glb --sensor vlp-16-real --pose 0,0,1,0,0,0 --twist 1.5,0,0,0,0,60 \\
      --points scan.ply --deskew 0.1

  Timing, and the stages that were skipped:
    presight predict hall.glb --sensor vlp-16 --pose 0,0,1,0,0,0 --repeat 50 \\
      --stats stats.json --explain";

/// Predict the images of a sensor at a pose
///
/// The command prints a one-line summary if no output flag is given. With --poses or --robot file names are templates:
/// {i} is the number of the pose from 0 ({i:06} in six digits), {t} its time stamp as written, {sensor} the sensor. To
/// continue an interrupted series, run the same command again. Poses from a pipe are answered one by one as they come
/// if no files are written.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The model: a .glb or .gltf file, a .rhai script, or a store
    scene: PathBuf,

    /// A preset (see `presight sensors`) or a sensor file
    #[arg(long, value_name = "PRESET|FILE", required_unless_present = "robot", conflicts_with = "robot")]
    sensor: Option<String>,

    #[command(flatten)]
    image: SensorArgs,

    /// Predict for all sensors of a robot; poses are those of the robot
    #[arg(long, value_name = "ROBOT.toml")]
    robot: Option<PathBuf>,

    #[command(flatten)]
    pose: PoseArgs,

    #[command(flatten)]
    motion: MotionArgs,

    /// Predict at every pose of a file, one `timestamp tx ty tz qx qy qz qw` per line; - reads stdin
    #[arg(long, value_name = "FILE.tum|-", conflicts_with = "pose")]
    poses: Option<PathBuf>,

    /// Leave out these objects, with everything below them, such as the robot itself
    #[arg(long, value_name = "OBJECT", num_args = 1..)]
    exclude: Vec<String>,

    #[command(flatten)]
    engine: EngineArgs,

    /// Rendering strategy of the CPU engine: polygons are drawn, or tiles of rays search trees; the images are the same
    #[arg(long, value_enum, default_value_t = WayArg::Auto)]
    way: WayArg,

    /// On a GPU, first draw the polygons visible at the previous pose: faster along a drive, with the same images
    #[arg(long, conflicts_with = "deadline_ms")]
    reuse_visible: bool,

    /// The spatial index that selects polygons: none, grid, plop, s2d, s3d or two-level; all give the same images
    #[arg(long, value_name = "INDEX", default_value = Scheme::default().name())]
    index: Scheme,

    /// Images to predict, from range, depth_z, polygon_id, object_id, cos_incidence, echo, normal, feature_id
    #[arg(long, value_name = "LIST", default_value = "range,polygon_id,object_id,cos_incidence")]
    outputs: Outputs,

    /// Write the images as OpenEXR, lossless
    #[arg(long, value_name = "FILE.exr")]
    out: Option<PathBuf>,

    /// Write each image as a NumPy array of (rows, columns), <f4 or <u4; normals are (rows, columns, 3)
    ///
    /// An example is 'run/{i:06}.{output}.npy'. {output} is the image; it is optional if there is one image. With
    /// --poses and neither {i} nor {t} in the name, the array has the shape (poses, rows, columns).
    #[arg(long, value_name = "TEMPLATE.npy")]
    npy: Option<String>,

    /// Write the sensor's unit rays as a NumPy array of (rows, columns, 3), <f8, body axes, NaN without a ray
    #[arg(long, value_name = "FILE.npy")]
    rays: Option<PathBuf>,

    /// Write a preview image for people
    #[arg(long, value_name = "FILE.png")]
    png: Option<PathBuf>,

    /// The image shown in the preview
    #[arg(long, value_name = "OUTPUT", default_value = "range", requires = "png")]
    png_of: Output,

    #[command(flatten)]
    layers: LayerArgs,

    #[command(flatten)]
    virtual_sensor: VirtualArgs,

    /// Write a 16-bit depth image in millimetres, 0 = no value (depth_z for cameras, otherwise range)
    #[arg(long, value_name = "FILE.png")]
    depth_png: Option<PathBuf>,

    /// Write a ROS 2 bag: /tf, /tf_static, and below the name of the sensor scan and points, or depth and camera_info
    ///
    /// A level scanner of one row gets LaserScan and PointCloud2, other scanners organized PointCloud2, with a field
    /// for each requested image: echo (as intensity), object_id and polygon_id; cameras get 32FC1 and, for requested
    /// ids, 32SC1. `presight replay --given` reads the bag back.
    #[cfg(feature = "ros")]
    #[arg(long, value_name = "OUT.mcap", requires = "poses")]
    mcap: Option<PathBuf>,

    /// The frame of the poses in the bag
    #[cfg(feature = "ros")]
    #[arg(long = "frame", value_name = "FRAME", default_value = "map", requires = "mcap")]
    bag_frame: String,

    /// Write the visible points as a point cloud; a device or pipe whose name has no ending gets PLY
    ///
    /// Points have a field for each requested image: range, echo (as intensity), object_id and polygon_id. They have
    /// normals if `normal` or both ids are requested. Points of scanners have their row as ring.
    #[arg(long, value_name = "FILE.ply|FILE.pcd")]
    points: Option<PathBuf>,

    /// The frame of the points
    #[arg(long, value_enum, default_value_t = PointsFrameArg::Sensor, requires = "points")]
    points_frame: PointsFrameArg,

    /// Put the points of a moving scan into the frame of the sensor at this time, seconds after the stamp
    #[arg(long, value_name = "SECONDS", requires = "points", allow_hyphen_values = true)]
    deskew: Option<f64>,

    #[command(flatten)]
    frame: FrameArgs,

    /// The meaning of polygon_id: merged polygons of the model, or triangles of the file
    #[arg(long, value_enum, default_value_t = IdsArg::Model)]
    ids: IdsArg,

    /// Merge coplanar neighbours within this fraction of an object's size [default: 1e-6]
    #[arg(long, value_name = "X")]
    merge_tolerance: Option<f64>,

    /// CPU threads, 0 = all cores
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,

    /// Print the summary as JSON, one object per line
    #[arg(long, conflicts_with = "explain")]
    pub json: bool,

    #[command(flatten)]
    deadline: DeadlineArgs,

    /// Print the stages with their times, the counts, and the skipped stages with the reason
    #[arg(long)]
    explain: bool,

    /// Predict N more times after a warm-up prediction, and report on these
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    repeat: Option<u32>,

    /// Write statistics of the repeated predictions
    #[arg(long, value_name = "FILE.json")]
    stats: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum IdsArg {
    /// Polygons of the model, coplanar triangles merged
    Model,
    /// Triangles of the source file, nothing merged
    Source,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum PointsFrameArg {
    /// The sensor's body axes: x forward, y left, z up
    Sensor,
    /// The world
    World,
}

/// The arguments, checked as far as possible without opening the scene.
pub struct Job {
    /// One pose with an empty stamp if --poses is not given.
    pub poses: Poses,
    pub sensors: Vec<Sensor>,
    pub files: OutputFiles,
    #[cfg(feature = "ros")]
    pub bag: Option<OutputBag>,
    pub names: FileNames,
    pub import: ImportOptions,
    pub options: Options,
}

impl Args {
    fn check(&self) -> Result<Job> {
        self.layers.check(self.asked())?;
        self.virtual_sensor.check()?;
        self.deadline.check()?;
        self.check_series()?;
        self.check_motion()?;
        let import = self.import_options()?;
        let mut files = OutputFiles::default();
        let names = self.names()?;
        let (poses, sensors) = (self.poses_for(&names)?, self.sensors()?);
        names.add_to(&mut files, &poses.stamps(), &sensors)?;
        files.add("--stats", self.stats.as_deref(), &["json"])?;
        files.add("--costs", self.deadline.costs.as_deref(), &["json"])?;
        #[cfg(feature = "ros")]
        let bag = OutputBag::of("--mcap", self.mcap.as_deref(), &mut files)?;
        files.check_named(self.inputs())?;
        sensors.iter().try_for_each(|sensor| self.virtual_sensor.check_sensor(sensor))?;
        sensors.iter().try_for_each(|sensor| self.check_picture(sensor))?;
        let threads = Threads::from(self.threads).started()?;
        let import = ImportOptions { threads: threads.clone(), ..import };
        Ok(Job {
            poses,
            sensors,
            files,
            #[cfg(feature = "ros")]
            bag,
            names,
            import,
            options: self.engine.options(threads).with_reuse_visible(self.reuse_visible).with_way(self.way.way()),
        })
    }

    /// A picture has sides that programs can show.
    fn check_picture(&self, sensor: &Sensor) -> Result<()> {
        if self.png.is_none() || sensor.width() <= tools::MAX_IMAGE_SIDE {
            return Ok(());
        }
        let what = format!("--png: a row of {} rays is wider than a picture may be", sensor.width());
        Err(Error::usage(what, "drop --png and write --out FILE.exr or --npy, or give the rays several rows"))
    }

    /// Returns true if there can be more than one prediction.
    fn is_series(&self) -> bool {
        self.poses.is_some() || self.robot.is_some()
    }

    fn check_series(&self) -> Result<()> {
        if self.reuse_visible && self.poses.is_none() {
            return Err(Error::usage("--reuse-visible needs a series of poses", "give --poses FILE, or drop it"));
        }
        // The parser waives a required flag that conflicts with one that is given.
        #[cfg(feature = "ros")]
        if self.mcap.is_some() && self.poses.is_none() {
            return Err(Error::usage("--mcap needs poses with stamps", "give --poses FILE.tum"));
        }
        let of_one =
            [("--repeat", self.repeat.is_some()), ("--stats", self.stats.is_some()), ("--explain", self.explain)];
        match of_one.iter().find(|(_, given)| *given && self.is_series()) {
            None => Ok(()),
            Some((flag, _)) => {
                let what = format!("{flag} works for one sensor at one pose only");
                Err(Error::usage(what, "give --pose and --sensor; --json reports the time of each pose"))
            }
        }
    }

    /// Refuses what a moving sensor does not deliver yet.
    fn check_motion(&self) -> Result<()> {
        if self.deskew.is_some() && self.points_frame == PointsFrameArg::World {
            return Err(Error::usage("--deskew: points in the world need no moment", "drop one of the two"));
        }
        if self.deskew.is_some_and(|seconds| !seconds.is_finite()) {
            return Err(Error::usage("--deskew: the time is not finite", "give seconds after the stamp"));
        }
        let tells = self.layers.writes_something() || self.virtual_sensor.task.is_some();
        if !self.motion.is_given() || !tells {
            return Ok(());
        }
        let remedy = "predict images alone, or drop the motion";
        Err(Error::usage("features and virtual sensors of a moving sensor: each ray has a pose of its own", remedy))
    }

    /// The motion during the scans of a sensor; `given` is the only pose, if there is one.
    fn motions(&self, scene: &Scene, sensor: &Sensor, given: Option<&ExternalPose>) -> Result<ScanMotions> {
        let of = if self.robot.is_some() { PoseOf::Robot } else { PoseOf::Sensor };
        self.motion.motions(scene, sensor, given, meaning_of(&self.pose, of))
    }

    fn names(&self) -> Result<FileNames> {
        let mask = self.virtual_sensor.mask.as_ref();
        let features = self.layers.features.as_ref();
        let given =
            [self.out.as_ref(), self.png.as_ref(), self.depth_png.as_ref(), mask, self.points.as_ref(), features];
        FileNames::new(given, self.npy.as_deref(), self.rays.as_ref(), self.outputs, self.is_series())
    }

    /// The input files named on the command line.
    pub fn inputs(&self) -> impl Iterator<Item = &Path> {
        let sensor = self.sensor.as_deref().map(Path::new).or(self.robot.as_deref());
        let poses = self.pose_file();
        let features = self.layers.inputs().chain(self.virtual_sensor.corridor.as_deref()).chain(self.motion.inputs());
        [self.scene.as_path()].into_iter().chain(sensor).chain(poses).chain(features)
    }

    fn sensors(&self) -> Result<Vec<Sensor>> {
        let Some(robot) = &self.robot else {
            return Ok(vec![self.image.load(self.sensor.as_deref().unwrap_or_default())?]);
        };
        let flags = [(self.image.rectified, "rectified"), (self.image.destagger, "destagger")];
        if let Some((_, name)) = flags.into_iter().find(|(given, _)| *given) {
            let remedy = format!("write {name} = true at its sensors in the robot file");
            return Err(Error::usage(format!("--{name}: --robot names several sensors"), remedy));
        }
        let (robot, notices) = load_robot(robot)?;
        print::notices(&notices);
        Ok(robot.sensors)
    }

    /// The file of `--poses`; `-` is stdin, which may be a file too.
    pub fn pose_file(&self) -> Option<&Path> {
        self.poses.as_deref().map(|path| if path == Path::new("-") { Path::new("/dev/stdin") } else { path })
    }

    /// The poses. Files need all of them before any work: their names must differ, and arrays hold all poses.
    fn poses_for(&self, names: &FileNames) -> Result<Poses> {
        let of = if self.robot.is_some() { PoseOf::Robot } else { PoseOf::Sensor };
        match self.pose_file() {
            None => Ok(Poses::Given(vec![(String::new(), self.pose.parse_as(of)?)])),
            Some(path) => Poses::read(path, &self.pose, of, names.write_predictions()),
        }
    }

    /// The flags of the virtual sensor.
    pub fn virtual_sensor(&self) -> &VirtualArgs {
        &self.virtual_sensor
    }

    /// The flags of the deadline.
    pub fn deadline(&self) -> &DeadlineArgs {
        &self.deadline
    }

    /// The flags of features.
    pub fn layers(&self) -> &LayerArgs {
        &self.layers
    }

    /// The path of the model.
    pub fn scene(&self) -> &Path {
        &self.scene
    }

    /// Opens the scene without the excluded objects.
    pub fn open(&self, import: &ImportOptions) -> Result<Scene> {
        open_scene_without(&self.scene, import, self.index.tuned(), &self.exclude)
    }

    /// Returns true if a ROS 2 bag is written.
    pub fn writes_bag(&self) -> bool {
        #[cfg(feature = "ros")]
        return self.mcap.is_some();
        #[cfg(not(feature = "ros"))]
        false
    }

    /// Returns true if EXR files are written.
    pub fn writes_exr(&self) -> bool {
        self.out.is_some()
    }

    fn import_options(&self) -> Result<ImportOptions> {
        let default = self.frame.options()?;
        match (self.ids, self.merge_tolerance) {
            (IdsArg::Source, Some(_)) => {
                let remedy = "drop --merge-tolerance or --ids source";
                Err(Error::usage("--merge-tolerance: --ids source leaves triangles unmerged", remedy))
            }
            (IdsArg::Source, None) => Ok(ImportOptions { merge: false, ..default }),
            (IdsArg::Model, given) => {
                Ok(ImportOptions { merge_tolerance: given.unwrap_or(default.merge_tolerance), ..default })
            }
        }
    }

    /// The outputs named on the command line.
    pub fn asked(&self) -> NamedRequest {
        let of_preview = self.png.as_ref().map(|_| self.png_of);
        let outputs = Outputs::of(&self.outputs.iter().chain(of_preview).collect::<Vec<_>>());
        let (preview, many_poses) = (self.png.is_some(), self.poses.is_some());
        NamedRequest { outputs, virtual_sensor: self.virtual_sensor.task, preview, many_poses }
    }

    /// The images to predict: the requested ones, and those needed for the other files.
    pub fn request(&self, sensor: &Sensor) -> Result<Request> {
        let mut wanted: Vec<Output> = self.outputs.iter().collect();
        if self.png.is_some() {
            wanted.extend(png::preview_needs(sensor, self.png_of).iter());
        }
        wanted.extend(self.layers.needs(self.asked()));
        wanted.extend(self.virtual_sensor.outputs().iter());
        if self.points.is_some() || self.writes_bag() && !sensor.is_camera() {
            wanted.push(Output::Range);
        }
        if self.writes_bag() && sensor.is_camera() {
            wanted.push(Output::DepthZ);
        }
        if wanted.contains(&Output::DepthZ) && !sensor.is_camera() {
            let what = format!("depth_z: sensor {:?} is not a camera and has no optical axis", sensor.spec().name);
            return Err(Error::usage(what, "use range"));
        }
        if self.depth_png.is_some() {
            wanted.push(png::depth_output(sensor));
        }
        let request = Request::of(Outputs::of(&wanted)).with_ids(self.scheme());
        Ok(self.deadline.add_to(request))
    }

    /// The memory that the prediction and its files need.
    pub fn memory(&self, sensor: &Sensor, request: &Request, predictor: &Predictor) -> FrameMemory {
        let mut images = request.outputs;
        // The echo is computed from cos_incidence. It also needs polygon ids if reflection factors differ, which is
        // known only once the scene is open.
        if images.has(Output::Echo) {
            images = images.with(Output::CosIncidence);
        }
        if images.has(Output::Normal) {
            images = images.with(Output::PolygonId).with(Output::ObjectId);
        }
        let picture = self.png.as_ref().map(|_| presight_pictures::preview_size(sensor)).unwrap_or_default();
        FrameMemory {
            pixels: u64::from(sensor.width()) * u64::from(sensor.height()),
            scanner: matches!(sensor.spec().geometry, Geometry::Scanner(_)),
            on_device: predictor.engine_name() != "cpu",
            images: images.numbers() as u64,
            exr: self.out.as_ref().map_or(0, |_| self.outputs.numbers() as u64),
            picture: u64::from(picture.0) * u64::from(picture.1),
            depth_png: self.depth_png.is_some(),
            // Bytes per point: a position in f64, and a normal in f32.
            // A point of a bag has up to 30 bytes in addition to its position, and a copy in the encoded message.
            points: self.points.as_ref().map_or(0, |_| 24 + if self.normals() { 12 } else { 0 })
                + if self.writes_bag() { 84 } else { 0 },
            reading: self.virtual_sensor.bytes_by_pixel(self.layers.writes_something()),
        }
    }

    /// Returns true if points get normals: if these are requested, or both ids, from which they follow.
    fn normals(&self) -> bool {
        self.outputs.has(Output::Normal) || self.outputs.has(Output::PolygonId) && self.outputs.has(Output::ObjectId)
    }

    pub fn scheme(&self) -> IdScheme {
        if self.ids == IdsArg::Source { IdScheme::Source } else { IdScheme::Model }
    }

    pub fn writes_something(&self) -> bool {
        let files = [&self.out, &self.png, &self.depth_png, &self.points, &self.stats];
        let tells = self.layers.writes_something() || self.virtual_sensor.task.is_some();
        let arrays = self.npy.is_some() || self.rays.is_some();
        self.explain || tells || arrays || self.writes_bag() || files.iter().any(|f| f.is_some())
    }
}

/// Runs the command.
///
/// # Errors
/// Wrong usage; errors from reading the scene and sensor, from the engine, and from writing files.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let job = args.check()?;
    if args.is_series() { poses::run(args, job) } else { one::run(args, job) }
}
