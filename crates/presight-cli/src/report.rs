//! `presight report`: studies as HTML pages.

use super::bar::bar;
use super::frame_args::FrameArgs;
use super::outputs::OutputFiles;
use super::pose_series::read_poses;
use super::{CommandOutcome, features, open_scene, print};
use presight::environment::IndexKind;
use presight::files::load_sensor;
use presight::predict::free_poses;
use presight::tools::{create_folder, printable, write_atomically};
use presight::{Error, Result, Sensor, Threads, preset};
use presight_studies::work_precision::{self, Effort, Findings, Scene, Study};
use presight_studies::{Machine, stability};
use std::ffi::OsString;
use std::io::Write;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight report hall.glb --out study                # index.html, report.json, and tables as CSV
  presight report hall.glb --out study --quick             # less than a minute
  presight report hall.glb --sensor camera.toml --out study --quick
  presight report --stability --quick --out stability      # every engine: stability.csv

Exit status: 1 if an exact path differs by more than rounding, or an error exceeds its bound.";

/// Measure error against run time and recommend settings, or check error bounds with --stability
///
/// Measures every engine and every setting that trades error for run time: resolution, part of the image, ray table,
/// index, visibility of features, regions of interest. Errors are relative to the reference engine. For lidars with beam
/// tables or scan times, it measures what one pose per scan, an even grid and one centre cost on a robot that drives.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The models: .glb or .gltf files, .rhai scripts, or stores
    scenes: Vec<PathBuf>,

    /// Check error bounds in built-in ill-conditioned and extreme cases; exit status 1 if there are faults
    #[arg(long, conflicts_with_all = ["scenes", "sensors", "poses", "seed", "up", "scale"])]
    stability: bool,

    /// Write the study into this folder
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    #[command(flatten)]
    frame: FrameArgs,

    /// Use fewer poses, runs and random samples: less than a minute on two cores
    #[arg(long)]
    quick: bool,

    /// Use this sensor; repeatable [default: video-camera, vlp-16, and without --quick a fisheye camera]
    #[arg(long = "sensor", value_name = "PRESET|FILE")]
    sensors: Vec<String>,

    /// Use these poses of the sensors instead of free ones: lines of timestamp tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE.tum")]
    poses: Option<PathBuf>,

    /// Seed of the random free poses
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "poses")]
    seed: u64,
}

/// The files of each study.
const STABILITY: [&str; 3] = ["index.html", "stability.csv", "report.json"];
const WORK_PRECISION: [&str; 4] = ["index.html", "work_precision.csv", "approximations.csv", "report.json"];

/// Number of free poses in a full study. A quick one has one.
const POSES: usize = 3;

/// Runs the command; pages show its `arguments`, in which invalid UTF-8 is replaced.
///
/// # Errors
/// Wrong usage; errors from reading scenes and sensors, from predictions, and from writing.
pub fn run(args: &Args, arguments: &[OsString]) -> Result<CommandOutcome> {
    let command = arguments.iter().map(|arg| arg.to_string_lossy().into_owned()).collect();
    let mut files = OutputFiles::default();
    let written: &[&str] = if args.stability { &STABILITY } else { &WORK_PRECISION };
    files.add_folder(&args.out, written)?;
    let named = args.scenes.iter().map(PathBuf::as_path).chain(args.poses.as_deref());
    files.check_named(named.chain(args.sensors.iter().map(Path::new)))?;
    Threads::SHARED.started()?;
    if args.stability { stability(args, command) } else { work_precision(args, files, command) }
}

fn stability(args: &Args, command: Vec<String>) -> Result<CommandOutcome> {
    create_folder(&args.out)?;
    let study = stability::Study::new(args.quick);
    let (mut engines, notes) = stability::subjects(0)?;
    notes.iter().for_each(|note| print::message(note));
    let progress = bar(study.steps() as u64);
    let rows = study.run(&mut engines, |what| {
        progress.set_message(printable(what).into_owned());
        progress.inc(1);
    });
    progress.finish_and_clear();
    let (rows, machine) = (rows?, Machine::this(features(), command));
    let about = stability::RunInfo { machine, notes };
    write(
        &args.out,
        STABILITY,
        [
            stability::to_html(&study, &rows, &about)?,
            stability::to_csv(&rows),
            stability::to_json(&study, &rows, &about)?,
        ],
    )?;
    let faults = stability::faults(&rows);
    let families = study.families.len();
    let page = args.out.join("index.html");
    let outcome = format!("{} cases in {families} families: {faults} faults", rows.len());
    print::lines([outcome, page.display().to_string()])?;
    Ok(if faults == 0 { CommandOutcome::Done } else { CommandOutcome::Found })
}

