//! Tables of results (CSV) that grow row by row, go on where they were stopped, and appear whole under their name.

use super::atomic::refused;
use crate::error::{Error, ErrorKind, Result};
use std::fs::{self, File, TryLockError};
use std::io::{self, BufRead, BufReader, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A table in progress, kept beside its final name with the ending `.part`. Each row begins with the number of its item and a
/// comma, and each item has the same number of rows.
#[derive(Debug)]
pub struct Rows {
    path: PathBuf,
    part: PathBuf,
    file: File,
    next: usize,
}

impl Rows {
    /// Opens the table of some items, or begins it. `None` if it is finished. Rows that an earlier process left stay as far as they
    /// are complete and `is_there` says that their item's files are.
    ///
    /// ```
    /// use presight::io::rows::Rows;
    /// let folder = tempfile::tempdir()?;
    /// let path = folder.path().join("poses.csv");
    /// let open = || Rows::open(&path, "pose,value", 0..2, 1, |_| true);
    /// let mut rows = open()?.expect("it is new");
    /// rows.append(0, "0,1.5\n")?;
    /// drop(rows);
    ///
    /// let mut rows = open()?.expect("it is not finished");
    /// assert_eq!(rows.next(), 1);
    /// rows.append(1, "1,2.5\n")?;
    /// assert!(!path.exists());
    /// rows.finish()?;
    /// assert_eq!(std::fs::read_to_string(&path)?, "pose,value\n0,1.5\n1,2.5\n");
    /// assert!(open()?.is_none());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the table cannot be written, or another process is writing it.
    pub fn open(
        path: &Path,
        header: &str,
        items: Range<usize>,
        rows_per_item: usize,
        is_there: impl Fn(usize) -> bool,
    ) -> Result<Option<Self>> {
        if path.exists() {
            return Ok(None);
        }
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".part");
        let part = path.with_file_name(name);
        let failed = |e| refused(&part, e);
        let opened = File::options().read(true).write(true).create(true).truncate(false).open(&part);
        let mut file = opened.map_err(failed)?;
        if matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
            let remedy = "wait until it has ended, or stop it";
            return Err(Error::new(ErrorKind::System, "another presight is writing it", remedy).in_file(&part));
        }
        let (next, sound) = complete(&file, header, items, rows_per_item, is_there).map_err(failed)?;
        file.set_len(sound).and_then(|()| file.seek(SeekFrom::End(0))).map_err(failed)?;
        if sound == 0 {
            file.write_all(format!("{header}\n").as_bytes()).map_err(failed)?;
        }
        Ok(Some(Self { path: path.to_owned(), part, file, next }))
    }

    /// The first item that is missing.
    pub fn next(&self) -> usize {
        self.next
    }

    /// Adds all rows up to those of an item; each ends its line.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if they cannot be written; what of them is there is dropped by the next [`Rows::open`].
    pub fn append(&mut self, last: usize, rows: &str) -> Result<()> {
        self.file.write_all(rows.as_bytes()).map_err(|e| refused(&self.part, e))?;
        self.next = last + 1;
        Ok(())
    }

    /// Gives the table its name.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the system refuses.
    pub fn finish(self) -> Result<()> {
        self.file.sync_all().and_then(|()| fs::rename(&self.part, &self.path)).map_err(|e| refused(&self.path, e))
    }
}

/// The first item that is missing, and the bytes before it; 0 bytes where the header is another one.
fn complete(
    file: &File,
    header: &str,
    items: Range<usize>,
    rows_per_item: usize,
    is_there: impl Fn(usize) -> bool,
) -> io::Result<(usize, u64)> {
    let mut reader = BufReader::new(file);
    let mut line = Vec::new();
    let mut next_line = |line: &mut Vec<u8>| -> io::Result<bool> {
        line.clear();
        // A line without its end was being written when the process ended.
        Ok(reader.read_until(b'\n', line)? > 0 && line.ends_with(b"\n"))
    };
    if !next_line(&mut line)? || line != format!("{header}\n").as_bytes() {
        return Ok((items.start, 0));
    }
    let mut sound = line.len() as u64;
    for item in items.clone() {
        let start = format!("{item},");
        let mut bytes = 0;
        for _ in 0..rows_per_item {
            if !next_line(&mut line)? || !line.starts_with(start.as_bytes()) {
                return Ok((item, sound));
            }
            bytes += line.len() as u64;
        }
        if !is_there(item) {
            return Ok((item, sound));
        }
        sound += bytes;
    }
    Ok((items.end, sound))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_go_on_after_the_last_complete_item_whatever_follows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let part = folder.path().join("a.csv.part");
        let whole = "pose,value\n4,1\n4,2\n5,1\n5,2\n";
        let ends = ["", "6", "6,1\n", "6,1\n6,2", "7,1\n7,2\n", "x\n", "6,1\n7,2\n"];
        for end in ends {
            fs::write(&part, format!("{whole}{end}")).unwrap();
            let rows = Rows::open(&path, "pose,value", 4..9, 2, |_| true).unwrap().unwrap();
            assert_eq!(rows.next(), 6, "{end:?}");
            drop(rows);
            assert_eq!(fs::read_to_string(&part).unwrap(), whole);
        }
        // The files of item 5 are gone; another table's header.
        let rows = Rows::open(&path, "pose,value", 4..9, 2, |item| item != 5).unwrap().unwrap();
        assert_eq!(rows.next(), 5);
        drop(rows);
        let rows = Rows::open(&path, "pose,other", 4..9, 2, |_| true).unwrap().unwrap();
        assert_eq!(rows.next(), 4);
        let e = Rows::open(&path, "pose,other", 4..9, 2, |_| true).unwrap_err();
        assert!(e.kind() == ErrorKind::System && e.to_string().contains("another presight"), "{e}");
        rows.finish().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "pose,other\n");
    }
}
