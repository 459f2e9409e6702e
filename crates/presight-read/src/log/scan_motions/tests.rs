use super::super::{Frames, LogFrame, lines};
use super::*;
use crate::tum::StampedPose;
use glam::DVec3;
use presight_model::geometry::RobotPose;
use presight_model::sensor::{Angles, Geometry, RayTimes, Scanner, SensorSpec, StampAt};
use std::f64::consts::{FRAC_PI_2, PI};

const BEAMS: u32 = 360;

/// A scanner that looks back first and turns left.
fn scanner(times: RayTimes) -> SensorSpec {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 1.0, count: BEAMS };
    let scanner = Scanner { azimuth, elevation: Angles::Listed(vec![0.0]), beam_height_deg: None };
    SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner)).with_times(times)
}

/// The frames of a log of format 1, and its notices.
fn read(spec: &SensorSpec, frames: &[LogFrame], with: impl Fn(Frames) -> Frames) -> (Vec<Observation>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.jsonl");
    let text: String = frames.iter().map(|frame| lines::line(frame).unwrap() + "\n").collect();
    std::fs::write(&path, format!("{}\n{text}", lines::header(spec))).unwrap();
    let mut log = with(Frames::open(&path, None, &Default::default()).unwrap());
    let frames = log.by_ref().map(Result::unwrap).collect();
    (frames, log.notices())
}

fn lines_at(stamps: &[f64], odometry: Option<Pose>) -> Vec<LogFrame> {
    let frame = |(i, time): (usize, &f64)| LogFrame {
        odometry: odometry.filter(|_| i > 0),
        ..LogFrame::new(*time, vec![2.0; BEAMS as usize])
    };
    stamps.iter().enumerate().map(frame).collect()
}

/// By hand: every half second a quarter of a circle of radius 1 m, so pi m/s and pi rad/s; after a quarter of a second
/// the robot is at (sin 45, 1 - cos 45) and has turned by 45 degrees.
#[test]
fn odometry_is_the_motion_of_the_scan_that_it_covers() {
    let quarter = Pose::from_xyz_rpy(DVec3::new(1.0, 1.0, 0.0), 0.0, 0.0, FRAC_PI_2);
    let spec = scanner(RayTimes::turning(0.3, StampAt::First));
    let (frames, notices) = read(&spec, &lines_at(&[0.0, 0.5, 1.0], Some(quarter)), |f| f);
    for o in &frames {
        let Some(ScanMotion::Twist(twist)) = o.frame.scan_motion() else { panic!("{:?}", o.frame.scan_motion()) };
        assert!(
            twist.linear.distance(DVec3::X * PI) < 1e-9 && twist.angular.distance(DVec3::Z * PI) < 1e-9,
            "{twist:?}"
        );
        let at = o.frame.scan_motion().unwrap().at(0.25).unwrap();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!(at.translation.distance(DVec3::new(half, 1.0 - half, 0.0)) < 1e-9, "{at:?}");
    }
    assert!(notices.iter().any(|n| n.contains("no pose lies beyond the scan at 1 s")), "{notices:?}");
    // The odometry of a frame that accelerates is that of the time behind it: the next one's covers the scan.
    let mut lines = lines_at(&[0.0, 0.5, 1.0], Some(quarter));
    lines[2].odometry = Some(Pose::IDENTITY);
    let (frames, _) = read(&spec, &lines, |f| f);
    assert!(frames[1].frame.scan_motion().unwrap().is_still(), "planted: the odometry of the frame itself");
    // For stamps of the last ray it is the frame's own; times count from there.
    let before: Vec<f32> = (0..BEAMS).map(|c| 0.3 * (c as f32 / BEAMS as f32 - 1.0)).collect();
    lines.iter_mut().for_each(|line| line.times = Some(before.clone()));
    let (frames, notices) = read(&scanner(RayTimes::AtOnce), &lines, |f| f);
    assert!(frames[2].frame.scan_motion().unwrap().is_still() && !frames[1].frame.scan_motion().unwrap().is_still());
    // The first frame takes the motion after it, because the motion before it is unknown.
    assert!(notices.iter().any(|n| n.contains("no pose lies beyond the scan at 0 s")), "{notices:?}");
}

#[test]
fn an_unknown_motion_is_noticed_once() {
    let turning = scanner(RayTimes::turning(0.1, StampAt::First));
    let (frames, notices) = read(&turning, &lines_at(&[0.0, 0.1, 0.2], None), |f| f);
    assert!(frames.iter().all(|o| o.frame.scan_motion().is_none()));
    let unknown: Vec<_> = notices.iter().filter(|n| n.contains("does not give the robot's motion")).collect();
    assert!(unknown.len() == 1 && unknown[0].contains("the scan at 0 s takes 0.100 s"), "{notices:?}");
    // Poses a second apart do not determine the motion within a tenth of a second.
    let (frames, notices) = read(&turning, &lines_at(&[0.0, 1.0], Some(Pose::IDENTITY)), |f| f);
    assert!(frames[0].frame.scan_motion().is_none());
    assert!(notices.iter().any(|n| n.contains("poses are 1.000 s apart")), "{notices:?}");
    // A scanner that measures all rays at the stamp needs no motion.
    let (_, notices) = read(&scanner(RayTimes::AtOnce), &lines_at(&[0.0, 0.1], None), |f| f);
    assert!(notices.is_empty(), "{notices:?}");
}

