//! What a scan measured while the robot moved, moved to one moment. Edges of near things are where this is not exact:
//! other parts of a surface are hidden from the moment's pose than from that of each ray.

use super::{Frame, Measurement, ScanMotion};
use crate::error::{Error, Result};
use crate::geometry::{Pose, PoseEstimate, SensorPose, Twist};
use crate::sensor::{Geometry, RayTable, RayTimes, Sensor};
use glam::{DQuat, DVec3};
use std::borrow::Cow;
use std::collections::HashMap;

/// Relative difference of the ranges of two neighbours beyond which they do not lie on one surface: at the step of one
/// degree that scanners have it is a surface seen at less than 10 degrees.
const JUMP: f64 = 0.1;

impl Frame {
    /// True if all rays start at one point at one time, or if the frame was deskewed: one pose then holds for the
    /// frame.
    pub fn has_one_pose(&self) -> bool {
        let sensor = self.sensor();
        let stands = self.scan_motion.as_ref().is_none_or(ScanMotion::is_still);
        self.deskewed_by.is_some() || (stands || sensor.spec().times.is_at_once()) && !sensor.has_origins()
    }

    /// The frame as measured from one point at one moment, `seconds` after its stamp, which becomes the stamp. Each
    /// point moves by the motion of the scan ([`Frame::with_scan_motion`]); without one the robot stands. Origins of
    /// rays beside the sensor's own are accounted for. A scanner of one row keeps its directions and gets new ranges;
    /// other frames get a ray for each of their points. A frame that [`Frame::has_one_pose`] and grey images only get
    /// the stamp.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the motion does not reach over the scan; [`crate::ErrorKind::System`] if there
    /// is no memory for the new rays.
    pub fn deskewed(&self, seconds: f64) -> Result<Self> {
        let motion = self.motion_or_still();
        if self.has_one_pose() || self.grey().is_some() {
            return Ok(Self { stamp: self.stamp + seconds, deskewed_by: Some(seconds), ..self.clone() });
        }
        let sensor = self.sensor();
        let moves = SensorMoves::new(sensor, &motion, seconds)?;
        let body = sensor.body_from_image();
        let width = sensor.width() as usize;
        let moved = |(i, range): (usize, &f32)| {
            let (c, r) = ((i % width) as u32, (i / width) as u32);
            let Some(ray) = sensor.ray(c, r) else { return Moved::NONE };
            let (then_from_measured, ray) = (moves.of(c, r), body * ray);
            if !range.is_finite() {
                let ray = body.transpose() * (then_from_measured.rotation * ray);
                return Moved { ray, range: f64::from(*range) };
            }
            let p = sensor.origin(c, r) + ray * f64::from(*range);
            let p = body.transpose() * then_from_measured.transform_point(p);
            Moved { ray: p.normalize(), range: p.length() }
        };
        let moved: Vec<Moved> = self.ranges().iter().enumerate().map(moved).collect();
        let is_row = sensor.height() == 1 && matches!(sensor.spec().geometry, Geometry::Scanner(_));
        let mut still = if is_row { in_row(self, &moved)? } else { with_own_rays(self, &moved)? };
        (still.stamp, still.deskewed_by, still.motion) = (self.stamp + seconds, Some(seconds), self.motion);
        match self.intensities() {
            Some(intensities) => still.with_intensities(intensities.clone()),
            None => Ok(still),
        }
    }

    /// The frame as measured at one moment, in the middle of its scan, where an error of the motion does least; the
    /// frame itself if it [`Frame::has_one_pose`]. A robot whose motion is unknown ([`Frame::scan_motion`]) counts as
    /// standing.
    ///
    /// # Errors
    /// Those of [`Frame::deskewed`].
    pub fn at_one_moment(&self) -> Result<FrameAtMoment<'_>> {
        if self.has_one_pose() || self.grey().is_some() {
            return Ok(FrameAtMoment { frame: Cow::Borrowed(self), stamp_from_moment: Pose::IDENTITY });
        }
        let [first, last] = self.sensor().scan_interval();
        let middle = 0.5 * (first + last);
        let frame = Cow::Owned(self.deskewed(middle)?);
        let stamp_from_moment = self.motion_or_still().at(middle).unwrap_or(Pose::IDENTITY);
        Ok(FrameAtMoment { frame, stamp_from_moment })
    }

    fn motion_or_still(&self) -> Cow<'_, ScanMotion> {
        let still = || Cow::Owned(ScanMotion::Twist(Twist::default()));
        self.scan_motion.as_ref().map_or_else(still, Cow::Borrowed)
    }
}

