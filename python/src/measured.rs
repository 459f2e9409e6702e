//! What sensors did see: logs, frames, verdicts, and the localizer.

use super::arrays::{array, numbers, one_by_one, pose_numbers, pose_of};
use super::errors::{Failed, apart, raised, usage, warn};
use super::process::Shared;
use super::scene::Scene;
use super::sensor::{Sensor, sensor_of};
use presight::files::{BagOptions, LogFrame, LogFrames, Observation};
use presight::localize::{
    EstimateOptions, Estimator, Freedom, LocalizeOptions, Localizer as Ours, Search, SearchOptions, Step as OurStep,
};
use presight::measured::{Frame as OurFrame, OdometryNoise, ScanMotion};
use presight::tools;
use presight::verdict::{Verdict, Verdicts as OurVerdicts};
use presight::{Backend, Error, Options, Pose, PoseEstimate, Predictor, RobotPose, Sensor as OurSensor, Twist};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use std::path::PathBuf;

/// One measurement of one sensor: ranges along its rays, in metres, with their time and the robot's motion since the frame before.
///
/// `ranges` are of (rows, columns), or (columns,) for one row: inf for nothing within reach, -inf for too near, NaN for no reading; 0
/// and finite values outside of the sensor's limits count as missing readings, too. `odometry` is the robot's pose in its frame of the
/// measurement before. `intensities` are 0 to 1. `times` are of the shape of `ranges`: seconds after `time` at which each ray was
/// measured, those of the sensor by default. `twist` is the robot's velocity meanwhile, vx vy vz wx wy wz, metres and radians per second
/// along and about its own axes.
///
/// >>> import presight, numpy as np
/// >>> frame = presight.Frame("laser-scanner", 0.0, np.full(361, 2.0), odometry=[0.1, 0, 0, 0, 0, 0])
/// >>> frame.time, frame.ranges.shape, frame.times
/// (0.0, (1, 361), None)
/// >>> moving = presight.Frame("laser-scanner", 0.0, np.full(361, 2.0), times=np.linspace(0, 0.1, 361), twist=[1.5, 0, 0, 0, 0, 1])
/// >>> float(moving.times[0, 360]), moving.twist.tolist()
/// (0.10000000149011612, [1.5, 0.0, 0.0, 0.0, 0.0, 1.0])
#[pyclass(frozen, module = "presight")]
pub struct Frame(pub OurFrame);

fn poses_array<'py>(py: Python<'py>, poses: impl Iterator<Item = Option<Pose>>) -> PyResult<Bound<'py, PyAny>> {
    let numbers: Vec<f64> = poses.flat_map(|pose| pose.map_or([f64::NAN; 7], |pose| pose_numbers(&pose))).collect();
    let count = numbers.len() / 7;
    array(py, numbers, &[count, 7])
}

/// A twist of six numbers.
fn twist_of(given: &Bound<'_, PyAny>) -> PyResult<Twist> {
    let (shape, values) = numbers::<f64>(given, "twist")?;
    let twist = <[f64; 6]>::try_from(values).ok().filter(|_| shape == [6]).map(Twist::from_array);
    let wrong = || usage(given.py(), "twist", format!("the shape is {shape:?}"), "give vx, vy, vz, wx, wy, wz");
    twist.ok_or_else(wrong)
}

