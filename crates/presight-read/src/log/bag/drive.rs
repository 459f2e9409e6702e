//! The frames of a bag, each with the robot's motion and reference at its stamp.

use super::choice::Choice;
use super::convert::{Converter, body_mount};
use super::scan_motion::{of_scan, span_ns};
use crate::log::BagOptions;
use crate::log::Observation;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, RobotPose};
use presight_model::measured::{Frame, Motion, OdometryNoise, ScanMotion};
use presight_model::sensor::Sensor;
use presight_ros::message::{CameraInfo, Message, Odometry, TFMessage};
use presight_ros::{Bag, FrameTree, Lookup, Messages, Record, Survey, is_static_topic};
use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Maximum number of frames that wait for a transform at or after their stamp. Recorders interleave topics within a
/// fraction of a second; a robot whose `map` to `odom` comes at 1 Hz makes a scanner of 50 Hz wait for 50 frames.
const MAX_WAITING: usize = 64;

/// Seconds per nanosecond.
const NANO: f64 = 1e-9;

/// The frames of one topic of a bag. The bag is read forward; memory does not grow with it.
pub struct BagFrames {
    messages: Messages,
    choice: Choice,
    converter: Converter,
    noise: OdometryNoise,
    tree: FrameTree,
    info: Option<CameraInfo>,
    waiting: VecDeque<(i64, Frame)>,
    /// odom_from_base at the last frame.
    before: Option<Pose>,
    last_ns: Option<i64>,
    count: u64,
    without_motion: u64,
    has_ended: bool,
}

impl BagFrames {
    /// Opens a bag as a log. `sensor` gives noise and limits, and a mount where the bag has none; `noise` is the
    /// odometry's.
    ///
    /// # Errors
    /// As [`Bag::open`], [`Survey::of`] and [`Choice::of`]; [`presight_model::ErrorKind::Usage`] if there is no mount.
    pub fn open(path: &Path, options: &BagOptions, sensor: Option<&Sensor>, noise: OdometryNoise) -> Result<Self> {
        let bag = Bag::open(path)?;
        let survey = Survey::of(&bag)?;
        let choice = Choice::of(&survey, options)?;
        let given = sensor.filter(|s| s.spec().mount != Pose::IDENTITY).map(|s| s.spec().mount);
        let by_frames = choice.base_from_frame.map(|pose| body_mount(pose, choice.measured));
        let Some(mount) = options.mount.or(by_frames).or(given) else {
            let what = format!("no static transform leads from \"{}\" to \"{}\"", choice.base, choice.frame);
            return Err(Error::usage(what, "give `BagOptions::mount` or `BagOptions::base`"));
        };
        let topic = survey.topic(&choice.topic).expect("the chosen topic is one of the survey's");
        let info = choice.camera_info.as_ref().and_then(|name| survey.topic(name)?.first.clone());
        let info = info.map(|data| CameraInfo::decode(&data)).transpose()?;
        let is_rectified = choice.topic.contains("rect")
            && info.as_ref().is_some_and(|info| info.d.iter().any(|d| *d != 0.0) && info.p[0] != 0.0);
        let mut notices: Vec<String> =
            survey.losses.iter().map(|loss| format!("{}: {}", loss.file.display(), loss.what)).collect();
        notices.extend(survey.faults.iter().cloned());
        if topic.without_stamp > 0 {
            notices.push(format!("{} messages have the stamp 0: the recorder's time is taken", topic.without_stamp));
        }
        let converter = Converter {
            measured: choice.measured,
            given: sensor.cloned(),
            mount,
            options: options.clone(),
            is_rectified,
            sensor: None,
            period_s: topic.rate_hz().map(f64::recip),
            notices: Arc::new(Mutex::new(notices)),
        };
        let mut tree = FrameTree::default();
        for (child, edge) in survey.tree.edges().filter(|(_, edge)| edge.is_static) {
            tree.insert(&edge.parent, child, 0, edge.last(), true)?;
        }
        let wanted: Vec<String> = [Some(&choice.topic), choice.camera_info.as_ref(), choice.odometry_topic.as_ref()]
            .into_iter()
            .flatten()
            .cloned()
            .collect();
        let messages = bag.messages(move |topic| {
            let is_transform = topic.message_type == TFMessage::TYPE && !is_static_topic(topic);
            topic.encoding == "cdr" && (is_transform || wanted.contains(&topic.name))
        });
        Ok(Self {
            messages,
            choice,
            converter,
            noise,
            tree,
            info,
            waiting: VecDeque::new(),
            before: None,
            last_ns: None,
            count: 0,
            without_motion: 0,
            has_ended: false,
        })
    }

    /// The topic, frames and transforms taken from the bag.
    pub fn choice(&self) -> &Choice {
        &self.choice
    }

