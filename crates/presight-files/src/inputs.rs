//! Which files were read, or belong to what was: a command must not write over them.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

/// Empty until somebody wants to know: the library alone keeps no list.
static READ: OnceLock<Mutex<BTreeSet<PathBuf>>> = OnceLock::new();

/// From now on it is noted what this process opens to read.
pub fn record() {
    READ.get_or_init(Mutex::default);
}

/// Whoever opens a file to read it calls this, or finds one that belongs to what is read.
pub fn note(path: &Path) {
    if let Some(read) = READ.get() {
        read.lock().unwrap_or_else(PoisonError::into_inner).insert(path.to_owned());
    }
}

/// A file that was read to be replaced by what goes on from it.
pub fn forget(path: &Path) {
    if let Some(read) = READ.get() {
        read.lock().unwrap_or_else(PoisonError::into_inner).remove(path);
    }
}

/// What was noted since [`record`], by the paths that were given.
pub fn so_far() -> BTreeSet<PathBuf> {
    READ.get().map(|read| read.lock().unwrap_or_else(PoisonError::into_inner).clone()).unwrap_or_default()
}
