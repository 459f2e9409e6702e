//! A drive: the log, map and start that `localize`, `replay`, `supervise` and `update` share, and the localizer that
//! follows it.

mod beside;
mod features;
mod robot;
mod start;

pub use features::FeatureCounts;

use super::bag_args::LogArgs;
use super::outputs::OutputFiles;
use super::resume::Resumed;
use super::sensor_args::SensorArgs;
use super::{open_scene_without, print};
use beside::LogBeside;
use features::{not_sought, not_sought_in_scans};
use indicatif::ProgressBar;
use presight::environment::IndexKind;
#[cfg(any(feature = "ros", feature = "store"))]
use presight::files::StampedPose;
use presight::files::{DepthFolder, ImportOptions, LogFrames, Observation, Recorded, load_sensor};
use presight::localize::{Estimator, Freedom, Phase, Step};
use presight::measured::Frame;
use presight::verdict::Verdicts;
use presight::{Backend, Error, Options, Pose, Predictor, Result, RobotPose, Scene, Sensor, Threads};
use robot::RobotLog;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Flags shared by `localize`, `replay`, `supervise` and `update`: the log, the map, and the options of the localizer.
#[derive(Clone, Debug, clap::Args)]
pub struct Drive {
    /// The log
    pub log: PathBuf,

    /// The sensors of a robot, the log's first, each with its log; empty to take what the other flags and the log say.
    #[arg(skip)]
    robot: Vec<RobotLog>,

    /// The model: a .glb or .gltf file, a .rhai script, or a store
    #[arg(long, value_name = "SCENE")]
    pub map: PathBuf,

    /// Start pose of the robot: x,y,z,roll_deg,pitch_deg,yaw_deg or x,y,z,qx,qy,qz,qw, `reference` for the log's first
    /// pose, or `unknown` to search the whole map at the height of --floor with the roll and pitch of --lean. Needed
    /// wherever the robot is localized
    #[arg(long, value_name = "POSE", allow_hyphen_values = true)]
    init: Option<String>,

    /// Standard deviation of the start position along each axis, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.05)]
    init_sigma: f64,

    /// Standard deviation of the start orientation about each axis, degrees
    #[arg(long, value_name = "DEG", default_value_t = 2.0)]
    init_sigma_deg: f64,

    /// Odds that the start is right: it is given up once the frames say more against it
    #[arg(long, value_name = "ODDS", default_value_t = 1e4)]
    init_odds: f64,

    /// The sensor, with its noise and mount [default: from the log]
    #[arg(long, value_name = "PRESET|FILE")]
    pub sensor: Option<String>,

    #[command(flatten)]
    image: SensorArgs,

    #[command(flatten)]
    logs: LogArgs,

    /// Options of the estimate: of a level scanner of one row on a level floor, of a sensor in any pose, or of scans of
    /// full panoramas of points [default: by the sensor]
    #[arg(long, value_name = "NAME", value_parser = ["indoor_scanner", "depth_camera", "lidar_3d"])]
    preset: Option<String>,

    /// Standard deviation of the model's surfaces, independent for each surface, metres [default: learnt by `localize`
    /// from the frames that it tracks; else 0.03 for a scanner of one row, 0.1 for scans of points, otherwise 0]
    #[arg(long, value_name = "METRES")]
    pub model_sigma: Option<f64>,

    /// Learn that deviation if no flag states it. Updates do not, so that changes do not depend on the order of the
    /// frames.
    #[arg(skip)]
    learns_sigma: bool,

    /// Standard deviation of odometry, as a fraction of the distance and of the turn
    #[arg(long, value_name = "PART", default_value_t = 0.1)]
    odometry_sigma: f64,

    /// The camera of grey images in a log of depth images [default: LOG/grey.toml, or the sensor of the depth images]
    #[arg(long, value_name = "PRESET|FILE")]
    grey_sensor: Option<String>,

    /// Search for the features of this layer: in grey images, and for reflectors in scans with intensities
    #[arg(long = "layer", value_name = "FILE.json")]
    pub layers: Vec<PathBuf>,

