//! The frames of a log of any kind, in the form that the estimator needs.

#[cfg(feature = "ros")]
use super::bag::BagFrames;
use super::bag_options::BagOptions;
use super::notices::Notices;
use super::ray_times::TimedSensor;
use super::readings::Readings;
use super::scan_motions::{ScanMotions, Source};
use super::scans::{self, Scans};
use super::skip_bad::{Chain, SkipBad};
use super::{Faults, LogFrame};
use crate::depth_folder::{DepthFolder, pose_at};
use crate::file::file_name;
use crate::tum::StampedPose;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, RobotPose, SensorPose};
use presight_model::measured::{Frame, Motion, OdometryNoise};
use presight_model::plausible::{FramePeriod, Speeds};
use presight_model::sensor::Sensor;
use std::path::Path;

/// A frame with the log's reference pose.
#[derive(Clone, Debug)]
pub struct Observation {
    /// The measured frame.
    pub frame: Frame,
    /// The robot's pose, if the log has it. Estimates must not use it.
    pub reference: Option<RobotPose>,
    /// The message of a ROS 2 bag that holds the measurement.
    pub recorded: Option<Box<Recorded>>,
}

/// The message of a ROS 2 bag that holds a measurement, as it was recorded, and the frames of its time.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// Its topic.
    pub topic: String,
    /// Its type, `sensor_msgs/msg/LaserScan`.
    pub message_type: String,
    /// Its serialization: a header of four bytes, then CDR.
    pub data: Vec<u8>,
    /// Topic and serialization of the `CameraInfo` of an image.
    pub camera_info: Option<(String, Vec<u8>)>,
    /// Nanoseconds since the epoch of the recording's clock.
    pub stamp_ns: i64,
    /// The frame of the measurement.
    pub frame: String,
    /// The frame of the robot.
    pub base: String,
    /// The frame of the odometry with odom_from_base at the stamp, if it is known.
    pub odom: Option<(String, Pose)>,
}

/// The frames of a log, in the order of time. The first error ends them.
///
/// A frame whose rays take time carries the motion of the robot during the scan ([`Frame::scan_motion`]): its own
/// twist, or by odometry between neighbouring frames. For a scan after its stamp that needs the next frame, which is
/// then read ahead.
pub struct Frames {
    sensor: Sensor,
    frames: Items,
    /// The next frame, if it was read ahead.
    ahead: Option<Option<Result<Observation>>>,
    motions: ScanMotions,
    ended: bool,
    readings: Readings,
    period: FramePeriod,
    odometry: Speeds,
    reference: Speeds,
    last_reference: Option<DVec3>,
    /// Notices on parts that were left out, and on the motion of scans.
    notices: Notices,
    has_planar_poses: bool,
}

/// Frames of any kind of log, without the motion during scans.
type Items = Box<dyn Iterator<Item = Result<Observation>> + Send>;

impl Frames {
    /// Opens a log: a folder of depth or grey images ([`crate::depth_folder`]), a scan or a folder of scans
    /// ([`super::scans`]), or a file of ranges ([`super::open`]). `sensor` supplies noise, limits and mount, and must
    /// have the log's image size; scans of points keep their own rays. `noise` is the odometry's.
    ///
    /// # Examples
    /// ```
    /// use presight::files::{LogFrames, range_log_header};
    /// let folder = tempfile::tempdir()?;
    /// let path = folder.path().join("run.jsonl");
    /// let sensor = presight::preset("laser-scanner")?;
    /// let line = r#"{"t": 1, "range": ["inf", null], "odometry": [0.2, 0, 0, 0, 0, 5]}"#;
    /// let line = line.replace("null", &["null"; 360].join(","));
    /// std::fs::write(&path, format!("{}\n{line}\n", range_log_header(sensor.spec())))?;
    /// let frames: Vec<_> = LogFrames::open(&path, None, &Default::default())?.collect::<Result<_, _>>()?;
    /// assert_eq!(frames[0].frame.motion.unwrap().previous_from_current.translation.x, 0.2);
    /// assert!(frames[0].frame.ranges()[1].is_nan() && frames[0].reference.is_none());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`super::open`], [`Scans::open`] and [`DepthFolder::open`]; [`presight_model::ErrorKind::Usage`] for a sensor
    /// with another image size.
    pub fn open(path: &Path, sensor: Option<&Sensor>, noise: &OdometryNoise) -> Result<Self> {
        Self::open_with(path, sensor, noise, &BagOptions::default())
    }

