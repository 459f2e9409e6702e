//! `presight supervise`: the free and the blocked cells of a corridor, frame by frame.

#[cfg(feature = "ros")]
use super::compared_bag::ComparedBag;
use super::drive::{Drive, Sensed};
#[cfg(feature = "ros")]
use super::output_bag::OutputBag;
use super::outputs::OutputFiles;
use super::{CommandOutcome, print};
#[cfg(feature = "ros")]
use glam::DVec3;
use presight::files;
use presight::localize::{Phase, Step};
use presight::measured::Frame;
#[cfg(feature = "ros")]
use presight::ros::{MarkerKind, MessageOrigin, Record, SceneMarker};
use presight::supervise::{CellState, Intrusion, Report, SuperviseOptions, Supervisor, UnseenReason};
use presight::tools::GrowingFile;
use presight::virtual_sensors::{Corridor, CorridorFrame};
use presight::{Backend, Error, Options, Pose, Predictor, Result, Scene, Threads};
use presight_pictures::{CorridorPicture, write_corridor};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

const EXAMPLES: &str = "Examples:
  presight supervise livingroom --map scenes/room.glb --sensor camera.toml --init reference \\
    --corridor way.json --speed 0.5 --out free.jsonl --png way.png
  presight supervise front=front rear=rear --robot kurt.toml --map scenes/room.glb \\
    --init reference --corridor way.json --out free.jsonl
  presight supervise scans.json --map corridor.glb --init reference --corridor way.json \\
    --upright --out free.jsonl";

/// Supervise the path ahead: the cells of a corridor that are free, known, intruded or not seen, and the reason
///
/// This is not a safety device. Tracks the robot as `localize` does, and compares each frame with the model in the
/// corridor of --corridor: a line in the robot's frame or in the world, a polygon, or a footprint over poses
/// (docs/formats.md). FILE.jsonl gets the cells and then one line for each frame; it grows as frames come, and stays
/// after an error or a signal. While the pose is not tracked, the measurement counts alone: all surfaces in the
/// corridor are intrusions.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    drive: Drive,

    /// The sensors of the robot: LOG is then NAME=LOG, the log of the sensor NAME, and more of them may follow
    #[arg(long, value_name = "ROBOT.toml", conflicts_with_all = ["sensor", "grey_sensor"])]
    robot: Option<PathBuf>,

    /// Logs of the robot's other sensors; frames with a time difference of at most 10 ms belong together
    #[arg(value_name = "NAME=LOG", requires = "robot")]
    beside: Vec<String>,

    /// The space through which the robot will move
    #[arg(long, value_name = "FILE.json")]
    corridor: PathBuf,

    /// Write the cells and their states here, a line for each frame
    #[arg(long, value_name = "FILE.jsonl")]
    out: PathBuf,

    /// Draw the corridor from above at the first tracked frame with an intrusion, or at the last frame
    #[arg(long, value_name = "FILE.png")]
    png: Option<PathBuf>,

    /// Side of the cells, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.1)]
    cell: f64,

    /// Width of the smallest intruder that a free cell cannot hide, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.07)]
    smallest: f64,

    /// Assume that what stands in the corridor reaches the heights that the sensor sees, as safety scanners do
    #[arg(long)]
    upright: bool,

    /// Speed along the corridor, metres per second, for the time until the first intrusion is reached
    #[arg(long, value_name = "M_PER_S", default_value_t = 0.0)]
    speed: f64,

    /// Leave unseen what cannot be looked at in this time, milliseconds a frame
    #[arg(long, value_name = "MS")]
    deadline_ms: Option<f64>,

    /// Write a ROS 2 bag: what `replay --mcap` writes, and cells and intrusions on /presight/corridor and
    /// /presight/intrusions
    #[cfg(feature = "ros")]
    #[arg(long, value_name = "OUT.mcap")]
    mcap: Option<PathBuf>,
}

impl Args {
    fn options(&self) -> Result<SuperviseOptions> {
        let deadline = match self.deadline_ms {
            Some(ms) if !(ms > 0.0 && ms <= 1e9) => {
                return Err(Error::usage(format!("--deadline-ms {ms}"), "give milliseconds above 0 and up to 1e9"));
            }
            ms => ms.map(|ms| Duration::from_secs_f64(ms / 1e3)),
        };
        let options = SuperviseOptions::default()
            .with_cell(self.cell)
            .with_smallest(self.smallest)
            .with_upright(self.upright)
            .with_speed(self.speed)
            .with_deadline(deadline);
        options.check()?;
        Ok(options)
    }
}

