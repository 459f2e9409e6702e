//! The ROS 2 bag that a command writes.

use super::drive::Sensed;
use super::outputs::OutputFiles;
use presight::Result;
use presight::localize::Step;
use presight::ros::{BagWriter, MessageOrigin, Record, answers, create_bag};
use std::path::{Path, PathBuf};

/// A bag that is created with its first message: an error before it leaves the file of an earlier run.
pub struct OutputBag {
    path: PathBuf,
    writer: Option<BagWriter>,
}

impl OutputBag {
    /// The bag of a flag, entered among the output files; `None` without the flag.
    ///
    /// # Errors
    /// As [`OutputFiles::add`].
    pub fn of(flag: &str, path: Option<&Path>, files: &mut OutputFiles) -> Result<Option<Self>> {
        files.add(flag, path, &["mcap"])?;
        Ok(path.map(|path| Self { path: path.to_owned(), writer: None }))
    }

    /// True before the first message.
    pub fn is_empty(&self) -> bool {
        self.writer.is_none()
    }

    /// Adds messages.
    ///
    /// # Errors
    /// [`presight::ErrorKind::System`] if the file cannot be written; the messages so far stay.
    pub fn add(&mut self, records: impl IntoIterator<Item = Record>) -> Result<()> {
        let writer = match &mut self.writer {
            Some(writer) => writer,
            None => self.writer.insert(create_bag(&self.path)?),
        };
        records.into_iter().try_for_each(|record| writer.add(&record))
    }

    /// Adds the answers of a localizer.
    ///
    /// # Errors
    /// As [`OutputBag::add`].
    pub fn answers(&mut self, sensed: &Sensed<'_>, step: &Step) -> Result<()> {
        self.add(answers(step, &MessageOrigin::of_frame(sensed.frame, sensed.recorded)))
    }

    /// Writes the index.
    ///
    /// # Errors
    /// As [`OutputBag::add`].
    pub fn finish(&mut self) -> Result<()> {
        self.writer.take().map_or(Ok(()), BagWriter::finish)
    }
}
