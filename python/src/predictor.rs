//! Predictors: one prediction, many, likelihoods, verdicts.

use super::arrays::{Conventions, covariance_of, numbers, outputs_of, pose_of, poses_of};
use super::errors::{Failed, apart, room_for, usage, warn};
use super::many::{self, Chunks, Targets};
use super::measured::{Frame, Verdicts};
use super::motion::{GivenMotion, twist_motion};
use super::prediction::{About, Layer, Prediction};
use super::process::PerProcessPredictor;
use super::scene::{Scene, Seen};
use super::sensor::sensor_of;
use presight::features::{BoxOptions, FeatureOptions, FeatureSource, Hidden};
use presight::files::{self, LayerFile};
use presight::measured::{Frame as OurFrame, Measurement};
use presight::predict::{BatchRequest, Headings, PoseCell, RangeLikelihood};
use presight::sensor::ExternalPose;
use presight::{
    Backend, Error, Output, Outputs, Pose, PoseEstimate, Predictor as Ours, Request, Result, RobotPose, SceneFeatures,
    Sensor, SensorPose, World,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Features that were placed before: the version of the world, the sensor's class, the layers, and what came of them.
type Placed = Option<(u64, String, Vec<Arc<LayerFile>>, SceneFeatures)>;

/// Predicts on one engine and keeps its buffers from call to call.
///
/// `backend` is "auto" (a hardware GPU if there is one, else the CPU), "cpu" or "gpu"; `threads` the number of CPU threads, 0 for all
/// cores. Threads of one number are shared by all predictors of a process. Two Python threads may use one predictor; one waits for the
/// other. After a fork the child makes threads of its own. Raises `DeviceError` for "gpu" without an adapter.
///
/// >>> import presight
/// >>> predictor = presight.Predictor(backend="cpu", threads=1)
/// >>> predictor.engine
/// 'cpu'
#[pyclass(frozen, module = "presight")]
pub struct Predictor {
    core: PerProcessPredictor<Placed>,
    /// The engine's name in the process that made it.
    opened: String,
}

impl Predictor {
    pub fn with<R>(&self, work: impl FnOnce(&mut Ours) -> Result<R, Failed>) -> Result<R, Failed> {
        self.core.with(|predictor, _| work(predictor))
    }
}

fn layers_of(given: &Bound<'_, PyAny>) -> PyResult<Vec<Arc<LayerFile>>> {
    let py = given.py();
    let list: Vec<Bound<'_, PyAny>> = match given.extract::<PathBuf>() {
        Ok(_) => vec![given.clone()],
        Err(_) => given.try_iter()?.collect::<PyResult<_>>()?,
    };
    let mut files = Vec::with_capacity(list.len());
    for layer in list {
        files.push(match layer.cast::<Layer>() {
            Ok(layer) => layer.get().file.clone(),
            Err(_) => {
                let wrong = |_| usage(py, "layers", "not a valid layer", "give Layer objects, or paths of layer files");
                let path: PathBuf = layer.extract().map_err(wrong)?;
                apart(py, || Ok(Layer::read(path)?))?.file
            }
        });
    }
    Ok(files)
}

/// Finds the polygons of the features, or takes the placement of the last call.
fn place(
    scene: &presight::Scene,
    sensor: &Sensor,
    layers: &[Arc<LayerFile>],
    kept: &mut Placed,
) -> Result<SceneFeatures> {
    let (stamp, class) = (scene.world.stamp(), &sensor.spec().class);
    if let Some((at, of, files, placed)) = kept
        && (*at, &*of) == (stamp, class)
        && files.len() == layers.len()
        && files.iter().zip(layers).all(|(a, b)| Arc::ptr_eq(a, b))
    {
        return Ok(placed.clone());
    }
    if layers.is_empty() && scene.world.environment().layer(class).is_none() {
        let what = format!("features are requested, and the scene has none for class {class:?}");
        return Err(Error::usage(what, "give layers= (presight features generates one)"));
    }
    let placed = scene.place_files(layers.iter().map(|file| LayerFile::clone(file)).collect(), class)?;
    *kept = Some((stamp, class.clone(), layers.to_vec(), placed.clone()));
    Ok(placed)
}