/// A run of the command.
struct Run {
    supervisor: Supervisor,
    predictor: Predictor,
    out: GrowingFile,
    frames: usize,
    intruded: usize,
    not_compared: usize,
    first: Option<String>,
    /// The report that is drawn, and the pose of the robot in the world.
    shown: Option<(Report, Pose)>,
}

/// Runs the command.
///
/// # Errors
/// Those of [`Drive::follow`], of the corridor file and of supervision, and write errors. The lines of earlier frames
/// stay.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let options = args.options()?;
    let mut files = OutputFiles::default();
    files.add("--out", Some(&args.out), &["jsonl"])?;
    files.add("--png", args.png.as_deref(), &["png"])?;
    #[cfg(feature = "ros")]
    let mut bag = OutputBag::of("--mcap", args.mcap.as_deref(), &mut files)?
        .map(|bag| ComparedBag::new(bag, args.drive.threads))
        .transpose()?;
    files.check_named([args.corridor.as_path()])?;
    files.check_named(args.robot.as_deref())?;
    let corridor = files::read_corridor(&args.corridor)?;
    let drive = args.drive.of_robot(args.robot.as_deref(), &args.beside)?;
    let mut run: Option<Run> = None;
    drive.follow(files, None, |scene, sensed, step| {
        // Only now: an error before the first step leaves the files of an earlier run.
        let run = match &mut run {
            Some(run) => run,
            None => run.insert(Run::new(args, &corridor, options, sensed.frame)?),
        };
        let report = run.add(scene, sensed, step)?;
        #[cfg(feature = "ros")]
        if let Some(bag) = &mut bag {
            bag.step(scene, sensed, step)?;
            bag.conclude(|origin| {
                let cells = corridor_markers(run.supervisor.cells(), &report, origin, &corridor);
                vec![cells, intrusion_markers(&report, origin)]
            })?;
        }
        let pose = sensed.frame.at_one_moment()?.robot(&step.pose).world_from_robot;
        run.shown.get_or_insert((report, pose));
        Ok(())
    })?;
    #[cfg(feature = "ros")]
    bag.iter_mut().try_for_each(ComparedBag::finish)?;
    let Some(run) = run else { return Ok(CommandOutcome::Done) };
    let Run { supervisor, out, frames, intruded, not_compared, first, shown, .. } = run;
    out.finish()?;
    if let (Some(path), Some((report, pose))) = (&args.png, &shown) {
        draw(path, &supervisor, report, pose)?;
    }
    let mut lines = vec![format!("{intruded} of {frames} frames show something in the corridor")];
    lines.extend(first);
    if not_compared > 0 {
        lines.push(format!("{not_compared} frames were judged by the measurement alone: the pose was not tracked"));
    }
    if args.upright {
        lines.push("assumed: what stands in the corridor reaches the heights that were seen (--upright)".to_owned());
    }
    print::lines(lines)?;
    Ok(CommandOutcome::Done)
}

impl Run {
    fn new(args: &Args, corridor: &Corridor, options: SuperviseOptions, frame: &Frame) -> Result<Self> {
        let options = options.with_model_sigma(args.drive.options(frame.sensor()).model_sigma);
        let supervisor = Supervisor::new(corridor.clone(), options)?;
        let threads = Threads::from(args.drive.threads).started()?;
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(threads))?;
        let mut out = GrowingFile::create(&args.out)?;
        out.add(&header(&supervisor, &options).to_string())?;
        let (frames, intruded, not_compared) = (0, 0, 0);
        Ok(Self { supervisor, predictor, out, frames, intruded, not_compared, first: None, shown: None })
    }

    /// Looks at a frame. The report is drawn if no earlier report had more to show.
    fn add(&mut self, scene: &Scene, sensed: &Sensed<'_>, step: &Step) -> Result<Report> {
        let robot = (step.phase == Phase::Tracking).then_some(&step.pose);
        let frames: Vec<&Frame> = std::iter::once(sensed.frame).chain(sensed.beside).collect();
        let report = self.supervisor.supervise(&mut self.predictor, &scene.world, &frames, robot)?;
        let then = sensed.frame.at_one_moment()?.robot(&step.pose);
        self.out.add(&line(scene, step, &then.world_from_robot, &report).to_string())?;
        self.frames += 1;
        self.not_compared += usize::from(!report.is_compared);
        if let Some(first) = report.intrusions.first() {
            self.intruded += 1;
            let time = report.time_to_reach.map_or(String::new(), |t| format!(", reached in {t:.2} s"));
            let what = first.object.map_or(String::new(), |o| format!(": {:?}", name(scene, o)));
            let line = format!("first at {} s, {:.2} m along{time}{what}", report.stamp, first.along);
            self.first.get_or_insert(line);
        }
        let is_telling = |r: &Report| r.is_compared && !r.intrusions.is_empty();
        if !self.shown.as_ref().is_some_and(|(report, _)| is_telling(report)) {
            self.shown = None;
        }
        Ok(report)
    }
}

