//! `presight update`: differences between site and model, as changes.

#[cfg(feature = "ros")]
mod bag;
mod known;
mod looks;
mod page;
mod store_of;

#[cfg(feature = "ros")]
use super::compared_bag::ComparedBag;
use super::drive::{Drive, Sensed};
use super::outputs::OutputFiles;
use super::{CommandOutcome, print};
use known::KnownArgs;
use looks::{Questions, look_from};
use page::{FrameKey, Page};
use presight::files::{self, Observation, StampedPose};
use presight::localize::Phase;
#[cfg(feature = "report")]
use presight::localize::Step;
use presight::measured::{Frame, ScanMotion};
use presight::store::ProposedChange;
use presight::tools::{create_folder, write_atomically};
use presight::update::{Action, FindingKind, LearnOptions, Learner, Policy, SiteFindings};
use presight::{Error, InWorld, PoseCovariance, PoseEstimate, Result, RobotPose, Scene, World};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use store_of::{Claim, apply, version_of};

/// This build writes no bags.
#[cfg(not(feature = "ros"))]
enum ComparedBag {}

#[cfg(not(feature = "ros"))]
impl ComparedBag {
    fn step(&mut self, _: &Scene, _: &Sensed<'_>, _: &presight::localize::Step) -> Result<()> {
        match *self {}
    }

    fn given(&mut self, _: &Scene, _: &Sensed<'_>, _: &PoseEstimate, _: f64) -> Result<()> {
        match *self {}
    }
}

const EXAMPLES: &str = "Examples:
  Look at the proposed changes, then apply them:
    presight update monday.jsonl tuesday.jsonl --map site.presight --init reference --out found
    presight env apply site.presight found/changes.jsonl

  With poses from elsewhere, known to 5 mm and 0.1 degrees:
    presight update monday.jsonl --map site.presight --poses room.tum \\
      --pose-cov 0.005,0.005,0.005,0.1,0.1,0.1 --out known

  New things whose shapes are known, as meshes:
    presight update monday.jsonl --map site.presight --init reference --library pallets \\
      --recognizer \"python3 name.py\" --out named

  A robot with two sensors:
    presight update front=front rear=rear --robot kurt.toml --map site.presight \\
      --init reference --out pair";

/// Learn what changed: objects that are gone, moved or new, from the logs of drives
///
/// LOGs are drives one after the other, each as for `localize`. DIR gets changes.jsonl for `env apply`, doubts.jsonl
/// with the poses that decide open questions, and index.html. The page shows for each change the measurement between
/// the predictions without and with it, and the growth of the evidence. Other files are written only with --apply or
/// --evidence.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    drive: Drive,

    /// Logs of further drives; with --robot, of the robot's other sensors
    #[arg(value_name = "LOG")]
    more: Vec<PathBuf>,

    /// The sensors of the robot: each LOG is then NAME=LOG, the log of the sensor NAME in the same drive
    #[arg(long, value_name = "ROBOT.toml", conflicts_with_all = ["sensor", "grey_sensor"])]
    robot: Option<PathBuf>,

    /// Poses of the robot at the stamps of the frames, instead of the localizer's own
    #[arg(long, value_name = "FILE.tum", requires = "pose_cov")]
    poses: Option<PathBuf>,

    /// Standard deviations of --poses: sx,sy,sz,sroll_deg,spitch_deg,syaw_deg, or a JSON file of 36 numbers
    #[arg(long, value_name = "COV", requires = "poses")]
    pose_cov: Option<String>,

    /// Write changes.jsonl, index.html and its pictures into this folder
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Write a ROS 2 bag: what `replay --mcap` writes, and each finding on /presight/findings
    ///
    /// Boxes are red around what is gone, blue around what moved, with an arrow, green around what is new, and yellow
    /// around what is doubtful.
    #[cfg(feature = "ros")]
    #[arg(long, value_name = "OUT.mcap")]
    mcap: Option<PathBuf>,

    /// Apply the changes to the store
    #[arg(long)]
    apply: bool,

    /// Begin no further change after this time, milliseconds; the rest waits in DIR/changes.jsonl
    #[arg(long, value_name = "MS", requires = "apply")]
    deadline_ms: Option<f64>,

    /// Read undecided evidence from this file, and write it back
    #[arg(long, value_name = "FILE")]
    evidence: Option<PathBuf>,

    /// UTC of stamp 0, seconds; stamps over 1e9 are UTC [default: 0]
    #[arg(long, value_name = "UTC")]
    time: Option<f64>,

    /// Action for each kind of finding, such as gone=change,new=stop: mark, change, stop, come-back or ignore [default:
    /// mark]
    ///
    /// The kinds are gone, moved, new and part. `mark` marks known and new objects as uncertain. `change` changes
    /// the model. `stop` proposes no change, reports the pose that decides the question, and ends with status 1.
    /// `come-back` adds the place to DIR/come_back.jsonl.
    #[arg(long, value_name = "KIND=ACTION,..", default_value = "")]
    policy: String,

    #[command(flatten)]
    known: KnownArgs,

    /// Minimum number of agreeing views
    #[arg(long, value_name = "N", default_value_t = 3)]
    views: u32,

    /// Log-odds that decide
    #[arg(long, value_name = "L", default_value_t = 9.0)]
    sure: f64,

    /// Maximum contribution of one view, log-odds
    #[arg(long = "most-per-view", value_name = "L", default_value_t = 3.0)]
    max_per_view: f64,
}

