//! One array of the images of many poses.

use crate::npy::{Values, header, image_shape};
use presight_model::error::{Error, Result};
use presight_read::atomic::{keep_rights, open_to_replace, refused, target_of};
use presight_render::plan::{Images, Output};
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// An array of the images of many poses, written pose by pose. Its shape is (poses, rows, columns), or (poses, rows,
/// columns, 3) for vectors. Until complete, it is named `NAME.npy.unfinished`, and a later process can continue it.
#[derive(Debug)]
pub struct NpyStack {
    file: File,
    unfinished: PathBuf,
    target: PathBuf,
    path: PathBuf,
    header: Vec<u8>,
    bytes_per_pose: u64,
    descr: &'static str,
}

impl NpyStack {
    /// Continues an unfinished array if it has the size of that shape and was not modified after `until`. Otherwise, or
    /// if `until` is `None`, starts a new one and returns false.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the file cannot be written; [`presight_model::ErrorKind::Usage`] for a
    /// device or pipe.
    pub fn open(
        path: &Path,
        poses: usize,
        (width, height): (u32, u32),
        output: Output,
        until: Option<SystemTime>,
    ) -> Result<(Self, bool)> {
        let shape = [vec![poses], image_shape(width, height, output)].concat();
        Self::of_shape(path, &shape, if output.is_of_ids() { "<u4" } else { "<f4" }, until)
    }

    fn of_shape(path: &Path, shape: &[usize], descr: &'static str, until: Option<SystemTime>) -> Result<(Self, bool)> {
        if path.metadata().is_ok_and(|m| !m.is_file()) {
            let what = "an array of all poses is written piece by piece, into a file";
            return Err(Error::usage(what, "name a file, or put {i} into the name").in_file(path));
        }
        let refused = |e| refused(path, e);
        drop(open_to_replace(path)?);
        let target = target_of(path).map_err(refused)?;
        let mut name = target.clone().into_os_string();
        name.push(".unfinished");
        let unfinished = PathBuf::from(name);
        let header = header(descr, shape);
        // Cannot overflow: image sides and the number of poses are limited.
        let bytes_per_pose = shape.iter().skip(1).fold(4, |bytes, side| bytes * *side as u64);
        let length = header.len() as u64 + shape.first().map_or(1, |poses| *poses as u64) * bytes_per_pose;
        let mut file =
            File::options().read(true).write(true).create(true).truncate(false).open(&unfinished).map_err(refused)?;
        let was = file.metadata().map_err(refused)?;
        let untouched = until.zip(was.modified().ok()).is_some_and(|(until, modified)| modified <= until);
        let goes_on = untouched && was.len() == length;
        if !goes_on {
            file.set_len(0).map_err(refused)?;
            file.write_all(&header).and_then(|()| file.set_len(length)).map_err(refused)?;
        }
        Ok((Self { file, unfinished, target, path: path.to_owned(), header, bytes_per_pose, descr }, goes_on))
    }

    /// Writes an image of one pose; nothing if the images lack it.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for an image of another size or type;
    /// [`presight_model::ErrorKind::System`] for I/O errors.
    pub fn put_image(&mut self, pose: usize, images: &Images, output: Output) -> Result<()> {
        Values::of(images, output).map_or(Ok(()), |values| self.put(pose, values))
    }

    /// Writes the values of one pose.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for an image of another size or type;
    /// [`presight_model::ErrorKind::System`] for I/O errors.
    fn put(&mut self, pose: usize, values: Values<'_>) -> Result<()> {
        if values.descr() != self.descr || 4 * values.count() as u64 != self.bytes_per_pose {
            let what = format!("an image of {} {} does not fit the array", values.count(), values.descr());
            return Err(Error::invalid(what, "give images of one size and type").in_file(&self.path));
        }
        let at = self.header.len() as u64 + pose as u64 * self.bytes_per_pose;
        let mut write = || {
            self.file.seek(SeekFrom::Start(at))?;
            values.write_to(&mut self.file)
        };
        write().map_err(|e| refused(&self.path, e))
    }

    /// Gives the complete file its final name.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the system refuses.
    pub fn finish(self) -> Result<()> {
        let old = open_to_replace(&self.path)?;
        let done = || {
            if let Some(old) = old {
                keep_rights(&old, &self.file)?;
            }
            self.file.sync_all()?;
            std::fs::rename(&self.unfinished, &self.target)
        };
        done().map_err(|e| refused(&self.path, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::npy::write;

    #[test]
    fn a_stack_goes_on_where_it_was_left_and_appears_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let open = |until| NpyStack::of_shape(&path, &[3, 1, 2], "<f4", until).unwrap();
        let now = || Some(SystemTime::now());
        let (mut stack, goes_on) = open(now());
        assert!(!goes_on);
        stack.put(2, Values::F32(&[5.0, 6.0])).unwrap();
        stack.put(0, Values::F32(&[1.0, 2.0])).unwrap();
        assert!(stack.put(1, Values::F32(&[1.0])).is_err() && stack.put(1, Values::U32(&[1, 2])).is_err());
        drop(stack);
        assert!(!path.exists());
        let (mut stack, goes_on) = open(now());
        assert!(goes_on);
        stack.put(1, Values::F32(&[3.0, 4.0])).unwrap();
        stack.finish().unwrap();
        let whole = std::fs::read(&path).unwrap();
        write(&path, &[3, 1, 2], Values::F32(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), whole);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        drop(open(now()));
        assert!(!open(None).1, "of another job");
        assert!(!open(Some(SystemTime::UNIX_EPOCH)).1, "written by another");
        assert!(!NpyStack::of_shape(&path, &[4, 1, 2], "<f4", now()).unwrap().1, "of another size");
        assert_eq!(std::fs::read(&path).unwrap(), whole);
    }
}