/// A frame with one pose: see [`Frame::at_one_moment`].
#[derive(Clone, Debug)]
pub struct FrameAtMoment<'a> {
    /// The frame; its stamp is the moment.
    pub frame: Cow<'a, Frame>,
    /// The robot's pose at the moment, in its frame at the stamp of the scan.
    pub stamp_from_moment: Pose,
}

impl FrameAtMoment<'_> {
    /// The robot's pose at the moment, from its pose at the stamp of the scan.
    pub fn robot(&self, at_stamp: &PoseEstimate) -> PoseEstimate {
        // A frame with one pose changes no bit.
        if self.stamp_from_moment == Pose::IDENTITY { *at_stamp } else { at_stamp.after(&self.stamp_from_moment) }
    }

    /// The robot's pose at the stamp of the scan, from its pose at the moment.
    pub fn robot_at_stamp(&self, at_moment: &PoseEstimate) -> PoseEstimate {
        at_moment.after(&self.stamp_from_moment.inverse())
    }

    /// The sensor's pose at the moment, from its pose at the stamp of the scan.
    pub fn sensor(&self, at_stamp: &SensorPose) -> SensorPose {
        if self.stamp_from_moment == Pose::IDENTITY {
            return *at_stamp;
        }
        let mount = self.frame.sensor().spec().mount;
        SensorPose::new(at_stamp.world_from_sensor() * mount.inverse() * self.stamp_from_moment * mount)
    }
}

/// A measured ray, from the sensor's position at the moment to which it was moved.
#[derive(Clone, Copy)]
struct Moved {
    /// Unit direction, image axes; NaN without a ray.
    ray: DVec3,
    /// Metres; an infinity or NaN without a point.
    range: f64,
}

impl Moved {
    const NONE: Self = Self { ray: DVec3::NAN, range: f64::NAN };

    fn point(&self) -> Option<DVec3> {
        self.range.is_finite().then(|| self.ray * self.range)
    }
}

/// then_from_measured of the sensor for each ray, body axes.
struct SensorMoves<'a> {
    sensor: &'a Sensor,
    /// By the bits of the time of a ray.
    by_time: HashMap<u64, Pose>,
}

impl<'a> SensorMoves<'a> {
    fn new(sensor: &'a Sensor, motion: &ScanMotion, seconds: f64) -> Result<Self> {
        let mount = sensor.spec().mount;
        let reach = || {
            let [first, last] = sensor.scan_interval();
            let what = format!("a motion that does not reach from {first} s to {last} s after the stamp");
            Error::invalid(what, "give poses from before the first ray until after the last")
        };
        let from_robot = motion.at(seconds).ok_or_else(reach)?.inverse();
        let mut by_time = HashMap::new();
        let rows = match sensor.spec().times {
            RayTimes::Columns { .. } => 1,
            _ => sensor.height(),
        };
        for (c, r) in (0..rows).flat_map(|r| (0..sensor.width()).map(move |c| (c, r))) {
            let time = sensor.seconds_after_stamp(c, r);
            if let std::collections::hash_map::Entry::Vacant(slot) = by_time.entry(time.to_bits()) {
                slot.insert(mount.inverse() * from_robot * motion.at(time).ok_or_else(reach)? * mount);
            }
        }
        Ok(Self { sensor, by_time })
    }

    fn of(&self, column: u32, row: u32) -> &Pose {
        &self.by_time[&self.sensor.seconds_after_stamp(column, row).to_bits()]
    }
}

