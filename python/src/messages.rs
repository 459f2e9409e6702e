//! ROS 2 messages as bytes: received messages become frames, and answers become messages to publish.

use super::arrays::{array, pose_numbers, pose_of};
use super::errors::{Failed, apart, usage, warn};
use super::learner::Learner;
use super::measured::{Frame, Step};
use super::prediction::Prediction;
use super::predictor::Predictor;
use super::scene::Scene;
use super::sensor::sensor_of;
use presight::Error;
use presight::files::BagOptions;
use presight::measured::OdometryNoise;
use presight::ros::{LiveFrames, MessageOrigin, Record, Topic, answers, comparison, findings, initial_pose, model};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

/// Messages of ROS 2 as bytes, without ROS: for nodes that subscribe with `raw=True` and publish bytes.
///
/// Messages go in by `add`; `frame` is the newest measurement, with the robot's motion by `/tf` since the frame before. `answers`,
/// `comparison` and `model` give lists of (topic, type, latched, bytes), and `laser_scan`, `point_cloud2` and `image` one message of a
/// prediction, at the time and in the frames of the last measurement. `base` is the robot's frame (by default `base_link`, else
/// `base_footprint`); `sensor` gives noise and limits; `mount` is the sensor's pose on the robot where no static transform gives it;
/// `reflector` is the intensity of a full reflector; `map` is the frame of the model.
///
/// >>> import presight
/// >>> messages = presight.Messages(mount=[0, 0, 0.3, 0, 0, 0])
/// >>> messages.frame() is None, messages.left_out
/// (True, 0)
#[pyclass(frozen, module = "presight")]
pub struct Messages {
    map: String,
    state: Mutex<State>,
}

struct State {
    live: LiveFrames,
    /// The value for the last frame.
    origin: Option<MessageOrigin>,
}

/// Topic, type, whether it is latched, and bytes.
type Sent<'py> = (String, String, bool, Bound<'py, PyBytes>);

fn sent<'py>(py: Python<'py>, records: Vec<Record>) -> Vec<Sent<'py>> {
    let one = |record: Record| {
        let topic = &record.topic;
        (topic.name.clone(), topic.message_type.clone(), topic.is_latched(), PyBytes::new(py, &record.data))
    };
    records.into_iter().map(one).collect()
}

impl Messages {
    fn with<R>(&self, work: impl FnOnce(&mut State) -> R) -> R {
        work(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn origin(&self) -> Result<MessageOrigin, Error> {
        let none = || Error::usage("there is no measurement yet", "call frame() until it gives one");
        self.with(|state| state.origin.clone()).ok_or_else(none)
    }

    /// The bytes of the first message of a prediction with this type.
    fn of_prediction<'py>(
        &self,
        py: Python<'py>,
        out: &Bound<'_, Prediction>,
        message_type: &str,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let prediction = out.get().whole(py, |_| true)?;
        let found = apart(py, || {
            let sensor = &prediction.sensor;
            let origin = self.origin().unwrap_or_else(|_| MessageOrigin::of_sensor(0.0, sensor));
            let records = origin.prediction(sensor, &prediction.images, prediction.images.outputs())?;
            Ok::<_, Failed>(records.into_iter().find(|record| record.topic.message_type == message_type))
        })?;
        match found {
            Some(record) => Ok(PyBytes::new(py, &record.data)),
            None => {
                let what = format!("sensor {:?} gives no {message_type}", prediction.sensor.spec().name);
                Err(usage(py, "out", what, "give the prediction of another sensor"))
            }
        }
    }
}

#[pymethods]
impl Messages {
    #[new]
    #[pyo3(signature = (map = "map", base = None, sensor = None, mount = None, reflector = None))]
    fn new(
        map: &str,
        base: Option<String>,
        sensor: Option<&Bound<'_, PyAny>>,
        mount: Option<&Bound<'_, PyAny>>,
        reflector: Option<f32>,
    ) -> PyResult<Self> {
        let sensor = sensor.map(sensor_of).transpose()?;
        let mount = mount.map(|given| pose_of(given, "mount")).transpose()?;
        let options = BagOptions::default().with_base(base).with_mount(mount).with_reflector(reflector);
        let live = LiveFrames::new(options, sensor, OdometryNoise::default(), map);
        Ok(Self { map: map.to_owned(), state: Mutex::new(State { live, origin: None }) })
    }

    /// Takes in a message: `tf2_msgs/msg/TFMessage`, `nav_msgs/msg/Odometry`, `sensor_msgs/msg/CameraInfo`, or a measurement. What is
    /// left out is a warning. Raises `Error` for a message that contradicts itself or goes back in time.
    fn add(&self, py: Python<'_>, topic: &str, message_type: &str, data: &[u8]) -> PyResult<()> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as i64);
        let topic = Topic { name: topic.to_owned(), message_type: message_type.to_owned(), encoding: "cdr".to_owned() };
        let record = Record { topic: Arc::new(topic), log_time_ns: now, data: data.to_vec() };
        let notices = apart(py, || {
            let name = record.topic.name.clone();
            let added = |state: &mut State| state.live.add(record).map(|()| state.live.take_notices());
            Ok(self.with(added).map_err(|e| e.in_file(Path::new(&name)))?)
        })?;
        warn(py, &notices)
    }

