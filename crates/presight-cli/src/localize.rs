//! `presight localize`: the robot's pose at each frame of a log.

use super::outputs::OutputFiles;
use super::pose::parse_pose;
use super::resume::{Mark, Resumed};
use super::sensor_args::SensorArgs;
use super::{CommandOutcome, open_scene_without, print};
use presight::Scene;
use presight_features::PlacedFeatures;
use presight_files::depth_folder::DepthFolder;
use presight_files::gltf::ImportOptions;
use presight_files::growing::{GrowingFile, is_through};
use presight_files::load_sensor;
use presight_files::log::{Frames, Observation};
use presight_localize::estimate::{EstimateOptions, Estimator, Freedom};
use presight_localize::extract::{FeatureClass, Findings, is_sought};
use presight_localize::localize::{
    Candidate, ErrorRates, LocalizeOptions, Localizer, Phase, Search, SearchOptions, Step,
};
use presight_localize::verdict::{Verdict as Judged, Verdicts};
use presight_model::environment::FeatureShape;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::index::IndexKind;
use presight_model::measured::{Frame, OdometryNoise};
use presight_model::sensor::{Geometry, Sensor};
use presight_model::threads::Threads;
use presight_predict::predict::{Backend, Options, Predictor};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight localize livingroom --map livingroom/livingroom_map.glb --init reference --stride 4 --out flight.tum
  presight localize run --map hall.presight --sensor camera.toml --init 1,2,1.5,0,20,90 --out run.tum
  presight localize scans.json --map corridor.glb --init unknown --out run.tum
  presight localize livingroom --map livingroom/livingroom_map.glb --stride 4 --from 30 --init unknown --floor 0.75 --floor-to 1.3 --lean 0,16.6 --margin 1 --surrounded 0.02 --out run.tum
  presight localize street_1.ply --map street_map.glb --init 0,0,0,0,0,0 --init-sigma 0.3 --init-sigma-deg 8 --out run.tum";

/// Track a robot through a log: its pose at every frame, with covariance and state
///
/// LOG is a folder of 16-bit depth images (camera.json, depth/*.png, optionally poses.txt), of grey images
/// (grey/*.png), or of both; a file of ranges (a log of format 1, or a document of planar scans); a scan; or a folder
/// of scans (.ply, .pcd, .csv, .exr). Features of --layer are detected in grey images, its reflectors in scans with
/// intensities. With a level scanner of one row only x, y and yaw are estimated. FILE.jsonl next to FILE.tum gets
/// covariance, state and verdicts of every frame. FILE.tum has no line for a frame whose pose is not known. Both grow
/// by a line as each frame comes, and stay after an error or a signal; the same command then goes on behind them. A log of ranges can come from a pipe
/// (/dev/stdin); a device or pipe as --out gets the poses without FILE.jsonl.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    drive: Drive,

    /// Write the poses here: lines of timestamp tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE.tum")]
    out: PathBuf,
}

/// Flags shared by `localize`, `replay`, `supervise` and `update`: the log, the map, and the options of the localizer.
#[derive(Clone, Debug, clap::Args)]
pub struct Drive {
    /// The log
    pub log: PathBuf,

    /// The sensors of a robot, the log's first, each with its log; empty to take what the other flags and the log say.
    #[arg(skip)]
    pub robot: Vec<(PathBuf, Sensor)>,

    /// The model: a .glb or .gltf file, a .rhai script, or a store
    #[arg(long, value_name = "SCENE")]
    pub map: PathBuf,

    /// Start pose of the robot: x,y,z,roll_deg,pitch_deg,yaw_deg or x,y,z,qx,qy,qz,qw, `reference` for the log's first
    /// pose, or `unknown` to search the whole map at the height of --floor with the roll and pitch of --lean
    #[arg(long, value_name = "POSE", allow_hyphen_values = true)]
    init: String,

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
    sensor: Option<String>,

    #[command(flatten)]
    image: SensorArgs,

