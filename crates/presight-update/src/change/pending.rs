//! Changes that wait until there is time to apply them.

use presight_model::clock::Instant;
use presight_model::error::{Error, Result};
use presight_store::{Note, ProposedChange, Store};
use std::collections::VecDeque;
use std::time::Duration;

/// A queue of changes. A robot adds its changes, and applies them when it has time.
///
/// ```
/// # use presight_model::environment::Environment;
/// # use presight_model::geometry::Pose;
/// # use presight_store::{Note, Store};
/// use presight_model::change::Change;
/// use presight_store::{Edit, ProposedChange};
/// use presight_update::PendingChanges;
/// use std::time::Duration;
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("site.presight");
/// # let mut environment = Environment::new();
/// # environment.add_cuboid("crate", Pose::IDENTITY, glam::DVec3::ONE)?;
/// # presight_store::create(&path, &environment, &Note::new("new", 0.0))?;
/// let mut store = Store::open(&path)?;
/// let mut pending = PendingChanges::default();
/// let edit = Edit::from(Change::DeleteObject { name: "crate".to_owned() });
/// pending.add([ProposedChange::new(edit, "the crate is gone", None, Vec::new(), "v1")?]);
/// let note = Note::new("monday", 1.7e9);
/// assert_eq!(pending.apply(&mut store, &note, Duration::ZERO)?.changes.len(), 0);
/// assert_eq!(pending.iter().count(), 1, "it waits");
/// assert_eq!(pending.apply(&mut store, &note, Duration::MAX)?.changes.len(), 1);
/// assert!(store.world().environment().object("crate").is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct PendingChanges {
    changes: VecDeque<ProposedChange>,
}

/// The results of applying changes.
#[derive(Debug, Default)]
pub struct Applied {
    /// Changes that are in the store now.
    pub changes: Vec<ProposedChange>,
    /// Changes that do not apply, and the reason: their object changed since.
    pub refused: Vec<(ProposedChange, Error)>,
}

impl PendingChanges {
    /// Adds changes at the end.
    pub fn add(&mut self, changes: impl IntoIterator<Item = ProposedChange>) {
        self.changes.extend(changes);
    }

    /// The pending changes, the next one first.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &ProposedChange> {
        self.changes.iter()
    }

    /// Applies changes in order, each completely or not at all, and commits them together. No change begins after
    /// `within`; the rest stays pending. A change that does not apply is refused, and the next one follows. The store
    /// is locked only during this call.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the store is locked or cannot be written. All changes then stay
    /// pending.
    pub fn apply(&mut self, store: &mut Store, note: &Note, within: Duration) -> Result<Applied> {
        let started = Instant::now();
        let mut batch = store.batch()?;
        let (mut applied, mut count) = (Applied::default(), 0);
        for change in &self.changes {
            if started.elapsed() >= within {
                break;
            }
            match batch.apply_proposed(change, note) {
                Ok((_, true)) => applied.changes.push(change.clone()),
                // It was applied before.
                Ok((_, false)) => {}
                Err(e) if batch.is_whole() => applied.refused.push((change.clone(), e)),
                Err(e) => return Err(e),
            }
            count += 1;
        }
        batch.commit()?;
        store.release();
        self.changes.drain(..count);
        Ok(applied)
    }
}
