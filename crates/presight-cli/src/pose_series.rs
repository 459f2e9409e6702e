//! The poses of a series of predictions.

use super::pose::{PoseArgs, PoseOf};
use presight::files;
use presight::sensor::ExternalPose;
use presight::tools;
use presight::{Error, Pose, Result};
use std::path::Path;

/// A pose with its time stamp as written.
pub type NamedPose = (String, ExternalPose);

/// The poses to predict at.
pub enum Poses {
    /// Poses that are known before any work.
    Given(Vec<NamedPose>),
    /// Poses that come through a pipe. An error ends them.
    Coming(Box<dyn Iterator<Item = Result<NamedPose>>>),
}

impl Poses {
    /// Reads all poses of a file. Poses of a pipe come one by one, unless `all_first`.
    ///
    /// # Errors
    /// Those of [`files::read_tum`] and [`PoseArgs::given`]; [`presight::ErrorKind::Invalid`] for a file with no poses
    /// or too many.
    pub fn read(path: &Path, meaning: &PoseArgs, of: PoseOf, all_first: bool) -> Result<Self> {
        let is_pipe = path.metadata().is_ok_and(|m| !m.is_file() && !m.is_dir());
        if is_pipe && !all_first {
            let (poses, meaning) = (files::stream_tum_with_stamps(path)?, meaning.clone());
            return Ok(Self::Coming(Box::new(poses.map(move |pose| {
                let (stamp, stamped) = pose?;
                Ok((stamp, meaning.given(stamped.pose, of)?))
            }))));
        }
        let poses = files::read_tum_with_stamps(path)?;
        if poses.is_empty() {
            return Err(no_poses(path));
        }
        if poses.len() > tools::MAX_SERIES {
            let what = format!("there are {} poses", poses.len());
            let remedy = format!("the limit is {}: split the file", tools::MAX_SERIES);
            return Err(Error::invalid(what, remedy).in_file(path));
        }
        let poses = poses.into_iter().map(|(stamp, p)| Ok((stamp, meaning.given(p.pose, of)?)));
        poses.collect::<Result<_>>().map(Self::Given)
    }

    /// Returns the poses that are known before any work.
    pub fn given(&self) -> &[NamedPose] {
        match self {
            Self::Given(poses) => poses,
            Self::Coming(_) => &[],
        }
    }

    /// The time stamps for file names.
    pub fn stamps(&self) -> Vec<&str> {
        match self {
            Self::Given(poses) => poses.iter().map(|(stamp, _)| stamp.as_str()).collect(),
            // Poses of a pipe have no files of their own, but the file of the rays belongs to all of them.
            Self::Coming(_) => vec![""],
        }
    }

    /// The poses from number `first` on, with their numbers.
    pub fn numbered(self, first: usize) -> Box<dyn Iterator<Item = Result<(usize, NamedPose)>>> {
        match self {
            Self::Given(poses) => Box::new(poses.into_iter().enumerate().skip(first).map(Ok)),
            Self::Coming(poses) => Box::new(poses.enumerate().map(|(index, pose)| Ok((index, pose?)))),
        }
    }
}

/// Reads the poses of a file that must hold at least one.
///
/// # Errors
/// Read errors; [`presight::ErrorKind::Invalid`] naming the file if it has no poses.
pub fn read_poses(path: &Path) -> Result<Vec<Pose>> {
    let poses: Vec<Pose> = files::read_tum(path)?.into_iter().map(|stamped| stamped.pose).collect();
    if poses.is_empty() { Err(no_poses(path)) } else { Ok(poses) }
}

/// The error of a pose file without a pose.
pub fn no_poses(path: &Path) -> Error {
    let remedy = "give at least one line of timestamp tx ty tz qx qy qz qw";
    Error::invalid("the file has no poses", remedy).in_file(path)
}
