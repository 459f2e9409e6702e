//! The motion of the robot during a scan, by transforms at their own rate.

use crate::log::scan_motions::through;
use presight_model::error::Result;
use presight_model::measured::ScanMotion;
use presight_ros::{FrameTree, Lookup};

/// Nanoseconds per second.
const GIGA: f64 = 1e9;

/// The stamps of the first and the last ray of a scan, and its own, whichever are the outermost, nanoseconds.
pub(super) fn span_ns(stamp_ns: i64, [first, last]: [f64; 2]) -> (i64, i64) {
    let after = |seconds: f64| stamp_ns.saturating_add((seconds * GIGA).round() as i64);
    (after(first.min(0.0)), after(last.max(0.0)))
}

/// The motion during a scan from its first ray to its last, by all transforms between two frames: the robot's base and
/// one that stays. True if they cover the scan; otherwise the velocity between the two nearest transforms is returned.
///
/// # Errors
/// Errors of [`ScanMotion::along`], if these two are also too far apart.
pub(super) fn of_scan(
    tree: &FrameTree,
    (world, base): (&str, &str),
    stamp_ns: i64,
    interval: [f64; 2],
) -> Result<(ScanMotion, bool)> {
    let stamps = tree.stamps(world, base);
    let (from, to) = span_ns(stamp_ns, interval);
    // Two transforms before the scan give a velocity if none follows it.
    let start = stamps.partition_point(|t| *t <= from).saturating_sub(2);
    let end = (stamps.partition_point(|t| *t < to) + 1).min(stamps.len());
    let pose = |t: &i64| match tree.lookup(world, base, *t) {
        Lookup::Found(pose) => Some(((*t - stamp_ns) as f64 / GIGA, pose)),
        _ => None,
    };
    let poses: Vec<_> = stamps[start.min(end)..end].iter().filter_map(pose).collect();
    through(&poses, interval)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use presight_model::geometry::Pose;

    /// A robot that doubles its speed in the middle of the scan: poses at 50 Hz show the change, poses at the stamps do
    /// not. By hand: 1 m/s for 0.06 s, then 2 m/s for 0.04 s, are 0.14 m; the mean speed of the whole interval is 1.4
    /// m/s.
    #[test]
    fn transforms_at_their_own_rate_are_the_motion() {
        let x = |t: f64| t.min(0.06) + 2.0 * (t - 0.06).max(0.0);
        let at = |t: f64| Pose::from_xyz_rpy(DVec3::X * x(t), 0.0, 0.0, 0.0);
        let stamp = 1_700_000_000_000_000_000;
        let mut tree = FrameTree::default();
        for k in -5..=5 {
            tree.insert("odom", "base", stamp + k * 20_000_000, at(0.02 * k as f64), false).unwrap();
        }
        let of = |interval| of_scan(&tree, ("odom", "base"), stamp, interval);
        let (motion, reaches) = of([0.0, 0.1]).unwrap();
        for (t, truth) in [(0.0, 0.0), (0.03, 0.03), (0.06, 0.06), (0.08, 0.1), (0.1, 0.14)] {
            let found = motion.at(t).unwrap().translation.x;
            assert!(reaches && (found - truth).abs() < 1e-6, "{t}: {found}");
        }
        assert!(motion.at(0.2).is_none(), "never extrapolated");
        // Transforms that end before the scan: the last velocity is extended.
        let (motion, reaches) = of([0.05, 0.15]).unwrap();
        let ScanMotion::Twist(twist) = motion else { panic!("{motion:?}") };
        assert!(!reaches && twist.linear.distance(DVec3::X * 2.0) < 1e-6, "{twist:?}");
        assert!(of([5.0, 5.1]).is_err(), "far from the last transform");
        let mut gap = FrameTree::default();
        for (t, x) in [(0, 0.0), (600_000_000, 1.0)] {
            gap.insert("odom", "base", stamp + t, Pose::from_xyz_rpy(DVec3::X * x, 0.0, 0.0, 0.0), false).unwrap();
        }
        let e = of_scan(&gap, ("odom", "base"), stamp, [0.0, 0.1]).unwrap_err();
        assert!(e.to_string().contains("0.600 s apart"), "{e}");
        assert!(of_scan(&FrameTree::default(), ("odom", "base"), stamp, [0.0, 0.1]).is_err());
    }
}
