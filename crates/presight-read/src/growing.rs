//! Output files that grow by whole lines while a command works, and stay when it fails or is ended by a signal.

use crate::atomic::{is_given, open_through, open_to_replace, refused};
use crate::temporary::undisturbed;
use presight_model::error::Result;
use std::fs::{self, File};
use std::io::{self, Seek, Write};
use std::path::{Path, PathBuf};

/// A file of lines. Adding a line writes it at once.
#[derive(Debug)]
pub struct GrowingFile {
    file: File,
    path: PathBuf,
    /// Bytes so far; `None` for a device or pipe.
    length: Option<u64>,
}

impl GrowingFile {
    /// Creates the file, or empties an existing one, which keeps its owner and mode. Links are followed.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] naming the file, as [`crate::atomic::write_atomically`].
    pub fn create(path: &Path) -> Result<Self> {
        let refused = |e| refused(path, e);
        if is_through(path) {
            return Ok(Self { file: open_through(path).map_err(refused)?, path: path.to_owned(), length: None });
        }
        drop(open_to_replace(path)?);
        Ok(Self { file: File::create(path).map_err(refused)?, path: path.to_owned(), length: Some(0) })
    }

    /// Opens a file that a run left, to go on behind its first `length` bytes.
    ///
    /// # Errors
    /// As [`GrowingFile::create`].
    pub fn reopen(path: &Path, length: u64) -> Result<Self> {
        let opened = || {
            let mut file = File::options().write(true).open(path)?;
            file.set_len(length)?;
            file.seek(io::SeekFrom::End(0))?;
            Ok(file)
        };
        let file = opened().map_err(|e| refused(path, e))?;
        Ok(Self { file, path: path.to_owned(), length: Some(length) })
    }

    /// Adds a line, given without its line end.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if it cannot be written; the file then ends after the line before.
    pub fn add(&mut self, line: &str) -> Result<()> {
        let bytes = format!("{line}\n").into_bytes();
        let written = match self.length {
            None => self.file.write_all(&bytes),
            Some(length) => undisturbed(|| {
                // A full disk takes a part of a line.
                self.file.write_all(&bytes).inspect_err(|_| drop(self.file.set_len(length)))
            }),
        };
        written.map_err(|e| refused(&self.path, e))?;
        self.length = self.length.map(|length| length + bytes.len() as u64);
        Ok(())
    }

    /// Syncs the complete file to the disk.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the system refuses.
    pub fn finish(self) -> Result<()> {
        let synced: io::Result<()> = self.length.map_or(Ok(()), |_| self.file.sync_all());
        synced.map_err(|e| refused(&self.path, e))
    }
}

/// True for a device, a pipe or an open file of this process: output goes into it, and nothing replaces it.
pub fn is_through(path: &Path) -> bool {
    is_given(path) || fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir())
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::error::ErrorKind;

    #[test]
    fn every_line_is_there_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tum");
        fs::write(&path, "of an earlier run, and longer\n").unwrap();
        let mut file = GrowingFile::create(&path).unwrap();
        for (line, all) in [("1", "1\n"), ("", "1\n\n"), ("2 3", "1\n\n2 3\n")] {
            file.add(line).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), all);
        }
        file.finish().unwrap();
        // Behind the first line, what came after it is replaced.
        let mut again = GrowingFile::reopen(&path, 2).unwrap();
        again.add("4").unwrap();
        again.finish().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "1\n4\n");
        let mut through = GrowingFile::create(Path::new("/dev/null")).unwrap();
        through.add("gone").unwrap();
        through.finish().unwrap();
    }

    #[test]
    fn unwritable_files_are_the_systems_refusal() {
        let folder = tempfile::tempdir().unwrap();
        let locked = folder.path().join("locked");
        fs::write(&locked, b"old").unwrap();
        let mut permissions = fs::metadata(&locked).unwrap().permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&locked, permissions).unwrap();
        for path in [folder.path(), &folder.path().join("none/a"), &locked] {
            let e = GrowingFile::create(path).unwrap_err();
            assert_eq!((e.kind(), e.file()), (ErrorKind::System, Some(path)), "{e}");
        }
        assert_eq!(fs::read(&locked).unwrap(), b"old");
    }

    /// A device that is full takes nothing, and says so.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_device_is_an_error() {
        let e = GrowingFile::create(Path::new("/dev/full")).unwrap().add("1").unwrap_err();
        assert_eq!(e.kind(), ErrorKind::System, "{e}");
    }
}