    /// As [`Frames::open`], with the choices that a ROS 2 bag leaves open.
    ///
    /// # Errors
    /// Also those of [`BagFrames::open`]; [`presight_model::ErrorKind::Usage`] for choices where the log is no bag.
    pub fn open_with(path: &Path, sensor: Option<&Sensor>, noise: &OdometryNoise, bag: &BagOptions) -> Result<Self> {
        Self::opened(path, sensor, noise, (bag, Faults::End))
    }

    /// As [`Frames::open_with`], without frames that cannot be read and frames whose time falls. [`Frames::notices`]
    /// counts and names them at the end of the log. If no frame is left, the first fault is the last item.
    ///
    /// If the times of two neighbours fall, the second one is left out where the third is after both, and the first one
    /// otherwise. In a bag it is always the second one.
    ///
    /// # Errors
    /// As [`Frames::open_with`], for a log without a readable header and for a folder without a readable camera.
    pub fn open_skipping_bad(
        path: &Path,
        sensor: Option<&Sensor>,
        noise: &OdometryNoise,
        bag: &BagOptions,
    ) -> Result<Self> {
        Self::opened(path, sensor, noise, (bag, Faults::Pass))
    }

    fn opened(
        path: &Path,
        sensor: Option<&Sensor>,
        noise: &OdometryNoise,
        (bag, faults): (&BagOptions, Faults),
    ) -> Result<Self> {
        if is_bag(path) {
            return Self::of_bag(path, sensor, *noise, (bag, faults)).map_err(|e| e.in_file(path));
        }
        if !bag.is_default() {
            let what = "topic, base, mount and reflector are for ROS 2 bags, and the log is none";
            return Err(Error::usage(what, "leave them out; a sensor file has a mount").in_file(path));
        }
        let opened = match path.is_dir() {
            true if ["camera.json", "depth", "grey"].iter().any(|name| path.join(name).exists()) => {
                Self::of_folder(path, sensor, *noise, faults)
            }
            false if !scans::is_scan(path) => Self::of_file(path, sensor, *noise, faults),
            _ => Self::of_scans(path, sensor, *noise, faults),
        };
        opened.map_err(|e| e.in_file(path))
    }

    #[cfg(feature = "ros")]
    fn of_bag(
        path: &Path,
        sensor: Option<&Sensor>,
        noise: OdometryNoise,
        (bag, faults): (&BagOptions, Faults),
    ) -> Result<Self> {
        let frames = BagFrames::open(path, bag, sensor, noise)?;
        let notices = Notices::from(frames.notices());
        let mut frames: Items = match faults {
            Faults::End => Box::new(frames),
            Faults::Pass => Box::new(SkipBad::new(frames.placed(), Chain::Stamps, noise, notices.clone())),
        };
        let Some(first) = frames.next().transpose()? else {
            return Err(Error::invalid("the topic has no messages", "choose another by `BagOptions::topic`"));
        };
        let sensor = first.frame.sensor().clone();
        let frames = std::iter::once(Ok(first)).chain(frames);
        let mut frames = Self::new(sensor, frames, "NaN", notices);
        frames.motions.own_is_odometry = true;
        Ok(frames)
    }

    #[cfg(not(feature = "ros"))]
    fn of_bag(_: &Path, _: Option<&Sensor>, _: OdometryNoise, _: (&BagOptions, Faults)) -> Result<Self> {
        Err(crate::not_built("ROS 2 bags", "ros"))
    }

