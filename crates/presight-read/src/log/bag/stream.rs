//! Messages of one sensor as frames, each with the robot's motion and reference at its stamp.

use super::NANO;
use super::choice::Choice;
use super::convert::Converter;
use super::scan_motion::{of_scan, span_ns};
use crate::log::{Observation, Recorded};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, RobotPose};
use presight_model::measured::{Frame, Motion, OdometryNoise, ScanMotion};
use presight_ros::message::{CameraInfo, Header, Message, Odometry, TFMessage};
use presight_ros::{FrameTree, Lookup, Record, clean_frame_id};
use std::collections::VecDeque;

/// Maximum number of frames that wait for a transform at or after their stamp. Recorders interleave topics within a
/// fraction of a second; a robot whose `map` to `odom` comes at 1 Hz makes a scanner of 50 Hz wait for 50 frames.
const MAX_WAITING: usize = 64;

/// Seconds that a stamp may gain on the recorder's clock between two frames: a simulation ten times as fast as the
/// clock gains 10 s only over a gap of 11 s.
const MAX_AHEAD_S: f64 = 10.0;

/// Turns messages into frames in the order of their stamps. Memory does not grow with the number of messages.
pub(super) struct Stream {
    pub choice: Choice,
    pub converter: Converter,
    pub tree: FrameTree,
    pub info: Option<Info>,
    noise: OdometryNoise,
    waiting: VecDeque<Waiting>,
    /// odom_from_base at the last frame.
    before: Option<Pose>,
    last_ns: Option<i64>,
    /// The recorder's time of the last frame.
    last_log_ns: i64,
    /// True if a stamp that jumps ahead is a fault of its frame, as one that falls is.
    pub skips_jumps: bool,
    count: u64,
    without_motion: u64,
    /// True if no message comes any more.
    pub has_ended: bool,
}

/// A frame that waits for its transforms, with its message.
struct Waiting {
    frame: Frame,
    recorded: Recorded,
}

/// The last `CameraInfo`, with its serialization.
pub(super) struct Info {
    pub message: CameraInfo,
    data: Vec<u8>,
}

impl Info {
    pub(super) fn decode(data: Vec<u8>) -> Result<Self> {
        Ok(Self { message: CameraInfo::decode(&data)?, data })
    }
}

impl Stream {
    pub(super) fn new(choice: Choice, converter: Converter, tree: FrameTree, noise: OdometryNoise) -> Self {
        Self {
            choice,
            converter,
            tree,
            info: None,
            noise,
            waiting: VecDeque::new(),
            before: None,
            last_ns: None,
            last_log_ns: 0,
            skips_jumps: false,
            count: 0,
            without_motion: 0,
            has_ended: false,
        }
    }

    /// Enters a message of the chosen topics: a transform into the tree, a measurement among the waiting frames.
    pub(super) fn add(&mut self, record: Record) -> Result<()> {
        let name = &record.topic.name;
        if *name == self.choice.topic {
            return self.add_frame(record);
        }
        if Some(name) == self.choice.camera_info.as_ref() {
            self.info = Some(Info::decode(record.data)?);
        } else if Some(name) == self.choice.odometry_topic.as_ref() {
            self.add_odometry(&record.data)?;
        } else {
            self.add_transforms(&record.data, false)?;
        }
        Ok(())
    }

    /// Enters the transforms of a message.
    pub(super) fn add_transforms(&mut self, data: &[u8], is_static: bool) -> Result<()> {
        for t in TFMessage::decode(data)?.transforms {
            // A static edge stays static if /tf repeats it. The survey has reported bad rotations.
            let (Some(pose), header) = (t.parent_from_child, &t.header) else { continue };
            // Two parents are reported by the survey; the first one counts.
            let _ = self.tree.insert(&header.frame_id, &t.child_frame_id, header.stamp_ns, pose, is_static);
        }
        Ok(())
    }