/// Runs the command.
///
/// # Errors
/// Those of the localizer, of reading and writing files, and of the store.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    if let Some(time) = args.time.filter(|time| !time.is_finite()) {
        return Err(Error::usage(format!("--time {time}"), "give finite UTC seconds"));
    }
    let within = deadline(args)?;
    let policy = Policy::parse(&args.policy).map_err(|e| e.at("--policy"))?;
    let mut learner = Learner::new(options(args)?)?;
    let drives = drives(args)?;
    check_files(args, &drives)?;
    let known = known_poses(args)?;
    let mut recognizers = args.known.open()?;
    let claimed = args.apply.then_some(&args.drive.map).into_iter().chain(&args.evidence);
    let _claims = claimed.map(|path| Claim::of(path)).collect::<Result<Vec<_>>>()?;
    let scene = args.drive.scene()?;
    let version = version_of(&args.drive.map, &scene)?;
    if args.apply && !version.is_store {
        let remedy = "make one with presight env create, and give it as --map";
        return Err(Error::usage(format!("--apply: {} is not a store", args.drive.map.display()), remedy));
    }
    if let Some(path) = args.evidence.as_deref().filter(|path| path.exists()) {
        let left_out = learner.load(path, scene.world.environment(), &version.origin)?;
        let notice = format!("evidence on {left_out} objects is left out, because they moved or are gone since");
        print::notices(&(left_out > 0).then_some(notice));
    }
    #[cfg(feature = "ros")]
    let mut compared = bag::open(args)?;
    #[cfg(not(feature = "ros"))]
    let mut compared = None;
    let seen = learn(&drives, &scene, &mut learner, known.as_ref(), compared.as_mut())?;
    let stamp = seen.last;
    create_folder(&args.out)?;
    let mut findings = learner.findings(&scene.world);
    recognizers.improve(&mut learner, &scene.world, &mut findings);
    let utc = args.time.unwrap_or(0.0);
    let utc = if stamp > 1e9 { 0.0 } else { utc };
    #[cfg(feature = "ros")]
    compared.as_mut().map_or(Ok(()), |compared| bag::conclude(compared, &scene, &findings))?;
    let changes = learner.changes(&findings, &scene.world, (&version.base, utc), &policy)?;
    let changes_file = args.out.join("changes.jsonl");
    write_changes(&changes_file, &changes)?;
    let after = after(&scene.world, &findings);
    let shares = (learner.share_explained(&scene.world, 0.1), learner.share_explained(&after, 0.1));
    let summary = summary(&learner, &findings, shares);
    let questions = Questions::of(&mut learner, &scene.world, &findings, &policy);
    write_atomically(&args.out.join("doubts.jsonl"), |file| file.write_all(questions.lines(&findings).as_bytes()))?;
    let motions = &seen.motions;
    let page = Page { args, drives: &drives, motions, scene: &scene, findings: &findings, summary: &summary };
    page.write(&args.out)?;
    let count = changes.len();
    let (applied, waiting) =
        if args.apply { apply(&args.drive.map, changes, stamp + utc, within)? } else { (Vec::new(), 0) };
    if let Some(path) = &args.evidence {
        let changed: Vec<String> = applied.iter().filter_map(ProposedChange::object).map(str::to_owned).collect();
        if !applied.is_empty() {
            learner.forget(&after, &changed);
        }
        learner.save(path, scene.world.environment(), &version.origin)?;
    }
    questions.come_back(&args.out.join("come_back.jsonl"))?;
    print::data(&summary)?;
    let waits = format!(
        "{waiting} of {count} changes wait: presight env apply {} {} applies them",
        args.drive.map.display(),
        changes_file.display()
    );
    print::notices(&(waiting > 0).then_some(waits));
    let stops: Vec<String> = questions.describe(Action::Stop).map(|finding| format!("stop: {finding}")).collect();
    print::notices(&stops);
    print::notices(&findings.wrong.iter().map(|why| format!("the model is not changed: {why}")).collect::<Vec<_>>());
    Ok(if findings.wrong.is_some() || !stops.is_empty() { CommandOutcome::Found } else { CommandOutcome::Done })
}