#[pymethods]
impl Frame {
    #[new]
    #[pyo3(signature = (sensor, time, ranges, odometry = None, intensities = None, times = None, twist = None))]
    #[expect(clippy::too_many_arguments, reason = "what a line of a log holds")]
    fn new(
        py: Python<'_>,
        sensor: &Bound<'_, PyAny>,
        time: f64,
        ranges: &Bound<'_, PyAny>,
        odometry: Option<&Bound<'_, PyAny>>,
        intensities: Option<&Bound<'_, PyAny>>,
        times: Option<&Bound<'_, PyAny>>,
        twist: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let sensor = sensor_of(sensor)?;
        let (height, width) = (sensor.height() as usize, sensor.width() as usize);
        let image = |given: &Bound<'_, PyAny>, name: &str| -> PyResult<Vec<f32>> {
            let (shape, values) = numbers::<f32>(given, name)?;
            if shape != [height, width] && !(height == 1 && shape == [width]) {
                let remedy = format!("give ({height}, {width}), or the sensor that measured");
                return Err(usage(py, name, format!("the shape is {shape:?}"), remedy));
            }
            Ok(values)
        };
        let ranges = image(ranges, "ranges")?;
        let intensities = intensities.map(|given| image(given, "intensities")).transpose()?;
        let times = times.map(|given| image(given, "times")).transpose()?;
        let odometry = odometry.map(|given| pose_of(given, "odometry")).transpose()?;
        let twist = twist.map(twist_of).transpose()?;
        let line = LogFrame { intensities, times, twist, odometry, ..LogFrame::new(time, ranges) };
        apart(py, || Ok(Self(line.into_frame(&sensor, &OdometryNoise::default())?)))
    }

    /// Seconds.
    #[getter]
    fn time(&self) -> f64 {
        self.0.stamp
    }

    /// Metres along each ray: (rows, columns), float32, NaN for no reading.
    #[getter]
    fn ranges<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let sensor = self.0.sensor();
        array(py, self.0.ranges().to_vec(), &[sensor.height() as usize, sensor.width() as usize])
    }

    /// The robot's motion since the frame before: (7,) x y z qx qy qz qw, or None.
    #[getter]
    fn odometry<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let motion = self.0.motion.map(|motion| pose_numbers(&motion.previous_from_current).to_vec());
        motion.map(|numbers| array(py, numbers, &[7])).transpose()
    }

    /// Seconds after `time` at which each ray was measured: (rows, columns), float32, or None if all rays were measured at `time`.
    #[getter]
    fn times<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let sensor = self.0.sensor();
        if sensor.spec().times.is_at_once() {
            return Ok(None);
        }
        let (width, height) = (sensor.width(), sensor.height());
        let pixels = (0..height).flat_map(|r| (0..width).map(move |c| (c, r)));
        let seconds: Vec<f32> = pixels.map(|(c, r)| sensor.seconds_after_stamp(c, r) as f32).collect();
        array(py, seconds, &[height as usize, width as usize]).map(Some)
    }

    /// The robot's velocity while the rays were measured, if it was constant: (6,) vx vy vz wx wy wz along and about its own axes, or None.
    #[getter]
    fn twist<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let Some(ScanMotion::Twist(twist)) = self.0.scan_motion() else { return Ok(None) };
        array(py, twist.to_array().to_vec(), &[6]).map(Some)
    }

    /// The sensor that measured.
    #[getter]
    fn sensor(&self) -> Sensor {
        Sensor(self.0.sensor().clone())
    }

    fn __repr__(&self) -> String {
        format!("<presight.Frame of {} at {} s>", self.0.sensor().spec().name, self.0.stamp)
    }
}

/// The frames of a log, in memory.
///
/// A log is what `presight localize` takes: a file of ranges, a folder of depth images, a scan or a folder of scans, or a ROS 2 bag. Its frames come by
/// index or in a loop; columns are arrays.
///
/// >>> import presight, tempfile, os, json
/// >>> path = os.path.join(tempfile.mkdtemp(), "run.jsonl")
/// >>> header = {"format": 1, "kind": "range-log", "sensor": presight.Sensor.scanner([0, 1]).toml()}
/// >>> lines = [header, {"t": 0.0, "range": [2.0, 3.0]}, {"t": 0.1, "range": [2.1, None], "odometry": [0.1, 0, 0, 0, 0, 0]}]
/// >>> _ = open(path, "w").write("".join(json.dumps(line) + chr(10) for line in lines))
/// >>> import warnings; warnings.simplefilter("ignore")
/// >>> log = presight.Log.open(path)
/// >>> log.ranges.shape, log.time.tolist()
/// ((2, 1, 2), [0.0, 0.1])
#[pyclass(frozen, module = "presight")]
pub struct Log {
    sensor: OurSensor,
    frames: Vec<Observation>,
    notices: Vec<String>,
}

/// Memory is checked each time that frames have taken this number of bytes.
const LOOK_BYTES: u64 = 64 << 20;

