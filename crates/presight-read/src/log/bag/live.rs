//! Messages as they come in a running robot, as frames.

use super::choice::{Choice, Measured};
use super::convert::{Converter, body_mount};
use super::stream::{Info, Stream, has_rectified};
use crate::log::{BagOptions, Observation};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::measured::OdometryNoise;
use presight_model::sensor::Sensor;
use presight_ros::message::{CameraInfo, Header, Message, Odometry, TFMessage};
use presight_ros::{FrameTree, Lookup, Record, clean_frame_id, is_static_topic};
use std::sync::{Arc, Mutex, PoisonError};

/// How long transforms are kept before the first measurement, nanoseconds: a measurement may come behind younger odometry. It is
/// tf2's default.
const KEPT_NS: i64 = 10_000_000_000;

/// Frames of one sensor from messages that come one by one, by the rules for bags. Topics are distinguished by their
/// types: the topic of the options is the measured one, every other message is a transform, an odometry or a
/// `CameraInfo`.
pub struct LiveFrames {
    options: BagOptions,
    sensor: Option<Sensor>,
    noise: OdometryNoise,
    /// The frame of the model, whose transforms are answers.
    map: String,
    /// Transforms before the first measurement, whose frame decides what is needed.
    tree: FrameTree,
    /// The frame of the odometry before the first measurement.
    odom: Option<String>,
    info: Option<Vec<u8>>,
    stream: Option<Stream>,
    notices: Arc<Mutex<Vec<String>>>,
    left_out: u64,
}

impl LiveFrames {
    /// No message yet. `sensor` gives noise and limits, and a mount where no transform does.
    /// Transforms from the frame `map` of the model are left out: a node that publishes them also receives them.
    pub fn new(options: BagOptions, sensor: Option<Sensor>, noise: OdometryNoise, map: &str) -> Self {
        Self {
            options,
            sensor,
            noise,
            map: clean_frame_id(map).to_owned(),
            tree: FrameTree::default(),
            odom: None,
            info: None,
            stream: None,
            notices: Arc::default(),
            left_out: 0,
        }
    }

    /// Takes in a message. A measurement is left out, with a notice, while the sensor's mount is unknown.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for a message that contradicts itself, or has a stamp before the last
    /// one: the clock has jumped, frames and transforms over time are forgotten, and the next message starts a new sequence;
    /// [`presight_model::ErrorKind::Usage`] for a type that presight does not read.
    pub fn add(&mut self, record: Record) -> Result<()> {
        match record.topic.message_type.as_str() {
            TFMessage::TYPE => self.add_transforms(&record.data, is_static_topic(&record.topic)),
            Odometry::TYPE => self.add_odometry(&record.data),
            CameraInfo::TYPE => {
                match &mut self.stream {
                    Some(stream) => stream.info = Some(Info::decode(record.data)?),
                    None => self.info = Some(record.data),
                }
                Ok(())
            }
            _ => {
                if self.stream.is_none() {
                    self.stream = self.begun(&record)?;
                }
                let Some(stream) = &mut self.stream else { return Ok(()) };
                let is_back = stream.is_back(&record)?;
                let added = stream.add_frame(record);
                if is_back {
                    stream.forget();
                }
                added
            }
        }
    }

    fn add_transforms(&mut self, data: &[u8], is_static: bool) -> Result<()> {
        for t in TFMessage::decode(data)?.transforms {
            let (Some(pose), header) = (t.parent_from_child, &t.header) else { continue };
            if clean_frame_id(&header.frame_id) == self.map {
                continue;
            }
            let tree = self.stream.as_mut().map_or(&mut self.tree, |stream| &mut stream.tree);
            let inserted = tree.insert(&header.frame_id, &t.child_frame_id, header.stamp_ns, pose, is_static);
            if let Err(e) = inserted {
                self.add_notice(format!("a transform is left out: {e}"));
                continue;
            }
            if !is_static && self.stream.is_none() {
                self.tree.forget_before(header.stamp_ns - KEPT_NS);
            }
        }
        if let Some(stream) = &mut self.stream {
            stream.find_odometry("odom");
        }
        Ok(())
    }

