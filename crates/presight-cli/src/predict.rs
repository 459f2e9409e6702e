//! `presight predict`: what a sensor at a pose sees.

use super::layers::{Asked, LayerArgs, Layers};
use super::outputs::OutputFiles;
use super::pose::PoseArgs;
use super::statistics::{Statistics, Subject};
use super::virtual_sensor::VirtualArgs;
use super::{Verdict, open_scene, print};
use clap::ValueEnum;
use presight::Threads;
use presight::features::{FeaturePrediction, SeenFeature};
use presight::frames::GivenPose;
use presight::index::Scheme;
use presight::io::atomic::write_atomically;
use presight::io::gltf::ImportOptions;
use presight::io::{PointCloud, PointsFrame, exr, load_sensor, pcd, ply, png, sensor_toml};
use presight::memory::{self, Frame};
use presight::plan::{IdScheme, Output, Outputs, Stats};
use presight::sensor::{Geometry, Sensor};
use presight::virtual_sensors::VirtualReading;
use presight::{Backend, Error, Options, Prediction, Predictor, Request, Result, Scene, blake3_of};
use std::collections::HashSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  A picture of what a radar sees from 1.2 m above the point (2, 1), looking along +y:
    presight predict hall.glb --sensor microwave-radar-image --pose 2,1,1.2,0,0,90 --png view.png

  All images of a camera looking 10 degrees down, as OpenEXR:
    presight predict hall.glb --sensor video-camera --pose 0,0,1.5,0,10,0 --out view.exr

  A point cloud in world coordinates, and a depth image for ROS:
    presight predict hall.glb --sensor realsense-d435 --pose 0,0,1,0,0,0 \\
      --points cloud.ply --points-frame world --depth-png depth.png

  Which features are seen, where to look for them, and a picture of them:
    presight predict hall.glb --sensor video-camera --pose 0,0,1.5,0,10,0 \\
      --layer hall.video.layer.json --pose-cov 0.05,0.05,0,0,0,2 --features seen.json --png seen.png

  Where the floor is free, as polygons in the robot's frame, and a picture of it:
    presight predict hall.glb --sensor video-camera --pose 0,0,1.5,0,20,0 \\
      --virtual free-floor --features floor.json --png floor.png

  How fast, and what was left out:
    presight predict hall.glb --sensor vlp-16 --pose 0,0,1,0,0,0 --repeat 50 --stats stats.json --explain";