#[pymethods]
impl Log {
    /// Reads a log. `sensor` supplies noise, limits and mount, and must have the log's image size. What the log leaves out is one warning.
    /// For a ROS 2 bag, `topic` names the measured topic if there are several, `base` the robot's frame (by default `base_link`, else
    /// `base_footprint`), `mount` the sensor's pose on the robot where no static transform gives it, and `reflector` the intensity of a
    /// full reflector. With `skip_bad` frames that cannot be read and frames whose time falls are left out; the warning counts and names
    /// them.
    ///
    /// Raises `Error` naming file and frame, and `MemoryError` for a log that does not fit.
    #[staticmethod]
    #[pyo3(signature = (path, sensor = None, topic = None, base = None, mount = None, reflector = None, skip_bad = false))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python by name")]
    fn open(
        py: Python<'_>,
        path: PathBuf,
        sensor: Option<&Bound<'_, PyAny>>,
        topic: Option<String>,
        base: Option<String>,
        mount: Option<&Bound<'_, PyAny>>,
        reflector: Option<f32>,
        skip_bad: bool,
    ) -> PyResult<Self> {
        let sensor = sensor.map(sensor_of).transpose()?;
        let mount = mount.map(|given| pose_of(given, "mount")).transpose()?;
        let bag = BagOptions::default().with_topic(topic).with_base(base).with_mount(mount).with_reflector(reflector);
        let log = apart(py, || {
            let (sensor, noise) = (sensor.as_ref(), OdometryNoise::default());
            let mut log = match skip_bad {
                true => LogFrames::open_skipping_bad(&path, sensor, &noise, &bag)?,
                false => LogFrames::open_with(&path, sensor, &noise, &bag)?,
            };
            let (mut frames, mut bytes) = (Vec::new(), 0);
            while let Some(frame) = log.next().transpose()? {
                bytes += 8 * frame.frame.ranges().len() as u64;
                if bytes > LOOK_BYTES {
                    tools::require_memory(LOOK_BYTES).map_err(|e| e.in_file(&path))?;
                    bytes = 0;
                }
                frames.push(frame);
            }
            Ok(Self { sensor: log.sensor().clone(), frames, notices: log.notices() })
        })?;
        warn(py, &log.notices)?;
        Ok(log)
    }

    /// The sensor of the first frame.
    #[getter]
    fn sensor(&self) -> Sensor {
        Sensor(self.sensor.clone())
    }

    /// Seconds: (n,), float64.
    #[getter]
    fn time<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let times: Vec<f64> = self.frames.iter().map(|o| o.frame.stamp).collect();
        array(py, times, &[self.frames.len()])
    }

    /// Metres along each ray: (n, rows, columns), float32. Raises `Error` if the frames differ in size.
    #[getter]
    fn ranges<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let (height, width) = (self.sensor.height() as usize, self.sensor.width() as usize);
        if self.frames.iter().any(|o| o.frame.ranges().len() != height * width) {
            return Err(usage(py, "ranges", "the scans have different rays", "take the ranges of each frame"));
        }
        super::errors::room_for(Some(4 * (self.frames.len() * height * width) as u64))?;
        let ranges =
            apart(py, || Ok(self.frames.iter().flat_map(|o| o.frame.ranges()).copied().collect::<Vec<f32>>()))?;
        array(py, ranges, &[self.frames.len(), height, width])
    }

    /// The robot's motion since the frame before: (n, 7) x y z qx qy qz qw, NaN where the log has none.
    #[getter]
    fn odometry<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        poses_array(py, self.frames.iter().map(|o| o.frame.motion.map(|motion| motion.previous_from_current)))
    }

    /// Reference poses of the robot in the world: (n, 7), NaN where the log has none.
    #[getter]
    fn reference<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        poses_array(py, self.frames.iter().map(|o| o.reference.map(|robot| robot.world_from_robot())))
    }

    fn __len__(&self) -> usize {
        self.frames.len()
    }

    fn __getitem__(&self, index: isize) -> PyResult<Frame> {
        let count = self.frames.len() as isize;
        let at = if index < 0 { index + count } else { index };
        match self.frames.get(usize::try_from(at).unwrap_or(usize::MAX)) {
            Some(observation) => Ok(Frame(observation.frame.clone())),
            None => Err(PyIndexError::new_err(format!("frame {index} of {count}"))),
        }
    }

    fn __iter__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        one_by_one(slf.as_any(), slf.get().__len__())
    }

    fn __repr__(&self) -> String {
        format!("<presight.Log of {} frames of {}>", self.frames.len(), self.sensor.spec().name)
    }
}

/// What each measured pixel says of the model.
///
/// `pixels` are numbers of `Verdicts.names`: "confirmed" (it is there), "nearer" (something unknown stands before it), "farther" (the ray
/// passed through it), "no_return", "beyond", "undecidable", "not_predicted".
///
/// >>> import presight
/// >>> presight.Verdicts.names[0]
/// 'confirmed'
#[pyclass(frozen, module = "presight")]
pub struct Verdicts(pub OurVerdicts);