/// Ranges along the scanner's own directions, where these meet the lines from each point to its neighbour. Next to a
/// ray without a return, and at the edge of a surface, the nearer neighbour counts.
fn in_row(frame: &Frame, moved: &[Moved]) -> Result<Frame> {
    let sensor = frame.sensor();
    let width = moved.len();
    let is_closed = sensor.distinct_columns() < sensor.width() || is_round(sensor);
    let mut ranges = vec![f32::NAN; width];
    let pairs = if is_closed { width } else { width - 1 };
    for i in 0..pairs {
        let (from, to) = (moved[i], moved[(i + 1) % width]);
        for column in columns_near(i, width, is_closed) {
            let Some(ray) = sensor.ray(column as u32, 0) else { continue };
            let Some(range) = range_between(ray, from, to) else { continue };
            let slot = &mut ranges[column];
            // The nearer one hides the other, and a point counts more than no return.
            *slot = match (slot.is_finite(), range.is_finite()) {
                (true, true) => slot.min(range),
                (true, false) => *slot,
                (false, _) if range.is_nan() => *slot,
                (false, _) => range,
            };
        }
    }
    Frame::new(frame.stamp, sensor.clone(), Measurement::Range(ranges))
}

/// Columns whose direction may lie between two neighbours that were measured in this column: a direction is met close
/// to the column that has measured it.
fn columns_near(i: usize, width: usize, is_closed: bool) -> impl Iterator<Item = usize> {
    let (reach, width) = ((2 + width / 8) as i64, width as i64);
    let column = move |k: i64| {
        let column = i as i64 + k;
        let column = if is_closed { column.rem_euclid(width) } else { column };
        (0..width).contains(&column).then_some(column as usize)
    };
    (-reach..=reach).filter_map(column)
}

/// The reading of a direction between two neighbours; `None` if it does not lie between them.
fn range_between(direction: DVec3, from: Moved, to: Moved) -> Option<f32> {
    let nearer = |part: f64| if part < 0.5 { from.range } else { to.range } as f32;
    let (Some(a), Some(b)) = (from.point(), to.point()) else {
        return meets(direction, from.ray, to.ray).map(nearer);
    };
    let part = meets(direction, a, b)?;
    let is_on_one = (from.range - to.range).abs() <= JUMP * from.range.min(to.range);
    Some(if is_on_one { a.lerp(b, part).length() as f32 } else { nearer(part) })
}

/// True if the step from the last column leads to the first.
fn is_round(sensor: &Sensor) -> bool {
    let (Some(first), Some(second), Some(last)) =
        (sensor.ray(0, 0), sensor.ray(1, 0), sensor.ray(sensor.width() - 1, 0))
    else {
        return false;
    };
    first.angle_between(last) < 1.5 * first.angle_between(second)
}

/// Where a direction meets the line from a to b, as a part of it, if it does: in the plane of the row.
fn meets(direction: DVec3, a: DVec3, b: DVec3) -> Option<f64> {
    let cross = |p: DVec3, q: DVec3| p.x * q.y - p.y * q.x;
    let (to_a, to_b) = (cross(direction, a), cross(direction, b));
    let ahead = direction.dot(a) > 0.0 && direction.dot(b) > 0.0;
    let part = to_a / (to_a - to_b);
    (ahead && to_a != to_b && (0.0..=1.0).contains(&part)).then_some(part)
}

