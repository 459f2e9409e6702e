//! Changes that wait until there is time to apply them.

use presight_model::clock::Instant;
use presight_model::error::{Error, Result};
use presight_store::{Note, Store};
use std::collections::VecDeque;
use std::path::Path;
use std::time::Duration;

/// Lines of changes that wait in order. A robot adds its changes, and applies them when it has time.
///
/// ```
/// # use presight_model::environment::Environment;
/// # use presight_model::geometry::Pose;
/// # use presight_store::{Note, Store};
/// use presight_update::Waiting;
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("site.presight");
/// # let mut environment = Environment::new();
/// # environment.add_cuboid("crate", Pose::IDENTITY, glam::DVec3::ONE)?;
/// # presight_store::create(&path, &environment, &Note::new("new", 0.0))?;
/// let mut store = Store::open(&path)?;
/// let mut waiting = Waiting::default();
/// waiting.add([r#"{"op":"delete_object","object":"crate","id":"1"}"#.to_owned()]);
/// let note = Note::new("monday", 1.7e9);
/// assert_eq!(waiting.apply(&mut store, &note, std::time::Duration::ZERO)?.lines.len(), 0);
/// assert_eq!(waiting.lines().count(), 1, "it waits");
/// assert_eq!(waiting.apply(&mut store, &note, std::time::Duration::MAX)?.lines.len(), 1);
/// assert!(store.world().environment().object("crate").is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Waiting {
    lines: VecDeque<String>,
}

/// What became of lines.
#[derive(Debug, Default)]
pub struct Applied {
    /// Lines that are in the store now.
    pub lines: Vec<String>,
    /// Lines that do not apply, and why: their object changed in the meantime.
    pub refused: Vec<(String, Error)>,
}

impl Waiting {
    /// Adds lines behind the others.
    pub fn add(&mut self, lines: impl IntoIterator<Item = String>) {
        self.lines.extend(lines);
    }

    /// The lines that wait, the next first.
    pub fn lines(&self) -> impl ExactSizeIterator<Item = &str> {
        self.lines.iter().map(String::as_str)
    }

    /// Applies lines in order, each whole or not at all, and commits them together. After `within` no further line begins; the
    /// rest waits. A line that does not apply is refused, and the next one follows. The store is locked only meanwhile.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the store is locked or cannot be written. Then all lines wait as before.
    pub fn apply(&mut self, store: &mut Store, note: &Note, within: Duration) -> Result<Applied> {
        let started = Instant::now();
        let mut batch = store.batch()?;
        let (mut applied, mut count) = (Applied::default(), 0);
        for line in &self.lines {
            if started.elapsed() >= within {
                break;
            }
            match batch.apply_line(line, Path::new("."), note) {
                Ok((_, true)) => applied.lines.push(line.clone()),
                // It was applied before.
                Ok((_, false)) => {}
                Err(e) if batch.is_whole() => applied.refused.push((line.clone(), e)),
                Err(e) => return Err(e),
            }
            count += 1;
        }
        batch.commit()?;
        store.release();
        self.lines.drain(..count);
        Ok(applied)
    }
}