fn work_precision(args: &Args, files: OutputFiles, command: Vec<String>) -> Result<CommandOutcome> {
    let (study, inputs) = args.study()?;
    files.check_scene(&inputs)?;
    create_folder(&args.out)?;
    let progress = bar(study.steps() as u64);
    let findings = study.run(|what| {
        progress.set_message(printable(what).into_owned());
        progress.inc(1);
    });
    progress.finish_and_clear();
    let findings = findings?;
    let machine = Machine::this(features(), command);
    write(
        &args.out,
        WORK_PRECISION,
        [
            work_precision::to_html(&findings, &machine)?,
            work_precision::to_csv(&findings),
            work_precision::approximations_to_csv(&findings.approximations),
            work_precision::to_json(&findings, &machine)?,
        ],
    )?;
    print::lines(summary(&args.out, &findings, &study.sensors))?;
    Ok(if findings.faults() == 0 { CommandOutcome::Done } else { CommandOutcome::Found })
}

fn write<const N: usize>(folder: &Path, names: [&str; N], texts: [String; N]) -> Result<()> {
    for (name, text) in names.into_iter().zip(texts) {
        write_atomically(&folder.join(name), |file| file.write_all(text.as_bytes()))?;
    }
    Ok(())
}

/// The advice for each sensor, and the cost of predicting the `given` lidars as simpler ones.
fn summary(folder: &Path, findings: &Findings, given: &[Sensor]) -> impl Iterator<Item = String> {
    let advice = findings.findings.iter().map(|f| f.advice.clone());
    let costs = findings.approximations.iter().filter(|cost| given.iter().any(|s| s.spec().name == cost.sensor));
    advice.chain(costs.map(ToString::to_string)).chain([folder.join("index.html").display().to_string()])
}

/// The given sensors that have simpler ones, and the lidars of every study.
fn lidars(given: &[Sensor]) -> Result<Vec<Sensor>> {
    let mut lidars: Vec<Sensor> = given.iter().filter(|s| work_precision::is_approximated(s)).cloned().collect();
    for name in work_precision::LIDARS {
        let lidar = preset(name)?;
        if lidars.iter().all(|known| known.spec() != lidar.spec()) {
            lidars.push(lidar);
        }
    }
    Ok(lidars)
}

impl Args {
    /// The study, and the files of its scenes.
    fn study(&self) -> Result<(Study, Vec<PathBuf>)> {
        if self.scenes.is_empty() {
            let remedy = "give one or more: .glb, .gltf, .rhai or a store";
            return Err(Error::usage("no scene is given", remedy));
        }
        let sensors = self.sensors()?;
        let given = self.poses.as_deref().map(read_poses).transpose()?;
        let (mut scenes, mut files) = (Vec::new(), Vec::new());
        for path in &self.scenes {
            let opened = open_scene(path, &self.frame.options()?, IndexKind::default())?;
            files.extend(opened.files);
            let world = opened.world;
            let poses = match &given {
                Some(given) => given.clone(),
                None => {
                    free_poses(&world, if self.quick { 1 } else { POSES }, self.seed).map_err(|e| e.in_file(path))?
                }
            };
            scenes.push(Scene { name: path.display().to_string(), world, poses });
        }
        let effort = if self.quick { Effort::QUICK } else { Effort::FULL };
        let lidars = lidars(&sensors)?;
        Ok((Study { scenes, sensors, lidars, effort }, files))
    }

    fn sensors(&self) -> Result<Vec<Sensor>> {
        if self.sensors.is_empty() {
            let mut sensors = vec![preset("video-camera")?, preset("vlp-16")?];
            if !self.quick {
                sensors.push(work_precision::fisheye()?);
            }
            return Ok(sensors);
        }
        let read = |name: &String| {
            let (sensor, notices) = load_sensor(name)?;
            print::notices(&notices);
            Ok(sensor)
        };
        self.sensors.iter().map(read).collect()
    }
}