    /// Enters a message of odometry.
    pub(super) fn add_odometry(&mut self, data: &[u8]) -> Result<()> {
        let odometry = Odometry::decode(data)?;
        let (Some(pose), header) = (odometry.odom_from_child, &odometry.header) else { return Ok(()) };
        self.tree.insert(&header.frame_id, &odometry.child_frame_id, header.stamp_ns, pose, false)
    }

    /// Enters a measurement.
    pub(super) fn add_frame(&mut self, record: Record) -> Result<()> {
        let header = Header::decode(&record.data)?;
        let stamp = if header.stamp_ns == 0 { record.log_time_ns } else { header.stamp_ns };
        if let Some(last) = self.last_ns.filter(|last| stamp <= *last) {
            let what = format!("the stamp {:.6} s is not after {:.6} s", stamp as f64 * NANO, last as f64 * NANO);
            return Err(Error::invalid(what, "record with one clock; cut the bag where the clock jumps"));
        }
        self.check_jump(stamp, record.log_time_ns)?;
        (self.last_ns, self.last_log_ns) = (Some(stamp), record.log_time_ns);
        let info = self.info.as_ref();
        let frame = self.converter.frame(stamp as f64 * NANO, &record.data, info.map(|info| &info.message))?;
        let recorded = Recorded {
            topic: record.topic.name.clone(),
            message_type: record.topic.message_type.clone(),
            data: record.data,
            camera_info: info.zip(self.choice.camera_info.as_ref()).map(|(i, topic)| (topic.clone(), i.data.clone())),
            stamp_ns: stamp,
            frame: clean_frame_id(&header.frame_id).to_owned(),
            base: self.choice.base.clone(),
            odom: None,
        };
        self.waiting.push_back(Waiting { frame, recorded });
        Ok(())
    }

    /// Checks that a stamp is not far ahead of the recorder's clock: every later frame would then be in the past.
    fn check_jump(&self, stamp: i64, log_time: i64) -> Result<()> {
        let Some(last) = self.last_ns.filter(|_| self.skips_jumps) else { return Ok(()) };
        let ahead_s =
            (stamp.saturating_sub(last)).saturating_sub(log_time.saturating_sub(self.last_log_ns)) as f64 * NANO;
        if ahead_s <= MAX_AHEAD_S {
            return Ok(());
        }
        let what = format!("the stamp {:.6} s is {ahead_s:.1} s ahead of the recorder's clock", stamp as f64 * NANO);
        Err(Error::invalid(what, "record with one clock; cut the bag where the clock jumps"))
    }

    /// base in a frame of the world at a stamp. `Err` if a sample at or after it may still come.
    fn base_in(&self, world: &str, stamp: i64) -> Result<Option<Pose>, ()> {
        match self.tree.lookup(world, &self.choice.base, stamp) {
            Lookup::Found(pose) => Ok(Some(pose)),
            Lookup::Later(_) if !self.has_ended && self.waiting.len() < MAX_WAITING => Err(()),
            Lookup::Later(_) | Lookup::Before(_) => Ok(None),
            // The first transform may not have come yet.
            Lookup::Unconnected if !self.has_ended && self.waiting.len() < MAX_WAITING => Err(()),
            Lookup::Unconnected => Ok(None),
        }
    }

    /// The motion during the scan of the first waiting frame by the transforms of the odometry; `None` if its rays take
    /// no time or the motion is unknown. `Err` if a transform at or after its last ray may still come.
    fn scan_motion(&self, stamp: i64) -> Result<Option<ScanMotion>, ()> {
        let sensor = self.waiting.front().map(|w| w.frame.sensor()).filter(|s| !s.spec().times.is_at_once());
        let (Some(sensor), Some(odom)) = (sensor, &self.choice.odom) else { return Ok(None) };
        let interval = sensor.scan_interval();
        self.base_in(odom, span_ns(stamp, interval).1)?;
        let Ok((motion, reaches)) = of_scan(&self.tree, (odom.as_str(), self.choice.base.as_str()), stamp, interval)
        else {
            return Ok(None);
        };
        if !reaches {
            self.converter.add_notice(
                "the odometry does not reach over every scan: the velocity between the two nearest poses is taken",
            );
        }
        Ok(Some(motion))
    }