/// Predict the images of a sensor at a pose
///
/// Without an output flag a one-line summary is printed.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The model: a .glb or .gltf file, a .rhai script, or a store
    scene: PathBuf,

    /// A preset (see `presight sensors`) or a sensor file
    #[arg(long, value_name = "PRESET|FILE")]
    sensor: String,

    #[command(flatten)]
    pose: PoseArgs,

    /// Which engine predicts
    #[arg(long, value_enum, default_value_t = BackendArg::Auto)]
    backend: BackendArg,

    /// How polygons are selected: none, grid, plop, s2d, s3d or two-level; the images are the same with any
    #[arg(long, value_name = "INDEX", default_value = Scheme::default().name())]
    index: Scheme,

    /// Images to predict, of range, depth_z, polygon_id, object_id, cos_incidence, echo, feature_id
    #[arg(long, value_name = "LIST", default_value = "range,polygon_id,object_id,cos_incidence")]
    outputs: Outputs,

    /// Write the images as OpenEXR, lossless
    #[arg(long, value_name = "FILE.exr")]
    out: Option<PathBuf>,

    /// Write a preview for people
    #[arg(long, value_name = "FILE.png")]
    png: Option<PathBuf>,

    /// What the preview shows
    #[arg(long, value_name = "OUTPUT", default_value = "range", value_parser = parse_output, requires = "png")]
    png_of: Output,

    #[command(flatten)]
    layers: LayerArgs,

    #[command(flatten)]
    virtual_sensor: VirtualArgs,

    /// Write a 16-bit depth image in millimetres, 0 = no value (a camera's depth_z, otherwise range)
    #[arg(long, value_name = "FILE.png")]
    depth_png: Option<PathBuf>,

    /// Write the seen points as a point cloud; to a device or pipe without an ending as PLY
    #[arg(long, value_name = "FILE.ply|FILE.pcd")]
    points: Option<PathBuf>,

    /// In which frame the points are
    #[arg(long, value_enum, default_value_t = PointsFrameArg::Sensor, requires = "points")]
    points_frame: PointsFrameArg,

    /// What polygon_id numbers: merged polygons of the model, or triangles of the file
    #[arg(long, value_enum, default_value_t = IdsArg::Model)]
    ids: IdsArg,

    /// Merge coplanar neighbours within this part of an object's size [default: 1e-6]
    #[arg(long, value_name = "X")]
    merge_tolerance: Option<f64>,

    /// CPU threads, 0 = all cores
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,

    /// Print what was done, what it cost, what was left out and why
    #[arg(long)]
    explain: bool,

    /// Predict N times more after a first one that warms up, and report on these
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    repeat: Option<u32>,

    /// Write statistics of the repeated predictions
    #[arg(long, value_name = "FILE.json")]
    stats: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BackendArg {
    /// A hardware GPU if there is one, otherwise the CPU engine
    Auto,
    /// The CPU engine
    Cpu,
    /// wgpu on any adapter, a software one too
    Gpu,
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

fn parse_output(name: &str) -> Result<Output> {
    let names = Output::WITH_FEATURES.map(Output::name).join(", ");
    let found = Output::WITH_FEATURES.into_iter().find(|o| o.name() == name);
    found.ok_or_else(|| Error::usage("unknown output", format!("choose from {names}")))
}

/// The arguments, checked as far as they go without touching the world.
struct Job {
    pose: GivenPose,
    files: OutputFiles,
    import: ImportOptions,
    options: Options,
}

impl Args {
    fn check(&self) -> Result<Job> {
        self.layers.check(self.asked())?;
        self.virtual_sensor.check()?;
        let (pose, files, import) = (self.pose.parse()?, self.files()?, self.import_options()?);
        let threads = Threads::from(self.threads).started()?;
        Ok(Job {
            pose,
            files,
            import: ImportOptions { threads: threads.clone(), ..import },
            options: Options::new(self.backend.into()).with_threads(threads),
        })
    }

    /// The files to write, none of which is named as one to read.
    fn files(&self) -> Result<OutputFiles> {
        let mut files = OutputFiles::new();
        for (option, path, endings) in [
            ("--out", &self.out, &["exr"] as &[_]),
            ("--png", &self.png, &["png"]),
            ("--depth-png", &self.depth_png, &["png"]),
            ("--mask", &self.virtual_sensor.mask, &["png"]),
            ("--points", &self.points, &["ply", "pcd"]),
            ("--features", &self.layers.features, &["json"]),
            ("--stats", &self.stats, &["json"]),
        ] {
            files.add(option, path.as_deref(), endings)?;
        }
        files.check_named([self.scene.as_path(), Path::new(&self.sensor)])?;
        files.check_named(self.layers.inputs().chain(self.virtual_sensor.corridor.as_deref()))?;
        Ok(files)
    }

    fn import_options(&self) -> Result<ImportOptions> {
        let default = ImportOptions::default();
        match (self.ids, self.merge_tolerance) {
            (IdsArg::Source, Some(_)) => {
                let remedy = "drop --merge-tolerance or --ids source";
                Err(Error::usage("--merge-tolerance: source ids are of unmerged triangles", remedy))
            }
            (IdsArg::Source, None) => Ok(ImportOptions { merge: false, ..default }),
            (IdsArg::Model, given) => {
                Ok(ImportOptions { merge_tolerance: given.unwrap_or(default.merge_tolerance), ..default })
            }
        }
    }

    /// Everything asked for by name.
    fn asked(&self) -> Asked {
        let of_preview = self.png.as_ref().map(|_| self.png_of);
        let outputs = Outputs::of(&self.outputs.iter().chain(of_preview).collect::<Vec<_>>());
        Asked { outputs, virtual_sensor: self.virtual_sensor.task, preview: self.png.is_some() }
    }

    /// The images to predict: what was asked for, and what the other files are drawn from.
    fn request(&self, sensor: &Sensor) -> Result<Request> {
        let mut wanted: Vec<Output> = self.outputs.iter().collect();
        if self.png.is_some() {
            wanted.extend(png::preview_needs(sensor, self.png_of).iter());
        }
        wanted.extend(self.layers.needs(self.asked()));
        wanted.extend(self.virtual_sensor.outputs().iter());
        if self.points.is_some() {
            wanted.extend([Output::Range, Output::PolygonId]);
        }
        if wanted.contains(&Output::DepthZ) && !sensor.is_camera() {
            let what = format!("depth_z: sensor {:?} is no camera and has no optical axis", sensor.spec().name);
            return Err(Error::usage(what, "ask for range"));
        }
        if self.depth_png.is_some() {
            wanted.push(png::depth_output(sensor));
        }
        Ok(Request::of(Outputs::of(&wanted)).with_ids(self.scheme()))
    }

    /// What the prediction and its files take of memory.
    fn frame(&self, sensor: &Sensor, request: &Request, predictor: &Predictor) -> Frame {
        let mut images = request.outputs;
        // What the echo is made of, for which there may be no other reason; more only where reflection factors differ, as is
        // known when the scene is.
        if images.has(Output::Echo) {
            images = images.with(Output::CosIncidence);
        }
        let picture = self.png.as_ref().map(|_| presight::internal::preview_size(sensor)).unwrap_or_default();
        let written = self.out.as_ref().map_or(0, |_| self.outputs.iter().count());
        Frame {
            pixels: u64::from(sensor.width()) * u64::from(sensor.height()),
            scanner: matches!(sensor.spec().geometry, Geometry::Scanner(_)),
            on_device: predictor.engine_name() != "cpu",
            images: images.iter().count() as u64,
            exr: written as u64,
            picture: u64::from(picture.0) * u64::from(picture.1),
            depth_png: self.depth_png.is_some(),
            points: self.points.is_some(),
            reading: self.virtual_sensor.bytes_by_pixel(self.layers.writes_something()),
        }
    }

    fn scheme(&self) -> IdScheme {
        if self.ids == IdsArg::Source { IdScheme::Source } else { IdScheme::Model }
    }

    fn writes_something(&self) -> bool {
        let files = [&self.out, &self.png, &self.depth_png, &self.points, &self.stats];
        let tells = self.layers.writes_something() || self.virtual_sensor.task.is_some();
        self.explain || tells || files.iter().any(|f| f.is_some())
    }
}

impl From<BackendArg> for Backend {
    fn from(backend: BackendArg) -> Self {
        match backend {
            BackendArg::Auto => Self::Auto,
            BackendArg::Cpu => Self::Cpu,
            BackendArg::Gpu => Self::Gpu,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// Wrong usage, those of scene and sensor, of the engine, and of writing.
pub fn run(args: &Args) -> Result<Verdict> {
    let job = args.check()?;
    let (sensor, notices) = load_sensor(&args.sensor)?;
    print::notices(&notices);
    args.virtual_sensor.check_sensor(&sensor)?;
    let request = args.request(&sensor)?;
    let mut predictor = Predictor::new(job.options)?;
    let frame = args.frame(&sensor, &request, &predictor);
    memory::require(frame.bytes())?;
    let scene = open_scene(&args.scene, &job.import, args.index)?;
    let world_from_sensor = job.pose.of_sensor(sensor.spec(), &scene.world_from_gltf)?;
    let layers = args.layers.load(&scene, &sensor, (&job.pose, &world_from_sensor), args.asked())?;
    if layers.is_some() {
        sensor.check_projection().map_err(|e| e.in_file(&args.sensor))?;
    }
    let request = layers.as_ref().map_or(request.clone(), |layers| layers.add_to(request));
    let settings = args.virtual_sensor.settings(&scene, &sensor, &world_from_sensor, &mut predictor)?;
    // What the scene has left.
    memory::require(frame.bytes())?;
    let start = Instant::now();
    let mut prediction = predictor.predict(&scene.world, &sensor, &world_from_sensor, &request)?;
    let first_ms = start.elapsed().as_secs_f64() * 1e3;
    let (mut times_ms, mut runs): (Vec<f64>, Vec<Stats>) = Default::default();
    let repeat = args.repeat.unwrap_or(u32::from(args.stats.is_some()));
    for _ in 0..repeat {
        let start = Instant::now();
        predictor.predict_again(&scene.world, &world_from_sensor, &mut prediction)?;
        times_ms.push(start.elapsed().as_secs_f64() * 1e3);
        runs.push(prediction.stats.clone());
    }
    if repeat == 0 {
        times_ms.push(first_ms);
        runs.push(prediction.stats.clone());
    }
    print::notices(&prediction.stats.notices);
    let subject = Subject {
        scene: args.scene.display().to_string(),
        sensor: sensor.spec().name.clone(),
        size: (sensor.width(), sensor.height()),
        outputs: request.outputs.iter().map(Output::name).collect(),
    };
    let statistics = Statistics::of(subject, &times_ms, &runs);
    let reading = args.virtual_sensor.read(&scene, &prediction, &settings)?;
    let sides = match args.png.is_some() {
        true => predictor.predict_outlines(&scene.world, &prediction)?,
        false => Vec::new(),
    };
    job.files.check_read()?;
    write_files(args, &scene, &prediction, (layers.as_ref(), &sides), reading.as_ref())?;
    if let Some(path) = &args.stats {
        let json = serde_json::to_string_pretty(&statistics)
            .map_err(|e| Error::invalid(format!("statistics are no JSON: {e}"), "").in_file(path))?;
        write_atomically(path, |file| writeln!(file, "{json}"))?;
    }
    if args.explain {
        print::lines(statistics.explanation())?;
    } else if !args.writes_something() {
        print::lines([summary(&scene, &prediction, &statistics)])?;
    }
    Ok(Verdict::Done)
}

/// Writes all files that are asked for; `sides` are of patches that are seen in part.
fn write_files(
    args: &Args,
    scene: &Scene,
    prediction: &Prediction,
    (layers, sides): (Option<&Layers>, &[SeenFeature]),
    reading: Option<&VirtualReading>,
) -> Result<()> {
    let (sensor, images) = (&prediction.sensor, &prediction.images);
    if let Some(path) = &args.out {
        let attributes = attributes(args, scene, prediction)?;
        exr::write(path, images, args.outputs, &attributes)?;
    }
    if let Some(path) = &args.png {
        let overlay = prediction.features.as_ref().map(|features| png::Overlay {
            features,
            sides,
            sensor,
            world_from_sensor: &prediction.world_from_sensor,
            numbers: args.layers.numbers(),
        });
        let mark = reading.and_then(VirtualReading::mask);
        png::write_preview_with(path, images, sensor, args.png_of, overlay.as_ref(), mark)?;
    }
    args.layers.write(scene, prediction, layers, reading)?;
    args.virtual_sensor.tell(reading, args.layers.writes_something())?;
    if let Some(path) = &args.depth_png {
        print::notices(&png::write_depth(path, images, sensor)?);
    }
    if let Some(path) = &args.points {
        let frame = match args.points_frame {
            PointsFrameArg::Sensor => PointsFrame::Sensor,
            PointsFrameArg::World => PointsFrame::World,
        };
        let cloud = PointCloud::new(images, sensor, &prediction.world_from_sensor, frame)?;
        match path.extension().is_some_and(|e| e.eq_ignore_ascii_case("pcd")) {
            true => pcd::write(path, &cloud)?,
            false => ply::write(path, &cloud)?,
        }
    }
    Ok(())
}

fn attributes(args: &Args, scene: &Scene, prediction: &Prediction) -> Result<exr::Attributes> {
    let objects = scene.world.environment().objects();
    Ok(exr::Attributes {
        sensor: Some(sensor_toml::to_string(prediction.sensor.spec())),
        world_from_sensor: Some(prediction.world_from_sensor),
        scene: Some(args.scene.display().to_string()),
        scene_blake3: Some(blake3_of(&args.scene)?),
        ids: Some(args.scheme()),
        objects: (1..).zip(objects.iter().map(|o| o.name.clone())).collect(),
    })
}

/// One line: what was predicted, what is in it, what it took.
fn summary(scene: &Scene, prediction: &Prediction, statistics: &Statistics) -> String {
    let (sensor, images) = (&prediction.sensor, &prediction.images);
    let mut parts = vec![format!("{} {} x {}", sensor.spec().name, sensor.width(), sensor.height())];
    let percent = |n: usize| 100.0 * n as f64 / images.pixels() as f64;
    if !images.range.is_empty() {
        let seen = || images.range.iter().copied().filter(|r| r.is_finite());
        let (near, far) = seen().fold((f32::INFINITY, 0f32), |(lo, hi), r| (lo.min(r), hi.max(r)));
        parts.push(match seen().count() {
            0 => "no ray hits".into(),
            hits => format!("{:.1} % of rays hit at {near:.3}..{far:.3} m", percent(hits)),
        });
    }
    if !images.object_id.is_empty() {
        // Neighbours mostly are the same: few are looked up.
        let mut ids: HashSet<u32> = images.object_id.chunk_by(|a, b| a == b).map(|run| run[0]).collect();
        ids.remove(&0);
        let there = scene.world.environment().objects().iter().filter(|o| !o.is_deleted()).count();
        parts.push(format!("{} of {there} objects seen", ids.len()));
    }
    if let Some(FeaturePrediction { features, .. }) = &prediction.features {
        let seen = features.iter().filter(|f| !f.visible.is_empty()).count();
        parts.push(format!("{seen} of {} features seen", features.len()));
    }
    parts.push(format!("{:.2} ms on {}", statistics.median_ms(), statistics.engine_in_words()));
    parts.join(", ")
}