/// A ray for each pixel, in the direction in which its point lies then.
fn with_own_rays(frame: &Frame, moved: &[Moved]) -> Result<Frame> {
    let sensor = frame.sensor();
    let body = sensor.body_from_image();
    let rays = moved.iter().map(|moved| body * moved.ray).collect();
    let table = RayTable::new(sensor.width(), sensor.height(), rays)?;
    let mut spec = sensor.spec().clone().with_geometry(Geometry::Rays(table));
    spec.optical_from_image = DQuat::IDENTITY;
    let ranges = moved.iter().map(|moved| moved.range as f32).collect();
    Frame::new(frame.stamp, Sensor::new(spec)?, Measurement::Range(ranges))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Twist;
    use crate::sensor::{Angles, Scanner, SensorSpec, StampAt};

    /// 360 beams in a tenth of a second; the first looks back.
    fn scanner(turn_s: f64, stamp: StampAt) -> Sensor {
        let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 1.0, count: 360 };
        let elevation = Angles::Listed(vec![0.0]);
        let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
        let spec = SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner));
        Sensor::new(spec.with_times(RayTimes::turning(turn_s, stamp))).unwrap()
    }

    /// What the scanner reads in a room of 10 x 8 m with its middle at the origin, where the robot is `seconds` after
    /// the stamp; column by column.
    fn turned(twist: &Twist, sensor: &Sensor, seconds: f64) -> Frame {
        let range = |c: u32| {
            let pose = twist.over(seconds).inverse() * twist.over(sensor.seconds_after_stamp(c, 0));
            let (p, d) = (pose.translation, pose.rotation * sensor.ray(c, 0).unwrap());
            let to = |p: f64, d: f64, wall: f64| if d == 0.0 { f64::INFINITY } else { (wall * d.signum() - p) / d };
            to(p.x, d.x, 5.0).min(to(p.y, d.y, 4.0)) as f32
        };
        let frame = Frame::new(0.0, sensor.clone(), Measurement::Range((0..360).map(range).collect())).unwrap();
        frame.with_scan_motion(ScanMotion::Twist(*twist))
    }

    /// A robot at 1.5 m/s and 1 rad/s reads what one that stands reads, but for 5 mm on the walls, once its motion is
    /// undone. Without that it is off by decimetres. A wrong sign doubles the error, and so does the wrong end of the
    /// scan.
    #[test]
    fn a_turn_is_undone_by_the_motion() {
        let driving = [(1.5, 1.0), (0.0, -1.0), (1.5, 0.0)];
        let truth = turned(&Twist::default(), &scanner(0.1, StampAt::First), 0.0);
        let off = |ranges: &[f32]| {
            let offs = ranges.iter().zip(truth.ranges()).map(|(a, b)| (a - b).abs());
            let mut off: Vec<f32> = offs.filter(|d| d.is_finite()).collect();
            off.sort_by(f32::total_cmp);
            (off.len(), off[off.len() * 98 / 100])
        };
        for (speed, turn) in driving {
            let twist = Twist::new(DVec3::X * speed, DVec3::Z * turn);
            for (turn_s, stamp, to) in
                [(0.1, StampAt::First, 0.05), (-0.1, StampAt::First, 0.05), (0.1, StampAt::Last, -0.05)]
            {
                let frame = turned(&twist, &scanner(turn_s, stamp), to);
                let still = frame.deskewed(to).unwrap();
                assert_eq!(still.stamp, to);
                let (seen, largest) = off(still.ranges());
                assert!(seen > 350 && largest < 0.005, "{twist:?} {turn_s}: {seen} of 360, {largest}");
                assert!(off(frame.ranges()).1 > 0.04, "{twist:?}: nothing to undo");
                let back = ScanMotion::Twist(Twist::new(-twist.linear, -twist.angular));
                let wrong = frame.clone().with_scan_motion(back).deskewed(to).unwrap();
                assert!(off(wrong.ranges()).1 > 0.08, "planted");
                let path = (0..=20).map(|i| f64::from(i) * 0.02 - 0.2).map(|t| (t, twist.over(t))).collect();
                let path = frame.with_scan_motion(ScanMotion::path(path).unwrap()).deskewed(to).unwrap();
                assert!(off(path.ranges()).1 < 0.005);
            }
        }
        let frame = turned(&Twist::default(), &scanner(0.1, StampAt::First), 0.0);
        let short = ScanMotion::path(vec![(0.0, Pose::IDENTITY), (0.05, Pose::from_xyz_rpy(DVec3::X, 0.0, 0.0, 0.0))]);
        let e = frame.with_scan_motion(short.unwrap()).deskewed(0.0).unwrap_err();
        assert!(e.to_string().contains("does not reach"), "{e}");
    }
}
