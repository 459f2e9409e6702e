//! `presight predict --poses` and `--robot`: many predictions in one world, with one predictor.

#[cfg(feature = "ros")]
use super::bag;
use super::files::{Shown, attributes, write_files};
use super::{Args, Job};
use crate::file_names::{FileNames, Paths};
use crate::layers::Layers;
use crate::motion_args::ScanMotions;
#[cfg(feature = "ros")]
use crate::output_bag::OutputBag;
use crate::overlap::{make_and_write, make_then_write};
use crate::pose_series::{NamedPose, Poses, no_poses};
use crate::series::SeriesProgress;
use crate::summary::{Summary, objects_in};
use crate::templates::Names;
use crate::{CommandOutcome, bar, print};
use presight::files::{self, NpyStack};
use presight::sensor::ExternalPose;
use presight::tools::{self, FrameMemory};
use presight::{Error, ErrorKind, Output, Prediction, Predictor, Request, Result, Scene, Sensor, blake3_of};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Predicts at every pose for every sensor, and writes the files that are missing.
///
/// # Errors
/// Errors from reading, from the engine, and from writing. Finished files are kept, and the same command continues.
pub fn run(args: &Args, mut job: Job) -> Result<CommandOutcome> {
    let requests = job.sensors.iter().map(|s| args.request(s)).collect::<Result<Vec<Request>>>()?;
    let mut predictor = Predictor::new(job.options.clone())?;
    args.deadline().read_costs(&mut predictor)?;
    // With more than one thread, a frame is written while the next one is predicted.
    let overlapped = job.import.threads.count()? > 1;
    let frames = job.sensors.iter().zip(&requests).map(|(s, request)| args.memory(s, request, &predictor));
    let largest = of_frames(frames, if overlapped { 2 } else { 1 });
    tools::require_memory(largest)?;
    let scene = args.open(&job.import)?;
    let sensors = std::mem::take(&mut job.sensors);
    let mut setups = Vec::new();
    for (sensor, request) in sensors.into_iter().zip(requests) {
        setups.push(Setup::new(args, &scene, sensor, request)?);
    }
    // Check again: the scene has taken some of the memory.
    tools::require_memory(largest)?;
    let files = std::mem::take(&mut job.files);
    files.check_scene(&scene.files)?;
    for setup in &setups {
        job.names.rays(&setup.sensor)?.iter().try_for_each(|path| files::write_rays_npy(path, &setup.sensor))?;
    }
    let poses = std::mem::replace(&mut job.poses, Poses::Given(Vec::new()));
    let series = Series { args, scene: &scene, names: &job.names };
    let (mut progress, mut stacks) = series.progress(&setups, poses.given())?;
    #[cfg(feature = "ros")]
    let mut bag = job.bag.take();
    let bar = bar::bar(poses.given().len() as u64);
    let (mut all, mut incomplete, mut empty) = (0, 0, 0);
    let first = progress.as_ref().map_or(0, SeriesProgress::next);
    let mut items = poses.numbered(first).peekable();
    if first == 0 && items.peek().is_none() {
        return Err(no_poses(args.pose_file().unwrap_or(Path::new(""))));
    }
    let make = |item: Result<(usize, NamedPose)>, spare: Option<Frames>| {
        let (index, (stamp, pose)) = item?;
        let mut spare = spare.into_iter().flat_map(|spare| spare.frames);
        let mut make = |setup| {
            let spare = spare.next().map(|frame| frame.prediction);
            series.predict(&mut predictor, setup, (&stamp, &pose), spare)
        };
        let frames = setups.iter_mut().map(&mut make).collect::<Result<Vec<Frame>>>()?;
        print::notices(frames.iter().flat_map(|frame| &frame.prediction.stats.notices));
        all += frames.len();
        for frame in frames.iter().filter(|frame| frame.prediction.degradation().is_some()) {
            let images = &frame.prediction.images;
            incomplete += 1;
            empty += usize::from((0..images.pixels()).all(|at| images.is_open(at)));
        }
        Ok(Frames { index, stamp, frames })
    };
    let write = |made: &mut Frames| {
        let stacks = stacks.iter_mut().map(Some).chain(std::iter::repeat_with(|| None));
        let Frames { index, stamp, frames } = made;
        frames.iter().zip(stacks).try_for_each(|(frame, stacks)| series.write(frame, stacks, (*index, stamp)))?;
        #[cfg(feature = "ros")]
        if let Some(output) = &mut bag {
            for (k, frame) in frames.iter().enumerate() {
                // The robot has one pose, whatever its sensors.
                output.add(bag::records(args, &frame.prediction, stamp, (*index == 0, k == 0))?)?;
            }
        }
        bar.set_position(*index as u64 + 1);
        progress.as_mut().map_or(Ok(()), |progress| progress.append(*index, &format!("{index}\n")))
    };
    if overlapped { make_and_write(items, make, write) } else { make_then_write(items, make, write) }?;
    if incomplete > 0 {
        let what = format!("{incomplete} of {all} predictions are incomplete, {empty} of them empty");
        print::notices(&[format!("{what}: a longer --deadline-ms gives up less")]);
    }
    args.deadline().write_costs(&predictor)?;
    stacks.into_iter().flatten().try_for_each(|(_, stack)| stack.finish())?;
    #[cfg(feature = "ros")]
    bag.iter_mut().try_for_each(OutputBag::finish)?;
    progress.map_or(Ok(()), SeriesProgress::remove)?;
    bar.finish_and_clear();
    Ok(CommandOutcome::Done)
}