    /// Notices on parts that were left out so far, a line each. The list grows as frames are read.
    pub fn notices(&self) -> Arc<Mutex<Vec<String>>> {
        Arc::clone(&self.converter.notices)
    }

    /// Enters a message: a transform into the tree, a measurement among the waiting frames.
    fn add(&mut self, record: &Record) -> Result<()> {
        let name = &record.topic.name;
        if *name == self.choice.topic {
            return self.add_frame(record);
        }
        if Some(name) == self.choice.camera_info.as_ref() {
            self.info = Some(CameraInfo::decode(&record.data)?);
        } else if Some(name) == self.choice.odometry_topic.as_ref() {
            let odometry = Odometry::decode(&record.data)?;
            if let Some(pose) = odometry.odom_from_child {
                let header = &odometry.header;
                self.tree.insert(&header.frame_id, &odometry.child_frame_id, header.stamp_ns, pose, false)?;
            }
        } else {
            for t in TFMessage::decode(&record.data)?.transforms {
                // A static edge stays static if /tf repeats it. The survey has reported bad rotations.
                let (Some(pose), header) = (t.parent_from_child, &t.header) else { continue };
                // Two parents are reported by the survey; the first one counts.
                let _ = self.tree.insert(&header.frame_id, &t.child_frame_id, header.stamp_ns, pose, false);
            }
        }
        Ok(())
    }

    fn add_frame(&mut self, record: &Record) -> Result<()> {
        let stamp = presight_ros::message::Header::read(&mut presight_ros::cdr::Cursor::new(&record.data)?)?.stamp_ns;
        let stamp = if stamp == 0 { record.log_time_ns } else { stamp };
        if let Some(last) = self.last_ns.filter(|last| stamp <= *last) {
            let what = format!("the stamp {:.6} s is not after {:.6} s", stamp as f64 * NANO, last as f64 * NANO);
            return Err(Error::invalid(what, "record with one clock; cut the bag where the clock jumps"));
        }
        self.last_ns = Some(stamp);
        let frame = self.converter.frame(stamp as f64 * NANO, &record.data, self.info.as_ref())?;
        self.waiting.push_back((stamp, frame));
        Ok(())
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

    /// The motion during the scan of the first waiting frame by the transforms of the odometry; `None` if its rays take no time
    /// or the motion is unknown. `Err` if a transform at or after its last ray may still come.
    fn scan_motion(&self, stamp: i64) -> Result<Option<ScanMotion>, ()> {
        let sensor = self.waiting.front().map(|(_, frame)| frame.sensor()).filter(|s| !s.spec().times.is_at_once());
        let (Some(sensor), Some(odom)) = (sensor, &self.choice.odom) else { return Ok(None) };
        let interval = sensor.scan_interval();
        self.base_in(odom, span_ns(stamp, interval).1)?;
        let Ok((motion, reaches)) = of_scan(&self.tree, (odom.as_str(), self.choice.base.as_str()), stamp, interval)
        else {
            return Ok(None);
        };
        if !reaches {
            let what = "the odometry does not reach over every scan: the motion between its two poses nearest to a scan is taken";
            self.converter.add_notice(what);
        }
        Ok(Some(motion))
    }

    /// The first waiting frame, if its transforms have come.
    fn ready(&mut self) -> Option<Observation> {
        let (stamp, _) = self.waiting.front()?;
        let stamp = *stamp;
        let odometry = self.choice.odom.as_ref().map_or(Ok(None), |odom| self.base_in(odom, stamp)).ok()?;
        let reference = if self.choice.has_reference { self.base_in("map", stamp).ok()? } else { None };
        let moved = self.scan_motion(stamp).ok()?;
        let (_, mut frame) = self.waiting.pop_front()?;
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
        Some(Observation { frame, reference: reference.map(RobotPose::new) })
    }

    fn report_missing_odometry(&mut self) {
        let without = std::mem::take(&mut self.without_motion);
        if self.choice.odom.is_some() && without > 0 {
            self.converter.add_notice(format!("{without} of {} frames have no odometry at their stamp", self.count));
        }
    }

    fn read(&mut self) -> Result<Option<Observation>> {
        loop {
            if let Some(observation) = self.ready() {
                return Ok(Some(observation));
            }
            if self.has_ended {
                self.report_missing_odometry();
                return Ok(None);
            }
            match self.messages.next().transpose()? {
                Some(record) => {
                    let place = |e: Error| {
                        e.at(format!("{}, recorded at {:.6} s", record.topic.name, record.log_time_ns as f64 * NANO))
                    };
                    self.add(&record).map_err(place)?;
                }
                None => self.has_ended = true,
            }
        }
    }
}

impl Iterator for BagFrames {
    type Item = Result<Observation>;

    fn next(&mut self) -> Option<Self::Item> {
        self.read().transpose()
    }
}