    fn of_scans(path: &Path, sensor: Option<&Sensor>, noise: OdometryNoise, faults: Faults) -> Result<Self> {
        let scans = Scans::open(path, sensor)?;
        let notices = scans.notices();
        let mut scans: Items = match faults {
            Faults::End => Box::new(scans),
            Faults::Pass => Box::new(SkipBad::new(scans.placed(), Chain::Stamps, noise, notices.clone())),
        };
        // Each scan has its own sensor; the first one represents them.
        let Some(first) = scans.next().transpose()? else {
            return Err(Error::invalid("there is no scan", "give PLY, PCD, CSV or EXR files"));
        };
        let sensor = first.frame.sensor().clone();
        Ok(Self::new(sensor, std::iter::once(Ok(first)).chain(scans), "NaN or a cell without a point", notices))
    }

    fn of_folder(path: &Path, sensor: Option<&Sensor>, noise: OdometryNoise, faults: Faults) -> Result<Self> {
        let notices = Notices::default();
        let mut log = match faults {
            Faults::End => DepthFolder::open(path, sensor)?,
            Faults::Pass => {
                let (log, left_out) = DepthFolder::open_skipping_bad(path, sensor)?;
                left_out.into_iter().for_each(|notice| notices.add(notice));
                log
            }
        };
        let sensor = log.sensor().clone();
        let (known, camera) = (log.reference().to_vec(), sensor.clone());
        let at = move |stamp: f64| {
            let there = known.iter().find(|s| (s.time - stamp).abs() < 1e-6)?;
            Some(SensorPose::new(there.pose).robot(&camera))
        };
        let odometry = log.odometry().to_vec();
        let mut before = None;
        let mut observed = move |frame: Result<Frame>| {
            let mut frame = frame?;
            let now = pose_at(&odometry, frame.stamp);
            let since = before.zip(now).map(|(before, now): (Pose, Pose)| before.inverse() * now);
            frame.motion = since.map(|motion| Motion::of_odometry(motion, &noise));
            before = now;
            Ok(Observation { reference: at(frame.stamp), frame, recorded: None })
        };
        if faults == Faults::End {
            return Ok(Self::new(sensor, log.map(observed), "65535", notices));
        }
        let placed = std::iter::from_fn(move || {
            let place = log.next_image().map(file_name)?;
            log.next().map(|frame| (Some(place), observed(frame)))
        });
        let frames = SkipBad::new(placed, Chain::Stamps, noise, notices.clone());
        Ok(Self::new(sensor, frames, "65535", notices))
    }

    fn of_file(path: &Path, sensor: Option<&Sensor>, noise: OdometryNoise, faults: Faults) -> Result<Self> {
        let mut log = super::open_with(path, faults)?;
        let has_planar_poses = log.has_planar_poses();
        let own = log.sensor();
        let sensor = sensor.unwrap_or(own).clone();
        if (sensor.width(), sensor.height()) != (own.width(), own.height()) {
            let what = format!(
                "the sensor has {} x {} pixels, but the log has {} x {}",
                sensor.width(),
                sensor.height(),
                own.width(),
                own.height()
            );
            return Err(Error::usage(what, "give the sensor that measured"));
        }
        let (file, mut used) = (path.to_owned(), TimedSensor::new(sensor.clone()));
        let mut observed = move |index: usize, frame: Result<LogFrame>| {
            let frame = frame?;
            let reference = frame.reference;
            let timed = used.with(frame.times.as_deref());
            let frame = timed.and_then(|sensor| frame.into_frame_of(sensor, &noise));
            let frame = frame.map_err(|e| e.at(format!("frame {index}")).in_file(&file))?;
            Ok(Observation { frame, reference, recorded: None })
        };
        let notices = Notices::default();
        let mut index = 0..;
        let placed = std::iter::from_fn(move || {
            let frame = log.next()?;
            Some((log.place(), observed(index.next()?, frame)))
        });
        let frames: Items = match faults {
            Faults::End => Box::new(placed.map(|(_, item)| item)),
            Faults::Pass => Box::new(SkipBad::new(placed, Chain::Frames, noise, notices.clone())),
        };
        Ok(Self { has_planar_poses, ..Self::new(sensor, frames, "null or NaN", notices) })
    }

