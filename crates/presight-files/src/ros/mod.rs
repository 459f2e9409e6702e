//! Messages of ROS 2 from poses, predictions and models: for bags, and for nodes that publish bytes.
//!
//! Frames are those of REP-105: `map`, `odom`, and the robot's base. Images are in the optical frame of their camera
//! (REP-103), scans and points in the body axes of their sensor. Ranges follow REP-117, as presight's images do.

mod model;
mod sensed;
mod verdicts;

pub use model::model;
pub use presight_ros::message::{MarkerKind, SceneMarker};
pub use presight_ros::{BagWriter, Record, Topic};

use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::measured::Frame;
use presight_model::sensor::{Sensor, body_from_optical_rotation};
use presight_read::atomic::{open_to_replace, refused};
use presight_read::log::Recorded;
use presight_ros::clean_frame_id;
use presight_ros::message::{
    DiagnosticArray, DiagnosticStatus, Header, Message, PoseWithCovarianceStamped, TFMessage, TransformStamped,
};
use std::fs::File;
use std::path::Path;

/// The time and the coordinate frames of a measurement, for messages about it.
#[derive(Clone, Debug, PartialEq)]
pub struct MessageOrigin {
    /// Nanoseconds since the epoch of the clock.
    pub stamp_ns: i64,
    /// The frame of the model and of its poses.
    pub map: String,
    /// The frame of the robot.
    pub base: String,
    /// The frame of the sensor's messages: of a camera its optical frame.
    pub sensor: String,
    /// The frame of the odometry with odom_from_base at the stamp, if there is one.
    pub odom: Option<(String, Pose)>,
}

/// Creates a bag, or replaces an existing file. It has the messages so far also if it is dropped.
///
/// # Errors
/// [`presight_model::ErrorKind::System`] naming the file.
pub fn create_bag(path: &Path) -> Result<BagWriter> {
    drop(open_to_replace(path)?);
    BagWriter::new(path, File::create(path).map_err(|e| refused(path, e))?)
}

impl MessageOrigin {
    /// For a sensor without a recording: frames `map`, `base_link` and the sensor's name, of a camera with
    /// `_optical_frame`.
    pub fn of_sensor(stamp_s: f64, sensor: &Sensor) -> Self {
        let name = &sensor.spec().name;
        let frame = if sensor.is_camera() { format!("{name}_optical_frame") } else { name.clone() };
        // A stamp beyond the year 2262 saturates.
        let stamp_ns = (stamp_s * 1e9).round() as i64;
        Self { stamp_ns, map: "map".into(), base: "base_link".into(), sensor: frame, odom: None }
    }

    /// For a frame of a log: time and frames of its message if the log is a bag, otherwise as
    /// [`MessageOrigin::of_sensor`].
    pub fn of_frame(frame: &Frame, recorded: Option<&Recorded>) -> Self {
        let Some(recorded) = recorded else { return Self::of_sensor(frame.stamp, frame.sensor()) };
        Self {
            stamp_ns: recorded.stamp_ns,
            map: "map".into(),
            base: recorded.base.clone(),
            sensor: recorded.frame.clone(),
            odom: recorded.odom.clone(),
        }
    }

    fn header(&self, frame: &str) -> Header {
        Header { stamp_ns: self.stamp_ns, frame_id: frame.to_owned() }
    }

    fn transform(&self, topic: &str, parent: &str, child: &str, pose: Pose) -> Record {
        let transform = TransformStamped {
            header: self.header(parent),
            child_frame_id: child.to_owned(),
            parent_from_child: Some(pose),
        };
        Record::of(topic, self.stamp_ns, &TFMessage { transforms: vec![transform] })
    }

    /// The mount of the sensor as a static transform from the base to the frame of its messages, on `/tf_static`.
    pub fn mount(&self, sensor: &Sensor) -> Record {
        self.transform("/tf_static", &self.base, &self.sensor, base_from_frame(sensor))
    }

