//! Output files that appear whole or not at all.

use super::temporary::{Access, Temporary};
use presight_model::error::{Error, ErrorKind, Result};
use std::fs::{self, File, Metadata};
use std::io::{self, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Writes a file through a temporary file in the same folder, which is filled, synced to disk and renamed. If any step
/// fails, the old file stays and the temporary file is removed.
///
/// A replaced file keeps its mode and, as far as the system allows, its owner and group; nobody gets more rights than
/// before. Links are followed, even to a file that does not exist yet. An existing target that is not a regular file
/// (`/dev/null`, a pipe, `/dev/stdout`) is not replaced: the finished bytes are written into it.
///
/// # Errors
/// [`ErrorKind::System`] naming the file, for any reason, including a missing folder and missing write permission.
pub fn write_atomically(path: &Path, fill: impl FnOnce(&mut File) -> io::Result<()>) -> Result<()> {
    let refused = |e| refused(path, e);
    match fs::metadata(path) {
        Ok(m) if m.is_dir() => return Err(refused(io::Error::from(io::ErrorKind::IsADirectory))),
        Ok(m) if !m.is_file() || is_given(path) => return write_through(path, fill).map_err(refused),
        _ => {}
    }
    let old = open_to_replace(path)?;
    let target = target_of(path).map_err(refused)?;
    let folder = target.parent().filter(|_| target.file_name().is_some());
    let folder = folder.ok_or_else(|| refused(io::Error::from(io::ErrorKind::IsADirectory)))?;
    let access = if old.is_some() { Access::Private } else { Access::Umask };
    let mut temporary = Temporary::new(folder, access).map_err(refused)?;
    let file = temporary.file();
    fill(file).map_err(refused)?;
    if let Some(old) = old {
        keep_rights(&old, file).map_err(refused)?;
    }
    file.sync_all().map_err(refused)?;
    temporary.keep_as(&target).map_err(refused)
}

/// Opens the file to be replaced, if it exists. Fails if it has no write bit, even for root, who could write it.
pub fn open_to_replace(path: &Path) -> Result<Option<File>> {
    fs::metadata(path).ok().map(|old| open_old(path, &old)).transpose()
}

fn open_old(path: &Path, old: &Metadata) -> Result<File> {
    if old.permissions().readonly() {
        let remedy = "allow writing to it first, or write elsewhere";
        return Err(Error::new(ErrorKind::System, "cannot write: the file is read-only", remedy).in_file(path));
    }
    File::options().write(true).open(path).map_err(|e| refused(path, e))
}

/// Gives a new file owner, group and mode of the file that it replaces. If the system keeps the owner from moving, only
/// the owner's rights stay, so that nobody gains any.
///
/// # Errors
/// The system's.
pub fn keep_rights(old: &File, new: &File) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
        let (was, is) = (old.metadata()?, new.metadata()?);
        let same = (was.uid(), was.gid()) == (is.uid(), is.gid());
        let kept = same || fchown(new, Some(was.uid()), Some(was.gid())).is_ok();
        let mode = if kept { was.mode() } else { was.mode() & 0o700 };
        new.set_permissions(fs::Permissions::from_mode(mode & 0o7777))
    }
    #[cfg(not(unix))]
    new.set_permissions(old.metadata()?.permissions())
}

/// The path that symbolic links lead to; it need not exist.
pub fn target_of(path: &Path) -> io::Result<PathBuf> {
    /// The limit of Linux.
    const LINKS: usize = 40;
    let mut target = path.to_owned();
    for _ in 0..LINKS {
        match fs::read_link(&target) {
            Ok(to) => target = target.parent().unwrap_or(Path::new("")).join(to),
            Err(_) => return Ok(target),
        }
    }
    Err(io::Error::other("too many levels of symbolic links"))
}

/// True for a path of an open file of this process: output is appended to it, also to a regular file.
pub fn is_given(path: &Path) -> bool {
    ["/dev/stdout", "/dev/stderr", "/dev/fd", "/proc/self/fd"].iter().any(|given| path.starts_with(given))
}

fn write_through(path: &Path, fill: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let mut finished = tempfile::tempfile()?;
    fill(&mut finished)?;
    finished.seek(SeekFrom::Start(0))?;
    io::copy(&mut finished, &mut open_through(path)?)?;
    Ok(())
}

/// Opens a device, a pipe or an open file of this process.
pub(crate) fn open_through(path: &Path) -> io::Result<File> {
    #[cfg(unix)]
    {
        use std::os::fd::AsFd;
        // Shares the open file: opening it again would overwrite a file that stdout is redirected to from its start.
        if path == Path::new("/dev/stdout") {
            return io::stdout().as_fd().try_clone_to_owned().map(File::from);
        }
        if path == Path::new("/dev/stderr") {
            return io::stderr().as_fd().try_clone_to_owned().map(File::from);
        }
    }
    File::options().write(true).append(is_given(path)).open(path)
}

/// The error of a file that cannot be written, with a remedy for its cause.
pub fn refused(path: &Path, e: io::Error) -> Error {
    use io::ErrorKind as Io;
    let remedy = match e.kind() {
        Io::NotFound | Io::NotADirectory => "create the folder first, or write elsewhere",
        Io::PermissionDenied | Io::ReadOnlyFilesystem => "check the permissions of folder and file, or write elsewhere",
        Io::IsADirectory => "name a file, not a folder",
        Io::StorageFull | Io::QuotaExceeded => "free some disk space, or write elsewhere",
        Io::FileTooLarge => "raise the file size limit (ulimit -f), or write elsewhere",
        _ => "write elsewhere, or see the system's message",
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

    /// Only root can create files of other owners.
    #[cfg(unix)]
    #[test]
    fn owner_and_group_stay_as_far_as_the_system_allows() {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, b"old").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        if chown(&path, Some(4711), Some(4712)).is_err() {
            eprintln!("skipped: only root can give files away");
            return;
        }
        write_atomically(&path, |f| {
            let now = f.metadata()?;
            assert_eq!(now.permissions().mode() & 0o777, 0o600, "nobody else may read along");
            f.write_all(b"new")
        })
        .unwrap();
        let kept = fs::metadata(&path).unwrap();
        assert_eq!((kept.uid(), kept.gid(), kept.mode() & 0o777), (4711, 4712, 0o640));
        assert_eq!(fs::read(&path).unwrap(), b"new");
    }

    #[test]
    fn a_file_that_nobody_may_write_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, b"old").unwrap();
        let mut permissions = fs::metadata(&path).unwrap().permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&path, permissions).unwrap();
        let e = write_atomically(&path, |f| f.write_all(b"new")).unwrap_err();
        assert_eq!((e.kind(), e.file()), (ErrorKind::System, Some(path.as_path())));
        assert!(e.to_string().contains("read-only"), "{e}");
        assert_eq!(fs::read(&path).unwrap(), b"old");
    }

    #[cfg(unix)]
    #[test]
    fn a_link_to_nothing_yet_is_followed() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("sub")).unwrap();
        symlink("sub/second", at("first")).unwrap();
        symlink("../file", at("sub/second")).unwrap();
        write_atomically(&at("first"), |f| f.write_all(b"new")).unwrap();
        assert_eq!(fs::read(at("file")).unwrap(), b"new");
        assert!(["first", "sub/second"].iter().all(|link| fs::symlink_metadata(at(link)).unwrap().is_symlink()));
        symlink("b", at("a")).unwrap();
        symlink("a", at("b")).unwrap();
        let e = write_atomically(&at("a"), |f| f.write_all(b"new")).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::System, "{e}");
    }
}
