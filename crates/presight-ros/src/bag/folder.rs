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
        if inside.exists() { inside } else { by_name.filter(|path| path.exists()).unwrap_or(inside) }
    };
    Ok((!names.is_empty()).then(|| names.into_iter().map(file).collect()))
}

/// The `.mcap` and `.db3` files of a folder, by the number before the ending, then by name.
fn files_by_name(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list the folder", e))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::io(folder, "list the folder", e))?.path();
        if path.extension().is_some_and(|e| e == "mcap" || e == "db3") {
            files.push(path);
        }
    }
    files.sort_by_key(|path| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let number = stem.rsplit('_').next().and_then(|last| last.parse::<u64>().ok());
        (number, stem)
    });
    Ok(files)
}
