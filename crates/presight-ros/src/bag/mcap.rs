//! MCAP files (specification of mcap.dev, version 0), read forward without their index, so that a cut file is read too.

use super::{MAX_RECORD_BYTES, Record, Registry, Step, Topic, packed};
use mcap::McapError;
use mcap::records::Record as McapRecord;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use presight_model::error::{Error, Result};
use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub(super) struct Reader {
    path: PathBuf,
    /// The file, or the unpacked content of a compressed one.
    file: Box<dyn Read + Send>,
    is_packed: bool,
    linear: LinearReader,
    schemas: HashMap<u16, String>,
    /// `None` for a channel whose messages are not wanted.
    channels: HashMap<u16, Option<Arc<Topic>>>,
    bytes_read: u64,
}

impl Reader {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let is_packed = packed::is_packed(path)?;
        let file: Box<dyn Read + Send> = match is_packed {
            true => Box::new(packed::unpacking(path)?),
            false => Box::new(File::open(path).map_err(|e| Error::io(path, "open the bag", e))?),
        };
        // A chunk is checked before its first message is used: damaged bytes never become a measurement.
        let options =
            LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(MAX_RECORD_BYTES);
        let linear = LinearReader::new_with_options(options);
        let path = path.to_owned();
        Ok(Self { path, file, is_packed, linear, schemas: HashMap::new(), channels: HashMap::new(), bytes_read: 0 })
    }

    pub(super) fn read(&mut self, registry: &mut Registry<'_>) -> Result<Step> {
        while let Some(event) = self.linear.next_event() {
            let event = match event {
                Ok(event) => event,
                Err(e) => return Ok(Step::Lost(damage(&e, self.bytes_read))),
            };
            let (opcode, data) = match event {
                LinearReadEvent::Record { data, opcode } => (opcode, data),
                LinearReadEvent::ReadRequest(count) => {
                    let buffer = self.linear.insert(count);
                    let read = match self.file.read(buffer) {
                        Ok(read) => read,
                        Err(e) if self.is_packed => return Ok(Step::Lost(packed::damaged(&e).to_string())),
                        Err(e) => return Err(Error::io(&self.path, "read the bag", e)),
                    };
                    self.linear.notify_read(read);
                    self.bytes_read += read as u64;
                    continue;
                }
            };
            let record = match mcap::parse_record(opcode, data) {
                Ok(record) => record,
                Err(e) => return Ok(Step::Lost(damage(&e, self.bytes_read))),
            };
            match record {
                McapRecord::Schema { header, .. } => {
                    self.schemas.insert(header.id, header.name);
                }
                McapRecord::Channel(channel) => {
                    let message_type = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                    let topic = Topic { name: channel.topic, message_type, encoding: channel.message_encoding };
                    self.channels.insert(channel.id, registry.enter(topic));
                }
                McapRecord::Message { header, data } => match self.channels.get(&header.channel_id) {
                    None => {
                        return Ok(Step::Lost(format!(
                            "a message of channel {}, which is not declared",
                            header.channel_id
                        )));
                    }
                    Some(None) => {}
                    Some(Some(topic)) => {
                        let log_time_ns = header.log_time.min(i64::MAX as u64) as i64;
                        let data = match packed::message(data) {
                            Ok(data) => data,
                            Err(e) => return Ok(Step::Lost(format!("a message of {}: {e}", topic.name))),
                        };
                        return Ok(Step::Record(Record { topic: Arc::clone(topic), log_time_ns, data }));
                    }
                },
                // The summary repeats what stood before.
                McapRecord::DataEnd(_) => return Ok(Step::End),
                _ => {}
            }
        }
        Ok(Step::Lost("the file ends without its end mark".into()))
    }
}

/// The damage of a file, in words of its reader.
fn damage(error: &McapError, bytes_read: u64) -> String {
    match error {
        McapError::UnexpectedEof => format!("the file is cut within a chunk, after {bytes_read} bytes"),
        error => format!("the file is damaged before byte {bytes_read}: {error}"),
    }
}
