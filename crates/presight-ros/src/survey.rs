//! A survey of a bag: its topics with counts and times, its tree of frames, and its faults.

use crate::message::{
    CameraInfo, CompressedImage, Header, Image, LaserScan, Message, Odometry, PointCloud2, TFMessage,
};
use crate::{Bag, FrameTree, Loss, Topic, clean_frame_id};
use presight_model::error::Result;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The topics of a bag and its tree of frames, from one pass over all messages.
#[derive(Clone, Debug, Default)]
pub struct Survey {
    /// The topics, by name.
    pub topics: Vec<TopicSurvey>,
    /// The frames: static transforms, and the newest sample of the others.
    pub tree: FrameTree,
    /// The transforms over time, by parent and child.
    pub edges: BTreeMap<(String, String), EdgeSurvey>,
    /// Faults of single messages and of the tree, each once.
    pub faults: Vec<String>,
    /// Parts of files that could not be read.
    pub losses: Vec<Loss>,
}

/// A topic with its counts and times.
#[derive(Clone, Debug)]
pub struct TopicSurvey {
    /// The topic.
    pub topic: Arc<Topic>,
    /// Number of its messages.
    pub count: u64,
    /// The frame of its first message, without a leading slash; empty if its type has no header.
    pub frame: String,
    /// Stamps of the first and the last message, nanoseconds: from their headers, or from the recorder where the type
    /// has no header or the stamp is 0.
    pub span_ns: (i64, i64),
    /// The longest time from one stamp to the next, nanoseconds.
    pub max_gap_ns: i64,
    /// Number of messages whose stamp is not after the one before.
    pub not_rising: u64,
    /// Number of messages whose stamp is 0.
    pub without_stamp: u64,
    /// The first message, serialized, if its topic is measured.
    pub first: Option<Vec<u8>>,
}

/// A transform over time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EdgeSurvey {
    /// True for one of `/tf_static`.
    pub is_static: bool,
    /// Number of samples.
    pub count: u64,
    /// Stamps of the first and the last sample, nanoseconds.
    pub span_ns: (i64, i64),
}

/// Maximum number of faults that are kept; later ones mostly repeat them.
const MAX_FAULTS: usize = 16;

/// Message types that start with a header.
const STAMPED: [&str; 6] =
    [LaserScan::TYPE, PointCloud2::TYPE, Image::TYPE, CompressedImage::TYPE, CameraInfo::TYPE, Odometry::TYPE];

/// True if the topic holds transforms that never change: recorders keep its name.
pub fn is_static_topic(topic: &Topic) -> bool {
    topic.name.trim_start_matches('/').ends_with("tf_static")
}

impl Survey {
    /// Reads a bag once.
    ///
    /// # Errors
    /// As the iterator of [`Bag::messages`]. A damaged part, a faulty message or transform is reported in the survey.
    pub fn of(bag: &Bag) -> Result<Self> {
        let mut survey = Self::default();
        let mut topics: BTreeMap<Arc<Topic>, TopicSurvey> = BTreeMap::new();
        let mut messages = bag.messages(|_| true);
        while let Some(record) = messages.next().transpose()? {
            let of_topic = topics.entry(Arc::clone(&record.topic)).or_insert_with(|| TopicSurvey::new(&record.topic));
            if record.topic.encoding == "cdr" {
                if let Err(e) = survey.add(of_topic, &record.data, record.log_time_ns) {
                    survey.add_fault(format!("{}, message {}: {e}", record.topic.name, of_topic.count));
                }
            } else {
                of_topic.add_stamp(record.log_time_ns);
            }
        }
        for topic in messages.topics() {
            topics.entry(Arc::clone(topic)).or_insert_with(|| TopicSurvey::new(topic));
        }
        survey.losses = messages.losses().to_vec();
        survey.topics = topics.into_values().collect();
        Ok(survey)
    }

    fn add(&mut self, of_topic: &mut TopicSurvey, data: &[u8], log_time_ns: i64) -> Result<()> {
        let message_type = of_topic.topic.message_type.as_str();
        if message_type == TFMessage::TYPE {
            of_topic.add_stamp(log_time_ns);
            let is_static = is_static_topic(&of_topic.topic);
            return self.add_transforms(TFMessage::decode(data)?, is_static);
        }
        if !STAMPED.contains(&message_type) {
            of_topic.add_stamp(log_time_ns);
            return Ok(());
        }
        let header = Header::decode(data)?;
        if of_topic.count == 0 {
            of_topic.frame = clean_frame_id(&header.frame_id).to_owned();
            of_topic.first = Some(data.to_owned());
        }
        of_topic.without_stamp += u64::from(header.stamp_ns == 0);
        of_topic.add_stamp(if header.stamp_ns == 0 { log_time_ns } else { header.stamp_ns });
        Ok(())
    }

    fn add_transforms(&mut self, message: TFMessage, is_static: bool) -> Result<()> {
        for transform in message.transforms {
            let (parent, child) =
                (clean_frame_id(&transform.header.frame_id), clean_frame_id(&transform.child_frame_id));
            let stamp = transform.header.stamp_ns;
            let edge = self.edges.entry((parent.to_owned(), child.to_owned()));
            let edge = edge.or_insert(EdgeSurvey { is_static, count: 0, span_ns: (stamp, stamp) });
            edge.count += 1;
            edge.span_ns = (edge.span_ns.0.min(stamp), edge.span_ns.1.max(stamp));
            let Some(pose) = transform.parent_from_child else {
                self.add_fault(format!("the transform from \"{parent}\" to \"{child}\" has no valid rotation"));
                continue;
            };
            if let Err(e) = self.tree.insert(parent, child, stamp, pose, is_static) {
                self.add_fault(e.to_string());
            }
            self.tree.forget_before(stamp);
        }
        Ok(())
    }

    fn add_fault(&mut self, fault: String) {
        if self.faults.len() < MAX_FAULTS && !self.faults.contains(&fault) {
            self.faults.push(fault);
        }
    }

    /// A topic by its name.
    pub fn topic(&self, name: &str) -> Option<&TopicSurvey> {
        self.topics.iter().find(|t| t.topic.name == name)
    }
}

impl TopicSurvey {
    fn new(topic: &Arc<Topic>) -> Self {
        Self {
            topic: Arc::clone(topic),
            count: 0,
            frame: String::new(),
            span_ns: (0, 0),
            max_gap_ns: 0,
            not_rising: 0,
            without_stamp: 0,
            first: None,
        }
    }

    fn add_stamp(&mut self, stamp_ns: i64) {
        if self.count == 0 {
            self.span_ns = (stamp_ns, stamp_ns);
        } else {
            let since = stamp_ns.saturating_sub(self.span_ns.1);
            self.not_rising += u64::from(since <= 0);
            self.max_gap_ns = self.max_gap_ns.max(since);
            self.span_ns.1 = stamp_ns;
        }
        self.count += 1;
    }

    /// Messages a second between the first and the last one; `None` for less than two.
    pub fn rate_hz(&self) -> Option<f64> {
        let seconds = (self.span_ns.1 - self.span_ns.0) as f64 * 1e-9;
        (self.count > 1 && seconds > 0.0).then(|| (self.count - 1) as f64 / seconds)
    }
}