fn name(scene: &Scene, object: u32) -> &str {
    &scene.world.environment().objects()[object as usize].name
}

/// The first line: the cells, and the meaning of their letters.
fn header(supervisor: &Supervisor, options: &SuperviseOptions) -> Value {
    let mut letters = json!({ "f": "free", "k": "known", "i": "intruded" });
    for reason in UnseenReason::ALL {
        letters[reason.letter().to_string()] = format!("unseen: {}", reason.name()).into();
    }
    let frame = match supervisor.corridor().frame() {
        CorridorFrame::Robot => "robot",
        CorridorFrame::World => "world",
    };
    json!({
        "format": 1, "frame": frame, "length": supervisor.corridor().length(), "grid": supervisor.cells(),
        "letters": letters, "smallest": options.smallest, "speed": options.speed,
        "false_alarms_per_frame": options.false_alarms,
        "assumed": if options.is_upright { vec!["upright"] } else { vec![] },
    })
}

/// The line of a frame, with the pose of the robot at the moment of the report.
fn line(scene: &Scene, step: &Step, world_from_robot: &Pose, report: &Report) -> Value {
    let counts = report.counts();
    let by_reason = |value: &dyn Fn(usize) -> Value| -> Value {
        let named = UnseenReason::ALL.iter().enumerate().map(|(i, reason)| (reason.name().to_owned(), value(i)));
        Value::Object(named.collect())
    };
    let mut known: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (cell, state) in report.cells.iter().enumerate() {
        if let CellState::Known(object) = state {
            known.entry(name(scene, *object)).or_default().push(cell);
        }
    }
    let pose = report.is_compared.then_some(world_from_robot);
    json!({
        "time": report.stamp, "state": step.phase.name(),
        "against": if report.is_compared { "model" } else { "measurement" },
        "assumed": if report.is_upright_assumed { vec!["upright"] } else { vec![] },
        "given_up": report.is_given_up,
        "cells": report.letters(),
        "counts": {
            "free": counts.free, "known": counts.known, "intruded": counts.intruded,
            "unseen": by_reason(&|i| counts.unseen[i].into()),
        },
        "hidden_volume": by_reason(&|i| report.hidden[i].into()),
        "known": known,
        "intrusions": report.intrusions.iter().map(|i| intrusion(scene, i, pose)).collect::<Vec<_>>(),
        "time_to_reach": report.time_to_reach,
    })
}

fn intrusion(scene: &Scene, i: &Intrusion, world_from_robot: Option<&Pose>) -> Value {
    let c = i.covariance;
    let extent = |b: &presight::environment::Aabb| json!([b.min.to_array(), b.max.to_array()]);
    json!({
        "nearest_robot": i.nearest.to_array(),
        "nearest_world": world_from_robot.map(|pose| pose.transform_point(i.nearest).to_array()),
        "covariance_robot": [c.x_axis.to_array(), c.y_axis.to_array(), c.z_axis.to_array()],
        "range": i.range, "along": i.along,
        "extent_robot": extent(&i.extent),
        "extent_world": world_from_robot.map(|pose| extent(&i.extent.transformed(&pose.to_affine()))),
        "pixels": i.pixels, "false_alarms": i.false_alarms,
        "object": i.object.map(|o| name(scene, o)),
    })
}

