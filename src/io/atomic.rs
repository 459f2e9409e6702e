//! Output files that appear whole or not at all.

use crate::error::{Error, ErrorKind, Result};
use std::fs::{self, File};
use std::io::{self, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Writes a file through a temporary one in the same folder: filled, synced to the disk, then renamed. Whatever goes
/// wrong before, the final name keeps what it held, and the temporary file is removed.
///
/// A target that exists and is no regular file (`/dev/null`, a pipe) is never renamed over: it gets the finished
/// bytes.
///
/// ```
/// use presight::io::atomic::write_atomically;
/// use std::io::Write;
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("a.txt");
/// write_atomically(&path, |file| file.write_all(b"whole"))?;
/// assert_eq!(std::fs::read(&path)?, b"whole");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`ErrorKind::System`] naming the file, whatever the system's reason: for an output a folder that is not there is
/// no fault of a file.
pub fn write_atomically(path: &Path, fill: impl FnOnce(&mut File) -> io::Result<()>) -> Result<()> {
    let refused = |e| refused(path, e);
    let target = fs::metadata(path);
    match &target {
        Ok(m) if m.is_dir() => return Err(refused(io::Error::from(io::ErrorKind::IsADirectory))),
        Ok(m) if !m.is_file() => return write_through(path, fill).map_err(refused),
        _ => {}
    }
    // A link stays a link: what it points to is replaced.
    let path = if target.is_ok() { fs::canonicalize(path).map_err(refused)? } else { path.to_owned() };
    let mut temporary = temporary_beside(&path).map_err(refused)?;
    fill(temporary.as_file_mut()).map_err(refused)?;
    temporary.as_file().sync_all().map_err(refused)?;
    temporary.persist(&path).map_err(|e| refused(e.error))?;
    Ok(())
}

fn temporary_beside(path: &Path) -> io::Result<tempfile::NamedTempFile> {
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder.to_owned(),
        _ => PathBuf::from("."),
    };
    if path.file_name().is_none() {
        return Err(io::Error::from(io::ErrorKind::IsADirectory));
    }
    let mut builder = tempfile::Builder::new();
    builder.prefix(".presight-").suffix(".part");
    // Temporary files are private by default; an output gets what the user's umask leaves of 0666.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}

fn write_through(path: &Path, fill: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let mut finished = tempfile::tempfile()?;
    fill(&mut finished)?;
    finished.seek(SeekFrom::Start(0))?;
    let mut device = fs::OpenOptions::new().write(true).open(path)?;
    io::copy(&mut finished, &mut device)?;
    Ok(())
}

fn refused(path: &Path, e: io::Error) -> Error {
    use io::ErrorKind as Io;
    let remedy = match e.kind() {
        Io::NotFound | Io::NotADirectory => "create the folder first, or write elsewhere",
        Io::PermissionDenied | Io::ReadOnlyFilesystem => "check the folder's permissions, or write elsewhere",
        Io::IsADirectory => "name a file, not a folder",
        Io::StorageFull | Io::QuotaExceeded | Io::FileTooLarge => "free some disk space, or write elsewhere",
        _ => "write elsewhere, or see what the system says",
    };
    Error::new(ErrorKind::System, format!("cannot write: {e}"), remedy).in_file(path).caused_by(e)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn names_in(folder: &Path) -> Vec<String> {
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        write_atomically(&path, |f| f.write_all(b"old")).unwrap();
        let e = write_atomically(&path, |f| {
            f.write_all(b"half")?;
            Err(io::Error::from(io::ErrorKind::StorageFull))
        })
        .unwrap_err();
        assert_eq!(e.kind(), ErrorKind::System);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names_in(folder.path()), ["a"]);
    }

    #[test]
    fn unwritable_targets_are_the_systems_refusal() {
        let folder = tempfile::tempdir().unwrap();
        let no_folder = folder.path().join("none/a");
        for path in [no_folder.as_path(), folder.path(), Path::new("/proc/none/a"), Path::new("")] {
            let e = write_atomically(path, |f| f.write_all(b"x")).unwrap_err();
            assert_eq!(e.kind(), ErrorKind::System, "{e}");
            assert!(!e.remedy().is_empty());
        }
        assert!(names_in(folder.path()).is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn links_and_devices_stay_what_they_are() {
        use std::os::unix::fs::{FileTypeExt, PermissionsExt};
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, b"old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write_atomically(&link, |f| f.write_all(b"new")).unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o600, 0o600);
        write_atomically(Path::new("/dev/null"), |f| f.write_all(b"gone")).unwrap();
        assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    }
}