    fn new(
        sensor: Sensor,
        frames: impl Iterator<Item = Result<Observation>> + Send + 'static,
        missing_as: &'static str,
        notices: Notices,
    ) -> Self {
        let readings = Readings::new(missing_as);
        Self {
            sensor,
            frames: Box::new(frames),
            ahead: None,
            motions: ScanMotions::new(notices.clone()),
            ended: false,
            readings,
            period: FramePeriod::default(),
            odometry: Speeds::default(),
            reference: Speeds::default(),
            last_reference: None,
            notices,
            has_planar_poses: false,
        }
    }

    /// Takes the motion of scans from the log's reference poses, which are preferred to odometry: for work that takes
    /// the reference as the pose of the robot. Estimates must not use it.
    #[must_use]
    pub fn moving_by_reference(mut self) -> Self {
        self.motions.source = Source::Reference;
        self
    }

    /// Takes the motion of scans from a trajectory of the robot, which is preferred to odometry: for work that takes it
    /// as the pose of the robot.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if its times do not ascend.
    pub fn moving_along(mut self, trajectory: &[StampedPose]) -> Result<Self> {
        if let Some(pair) = trajectory.windows(2).find(|pair| !(pair[1].time > pair[0].time)) {
            let what = format!("a trajectory goes back from {} s to {} s", pair[0].time, pair[1].time);
            return Err(Error::invalid(what, "sort its poses by time, each once"));
        }
        self.motions.source = Source::Trajectory(trajectory.iter().map(|p| (p.time, p.pose)).collect());
        Ok(self)
    }

    /// The next frame, which may have been read ahead.
    fn taken(&mut self) -> Option<Result<Observation>> {
        self.ahead.take().unwrap_or_else(|| self.frames.next())
    }

    /// True if the log's poses are x, y and yaw only, as in documents of planar scans: their height is 0 whatever the
    /// height of the floor.
    pub fn has_planar_poses(&self) -> bool {
        self.has_planar_poses
    }

    /// Notices on parts that were left out so far, one that counts the readings by their meaning, unless every reading
    /// is a distance, and others on readings at exactly the maximum range, on times that cannot be seconds and on
    /// positions that cannot be metres.
    pub fn notices(&self) -> Vec<String> {
        let mut notices = self.notices.all();
        notices.extend(self.readings.notice());
        notices.extend(self.readings.notice_at_reach());
        notices.extend(self.period.notice());
        notices.extend(self.odometry.notice("the odometry"));
        notices.extend(self.reference.notice("the reference"));
        notices
    }

    /// The sensor of the first frame. Each scan of points has its own sensor.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }
}

impl Iterator for Frames {
    type Item = Result<Observation>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let now = match self.taken() {
            Some(Ok(now)) => now,
            end => {
                self.ended = true;
                return end;
            }
        };
        if self.motions.needs_next(&now) {
            self.ahead = Some(self.frames.next());
        }
        let ahead = self.ahead.as_ref().and_then(|ahead| ahead.as_ref()?.as_ref().ok());
        let now = self.motions.moved(now, ahead);
        self.readings.add(&now.frame);
        self.period.add(now.frame.stamp);
        let driven = now.frame.motion.map(|motion| motion.previous_from_current.translation.length());
        self.odometry.add(now.frame.stamp, driven);
        let here = now.reference.map(|robot| robot.world_from_robot().translation);
        self.reference.add(now.frame.stamp, here.zip(self.last_reference).map(|(a, b)| a.distance(b)));
        self.last_reference = here;
        Some(Ok(now))
    }
}

#[cfg(feature = "ros")]
fn is_bag(path: &Path) -> bool {
    presight_ros::Bag::is_bag(path)
}

/// By the name alone: this build reads no bags.
#[cfg(not(feature = "ros"))]
fn is_bag(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "mcap" || e == "db3") || path.join("metadata.yaml").is_file()
}