/// A twist is preferred to all, poses to odometry.
#[test]
fn the_best_source_is_taken() {
    let spec = scanner(RayTimes::turning(0.1, StampAt::First));
    let ahead = |x: f64| Pose::from_xyz_rpy(DVec3::X * x, 0.0, 0.0, 0.0);
    let mut lines = lines_at(&[0.0, 0.1, 0.2], Some(ahead(0.1)));
    for (line, x) in lines.iter_mut().zip([0.0, 0.2, 0.4]) {
        line.reference = Some(RobotPose::new(ahead(x)));
    }
    lines[1].twist = Some(Twist::new(DVec3::X * 5.0, DVec3::ZERO));
    let speeds = |with: &dyn Fn(Frames) -> Frames| {
        let (frames, _) = read(&spec, &lines, with);
        frames.iter().map(|o| o.frame.scan_motion().unwrap().at(0.1).unwrap().translation.x * 10.0).collect::<Vec<_>>()
    };
    let close = |found: &[f64], truth: [f64; 3]| {
        assert!(found.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}")
    };
    close(&speeds(&|f| f), [1.0, 5.0, 1.0]);
    close(&speeds(&|f| f.moving_by_reference()), [2.0, 5.0, 2.0]);
    // At 10 Hz from 0.05 s before the first stamp, and not to the end of the last scan.
    let poses: Vec<StampedPose> =
        (-1..=4).map(|k| f64::from(k) * 0.05).map(|time| StampedPose { time, pose: ahead(3.0 * time) }).collect();
    close(&speeds(&|f| f.moving_along(&poses).unwrap()), [3.0, 5.0, 3.0]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jsonl");
    std::fs::write(&path, lines::header(&spec)).unwrap();
    let back: Vec<StampedPose> = poses.iter().rev().copied().collect();
    let e = Frames::open(&path, None, &Default::default()).unwrap().moving_along(&back).err().unwrap();
    assert!(e.to_string().contains("goes back"), "{e}");
}

/// Range along a direction from a place in a room of 10 x 8 m around the origin.
fn range(pose: &Pose, azimuth: f64) -> f64 {
    let d = pose.rotation * DVec3::new(azimuth.cos(), azimuth.sin(), 0.0);
    let to = |p: f64, d: f64, wall: f64| if d == 0.0 { f64::INFINITY } else { (wall * d.signum() - p) / d };
    to(pose.translation.x, d.x, 5.0).min(to(pose.translation.y, d.y, 4.0))
}

/// The times and the twist of a log undo the motion of its scans. Wrong times and a wrong twist do not.
#[test]
fn a_drive_is_undone_by_what_its_log_says() {
    let twist = Twist::new(DVec3::X * 1.5, DVec3::Z * 1.0);
    // The robot looks along the world's y axis.
    let start = Pose::from_xyz_rpy(DVec3::new(0.5, -0.5, 0.0), 0.0, 0.0, FRAC_PI_2);
    let azimuth = |c: u32| (f64::from(c) - 180.0).to_radians();
    let times: Vec<f32> = (0..BEAMS).map(|c| 0.1 * c as f32 / BEAMS as f32).collect();
    let at = |c: u32| start * twist.over(f64::from(times[c as usize]));
    let line = LogFrame {
        times: Some(times.clone()),
        twist: Some(twist),
        ..LogFrame::new(0.0, (0..BEAMS).map(|c| range(&at(c), azimuth(c)) as f32).collect())
    };
    let off = |line: &LogFrame| {
        let (frames, _) = read(&scanner(RayTimes::AtOnce), std::slice::from_ref(line), |f| f);
        let still = frames[0].frame.deskewed(0.0).unwrap();
        let off = |(c, r): (u32, &f32)| (f64::from(*r) - range(&start, azimuth(c))).abs();
        let mut off: Vec<f64> = (0..).zip(still.ranges()).map(off).filter(|d| d.is_finite()).collect();
        off.sort_by(f64::total_cmp);
        assert!(off.len() > 340);
        off[off.len() * 95 / 100]
    };
    assert!(off(&line) < 0.005, "{}", off(&line));
    let from_last = LogFrame { times: Some(times.iter().map(|t| t - 0.1).collect()), ..line.clone() };
    let in_world = Twist::new(start.rotation * twist.linear, start.rotation * twist.angular);
    let in_world = LogFrame { twist: Some(in_world), ..line.clone() };
    let backwards = LogFrame { times: Some(times.iter().rev().copied().collect()), ..line.clone() };
    for (planted, name) in [(from_last, "from the last ray"), (in_world, "world's axes"), (backwards, "backwards")] {
        assert!(off(&planted) > 0.05, "{name}: {}", off(&planted));
    }
    let nanoseconds = LogFrame { times: Some(times.iter().map(|t| t * 1e9).collect()), ..line.clone() };
    let e = nanoseconds.check(&scanner(RayTimes::AtOnce)).unwrap_err();
    assert!(e.to_string().contains("s after the stamp") && e.remedy().contains("seconds"), "{e}");
    // The times of the sensor must not contradict them.
    assert!(line.check(&scanner(RayTimes::turning(0.1, StampAt::First))).is_ok());
    for stated in [
        RayTimes::turning(-0.1, StampAt::First),
        RayTimes::turning(0.1, StampAt::Last),
        RayTimes::turning(0.2, StampAt::First),
    ] {
        let e = line.check(&scanner(stated)).unwrap_err();
        assert!(e.to_string().contains("by the times of the sensor") && e.remedy().contains("turn_s"), "{e}");
    }
}
