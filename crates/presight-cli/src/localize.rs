//! `presight localize`: where the robot was at each frame of a log.

use super::outputs::OutputFiles;
use super::pose::parse_pose;
use super::{CommandOutcome, open_scene, print};
use presight::estimate::{EstimateOptions, Estimator, Prior};
use presight::frame::Frame;
use presight::index::Scheme;
use presight::io::atomic::write_atomically;
use presight::io::depth_folder::DepthFolder;
use presight::io::gltf::ImportOptions;
use presight::io::load_sensor;
use presight::io::tum::StampedPose;
use presight::localize::{LocalizeOptions, Localizer, Phase, Step};
use presight::verdict::{Verdict as Judged, Verdicts};
use presight::{Backend, Error, Options, Pose, Predictor, Result, Scene, Threads};
use std::io::Write;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight localize livingroom --map livingroom/livingroom_map.glb --init reference --stride 4 --out flight.tum
  presight localize run --map hall.presight --sensor camera.toml --init 1,2,1.5,0,20,90 --out run.tum";

/// Follow a robot through a log: its pose at every frame, with covariance and state
///
/// LOG is a folder of depth images: camera.json, depth/*.png (16 bits), and optionally poses.txt. Beside FILE.tum, FILE.jsonl
/// gets covariance, state and verdicts of every frame. A frame at which the pose is not known has no line in FILE.tum.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    drive: Drive,

    /// Write the poses here: lines of timestamp tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE.tum")]
    out: PathBuf,
}

/// A log, its map, and how the robot is followed through them.
#[derive(Debug, clap::Args)]
pub struct Drive {
    /// The log
    pub log: PathBuf,

    /// The model: a .glb or .gltf file, a .rhai script, or a store
    #[arg(long, value_name = "SCENE")]
    pub map: PathBuf,

    /// Where the robot starts: x,y,z,roll_deg,pitch_deg,yaw_deg or x,y,z,qx,qy,qz,qw, or `reference` for the log's own first pose
    #[arg(long, value_name = "POSE", allow_hyphen_values = true)]
    init: String,

    /// How far off that may be, one standard deviation along each axis, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.05)]
    init_sigma: f64,

    /// Likewise about each axis, degrees
    #[arg(long, value_name = "DEG", default_value_t = 2.0)]
    init_sigma_deg: f64,

    /// The sensor, with its noise and mount [default: as the log says]
    #[arg(long, value_name = "PRESET|FILE")]
    sensor: Option<String>,

    /// Start at the first frame at or after this time, seconds
    #[arg(long, value_name = "TIME")]
    from: Option<f64>,

    /// Use every N-th column and row
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    stride: u32,

    /// CPU threads, 0 = all cores
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
}

/// A drive that was followed to its end.
pub struct Followed {
    /// What became of each frame; images of verdicts are left out.
    pub steps: Vec<Step>,
    /// Pixels of each verdict, by frame.
    pub counts: Vec<[usize; 7]>,
    /// world_from_sensor by the log itself.
    pub reference: Vec<StampedPose>,
    /// robot_from_sensor.
    pub mount: Pose,
}

impl Drive {
    /// Follows the robot. `visit` sees each frame with what became of it; before the first, `files` are held against what was read.
    ///
    /// # Errors
    /// Those of the log, the map and the sensor, of estimates, and of `visit`.
    pub fn follow(
        &self,
        files: OutputFiles,
        mut visit: impl FnMut(&Scene, &Frame, &Step) -> Result<()>,
    ) -> Result<Followed> {
        files.check_named([self.log.as_path(), self.map.as_path()])?;
        let sensor = self.sensor.as_deref().map(load_sensor).transpose()?;
        print::notices(sensor.iter().flat_map(|(_, notices)| notices));
        let log = DepthFolder::open(&self.log, sensor.as_ref().map(|(sensor, _)| sensor))?;
        let start = self.start(&log)?;
        let threads = Threads::from(self.threads).started()?;
        let import = ImportOptions { threads: threads.clone(), ..ImportOptions::default() };
        let scene = open_scene(&self.map, &import, Scheme::default())?;
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(threads))?;
        let estimator = Estimator::new(predictor, EstimateOptions::default());
        let prior = Prior::of_sigmas(start, self.init_sigma, self.init_sigma_deg.to_radians());
        let mut localizer = Localizer::new(estimator, prior, LocalizeOptions::default());
        let (reference, mount) = (log.reference().to_vec(), log.sensor().spec().mount);
        files.check_read()?;
        let mut followed = Followed { steps: Vec::new(), counts: Vec::new(), reference, mount };
        for frame in log {
            let frame = frame?;
            if self.from.is_none_or(|from| frame.stamp >= from) {
                let frame: Frame = if self.stride > 1 { frame.thinned(self.stride)? } else { frame };
                let mut step = localizer.step(&scene.world, &frame)?;
                visit(&scene, &frame, &step)?;
                followed.counts.push(step.estimate.verdicts.first().map(Verdicts::counts).unwrap_or_default());
                step.estimate.verdicts.clear();
                followed.steps.push(step);
            }
        }
        Ok(followed)
    }

    fn start(&self, log: &DepthFolder) -> Result<Pose> {
        if self.init == "reference" {
            let from = self.from.unwrap_or(f64::NEG_INFINITY);
            let first = log.reference().iter().find(|s| s.time >= from);
            return first.map(|s| s.pose * log.sensor().spec().mount.inverse()).ok_or_else(|| {
                Error::usage("--init reference: the log has no poses", "give x,y,z,roll_deg,pitch_deg,yaw_deg")
            });
        }
        parse_pose(&self.init).map_err(|e| e.at(format!("--init {}", self.init)))
    }
}

