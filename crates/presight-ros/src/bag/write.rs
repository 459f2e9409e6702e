//! Bags that presight writes: MCAP files with an index, without compression, as `ros2 bag record` makes them.

use super::{Record, Topic};
use crate::message::{MarkerArray, Message, definition};
use crate::survey::is_static_topic;
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions};
use presight_model::error::{Error, Result};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Writes an MCAP file, one message at a time. If it is dropped before [`BagWriter::finish`], the file has the messages
/// so far and their index.
pub struct BagWriter {
    path: PathBuf,
    writer: mcap::Writer<BufWriter<File>>,
    channels: HashMap<Arc<Topic>, Channel>,
}

/// The channel of a topic, and the number of messages in it.
#[derive(Clone, Copy)]
struct Channel {
    id: u16,
    count: u32,
}

impl Record {
    /// A message to write: its recorder's time is its stamp.
    #[doc(hidden)]
    pub fn of<'a, M: Message<'a>>(topic: &str, stamp_ns: i64, message: &M) -> Self {
        Self { topic: Arc::new(Topic::of::<M>(topic)), log_time_ns: stamp_ns, data: message.encode() }
    }
}

impl Topic {
    /// A topic of CDR messages.
    #[doc(hidden)]
    pub fn of<'a, M: Message<'a>>(name: &str) -> Self {
        Self { name: name.to_owned(), message_type: M::TYPE.to_owned(), encoding: "cdr".to_owned() }
    }

    /// True if its last message is kept for those who subscribe later: static transforms, and markers, of which
    /// presight publishes the model and findings once.
    pub fn is_latched(&self) -> bool {
        is_static_topic(self) || self.message_type == MarkerArray::TYPE
    }

    /// Quality of service as rosbag2 writes it since Iron: reliable, all values stated.
    fn qos(&self) -> String {
        let durability = if self.is_latched() { "transient_local" } else { "volatile" };
        // Infinite, as rmw writes it.
        let never = "\n    sec: 9223372036\n    nsec: 854775807";
        format!(
            "- history: keep_last\n  depth: 10\n  reliability: reliable\n  durability: {durability}\n  \
             deadline:{never}\n  lifespan:{never}\n  liveliness: automatic\n  liveliness_lease_duration:{never}\n  \
             avoid_ros_namespace_conventions: false\n"
        )
    }
}

impl BagWriter {
    /// Writes a bag into an empty file. The path is for messages of errors.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the file cannot be written.
    #[doc(hidden)]
    pub fn new(path: &Path, file: File) -> Result<Self> {
        let options = WriteOptions::new().compression(None).profile("ros2").library("presight");
        let writer = mcap::Writer::with_options(BufWriter::new(file), options).map_err(|e| fault(path, e))?;
        Ok(Self { path: path.to_owned(), writer, channels: HashMap::new() })
    }

    /// Adds a message. Messages of different topics may come in any order of time.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Unsupported`] for a type that presight does not write;
    /// [`presight_model::ErrorKind::System`] if the file cannot be written.
    pub fn add(&mut self, record: &Record) -> Result<()> {
        let channel = match self.channels.get(&record.topic) {
            Some(channel) => *channel,
            None => self.channel(&record.topic)?,
        };
        let time = record.log_time_ns.max(0) as u64;
        let header =
            MessageHeader { channel_id: channel.id, sequence: channel.count, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, &record.data).map_err(|e| fault(&self.path, e))?;
        self.channels.insert(Arc::clone(&record.topic), Channel { count: channel.count.wrapping_add(1), ..channel });
        Ok(())
    }

    fn channel(&mut self, topic: &Topic) -> Result<Channel> {
        let Some(definition) = definition(&topic.message_type) else {
            return Err(Error::new(
                presight_model::ErrorKind::Unsupported,
                format!("presight writes no messages of type {}", topic.message_type),
                "leave the topic out",
            ));
        };
        let mut declared = || {
            let schema = self.writer.add_schema(&topic.message_type, "ros2msg", definition.as_bytes())?;
            let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), topic.qos())]);
            self.writer.add_channel(schema, &topic.name, &topic.encoding, &metadata)
        };
        declared().map(|id| Channel { id, count: 0 }).map_err(|e| fault(&self.path, e))
    }

    /// Writes the index, and waits until the file is on the disk.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the file cannot be written.
    pub fn finish(mut self) -> Result<()> {
        self.writer.finish().map_err(|e| fault(&self.path, e))?;
        let file = self.writer.into_inner().into_inner().map_err(|e| Error::io(&self.path, "write", e.into_error()))?;
        match file.metadata().is_ok_and(|m| m.is_file()) {
            true => file.sync_all().map_err(|e| Error::io(&self.path, "write", e)),
            false => Ok(()),
        }
    }
}

fn fault(path: &Path, error: McapError) -> Error {
    match error {
        McapError::Io(e) => Error::io(path, "write", e),
        e => Error::io(path, "write", std::io::Error::other(e)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Bag;
    use crate::message::{Header, LaserScan, TFMessage};

    #[test]
    fn a_written_bag_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut bag = BagWriter::new(&path, File::create(&path).unwrap()).unwrap();
        let scan = |k: i64| LaserScan {
            header: Header { stamp_ns: 1_700_000_000_123_456_789 + k, frame_id: "laser".into() },
            angle_min: -1.0,
            angle_max: 1.0,
            angle_increment: 1.0,
            time_increment: 0.0,
            scan_time: 0.0,
            range_min: 0.1,
            range_max: 10.0,
            ranges: vec![1.0, f32::INFINITY, k as f32],
            intensities: vec![],
        };
        for k in 0..3 {
            bag.add(&Record::of("/scan", scan(k).header.stamp_ns, &scan(k))).unwrap();
        }
        bag.add(&Record::of("/tf_static", 5, &TFMessage { transforms: vec![] })).unwrap();
        let foreign = Topic { name: "/a".into(), message_type: "a_msgs/msg/A".into(), encoding: "cdr".into() };
        let e = bag.add(&Record { topic: Arc::new(foreign), log_time_ns: 0, data: vec![] }).unwrap_err();
        assert!(e.to_string().contains("a_msgs/msg/A"), "{e}");
        bag.finish().unwrap();
        let read: Vec<Record> = Bag::open(&path).unwrap().messages(|_| true).map(Result::unwrap).collect();
        assert_eq!(read.len(), 4);
        for (k, record) in read[..3].iter().enumerate() {
            assert_eq!(LaserScan::decode(&record.data).unwrap(), scan(k as i64));
            assert_eq!(record.log_time_ns, scan(k as i64).header.stamp_ns);
        }
        assert!(read[3].topic.is_latched() && !read[0].topic.is_latched());
    }
}
