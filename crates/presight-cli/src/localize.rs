//! `presight localize`: the robot's pose at each frame of a log.

use super::drive::{Drive, FeatureCounts, Followed, verdict_counts};
#[cfg(feature = "ros")]
use super::output_bag::OutputBag;
use super::outputs::OutputFiles;
use super::resume::{Mark, Resumed};
use super::{CommandOutcome, print};
use presight::Result;
use presight::localize::{Candidate, Phase, Step};
use presight::tools::{GrowingFile, is_through};
use presight::verdict::Verdict as Judged;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight localize livingroom --map scenes/room.glb --sensor camera.toml \\
    --init reference --out followed.tum
  presight localize run --map hall.glb --sensor camera.toml --init 12,18,1,0,0,0 --out run.tum
  presight localize scans.json --map corridor.glb --init unknown --out run.tum
  presight localize livingroom --map scenes/room.glb --sensor camera.toml --from 2 \\
    --init unknown --floor 0.8 --margin 1 --out searched.tum
  presight localize drive.mcap --map hall.glb --init reference --out answers.tum --mcap answers.mcap
  presight localize hall.ply --map hall.glb \\
    --init 12,18,1,0,0,0 --init-sigma 0.3 --init-sigma-deg 8 --out scan.tum";

/// Track a robot through a log: its pose at every frame, with covariance and state
///
/// LOG is a folder of 16-bit depth images (camera.json, depth/*.png, optionally poses.txt), of grey images
/// (grey/*.png), or of both; a file of ranges (a log of format 1, or a document of planar scans); a scan; or a folder
/// of scans (.ply, .pcd, .csv, .exr). Features of --layer are detected in grey images, its reflectors in scans with
/// intensities. With a level scanner of one row only x, y and yaw are estimated. FILE.jsonl next to FILE.tum gets
/// covariance, state and verdicts of every frame. FILE.tum has the poses of states `tracking` and `kept`. Both grow
/// by a line as each frame comes, and stay after an error or a signal; the same command then goes on behind them. A log
/// of ranges can come from a pipe (/dev/stdin); a device or pipe as --out gets the poses without FILE.jsonl.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    drive: Drive,

    /// Write the poses here: lines of timestamp tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE.tum")]
    out: PathBuf,

    /// Also write the poses as a ROS 2 bag: /tf (map to odom, or to the base), /presight/pose and /diagnostics
    #[cfg(feature = "ros")]
    #[arg(long, value_name = "OUT.mcap")]
    mcap: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// Those of [`Drive::follow`], and write errors. The lines of earlier frames stay.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let mut files = OutputFiles::default();
    files.add("--out", Some(&args.out), &["tum"])?;
    let details = (!is_through(&args.out)).then(|| args.out.with_extension("jsonl"));
    details.iter().try_for_each(|path| files.add_any(path))?;
    details.iter().try_for_each(|path| files.add_any(&path.with_extension("resume")))?;
    #[cfg(feature = "ros")]
    let mut bag = OutputBag::of("--mcap", args.mcap.as_deref(), &mut files)?;
    let mark = details.as_ref().map(|_| {
        let inputs: Vec<&Path> = [args.drive.log.as_path(), &args.drive.map].into_iter().collect();
        Mark::new(&args.out, &format!("{args:?}"), &inputs)
    });
    // A bag has an index at its end, so the whole bag is written again.
    #[cfg(feature = "ros")]
    let goes_on = bag.is_none();
    #[cfg(not(feature = "ros"))]
    let goes_on = true;
    let earlier = mark.as_ref().filter(|_| goes_on).zip(details.as_deref());
    let resumed = earlier.and_then(|(mark, details)| mark.resumed(&args.out, details));
    let mut lines: Option<Lines> = None;
    let followed = args.drive.learning().follow(files, resumed.as_ref(), |_, sensed, step| {
        // Only now: an error before the first step leaves the files of an earlier run.
        let lines = match &mut lines {
            Some(lines) => lines,
            None => {
                mark.as_ref().map_or(Ok(()), Mark::set)?;
                lines.insert(Lines::open(&args.out, details.as_deref(), resumed.as_ref())?)
            }
        };
        #[cfg(feature = "ros")]
        bag.iter_mut().try_for_each(|bag| bag.answers(sensed, step))?;
        #[cfg(not(feature = "ros"))]
        let _ = sensed;
        lines.add(step)
    })?;
    let is_marked = lines.is_some() || resumed.is_some();
    lines.map_or(Ok(()), Lines::finish)?;
    #[cfg(feature = "ros")]
    bag.iter_mut().try_for_each(OutputBag::finish)?;
    mark.iter().filter(|_| is_marked).try_for_each(Mark::clear)?;
    print::data(&summary(&followed))?;
    print::notices(&noise_is_assumed(&args.drive, &followed));
    let last = followed.steps.last().filter(|_| followed.steps.iter().all(|step| !step.is_known()));
    print::notices(&last.and_then(help).map(|help| format!("no frame has a pose: {help}")));
    Ok(CommandOutcome::Done)
}

/// Advice if most frames of a depth folder have no pose: the assumed noise may be too small.
fn noise_is_assumed(drive: &Drive, followed: &Followed) -> Option<String> {
    let known = followed.steps.iter().filter(|s| s.is_known()).count();
    let assumed = drive.log.join("depth").is_dir() && drive.sensor.is_none() && 2 * known < followed.steps.len();
    assumed.then(|| {
        "the log does not specify the noise of its depths; if it exceeds 5 mm, give a --sensor file with [noise] \
         range_sigma and range_sigma_quadratic (docs/formats.md)"
            .to_owned()
    })
}