/// The time that applying may take.
fn deadline(args: &Args) -> Result<Duration> {
    let Some(ms) = args.deadline_ms else { return Ok(Duration::MAX) };
    let within = (ms >= 0.0).then(|| Duration::try_from_secs_f64(ms / 1e3).ok()).flatten();
    within.ok_or_else(|| Error::usage(format!("--deadline-ms {ms}"), "give milliseconds of at least 0"))
}

/// The drives, one after the other; with --robot one drive with all logs.
fn drives(args: &Args) -> Result<Vec<Drive>> {
    if args.robot.is_some() {
        let more: Vec<String> = args.more.iter().map(|log| log.to_string_lossy().into_owned()).collect();
        return Ok(vec![args.drive.of_robot(args.robot.as_deref(), &more)?]);
    }
    let logs = std::iter::once(args.drive.log.as_path()).chain(args.more.iter().map(PathBuf::as_path));
    logs.map(|log| args.drive.with_log(log).of_robot(None, &[])).collect()
}

/// What a run saw of its frames.
#[derive(Default)]
struct Seen {
    /// The last stamp, seconds.
    last: f64,
    /// Number of the drive.
    drive: usize,
    /// The motion during each scan that takes time, with which the page shows it.
    motions: BTreeMap<FrameKey, ScanMotion>,
}

impl Seen {
    fn add(&mut self, frame: &Frame) {
        if let Some(motion) = frame.scan_motion().filter(|_| !frame.has_one_pose()) {
            self.motions.insert(FrameKey::of(self.drive, frame), motion.clone());
        }
    }
}

/// Learns from all drives.
fn learn(
    drives: &[Drive],
    scene: &Scene,
    learner: &mut Learner,
    known: Option<&Known>,
    mut compared: Option<&mut ComparedBag>,
) -> Result<Seen> {
    let mut seen = Seen::default();
    for drive in drives {
        match known {
            Some((poses, covariance)) => {
                for drive in drive.each_log() {
                    follow_known(&drive, scene, learner, (poses, covariance), &mut seen, compared.as_deref_mut())?;
                    learner.end_log();
                }
            }
            None => follow(drive, learner, &mut seen, compared.as_deref_mut())?,
        }
        learner.end_drive();
        seen.drive += 1;
    }
    Ok(seen)
}

/// Writes changes as lines of `presight env apply`.
fn write_changes(path: &Path, changes: &[ProposedChange]) -> Result<()> {
    let lines = changes.iter().map(|change| Ok(change.line()? + "\n")).collect::<Result<String>>()?;
    write_atomically(path, |file| file.write_all(lines.as_bytes()))
}

