//! Folders that commands write their findings into.

use presight::geometry::Pose;
use presight::io::tum;
use presight::{Error, ErrorKind, Result};
use presight_files::temporary::{Access, Temporary};
use std::path::Path;

/// Makes a folder, and a file in it that is removed again: what cannot be written is better known before minutes of work
/// than after.
///
/// # Errors
/// [`ErrorKind::System`] naming the folder, whatever the system's reason: it is no file at fault.
pub fn ready(folder: &Path) -> Result<()> {
    let refused = |what: &str, e: std::io::Error| {
        let what = format!("cannot {what}: {e}");
        Error::new(ErrorKind::System, what, "give another --out").in_file(folder).caused_by(e)
    };
    std::fs::create_dir_all(folder).map_err(|e| refused("make the folder", e))?;
    Temporary::new(folder, Access::Private).map(drop).map_err(|e| refused("write into the folder", e))
}

/// Poses from a file; there must be one at least.
///
/// # Errors
/// Those of reading; [`ErrorKind::Invalid`] naming the file if it holds none.
pub fn poses(path: &Path) -> Result<Vec<Pose>> {
    let poses: Vec<Pose> = tum::read(path)?.into_iter().map(|stamped| stamped.pose).collect();
    if poses.is_empty() {
        let remedy = "give at least one line of timestamp tx ty tz qx qy qz qw";
        return Err(Error::invalid("there is no pose", remedy).in_file(path));
    }
    Ok(poses)
}