    /// The first waiting frame, if its transforms have come.
    pub(super) fn ready(&mut self) -> Option<Observation> {
        let stamp = self.waiting.front()?.recorded.stamp_ns;
        let odometry = self.choice.odom.as_ref().map_or(Ok(None), |odom| self.base_in(odom, stamp)).ok()?;
        let reference = if self.choice.has_reference { self.base_in("map", stamp).ok()? } else { None };
        let moved = self.scan_motion(stamp).ok()?;
        let Waiting { mut frame, mut recorded } = self.waiting.pop_front()?;
        let [first, _] = frame.sensor().scan_interval();
        if let Some(motion) = moved {
            frame = frame.with_scan_motion(motion);
        }
        let since = self.before.zip(odometry).map(|(before, now)| before.inverse() * now);
        self.without_motion += u64::from(odometry.is_none());
        self.count += 1;
        frame.motion = since.map(|motion| Motion::of_odometry(motion, &self.noise));
        self.before = odometry;
        self.tree.forget_before(span_ns(stamp, [first, 0.0]).0);
        recorded.odom = self.choice.odom.clone().zip(odometry);
        let recorded = Some(Box::new(recorded));
        Some(Observation { frame, reference: reference.map(RobotPose::new), recorded })
    }

    /// Adds the notice on frames without odometry.
    pub(super) fn report_missing_odometry(&mut self) {
        let without = std::mem::take(&mut self.without_motion);
        if self.choice.odom.is_some() && without > 0 {
            self.converter.add_notice(format!("{without} of {} frames have no odometry at their stamp", self.count));
        }
    }

    /// Takes a frame as the origin of the odometry if there is none yet and transforms lead to it: odometry may begin
    /// after the first scan.
    pub(super) fn find_odometry(&mut self, frame: &str) {
        let is_connected = || self.tree.lookup(frame, &self.choice.base, 0) != Lookup::Unconnected;
        if self.choice.odom.is_none() && is_connected() {
            self.choice.odom = Some(clean_frame_id(frame).to_owned());
        }
    }

    /// True if the stamp of a measurement is not after the last one.
    pub(super) fn is_back(&self, record: &Record) -> Result<bool> {
        let stamp = Header::decode(&record.data)?.stamp_ns;
        Ok(self.last_ns.is_some_and(|last| stamp != 0 && stamp <= last))
    }

    /// Forgets all that has a time: the clock has jumped.
    pub(super) fn forget(&mut self) {
        self.waiting.clear();
        (self.before, self.last_ns) = (None, None);
        self.tree.forget_moving();
    }

    /// The last waiting frame whose transforms have come, with the motion since the frame before that was taken, and
    /// the number of frames between them, which are left out.
    pub(super) fn newest(&mut self) -> Option<(Observation, u64)> {
        let before = self.before;
        let (mut newest, mut left_out) = (None, 0);
        while let Some(observation) = self.ready() {
            left_out += u64::from(newest.replace(observation).is_some());
        }
        let mut newest = newest?;
        let since = before.zip(self.before).map(|(before, now)| before.inverse() * now);
        newest.frame.motion = since.map(|motion| Motion::of_odometry(motion, &self.noise));
        Some((newest, left_out))
    }
}

/// True if a topic of rectified images has another camera than the raw one.
pub(super) fn has_rectified(info: &CameraInfo) -> bool {
    // Uncalibrated drivers leave R at zeros.
    let is_turned = info.r[0] != 0.0 && info.r != [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    info.p[0] != 0.0 && (is_turned || info.d.iter().any(|d| *d != 0.0))
}