#[pymethods]
impl Verdicts {
    /// The names of the numbers.
    #[classattr]
    fn names() -> [&'static str; 7] {
        Verdict::ALL.map(Verdict::name)
    }

    /// The verdict of each pixel: (rows, columns), uint8.
    #[getter]
    fn pixels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let pixels: Vec<u8> = self.0.pixels.iter().map(|verdict| *verdict as u8).collect();
        array(py, pixels, &[self.0.height as usize, self.0.width as usize])
    }

    /// Measured less predicted range, metres: (rows, columns), float32, NaN where one is missing.
    #[getter]
    fn difference<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.difference.clone(), &[self.0.height as usize, self.0.width as usize])
    }

    /// Number of pixels by name.
    #[getter]
    fn counts(&self) -> std::collections::BTreeMap<&'static str, usize> {
        Self::names().into_iter().zip(self.0.counts()).collect()
    }

    fn __repr__(&self) -> String {
        let (confirmed, all) = (self.0.counts()[Verdict::Confirmed as usize], self.0.pixels.len());
        format!("<presight.Verdicts {confirmed} of {all} confirmed>")
    }
}

/// Where the robot is after a frame.
#[pyclass(frozen, module = "presight")]
pub struct Step(pub OurStep);

#[pymethods]
impl Step {
    /// The robot's pose in the world: (7,) x y z qx qy qz qw.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, pose_numbers(&self.0.pose.world_from_robot).to_vec(), &[7])
    }

    /// Its covariance: (6, 6), x y z and rotations about x y z, along the world's axes, metres and radians.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.pose.covariance.as_rows().as_flattened().to_vec(), &[6, 6])
    }

    /// The name of the localizer's state, such as "tracking". The guide on localization says in which states the pose is known.
    #[getter]
    fn state(&self) -> &'static str {
        self.0.phase.name()
    }

    /// Why, with numbers.
    #[getter]
    fn reason(&self) -> &str {
        &self.0.reason
    }

    /// True if one pose is known: it was given at the start, or it was found.
    #[getter]
    fn is_known(&self) -> bool {
        self.0.is_known()
    }

    /// The verdict on each pixel of the frame, or None if nothing was compared.
    #[getter]
    fn verdicts(&self) -> Option<Verdicts> {
        self.0.estimate.verdicts.first().cloned().map(Verdicts)
    }

    /// Fraction of the measured points that the model explains.
    #[getter]
    fn explained(&self) -> f64 {
        self.0.estimate.explained
    }

    /// Directions that the measurement does not determine, such as "x" or "x+yaw".
    #[getter]
    fn weak(&self) -> Vec<String> {
        self.0.estimate.weak.iter().map(|weak| weak.name.clone()).collect()
    }

    /// The frame's time, seconds.
    #[getter]
    fn time(&self) -> f64 {
        self.0.stamp
    }

    /// A frame of this step with the motion of the robot that was found for its scan, if the scan takes time: `Predictor.verdicts`
    /// then compares what the localizer compared.
    fn moving(&self, frame: &Bound<'_, Frame>) -> Frame {
        Frame(self.0.moving(&frame.get().0).into_owned())
    }

    fn __repr__(&self) -> String {
        let t = self.0.pose.world_from_robot.translation;
        format!("<presight.Step {} at {:.3}, {:.3}, {:.3}>", self.state(), t.x, t.y, t.z)
    }
}

/// Follows a robot through the frames of its sensor, as `presight localize` does.
///
/// `init` is the robot's first pose, known within `init_sigma` metres and `init_sigma_deg` degrees (standard deviations). Without it, a
/// search of the whole scene finds a level scanner at its first frames, on a floor at `floor` metres. `model_sigma` is the standard deviation
/// of the polygons' positions, metres. The scene's version at the start is used.
///
/// >>> import presight
/// >>> room, start = presight.Scene.example(), [1, 1.5, 0.5, 0, 0, 0]
/// >>> scanner = presight.Sensor.load("laser-scanner").replace(range_sigma=0.01)
/// >>> seen = presight.predict(room, scanner, start).range
/// >>> step = presight.Localizer(room, init=start).step(presight.Frame(scanner, 0.0, seen))
/// >>> step.pose.shape, step.covariance.shape
/// ((7,), (6, 6))
#[pyclass(frozen, module = "presight")]
pub struct Localizer {
    world: presight::World,
    start: Start,
    threads: usize,
    /// Made at the first frame, whose sensor it depends on.
    follower: Shared<Option<Ours>>,
    /// The process that made it: a child has no localizer that saw what came before.
    process: u32,
}