    /// Standard deviation of the model's surfaces, independent for each surface, metres [default: 0.03 for a scanner of
    /// one row, 0.1 for scans of points, otherwise 0]
    #[arg(long, value_name = "METRES")]
    model_sigma: Option<f64>,

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

    /// Largest height in a search of the whole map, metres, if the height is not known [default: --floor]
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

/// The measurements at one time.
pub struct Sensed<'a> {
    /// Ranges, or a grey image in a log of grey images only.
    pub frame: &'a Frame,
    /// The grey image in addition to ranges.
    pub grey: Option<&'a Frame>,
    /// What the robot's other sensors measured.
    pub beside: &'a [Frame],
}

#[cfg_attr(not(feature = "report"), expect(dead_code, reason = "only replays show measurements"))]
impl Sensed<'_> {
    /// The grey image, with or without ranges.
    pub fn grey(&self) -> Option<&Frame> {
        self.grey.or(self.frame.grey().map(|_| self.frame))
    }
}

/// The log of another sensor.
struct LogBeside {
    frames: Frames,
    next: Option<Observation>,
}

/// Largest difference of the stamps of frames that count as taken at the same time, seconds.
const SAME_TIME: f64 = 0.01;

impl LogBeside {
    /// The frame that was taken at a time. Earlier ones are passed over.
    fn next_at(&mut self, stamp: f64) -> Result<Option<Observation>> {
        loop {
            let next = match self.next.take() {
                Some(next) => next,
                None => match self.frames.next().transpose()? {
                    Some(next) => next,
                    None => return Ok(None),
                },
            };
            if next.frame.stamp > stamp + SAME_TIME {
                self.next = Some(next);
                return Ok(None);
            }
            if next.frame.stamp >= stamp - SAME_TIME {
                return Ok(Some(next));
            }
        }
    }
}

/// Feature counts of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FeatureCounts {
    /// Predicted features, in the order of [`FeatureClass::NAMES`].
    pub classes: [usize; 4],
    /// Detections without a predicted feature.
    pub only_found: usize,
}

impl FeatureCounts {
    /// Sums over all images in which features were searched; `None` without one.
    fn of(findings: &[Findings]) -> Option<Self> {
        let count = |name: &str| findings.iter().map(|f| f.count(name)).sum();
        let only_found = findings.iter().map(|f| f.only_found.len()).sum();
        (!findings.is_empty()).then(|| Self { classes: FeatureClass::NAMES.map(count), only_found })
    }

    /// Names and numbers, for files and pages.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, usize)> {
        FeatureClass::NAMES.into_iter().zip(self.classes).chain(std::iter::once(("only_found", self.only_found)))
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
    /// world_from_robot from the log, by frame.
    pub reference: Vec<Option<Pose>>,
}