    /// The transform of the odometry on `/tf`, if there is one.
    pub fn odometry(&self) -> Option<Record> {
        let (odom, odom_from_base) = self.odom.as_ref()?;
        Some(self.transform("/tf", odom, &self.base, *odom_from_base))
    }

    /// The pose of the robot on `/tf`: the transform from `map` to the frame of the odometry if there is one (REP-105),
    /// otherwise to the base.
    pub fn localization(&self, world_from_robot: &Pose) -> Record {
        match &self.odom {
            Some((odom, odom_from_base)) => {
                self.transform("/tf", &self.map, odom, *world_from_robot * odom_from_base.inverse())
            }
            None => self.transform("/tf", &self.map, &self.base, *world_from_robot),
        }
    }

    /// The pose with its covariance on `/presight/pose`.
    pub fn pose(&self, estimate: &PoseEstimate) -> Record {
        let rows = estimate.covariance.as_rows();
        let message = PoseWithCovarianceStamped {
            header: self.header(&self.map),
            pose: Some(estimate.world_from_robot),
            covariance: std::array::from_fn(|i| rows[i / 6][i % 6]),
        };
        Record::of("/presight/pose", self.stamp_ns, &message)
    }

    /// A state in words with its numbers, on `/diagnostics`. The level is 0 for well, 1 for a warning, 2 for an error.
    pub fn status(&self, level: u8, message: String, values: Vec<(String, String)>) -> Record {
        let status = DiagnosticStatus {
            level,
            name: "presight: localization".into(),
            message,
            hardware_id: self.sensor.clone(),
            values,
        };
        Record::of("/diagnostics", self.stamp_ns, &DiagnosticArray { header: self.header(""), status: vec![status] })
    }
}

/// The measured message of a bag, and the `CameraInfo` of an image, as they were recorded.
pub fn measured(recorded: &Recorded) -> Vec<Record> {
    let record = |(topic, message_type, data): (&String, &String, &Vec<u8>)| Record {
        topic: std::sync::Arc::new(Topic {
            name: topic.clone(),
            message_type: message_type.clone(),
            encoding: "cdr".into(),
        }),
        log_time_ns: recorded.stamp_ns,
        data: data.clone(),
    };
    let info = recorded.camera_info.iter();
    let info_type = "sensor_msgs/msg/CameraInfo".to_owned();
    let info: Vec<Record> = info.map(|(topic, data)| record((topic, &info_type, data))).collect();
    let message = record((&recorded.topic, &recorded.message_type, &recorded.data));
    info.into_iter().chain([message]).collect()
}

/// The pose of a `geometry_msgs/msg/PoseWithCovarianceStamped` in the frame `map`, as RViz sends it on `/initialpose`.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] for a message that is cut, a pose in another frame, an invalid pose, or an
/// invalid covariance.
pub fn initial_pose(message: &[u8], map: &str) -> Result<PoseEstimate> {
    let message = PoseWithCovarianceStamped::decode(message)?;
    let frame = clean_frame_id(&message.header.frame_id);
    if frame != clean_frame_id(map) {
        let what = format!("the pose is in the frame {frame:?}, not in {map:?}");
        return Err(Error::invalid(what, "set the fixed frame of RViz to the frame of the model"));
    }
    let Some(pose) = message.pose else {
        return Err(Error::invalid("the pose is not a pose", "send a unit quaternion and finite metres"));
    };
    Ok(PoseEstimate::new(RobotPose::new(pose), PoseCovariance::from_row_major(&message.covariance)?))
}

/// base_from_frame: the messages of a camera are in its optical frame.
fn base_from_frame(sensor: &Sensor) -> Pose {
    let mount = sensor.spec().mount;
    let body_from_optical = Pose { translation: DVec3::ZERO, rotation: body_from_optical_rotation() };
    if sensor.is_camera() { mount * body_from_optical } else { mount }
}

/// A name for a topic: of letters, digits and underscores, and not a digit in front.
pub fn topic_name(name: &str) -> String {
    let clean: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if clean.starts_with(|c: char| c.is_ascii_alphabetic()) { clean } else { format!("_{clean}") }
}
