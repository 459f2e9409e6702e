//! `presight index`: measures the cost and selectivity of the spatial indexes.

use super::frame_args::FrameArgs;
use super::outputs::OutputFiles;
use super::pose_series::read_poses;
use super::{CommandOutcome, open_scene, print};
use presight::environment::IndexKind;
use presight::files::{ImportOptions, load_sensor};
use presight::predict::free_poses;
use presight::sensor::PRESETS;
use presight::tools::{create_folder, write_atomically};
use presight::{Backend, Options, Pose, Result, Threads, preset};
use presight_studies::index::Scheme;
use presight_studies::index_study::{self, Row, Study};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight index hall.glb
  presight index hall.glb --out study                  # also write study/index.csv
  presight index hall.glb --sweep --sensor vlp-16 --out study";

/// Measure the spatial indexes: build time, memory, access time, selectivity, whole predictions
///
/// Prints medians over many free poses for every index and every query: `sector` (10 m, 60 degrees, any height) and the
/// region of each preset. needed: polygons with a point in the region; selectivity: needed / returned.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The model: a .glb or .gltf file, a .rhai script, or a store
    scene: PathBuf,

    #[command(flatten)]
    frame: FrameArgs,

    /// Write index.csv into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Number of free poses
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    count: u32,

    /// Seed of the random free poses
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,

    /// Use these poses of the sensors: lines of timestamp tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE.tum", conflicts_with_all = ["count", "seed"])]
    poses: Option<PathBuf>,

    /// Measure only these indexes [default: all]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    only: Vec<Scheme>,

    /// Query only the sector and this sensor's region [default: all presets]
    #[arg(long, value_name = "PRESET|FILE")]
    sensor: Option<String>,

    /// Measure many cell sizes of every index
    #[arg(long)]
    sweep: bool,

    /// Return all polygons of cells that are partly in the region, as the paper's indexes do
    #[arg(long)]
    unfiltered: bool,

    /// Repetitions of each query and prediction; the fastest counts
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: u32,

    /// CPU threads of predictions, 0 = all cores
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
}

/// The files in `--out`.
const FILES: [&str; 1] = ["index.csv"];

/// Runs the command.
///
/// # Errors
/// Errors from reading the scene, sensor and poses, from predictions, and from writing.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let mut files = OutputFiles::default();
    args.out.as_deref().map_or(Ok(()), |folder| files.add_folder(folder, &FILES))?;
    let named = [Some(args.scene.as_path()), args.poses.as_deref(), args.sensor.as_deref().map(Path::new)];
    files.check_named(named.into_iter().flatten())?;
    let threads = Threads::from(args.threads).started()?;
    let import = ImportOptions { threads: threads.clone(), ..args.frame.options()? };
    let sensors = match &args.sensor {
        Some(name) => {
            let (sensor, notices) = load_sensor(name)?;
            print::notices(&notices);
            vec![(sensor.spec().name.clone(), sensor)]
        }
        None => PRESETS.iter().map(|p| Ok((p.name.to_owned(), preset(p.name)?))).collect::<Result<_>>()?,
    };
    let given = args.poses.as_deref().map(read_poses).transpose()?;
    let scene = open_scene(&args.scene, &import, IndexKind::default())?;
    let world = scene.world;
    let seed = given.is_none().then_some(args.seed);
    let poses: Vec<Pose> = match given {
        Some(given) => given,
        None => free_poses(&world, args.count as usize, args.seed)?,
    };
    index_study::check_poses(&poses)?;
    files.check_scene(&scene.files)?;
    args.out.as_deref().map(create_folder).transpose()?;
    let count = poses.len();
    let options = Options::new(Backend::Cpu).with_threads(threads);
    let study = Study { poses, sensors, options, repeats: args.repeat as usize };
    let progress = |what: &str| {
        if std::io::stderr().is_terminal() {
            print::message(what);
        }
    };
    let rows = study.run(&world, &index_study::variants(&args.only, args.sweep, !args.unfiltered), progress)?;
    print::lines(table(&rows, count, world.environment().slot_count(), args.sweep))?;
    if let Some(folder) = &args.out {
        let [csv_file] = FILES.map(|name| folder.join(name));
        let csv = index_study::to_csv(&rows, count, seed);
        write_atomically(&csv_file, |file| file.write_all(csv.as_bytes()))?;
    }
    Ok(CommandOutcome::Done)
}

fn table(rows: &[Row], poses: usize, polygons: u32, swept: bool) -> Vec<String> {
    let mut lines = vec![format!("{polygons} polygons, {poses} poses, medians; selectivity = needed / returned")];
    let wide = rows.iter().map(|r| r.query.len()).max().unwrap_or(0).max(5);
    lines.push(format!(
        "{:9}  {:wide$}  {:>9}  {:>11}  {:>9}  {:>8}  {:>8}  {:>11}  {:>13}{}",
        "scheme",
        "query",
        "build ms",
        "bytes",
        "access us",
        "needed",
        "returned",
        "selectivity",
        "prediction ms",
        if swept { "  tuned" } else { "" },
    ));
    for r in rows {
        let prediction = r.prediction_ms.map_or_else(|| "-".into(), |ms| format!("{ms:.3}"));
        let mut line = format!(
            "{:9}  {:wide$}  {:>9.2}  {:>11}  {:>9.1}  {:>8}  {:>8}  {:>11.3}  {prediction:>13}",
            r.scheme.name(),
            r.query,
            r.build_ms,
            r.bytes,
            r.access_us,
            r.needed,
            r.returned,
            r.selectivity,
        );
        if swept {
            let used = &r.params;
            line += &format!("  {} polygons, {} m, {:?}", used.cell_polygons, used.min_cell, used.split_axis);
        }
        lines.push(line);
    }
    lines
}
