//! A report of a bag: its topics, frames and times, and the parts that presight takes from it.

use super::NANO;
use super::choice::{Choice, Measured, measured_topics};
use crate::log::BagOptions;
use presight_model::error::{Error, ErrorKind, Result};
use presight_ros::message::{CameraInfo, Image, LaserScan, Message, PointCloud2};
use presight_ros::{Bag, Survey, TopicSurvey};
use serde_json::{Value, json};
use std::path::Path;

/// The content of a bag, the parts that presight takes from it, and the reason if it takes none.
#[derive(Debug)]
pub struct BagReport {
    bag: Bag,
    survey: Survey,
    choice: Result<Choice>,
}

/// A gap in a topic is reported if it is this many times longer than the mean distance of its messages. A recorder that
/// drops every other message makes gaps of 2.
const NOTABLE_GAP: f64 = 5.0;

impl BagReport {
    /// Reads a bag once.
    ///
    /// # Errors
    /// As [`Bag::open`] and [`Survey::of`]. A bag that presight cannot read as a log is not an error here.
    pub fn of(path: &Path, options: &BagOptions) -> Result<Self> {
        let bag = Bag::open(path)?;
        let survey = Survey::of(&bag)?;
        let choice = Choice::of(&survey, options);
        Ok(Self { bag, survey, choice })
    }

    /// The reason why no topic of the bag can be read as a log. Several measured topics do not count: a flag chooses
    /// one.
    ///
    /// # Errors
    /// This reason.
    pub fn check(self) -> Result<()> {
        match self.choice {
            Err(e) if e.kind() != ErrorKind::Usage => Err(e.in_file(self.bag.path())),
            _ => Ok(()),
        }
    }

    /// The report as lines for people.
    pub fn lines(&self) -> Vec<String> {
        let mut lines: Vec<String> = self.bag.files().iter().map(|file| format!("file   {}", file.display())).collect();
        for topic in &self.survey.topics {
            lines.push(topic_line(topic));
        }
        for ((parent, child), edge) in &self.survey.edges {
            let kind = if edge.is_static { "static".into() } else { format!("{} samples", edge.count) };
            lines.push(format!("frame  {parent} -> {child} ({kind})"));
        }
        let lost = self.survey.losses.iter().map(|loss| format!("lost   {}: {}", loss.file.display(), loss.what));
        lines.extend(lost);
        lines.extend(self.survey.faults.iter().map(|fault| format!("fault  {fault}")));
        match &self.choice {
            Ok(choice) => lines.extend(choice_lines(choice)),
            Err(e) => lines.push(format!("not read as a log: {e}")),
        }
        lines
    }

    /// The report as JSON.
    pub fn to_json(&self) -> String {
        let topics: serde_json::Map<String, Value> =
            self.survey.topics.iter().map(|t| (t.topic.name.clone(), topic_json(t))).collect();
        let poses: Vec<(&str, &presight_ros::Edge)> = self.survey.tree.edges().collect();
        let transforms = self.survey.edges.iter().map(|((parent, child), edge)| {
            let pose = poses.iter().find(|(c, e)| c == child && e.parent == *parent).map(|(_, e)| e.last());
            let pose = pose.map(|pose| pose.to_array());
            let span = [edge.span_ns.0 as f64 * NANO, edge.span_ns.1 as f64 * NANO];
            json!({
                "parent": parent, "child": child, "static": edge.is_static, "count": edge.count, "span_s": span,
                "last_pose": pose,
            })
        });
        let taken = self.choice.as_ref().ok().map(|choice| {
            json!({
                "topic": choice.topic, "frame": choice.frame, "base": choice.base, "camera_info": choice.camera_info,
                "mount": choice.base_from_frame.map(|pose| pose.to_array()),
                "odometry": choice.odometry_topic.clone().or(choice.odom.as_ref().map(|_| "/tf".to_owned())),
                "reference": choice.has_reference,
            })
        });
        let lost = self.survey.losses.iter().map(|loss| format!("{}: {}", loss.file.display(), loss.what));
        json!({
            "files": self.bag.files(),
            "topics": topics,
            "transforms": transforms.collect::<Vec<_>>(),
            "measured": measured_topics(&self.survey).iter().map(|(t, _)| &t.topic.name).collect::<Vec<_>>(),
            "taken": taken,
            "hindrance": self.choice.as_ref().err().map(Error::to_string),
            "lost": lost.collect::<Vec<_>>(),
            "faults": self.survey.faults,
        })
        .to_string()
    }
}

