//! The choice of topic, base, mount, odometry and reference from a survey of a bag.

use crate::log::BagOptions;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_ros::message::{CompressedImage, Image, LaserScan, Message, Odometry, PointCloud2};
use presight_ros::{Lookup, Survey, TopicSurvey};

/// The kind of measurement in a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measured {
    /// A planar scan.
    Scan,
    /// Points, organized or not.
    Points,
    /// A depth image.
    Depth,
    /// A depth image in PNG behind 12 bytes of its own.
    CompressedDepth,
    /// A grey image.
    Grey,
}

impl Measured {
    /// The measurement in a topic; the error says why presight does not read it.
    fn of(topic: &TopicSurvey) -> Result<Self, String> {
        Self::of_message(&topic.topic.message_type, topic.first.as_deref())
    }

    /// The measurement in messages of a type, of which the first is known.
    pub(super) fn of_message(message_type: &str, first: Option<&[u8]>) -> Result<Self, String> {
        match message_type {
            LaserScan::TYPE => Ok(Self::Scan),
            PointCloud2::TYPE => Ok(Self::Points),
            Image::TYPE => match first.map(Image::decode) {
                Some(Ok(image)) => match image.encoding.as_str() {
                    "32FC1" | "16UC1" => Ok(Self::Depth),
                    "mono8" | "8UC1" | "mono16" => Ok(Self::Grey),
                    other => Err(format!("its encoding is {other}, not 32FC1, 16UC1, mono8 or mono16")),
                },
                Some(Err(e)) => Err(e.to_string()),
                None => Err("it has no message".into()),
            },
            CompressedImage::TYPE => match first.map(CompressedImage::decode) {
                Some(Ok(image)) if image.format.contains("compressedDepth") => Ok(Self::CompressedDepth),
                Some(Ok(image)) => Err(format!("its format is {}, not compressedDepth", image.format)),
                Some(Err(e)) => Err(e.to_string()),
                None => Err("it has no message".into()),
            },
            other => Err(format!("presight does not measure with {other}")),
        }
    }
}

/// The topic, frames and transforms that presight takes from a bag.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// The measured topic.
    pub topic: String,
    /// Its kind.
    pub measured: Measured,
    /// The frame of its messages.
    pub frame: String,
    /// The topic of its `CameraInfo`, for images.
    pub camera_info: Option<String>,
    /// The frame of the robot.
    pub base: String,
    /// base_from_frame; `None` if no static transforms connect them.
    pub base_from_frame: Option<Pose>,
    /// The frame of the odometry, if the bag has one.
    pub odom: Option<String>,
    /// The topic of `Odometry` that gives it, unless it comes from transforms.
    pub odometry_topic: Option<String>,
    /// True if the transforms give the robot's pose in `map`.
    pub has_reference: bool,
}

/// One line for each measured topic, for an error that lists them.
fn listed(topics: &[(&TopicSurvey, Measured)]) -> String {
    let line = |(t, _): &(&TopicSurvey, Measured)| {
        let rate = t.rate_hz().map_or(String::new(), |hz| format!(", {hz:.1} Hz"));
        format!("{} ({}, frame {}, {} messages{rate})", t.topic.name, t.topic.message_type, t.frame, t.count)
    };
    topics.iter().map(line).collect::<Vec<_>>().join("; ")
}

/// The measured topics of a bag that presight reads, by name.
pub fn measured_topics(survey: &Survey) -> Vec<(&TopicSurvey, Measured)> {
    let is_cdr = |t: &&TopicSurvey| t.topic.encoding == "cdr" && t.count > 0;
    survey.topics.iter().filter(is_cdr).filter_map(|t| Some((t, Measured::of(t).ok()?))).collect()
}

impl Choice {
    /// Chooses from a bag.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] if a chosen topic or frame is not in the bag, or several topics could be
    /// meant;
    /// [`presight_model::ErrorKind::Unsupported`] for a serialization other than CDR;
    /// [`presight_model::ErrorKind::Invalid`] if there is no measurement, or an image has no `CameraInfo`.
    pub fn of(survey: &Survey, options: &BagOptions) -> Result<Self> {
        let (topic, measured) = chosen_topic(survey, options.topic.as_deref())?;
        let frame = topic.frame.clone();
        let base = chosen_base(survey, options.base.as_deref())?;
        let base_from_frame = match survey.tree.lookup(&base, &frame, 0) {
            _ if frame == base => Some(Pose::IDENTITY),
            Lookup::Found(pose) if survey.tree.is_rigid(&base, &frame) => Some(pose),
            _ => None,
        };
        let camera_info = match measured {
            Measured::Scan | Measured::Points => None,
            _ => Some(camera_info_of(survey, topic)?),
        };
        let (odom, odometry_topic) = odometry_of(survey, &base);
        let is_connected =
            |frame: &str| survey.tree.contains(frame) && survey.tree.lookup(frame, &base, 0) != Lookup::Unconnected;
        let odom = odom.or_else(|| is_connected("odom").then(|| "odom".to_owned()));
        let has_reference = is_connected("map");
        let topic = topic.topic.name.clone();
        Ok(Self { topic, measured, frame, camera_info, base, base_from_frame, odom, odometry_topic, has_reference })
    }
}

