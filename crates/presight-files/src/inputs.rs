//! The files that this process read, and files that belong to them: a command must not overwrite them.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

/// Unset until [`record`] is called: the library alone keeps no list.
static READ: OnceLock<Mutex<BTreeSet<PathBuf>>> = OnceLock::new();

/// Starts the list of files that this process opens for reading.
pub fn record() {
    READ.get_or_init(Mutex::default);
}

/// Adds a file that is opened for reading, or that belongs to such a file.
pub fn note(path: &Path) {
    if let Some(read) = READ.get() {
        read.lock().unwrap_or_else(PoisonError::into_inner).insert(path.to_owned());
    }
}

/// Removes a file that was read in order to be continued and replaced.
pub fn forget(path: &Path) {
    if let Some(read) = READ.get() {
        read.lock().unwrap_or_else(PoisonError::into_inner).remove(path);
    }
}

/// The files added since [`record`], by their paths as given.
pub fn so_far() -> BTreeSet<PathBuf> {
    READ.get().map(|read| read.lock().unwrap_or_else(PoisonError::into_inner).clone()).unwrap_or_default()
}