/// The output files, which grow with each frame.
struct Lines {
    poses: GrowingFile,
    details: Option<GrowingFile>,
}

impl Lines {
    fn open(poses: &Path, details: Option<&Path>, resumed: Option<&Resumed>) -> Result<Self> {
        let file = |path: &Path, k: usize| match resumed {
            Some(run) => GrowingFile::reopen(path, run.lengths[k]),
            None => GrowingFile::create(path),
        };
        Ok(Self { poses: file(poses, 0)?, details: details.map(|path| file(path, 1)).transpose()? })
    }

    fn add(&mut self, step: &Step) -> Result<()> {
        if step.is_known() {
            let (t, q) = (step.pose.world_from_robot.translation, step.pose.world_from_robot.rotation);
            // `{}` prints an f64 with all of its digits.
            self.poses.add(&format!("{} {} {} {} {} {} {} {}", step.stamp, t.x, t.y, t.z, q.x, q.y, q.z, q.w))?;
        }
        self.details.iter_mut().try_for_each(|file| file.add(&details(step).to_string()))
    }

    fn finish(self) -> Result<()> {
        self.poses.finish()?;
        self.details.map_or(Ok(()), GrowingFile::finish)
    }
}

fn details(s: &Step) -> serde_json::Value {
    let features = FeatureCounts::of(&s.estimate.findings).map(|f| -> serde_json::Map<String, serde_json::Value> {
        f.named().map(|(name, count)| (name.to_owned(), count.into())).collect()
    });
    let weak: Vec<&str> = s.estimate.weak.iter().map(|w| w.name.as_str()).collect();
    let counts = verdict_counts(s);
    let verdicts: serde_json::Map<String, serde_json::Value> =
        Judged::ALL.iter().zip(counts).map(|(v, n)| (v.name().to_owned(), n.into())).collect();
    serde_json::json!({
        "time": s.stamp, "state": s.phase.name(), "reason": s.reason, "help": help(s),
        "translation": s.pose.world_from_robot.translation.to_array(),
        "rotation_xyzw": s.pose.world_from_robot.rotation.to_array(),
        "odds": s.odds, "fit_odds": s.fit_odds, "carried": s.carried, "covariance": s.pose.covariance, "explained": s.estimate.explained,
        "model_sigma": s.estimate.model_sigma, "weak": weak, "verdicts": verdicts, "features": features,
        "predictions": s.estimate.predictions,
        "candidates": s.candidates.iter().map(candidate).collect::<Vec<_>>(),
    })
}

/// What a user can do about a frame, by the flags of the command.
fn help(s: &Step) -> Option<&'static str> {
    match s.phase {
        Phase::Lost | Phase::Unknown => Some(
            "--init unknown searches the whole map for the robot, at the height of --floor; --model-sigma states the \
             deviation of the map, --sensor the noise and the mount of the sensor",
        ),
        Phase::Kept => Some("no frame proves the pose so far: drive on; --init-odds states how certain the start is"),
        _ if !s.estimate.weak.is_empty() => {
            Some("no measurement determines the weak directions: add odometry to the log")
        }
        _ => None,
    }
}

fn candidate(c: &Candidate) -> serde_json::Value {
    serde_json::json!({
        "translation": c.pose.world_from_robot.translation.to_array(),
        "rotation_xyzw": c.pose.world_from_robot.rotation.to_array(),
        "log_likelihood": c.log_likelihood, "explained": c.explained, "frames": c.frames,
    })
}

/// The number of frames with a pose, the changes of state, and the errors against the log's own poses.
pub fn summary(followed: &Followed) -> String {
    let Followed { steps, reference, .. } = followed;
    let known = steps.iter().filter(|s| s.is_known()).count();
    let mut text = format!("{known} of {} frames have a pose\n", steps.len());
    let kept = steps.iter().filter(|s| s.phase == Phase::Kept).count();
    if kept > 0 {
        text += &format!("{kept} of these poses are of state kept: no frame proves them\n");
    }
    let changed = steps.windows(2).filter(|pair| pair[0].phase != pair[1].phase).map(|pair| &pair[1]);
    for step in steps.first().into_iter().chain(changed) {
        text += &format!("{}: {}: {}\n", step.stamp, step.phase.name(), step.reason);
    }
    let mut off: Vec<(f64, f64)> = Vec::new();
    for (step, there) in steps.iter().zip(reference).filter(|(step, _)| step.is_known()) {
        let Some(there) = there else { continue };
        let degrees = step.pose.world_from_robot.rotation.angle_between(there.world_from_robot().rotation).to_degrees();
        off.push(((step.pose.world_from_robot.translation - there.world_from_robot().translation).length(), degrees));
    }
    if let Some(sigma) = steps.iter().rev().find(|s| s.phase == Phase::Tracking).map(|s| s.estimate.model_sigma) {
        text += &format!("surfaces of the map count as off by {sigma:.3} m\n");
    }
    if !off.is_empty() {
        let rms = |f: fn(&(f64, f64)) -> f64| (off.iter().map(|o| f(o).powi(2)).sum::<f64>() / off.len() as f64).sqrt();
        let most = |f: fn(&(f64, f64)) -> f64| off.iter().map(f).fold(0.0, f64::max);
        text += &format!(
            "against the log's own poses: RMS {:.4} m {:.3} deg, largest {:.4} m {:.3} deg\n",
            rms(|o| o.0),
            rms(|o| o.1),
            most(|o| o.0),
            most(|o| o.1)
        );
    }
    text
}