fn chosen_topic<'a>(survey: &'a Survey, name: Option<&str>) -> Result<(&'a TopicSurvey, Measured)> {
    let usable = measured_topics(survey);
    if let Some(name) = name {
        let Some(topic) = survey.topic(name) else {
            let remedy = format!("measured topics: {}", listed(&usable));
            return Err(Error::usage(format!("the bag has no topic {name}"), remedy));
        };
        let encoding = &topic.topic.encoding;
        if encoding != "cdr" {
            return Err(Error::new(
                presight_model::ErrorKind::Unsupported,
                format!("the serialization format of {name} is {encoding:?}"),
                "record it with serialization format cdr",
            ));
        }
        let measured = Measured::of(topic).map_err(|why| {
            Error::usage(format!("{name} is not a measurement: {why}"), format!("measured topics: {}", listed(&usable)))
        })?;
        return Ok((topic, measured));
    }
    match usable.as_slice() {
        [only] => Ok(*only),
        [] => {
            let odd = survey.topics.iter().find(|t| t.topic.encoding != "cdr");
            if let Some(odd) = odd {
                return Err(Error::new(
                    presight_model::ErrorKind::Unsupported,
                    format!("the serialization format of {} is {:?}", odd.topic.name, odd.topic.encoding),
                    "record it with serialization format cdr",
                ));
            }
            let types = [LaserScan::TYPE, PointCloud2::TYPE, Image::TYPE, CompressedImage::TYPE];
            let is_unread = |t: &&TopicSurvey| types.contains(&t.topic.message_type.as_str()) && t.count == 0;
            if let Some(unread) = survey.topics.iter().find(is_unread) {
                let what = format!("the bag has no whole message of {}", unread.topic.name);
                return Err(Error::invalid(what, "record it again; these are empty, cut, or of another type"));
            }
            let remedy = "record a LaserScan, a PointCloud2, or depth or grey images with their CameraInfo";
            Err(Error::invalid("the bag has no measurement", remedy))
        }
        several => Err(Error::usage(
            "the bag has several measured topics",
            format!("choose one by `BagOptions::topic`: {}", listed(several)),
        )),
    }
}

fn chosen_base(survey: &Survey, base: Option<&str>) -> Result<String> {
    if let Some(base) = base {
        if survey.edges.is_empty() || survey.tree.contains(base) {
            return Ok(presight_ros::clean_frame_id(base).to_owned());
        }
        let mut frames: Vec<&str> = survey.edges.keys().flat_map(|(p, c)| [p.as_str(), c.as_str()]).collect();
        frames.sort_unstable();
        frames.dedup();
        return Err(Error::usage(
            format!("no transform has the frame {base:?}"),
            format!("frames: {}", frames.join(", ")),
        ));
    }
    let known = ["base_link", "base_footprint"].into_iter().find(|frame| survey.tree.contains(frame));
    Ok(known.unwrap_or("base_link").to_owned())
}

/// The `CameraInfo` of an image topic: the one in its namespace, otherwise the only one with its frame.
fn camera_info_of(survey: &Survey, image: &TopicSurvey) -> Result<String> {
    let name = image.topic.name.as_str();
    let name = name.strip_suffix("/compressedDepth").unwrap_or(name);
    let beside = name.rsplit_once('/').map(|(namespace, _)| format!("{namespace}/camera_info"));
    let infos = survey.topics.iter().filter(|t| t.topic.message_type.ends_with("/CameraInfo") && t.count > 0);
    let infos: Vec<&TopicSurvey> = infos.collect();
    let in_namespace = infos.iter().find(|t| Some(&t.topic.name) == beside.as_ref());
    let of_frame: Vec<_> = infos.iter().filter(|t| t.frame == image.frame).collect();
    match (in_namespace, of_frame.as_slice()) {
        (Some(info), _) => Ok(info.topic.name.clone()),
        (None, [info]) => Ok(info.topic.name.clone()),
        _ => {
            let remedy = format!("record {} too", beside.unwrap_or_else(|| "its CameraInfo".into()));
            Err(Error::invalid(format!("the images of {} have no CameraInfo", image.topic.name), remedy))
        }
    }
}

/// The frame and topic of the odometry if transforms do not give it: of the only topic of `Odometry`.
fn odometry_of(survey: &Survey, base: &str) -> (Option<String>, Option<String>) {
    let by_transforms = survey.tree.contains("odom") && survey.tree.lookup("odom", base, 0) != Lookup::Unconnected;
    let topics: Vec<_> =
        survey.topics.iter().filter(|t| t.topic.message_type == Odometry::TYPE && t.count > 0).collect();
    match topics.as_slice() {
        [only] if !by_transforms => (Some(only.frame.clone()), Some(only.topic.name.clone())),
        _ => (None, None),
    }
}