/// Adds a deadline, if one is given.
fn in_time(py: Python<'_>, request: Request, deadline_ms: Option<f64>) -> PyResult<Request> {
    match deadline_ms {
        None => Ok(request),
        Some(ms) if ms > 0.0 && ms <= 1e9 => Ok(request.with_deadline(Duration::from_secs_f64(ms / 1e3))),
        Some(ms) => Err(usage(py, "deadline_ms", format!("{ms}"), "give milliseconds above 0 and up to 1e9")),
    }
}

/// Runs work that loads a graphics driver. Mesa prints an error where there is no folder of displays; for the while there is one that
/// cannot hold a socket.
fn without_displays<T>(py: Python<'_>, work: impl FnOnce() -> PyResult<T>) -> PyResult<T> {
    let (environ, name) = (py.import("os")?.getattr("environ")?, "XDG_RUNTIME_DIR");
    let given: Option<PathBuf> = environ.call_method1("get", (name,))?.extract()?;
    if given.as_ref().is_some_and(|folder| folder.is_absolute()) {
        return work();
    }
    environ.set_item(name, "/dev/null")?;
    let done = work();
    match given {
        Some(given) => environ.set_item(name, given)?,
        None => environ.del_item(name)?,
    }
    done
}

/// What each batch is given: a version of the world, a sensor, and its poses there.
struct Given {
    world: World,
    sensor: Sensor,
    poses: Vec<SensorPose>,
}

impl Given {
    fn new(
        scene: &Bound<'_, Scene>,
        sensor: &Bound<'_, PyAny>,
        poses: &Bound<'_, PyAny>,
        conventions: Conventions,
    ) -> PyResult<Self> {
        let (py, scene) = (scene.py(), scene.get());
        let (sensor, given) = (sensor_of(sensor)?, poses_of(poses)?);
        apart(py, || {
            let seen = scene.seen();
            let place = |(i, pose)| {
                let placed = conventions.given(pose).of_sensor(sensor.spec(), &seen.world_from_gltf);
                placed.map_err(|e: Error| e.at(format!("pose {i}")))
            };
            let poses = given.into_iter().enumerate().map(place).collect::<Result<_>>()?;
            Ok(Self { world: seen.world, sensor, poses })
        })
    }
}

#[pymethods]
impl Predictor {
    #[new]
    #[pyo3(signature = (backend = "auto", threads = 0))]
    fn new(py: Python<'_>, backend: &str, threads: usize) -> PyResult<Self> {
        let backend = match backend {
            "auto" => Backend::Auto,
            "cpu" => Backend::Cpu,
            "gpu" => Backend::Gpu,
            _ => return Err(usage(py, "backend", format!("{backend:?}"), "give \"auto\", \"cpu\" or \"gpu\"")),
        };
        let core = PerProcessPredictor::new(backend, threads);
        let open = || apart(py, || core.with(|predictor, _: &mut Placed| Ok::<_, Failed>(predictor.engine_name())));
        let opened = if backend == Backend::Cpu { open() } else { without_displays(py, open) }?;
        Ok(Self { core, opened })
    }

    /// The engine of this process: "cpu", or "gpu" with its adapter.
    #[getter]
    fn engine(&self, py: Python<'_>) -> PyResult<String> {
        apart(py, || self.with(|predictor| Ok(predictor.engine_name())))
    }

