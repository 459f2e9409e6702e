//! Notices of a log, each once.

use std::sync::{Arc, Mutex, PoisonError};

/// A list of notices that its readers share; it grows as frames are read.
#[derive(Clone, Debug, Default)]
pub(super) struct Notices(Arc<Mutex<Vec<String>>>);

impl Notices {
    /// Adds a notice that is not there yet.
    pub fn add(&self, notice: impl Into<String>) {
        let notice = notice.into();
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !all.contains(&notice) {
            all.push(notice);
        }
    }

    /// The notices so far.
    pub fn all(&self) -> Vec<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl From<Arc<Mutex<Vec<String>>>> for Notices {
    fn from(shared: Arc<Mutex<Vec<String>>>) -> Self {
        Self(shared)
    }
}