/// The memory for `kept` predictions of all sensors, and for the work on one of them, bytes.
fn of_frames(frames: impl Iterator<Item = FrameMemory>, kept: u64) -> u64 {
    let (mut images, mut work) = (0, 0);
    for frame in frames {
        images += kept * frame.of_images();
        work = work.max(frame.bytes() - frame.of_images());
    }
    images + work
}

/// A sensor with its request, features and EXR attributes.
struct Setup {
    sensor: Sensor,
    /// The request for images, without features.
    request: Request,
    layers: Option<Layers>,
    attributes: Option<files::ExrAttributes>,
    motions: ScanMotions,
}

impl Setup {
    fn new(args: &Args, scene: &Scene, sensor: Sensor, request: Request) -> Result<Self> {
        let layers = args.layers().load(scene, &sensor, args.asked())?;
        if layers.is_some() {
            sensor.check_projection().map_err(|e| e.at(&sensor.spec().name))?;
        }
        let attributes = args.writes_exr().then(|| attributes(args, scene, &sensor)).transpose()?;
        let motions = args.motions(scene, &sensor, None)?;
        Ok(Self { sensor, request, layers, attributes, motions })
    }
}

/// A prediction with the data for its files.
struct Frame {
    prediction: Prediction,
    shown: Shown,
    attributes: Option<files::ExrAttributes>,
    /// Time of the prediction, milliseconds.
    ms: f64,
    engine: String,
}

/// The predictions of all sensors at one pose.
struct Frames {
    index: usize,
    stamp: String,
    frames: Vec<Frame>,
}

/// The arrays of one sensor that hold all poses.
type Stacks = Vec<(Output, NpyStack)>;

/// Predictions at all poses.
struct Series<'a> {
    args: &'a Args,
    scene: &'a Scene,
    names: &'a FileNames,
}

