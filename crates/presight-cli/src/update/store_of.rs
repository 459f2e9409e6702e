//! The version of the map that findings refer to, and their application to the store.

use crate::print;
use presight::environment::IndexKind;
use presight::store;
use presight::store::{Note, ProposedChange, Store};
use presight::update::PendingChanges;
use presight::{Error, ErrorKind, Result, Scene};
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A version of a map.
pub struct Version {
    pub is_store: bool,
    /// Identifies a store in all its versions; the hash of the content for another scene.
    pub origin: String,
    /// Names this version: ids of changes begin with it.
    pub base: String,
}

/// The version of a map that was just opened.
///
/// # Errors
/// Errors from reading the store.
pub fn version_of(map: &Path, scene: &Scene) -> Result<Version> {
    let content = scene.world.environment().content_hash().to_string();
    if !map.extension().is_some_and(|e| e.eq_ignore_ascii_case("presight")) {
        return Ok(Version { is_store: false, base: content[..12].to_owned(), origin: content });
    }
    let info = store::info(map)?;
    Ok(Version { is_store: true, origin: info.genesis, base: info.head[..12].to_owned() })
}

/// Applies changes to the store at a time (UTC seconds), one by one. A change whose object was changed since is refused
/// with a message. Returns the applied changes, and the number of changes for which the time was too short.
///
/// # Errors
/// Errors from opening the store and from writing to it.
pub fn apply(
    map: &Path,
    changes: Vec<ProposedChange>,
    time: f64,
    within: Duration,
) -> Result<(Vec<ProposedChange>, usize)> {
    let mut store = Store::open_with_index(map, &IndexKind::None)?;
    let mut pending = PendingChanges::default();
    pending.add(changes);
    let applied = pending.apply(&mut store, &Note::new("presight update", time), within)?;
    applied.refused.iter().for_each(|(_, e)| print::message(&e.to_string()));
    Ok((applied.changes, pending.iter().len()))
}

/// The lock on a store or a file of evidence, which one run at a time holds. The operating system releases it when the
/// run ends.
pub struct Claim {
    path: PathBuf,
    _file: File,
}

impl Claim {
    /// Claims a file.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if another run has it, or if its folder cannot be written.
    pub fn of(claimed: &Path) -> Result<Self> {
        let mut name = claimed.as_os_str().to_owned();
        name.push("-update");
        let path = PathBuf::from(name);
        let read_only = std::fs::metadata(claimed).is_ok_and(|m| m.permissions().readonly());
        if read_only {
            let remedy = "make it writable, or leave out --apply and --evidence";
            return Err(Error::new(ErrorKind::System, "cannot write: the file is read-only", remedy).in_file(claimed));
        }
        let file = File::options().create(true).append(true).open(&path);
        let file = file.map_err(|e| Error::io(&path, "claim what an update writes", e))?;
        match file.try_lock() {
            Ok(()) => Ok(Self { path, _file: file }),
            Err(TryLockError::WouldBlock) => {
                let what = "another presight update is at work on it";
                Err(Error::new(ErrorKind::System, what, "wait until that one ends, or stop it").in_file(claimed))
            }
            Err(TryLockError::Error(e)) => Err(Error::io(&path, "claim what an update writes", e)),
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}
