//! The frames of a bag, each with the robot's motion and reference at its stamp.

use super::NANO;
use super::choice::Choice;
use super::convert::{Converter, body_mount};
use super::stream::{Info, Stream, has_rectified};
use crate::log::skip_bad::Placed;
use crate::log::{BagOptions, Observation};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::measured::OdometryNoise;
use presight_model::sensor::Sensor;
use presight_ros::message::{Message, TFMessage};
use presight_ros::{Bag, FrameTree, Messages, Survey, is_static_topic};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// The frames of one topic of a bag. The bag is read forward; memory does not grow with it.
pub struct BagFrames {
    /// The bag, for messages of errors.
    path: PathBuf,
    messages: Messages,
    stream: Stream,
    /// True if the container itself cannot be read on.
    is_cut: bool,
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
        let info = info.map(Info::decode).transpose()?;
        let is_rectified =
            choice.topic.contains("rect") && info.as_ref().is_some_and(|info| has_rectified(&info.message));
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
        let mut stream = Stream::new(choice, converter, tree, noise);
        stream.info = info;
        Ok(Self { path: path.to_owned(), messages, stream, is_cut: false })
    }

    /// The topic, frames and transforms taken from the bag.
    pub fn choice(&self) -> &Choice {
        &self.stream.choice
    }

    /// Notices on parts that were left out so far, a line each. The list grows as frames are read.
    pub fn notices(&self) -> Arc<Mutex<Vec<String>>> {
        Arc::clone(&self.stream.converter.notices)
    }

    /// The frames, also after a bad message; its place is its topic with the time of the recorder.
    pub(in crate::log) fn placed(mut self) -> impl Iterator<Item = Placed> + Send {
        self.stream.skips_jumps = true;
        std::iter::from_fn(move || match self.read().transpose()? {
            Ok(observation) => {
                let stamp = format!("the stamp {:.6} s", observation.frame.stamp);
                Some((Some(stamp), Ok(observation)))
            }
            Err(e) => Some((e.place().filter(|_| !self.is_cut).map(str::to_owned), Err(e))),
        })
    }

    fn read(&mut self) -> Result<Option<Observation>> {
        loop {
            if let Some(observation) = self.stream.ready() {
                return Ok(Some(observation));
            }
            if self.stream.has_ended {
                self.stream.report_missing_odometry();
                return Ok(None);
            }
            match self.messages.next().transpose().inspect_err(|_| self.is_cut = true)? {
                Some(record) => {
                    let (topic, time) = (Arc::clone(&record.topic), record.log_time_ns as f64 * NANO);
                    let place = |e: Error| e.at(format!("{}, recorded at {time:.6} s", topic.name)).in_file(&self.path);
                    self.stream.add(record).map_err(place)?;
                }
                None => self.stream.has_ended = true,
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
