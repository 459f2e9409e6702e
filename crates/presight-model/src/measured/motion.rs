//! The motion of the robot while a scan is measured.

use crate::error::{Error, Result};
use crate::geometry::{Pose, Twist};
use std::sync::Arc;

/// How the robot moves while a scan is measured, relative to its pose at the stamp of the frame.
#[derive(Clone, Debug, PartialEq)]
pub enum ScanMotion {
    /// A constant twist, robot axes.
    Twist(Twist),
    /// Poses of the robot in its frame at the stamp, by seconds after the stamp, ascending; linear in the position and
    /// spherically linear in the orientation between them.
    Path(Arc<[(f64, Pose)]>),
}

impl ScanMotion {
    /// A path of at least two poses.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] for fewer poses, and for times that do not ascend or are not finite.
    pub fn path(poses: Vec<(f64, Pose)>) -> Result<Self> {
        if poses.len() < 2 {
            let what = format!("a path of {} poses", poses.len());
            return Err(Error::invalid(what, "give at least two poses: one before the scan and one after it"));
        }
        if let Some(pair) = poses.windows(2).find(|pair| !(pair[0].0 < pair[1].0)) {
            let what = format!("a path goes from {} s to {} s", pair[0].0, pair[1].0);
            return Err(Error::invalid(what, "give finite times that ascend"));
        }
        Ok(Self::Path(poses.into()))
    }

    /// The pose of the robot `seconds` after the stamp, in its frame at the stamp. `None` outside of a path.
    pub fn at(&self, seconds: f64) -> Option<Pose> {
        match self {
            Self::Twist(twist) => Some(twist.over(seconds)),
            Self::Path(poses) => {
                let next = poses.partition_point(|(t, _)| *t < seconds).clamp(1, poses.len() - 1);
                let ((t0, a), (t1, b)) = (poses[next - 1], poses[next]);
                // A path that ends with the scan may end a rounding of two stamps before it: 0.2 us in Unix time.
                let slack = 1e-6;
                let inside = (t0 - slack..=t1 + slack).contains(&seconds);
                inside.then(|| a.between(&b, (seconds - t0) / (t1 - t0)))
            }
        }
    }

    /// True if the robot stands.
    pub fn is_still(&self) -> bool {
        match self {
            Self::Twist(twist) => *twist == Twist::default(),
            Self::Path(poses) => poses.iter().all(|(_, pose)| *pose == poses[0].1),
        }
    }
}
