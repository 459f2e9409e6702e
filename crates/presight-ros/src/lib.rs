//! ROS 2 bags without ROS: containers, messages and transforms.
//!
//! - [`Bag`] opens an MCAP file, an SQLite file (`.db3`), or the folder that `ros2 bag record` makes, and reads its
//!   messages in the order in which they were recorded. [`BagWriter`] writes an MCAP file.
//! - [`cdr`] holds the Common Data Representation (OMG Data-Distribution Service, Interoperability Wire Protocol 2.5,
//!   section 10), in which ROS 2 stores messages. [`message`] holds the message types that presight reads and writes.
//! - [`Survey`] lists what a bag holds.
//! - [`FrameTree`] looks up transforms between coordinate frames, as tf2 does.
//!
//! The crate knows neither sensors nor logs: `presight-read` turns messages into frames of a sensor.

mod bag;
pub mod cdr;
pub mod message;
mod survey;
mod tf;

pub use bag::{Bag, BagWriter, Loss, Messages, Record, Topic};
pub use survey::{EdgeSurvey, Survey, TopicSurvey, is_static_topic};
pub use tf::{Edge, FrameTree, Lookup, clean_frame_id};