fn options(args: &Args) -> Result<LearnOptions> {
    for (flag, value) in [("--sure", args.sure), ("--most-per-view", args.max_per_view)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(Error::usage(format!("{flag} {value}"), "give finite log-odds above 0"));
        }
    }
    Ok(LearnOptions::default()
        .with_min_views(args.views.max(1))
        .with_decisive(args.sure)
        .with_max_per_view(args.max_per_view)
        .with_model_sigma(args.drive.model_sigma.unwrap_or(0.0)))
}

/// Checks that no output is an input, before anything is read.
fn check_files(args: &Args, drives: &[Drive]) -> Result<()> {
    let mut files = OutputFiles::default();
    files.add_folder(&args.out, &["index.html", "changes.jsonl", "doubts.jsonl"])?;
    #[cfg(feature = "ros")]
    files.add("--mcap", args.mcap.as_deref(), &["mcap"])?;
    args.evidence.iter().try_for_each(|path| files.add_any(path))?;
    let logs: Vec<PathBuf> = drives.iter().flat_map(Drive::each_log).map(|drive| drive.log).collect();
    let others = [args.poses.as_deref(), args.robot.as_deref()].into_iter().flatten();
    files.check_named(logs.iter().map(PathBuf::as_path).chain([args.drive.map.as_path()]).chain(others))
}

type Known = (Vec<StampedPose>, PoseCovariance<InWorld>);

/// The poses of `--poses` and their covariance.
fn known_poses(args: &Args) -> Result<Option<Known>> {
    let (Some(poses), Some(covariance)) = (&args.poses, &args.pose_cov) else { return Ok(None) };
    let covariance = files::parse_pose_covariance(covariance).map_err(|e| e.at("--pose-cov"))?;
    Ok(Some((files::read_tum(poses)?, covariance)))
}

/// Learns from a drive that the localizer follows.
fn follow(drive: &Drive, learner: &mut Learner, seen: &mut Seen, mut compared: Option<&mut ComparedBag>) -> Result<()> {
    let mut is_tracked = false;
    drive.follow(OutputFiles::default(), None, |scene, sensed, step| {
        seen.last = step.stamp;
        compared.iter_mut().try_for_each(|bag| bag.step(scene, sensed, step))?;
        is_tracked |= step.phase == Phase::Tracking;
        let frames: Vec<&Frame> = std::iter::once(sensed.frame).chain(sensed.grey).chain(sensed.beside).collect();
        frames.iter().for_each(|frame| seen.add(frame));
        learner.observe(&scene.world, step, &frames)
    })?;
    let log = drive.log.display();
    print::notices(
        &(!is_tracked).then(|| format!("{log}: the pose of the robot was never certain, so the log was ignored")),
    );
    Ok(())
}

/// Maximum difference between the stamps of a frame and of its pose, seconds: writers round to milliseconds.
const SAME_TIME_S: f64 = 1e-3;

/// Learns from a drive with known poses. Frames without a pose at their stamp are left out; without any pose that is an
/// error.
fn follow_known(
    drive: &Drive,
    scene: &Scene,
    learner: &mut Learner,
    (poses, covariance): (&[StampedPose], &PoseCovariance<InWorld>),
    seen: &mut Seen,
    mut compared: Option<&mut ComparedBag>,
) -> Result<()> {
    print::far_outside(scene, poses.iter().map(|p| p.pose.translation));
    let (mut without, mut with) = (0, 0);
    let mut nearest = (f64::INFINITY, 0.0, 0.0);
    drive.read(scene, Some(poses), |scene, Observation { frame, recorded, .. }| {
        seen.last = frame.stamp;
        seen.add(frame);
        let at = poses.iter().min_by(|a, b| (a.time - frame.stamp).abs().total_cmp(&(b.time - frame.stamp).abs()));
        if let Some(at) = at.filter(|at| (at.time - frame.stamp).abs() < nearest.0) {
            nearest = ((at.time - frame.stamp).abs(), frame.stamp, at.time);
        }
        match at.filter(|stamped| (stamped.time - frame.stamp).abs() < SAME_TIME_S) {
            Some(at) => {
                with += 1;
                let robot = PoseEstimate::new(RobotPose::new(at.pose), *covariance);
                let sensed = Sensed { frame, grey: None, beside: &[], recorded: recorded.as_deref() };
                let sigma = drive.options(frame.sensor()).model_sigma;
                compared.iter_mut().try_for_each(|bag| bag.given(scene, &sensed, &robot, sigma))?;
                learner.observe_at(&scene.world, &[frame], &robot)
            }
            None => {
                without += 1;
                Ok(())
            }
        }
    })?;
    if with == 0 && without > 0 {
        let (apart, frame, pose) = nearest;
        let what = match apart.is_finite() {
            true => {
                format!("no frame has a pose of --poses: the nearest are {apart:.3} s apart ({frame} and {pose} s)")
            }
            false => "no frame has a pose of --poses, which is empty".to_owned(),
        };
        return Err(Error::invalid(what, "give poses with the stamps of the frames, in seconds").in_file(&drive.log));
    }
    let log = drive.log.display();
    print::notices(&(without > 0).then(|| format!("{log}: {without} frames have no pose and are left out")));
    Ok(())
}