    /// Also search for the scene's own features
    #[arg(long)]
    pub own_features: bool,

    /// Leave out these objects of the map, with everything below them, such as the robot itself
    #[arg(long, value_name = "OBJECT", num_args = 1..)]
    exclude: Vec<String>,

    /// Height of the robot's frame in a search of the whole map, and of the poses of a document of planar scans, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.0, allow_hyphen_values = true)]
    floor: f64,

    /// Maximum height in a search of the whole map, metres, if the height is unknown [default: --floor]
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    floor_to: Option<f64>,

    /// Distance beyond the bounds of the map that is searched, metres: for a map of measured surfaces that does not
    /// include the places they were measured from
    #[arg(long, value_name = "METRES", default_value_t = 0.0)]
    margin: f64,

    /// In a search of the whole map, the fraction of directions in which a place must be surrounded by the map
    #[arg(long, value_name = "SHARE", default_value_t = 0.5)]
    surrounded: f64,

    /// Roll and pitch of the robot in a search of the whole map, degrees
    #[arg(
        long,
        value_name = "ROLL,PITCH",
        value_delimiter = ',',
        num_args = 1,
        default_value = "0,0",
        allow_hyphen_values = true
    )]
    lean: Vec<f64>,

    /// Starts that one frame draws around the last pose of a lost sensor that has no search of the whole map; the next
    /// frame draws others. Each costs about 5 ms
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u16).range(1..=1000))]
    search_starts: u16,

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

/// The measurements at one time, with the motion of the robot that the localizer found for them.
pub struct Sensed<'a> {
    /// Ranges, or a grey image in a log of grey images only.
    pub frame: &'a Frame,
    /// The grey image in addition to ranges.
    pub grey: Option<&'a Frame>,
    /// What the robot's other sensors measured.
    pub beside: &'a [Frame],
    /// The message of a bag that holds the frame.
    #[cfg_attr(not(feature = "ros"), expect(dead_code, reason = "only bags repeat recorded messages"))]
    pub recorded: Option<&'a Recorded>,
}

#[cfg_attr(not(feature = "report"), expect(dead_code, reason = "only replays show measurements"))]
impl Sensed<'_> {
    /// The grey image, with or without ranges.
    pub fn grey(&self) -> Option<&Frame> {
        self.grey.or(self.frame.grey().map(|_| self.frame))
    }
}

/// The results of a whole drive.
#[derive(Default)]
pub struct Followed {
    /// The localizer's step for each frame, without verdict images and findings.
    pub steps: Vec<Step>,
    /// Pixels of each verdict, by frame.
    pub counts: Vec<[usize; 7]>,
    /// Feature counts, by frame; `None` if no features were searched.
    pub features: Vec<Option<FeatureCounts>>,
    /// The robot's pose from the log, by frame.
    pub reference: Vec<Option<RobotPose>>,
}

