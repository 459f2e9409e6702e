//! Creates a store.

use super::hash::Digest;
use super::rows::Meta;
use super::schema::{APPLICATION_ID, FORMAT, TABLES, refusal};
use super::{Note, Store};
use presight_model::environment::Environment;
use presight_model::error::{Error, ErrorKind, Result};
use presight_read::temporary::{Access, Temporary};
use rusqlite::{Connection, OpenFlags};
use std::path::{Path, PathBuf};

/// Bytes of a page. Finding a page costs one step, so small pages slow down meshes. A commit writes whole pages twice,
/// so large pages slow down small commits.
const PAGE: u32 = 16_384;

/// Makes a store with the given environment and an empty log. The file appears under its name only once it is complete
/// and on disk.
///
/// # Errors
/// [`ErrorKind::Usage`] if a file of this name exists; [`ErrorKind::System`] if the file cannot be written.
pub fn create(path: &Path, environment: &Environment, note: &Note) -> Result<()> {
    create_unnamed(path, environment, note).map_err(|e| e.in_file(path))
}

fn create_unnamed(path: &Path, environment: &Environment, note: &Note) -> Result<()> {
    if !note.time.is_finite() {
        return Err(Error::invalid(format!("the time {} is not finite", note.time), "give UTC seconds"));
    }
    if path.symlink_metadata().is_ok() {
        let remedy = "choose another name, or remove the file; presight env import adds to a store";
        return Err(Error::usage("a file of this name already exists", remedy));
    }
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder.to_owned(),
        _ => PathBuf::from("."),
    };
    let refused = |e: std::io::Error| {
        let remedy = "create the folder first, check its permissions, or write elsewhere";
        Error::new(ErrorKind::System, format!("cannot write: {e}"), remedy).caused_by(e)
    };
    let mut temporary = Temporary::new(&folder, Access::Umask).map_err(refused)?;
    // On Windows locks are mandatory, so ours would block SQLite. SQLite's own lock then protects the file.
    if cfg!(windows) {
        temporary.file().unlock().map_err(refused)?;
    }
    fill(temporary.path(), path, environment, note)?;
    temporary.file().sync_all().map_err(refused)?;
    temporary.keep_as_new(path).map_err(refused)?;
    // Only Unix can open a folder as a file to sync it.
    if cfg!(unix) {
        std::fs::File::open(&folder).and_then(|f| f.sync_all()).map_err(refused)?;
    }
    Ok(())
}

/// Opens the file without SQLite's lock, which would conflict with ours on network file systems.
fn connect(file: &Path) -> rusqlite::Result<Connection> {
    match cfg!(unix) {
        true => Connection::open_with_flags_and_vfs(file, OpenFlags::default(), "unix-none"),
        false => Connection::open(file),
    }
}

/// Fills the temporary `file`; errors name `path`, its final place.
fn fill(file: &Path, path: &Path, environment: &Environment, note: &Note) -> Result<()> {
    let wrap = |e| refusal(path, "create the store", e);
    // SQLite's own message would name the temporary file.
    let nameless = |e| match e {
        rusqlite::Error::SqliteFailure(code, _) => rusqlite::Error::SqliteFailure(code, None),
        other => other,
    };
    let connection = connect(file).map_err(|e| wrap(nameless(e)))?;
    connection.set_prepared_statement_cache_capacity(64);
    // No journal or syncs: the file is invisible until it is complete, and `create` syncs it once.
    let mut sql = format!(
        "PRAGMA page_size = {PAGE}; PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; \
         PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {FORMAT}; BEGIN;"
    );
    TABLES.iter().for_each(|(_, table)| sql += &format!("{table};"));
    connection.execute_batch(&sql).map_err(wrap)?;
    let mut meta = Meta {
        created: note.time + 0.0,
        cause: note.cause.clone(),
        genesis: environment.content_hash().0,
        next_object: 0,
        next_slot: 0,
        changes: 0,
        head: [0; 32],
        digest: Digest::default(),
    };
    meta.head = meta.first_head();
    let mut store = Store::empty(connection, path, meta);
    store.write_all(environment)?;
    store.write_meta()?;
    store.connection.execute_batch("COMMIT").map_err(wrap)?;
    store.connection.close().map_err(|(_, e)| refusal(path, "create the store", e))
}
