//! Resumable work on many poses: a record next to the output files lists the finished poses, and the next run continues
//! after them. The record of a batch is its table of results, which gets its final name once complete.

use presight::tools::write_error;
use presight::{Error, ErrorKind, Result};
use std::fs::{self, File, TryLockError};
use std::io::{self, BufRead, BufReader, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// The progress of a series of poses. The record is a text file: a head line that identifies the job, then a fixed
/// number of lines for each finished pose. Such a line is the pose's number, alone or followed by a comma and more
/// text. The file is locked, so that only one process works on it.
#[derive(Debug)]
pub struct SeriesProgress {
    path: PathBuf,
    file: File,
    head: String,
    poses: Range<usize>,
    lines_per_pose: usize,
    next: usize,
    replaced: bool,
    written: Option<SystemTime>,
}

impl SeriesProgress {
    /// Opens the record of a job, or starts a new one. A record of another job is replaced. `head` identifies the job
    /// in one line without line end, such as a hash of scene, sensors, poses and request.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the record cannot be written, or another process is working on it.
    pub fn open(path: &Path, head: &str, poses: Range<usize>, lines_per_pose: usize) -> Result<Self> {
        let failed = |e| write_error(path, e);
        let opened = File::options().read(true).write(true).create(true).truncate(false).open(path);
        let file = opened.map_err(failed)?;
        if matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
            let (what, remedy) = ("another presight is writing these files", "wait until it has ended, or stop it");
            return Err(Error::new(ErrorKind::System, what, remedy).in_file(path));
        }
        let written = file.metadata().and_then(|m| m.modified()).ok();
        let (path, head, next) = (path.to_owned(), format!("{head}\n"), poses.start);
        let mut progress = Self { path, file, head, poses, lines_per_pose, next, replaced: false, written };
        progress.keep_while(|_| true)?;
        Ok(progress)
    }

    /// Marks the first pose whose files are lost (`is_there` returns false), and all poses after it, as unfinished.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the record cannot be read or written.
    pub fn keep_while(&mut self, is_there: impl Fn(usize) -> bool) -> Result<()> {
        let failed = |e| write_error(&self.path, e);
        self.file.rewind().map_err(failed)?;
        let (next, sound) = self.sound_part(is_there).map_err(failed)?;
        self.replaced |= sound == 0 && self.file.metadata().map_err(failed)?.len() > 0;
        self.next = next;
        self.file.set_len(sound).and_then(|()| self.file.seek(SeekFrom::End(0))).map_err(failed)?;
        if sound == 0 {
            self.file.write_all(self.head.as_bytes()).map_err(failed)?;
        }
        Ok(())
    }

    /// The first unfinished pose, and the number of bytes recorded before it: 0 if the head belongs to another job.
    fn sound_part(&self, is_there: impl Fn(usize) -> bool) -> io::Result<(usize, u64)> {
        let mut reader = BufReader::new(&self.file);
        let mut line = Vec::new();
        let mut next_line = |line: &mut Vec<u8>| -> io::Result<bool> {
            line.clear();
            // A line without line end is incomplete: the process ended while writing it.
            Ok(reader.read_until(b'\n', line)? > 0 && line.ends_with(b"\n"))
        };
        if !next_line(&mut line)? || line != self.head.as_bytes() {
            return Ok((self.poses.start, 0));
        }
        let mut sound = line.len() as u64;
        for pose in self.poses.clone() {
            let number = pose.to_string();
            let mut bytes = 0;
            for _ in 0..self.lines_per_pose {
                let is_its = next_line(&mut line)?
                    && line.strip_prefix(number.as_bytes()).is_some_and(|rest| rest.starts_with(b",") || rest == b"\n");
                if !is_its {
                    return Ok((pose, sound));
                }
                bytes += line.len() as u64;
            }
            if !is_there(pose) {
                return Ok((pose, sound));
            }
            sound += bytes;
        }
        Ok((self.poses.end, sound))
    }

    /// The first pose that is not finished.
    pub fn next(&self) -> usize {
        self.next
    }

    /// The number of finished poses.
    pub fn finished(&self) -> usize {
        self.next - self.poses.start
    }

    /// True if this record replaced the unfinished record of another job.
    pub fn replaced(&self) -> bool {
        self.replaced
    }

    /// When the record was last written before it was opened. A file written later does not belong to this series.
    pub fn written(&self) -> Option<SystemTime> {
        self.written
    }

    /// Records all poses up to `last` as finished. `lines` are their lines, each with its line end.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if they cannot be written; the next [`SeriesProgress::open`] drops incomplete lines.
    pub fn append(&mut self, last: usize, lines: &str) -> Result<()> {
        self.file.write_all(lines.as_bytes()).map_err(|e| write_error(&self.path, e))?;
        self.next = last + 1;
        Ok(())
    }

    /// Removes the record if all poses are finished.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the system refuses.
    pub fn remove(self) -> Result<()> {
        if self.next == self.poses.end {
            drop(self.file);
            fs::remove_file(&self.path).map_err(|e| Error::io(&self.path, "remove the record", e))?;
        }
        Ok(())
    }

    /// Renames the record, which has become the finished table.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the system refuses.
    pub fn rename(self, to: &Path) -> Result<()> {
        self.file.sync_all().and_then(|()| fs::rename(&self.path, to)).map_err(|e| write_error(to, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(path: &Path, head: &str) -> SeriesProgress {
        SeriesProgress::open(path, head, 4..9, 2).unwrap()
    }

    #[test]
    fn what_is_finished_is_not_done_again_whatever_follows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv.part");
        let whole = "pose,value\n4,1\n4,2\n5\n5,2\n";
        let ends = ["", "6", "6,1\n", "6,1\n6,2", "7,1\n7,2\n", "x\n", "6,1\n7,2\n", "60\n60\n", "9\n9\n"];
        for end in ends.map(str::as_bytes).into_iter().chain([&b"\xff\n6,1\n"[..]]) {
            fs::write(&path, [whole.as_bytes(), end].concat()).unwrap();
            let progress = open(&path, "pose,value");
            assert_eq!((progress.next(), progress.finished()), (6, 2), "{end:?}");
            assert!(!progress.replaced());
            drop(progress);
            assert_eq!(fs::read_to_string(&path).unwrap(), whole);
        }
        let other = open(&path, "pose,other");
        assert!(other.replaced() && other.finished() == 0);
        drop(other);
        let again = open(&path, "pose,value");
        assert_eq!(again.finished(), 0, "the other job may have written over its files");
    }

    #[test]
    fn what_follows_a_lost_file_is_done_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.series");
        let mut progress = open(&path, "j");
        for pose in 4..9 {
            progress.append(pose, &format!("{pose}\n{pose}\n")).unwrap();
        }
        progress.keep_while(|pose| pose != 6).unwrap();
        assert_eq!((progress.next(), fs::read_to_string(&path).unwrap().as_str()), (6, "j\n4\n4\n5\n5\n"));
        progress.append(8, "6\n6\n7\n7\n8\n8\n").unwrap();
        drop(progress);
        assert_eq!(open(&path, "j").finished(), 5);
    }

    #[test]
    fn a_record_goes_only_when_everything_is_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.series");
        open(&path, "j").remove().unwrap();
        assert!(path.exists());
        let mut progress = open(&path, "j");
        progress.append(8, "").unwrap();
        progress.remove().unwrap();
        assert!(!path.exists());
    }

    #[test]
    fn a_complete_record_becomes_the_table() {
        let folder = tempfile::tempdir().unwrap();
        let (part, table) = (folder.path().join("poses.csv.part"), folder.path().join("poses.csv"));
        let open = || SeriesProgress::open(&part, "pose,value", 0..2, 1).unwrap();
        open().append(0, "0,1.5\n").unwrap();
        let mut progress = open();
        assert_eq!(progress.next(), 1);
        progress.append(1, "1,2.5\n").unwrap();
        assert!(!table.exists());
        progress.rename(&table).unwrap();
        assert_eq!(fs::read_to_string(&table).unwrap(), "pose,value\n0,1.5\n1,2.5\n");
    }

    #[test]
    fn two_do_not_work_on_one_series() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.series");
        let _first = open(&path, "j");
        let e = SeriesProgress::open(&path, "j", 4..9, 2).unwrap_err();
        assert!(e.kind() == ErrorKind::System && e.to_string().contains("another presight"), "{e}");
    }
}