    fn add_odometry(&mut self, data: &[u8]) -> Result<()> {
        let frame = Header::decode(data)?.frame_id;
        if let Some(stream) = &mut self.stream {
            stream.add_odometry(data)?;
            stream.find_odometry(&frame);
            return Ok(());
        }
        let Odometry { header, child_frame_id, odom_from_child, .. } = Odometry::decode(data)?;
        let Some(pose) = odom_from_child else { return Ok(()) };
        self.tree.insert(&frame, &child_frame_id, header.stamp_ns, pose, false)?;
        self.tree.forget_before(header.stamp_ns - KEPT_NS);
        self.odom = Some(frame);
        Ok(())
    }

    /// The stream of the topic whose first message this is; `None` while its mount is unknown.
    fn begun(&mut self, record: &Record) -> Result<Option<Stream>> {
        let measured = Measured::of_message(&record.topic.message_type, Some(&record.data)).map_err(|why| {
            Error::usage(format!("{} is not a measurement: {why}", record.topic.name), "give the topic of a sensor")
        })?;
        let frame = clean_frame_id(&Header::decode(&record.data)?.frame_id).to_owned();
        let known = ["base_link", "base_footprint"].into_iter().find(|base| self.tree.contains(base));
        let base = self.options.base.clone().unwrap_or_else(|| known.unwrap_or("base_link").to_owned());
        let base_from_frame = match self.tree.lookup(&base, &frame, 0) {
            _ if frame == base => Some(Pose::IDENTITY),
            Lookup::Found(pose) if self.tree.is_rigid(&base, &frame) => Some(pose),
            _ => None,
        };
        let given = self.sensor.as_ref().map(|s| s.spec().mount).filter(|mount| *mount != Pose::IDENTITY);
        let by_frames = base_from_frame.map(|pose| body_mount(pose, measured));
        let Some(mount) = self.options.mount.or(by_frames).or(given) else {
            self.add_notice(format!(
                "{} waits: no static transform leads from \"{base}\" to \"{frame}\"; give `BagOptions::mount`",
                record.topic.name
            ));
            return Ok(None);
        };
        let is_image = !matches!(measured, Measured::Scan | Measured::Points);
        let info = self.info.clone().map(Info::decode).transpose()?;
        if is_image && info.is_none() {
            self.add_notice(format!("{} waits for its CameraInfo", record.topic.name));
            return Ok(None);
        }
        let is_connected =
            |world: &&str| self.tree.contains(world) && self.tree.lookup(world, &base, 0) != Lookup::Unconnected;
        let odom = ["odom"].into_iter().chain(self.odom.as_deref()).find(is_connected);
        let choice = Choice {
            topic: record.topic.name.clone(),
            measured,
            frame,
            camera_info: is_image.then(|| "camera_info".to_owned()),
            odom: odom.map(|odom| clean_frame_id(odom).to_owned()),
            odometry_topic: None,
            has_reference: false,
            base_from_frame,
            base,
        };
        let is_rectified =
            choice.topic.contains("rect") && info.as_ref().is_some_and(|info| has_rectified(&info.message));
        let converter = Converter {
            measured,
            given: self.sensor.clone(),
            mount,
            options: self.options.clone(),
            is_rectified,
            sensor: None,
            period_s: None,
            notices: Arc::clone(&self.notices),
        };
        let mut stream = Stream::new(choice, converter, std::mem::take(&mut self.tree), self.noise);
        stream.info = info;
        Ok(Some(stream))
    }

    fn add_notice(&self, notice: String) {
        let mut notices = self.notices.lock().unwrap_or_else(PoisonError::into_inner);
        if !notices.contains(&notice) {
            notices.push(notice);
        }
    }

    /// The newest measurement whose transforms have come, with the robot's motion since the one that was taken before.
    /// Measurements between them are left out and counted.
    pub fn newest(&mut self) -> Option<Observation> {
        let (observation, left_out) = self.stream.as_mut()?.newest()?;
        self.left_out += left_out;
        Some(observation)
    }

    /// Number of measurements that a newer one replaced.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Notices on parts that were left out since the last call, a line each.
    pub fn take_notices(&mut self) -> Vec<String> {
        std::mem::take(&mut *self.notices.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