/// Runs the command.
///
/// # Errors
/// Those of [`Drive::follow`], and of writing.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let mut files = OutputFiles::new();
    let details = args.out.with_extension("jsonl");
    files.add("--out", Some(&args.out), &["tum"])?;
    files.add_any(&details)?;
    let followed = args.drive.follow(files, |_, _, _| Ok(()))?;
    write(&args.out, &followed.steps)?;
    write_details(&details, &followed)?;
    print::data(&summary(&followed))?;
    Ok(CommandOutcome::Done)
}

/// True if the frame's pose is one to go by.
pub fn is_known(step: &Step) -> bool {
    matches!(step.phase, Phase::Tracking | Phase::Candidates)
}

/// A line for each frame at which the pose is known; `{}` of an f64 has all of its digits.
fn write(path: &Path, steps: &[Step]) -> Result<()> {
    write_atomically(path, |file| {
        for s in steps.iter().filter(|s| is_known(s)) {
            let (t, q) = (s.pose.translation, s.pose.rotation);
            writeln!(file, "{} {} {} {} {} {} {} {}", s.stamp, t.x, t.y, t.z, q.x, q.y, q.z, q.w)?;
        }
        Ok(())
    })
}

fn write_details(path: &Path, followed: &Followed) -> Result<()> {
    write_atomically(path, |file| {
        for (s, counts) in followed.steps.iter().zip(&followed.counts) {
            let weak: Vec<&str> = s.estimate.weak.iter().map(|w| w.name.as_str()).collect();
            let verdicts: serde_json::Map<String, serde_json::Value> =
                Judged::ALL.iter().zip(counts).map(|(v, n)| (v.name().to_owned(), (*n).into())).collect();
            let line = serde_json::json!({
                "time": s.stamp, "state": s.phase.name(), "reason": s.reason,
                "translation": s.pose.translation.to_array(), "rotation_xyzw": s.pose.rotation.to_array(),
                "covariance": s.covariance, "explained": s.estimate.explained, "weak": weak, "verdicts": verdicts,
                "predictions": s.estimate.predictions,
            });
            writeln!(file, "{line}")?;
        }
        Ok(())
    })
}

/// How many frames are known, and how far they are from the log's own poses.
pub fn summary(followed: &Followed) -> String {
    let Followed { steps, reference, mount, .. } = followed;
    let known: Vec<&Step> = steps.iter().filter(|s| is_known(s)).collect();
    let mut text = format!("{} of {} frames have a pose\n", known.len(), steps.len());
    for pair in steps.windows(2).filter(|pair| pair[0].phase != pair[1].phase) {
        text += &format!("{}: {}: {}\n", pair[1].stamp, pair[1].phase.name(), pair[1].reason);
    }
    let at = |time: f64| reference.iter().find(|r| (r.time - time).abs() < 1e-6);
    let mut off: Vec<(f64, f64)> = Vec::new();
    for step in &known {
        let Some(there) = at(step.stamp) else { continue };
        let here = step.pose * *mount;
        let degrees = here.rotation.angle_between(there.pose.rotation).to_degrees();
        off.push(((here.translation - there.pose.translation).length(), degrees));
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