    /// The newest measurement whose transforms have come, or None. Earlier ones are left out and counted.
    fn frame(&self, py: Python<'_>) -> PyResult<Option<Frame>> {
        apart(py, || {
            let frame = self.with(|state| {
                let observation = state.live.newest()?;
                let mut origin = MessageOrigin::of_frame(&observation.frame, observation.recorded.as_deref());
                origin.map.clone_from(&self.map);
                state.origin = Some(origin);
                Some(Frame(observation.frame))
            });
            Ok(frame)
        })
    }

    /// Number of measurements that were left out because a newer one came.
    #[getter]
    fn left_out(&self) -> u64 {
        self.with(|state| state.live.left_out())
    }

    /// What `presight localize --mcap` writes of a step. `ahead` seconds are added to the stamp of the transform, as AMCL does.
    #[pyo3(signature = (step, ahead = 0.0))]
    fn answers<'py>(&self, py: Python<'py>, step: &Bound<'_, Step>, ahead: f64) -> PyResult<Vec<Sent<'py>>> {
        let step = &step.get().0;
        let records = apart(py, || {
            let origin = self.origin()?;
            let later = MessageOrigin { stamp_ns: origin.stamp_ns + (ahead * 1e9).round() as i64, ..origin.clone() };
            let mut records = answers(step, &origin);
            for record in records.iter_mut().filter(|record| record.topic.name == "/tf") {
                *record = later.localization(&step.pose.world_from_robot);
            }
            Ok(records)
        })?;
        Ok(sent(py, records))
    }

    /// What `presight replay --mcap` writes of a frame at the pose of a step: the prediction and the verdicts; empty while the pose is
    /// not known.
    fn comparison<'py>(
        &self,
        py: Python<'py>,
        predictor: &Bound<'_, Predictor>,
        scene: &Bound<'_, Scene>,
        frame: &Bound<'_, Frame>,
        step: &Bound<'_, Step>,
    ) -> PyResult<Vec<Sent<'py>>> {
        let (predictor, scene, frame, step) = (predictor.get(), scene.get(), &frame.get().0, &step.get().0);
        let records = apart(py, || {
            let Some(verdicts) = step.estimate.verdicts.first().filter(|_| step.is_known()) else { return Ok(vec![]) };
            let (origin, world, moving) = (self.origin()?, scene.seen().world, step.moving(frame));
            let (compared, robot) = ((&*moving, verdicts), &step.estimate.pose);
            predictor.with(|predictor| Ok(comparison(predictor, &world, compared, robot, &origin)?))
        })?;
        Ok(sent(py, records))
    }

    /// The model as markers.
    fn model<'py>(&self, py: Python<'py>, scene: &Bound<'_, Scene>) -> PyResult<Vec<Sent<'py>>> {
        let scene = scene.get();
        let record = apart(py, || Ok(model(scene.seen().world.environment(), &self.map, 0)?))?;
        Ok(sent(py, vec![record]))
    }

    /// What a learner found so far, as markers.
    fn findings<'py>(&self, py: Python<'py>, learner: &Bound<'_, Learner>) -> PyResult<Vec<Sent<'py>>> {
        let learner = learner.get();
        let record = apart(py, || {
            let (found, environment) = learner.found()?;
            Ok(findings(&found, environment, &self.origin()?))
        })?;
        Ok(sent(py, vec![record]))
    }

    /// The pose and the covariance of a `geometry_msgs/msg/PoseWithCovarianceStamped`: (7,) and (6, 6). Raises `Error` for a pose in
    /// another frame than `map`.
    fn initial_pose<'py>(&self, py: Python<'py>, data: &[u8]) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let data = data.to_vec();
        let estimate = apart(py, || Ok(initial_pose(&data, &self.map)?))?;
        let covariance = estimate.covariance.as_rows().as_flattened().to_vec();
        Ok((array(py, pose_numbers(&estimate.world_from_robot).to_vec(), &[7])?, array(py, covariance, &[6, 6])?))
    }

    /// A prediction of a level scanner of one row as `sensor_msgs/msg/LaserScan`.
    fn laser_scan<'py>(&self, py: Python<'py>, out: &Bound<'_, Prediction>) -> PyResult<Bound<'py, PyBytes>> {
        self.of_prediction(py, out, "sensor_msgs/msg/LaserScan")
    }

    /// A prediction of a scanner as organized `sensor_msgs/msg/PointCloud2`, with a field for each image.
    fn point_cloud2<'py>(&self, py: Python<'py>, out: &Bound<'_, Prediction>) -> PyResult<Bound<'py, PyBytes>> {
        self.of_prediction(py, out, "sensor_msgs/msg/PointCloud2")
    }

    /// The depth of a camera as `sensor_msgs/msg/Image` of `32FC1`.
    fn image<'py>(&self, py: Python<'py>, out: &Bound<'_, Prediction>) -> PyResult<Bound<'py, PyBytes>> {
        self.of_prediction(py, out, "sensor_msgs/msg/Image")
    }

    fn __repr__(&self) -> String {
        format!("<presight.Messages in {:?}>", self.map)
    }
}
