//! Bags: an MCAP file, an SQLite file, or the folder that `ros2 bag record` makes.

mod folder;
mod mcap;
mod packed;
mod sqlite;
mod write;

pub use write::BagWriter;

use presight_model::error::{Error, ErrorKind, Result};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A topic of a bag. One name may stand for several channels of the same type.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Topic {
    /// Its name, `/scan`.
    pub name: String,
    /// The type of its messages, `sensor_msgs/msg/LaserScan`; empty if the recording does not know it.
    pub message_type: String,
    /// The serialization of its messages; presight reads `cdr`.
    pub encoding: String,
}

/// A recorded message, or one to write.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Its topic.
    pub topic: Arc<Topic>,
    /// Time of the recorder when the message came, nanoseconds.
    pub log_time_ns: i64,
    /// The serialized message with its header.
    pub data: Vec<u8>,
}

/// The part of a damaged file that could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loss {
    /// The damaged file.
    pub file: PathBuf,
    /// The damage, and the bytes behind it.
    pub what: String,
}

/// The files of a bag, in the order of recording.
#[derive(Clone, Debug)]
pub struct Bag {
    path: PathBuf,
    files: Vec<PathBuf>,
}

/// The largest message and the largest chunk that are read, bytes. A cloud of 2^20 points of 48 bytes takes 48 MiB;
/// recorders write chunks of 0.75 to 16 MiB, or of one message.
const MAX_RECORD_BYTES: usize = 1 << 28;

/// The container that stores the messages of a file.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Container {
    Mcap,
    Sqlite,
}

const MCAP_MAGIC: &[u8] = b"\x89MCAP0\r\n";
const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";
const ROS1_MAGIC: &[u8] = b"#ROSBAG V";

impl Bag {
    /// True if a file or folder looks like a bag: by its first bytes, or by the files in it.
    pub fn is_bag(path: &Path) -> bool {
        if path.is_dir() {
            return folder::holds_bag(path);
        }
        let magics = [MCAP_MAGIC, SQLITE_MAGIC, ROS1_MAGIC];
        let by_name = folder::has_name_of_bag(path) || path.extension().is_some_and(|e| e.eq_ignore_ascii_case("bag"));
        // A pipe must keep its first bytes.
        by_name
            || path.is_file()
                && first_bytes(path).is_ok_and(|bytes| magics.iter().any(|magic| bytes.starts_with(magic)))
    }

    /// Opens a bag. A folder's `metadata.yaml` names its files in their order; if it is missing or empty, the files are
    /// taken by name.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if there is no bag at the path; [`ErrorKind::Unsupported`] for a bag of ROS 1;
    /// [`ErrorKind::System`] if a file cannot be read.
    pub fn open(path: &Path) -> Result<Self> {
        let files = if path.is_dir() { folder::files_of(path)? } else { vec![path.to_owned()] };
        for file in &files {
            container_of(file)?;
        }
        Ok(Self { path: path.to_owned(), files })
    }

    /// The path that was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The files, in the order of recording.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// The messages of the topics that `wanted` accepts, in the order of recording. The bag is read forward, one
    /// message at a time.
    pub fn messages(&self, wanted: impl Fn(&Topic) -> bool + Send + 'static) -> Messages {
        Messages {
            files: self.files.clone().into_iter(),
            reader: None,
            wanted: Box::new(wanted),
            topics: BTreeMap::new(),
            losses: vec![],
        }
    }
}

fn first_bytes(path: &Path) -> Result<Vec<u8>> {
    use std::io::Read;
    let file = std::fs::File::open(path).map_err(|e| Error::io(path, "open the bag", e))?;
    let mut bytes = Vec::new();
    file.take(16).read_to_end(&mut bytes).map_err(|e| Error::io(path, "read the bag", e))?;
    Ok(bytes)
}

