//! The motion of the robot while a scan is measured.

use crate::error::{Error, Result};
use crate::geometry::{Pose, Twist};
use glam::DQuat;
use std::sync::Arc;

/// Maximum seconds between two poses that give the motion of a scan. A robot that accelerates by 1 m/s² leaves the
/// path of constant velocity between poses that far apart by 3 cm, the noise of a lidar.
pub const MAX_POSE_GAP_S: f64 = 0.5;

/// Beyond this angle between two poses, degrees, the direction of turning is ambiguous: half a turn, less half a degree
/// for rounding in the text of a pose.
const HALF_TURN_DEG: f64 = 179.5;

/// Maximum distance of a path between its poses from the arc of constant velocity, metres: a hundredth of a lidar's
/// noise.
const MAX_SAGITTA: f64 = 1e-4;
/// Maximum number of poses of a path for each pose given.
const MAX_PIECES: usize = 64;
/// Stamps in seconds since 1970 are rounded to 0.2 microseconds.
const ROUNDING_S: f64 = 1e-6;

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
        check_ascending(&poses)?;
        Ok(Self::Path(poses.into()))
    }

    /// The motion through poses of the robot in any frame that stays, by seconds after the stamp, ascending: with a
    /// constant twist from each to the next, for the stamp and the seconds after it from the first to the last ray.
    ///
    /// # Examples
    /// ```
    /// use presight::{Pose, measured::ScanMotion};
    /// let at = |x: f64| Pose::from_xyz_rpy(glam::DVec3::X * x, 0.0, 0.0, 0.0);
    /// let motion = ScanMotion::along(&[(-0.1, at(3.0)), (0.1, at(3.4))], [0.0, 0.1])?;
    /// assert!((motion.at(0.1).unwrap().translation.x - 0.2).abs() < 1e-12);
    /// assert!(ScanMotion::along(&[(-0.1, at(3.0)), (0.1, at(3.4))], [0.0, 0.2]).is_err());
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] for fewer than two poses, for times that do not ascend, for poses that do not
    /// reach over the scan, and for a gap of more than [`MAX_POSE_GAP_S`] in it.
    pub fn along(poses: &[(f64, Pose)], [first, last]: [f64; 2]) -> Result<Self> {
        check_ascending(poses)?;
        let (from, to) = (first.min(0.0), last.max(0.0));
        let mut start = poses.partition_point(|(t, _)| *t <= from + ROUNDING_S);
        let mut end = poses.partition_point(|(t, _)| *t < to - ROUNDING_S);
        if start == 0 || end == poses.len() {
            let what = format!(
                "poses from {:.3} s to {:.3} s do not reach over the scan from {first:.3} s to {last:.3} s after the \
                 stamp",
                poses[0].0,
                poses[poses.len() - 1].0
            );
            return Err(Error::invalid(what, "give poses from before the first ray until after the last"));
        }
        start -= 1;
        // A scan at one pose takes the motion towards the next one.
        if start >= end {
            start = end.min(poses.len() - 2);
            end = start + 1;
        }
        let used = &poses[start..=end];
        if let Some(pair) = used.windows(2).find(|pair| pair[1].0 - pair[0].0 > MAX_POSE_GAP_S) {
            let what = format!("poses are {:.3} s apart during a scan", pair[1].0 - pair[0].0);
            return Err(Error::invalid(what, format!("give poses at most {MAX_POSE_GAP_S} s apart")));
        }
        let legs: Vec<Leg> = used.windows(2).map(|pair| Leg::between(&pair[0], &pair[1])).collect();
        if let [leg] = legs.as_slice() {
            return Ok(Self::Twist(leg.twist));
        }
        let at_stamp = legs.iter().rev().find(|leg| leg.start <= 0.0).unwrap_or(&legs[0]).at(0.0).inverse();
        let mut path: Vec<(f64, Pose)> = legs.iter().flat_map(Leg::pieces).collect();
        path.extend(used.last().copied());
        path.iter_mut().for_each(|(_, pose)| *pose = at_stamp * *pose);
        // Rounded stamps may begin after the first ray and end before the last.
        let ends = path.len() - 1;
        (path[0].0, path[ends].0) = (path[0].0.min(from), path[ends].0.max(to));
        Self::path(path)
    }

    /// The constant motion that leads to a pose of the robot, in its frame at the stamp, some seconds after the stamp.
    ///
    /// # Examples
    /// ```
    /// use presight::{Pose, measured::ScanMotion};
    /// let end = Pose::from_xyz_rpy(glam::DVec3::X * 0.2, 0.0, 0.0, 0.0);
    /// let motion = ScanMotion::until(&end, 0.1)?;
    /// assert!((motion.at(0.05).unwrap().translation.x - 0.1).abs() < 1e-12);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] if the seconds are not positive, or if the pose is half a turn away.
    pub fn until(end: &Pose, seconds: f64) -> Result<Self> {
        if !(seconds > 0.0) {
            let what = "there is no time between the stamp and the last ray";
            return Err(Error::usage(what, "give the twist of the robot: the scan is stamped at its last ray"));
        }
        let turned = end.rotation.angle_between(DQuat::IDENTITY).to_degrees();
        if turned > HALF_TURN_DEG {
            let what = format!("{turned:.1} degrees from the pose at the stamp: the direction of turning is ambiguous");
            return Err(Error::usage(what, "give the twist of the robot, or its trajectory"));
        }
        Ok(Self::Twist(Twist::to(end, seconds)))
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

fn check_ascending(poses: &[(f64, Pose)]) -> Result<()> {
    if poses.len() < 2 {
        let what = format!("a path of {} poses", poses.len());
        return Err(Error::invalid(what, "give at least two poses: one before the scan and one after it"));
    }
    if let Some(pair) = poses.windows(2).find(|pair| !(pair[0].0 < pair[1].0)) {
        let what = format!("a path goes from {} s to {} s", pair[0].0, pair[1].0);
        return Err(Error::invalid(what, "give finite times that ascend"));
    }
    Ok(())
}

/// Constant motion from one pose to the next.
struct Leg {
    start: f64,
    end: f64,
    from: Pose,
    twist: Twist,
}

impl Leg {
    fn between((start, from): &(f64, Pose), (end, to): &(f64, Pose)) -> Self {
        let twist = Twist::to(&(from.inverse() * *to), end - start);
        Self { start: *start, end: *end, from: *from, twist }
    }

    fn at(&self, seconds: f64) -> Pose {
        self.from * self.twist.over(seconds - self.start)
    }

    /// Poses from the start to before the end, so close that straight lines between them follow the arc.
    fn pieces(&self) -> impl Iterator<Item = (f64, Pose)> {
        let seconds = self.end - self.start;
        let sagitta = self.twist.linear.length() * self.twist.angular.length() * seconds * seconds / 8.0;
        let count = (sagitta / MAX_SAGITTA).sqrt().ceil().clamp(1.0, MAX_PIECES as f64) as usize;
        (0..count).map(move |k| self.start + seconds * k as f64 / count as f64).map(|t| (t, self.at(t)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// By hand: a robot at 2 m/s that turns by 90 degrees a second runs on a circle of radius 4 / pi. After half a
    /// second it is at (sin 45, 1 - cos 45) times the radius.
    #[test]
    fn a_motion_follows_the_arc_through_the_poses() {
        let radius = 4.0 / std::f64::consts::PI;
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let on_circle = |t: f64| {
            let angle = t * std::f64::consts::FRAC_PI_2;
            let place = DVec3::new(7.0 + radius * angle.sin(), radius * (1.0 - angle.cos()), 0.0);
            (t, Pose::from_xyz_rpy(place, 0.0, 0.0, angle))
        };
        let truth = DVec3::new(radius * half, radius * (1.0 - half), 0.0);
        let two = ScanMotion::along(&[on_circle(0.0), on_circle(0.5)], [0.0, 0.5]).unwrap();
        assert!(matches!(two, ScanMotion::Twist(_)));
        let many: Vec<_> = (-3..=3).map(|k| on_circle(0.25 * f64::from(k))).collect();
        let many = ScanMotion::along(&many, [-0.4, 0.5]).unwrap();
        for motion in [&two, &many] {
            let off = motion.at(0.5).unwrap().translation.distance(truth);
            assert!(off < 1e-9, "{motion:?}: {off}");
        }
        // Between the poses it stays on the circle.
        let centre = DVec3::new(0.0, radius, 0.0);
        for t in [-0.33, -0.1, 0.0, 0.13, 0.37] {
            let off = many.at(t).unwrap().translation.distance(centre) - radius;
            assert!(off.abs() <= MAX_SAGITTA, "{t}: {off}");
        }
        assert!(many.at(0.0).unwrap().translation.length() < 1e-9, "its own frame at the stamp");
    }

    #[test]
    fn half_a_turn_is_ambiguous() {
        let turned = |degrees: f64| Pose::from_xyz_rpy(DVec3::X, 0.0, 0.0, degrees.to_radians());
        for (end, seconds, words) in [(turned(180.0), 0.1, "ambiguous"), (turned(10.0), 0.0, "no time")] {
            let e = ScanMotion::until(&end, seconds).unwrap_err();
            assert!(e.to_string().contains(words) && e.remedy().contains("twist"), "{e}");
        }
        let Ok(ScanMotion::Twist(twist)) = ScanMotion::until(&turned(9.0), 0.1) else { panic!("a twist") };
        assert!((twist.angular.z - 90f64.to_radians()).abs() < 1e-9);
    }

    #[test]
    fn poses_that_do_not_say_the_motion_are_refused() {
        let at = |t: f64| (t, Pose::from_xyz_rpy(DVec3::X * t, 0.0, 0.0, 0.0));
        for (poses, interval, words) in [
            (vec![at(0.0)], [0.0, 0.1], "a path of 1 poses"),
            (vec![at(0.0), at(0.0)], [0.0, 0.1], "from 0 s to 0 s"),
            (vec![at(0.1), at(-0.1)], [0.0, 0.1], "from 0.1 s to -0.1 s"),
            (vec![at(0.0), at(0.09)], [0.0, 0.1], "do not reach over the scan from 0.000 s to 0.100 s"),
            (vec![at(-0.05), at(0.1)], [-0.1, 0.0], "do not reach"),
            (vec![at(-0.1), at(0.41)], [0.0, 0.1], "poses are 0.510 s apart"),
        ] {
            let e = ScanMotion::along(&poses, interval).unwrap_err();
            assert!(e.to_string().contains(words) && !e.remedy().is_empty(), "{words}: {e}");
        }
        // The motion before the stamp does not matter for a scan after it.
        assert!(ScanMotion::along(&[at(-2.0), at(0.0), at(0.1)], [0.0, 0.1]).is_ok());
        assert!(ScanMotion::along(&[at(-0.1), at(0.0)], [0.0, 0.0]).is_ok());
        assert!(ScanMotion::along(&[at(0.0), at(0.1)], [0.0, 0.0]).is_ok());
    }
}