    /// Predicts what a sensor should see at a pose. Arguments are named as the flags of `presight predict`.
    ///
    /// `sensor` is a `Sensor`, or the name of a preset or file. `pose` is world from sensor: (7,) x y z qx qy qz qw (the order of scipy
    /// and of TUM files), (6,) x y z roll pitch yaw in metres and degrees, or (4, 4). With `pose_frame="optical"` its axes are z forward,
    /// x right, y down; with `pose_of="robot"` it is the robot's, and the sensor's mount leads on; with `world_frame="gltf"` it is along
    /// the axes of the scene's file. `outputs` names the images (default: range, polygon_id, object_id, cos_incidence; also depth_z, echo,
    /// normal, feature_id). `layers` are feature layers on top of the scene's own, which `[]` takes alone; their regions of interest hold
    /// the features with `confidence`, where `pose_cov` is the pose's uncertainty: (6,) standard deviations in metres and degrees, or
    /// (6, 6) in metres and radians. `deadline_ms` gives up what does not fit. `twist` is how the robot moves while the sensor measures
    /// its rays: (6,) metres and degrees per second in the robot's axes; `pose` is then the one at the scan's stamp. Instead of it
    /// `pose_end` is the pose when the last ray is measured, or `trajectory` has poses over time, (n, 8) timestamp x y z qx qy qz qw or the
    /// path of a TUM file, on whose clock `stamp` is the scan's; both are in the conventions of `pose`.
    ///
    /// Raises `Error` for invalid arguments, `DeviceError`, `SystemFault`, and `DeadlineError` if nothing fits.
    ///
    /// >>> room = presight.Scene.example()
    /// >>> out = predictor.predict(room, "laser-scanner", [1, 1.5, 0.5, 0, 0, 0], outputs=("range", "object_id"))
    /// >>> room.objects[out.object_id[0, 180] - 1].startswith("room/")
    /// True
    #[pyo3(signature = (scene, sensor, pose, outputs = None, layers = None, pose_cov = None, confidence = 0.99, deadline_ms = None,
        pose_frame = "body", pose_of = "sensor", world_frame = "z-up", twist = None,
        pose_end = None, trajectory = None, stamp = None))]
    #[expect(clippy::too_many_arguments, reason = "the flags of the command")]
    fn predict(
        &self,
        py: Python<'_>,
        scene: &Bound<'_, Scene>,
        sensor: &Bound<'_, PyAny>,
        pose: &Bound<'_, PyAny>,
        outputs: Option<&Bound<'_, PyAny>>,
        layers: Option<&Bound<'_, PyAny>>,
        pose_cov: Option<&Bound<'_, PyAny>>,
        confidence: f64,
        deadline_ms: Option<f64>,
        pose_frame: &str,
        pose_of: &str,
        world_frame: &str,
        twist: Option<&Bound<'_, PyAny>>,
        pose_end: Option<&Bound<'_, PyAny>>,
        trajectory: Option<&Bound<'_, PyAny>>,
        stamp: Option<f64>,
    ) -> PyResult<Prediction> {
        let conventions = Conventions::new(py, pose_frame, pose_of, world_frame)?;
        let (sensor, outputs) = (sensor_of(sensor)?, outputs_of(outputs)?);
        let given = conventions.given(super::arrays::pose_of(pose, "pose")?);
        let layers = match layers {
            None if outputs.has(Output::FeatureId) => Some(Vec::new()),
            None => None,
            Some(layers) => Some(layers_of(layers)?),
        };
        if layers.is_none() && pose_cov.is_some() {
            return Err(usage(py, "pose_cov", "needs features, and none are requested", "give layers="));
        }
        let covariance = covariance_of(pose_cov)?;
        let mut request = in_time(py, Request::of(outputs), deadline_ms)?;
        let motion = GivenMotion::new(py, twist, pose_end, trajectory, stamp)?;
        let scene = scene.get();
        let done = apart(py, move || {
            let seen = scene.seen();
            let pose = given.of_sensor(sensor.spec(), &seen.world_from_gltf)?;
            let robot = |given: &ExternalPose| -> Result<Pose> {
                let sensor_pose = given.of_sensor(sensor.spec(), &seen.world_from_gltf)?;
                Ok(sensor_pose.world_from_sensor() * sensor.spec().mount.inverse())
            };
            request.motion = motion.during(&sensor, &given, conventions, robot)?;
            let Some(layers) = layers else {
                return self.one(&seen, &sensor, &pose, &request).map(|(p, a)| (p, a, None));
            };
            let whole = scene.whole();
            sensor.check_projection()?;
            let covariance = given.covariance_of_sensor(&covariance, sensor.spec(), &pose, &seen.world_from_gltf);
            let placed = self.core.with(|_, kept| place(&whole, &sensor, &layers, kept))?;
            let mut options = FeatureOptions::default().with_placed(placed.placed.clone());
            options.hidden = Hidden::Full;
            let mut boxes = BoxOptions::default().with_confidence(confidence);
            boxes.sensor = covariance;
            let request = request.with_features(options.clone()).with_regions(boxes.clone());
            let (mut prediction, mut about) = self.one(&seen, &sensor, &pose, &request)?;
            if let (Some(features), FeatureSource::Placed(placed)) = (&mut prediction.features, &options.source) {
                features.spell_out(seen.world.environment(), &placed.features);
            }
            let header = files::PredictionHeader {
                pose_covariance: Some(boxes.sensor),
                confidence: Some(boxes.confidence),
                given_up: prediction.degradation().cloned(),
                ..files::PredictionHeader::new(&sensor, pose)
            };
            about.features = Some((seen.world.environment().clone(), header));
            let others = placed.other_classes;
            let class = &sensor.spec().class;
            let ignored = (others > 0).then(|| format!("ignoring {others} features for other classes than {class:?}"));
            Ok((prediction, about, ignored))
        })?;
        let (prediction, about, ignored) = done;
        let incomplete =
            prediction.degradation().map(|g| format!("{}; a longer deadline_ms gives up less", g.summary()));
        warn(py, prediction.stats.notices.iter().chain(&ignored).chain(&incomplete))?;
        Prediction::new(py, prediction, about)
    }

    /// Predicts at many poses, and gives a dict of an array of (poses, rows, columns) for each output; normals have 3 more.
    ///
    /// `poses` is as for `predict`, with one axis in front. `out` is a dict of arrays to fill. The images have the bits of single
    /// predictions. Ctrl-C ends it within half a second. Raises `MemoryError` before arrays that do not fit are begun. `twist` is as for
    /// `predict`, the same at each pose.
    ///
    /// >>> poses = [[x, 1.5, 0.5, 0, 0, 0] for x in (0.9, 1.0, 1.1)]
    /// >>> predictor.predict_many(room, "laser-scanner", poses)["range"].shape
    /// (3, 1, 361)
    #[pyo3(signature = (scene, sensor, poses, outputs = None, out = None, pose_frame = "body", pose_of = "sensor",
        world_frame = "z-up", twist = None))]
    #[expect(clippy::too_many_arguments, reason = "the flags of the command")]
    fn predict_many<'py>(
        &self,
        py: Python<'py>,
        scene: &Bound<'py, Scene>,
        sensor: &Bound<'py, PyAny>,
        poses: &Bound<'py, PyAny>,
        outputs: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyDict>>,
        pose_frame: &str,
        pose_of: &str,
        world_frame: &str,
        twist: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let conventions = Conventions::new(py, pose_frame, pose_of, world_frame)?;
        let outputs = many::outputs(outputs)?;
        let motion = twist.map(twist_motion).transpose()?;
        let Given { world, sensor, poses } = Given::new(scene, sensor, poses, conventions)?;
        Targets::new(py, poses.len(), &sensor, outputs, out)?.fill(py, self, &world, &sensor, poses, motion)
    }

    /// As `predict_many`, in bounded memory: an iterator of dicts for `size` poses each (default: images of 64 MB).
    ///
    /// >>> [part["range"].shape[0] for part in predictor.predict_chunks(room, "laser-scanner", poses, size=2)]
    /// [2, 1]
    #[pyo3(signature = (scene, sensor, poses, outputs = None, size = None, pose_frame = "body", pose_of = "sensor",
        world_frame = "z-up", twist = None))]
    #[expect(clippy::too_many_arguments, reason = "the flags of the command")]
    fn predict_chunks(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        scene: &Bound<'_, Scene>,
        sensor: &Bound<'_, PyAny>,
        poses: &Bound<'_, PyAny>,
        outputs: Option<&Bound<'_, PyAny>>,
        size: Option<usize>,
        pose_frame: &str,
        pose_of: &str,
        world_frame: &str,
        twist: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Chunks> {
        let conventions = Conventions::new(py, pose_frame, pose_of, world_frame)?;
        let outputs = many::outputs(outputs)?;
        if size == Some(0) {
            return Err(usage(py, "size", "0", "give 1 or more"));
        }
        let motion = twist.map(twist_motion).transpose()?;
        let Given { world, sensor, poses } = Given::new(scene, sensor, poses, conventions)?;
        Ok(Chunks::new(slf.clone().unbind(), (world, sensor, motion), outputs, poses, size))
    }

    /// The log-likelihood of measured ranges at each pose: (poses,), float64, or with `headings` at this number of headings of each place:
    /// (poses, headings), float32, where heading k turns the sensor's x axis 360 k / headings degrees to the left.
    ///
    /// `sensed` is a `Frame`, or ranges of (rows, columns) in metres: inf for nothing, -inf for too near, NaN for no reading. Poses are
    /// those at the frame's time; a scan that takes time is compared in its middle. `cell` is
    /// the size of the cell that each pose stands for, in metres and degrees (None: 0, with headings the step between them). The
    /// sensor needs `range_sigma` and a finite `range_max`. Only differences are meaningful.
    ///
    /// >>> scanner = presight.Sensor.load("laser-scanner").replace(range_sigma=0.02)
    /// >>> sensed = predictor.predict(room, scanner, poses[1]).range
    /// >>> int(predictor.likelihood(room, scanner, sensed, poses).argmax())
    /// 1
    #[pyo3(signature = (scene, sensor, sensed, poses, headings = None, cell = (0.0, None), pose_frame = "body", pose_of = "sensor",
        world_frame = "z-up"))]
    #[expect(clippy::too_many_arguments, reason = "the flags of the command")]
    fn likelihood<'py>(
        &self,
        py: Python<'py>,
        scene: &Bound<'py, Scene>,
        sensor: &Bound<'py, PyAny>,
        sensed: &Bound<'py, PyAny>,
        poses: &Bound<'py, PyAny>,
        headings: Option<u32>,
        cell: (f64, Option<f64>),
        pose_frame: &str,
        pose_of: &str,
        world_frame: &str,
    ) -> PyResult<Bound<'py, PyAny>> {
        let conventions = Conventions::new(py, pose_frame, pose_of, world_frame)?;
        if headings.is_some() && pose_of == "robot" {
            let what = "the sensor's position on the robot changes with the heading";
            return Err(usage(py, "headings", what, "give poses of the sensor"));
        }
        let Given { world, sensor, poses } = Given::new(scene, sensor, poses, conventions)?;
        let moving = sensed.cast::<Frame>().ok().map(|frame| frame.get().0.clone());
        let ranges = match &moving {
            Some(frame) => frame.ranges().to_vec(),
            None => numbers::<f32>(sensed, "sensed")?.1,
        };
        let step = headings.map_or(0.0, |n| 360.0 / f64::from(n.max(1)));
        let cell = PoseCell { side: cell.0, turn: cell.1.unwrap_or(step).to_radians() };
        room_for(Some(4 * poses.len() as u64 * u64::from(headings.unwrap_or(2))))?;
        let count = poses.len();
        let (single, by_heading) = apart(py, || {
            let mut frame = OurFrame::new(0.0, sensor, Measurement::Range(ranges)).map_err(|e| e.at("sensed"))?;
            if let Some(motion) = moving.as_ref().and_then(|frame| frame.scan_motion()) {
                frame = frame.with_scan_motion(motion.clone());
            }
            let moment = frame.at_one_moment().map_err(|e| e.at("sensed"))?;
            let (frame, sensor) = (&*moment.frame, moment.frame.sensor().clone());
            let poses: Vec<SensorPose> = poses.iter().map(|pose| moment.sensor(pose)).collect();
            let likelihood = Some(RangeLikelihood::new(frame, cell).map_err(|e| e.at("sensed"))?);
            let headings = headings.map(|count| Headings::new(&sensor, count)).transpose()?;
            let request = BatchRequest { likelihood, headings, ..BatchRequest::default() };
            let (mut single, mut by_heading) = (Vec::new(), Vec::new());
            self.with(|predictor| {
                many::run(predictor.batch(&world, &sensor, poses, &request)?, |item| {
                    single.extend(item.log_likelihood);
                    by_heading.extend(item.headings);
                })
            })?;
            Ok((single, by_heading))
        })?;
        match headings {
            None => super::arrays::array(py, single, &[count]),
            Some(headings) => super::arrays::array(py, by_heading, &[count, headings as usize]),
        }
    }

    /// What each measured pixel says of the model: see `Verdicts`. `pose` is the robot's at the frame's time and `pose_cov` its
    /// uncertainty, as for `predict`; the mount of the frame's sensor leads from the robot to the sensor. A scan that takes time is
    /// compared in its middle.
    ///
    /// >>> frame = presight.Frame(scanner, 0.0, sensed)
    /// >>> verdicts = predictor.verdicts(room, frame, poses[1], pose_cov=[0.001, 0.001, 0.001, 0.05, 0.05, 0.05])
    /// >>> verdicts.counts["nearer"] + verdicts.counts["farther"]
    /// 0
    #[pyo3(signature = (scene, frame, pose, pose_cov = None))]
    fn verdicts(
        &self,
        py: Python<'_>,
        scene: &Bound<'_, Scene>,
        frame: &Bound<'_, Frame>,
        pose: &Bound<'_, PyAny>,
        pose_cov: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Verdicts> {
        let robot = PoseEstimate::new(RobotPose::new(pose_of(pose, "pose")?), covariance_of(pose_cov)?);
        let (scene, frame) = (scene.get(), frame.get());
        apart(py, || {
            let world = scene.seen().world;
            let judge = |predictor: &mut Ours| Ok(presight::verdict::of_frame(predictor, &world, &frame.0, &robot)?);
            self.with(judge).map(Verdicts)
        })
    }

    fn __repr__(&self) -> String {
        let (backend, threads) = self.core.options();
        format!("<presight.Predictor backend={backend:?} threads={threads} on {}>", self.opened)
    }

    /// By its options: another process opens its own engine.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        Ok((py.get_type::<Self>().into_any(), self.core.options().into_pyobject(py)?))
    }
}

impl Predictor {
    /// One prediction with its engine and time.
    fn one(
        &self,
        seen: &Seen,
        sensor: &Sensor,
        pose: &SensorPose,
        request: &Request,
    ) -> Result<(presight::Prediction, About), Failed> {
        self.with(|predictor| {
            let start = Instant::now();
            let prediction = predictor.predict(&seen.world, sensor, pose, request)?;
            let ms = start.elapsed().as_secs_f64() * 1e3;
            let (scene, objects, engine) = (seen.path.clone(), seen.objects, predictor.engine_name());
            Ok((prediction, About { scene, objects, engine, ms, features: None }))
        })
    }
}

/// The images of batches when none are named.
pub const RANGE: Outputs = Outputs::of(&[Output::Range]);
