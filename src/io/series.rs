//! Series of many poses that can be interrupted: what is finished is recorded beside the files, and the same series goes on
//! from there.

use crate::error::{Error, ErrorKind, Result};
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

const START: &str = "presight series 1";

/// Which poses of a series are finished. The record is a file of lines: a head that names the job, then the number of each pose
/// whose files are complete. It is removed when the series is.
///
/// ```
/// use presight::io::series::SeriesProgress;
/// let folder = tempfile::tempdir()?;
/// let (record, job) = (folder.path().join("a.series"), blake3_of("hall.glb, vlp-16, 3 poses"));
/// let mut progress = SeriesProgress::open(&record, &job, 3)?;
/// progress.run(|_, i| if i < 2 { Ok(()) } else { Err(presight::Error::invalid("the disk is full", "")) }).unwrap_err();
/// drop(progress);
///
/// let mut progress = SeriesProgress::open(&record, &job, 3)?;
/// assert_eq!(progress.finished(), 2);
/// let mut done = Vec::new();
/// progress.run(|_, i| Ok(done.push(i)))?;
/// progress.complete()?;
/// assert_eq!(done, [2]);
/// assert!(!record.exists());
/// # fn blake3_of(what: &str) -> String { what.replace(|c: char| !c.is_alphanumeric(), "") }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct SeriesProgress {
    path: PathBuf,
    file: File,
    done: Vec<bool>,
    /// There was a record of another job.
    replaced: bool,
    /// When a pose was finished last, before it was opened.
    written: Option<SystemTime>,
}

impl SeriesProgress {
    /// Opens the record of a job of `count` poses, or begins one. A record of another job is begun anew: all its files count as
    /// unfinished. `job` tells what must be the same, such as a hash of scene, sensors, poses and request.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the record cannot be written, or another process is at work on it.
    pub fn open(path: &Path, job: &str, count: usize) -> Result<Self> {
        let refused = |e: std::io::Error| {
            let remedy = "create the folder first, check its permissions, or write elsewhere";
            let what = format!("cannot keep a record of what is finished: {e}");
            Error::new(ErrorKind::System, what, remedy).in_file(path).caused_by(e)
        };
        let mut file =
            File::options().read(true).write(true).create(true).truncate(false).open(path).map_err(refused)?;
        if matches!(file.try_lock(), Err(fs::TryLockError::WouldBlock)) {
            let what = "another presight is writing these files";
            return Err(Error::new(ErrorKind::System, what, "wait until it has ended, or stop it").in_file(path));
        }
        let written = file.metadata().and_then(|m| m.modified()).ok();
        let head = format!("{START} {job}");
        let (mut same, mut started, mut done) = (false, false, vec![false; count]);
        let mut sound = 0;
        let mut reader = BufReader::new(&file);
        let mut line = String::new();
        // A line without its end was being written when the process ended.
        while reader.read_line(&mut line).is_ok_and(|n| n > 0) && line.ends_with('\n') {
            let text = line.trim_end();
            match (started, text.parse::<usize>()) {
                (false, _) => same = text == head,
                (true, Ok(i)) if same && i < count => done[i] = true,
                _ => break,
            }
            (started, sound) = (true, sound + line.len() as u64);
            line.clear();
        }
        if !same {
            done.fill(false);
            sound = 0;
        }
        file.set_len(sound).and_then(|()| file.seek(SeekFrom::End(0))).map_err(refused)?;
        if !same {
            writeln!(file, "{head}").map_err(refused)?;
        }
        Ok(Self { path: path.to_owned(), file, done, replaced: started && !same, written })
    }

    /// How many poses are finished.
    pub fn finished(&self) -> usize {
        self.done.iter().filter(|done| **done).count()
    }

    /// True if the pose is finished.
    pub fn is_finished(&self, index: usize) -> bool {
        self.done.get(index).copied().unwrap_or(false)
    }

    /// True if there was a record of another job, which was never completed.
    pub fn replaced(&self) -> bool {
        self.replaced
    }

    /// When a pose was finished last. A file that was written later is not of this series any more.
    pub fn written(&self) -> Option<SystemTime> {
        self.written
    }

    /// Takes as unfinished what `is_there` says has lost its files.
    pub fn keep_if(&mut self, is_there: impl Fn(usize) -> bool) {
        for (i, done) in self.done.iter_mut().enumerate() {
            *done = *done && is_there(i);
        }
    }

    /// Does the work of every pose that is not finished, in order, and records it.
    ///
    /// # Errors
    /// The first of the work, after which nothing more is done; [`ErrorKind::System`] if the record cannot be written.
    pub fn run(&mut self, mut work: impl FnMut(&Self, usize) -> Result<()>) -> Result<()> {
        for i in 0..self.done.len() {
            if self.done[i] {
                continue;
            }
            work(self, i)?;
            self.done[i] = true;
            // One write: a line is there whole, or its pose is done again.
            self.file.write_all(format!("{i}\n").as_bytes()).map_err(|e| {
                let what = format!("cannot keep a record of what is finished: {e}");
                Error::new(ErrorKind::System, what, "free some disk space").in_file(&self.path).caused_by(e)
            })?;
        }
        Ok(())
    }

    /// Removes the record, if everything is finished.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the system refuses.
    pub fn complete(self) -> Result<()> {
        if self.done.iter().all(|done| *done) {
            drop(self.file);
            fs::remove_file(&self.path).map_err(|e| Error::io(&self.path, "remove the record", e))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(path: &Path, job: &str) -> SeriesProgress {
        SeriesProgress::open(path, job, 4).unwrap()
    }

    #[test]
    fn what_is_finished_is_not_done_again_whatever_the_end_of_the_record() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.series");
        let stop_at = |progress: &mut SeriesProgress, stop| {
            progress.run(|_, i| if i == stop { Err(Error::invalid("stop", "")) } else { Ok(()) })
        };
        let mut progress = open(&path, "j");
        assert!(!progress.replaced() && stop_at(&mut progress, 2).is_err());
        drop(progress);
        // Torn lines: without its end, cut within the digits, and of another file.
        let sound = fs::read(&path).unwrap();
        for end in [&b""[..], b"3", b"x\n3\n", b"99\n3\n", b"\xff\n3\n"] {
            fs::write(&path, [&sound[..], end].concat()).unwrap();
            let progress = open(&path, "j");
            assert_eq!((progress.finished(), progress.is_finished(1), progress.is_finished(2)), (2, true, false));
            drop(progress);
            assert_eq!(fs::read(&path).unwrap(), sound);
        }
        let other = open(&path, "k");
        assert!(other.replaced() && other.finished() == 0);
        drop(other);
        assert_eq!(open(&path, "j").finished(), 0, "the other job may have written over its files");
    }

    #[test]
    fn lost_files_are_made_again_and_the_record_goes_at_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.series");
        let mut progress = open(&path, "j");
        progress.run(|_, _| Ok(())).unwrap();
        progress.keep_if(|i| i != 1);
        let mut again = Vec::new();
        progress
            .run(|progress, i| {
                again.push((i, progress.finished()));
                Ok(())
            })
            .unwrap();
        assert_eq!(again, [(1, 3)]);
        progress.complete().unwrap();
        assert!(!path.exists());
        let unfinished = open(&path, "j");
        unfinished.complete().unwrap();
        assert!(path.exists());
    }

    #[test]
    fn two_do_not_work_on_one_series() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.series");
        let _first = open(&path, "j");
        let e = SeriesProgress::open(&path, "j", 4).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::System);
        assert!(e.to_string().contains("another presight"), "{e}");
    }
}