fn topic_line(t: &TopicSurvey) -> String {
    let mut line = format!("topic  {}  {}  {} messages", t.topic.name, t.topic.message_type, t.count);
    if t.topic.encoding != "cdr" {
        line += &format!(", serialization {:?}", t.topic.encoding);
    }
    if !t.frame.is_empty() {
        line += &format!(", frame {}", t.frame);
    }
    if t.count > 0 {
        line += &format!(", {:.3} to {:.3} s", t.span_ns.0 as f64 * NANO, t.span_ns.1 as f64 * NANO);
    }
    if let Some(hz) = t.rate_hz() {
        line += &format!(", {hz:.1} Hz");
        let gap = t.max_gap_ns as f64 * NANO;
        if gap * hz > NOTABLE_GAP {
            line += &format!(", longest gap {gap:.2} s");
        }
    }
    if t.not_rising > 0 {
        line += &format!(", {} stamps not after the one before", t.not_rising);
    }
    if t.without_stamp > 0 {
        line += &format!(", {} stamps of 0 (the recorder's time is taken)", t.without_stamp);
    }
    line
}

fn choice_lines(choice: &Choice) -> Vec<String> {
    let kind = match choice.measured {
        Measured::Scan => "scans",
        Measured::Points => "points",
        Measured::Depth | Measured::CompressedDepth => "depth images",
        Measured::Grey => "grey images",
    };
    let mount = match &choice.base_from_frame {
        Some(p) => {
            let (roll, pitch, yaw) = p.rpy();
            let [roll, pitch, yaw] = [roll, pitch, yaw].map(f64::to_degrees);
            let [x, y, z] = p.translation.to_array();
            format!("{} from {}: {x:.4},{y:.4},{z:.4},{roll:.3},{pitch:.3},{yaw:.3}", choice.base, choice.frame)
        }
        None => format!("no static transform from {} to {}; give `BagOptions::mount`", choice.base, choice.frame),
    };
    let odometry = match (&choice.odom, &choice.odometry_topic) {
        (Some(odom), Some(topic)) => format!("{topic}, in frame {odom}"),
        (Some(odom), None) => format!("/tf from {odom} to {}", choice.base),
        _ => "none".into(),
    };
    let reference = if choice.has_reference { format!("/tf from map to {}", choice.base) } else { "none".into() };
    vec![
        format!("takes  {kind} of {}", choice.topic),
        format!("takes  mount {mount}"),
        format!("takes  odometry {odometry}"),
        format!("takes  reference {reference}"),
    ]
}

fn topic_json(t: &TopicSurvey) -> Value {
    let mut value = json!({"type": t.topic.message_type, "count": t.count});
    let mut set = |key: &str, entry: Value| value[key] = entry;
    if t.topic.encoding != "cdr" {
        set("serialization", json!(t.topic.encoding));
    }
    if !t.frame.is_empty() {
        set("frame", json!(t.frame));
    }
    if t.count > 0 {
        set("first_stamp", json!(t.span_ns.0 as f64 * NANO));
        set("last_stamp", json!(t.span_ns.1 as f64 * NANO));
        set("max_gap_s", json!(t.max_gap_ns as f64 * NANO));
    }
    if let Some(hz) = t.rate_hz() {
        set("rate_hz", json!(hz));
    }
    set("not_rising", json!(t.not_rising));
    set("without_stamp", json!(t.without_stamp));
    let Some(first) = &t.first else { return value };
    match t.topic.message_type.as_str() {
        LaserScan::TYPE => {
            if let Ok(scan) = LaserScan::decode(first) {
                value["sensor"] = json!({
                    "beams": scan.ranges.len(), "angle_min": scan.angle_min, "angle_max": scan.angle_max,
                    "angle_increment": scan.angle_increment, "range_min": scan.range_min, "range_max": scan.range_max,
                });
            }
        }
        PointCloud2::TYPE => {
            if let Ok(cloud) = PointCloud2::decode(first) {
                value["size"] = json!([cloud.height, cloud.width]);
                value["fields"] = json!(cloud.fields.iter().map(|f| &f.name).collect::<Vec<_>>());
            }
        }
        Image::TYPE => {
            if let Ok(image) = Image::decode(first) {
                value["size"] = json!([image.height, image.width]);
                value["encoding"] = json!(image.encoding);
            }
        }
        CameraInfo::TYPE => {
            if let Ok(info) = CameraInfo::decode(first) {
                value["k"] = json!(info.k);
                value["d"] = json!(info.d);
                value["model"] = json!(info.distortion_model);
            }
        }
        _ => {}
    }
    value
}
