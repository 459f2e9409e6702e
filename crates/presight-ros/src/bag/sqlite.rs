//! SQLite files (`.db3`) of rosbag2, of any schema version: tables `topics` and `messages`.

use super::{MAX_RECORD_BYTES, Record, Registry, Step, Topic, packed};
use presight_model::error::{Error, Result};
use rusqlite::{Connection, OpenFlags, OptionalExtension, params};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tempfile::TempDir;

pub(super) struct Reader {
    connection: Connection,
    /// Dropped after the connection: a copy of a file that has a write-ahead log, or the content of a compressed one.
    _copy: Option<TempDir>,
    topics: Option<HashMap<i64, Arc<Topic>>>,
    last_id: i64,
}

impl Reader {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let log = with_suffix(path, "-wal");
        let has_log = std::fs::metadata(&log).is_ok_and(|m| m.len() > 0);
        // To read a write-ahead log SQLite writes into the same folder, so it gets a copy. A file without a log is
        // opened as immutable.
        let is_packed = packed::is_packed(path)?;
        let has_log = has_log && !is_packed;
        let (_copy, path) = if has_log || is_packed {
            let copy = if is_packed { packed::unpacked(path)? } else { copy_with_log(path, &log)? };
            let path = copy.path().join("bag.db3");
            (Some(copy), path)
        } else {
            (None, path.to_owned())
        };
        let immutable = if has_log { "mode=rw" } else { "mode=ro&immutable=1" };
        let uri = format!("file:{}?{immutable}", escaped(&path)?);
        let flags = OpenFlags::SQLITE_OPEN_URI
            | OpenFlags::SQLITE_OPEN_NO_MUTEX
            | if has_log { OpenFlags::SQLITE_OPEN_READ_WRITE } else { OpenFlags::SQLITE_OPEN_READ_ONLY };
        let connection = Connection::open_with_flags(uri, flags).map_err(fault)?;
        Ok(Self { connection, _copy, topics: None, last_id: i64::MIN })
    }

    pub(super) fn read(&mut self, registry: &mut Registry<'_>) -> Result<Step> {
        if self.topics.is_none() {
            self.topics = Some(read_topics(&self.connection, registry)?);
        }
        let topics = self.topics.as_ref().expect("read above");
        if topics.is_empty() {
            return Ok(Step::End);
        }
        loop {
            match next_row(&self.connection, self.last_id) {
                Ok(None) => return Ok(Step::End),
                Ok(Some((id, topic_id, log_time_ns))) => {
                    self.last_id = id;
                    let Some(topic) = topics.get(&topic_id) else { continue };
                    return Ok(match read_data(&self.connection, id) {
                        Ok(data) => match packed::message(data.into()) {
                            Ok(data) => Step::Record(Record { topic: Arc::clone(topic), log_time_ns, data }),
                            Err(e) => Step::Lost(format!("message {id} of {}: {e}", topic.name)),
                        },
                        Err(e) => Step::Lost(format!("message {id} cannot be read: {e}")),
                    });
                }
                Err(e) => return Ok(Step::Lost(format!("the file is damaged behind message {}: {e}", self.last_id))),
            }
        }
    }
}

fn read_topics(connection: &Connection, registry: &mut Registry<'_>) -> Result<HashMap<i64, Arc<Topic>>> {
    let mut statement = connection.prepare("SELECT id, name, type, serialization_format FROM topics").map_err(fault)?;
    let rows = statement.query_map([], |row| {
        Ok((row.get::<_, i64>(0)?, Topic { name: row.get(1)?, message_type: row.get(2)?, encoding: row.get(3)? }))
    });
    let mut topics = HashMap::new();
    for row in rows.map_err(fault)? {
        let (id, topic) = row.map_err(fault)?;
        if let Some(topic) = registry.enter(topic) {
            topics.insert(id, topic);
        }
    }
    Ok(topics)
}

type Row = (i64, i64, i64);

/// Id, topic and time of the message behind `last_id`. Ids follow the order of recording.
fn next_row(connection: &Connection, last_id: i64) -> rusqlite::Result<Option<Row>> {
    let sql = "SELECT id, topic_id, timestamp FROM messages WHERE id > ? ORDER BY id LIMIT 1";
    connection
        .prepare_cached(sql)?
        .query_row(params![last_id], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))
        .optional()
}

fn read_data(connection: &Connection, id: i64) -> rusqlite::Result<Vec<u8>> {
    let sql = "SELECT data FROM messages WHERE id = ? AND length(data) <= ?";
    connection.prepare_cached(sql)?.query_row(params![id, MAX_RECORD_BYTES as i64], |row| row.get(0))
}

fn fault(e: rusqlite::Error) -> Error {
    Error::invalid(format!("not a readable bag: {e}"), "record it again, or repair it with: sqlite3 FILE .recover")
        .caused_by(e)
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

fn copy_with_log(path: &Path, log: &Path) -> Result<TempDir> {
    let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), "make a temporary folder", e))?;
    for (from, name) in [(path, "bag.db3"), (log, "bag.db3-wal")] {
        std::fs::copy(from, folder.path().join(name)).map_err(|e| Error::io(from, "copy it", e))?;
    }
    Ok(folder)
}

/// A path for a URI of SQLite: `%`, `?` and `#` have a meaning there.
fn escaped(path: &Path) -> Result<String> {
    let text = path.to_str().ok_or_else(|| Error::invalid("the path is not UTF-8", "rename the file").in_file(path))?;
    Ok(text.replace('%', "%25").replace('?', "%3f").replace('#', "%23"))
}