impl Drive {
    /// Tracks the robot through the log. Calls `visit` with each frame and its step. Before the first call it checks
    /// that `files` would not overwrite an input. A run that is `resumed` begins behind the frames that it has. Prints
    /// what the readings were taken as, also after an error.
    ///
    /// # Errors
    /// Errors from reading the log, map and sensor, from the estimator, and from `visit`.
    pub fn follow(
        &self,
        files: OutputFiles,
        resumed: Option<&Resumed>,
        visit: impl FnMut(&Scene, &Sensed<'_>, &Step) -> Result<()>,
    ) -> Result<Followed> {
        self.check_outputs(&files)?;
        if self.init.is_none() {
            return Err(Error::usage(
                "--init is missing",
                "give a pose, `reference` (the log's first pose) or `unknown`",
            ));
        }
        let mut log = self.opened()?;
        let followed = self.follow_log(&mut log, files, resumed, visit);
        self.print_notices(&log);
        followed
    }

    /// Checks the flags, and that no output is an input.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] naming the flag or the output.
    pub fn check_outputs(&self, files: &OutputFiles) -> Result<()> {
        self.check()?;
        let beside =
            ["camera.json", "grey.toml", "odometry.txt", "poses.json", "poses.txt"].map(|name| self.log.join(name));
        let sensors = [&self.sensor, &self.grey_sensor].into_iter().flatten().map(Path::new);
        files.check_named([self.log.as_path(), self.map.as_path()].into_iter().chain(sensors))?;
        files.check_named(files_of_bag(&self.log).iter().map(PathBuf::as_path))?;
        files.check_named(self.layers.iter().chain(&beside).map(PathBuf::as_path))?;
        files.check_named(self.robot.iter().map(|sensor| sensor.log.as_path()))
    }

    /// Reads the log without following it. Calls `visit` with each frame, and with its pose and message if the log has
    /// them. The motion during scans is that of a trajectory, if one is given. Prints the notices of the log.
    ///
    /// # Errors
    /// Errors from reading the log, map and sensor, and from `visit`.
    #[cfg(any(feature = "ros", feature = "store"))]
    pub fn read(
        &self,
        scene: &Scene,
        trajectory: Option<&[StampedPose]>,
        visit: impl FnMut(&Scene, &Observation) -> Result<()>,
    ) -> Result<()> {
        let log = self.read_again(scene, trajectory, visit)?;
        self.print_notices(&log);
        Ok(())
    }

    /// As [`Drive::read`], for a log that was read before: its notices have been printed.
    ///
    /// # Errors
    /// As [`Drive::read`].
    #[cfg(any(feature = "ros", feature = "store"))]
    pub fn read_again(
        &self,
        scene: &Scene,
        trajectory: Option<&[StampedPose]>,
        mut visit: impl FnMut(&Scene, &Observation) -> Result<()>,
    ) -> Result<LogFrames> {
        self.check()?;
        let mut log = self.opened()?;
        if let Some(poses) = trajectory {
            log = log.moving_along(poses).map_err(|e| e.at("--poses"))?;
        }
        for observation in self.observations(&mut log, None) {
            visit(scene, &observation?)?;
        }
        Ok(log)
    }

    /// Prints how the readings of the log were interpreted, and which times or motions of its scans are unknown.
    fn print_notices(&self, log: &LogFrames) {
        let notices = log.notices();
        print::notices(&notices.iter().map(|notice| format!("{}: {notice}", self.log.display())).collect::<Vec<_>>());
    }

    /// Opens the log with its sensor.
    fn opened(&self) -> Result<LogFrames> {
        match self.robot.first() {
            Some(first) => self.opened_of(first),
            None => self.logs.open(&self.log, self.given_sensor()?.as_ref(), &self.odometry()?),
        }
    }

    /// Opens the log of a sensor of the robot.
    fn opened_of(&self, of: &RobotLog) -> Result<LogFrames> {
        let sensor = of.sensor.clone().map_or_else(|| self.given_sensor(), |sensor| Ok(Some(sensor)))?;
        self.logs.of_topic(of.topic.clone()).open(&of.log, sensor.as_ref(), &self.odometry()?)
    }

    fn given_sensor(&self) -> Result<Option<Sensor>> {
        self.sensor.as_deref().map(|sensor| self.image.load(sensor)).transpose()
    }

    /// The measurements from --from on and `after` a time, thinned, with the poses of planar documents on the floor.
    fn observations(&self, log: &mut LogFrames, after: Option<f64>) -> impl Iterator<Item = Result<Observation>> {
        let is_planar = log.has_planar_poses();
        let is_early =
            move |stamp: f64| self.from.is_some_and(|from| stamp < from) || after.is_some_and(|t| stamp <= t);
        log.skip_while(move |o| matches!(o, Ok(o) if is_early(o.frame.stamp)))
            .map(move |o| o.and_then(|o| self.thinned(if is_planar { self.on_the_floor(o) } else { o })))
    }

    /// Opens the map.
    ///
    /// # Errors
    /// Errors from reading it.
    pub fn scene(&self) -> Result<Scene> {
        let threads = Threads::from(self.threads).started()?;
        let import = ImportOptions { threads, ..ImportOptions::default() };
        open_scene_without(&self.map, &import, IndexKind::default(), &self.exclude)
    }

    /// This drive, with a deviation of the model that is learnt if no flag states it.
    pub fn learning(&self) -> Self {
        Self { learns_sigma: true, ..self.clone() }
    }

    /// These options with another log.
    #[cfg(feature = "store")]
    pub fn with_log(&self, log: &Path) -> Self {
        Self { log: log.to_owned(), ..self.clone() }
    }

    fn follow_log(
        &self,
        log: &mut LogFrames,
        files: OutputFiles,
        resumed: Option<&Resumed>,
        mut visit: impl FnMut(&Scene, &Sensed<'_>, &Step) -> Result<()>,
    ) -> Result<Followed> {
        let measured = log.sensor().clone();
        let mut log = self.observations(log, resumed.map(|run| run.time));
        let Some(first) = log.next().transpose()? else {
            if resumed.is_some() {
                return Ok(Followed::default());
            }
            let remedy = "give a log with frames, or an earlier --from";
            return Err(Error::invalid("the log has no frames", remedy).in_file(&self.log));
        };
        let threads = Threads::from(self.threads).started()?;
        let (start, options) = (self.start(&first)?, self.options(first.frame.sensor()));
        let scene = self.scene()?;
        print::far_outside(&scene, start.iter().map(|robot| robot.world_from_robot().translation));
        let mut grey = self.grey(&measured)?;
        let mut logs_beside = self.logs_beside()?;
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(threads))?;
        let estimator = Estimator::new(predictor, options);
        let estimator = self.with_features(estimator, &scene, grey.as_ref(), &first.frame)?;
        // A resumed run starts at its last pose, if it had one, with the uncertainty of a start.
        let start_now = if let Some(run) = resumed { run.pose } else { start };
        let progress = super::bar::count("frames");
        let mut localizer = self.localizer(estimator, start_now, &scene, first.frame.sensor(), &progress)?;
        // The search of the whole map predicts many panoramas, so it is set up only when it is needed.
        let mut may_search = start_now.is_some() && options.freedom == Freedom::Planar;
        files.check_scene(&scene.files)?;
        let mut followed = Followed::default();
        for observation in std::iter::once(Ok(first)).chain(log) {
            let Observation { frame, reference, recorded } = observation?;
            let grey = self.logs.kept(grey.as_mut().and_then(|g| g.next_at(frame.stamp).transpose()).transpose())?;
            let others = logs_beside.iter_mut().filter_map(|log| log.next_at(frame.stamp).transpose());
            let others = others.map(|other| other.and_then(|o| self.thinned(o))).map(|o| o.map(|o| o.frame));
            let mut others = others.collect::<Result<Vec<Frame>>>()?;
            let beside: Vec<&Frame> = grey.iter().chain(&others).collect();
            let place = |e: Error| e.at(format!("the frame at {} s", frame.stamp)).in_file(&self.log);
            let mut step = localizer.step_together(&scene.world, &frame, &beside).map_err(place)?;
            if may_search && matches!(step.phase, Phase::Lost | Phase::Unknown) {
                may_search = false;
                let search = self.search_about(&step.pose.world_from_robot)?;
                let mut watch = watching(&progress);
                if let Err(e) = localizer.search_everywhere_watched(&scene.world, frame.sensor(), search, &mut watch) {
                    print::notices(&[format!("searching for the robot only around its last pose: {e}")]);
                }
            }
            progress.set_message(match (step.phase, may_search || start_now.is_none()) {
                (Phase::Lost | Phase::Unknown, false) if options.freedom == Freedom::Full => {
                    "lost: searching around the last pose"
                }
                (phase, _) => phase.name(),
            });
            progress.inc(1);
            let recorded = recorded.as_deref();
            others.iter_mut().for_each(|other| *other = step.moving(other).into_owned());
            let sensed = Sensed { frame: &step.moving(&frame), grey: grey.as_ref(), beside: &others, recorded };
            visit(&scene, &sensed, &step)?;
            followed.features.push(FeatureCounts::of(&step.estimate.findings));
            step.estimate.findings.clear();
            followed.counts.push(verdict_counts(&step));
            step.estimate.verdicts.clear();
            followed.steps.push(step);
            followed.reference.push(reference);
        }
        progress.finish_and_clear();
        print::notices(&localizer.warnings());
        Ok(followed)
    }

    /// The estimator with the features of the map that are sought in the frames, which are images or scans.
    fn with_features(
        &self,
        estimator: Estimator,
        scene: &Scene,
        grey: Option<&DepthFolder>,
        first: &Frame,
    ) -> Result<Estimator> {
        let shows_features = first.grey().is_some() || !first.sensor().is_camera();
        let sensor = grey.map(DepthFolder::sensor).or(shows_features.then(|| first.sensor()));
        let Some(placed) = sensor.map(|sensor| self.placed(scene, sensor)).transpose()?.flatten() else {
            return Ok(estimator);
        };
        let of_scans = grey.is_none() && first.grey().is_none();
        print::notices(&if of_scans { not_sought_in_scans(&placed, first) } else { not_sought(&placed) });
        Ok(estimator.with_features(placed))
    }

    /// Opens the logs of the robot's other sensors.
    fn logs_beside(&self) -> Result<Vec<LogBeside>> {
        let open = |of: &RobotLog| Ok(LogBeside { frames: self.opened_of(of)?, next: None });
        self.robot.iter().skip(1).map(open).collect()
    }

    /// Opens the grey images of a log of depth images, if it has any.
    fn grey(&self, depth: &Sensor) -> Result<Option<DepthFolder>> {
        let sensor = self.grey_sensor.as_deref().map(load_sensor).transpose()?;
        print::notices(sensor.iter().flat_map(|(_, notices)| notices));
        if !self.log.is_dir() {
            return Ok(None);
        }
        DepthFolder::grey_beside(&self.log, sensor.as_ref().map(|(sensor, _)| sensor), depth)
    }

    /// Lifts the reference of planar poses, which have no height, to the floor.
    fn on_the_floor(&self, mut observation: Observation) -> Observation {
        observation.reference = observation.reference.map(|robot| at_height(robot, self.floor));
        observation
    }

    fn thinned(&self, observation: Observation) -> Result<Observation> {
        // A grey image keeps all pixels: thinning would destroy its edges.
        let frame: Frame = if self.stride > 1 && observation.frame.grey().is_none() {
            observation.frame.thinned(self.stride)?
        } else {
            observation.frame
        };
        Ok(Observation { frame, ..observation })
    }
}

/// Shows how far a search of the whole map is.
fn watching(progress: &ProgressBar) -> impl FnMut(usize, usize) + use<> {
    let (progress, since) = (progress.clone(), Instant::now());
    move |done, all| progress.set_message(super::bar::looking_round(done, all, since.elapsed()))
}

/// The files of a log that is a folder of a ROS 2 bag.
fn files_of_bag(log: &Path) -> Vec<PathBuf> {
    if !log.is_dir() || log.join("depth").exists() {
        return Vec::new();
    }
    let entries = std::fs::read_dir(log).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_of_bag = |path: &PathBuf| {
        let name = path.to_string_lossy();
        let name = name.trim_end_matches(".zstd");
        name.ends_with(".mcap") || name.ends_with(".db3")
    };
    entries.filter(is_of_bag).collect()
}

/// Pixels of each verdict of a step that still has its verdict images.
pub fn verdict_counts(step: &Step) -> [usize; 7] {
    step.estimate.verdicts.first().map(Verdicts::counts).unwrap_or_default()
}

/// The pose of a robot with another height, metres.
pub fn at_height(robot: RobotPose, height: f64) -> RobotPose {
    let pose = robot.world_from_robot();
    RobotPose::new(Pose { translation: pose.translation.with_z(height), ..pose })
}
