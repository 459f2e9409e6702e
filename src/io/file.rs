//! How files are opened: what is no file, such as a pipe that nobody writes to, must not keep us waiting for ever.

use super::inputs;
use crate::error::{Error, Result};
use std::fs::File;
use std::path::Path;

/// Opens a file to read; folders, devices and pipes are refused.
pub(crate) fn open(path: &Path) -> Result<File> {
    open_as(path, path)
}

/// As [`open`], of a file that errors know by another path.
pub(crate) fn open_as(path: &Path, shown: &Path) -> Result<File> {
    inputs::note(path);
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(shown, "open it", e))?;
    if metadata.is_dir() {
        return Err(Error::invalid("this is a folder, not a file", "name a file in it").in_file(shown));
    }
    if !metadata.is_file() {
        let what = "this is a pipe or a device, not a file";
        return Err(Error::invalid(what, "write what it gives to a file, and name that").in_file(shown));
    }
    File::open(path).map_err(|e| Error::io(shown, "open it", e))
}

/// As [`open`], but for pipes that this process was given, such as `/dev/stdin` and a shell's `<(..)`.
pub(crate) fn open_or_given(path: &Path) -> Result<File> {
    let given = ["/dev/stdin", "/dev/fd", "/proc/self/fd"].iter().any(|folder| path.starts_with(folder));
    inputs::note(path);
    if given { File::open(path).map_err(|e| Error::io(path, "open it", e)) } else { open(path) }
}

/// A text without the mark that some editors put before UTF-8.
pub(crate) fn without_mark(mut text: String) -> String {
    const MARK: char = '\u{feff}';
    if text.starts_with(MARK) {
        text.drain(..MARK.len_utf8());
    }
    text
}