/// The container of a file, which may be compressed as a whole.
fn container_of(file: &Path) -> Result<Container> {
    if packed::is_packed(file)? {
        return packed::container_in(file);
    }
    container_of_bytes(&first_bytes(file)?).map_err(|e| e.in_file(file))
}

/// The container that begins with these bytes.
fn container_of_bytes(bytes: &[u8]) -> Result<Container> {
    if bytes.starts_with(MCAP_MAGIC) {
        Ok(Container::Mcap)
    } else if bytes.starts_with(SQLITE_MAGIC) {
        Ok(Container::Sqlite)
    } else if bytes.starts_with(ROS1_MAGIC) {
        let remedy = "convert it with: pip install rosbags; rosbags-convert --src FILE.bag --dst FOLDER";
        Err(Error::new(ErrorKind::Unsupported, "a bag of ROS 1", remedy))
    } else if bytes.is_empty() {
        Err(Error::invalid("the bag is empty", "record it again"))
    } else {
        Err(Error::invalid("neither an MCAP nor an SQLite file", "give a bag of ROS 2"))
    }
}

/// The messages of a bag, in the order of recording. After an error there are no more.
pub struct Messages {
    files: std::vec::IntoIter<PathBuf>,
    reader: Option<(PathBuf, Reader)>,
    wanted: Box<dyn Fn(&Topic) -> bool + Send>,
    topics: BTreeMap<(String, String), Arc<Topic>>,
    losses: Vec<Loss>,
}

enum Reader {
    Mcap(Box<mcap::Reader>),
    Sqlite(sqlite::Reader),
}

impl Messages {
    /// Parts that were lost so far: a file that ends within a chunk is read up to its last whole chunk.
    pub fn losses(&self) -> &[Loss] {
        &self.losses
    }

    /// The topics found so far, by name.
    pub fn topics(&self) -> impl Iterator<Item = &Arc<Topic>> {
        self.topics.values()
    }

    fn read(&mut self) -> Result<Option<Record>> {
        loop {
            let Some((file, reader)) = &mut self.reader else {
                let Some(file) = self.files.next() else { return Ok(None) };
                let reader = match container_of(&file)? {
                    Container::Mcap => Reader::Mcap(Box::new(mcap::Reader::open(&file)?)),
                    Container::Sqlite => Reader::Sqlite(sqlite::Reader::open(&file)?),
                };
                self.reader = Some((file, reader));
                continue;
            };
            let mut registry = Registry { topics: &mut self.topics, wanted: &*self.wanted };
            let read = match reader {
                Reader::Mcap(reader) => reader.read(&mut registry),
                Reader::Sqlite(reader) => reader.read(&mut registry),
            };
            match read.map_err(|e| e.in_file(&*file))? {
                Step::Record(record) => return Ok(Some(record)),
                Step::Lost(what) => {
                    self.losses.push(Loss { file: file.clone(), what });
                    self.reader = None;
                }
                Step::End => self.reader = None,
            }
        }
    }
}

impl Iterator for Messages {
    type Item = Result<Record>;

    fn next(&mut self) -> Option<Self::Item> {
        let read = self.read().transpose();
        if matches!(read, Some(Err(_)) | None) {
            self.files = Vec::new().into_iter();
            self.reader = None;
        }
        read
    }
}

/// The result of reading on in one file.
enum Step {
    Record(Record),
    /// The file is damaged here; the text names the damage.
    Lost(String),
    End,
}

/// The topics of a bag while it is read.
struct Registry<'a> {
    topics: &'a mut BTreeMap<(String, String), Arc<Topic>>,
    wanted: &'a (dyn Fn(&Topic) -> bool + Send),
}

impl Registry<'_> {
    /// Enters a topic; `None` if its messages are not wanted.
    fn enter(&mut self, topic: Topic) -> Option<Arc<Topic>> {
        let key = (topic.name.clone(), topic.message_type.clone());
        let topic = self.topics.entry(key).or_insert_with(|| Arc::new(topic));
        (self.wanted)(topic).then(|| Arc::clone(topic))
    }
}
