//! The tables, opening a store, and SQLite's errors as ours.

use presight_model::error::{Error, ErrorKind, Result};
use rusqlite::{Connection, ErrorCode, OpenFlags};
use std::path::Path;
use std::time::Duration;

/// "prsg": distinguishes a store from SQLite files of other programs.
pub(super) const APPLICATION_ID: i32 = 0x7072_7367;
/// The format version that this build writes.
pub(super) const FORMAT: i32 = 5;
/// The oldest format version that this build reads. The first write upgrades it.
const OLDEST: i32 = 4;
/// What format 5 adds to the log.
const EVIDENCE: &str = "evidence TEXT";
/// The tables that format 5 adds.
const ADDED: [&str; 2] = ["marks", "trust"];
/// How long to wait for another program's commit.
const PATIENCE: Duration = Duration::from_secs(3);

/// Name and SQL of each table, exactly as `sqlite_schema` contains them, sorted by name.
pub(super) const TABLES: [(&str, &str); 10] = [
    (
        "features",
        "CREATE TABLE features(class TEXT NOT NULL, id INTEGER NOT NULL, kind TEXT, object TEXT, feature TEXT, \
         hash BLOB NOT NULL, PRIMARY KEY(class, id)) WITHOUT ROWID",
    ),
    (
        "groups",
        "CREATE TABLE groups(path TEXT PRIMARY KEY NOT NULL, pose TEXT NOT NULL, hash BLOB NOT NULL) WITHOUT ROWID",
    ),
    (
        "layers",
        "CREATE TABLE layers(class TEXT PRIMARY KEY NOT NULL, tolerance TEXT NOT NULL, \
         pose_covariances TEXT NOT NULL, hash BLOB NOT NULL) WITHOUT ROWID",
    ),
    (
        "log",
        "CREATE TABLE log(number INTEGER PRIMARY KEY, time REAL NOT NULL, cause TEXT NOT NULL, id TEXT, \
         undoes INTEGER, change TEXT NOT NULL, inverse TEXT NOT NULL, request BLOB, hash BLOB NOT NULL, evidence TEXT)",
    ),
    (
        "marks",
        "CREATE TABLE marks(name TEXT PRIMARY KEY NOT NULL, mark TEXT NOT NULL, hash BLOB NOT NULL) WITHOUT ROWID",
    ),
    (
        "materials",
        "CREATE TABLE materials(number INTEGER PRIMARY KEY, name TEXT NOT NULL, properties TEXT NOT NULL, \
         hash BLOB NOT NULL)",
    ),
    (
        "meshes",
        "CREATE TABLE meshes(number INTEGER PRIMARY KEY, name TEXT NOT NULL, vertices INTEGER NOT NULL, \
         polygons INTEGER NOT NULL, hash BLOB NOT NULL, content BLOB NOT NULL)",
    ),
    (
        "meta",
        "CREATE TABLE meta(one INTEGER PRIMARY KEY CHECK(one = 1), created REAL NOT NULL, cause TEXT NOT NULL, \
         genesis BLOB NOT NULL, next_object INTEGER NOT NULL, next_slot INTEGER NOT NULL, changes INTEGER NOT NULL, \
         head BLOB NOT NULL, digest BLOB NOT NULL, hash BLOB NOT NULL)",
    ),
    (
        "objects",
        "CREATE TABLE objects(number INTEGER PRIMARY KEY, name TEXT NOT NULL, pose TEXT NOT NULL, \
         object_from_mesh TEXT, mesh INTEGER NOT NULL, first_slot INTEGER NOT NULL, first_source INTEGER NOT NULL, \
         hash BLOB NOT NULL)",
    ),
    (
        "trust",
        "CREATE TABLE trust(object TEXT PRIMARY KEY NOT NULL, trust TEXT NOT NULL, hash BLOB NOT NULL) WITHOUT ROWID",
    ),
];

/// Purpose of a connection.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Access {
    /// Reading. This may still write to the file, to roll back the unfinished commit of a killed writer.
    Read,
    /// Writing, with durable commits.
    Write,
}

/// Opens a store. For writing, its tables must match its format.
pub(super) fn connect(path: &Path, access: Access) -> Result<Connection> {
    connect_unnamed(path, access).map_err(|e| e.in_file(path))
}

fn connect_unnamed(path: &Path, access: Access) -> Result<Connection> {
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, "open the store", e))?;
    if !metadata.is_file() {
        return Err(Error::invalid("this is not a file", "name a .presight file"));
    }
    if metadata.len() == 0 {
        // Virtual files of the operating system, such as those in /proc, report length 0 and may block a reader.
        return Err(Error::invalid("the file is empty", "name a .presight file"));
    }
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let wrap = |e| refusal(path, "open the store", e);
    let connection = Connection::open_with_flags(path, flags).map_err(wrap)?;
    connection.busy_timeout(PATIENCE).map_err(wrap)?;
    connection.set_prepared_statement_cache_capacity(64);
    // The file is not trusted: no SQL in its schema may run functions.
    connection.execute_batch("PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON;").map_err(wrap)?;
    match access {
        Access::Read => connection.execute_batch("PRAGMA query_only = ON").map_err(wrap)?,
        Access::Write => {
            check_identity(&connection, path)?;
            make_durable(&connection, path)?;
        }
    }
    Ok(connection)
}

pub(super) fn pragma<T: rusqlite::types::FromSql>(connection: &Connection, name: &str) -> rusqlite::Result<T> {
    connection.query_row(&format!("PRAGMA {name}"), [], |row| row.get(0))
}