/// The world with all findings.
fn after(world: &World, findings: &SiteFindings) -> World {
    let mut after = world.clone();
    if findings.wrong.is_none() {
        // A finding that cannot be applied, such as a box at an odd place, is shown without its effect.
        findings.changes.iter().for_each(|finding| drop(after.apply_unchecked(finding.change(&after))));
    }
    after
}

fn summary(learner: &Learner, findings: &SiteFindings, (before, after): (f64, f64)) -> String {
    let count = |of: fn(&FindingKind) -> bool| findings.changes.iter().filter(|f| of(&f.kind)).count();
    let tally = learner.tally();
    let mut text = format!("{} frames, {} views, {} thrown away\n", tally.frames, tally.views, tally.discarded);
    text += &format!(
        "{} gone, {} moved, {} new, {} parts gone, {} seen through, {} come and go, {} doubtful, \
         {} confirmed, {} never seen\n",
        count(|w| matches!(w, FindingKind::Gone)),
        count(|w| matches!(w, FindingKind::Moved { .. })),
        count(|w| matches!(w, FindingKind::New(_) | FindingKind::Recognized(_))),
        count(|w| matches!(w, FindingKind::Part(_))),
        count(|w| matches!(w, FindingKind::SeenThrough(_))),
        count(|w| matches!(w, FindingKind::ComesAndGoes)),
        findings.doubts.len(),
        findings.confirmed.len(),
        findings.unseen
    );
    text += &format!("beams within 0.1 m of the model: {:.1} % before, {:.1} % after\n", 100.0 * before, 100.0 * after);
    findings.changes.iter().for_each(|finding| text += &format!("{}\n", finding));
    for doubt in &findings.doubts {
        text += &format!("doubtful: {}: {}{}\n", doubt.object, doubt.why, look_from(doubt.view.as_ref()));
    }
    text
}

/// The evidence after each frame of a drive, for replays.
#[cfg(feature = "report")]
pub struct Learning {
    learner: Learner,
    /// A note for each frame.
    pub notes: Vec<String>,
}

#[cfg(feature = "report")]
impl Learning {
    /// Makes a learner without evidence.
    ///
    /// # Errors
    /// None, because the default options are valid.
    pub fn new() -> Result<Self> {
        Ok(Self { learner: Learner::new(LearnOptions::default())?, notes: Vec::new() })
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// Those of [`Learner::observe`].
    pub fn observe(&mut self, world: &World, step: &Step, frame: &Frame) -> Result<()> {
        const LISTED: usize = 5;
        self.learner.observe(world, step, &[frame])?;
        let mut evidence = self.learner.evidence(world);
        let standing = evidence.iter().filter(|(_, e)| e.l >= self.learner.options().decisive).count();
        evidence.retain(|(_, e)| e.l < 0.0);
        evidence.sort_by(|a, b| a.1.l.total_cmp(&b.1.l));
        let listed: Vec<String> =
            evidence.iter().take(LISTED).map(|(name, e)| format!("{name} {:.0} in {} views", e.l, e.views)).collect();
        let against = if listed.is_empty() { "nothing".to_owned() } else { listed.join(", ") };
        self.notes.push(format!("; learnt: {standing} objects stand, evidence against {against}"));
        Ok(())
    }
}