#[derive(Clone, Copy)]
struct Start {
    prior: Option<PoseEstimate>,
    floor: f64,
    model_sigma: Option<f64>,
}

impl Start {
    fn localizer(&self, world: &presight::World, sensor: &OurSensor, threads: usize) -> Result<Ours, Error> {
        // As the command: a scanner of one row determines x, y and yaw only.
        let options = EstimateOptions::of(sensor).with_stated_sigma(self.model_sigma);
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(threads))?;
        let mut estimator = Estimator::new(predictor, options);
        if let Some(prior) = self.prior {
            return Ok(Ours::new(estimator, prior, LocalizeOptions::default()));
        }
        if options.freedom != Freedom::Planar {
            let what = format!("sensor {:?} is not a level scanner, and a search finds only these", sensor.spec().name);
            return Err(Error::usage(what, "give init=, the robot's first pose"));
        }
        let search = SearchOptions::default().with_floor(self.floor);
        let search = Search::new(&mut estimator, world, sensor, search)?;
        Ok(Ours::unknown(estimator, search, LocalizeOptions::default()))
    }
}

#[pymethods]
impl Localizer {
    #[new]
    #[pyo3(signature = (scene, init = None, init_sigma = 0.05, init_sigma_deg = 2.0, model_sigma = None, floor = 0.0, threads = 0))]
    #[expect(clippy::too_many_arguments, reason = "the flags of the command")]
    fn new(
        py: Python<'_>,
        scene: &Bound<'_, Scene>,
        init: Option<&Bound<'_, PyAny>>,
        init_sigma: f64,
        init_sigma_deg: f64,
        model_sigma: Option<f64>,
        floor: f64,
        threads: usize,
    ) -> PyResult<Self> {
        let sigmas = [
            ("init_sigma", init_sigma),
            ("init_sigma_deg", init_sigma_deg),
            ("model_sigma", model_sigma.unwrap_or(1.0)),
        ];
        for (name, sigma) in sigmas {
            if !(sigma > 0.0 && sigma.is_finite()) {
                return Err(usage(py, name, format!("{sigma}"), "give a finite deviation above 0"));
            }
        }
        if !floor.is_finite() {
            return Err(usage(py, "floor", format!("{floor}"), "give finite metres"));
        }
        let of_sigmas = |pose| PoseEstimate::of_sigmas(RobotPose::new(pose), init_sigma, init_sigma_deg.to_radians());
        let prior = init.map(|given| pose_of(given, "init")).transpose()?.map(of_sigmas);
        let scene = scene.get();
        let world = apart(py, || Ok(scene.seen().world))?;
        let start = Start { prior, floor, model_sigma };
        let process = presight::tools::this_process();
        Ok(Self { world, start, threads, follower: Shared::new(), process })
    }

    /// Takes in the next frame. Raises `Error` if it is not later than the one before.
    fn step(&self, py: Python<'_>, frame: &Bound<'_, Frame>) -> PyResult<Step> {
        if self.process != presight::tools::this_process() {
            let e = Error::usage("a localizer cannot go on in a forked process", "make one there");
            return Err(raised(py, &e));
        }
        let frame = &frame.get().0;
        apart(py, || {
            self.follower.with(
                || Ok(None),
                |follower| {
                    let localizer = match follower {
                        Some(localizer) => localizer,
                        None => follower.insert(self.start.localizer(&self.world, frame.sensor(), self.threads)?),
                    };
                    let step = localizer.step(&self.world, frame)?;
                    Ok::<_, Failed>(Step(step))
                },
            )
        })
    }

    /// What limits the poses so far, a line each.
    #[getter]
    fn warnings(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        apart(py, || {
            let lines = |follower: &mut Option<Ours>| Ok::<_, Failed>(follower.as_ref().map(Ours::warnings));
            Ok::<_, Failed>(self.follower.with(|| Ok(None), lines)?.unwrap_or_default())
        })
    }

    fn __repr__(&self) -> &'static str {
        "<presight.Localizer>"
    }
}