/// Gives a store of the oldest format what the newest has in addition.
pub(super) fn upgrade(connection: &Connection) -> rusqlite::Result<()> {
    let mut sql = format!("ALTER TABLE log ADD COLUMN {EVIDENCE}; PRAGMA user_version = {FORMAT};");
    TABLES.iter().filter(|(name, _)| ADDED.contains(name)).for_each(|(_, table)| sql += &format!("{table};"));
    connection.execute_batch(&sql)
}

/// Name and SQL of each table of a format.
fn tables_of(format: i32) -> Vec<(&'static str, String)> {
    let is_old = format < FORMAT;
    let has = |(name, _): &&(&str, &str)| !(is_old && ADDED.contains(name));
    let own = |(name, sql): &(&'static str, &str)| {
        (*name, if is_old { sql.replace(&format!(", {EVIDENCE}"), "") } else { (*sql).to_owned() })
    };
    TABLES.iter().filter(has).map(own).collect()
}

/// The format of the store, as the open transaction sees it.
///
/// # Errors
/// If the file is not a store of a format that this build reads.
pub(super) fn check_identity(connection: &Connection, path: &Path) -> Result<i32> {
    let wrap = |e| refusal(path, "open the store", e);
    let application: i32 = pragma(connection, "application_id").map_err(wrap)?;
    if application != APPLICATION_ID {
        let what = "this SQLite file is not a presight store";
        return Err(Error::invalid(what, "presight env create makes one"));
    }
    let version: i32 = pragma(connection, "user_version").map_err(wrap)?;
    if version > FORMAT {
        let what = format!("format {version} is newer than this presight, which reads up to format {FORMAT}");
        return Err(Error::new(ErrorKind::Unsupported, what, "update presight"));
    }
    if version < 1 {
        return Err(damaged(format!("format {version} never existed")));
    }
    if version < OLDEST {
        let what = format!("format {version} is older than the first release and is no longer supported");
        let remedy =
            "create it again with presight env create, from its scene or an export by the version that wrote it";
        return Err(Error::new(ErrorKind::Unsupported, what, remedy));
    }
    let mut statement = connection.prepare("SELECT type, name, sql FROM sqlite_schema ORDER BY name").map_err(wrap)?;
    let columns = |row: &rusqlite::Row<'_>| Ok((row.get(0)?, row.get(1)?, row.get(2)?));
    let found: Vec<(String, String, Option<String>)> =
        statement.query_map([], columns).and_then(Iterator::collect).map_err(wrap)?;
    let tables = tables_of(version);
    let is_table = |((kind, name, sql), (table, text)): (&(String, String, Option<String>), &(&str, String))| {
        kind == "table" && name == table && sql.as_ref() == Some(text)
    };
    let same = found.len() == tables.len() && found.iter().zip(&tables).all(is_table);
    if same { Ok(version) } else { Err(damaged(format!("its tables do not match format {version}"))) }
}

/// Makes commits durable: when one returns, the data and the deletion of the journal are on disk.
fn make_durable(connection: &Connection, path: &Path) -> Result<()> {
    let wrap = |e| refusal(path, "open the store for writing", e);
    if connection.is_readonly("main").map_err(wrap)? {
        let what = "the store is read-only";
        return Err(Error::new(ErrorKind::System, what, "check the permissions of the file and its folder"));
    }
    let mode: String = connection.query_row("PRAGMA journal_mode = DELETE", [], |row| row.get(0)).map_err(wrap)?;
    connection.execute_batch("PRAGMA synchronous = EXTRA; PRAGMA cache_size = -16384;").map_err(wrap)?;
    let synchronous: i64 = pragma(connection, "synchronous").map_err(wrap)?;
    if mode != "delete" || synchronous != 3 {
        let what = format!("journal mode {mode}, synchronous {synchronous}: changes would not be durable");
        return Err(Error::new(ErrorKind::System, what, "close other programs that use the store"));
    }
    Ok(())
}

/// The error for a damaged store.
pub(super) fn damaged(what: impl std::fmt::Display) -> Error {
    Error::invalid(format!("the store is damaged: {what}"), "restore it from a backup")
}

/// Converts an error of SQLite to ours.
pub(super) fn refusal(path: &Path, doing: &str, e: rusqlite::Error) -> Error {
    use ErrorKind::System;
    let system = |what: &str, remedy: &str| Error::new(System, format!("cannot {doing}: {what}"), remedy);
    let said = e.to_string();
    let moved = e.sqlite_error().is_some_and(|e| e.extended_code == rusqlite::ffi::SQLITE_READONLY_DBMOVED);
    let unopened = matches!(e.sqlite_error_code(), Some(ErrorCode::ReadOnly | ErrorCode::CannotOpen));
    let error = match e.sqlite_error_code() {
        _ if moved || unopened && !path.exists() => {
            system("it was moved, replaced or deleted while it was open", "open it again at its new path")
        }
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked | ErrorCode::FileLockingProtocolFailed) => system(
            "another program has it open, for writing or reading (locked)",
            "wait until that program ends, or stop it",
        ),
        Some(ErrorCode::DiskFull) => system("the disk is full", "free some disk space"),
        Some(ErrorCode::ReadOnly | ErrorCode::PermissionDenied | ErrorCode::CannotOpen) => {
            system(&said, "check the permissions of the file and its folder")
        }
        Some(ErrorCode::SystemIoFailure | ErrorCode::OutOfMemory | ErrorCode::NoLargeFileSupport) => {
            system(&said, "check the disk and the permissions")
        }
        Some(ErrorCode::NotADatabase) => {
            Error::invalid("this is not an SQLite file, or its start is damaged", "name a .presight file")
        }
        _ => damaged(&said),
    };
    error.in_file(path).caused_by(e)
}