/// The cells of the corridor that are not free, and the boxes of intrusions: intruded cells red, known ones green,
/// unseen ones grey.
#[cfg(feature = "ros")]
fn corridor_markers(
    cells: &presight::supervise::Cells,
    report: &Report,
    origin: &MessageOrigin,
    corridor: &Corridor,
) -> Record {
    const GREY: [f32; 4] = [0.5, 0.5, 0.5, 0.15];
    const GREEN: [f32; 4] = [0.1, 0.8, 0.2, 0.4];
    const RED: [f32; 4] = [0.9, 0.1, 0.1, 0.8];
    type IsOfKind = fn(&CellState) -> bool;
    let kinds: [(&str, [f32; 4], IsOfKind); 3] = [
        ("unseen", GREY, |state| matches!(state, CellState::Unseen(_))),
        ("known", GREEN, |state| matches!(state, CellState::Known(_))),
        ("intruded", RED, |state| matches!(state, CellState::Intruded)),
    ];
    let centre = |(cell, _): (usize, &CellState)| {
        let [column, row] = cells.columns[cell / cells.layers].map(f64::from);
        let layer = (cell % cells.layers) as f64;
        let [x, y, z] = cells.origin;
        [x + (column + 0.5) * cells.side, y + (row + 0.5) * cells.side, z + (layer + 0.5) * cells.layer_height]
    };
    let mut markers = Vec::new();
    for (name, color, is_of) in kinds {
        let mut marker = SceneMarker::new(MarkerKind::CubeList, name, color);
        marker.scale = [cells.side, cells.side, cells.layer_height];
        marker.points = report.cells.iter().enumerate().filter(|(_, state)| is_of(state)).map(centre).collect();
        markers.extend((!marker.points.is_empty()).then_some(marker));
    }
    let frame = match corridor.frame() {
        CorridorFrame::Robot => &origin.base,
        CorridorFrame::World => &origin.map,
    };
    origin.markers("/presight/corridor", frame, markers)
}

/// The boxes around intrusions, in the frame of the robot.
#[cfg(feature = "ros")]
fn intrusion_markers(report: &Report, origin: &MessageOrigin) -> Record {
    let boxes = report.intrusions.iter().map(|intrusion| {
        let mut marker = SceneMarker::new(MarkerKind::Cube, "intrusion", [0.9, 0.1, 0.1, 0.5]);
        marker.pose.translation = intrusion.extent.center();
        // A box of one point has no extent, and viewers refuse a scale of 0.
        marker.scale = (intrusion.extent.max - intrusion.extent.min).max(DVec3::splat(0.01)).to_array();
        marker
    });
    origin.markers("/presight/intrusions", &origin.base, boxes)
}

/// Draws the cells from above: each place shows the states of its height side by side, and only the intrusion if there
/// is one.
fn draw(path: &Path, supervisor: &Supervisor, report: &Report, world_from_robot: &Pose) -> Result<()> {
    let cells = supervisor.cells();
    let most = |i: usize| cells.columns.iter().map(|at| at[i] + 1).max().unwrap_or(1);
    let (columns, rows) = (most(0), most(1));
    let mut shares = vec![None; columns as usize * rows as usize];
    for (at, column) in cells.columns.iter().zip(report.cells.chunks(cells.layers)) {
        let part = |is: fn(&CellState) -> bool| column.iter().filter(|s| is(s)).count() as f64 / column.len() as f64;
        let is_intruded = part(|s| *s == CellState::Intruded) > 0.0;
        shares[at[1] as usize * columns as usize + at[0] as usize] = Some(if is_intruded {
            [0.0, 0.0, 1.0, 0.0]
        } else {
            let (free, known) = (part(|s| *s == CellState::Free), part(|s| matches!(s, CellState::Known(_))));
            [free, known, 0.0, 1.0 - free - known]
        });
    }
    let nearest = report.intrusions.first().map_or(String::new(), |i| format!(", first at {:.2} m", i.along));
    let title = format!("{} s: {} intrusions{nearest}", report.stamp, report.intrusions.len());
    let robot = match supervisor.corridor().frame() {
        CorridorFrame::Robot => Some([0.0; 3]),
        CorridorFrame::World => report.is_compared.then(|| {
            let (t, (.., yaw)) = (world_from_robot.translation, world_from_robot.rpy());
            [t.x, t.y, yaw]
        }),
    };
    let [x, y, _] = cells.origin;
    let picture = CorridorPicture { title: &title, columns, side: cells.side, origin: [x, y], robot, cells: &shares };
    write_corridor(path, &picture)
}
