//! The only place that opens files for reading. A pipe without a writer must not block for ever, and no file may
//! deliver more than a limit, even if the system reports a wrong size.
//!
//! A regular file is read up to its length when it was opened, so reading a growing file ends. Files that the system
//! generates on reading, such as `/proc/kmsg`, report length 0 and read as empty.

use presight_model::error::{Error, ErrorKind, Result};
use std::fs::File;
use std::io::{Read, Take};
use std::path::Path;

/// Opens a file for reading; refuses folders, devices and pipes.
pub fn open(path: &Path) -> Result<Take<File>> {
    open_as(path, path)
}

/// As [`open`]; errors name the file `shown`.
pub(crate) fn open_as(path: &Path, shown: &Path) -> Result<Take<File>> {
    // Checked before opening, because opening a pipe waits for a writer.
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(shown, "open it", e))?;
    if !metadata.is_file() && !metadata.is_dir() {
        let what = "this is a pipe or a device, not a file";
        return Err(Error::invalid(what, "write its output to a file, and name that file").in_file(shown));
    }
    open_any(path, shown)
}

/// As [`open`], but also accepts pipes passed to this process, such as `/dev/stdin` and a shell's `<(..)`.
pub(crate) fn open_or_given(path: &Path) -> Result<Take<File>> {
    let given = ["/dev/stdin", "/dev/fd", "/proc/self/fd"].iter().any(|folder| path.starts_with(folder));
    if given { open_any(path, path) } else { open(path) }
}

/// Opens a file, pipe or device that is read piece by piece. Reading a pipe or device may block.
pub fn open_any(path: &Path, shown: &Path) -> Result<Take<File>> {
    let refused = |e| Error::io(shown, "open it", e);
    let file = File::open(path).map_err(refused)?;
    let metadata = file.metadata().map_err(refused)?;
    if metadata.is_dir() {
        return Err(Error::invalid("this is a folder, not a file", "name a file in it").in_file(shown));
    }
    Ok(file.take(if metadata.is_file() { metadata.len() } else { u64::MAX }))
}

/// Reads an opened file completely; fails if it has more than `limit` bytes.
pub fn read(file: Take<File>, shown: &Path, limit: u64) -> Result<Vec<u8>> {
    read_unnamed(file, shown, limit).map_err(|e| e.in_file(shown))
}

fn read_unnamed(file: Take<File>, shown: &Path, limit: u64) -> Result<Vec<u8>> {
    let too_large = || {
        let remedy = format!("the limit is {limit}: give less, or several files");
        let what = match file.limit() {
            u64::MAX => format!("it is too large: it delivers over {limit} bytes"),
            length => format!("the file is too large: it has {length} bytes"),
        };
        Error::invalid(what, remedy)
    };
    let known = file.limit() != u64::MAX;
    if known && file.limit() > limit {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    if known {
        // At most `limit`, which fits a 64-bit usize.
        bytes.try_reserve_exact(file.limit() as usize).map_err(|_| no_memory(file.limit()))?;
    }
    let refused = |e| Error::io(shown, "read it", e);
    let over = too_large();
    file.take(limit + 1).read_to_end(&mut bytes).map_err(refused)?;
    if bytes.len() as u64 > limit { Err(over) } else { Ok(bytes) }
}

fn no_memory(bytes: u64) -> Error {
    Error::new(ErrorKind::System, format!("there is not enough memory for its {bytes} bytes"), "free some memory")
}

/// True if the file starts with these bytes; false if it cannot be read.
pub fn starts_with<const N: usize>(path: &Path, bytes: &[u8; N]) -> bool {
    let mut start = [0; N];
    open(path).is_ok_and(|mut file| file.read_exact(&mut start).is_ok()) && start == *bytes
}

/// Removes the byte order mark that some editors put before UTF-8 text.
pub fn without_mark(mut text: String) -> String {
    const MARK: char = '\u{feff}';
    if text.starts_with(MARK) {
        text.drain(..MARK.len_utf8());
    }
    text
}

/// The name of a file in its folder.
pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn files_are_held_to_the_limit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, b"12345").unwrap();
        let read_to = |limit| read(open(&path).unwrap(), &path, limit);
        assert_eq!(read_to(5).unwrap(), b"12345");
        let e = read_to(4).unwrap_err();
        assert!(e.to_string().contains("too large: it has 5 bytes") && e.remedy().contains("the limit is 4"), "{e}");
        assert!(starts_with(&path, b"123") && !starts_with(&path, b"124") && !starts_with(&path, b"123456"));
    }

    #[test]
    fn a_file_that_grows_ends() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, b"12345").unwrap();
        let opened = open(&path).unwrap();
        File::options().append(true).open(&path).unwrap().write_all(b"6789").unwrap();
        assert_eq!(read(opened, &path, 100).unwrap(), b"12345");
    }

    /// Files that the system generates on reading report length 0; reading them may block, or never end.
    #[cfg(target_os = "linux")]
    #[test]
    fn files_that_the_system_makes_up_give_nothing() {
        for path in ["/proc/self/pagemap", "/proc/kmsg", "/proc/self/maps"].map(Path::new) {
            // Missing or unreadable on some systems.
            let Ok(file) = open(path) else { continue };
            assert_eq!(read(file, path, 100).unwrap(), b"", "{}", path.display());
            assert!(!starts_with(path, b"1"));
        }
    }

    #[cfg(unix)]
    #[test]
    fn folders_devices_and_endless_pipes_are_refused() {
        let zeros = Path::new("/dev/zero");
        assert!(open(zeros).unwrap_err().to_string().contains("a pipe or a device"));
        assert!(open_any(Path::new("/"), Path::new("/")).unwrap_err().to_string().contains("a folder"));
        let e = read(open_any(zeros, zeros).unwrap(), zeros, 1000).unwrap_err();
        assert!(e.to_string().contains("it delivers over 1000 bytes"), "{e}");
    }
}
