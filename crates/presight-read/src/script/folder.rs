//! The scene's folder: scripts cannot read files outside it.

use crate::file;
use presight_model::error::{Error, Result};
use presight_model::limits;
use std::path::{Component, Path, PathBuf};

/// A folder with symbolic links resolved.
#[derive(Clone, Debug, Default)]
pub(super) struct Folder {
    /// `None` for a script in memory, which cannot read files.
    real: Option<PathBuf>,
    /// Relative to the given path of the script, for messages.
    shown: PathBuf,
}

impl Folder {
    /// The folder that holds a script.
    pub fn of(script: &Path) -> Result<Self> {
        let shown = script.parent().unwrap_or(Path::new("")).to_owned();
        let folder = if shown.as_os_str().is_empty() { Path::new(".") } else { &shown };
        let real = folder.canonicalize().map_err(|e| Error::io(script, "open its folder", e))?;
        Ok(Self { real: Some(real), shown })
    }

    /// The folder, with symbolic links resolved.
    pub fn real(&self) -> Option<&Path> {
        self.real.as_deref()
    }

    /// The path of a file in it, for messages, and the path with symbolic links resolved.
    pub fn file(&self, relative: &str) -> Result<(PathBuf, PathBuf)> {
        let outside = |what: &str| {
            let remedy = "put the file into the folder of the scene script or below, and give its path relative to it";
            Error::invalid(format!("{relative:?} {what}"), remedy)
        };
        let path = Path::new(relative);
        let plain = path.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
        if relative.is_empty() || !plain {
            return Err(outside("is not a path inside the scene's folder"));
        }
        let Some(folder) = &self.real else {
            let remedy = "open the script from its file, or put everything into the script";
            return Err(Error::invalid(
                format!("{relative:?} is a file, which a script in memory cannot read"),
                remedy,
            ));
        };
        let shown = self.shown.join(path);
        let real = folder.join(path).canonicalize().map_err(|e| Error::io(&shown, "open it", e))?;
        if !real.starts_with(folder) {
            return Err(outside("leads out of the scene's folder"));
        }
        Ok((shown, real))
    }
}

/// Reads the text of a script.
pub(super) fn read_script(shown: &Path, real: &Path) -> Result<String> {
    text_of(file::read(file::open_as(real, shown)?, shown, limits::MAX_SCRIPT_BYTES)?)
}

/// The text of a script in memory.
pub(super) fn script_of(bytes: &[u8]) -> Result<String> {
    if bytes.len() as u64 > limits::MAX_SCRIPT_BYTES {
        let what = format!("the script is too large: it has {} bytes", bytes.len());
        return Err(Error::invalid(what, format!("the limit is {}", limits::MAX_SCRIPT_BYTES)));
    }
    text_of(bytes.to_vec())
}

fn text_of(bytes: Vec<u8>) -> Result<String> {
    String::from_utf8(bytes).map(file::without_mark).map_err(|e| {
        let good = e.utf8_error().valid_up_to();
        let before = &e.as_bytes()[..good];
        let line = 1 + before.iter().filter(|b| **b == b'\n').count();
        let start = before.iter().rposition(|b| *b == b'\n').map_or(0, |p| p + 1);
        let column = 1 + String::from_utf8_lossy(&before[start..]).chars().count();
        Error::invalid("this is not UTF-8", "save the script as UTF-8 text").at(format!("line {line}, column {column}"))
    })
}
