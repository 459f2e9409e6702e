//! The folder that `ros2 bag record` makes: files and a `metadata.yaml` that names them.

use presight_model::error::{Error, Result};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The largest `metadata.yaml` that is read, bytes: it grows with topics and files, not with messages.
const MAX_METADATA_BYTES: u64 = 1 << 24;

#[derive(Deserialize)]
struct Metadata {
    rosbag2_bagfile_information: Information,
}

#[derive(Deserialize)]
struct Information {
    #[serde(default)]
    relative_file_paths: Vec<String>,
}

/// True if a folder has a `metadata.yaml` or a file of a bag.
pub(super) fn holds_bag(folder: &Path) -> bool {
    folder.join("metadata.yaml").is_file() || files_by_name(folder).is_ok_and(|files| !files.is_empty())
}

/// The files of a bag's folder, in the order of recording.
pub(super) fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let files = match named_files(folder)? {
        Some(files) => files,
        None => files_by_name(folder)?,
    };
    if files.is_empty() {
        let remedy = "give a folder that `ros2 bag record` made, or one of its files";
        return Err(Error::invalid("the folder holds no bag", remedy).in_file(folder));
    }
    Ok(files)
}

/// The files that `metadata.yaml` names; `None` if it is missing, or empty after a crash of the recorder.
fn named_files(folder: &Path) -> Result<Option<Vec<PathBuf>>> {
    let path = folder.join("metadata.yaml");
    let Ok(size) = std::fs::metadata(&path).map(|m| m.len()) else { return Ok(None) };
    if size == 0 || size > MAX_METADATA_BYTES {
        return Ok(None);
    }
    let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read it", e))?;
    let metadata: Metadata = serde_saphyr::from_str(&text).map_err(|e| {
        let remedy = "repair it with: ros2 bag reindex FOLDER, or delete it: the files are then taken by name";
        Error::invalid(format!("not the metadata of a bag: {e}"), remedy).in_file(&path)
    })?;
    let names = metadata.rosbag2_bagfile_information.relative_file_paths;
    // Old recorders wrote paths from the folder's parent.
    let file = |name: String| {
        let inside = folder.join(&name);
        let by_name = Path::new(&name).file_name().map(|last| folder.join(last));
        existing(&inside).or_else(|| existing(&by_name?)).unwrap_or(inside)
    };
    Ok((!names.is_empty()).then(|| names.into_iter().map(file).collect()))
}

fn ends_in(path: &Path, endings: &[&str]) -> bool {
    path.extension().is_some_and(|e| endings.iter().any(|ending| e.eq_ignore_ascii_case(ending)))
}

/// True for `.mcap` and `.db3`, and for these compressed as a whole.
pub(super) fn has_name_of_bag(path: &Path) -> bool {
    ends_in(&unpacked_name(path), &["mcap", "db3"])
}

/// The path of a file before it was compressed as a whole.
fn unpacked_name(path: &Path) -> PathBuf {
    if ends_in(path, &["zstd", "zst"]) { path.with_extension("") } else { path.to_owned() }
}

/// A file that a recording names, or the same before or after it was compressed.
fn existing(path: &Path) -> Option<PathBuf> {
    let mut packed = path.as_os_str().to_owned();
    packed.push(".zstd");
    [path.to_owned(), packed.into(), unpacked_name(path)].into_iter().find(|path| path.exists())
}

/// The files of bags in a folder, by the number before the ending, then by name.
fn files_by_name(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list the folder", e))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::io(folder, "list the folder", e))?.path();
        if has_name_of_bag(&path) {
            files.push(path);
        }
    }
    let is_double = |path: &PathBuf| unpacked_name(path) != *path && unpacked_name(path).exists();
    files.retain(|path| !is_double(path));
    files.sort_by_key(|path| {
        let stem = unpacked_name(path).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let number = stem.rsplit('_').next().and_then(|last| last.parse::<u64>().ok());
        (number, stem)
    });
    Ok(files)
}