impl Series<'_> {
    fn paths(&self, sensor: &Sensor, index: usize, stamp: &str) -> Result<Paths> {
        self.names.paths(&Names { index, stamp, sensor: &sensor.spec().name, output: "" })
    }

    /// Opens the record of an interrupted series and its unfinished arrays; `None` if the series writes no files.
    fn progress(&self, setups: &[Setup], poses: &[NamedPose]) -> Result<(Option<SeriesProgress>, Vec<Stacks>)> {
        if !self.names.write_predictions() {
            return Ok((None, Vec::new()));
        }
        let first = self.paths(&setups[0].sensor, 0, &poses[0].0)?;
        let head = format!("presight series 1 {}", self.job(setups, poses)?);
        let mut progress = SeriesProgress::open(&record(first)?, &head, 0..poses.len(), 1)?;
        let until = progress.written().filter(|_| progress.finished() > 0);
        let (mut kept, mut stacks) = (true, Vec::new());
        for setup in setups.iter().filter(|_| self.names.are_stacked()) {
            let mut of_setup = Stacks::new();
            for (output, path) in self.paths(&setup.sensor, 0, &poses[0].0)?.npy {
                let size = (setup.sensor.width(), setup.sensor.height());
                let (stack, goes_on) = NpyStack::open(&path, poses.len(), size, output, until)?;
                kept &= goes_on;
                of_setup.push((output, stack));
            }
            stacks.push(of_setup);
        }
        let stacked = self.names.are_stacked();
        // A bag holds all poses, so a resumed run writes the whole bag again.
        let kept = kept && !self.args.writes_bag();
        let are_there = |setup: &Setup, i| {
            let paths = || self.paths(&setup.sensor, i, &poses[i].0);
            until.is_some_and(|until| paths().is_ok_and(|paths| paths.are_there(stacked, until)))
        };
        progress.keep_while(|i| kept && setups.iter().all(|setup| are_there(setup, i)))?;
        print::finished_before(&progress, poses.len());
        if progress.replaced() {
            print::message("note: another series was left unfinished here; writing all files again");
        }
        Ok((Some(progress), stacks))
    }

    /// A hash over all inputs of the files.
    fn job(&self, setups: &[Setup], poses: &[NamedPose]) -> Result<String> {
        let mut hasher = blake3::Hasher::new();
        let environment = self.scene.world.environment();
        let what = format!("{} {:?} {}", env!("CARGO_PKG_VERSION"), self.args, environment.content_hash());
        hasher.update(what.as_bytes());
        for pose in poses {
            hasher.update(format!("{pose:?}").as_bytes());
        }
        for setup in setups {
            hasher.update(files::sensor_to_toml(setup.sensor.spec()).as_bytes());
        }
        let files = self.args.layers().inputs().chain(self.args.virtual_sensor().corridor.as_deref());
        let files = files.chain(self.args.motion.inputs());
        for file in files {
            hasher.update(blake3_of(file)?.as_bytes());
        }
        Ok(hasher.finalize().to_hex().to_string())
    }

    /// Predicts at one pose for one sensor, reusing the memory of an older prediction.
    fn predict(
        &self,
        predictor: &mut Predictor,
        setup: &mut Setup,
        (stamp, given): (&str, &ExternalPose),
        spare: Option<Prediction>,
    ) -> Result<Frame> {
        let Self { args, scene, .. } = *self;
        let Setup { sensor, request, layers, attributes, motions } = setup;
        let pose = given.of_sensor(sensor.spec(), &scene.world_from_gltf)?;
        if let Some(layers) = layers {
            layers.move_to(given, sensor, &pose, scene);
        }
        let mut request = layers.as_ref().map_or(request.clone(), |layers| layers.add_to(request.clone()));
        request.motion = motions.at(sensor, if stamp.is_empty() { args.motion.stamp()? } else { seconds(stamp)? })?;
        let settings = args.virtual_sensor().settings(scene, sensor, &pose, predictor)?;
        let start = Instant::now();
        let predicted = match spare {
            None => predictor.predict(&scene.world, sensor, &pose, &request),
            Some(mut prediction) => {
                prediction.request.clone_from(&request);
                predictor.predict_again(&scene.world, &pose, &mut prediction).map(|()| prediction)
            }
        };
        let mut prediction = match predicted {
            // One frame without enough time does not end the series.
            Err(e) if e.kind() == ErrorKind::Deadline => predictor.give_up(&scene.world, sensor, &pose, &request)?,
            other => other?,
        };
        let ms = start.elapsed().as_secs_f64() * 1e3;
        layers.iter().for_each(|layers| layers.spell_out(scene, &mut prediction));
        let shown = Shown::of(args, scene, predictor, &prediction, (layers.as_ref(), &settings))?;
        Ok(Frame { prediction, shown, attributes: attributes.clone(), ms, engine: predictor.engine_name() })
    }

    /// Writes the files of a prediction, and prints its summary.
    fn write(&self, frame: &Frame, stacks: Option<&mut Stacks>, (index, stamp): (usize, &str)) -> Result<()> {
        let Frame { prediction, shown, attributes, ms, engine } = frame;
        let paths = self.paths(&prediction.sensor, index, stamp)?;
        write_files(self.args, &paths, self.scene, prediction, attributes.clone(), shown)?;
        match stacks {
            Some(stacks) => {
                stacks.iter_mut().try_for_each(|(output, stack)| stack.put_image(index, &prediction.images, *output))?
            }
            None => {
                paths.npy.iter().try_for_each(|(output, path)| files::write_npy(path, &prediction.images, *output))?
            }
        }
        self.tell(prediction, (index, stamp), (*ms, engine))
    }

    fn tell(&self, prediction: &Prediction, (index, stamp): (usize, &str), (ms, engine): (f64, &str)) -> Result<()> {
        if self.args.json {
            let summary = Summary::of(prediction, objects_in(self.scene.world.environment()));
            let mut value = summary.json(self.args.scene(), prediction, ms, engine);
            value["pose"] = index.into();
            value["stamp"] = stamp.into();
            return print::data(&format!("{value}\n"));
        }
        if self.args.writes_something() {
            return Ok(());
        }
        let summary = Summary::of(prediction, objects_in(self.scene.world.environment()));
        print::lines([format!("{index}: {}, {ms:.2} ms on {engine}", summary.in_words(prediction))])
    }
}

/// The stamp of a scan as written in the file of poses.
fn seconds(stamp: &str) -> Result<f64> {
    let what = || Error::invalid(format!("a stamp of {stamp:?}"), "give seconds");
    stamp.parse().map_err(|_| what())
}

/// The path of the record of finished poses, in the folder of the first file.
fn record(first: Paths) -> Result<PathBuf> {
    let Paths { out, png, depth_png, mask, points, features, npy } = first;
    let named = [out, png, depth_png, mask, points, features];
    let all: Vec<PathBuf> = named.into_iter().flatten().chain(npy.into_iter().map(|(_, path)| path)).collect();
    let regular = |path: &&PathBuf| path.metadata().map_or(true, |m| m.is_file());
    let Some(first) = all.iter().find(regular) else {
        let what = "a series needs an output file, and only devices and pipes are named";
        return Err(Error::usage(what, "name a file, or give one --pose"));
    };
    let hash = blake3::hash(format!("{all:?}").as_bytes()).to_hex();
    Ok(first.parent().unwrap_or(Path::new("")).join(format!(".presight-{}.series", &hash[..12])))
}
