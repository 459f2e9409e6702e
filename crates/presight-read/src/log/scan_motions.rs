//! The motion of the robot during each scan, from poses and odometry of the neighbouring frames.

use super::Observation;
use super::notices::Notices;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, Twist};
use presight_model::measured::{MAX_POSE_GAP_S, ScanMotion};

/// The source of the motion of scans for frames without their own.
#[derive(Clone, Debug, Default)]
pub(super) enum Source {
    /// Odometry between neighbouring frames.
    #[default]
    Odometry,
    /// The log's reference poses, then odometry.
    Reference,
    /// Poses of the robot by time, then odometry.
    Trajectory(Vec<(f64, Pose)>),
}

/// Gives frames the motion of the robot during their scans.
#[derive(Debug)]
pub(super) struct ScanMotions {
    pub source: Source,
    /// True if a frame's own motion comes from odometry, to which poses are preferred.
    pub own_is_odometry: bool,
    before: Option<(f64, Option<Pose>)>,
    notices: Notices,
    has_unknown: bool,
    has_beyond: bool,
}

impl ScanMotions {
    pub fn new(notices: Notices) -> Self {
        Self {
            source: Source::default(),
            own_is_odometry: false,
            before: None,
            notices,
            has_unknown: false,
            has_beyond: false,
        }
    }

    /// True if the motion of a frame also depends on the next frame: of a scan after its stamp, and of the first frame.
    pub fn needs_next(&self, now: &Observation) -> bool {
        let [_, last] = now.frame.sensor().scan_interval();
        let by_trajectory = matches!(self.source, Source::Trajectory(_)) && now.frame.motion.is_none();
        (last > 0.0 || self.before.is_none()) && self.is_sought(now) && !by_trajectory
    }

    fn is_sought(&self, now: &Observation) -> bool {
        let may_give_way = self.own_is_odometry && !matches!(self.source, Source::Odometry);
        let sensor = now.frame.sensor();
        !sensor.spec().times.is_at_once() && (now.frame.scan_motion().is_none() || may_give_way)
    }

    /// Adds the motion to a frame that takes time and does not bring its own.
    pub fn moved(&mut self, mut now: Observation, next: Option<&Observation>) -> Observation {
        if self.is_sought(&now) {
            match self.find(&now, next) {
                Ok(motion) => now.frame = now.frame.with_scan_motion(motion),
                Err(why) if now.frame.scan_motion().is_none() => self.say_unknown(&now, why.as_ref()),
                Err(_) => {}
            }
        }
        let reference = now.reference.map(|robot| robot.world_from_robot());
        self.before = Some((now.frame.stamp, reference));
        now
    }

    /// The motion; the reason why it is not known, if poses are there.
    fn find(&mut self, now: &Observation, next: Option<&Observation>) -> Result<ScanMotion, Option<Error>> {
        let (stamp, interval) = (now.frame.stamp, now.frame.sensor().scan_interval());
        let mut why = None;
        for poses in [self.poses(now, next), self.driven(now, next)] {
            if poses.len() < 2 {
                continue;
            }
            match through(&poses, interval) {
                Ok((motion, reaches)) => {
                    if !reaches && !std::mem::replace(&mut self.has_beyond, true) {
                        let what = "the velocity between the two nearest poses is taken";
                        self.notices.add(format!("no pose lies beyond the scan at {stamp} s: {what}"));
                    }
                    return Ok(motion);
                }
                Err(e) => why = why.or(Some(e)),
            }
        }
        Err(why)
    }

    /// Poses of the robot around a frame that are better than odometry, by seconds after its stamp.
    fn poses(&self, now: &Observation, next: Option<&Observation>) -> Vec<(f64, Pose)> {
        let stamp = now.frame.stamp;
        match &self.source {
            Source::Odometry => Vec::new(),
            Source::Reference => {
                let of = |o: &Observation| Some((o.frame.stamp - stamp, o.reference?.world_from_robot()));
                let before = self.before.and_then(|(time, pose)| Some((time - stamp, pose?)));
                [before, of(now), next.and_then(of)].into_iter().flatten().collect()
            }
            Source::Trajectory(poses) => {
                let [first, last] = now.frame.sensor().scan_interval();
                let from = stamp + first.min(0.0) - MAX_POSE_GAP_S;
                let to = stamp + last.max(0.0) + MAX_POSE_GAP_S;
                let used = poses.partition_point(|(t, _)| *t < from)..poses.partition_point(|(t, _)| *t <= to);
                poses[used].iter().map(|(t, pose)| (t - stamp, *pose)).collect()
            }
        }
    }

    /// Poses of the robot at the frame and its neighbours by odometry, in its frame at the stamp.
    fn driven(&self, now: &Observation, next: Option<&Observation>) -> Vec<(f64, Pose)> {
        let stamp = now.frame.stamp;
        let before = self.before.zip(now.frame.motion);
        let before = before.map(|((time, _), motion)| (time - stamp, motion.previous_from_current.inverse()));
        let after = next.and_then(|o| Some((o.frame.stamp - stamp, o.frame.motion?.previous_from_current)));
        [before, Some((0.0, Pose::IDENTITY)), after].into_iter().flatten().collect()
    }

    fn say_unknown(&mut self, now: &Observation, why: Option<&Error>) {
        if std::mem::replace(&mut self.has_unknown, true) {
            return;
        }
        let [first, last] = now.frame.sensor().scan_interval();
        let why = why.map_or_else(String::new, |why| format!(" ({why})"));
        self.notices.add(format!(
            "the scan at {} s takes {:.3} s, and the log does not give the robot's motion during it{why}: unless it is \
             estimated, all rays are taken as measured from one pose",
            now.frame.stamp,
            last - first
        ));
    }
}

/// The motion through poses by seconds after the stamp, and true if they reach over the scan. If they do not, it is the
/// twist between the two poses that are nearest to the middle of the scan.
///
/// # Errors
/// Errors of [`ScanMotion::along`], if these two are also too far apart.
pub(super) fn through(poses: &[(f64, Pose)], interval: [f64; 2]) -> Result<(ScanMotion, bool)> {
    let e = match ScanMotion::along(poses, interval) {
        Ok(motion) => return Ok((motion, true)),
        Err(e) => e,
    };
    let middle = 0.5 * (interval[0] + interval[1]);
    let distance = |pair: &[(f64, Pose)]| (pair[0].0 - middle).max(middle - pair[1].0).max(0.0);
    let nearest = poses.windows(2).min_by(|a, b| distance(a).total_cmp(&distance(b)));
    // The difference is below 0 for times that fall.
    let is_near = |pair: &&[(f64, Pose)]| {
        let apart = pair[1].0 - pair[0].0;
        apart > 0.0 && apart <= MAX_POSE_GAP_S && distance(pair) <= MAX_POSE_GAP_S
    };
    let Some([(t0, a), (t1, b)]) = nearest.filter(is_near) else { return Err(e) };
    Ok((ScanMotion::Twist(Twist::to(&(a.inverse() * *b), t1 - t0)), false))
}

#[cfg(test)]
mod tests;
