//! Trajectories: poses over time, from which the motion during each scan follows.

use super::{MAX_POSE_GAP_S, ScanMotion};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::plausible::check_stamp;

/// Poses of the robot over time, linear in the position and spherically linear in the orientation between them.
///
/// ```
/// use presight::measured::Trajectory;
/// use presight::Pose;
/// let ahead = |x: f64| Pose::from_xyz_rpy(glam::DVec3::X * x, 0.0, 0.0, 0.0);
/// let drive = Trajectory::new(vec![(10.0, ahead(0.0)), (10.2, ahead(0.4))])?;
/// // A scan from 10.05 s to 10.15 s, stamped at its start: 0.2 m on.
/// let motion = drive.scan(10.05, [0.0, 0.1])?;
/// assert!((motion.at(0.1).unwrap().translation.x - 0.2).abs() < 1e-12);
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory(Vec<(f64, Pose)>);

impl Trajectory {
    /// World from robot by stamps in seconds.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] for fewer than two poses, and for stamps that do not ascend or are in nanoseconds.
    pub fn new(poses: Vec<(f64, Pose)>) -> Result<Self> {
        if poses.len() < 2 {
            let what = format!("a trajectory of {} poses", poses.len());
            return Err(Error::invalid(
                what,
                "give at least two poses: one before the first ray and one after the last",
            ));
        }
        poses.iter().try_for_each(|(stamp, _)| check_stamp(*stamp))?;
        if let Some(pair) = poses.windows(2).find(|pair| !(pair[0].0 < pair[1].0)) {
            let what = format!("the trajectory goes back from {} s to {} s", pair[0].0, pair[1].0);
            return Err(Error::invalid(what, "sort its poses by time, without duplicates"));
        }
        Ok(Self(poses))
    }

    /// World from robot at a stamp.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] for a stamp outside of the trajectory or in a gap of over 0.5 s.
    pub fn at(&self, stamp: f64) -> Result<Pose> {
        let knots = self.around(stamp, [0.0; 2])?;
        let next = knots.partition_point(|(t, _)| *t < stamp).clamp(1, knots.len() - 1);
        let ((t0, a), (t1, b)) = (knots[next - 1], knots[next]);
        Ok(a.between(&b, (stamp - t0) / (t1 - t0)))
    }

    /// The motion during a scan whose first and last rays are measured `interval` seconds after its stamp.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the scan reaches out of the trajectory or over a gap of more than 0.5 s.
    pub fn scan(&self, stamp: f64, interval: [f64; 2]) -> Result<ScanMotion> {
        let knots = self.around(stamp, interval)?;
        let from_world = self.at(stamp)?.inverse();
        ScanMotion::path(knots.iter().map(|(t, pose)| (t - stamp, from_world * *pose)).collect())
    }

    /// The poses around a scan.
    fn around(&self, stamp: f64, interval: [f64; 2]) -> Result<&[(f64, Pose)]> {
        check_stamp(stamp)?;
        let ([first, last], poses) = (interval.map(|s| stamp + s), &self.0);
        let [begin, end] = [poses[0].0, poses[poses.len() - 1].0];
        // A trajectory that ends with the scan may end a rounding before it.
        let slack = 1e-6;
        if !(begin - slack <= first.min(stamp) && last.max(stamp) <= end + slack) {
            let what = format!("a scan from {first} s to {last} s is outside of the trajectory, {begin} s to {end} s");
            return Err(Error::invalid(
                what,
                "give poses from before the first ray until after the last, on one clock",
            ));
        }
        let from = poses.partition_point(|(t, _)| *t <= first.min(stamp)).clamp(1, poses.len() - 1) - 1;
        let to = poses.partition_point(|(t, _)| *t < last.max(stamp)).clamp(from + 1, poses.len() - 1);
        let knots = &poses[from..=to];
        if let Some(pair) = knots.windows(2).find(|pair| pair[1].0 - pair[0].0 > MAX_POSE_GAP_S) {
            let what = format!("the trajectory has no pose between {} s and {} s, during a scan", pair[0].0, pair[1].0);
            return Err(Error::invalid(what, format!("give a pose at least every {MAX_POSE_GAP_S} s")));
        }
        Ok(knots)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn at(x: f64, yaw: f64) -> Pose {
        Pose::from_xyz_rpy(DVec3::new(x, 0.0, 0.0), 0.0, 0.0, yaw)
    }

    /// By hand: 1 m in 0.2 s and a quarter turn; halfway, 0.5 m ahead and an eighth of a turn.
    #[test]
    fn poses_between_are_on_the_line_and_the_arc() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let drive =
            Trajectory::new(vec![(5.0, at(0.0, 0.0)), (5.2, at(1.0, quarter)), (5.4, at(1.0, quarter))]).unwrap();
        let middle = drive.at(5.1).unwrap();
        assert!(middle.translation.distance(DVec3::X * 0.5) < 1e-12);
        assert!((middle.rotation * DVec3::X).distance(DVec3::new(0.5f64.sqrt(), 0.5f64.sqrt(), 0.0)) < 1e-12);
        // From its own pose at 5.2 s, where it looks along y, the robot came from 1 m on its left.
        let motion = drive.scan(5.2, [-0.2, 0.1]).unwrap();
        assert!(motion.at(-0.2).unwrap().translation.distance(DVec3::Y) < 1e-12);
        assert!(motion.at(0.1).unwrap().translation.length() < 1e-12);
    }

    #[test]
    fn bad_trajectories_are_refused_with_a_remedy() {
        let said = |poses: Vec<(f64, Pose)>, stamp: f64| {
            let scan = Trajectory::new(poses).and_then(|t| t.scan(stamp, [0.0, 0.1]));
            let e = scan.unwrap_err();
            assert!(!e.remedy().is_empty());
            e.to_string()
        };
        let still = Pose::IDENTITY;
        let sound = |from: f64| (0..20).map(|i| (from + 0.1 * f64::from(i), still)).collect::<Vec<_>>();
        assert!(Trajectory::new(sound(1.0)).unwrap().scan(1.3, [0.0, 0.1]).is_ok());
        assert!(said(vec![(1.0, still)], 1.0).contains("a trajectory of 1 poses"));
        assert!(said(vec![(2.0, still), (1.0, still)], 1.0).contains("goes back"));
        assert!(said(sound(1.0), 2.85).contains("outside of the trajectory"));
        assert!(said(sound(1.0), 0.9).contains("outside of the trajectory"));
        assert!(said(vec![(1.0, still), (1.6, still)], 1.2).contains("no pose between"));
        assert!(said(sound(1.7e18), 1.7e18).contains("nanoseconds"));
        assert!(said(sound(1.0), 1.7e18).contains("nanoseconds"));
    }
}
