//! Output folders of commands.

use presight::files;
use presight::tools::{Access, Temporary};
use presight::{Error, ErrorKind, Pose, Result};
use std::path::Path;

/// Creates a folder and checks that it is writable, so that a command fails before minutes of work, not after.
///
/// # Errors
/// [`ErrorKind::System`] naming the folder, whatever the cause: no input file is at fault.
pub fn ready(folder: &Path) -> Result<()> {
    let refused = |what: &str, e: std::io::Error| {
        let what = format!("cannot {what}: {e}");
        Error::new(ErrorKind::System, what, "choose another --out").in_file(folder).caused_by(e)
    };
    std::fs::create_dir_all(folder).map_err(|e| refused("create the folder", e))?;
    Temporary::new(folder, Access::Private).map(drop).map_err(|e| refused("write into the folder", e))
}

/// Reads poses from a file that must hold at least one.
///
/// # Errors
/// Read errors; [`ErrorKind::Invalid`] naming the file if it has no poses.
pub fn poses(path: &Path) -> Result<Vec<Pose>> {
    let poses: Vec<Pose> = files::read_tum(path)?.into_iter().map(|stamped| stamped.pose).collect();
    if poses.is_empty() {
        let remedy = "give at least one line of timestamp tx ty tz qx qy qz qw";
        return Err(Error::invalid("the file has no poses", remedy).in_file(path));
    }
    Ok(poses)
}