impl Drive {
    /// Tracks the robot through the log. Calls `visit` with each frame and its step. Before the first call it checks
    /// that `files` would not overwrite an input. A run that is `resumed` begins behind the frames that it has. Prints what the readings were taken as, also after an error.
    ///
    /// # Errors
    /// Errors from reading the log, map and sensor, from the estimator, and from `visit`.
    pub fn follow(
        &self,
        files: OutputFiles,
        resumed: Option<&Resumed>,
        visit: impl FnMut(&Scene, &Sensed<'_>, &Step) -> Result<()>,
    ) -> Result<Followed> {
        self.check()?;
        let beside =
            ["camera.json", "grey.toml", "odometry.txt", "poses.json", "poses.txt"].map(|name| self.log.join(name));
        let sensors = [&self.sensor, &self.grey_sensor].into_iter().flatten().map(Path::new);
        files.check_named([self.log.as_path(), self.map.as_path()].into_iter().chain(sensors))?;
        files.check_named(self.layers.iter().chain(&beside).map(PathBuf::as_path))?;
        files.check_named(self.robot.iter().map(|(log, _)| log.as_path()))?;
        let sensor = match self.robot.first() {
            Some((_, sensor)) => Some(sensor.clone()),
            None => self.sensor.as_deref().map(|sensor| self.image.load(sensor)).transpose()?,
        };
        let mut log = Frames::open(&self.log, sensor.as_ref(), &self.odometry()?)?;
        let followed = self.follow_log(&mut log, files, resumed, visit);
        print::notices(&log.notice().map(|notice| format!("{}: {notice}", self.log.display())));
        followed
    }

    /// Reads the log without following it. Calls `visit` with each frame, and with its pose if the log has one.
    ///
    /// # Errors
    /// Errors from reading the log, map and sensor, and from `visit`.
    #[cfg(feature = "store")]
    pub fn read(&self, scene: &Scene, mut visit: impl FnMut(&Scene, &Frame, Option<Pose>) -> Result<()>) -> Result<()> {
        self.check()?;
        let sensor = self.sensor.as_deref().map(|sensor| self.image.load(sensor)).transpose()?;
        let log = Frames::open(&self.log, sensor.as_ref(), &self.odometry()?)?;
        let is_planar = log.has_planar_poses();
        for observation in log {
            let observation = observation?;
            if self.from.is_some_and(|from| observation.frame.stamp < from) {
                continue;
            }
            let lifted = if is_planar { self.on_the_floor(observation) } else { observation };
            let Observation { frame, reference } = self.thinned(lifted)?;
            visit(scene, &frame, reference)?;
        }
        Ok(())
    }

    /// Opens the map as [`Drive::follow`] does.
    ///
    /// # Errors
    /// Errors from reading it.
    #[cfg(feature = "store")]
    pub fn scene(&self) -> Result<Scene> {
        let threads = Threads::from(self.threads).started()?;
        let import = ImportOptions { threads, ..ImportOptions::default() };
        open_scene_without(&self.map, &import, IndexKind::default(), &self.exclude)
    }

    /// The same drive options with another log.
    #[cfg(feature = "store")]
    pub fn with_log(&self, log: &Path) -> Self {
        Self { log: log.to_owned(), ..self.clone() }
    }

    /// The deviation of the model's surfaces, if it is given, metres.
    #[cfg(feature = "store")]
    pub fn model_sigma(&self) -> Option<f64> {
        self.model_sigma
    }

    fn follow_log(
        &self,
        log: &mut Frames,
        files: OutputFiles,
        resumed: Option<&Resumed>,
        mut visit: impl FnMut(&Scene, &Sensed<'_>, &Step) -> Result<()>,
    ) -> Result<Followed> {
        let (measured, is_planar) = (log.sensor().clone(), log.has_planar_poses());
        let is_done = |stamp: f64| resumed.is_some_and(|run| stamp <= run.time);
        let mut log = log
            .skip_while(
                |o| matches!(o, Ok(o) if self.from.is_some_and(|from| o.frame.stamp < from) || is_done(o.frame.stamp)),
            )
            .map(|o| o.and_then(|o| self.thinned(if is_planar { self.on_the_floor(o) } else { o })));
        let Some(first) = log.next().transpose()? else {
            if resumed.is_some() {
                return Ok(Followed::default());
            }
            let remedy = "give a log with frames, or an earlier --from";
            return Err(Error::invalid("the log has no frames", remedy).in_file(&self.log));
        };
        let threads = Threads::from(self.threads).started()?;
        let import = ImportOptions { threads: threads.clone(), ..ImportOptions::default() };
        let (start, options) = (self.start(&first)?, self.options(first.frame.sensor()));
        let scene = open_scene_without(&self.map, &import, IndexKind::default(), &self.exclude)?;
        let mut grey = self.grey(&measured)?;
        let mut logs_beside = self.logs_beside()?;
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(threads))?;
        let mut estimator = Estimator::new(predictor, options);
        let is_looked_in = first.frame.grey().is_some() || !first.frame.sensor().is_camera();
        let looked_in = grey.as_ref().map(DepthFolder::sensor).or(is_looked_in.then(|| first.frame.sensor()));
        if let Some(placed) = looked_in.map(|sensor| self.placed(&scene, sensor)).transpose()?.flatten() {
            let of_scans = grey.is_none() && first.frame.grey().is_none();
            print::notices(&if of_scans { not_sought_in_scans(&placed, &first.frame) } else { not_sought(&placed) });
            estimator = estimator.with_features(placed);
        }
        // A run that ended without a pose has no start left; one with a pose has moved since, and is as unsure as a start.
        let start_now = if let Some(run) = resumed { run.pose } else { start };
        let mut localizer = self.localizer(estimator, start_now, &scene, first.frame.sensor())?;
        // The search of the whole map predicts many panoramas, so it is set up only when it is needed.
        let mut may_search = start_now.is_some() && options.freedom == Freedom::Planar;
        files.check_scene(&scene.files)?;
        let (mut followed, progress) = (Followed::default(), super::bar::count("frames"));
        for observation in std::iter::once(Ok(first)).chain(log) {
            let Observation { frame, reference } = observation?;
            let grey = grey.as_mut().map(|g| g.next_at(frame.stamp)).transpose()?.flatten();
            let others = logs_beside.iter_mut().filter_map(|log| log.next_at(frame.stamp).transpose());
            let others = others.map(|other| other.and_then(|o| self.thinned(o))).map(|o| o.map(|o| o.frame));
            let others = others.collect::<Result<Vec<Frame>>>()?;
            let beside: Vec<&Frame> = grey.iter().chain(&others).collect();
            let place = |e: Error| e.at(format!("the frame at {} s", frame.stamp)).in_file(&self.log);
            let mut step = localizer.step_together(&scene.world, &frame, &beside).map_err(place)?;
            if may_search && matches!(step.phase, Phase::Lost | Phase::Unknown) {
                may_search = false;
                progress.set_message("looking round in the whole map");
                let search = self.search_about(&step.pose.world_from_robot)?;
                if let Err(e) = localizer.search_everywhere(&scene.world, frame.sensor(), search) {
                    print::notices(&[format!("searching for the robot only around its last pose: {e}")]);
                }
            }
            progress.set_message(step.phase.name());
            progress.inc(1);
            visit(&scene, &Sensed { frame: &frame, grey: grey.as_ref(), beside: &others }, &step)?;
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

    /// Advice if most frames of a depth folder have no pose: the assumed noise may be too small.
    fn noise_is_assumed(&self, followed: &Followed) -> Option<String> {
        let known = followed.steps.iter().filter(|s| s.is_known()).count();
        let assumed = self.log.join("depth").is_dir() && self.sensor.is_none() && 2 * known < followed.steps.len();
        assumed.then(|| {
            "the log does not specify the noise of its depths; if it exceeds 5 mm, give a --sensor file with [noise] \
             range_sigma and range_sigma_quadratic (docs/formats.md)"
                .to_owned()
        })
    }

    /// Opens the logs of the robot's other sensors.
    fn logs_beside(&self) -> Result<Vec<LogBeside>> {
        let open = |(path, sensor): &(PathBuf, Sensor)| {
            Ok(LogBeside { frames: Frames::open(path, Some(sensor), &self.odometry()?)?, next: None })
        };
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

    /// The features that the sensor can detect; `None` if none are requested.
    pub fn placed(&self, scene: &Scene, sensor: &Sensor) -> Result<Option<PlacedFeatures>> {
        let class = &sensor.spec().class;
        if self.own_features && scene.world.environment().layer(class).is_none() {
            let what = format!("--own-features: the scene has none for class {class:?}");
            return Err(Error::usage(what, "give a --layer (presight features generates one)"));
        }
        let asked = self.own_features || !self.layers.is_empty();
        let Some(found) = asked.then(|| scene.place_layers(&self.layers, class)).transpose()? else { return Ok(None) };
        if found.placed.features.is_empty() && found.other_classes > 0 {
            let what = format!("--layer: {} features, none of them of class {class:?}", found.other_classes);
            return Err(Error::usage(what, "give a layer and a sensor of the same class"));
        }
        Ok(Some(found.placed))
    }

    /// Lifts the reference of planar poses, which have no height, to the floor.
    fn on_the_floor(&self, mut observation: Observation) -> Observation {
        observation.reference.iter_mut().for_each(|pose| pose.translation.z = self.floor);
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

    /// Checks the values of the flags without opening any file.
    fn check(&self) -> Result<()> {
        if self.from.is_some_and(f64::is_nan) {
            return Err(Error::usage("--from NaN", "give seconds"));
        }
        for (flag, sigma) in [("--init-sigma", self.init_sigma), ("--init-sigma-deg", self.init_sigma_deg)] {
            if !(sigma > 0.0 && sigma.is_finite()) {
                return Err(Error::usage(format!("{flag} {sigma}"), "give a finite deviation above 0"));
            }
        }
        if !(self.init_odds > 1.0 && self.init_odds.is_finite()) {
            return Err(Error::usage(
                format!("--init-odds {}", self.init_odds),
                "give finite odds above 1, such as 10000",
            ));
        }
        if let Some(sigma) = self.model_sigma.filter(|sigma| !(*sigma >= 0.0 && sigma.is_finite())) {
            return Err(Error::usage(format!("--model-sigma {sigma}"), "give finite metres of at least 0"));
        }
        self.odometry()?;
        self.search()?;
        self.given_start().map(drop)
    }

    /// The pose of `--init`; `None` for a word.
    fn given_start(&self) -> Result<Option<Pose>> {
        match self.init.as_str() {
            "unknown" | "reference" => Ok(None),
            pose => parse_pose(pose).map(Some).map_err(|e| e.at(format!("--init {pose}"))),
        }
    }

    /// The start pose; `None` for `--init unknown`.
    fn start(&self, first: &Observation) -> Result<Option<Pose>> {
        if self.init != "reference" {
            return self.given_start();
        }
        first.reference.map(Some).ok_or_else(|| {
            Error::usage("--init reference: the log has no poses", "give x,y,z,roll_deg,pitch_deg,yaw_deg")
        })
    }

    fn localizer(
        &self,
        mut estimator: Estimator,
        start: Option<Pose>,
        scene: &Scene,
        sensor: &Sensor,
    ) -> Result<Localizer> {
        let rates = ErrorRates { wrong_start: 1.0 / self.init_odds, ..ErrorRates::default() };
        let options = LocalizeOptions::default().with_rates(rates);
        let Some(start) = start else {
            let search = Search::new(&mut estimator, &scene.world, sensor, self.search()?);
            return Ok(Localizer::unknown(estimator, search.map_err(|e| e.at("--init unknown"))?, options));
        };
        let prior = PoseEstimate::of_sigmas(start, self.init_sigma, self.init_sigma_deg.to_radians());
        Ok(Localizer::new(estimator, prior, options))
    }

    fn search(&self) -> Result<SearchOptions> {
        let [roll, pitch] = self.lean[..] else {
            return Err(Error::usage("--lean", "give roll and pitch in degrees, as in --lean 0,20"));
        };
        let lean = [roll.to_radians(), pitch.to_radians()];
        let floor_to = self.floor_to.unwrap_or(self.floor);
        let (floor, margin, surrounded) = (self.floor, self.margin, self.surrounded);
        for (flag, value, is_sound, remedy) in [
            ("--lean", roll, roll.is_finite(), "give finite degrees"),
            ("--lean", pitch, pitch.is_finite(), "give finite degrees"),
            ("--floor", floor, floor.is_finite(), "give finite metres"),
            ("--floor-to", floor_to, floor_to.is_finite(), "give finite metres"),
            ("--margin", margin, margin >= 0.0 && margin.is_finite(), "give finite metres of at least 0"),
            ("--surrounded", surrounded, (0.0..=1.0).contains(&surrounded), "give a share of 0 to 1"),
        ] {
            if !is_sound {
                return Err(Error::usage(format!("{flag} {value}"), remedy));
            }
        }
        Ok(SearchOptions::default()
            .with_floor(floor)
            .with_floor_to(floor_to)
            .with_margin(margin)
            .with_lean(lean)
            .with_surrounded(surrounded))
    }

    /// Options for a search of the whole map at the last height of the robot.
    fn search_about(&self, pose: &Pose) -> Result<SearchOptions> {
        let height = pose.translation.z;
        Ok(self.search()?.with_floor(height).with_floor_to(height))
    }

    fn odometry(&self) -> Result<OdometryNoise> {
        let part = self.odometry_sigma;
        if !(part >= 0.0 && part.is_finite()) {
            return Err(Error::usage(format!("--odometry-sigma {part}"), "give a finite fraction of at least 0"));
        }
        Ok(OdometryNoise::default().with_way(part).with_turn(part).with_turn_on_way(0.5 * part))
    }

    /// Standard deviation of the model's surfaces for a sensor, metres.
    pub fn model_sigma_of(&self, sensor: &Sensor) -> f64 {
        self.options(sensor).model_sigma
    }

    /// Estimator options for the sensor: a scanner of one row determines x, y and yaw only.
    fn options(&self, sensor: &Sensor) -> EstimateOptions {
        let row = matches!(sensor.spec().geometry, Geometry::Scanner(_)) && sensor.height() == 1;
        let options = match sensor.spec().geometry {
            _ if row => EstimateOptions::planar(),
            Geometry::Rays(_) => EstimateOptions::scan(),
            _ => EstimateOptions::default(),
        };
        let model_sigma = self.model_sigma.unwrap_or(options.model_sigma);
        // The offset shared by the polygons of one plane is about as large as the offset of each polygon.
        let offset_sigma = if self.model_sigma.is_some() { 0.7 * model_sigma } else { options.offset_sigma };
        options.with_model_sigma(model_sigma).with_offset_sigma(offset_sigma.max(1e-3))
    }
}

/// A notice about features that are not searched for in scans, or only in a limited way.
fn not_sought_in_scans(placed: &PlacedFeatures, first: &Frame) -> Option<String> {
    let is_reflector = |shape: &FeatureShape| matches!(shape, FeatureShape::Reflector { .. });
    let reflectors = placed.features.iter().filter(|p| is_reflector(&p.feature.shape)).count();
    let others = placed.features.len() - reflectors;
    let row = matches!(&first.sensor().spec().geometry, Geometry::Scanner(s) if s.elevation.len() == 1 && s.beam_height_deg.is_none());
    if reflectors == 0 {
        return Some("the layer has no reflectors, so scans are not searched for its features".to_owned());
    }
    if first.intensities().is_none() {
        return Some(
            "the first scan has no intensities; reflectors are found only in scans with intensities".to_owned(),
        );
    }
    if row {
        let remedy = "set beam_height_deg in the sensor file";
        return Some(format!(
            "the scanner's row has no height, so only reflectors exactly in its plane are found; {remedy}"
        ));
    }
    (others > 0)
        .then(|| format!("only reflectors are found in scans; {others} other features of the layer are ignored"))
}

/// A notice about fiducials that are not searched for, if any.
fn not_sought(placed: &PlacedFeatures) -> Option<String> {
    let is_left = |shape: &FeatureShape| matches!(shape, FeatureShape::Fiducial { .. }) && !is_sought(shape);
    let count = placed.features.iter().filter(|p| is_left(&p.feature.shape)).count();
    let why = if cfg!(feature = "fiducials") {
        "their dictionaries are other than DICT_APRILTAG_16h5, 25h9 and 36h11"
    } else {
        "this presight was built without the feature `fiducials`"
    };
    (count > 0).then(|| format!("{count} fiducials of the layer are not searched for: {why}"))
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
    let mark = details.as_ref().map(|_| {
        let inputs: Vec<&Path> = [args.drive.log.as_path(), &args.drive.map].into_iter().collect();
        Mark::new(&args.out, &format!("{args:?}"), &inputs)
    });
    let resumed = mark.as_ref().zip(details.as_deref()).and_then(|(mark, details)| mark.resumed(&args.out, details));
    let mut lines: Option<Lines> = None;
    let followed = args.drive.follow(files, resumed.as_ref(), |_, _, step| {
        // Only now: an error before the first step leaves the files of an earlier run.
        let lines = match &mut lines {
            Some(lines) => lines,
            None => {
                mark.as_ref().map_or(Ok(()), Mark::set)?;
                lines.insert(Lines::open(&args.out, details.as_deref(), resumed.as_ref())?)
            }
        };
        lines.add(step)
    })?;
    let is_marked = lines.is_some() || resumed.is_some();
    lines.map_or(Ok(()), Lines::finish)?;
    mark.iter().filter(|_| is_marked).try_for_each(Mark::clear)?;
    print::data(&summary(&followed))?;
    print::notices(&args.drive.noise_is_assumed(&followed));
    let last = followed.steps.last().filter(|_| followed.steps.iter().all(|step| !step.is_known()));
    print::notices(&last.and_then(help).map(|help| format!("no frame has a pose: {help}")));
    Ok(CommandOutcome::Done)
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
        "translation": s.pose.world_from_robot.translation.to_array(), "rotation_xyzw": s.pose.world_from_robot.rotation.to_array(),
        "odds": s.odds, "carried": s.carried, "covariance": s.pose.covariance, "explained": s.estimate.explained, "weak": weak, "verdicts": verdicts,
        "features": features,
        "predictions": s.estimate.predictions,
        "candidates": s.candidates.iter().map(candidate).collect::<Vec<_>>(),
    })
}

/// What a user can do about a frame, by the flags of the command.
fn help(s: &Step) -> Option<&'static str> {
    match s.phase {
        Phase::Lost | Phase::Unknown => Some(
            "--init unknown looks for the robot in the whole map, at the height of --floor; --model-sigma states how far \
             the map may be off, --sensor the noise and the mount of the sensor",
        ),
        _ if !s.estimate.weak.is_empty() => Some("no measurement holds the weak directions: odometry in the log would"),
        _ => None,
    }
}

/// Pixels of each verdict of a step that still has its verdict images.
fn verdict_counts(step: &Step) -> [usize; 7] {
    step.estimate.verdicts.first().map(Verdicts::counts).unwrap_or_default()
}

fn candidate(c: &Candidate) -> serde_json::Value {
    serde_json::json!({
        "translation": c.pose.world_from_robot.translation.to_array(), "rotation_xyzw": c.pose.world_from_robot.rotation.to_array(),
        "log_likelihood": c.log_likelihood, "explained": c.explained, "frames": c.frames,
    })
}

/// The number of frames with a pose, the changes of state, and the errors against the log's own poses.
pub fn summary(followed: &Followed) -> String {
    let Followed { steps, reference, .. } = followed;
    let known = steps.iter().filter(|s| s.is_known()).count();
    let mut text = format!("{known} of {} frames have a pose\n", steps.len());
    let changed = steps.windows(2).filter(|pair| pair[0].phase != pair[1].phase).map(|pair| &pair[1]);
    for step in steps.first().into_iter().chain(changed) {
        text += &format!("{}: {}: {}\n", step.stamp, step.phase.name(), step.reason);
    }
    let mut off: Vec<(f64, f64)> = Vec::new();
    for (step, there) in steps.iter().zip(reference).filter(|(step, _)| step.is_known()) {
        let Some(there) = there else { continue };
        let degrees = step.pose.world_from_robot.rotation.angle_between(there.rotation).to_degrees();
        off.push(((step.pose.world_from_robot.translation - there.translation).length(), degrees));
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
