//! Scans that take time: what a moving scanner measured is put to where it would be seen from the middle of the turn, by the
//! robot's own motion, before it is matched. The middle is where an error of the speed does least: half of the points are off to
//! one side, half to the other. The exact prediction of a moving scan is not attempted.

use super::velocity::along;
use crate::estimate::after_middle;
use crate::motion::Vector;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::measured::{Frame, Measurement};
use presight_model::sensor::{Geometry, RayTable, Sensor};

/// Two neighbours whose ranges differ by more than this part do not lie on one surface.
const JUMP: f64 = 0.1;
/// A mean distance of frames may be shorter than the turn by this part: drivers round.
const ROUNDING: f64 = 1.1;
/// Frames after which their mean distance is known.
const KNOWN: f64 = 3.0;

/// The frame as a scanner would measure that turns in no time, at the middle of the turn: half a turn after the stamp. `twist` is
/// the robot's motion, metres and radians per second in its own axes. A scan of one row keeps its directions; other scans get a
/// ray for each of their points.
///
/// # Errors
/// Those of [`Sensor::new`] and [`Frame::new`].
pub fn at_once(frame: &Frame, twist: &Vector) -> Result<Frame> {
    let sensor = frame.sensor();
    let turn_s = sensor.spec().turn_s;
    if turn_s == 0.0 || frame.grey().is_some() {
        return Ok(frame.clone());
    }
    let (width, mount) = (sensor.width() as usize, sensor.spec().mount);
    // middle_from_column, in the axes of the sensor.
    let moves: Vec<Pose> =
        (0..width).map(|c| mount.inverse() * along(twist, after_middle(turn_s, c, width)) * mount).collect();
    let body = sensor.body_from_image();
    let point = |(i, range): (usize, &f32)| {
        let (c, r) = (i % width, i / width);
        let ray = sensor.ray(c as u32, r as u32)?;
        let there = moves[c].transform_point(body * (ray * f64::from(*range)));
        range.is_finite().then_some(body.transpose() * there)
    };
    let points: Vec<Option<DVec3>> = frame.ranges().iter().enumerate().map(point).collect();
    let is_row = sensor.height() == 1 && matches!(sensor.spec().geometry, Geometry::Scanner(_));
    let mut still = if is_row { in_row(frame, &points)? } else { with_own_rays(frame, &points)? };
    still.stamp = frame.stamp + 0.5 * turn_s.abs();
    still.motion = frame.motion;
    match frame.intensities() {
        Some(intensities) => still.with_intensities(intensities.clone()),
        None => Ok(still),
    }
}

/// Ranges along the scanner's own directions, where these meet the lines from each point to its neighbour.
fn in_row(frame: &Frame, points: &[Option<DVec3>]) -> Result<Frame> {
    let sensor = frame.sensor();
    let width = points.len();
    let is_closed = sensor.distinct_columns() < sensor.width() || is_round(sensor);
    let ray = |c: usize| sensor.ray(c as u32, 0);
    let mut ranges: Vec<f32> = frame.ranges().iter().map(|r| if r.is_finite() { f32::NAN } else { *r }).collect();
    let pairs = if is_closed { width } else { width - 1 };
    // A direction is met close to the column that has measured it.
    let reach = 2 + width / 8;
    for i in 0..pairs {
        let (Some(a), Some(b)) = (points[i], points[(i + 1) % width]) else { continue };
        let on_one = (a.length() - b.length()).abs() <= JUMP * a.length().min(b.length());
        for k in 0..=2 * reach {
            let column = i as i64 + k as i64 - reach as i64;
            let column = if is_closed { column.rem_euclid(width as i64) } else { column };
            let Some(direction) = usize::try_from(column).ok().filter(|c| *c < width).and_then(ray) else { continue };
            let Some(part) = meets(direction, a, b) else { continue };
            let range = if on_one {
                a.lerp(b, part).length()
            } else if part < 0.5 {
                a.length()
            } else {
                b.length()
            };
            let slot = &mut ranges[column as usize];
            // The nearer one hides the other.
            *slot = if slot.is_finite() { slot.min(range as f32) } else { range as f32 };
        }
    }
    Frame::new(frame.stamp, sensor.clone(), Measurement::Range(ranges))
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

/// A ray for each point.
fn with_own_rays(frame: &Frame, points: &[Option<DVec3>]) -> Result<Frame> {
    let sensor = frame.sensor();
    let body = sensor.body_from_image();
    let width = sensor.width() as usize;
    let own = |i: usize| {
        let ray = sensor.ray((i % width) as u32, (i / width) as u32);
        points[i].map(DVec3::normalize).or(ray).map_or(DVec3::NAN, |ray| body * ray)
    };
    let table = RayTable::new(sensor.width(), sensor.height(), (0..points.len()).map(own).collect())?;
    let mut spec = sensor.spec().clone().with_geometry(Geometry::Rays(table));
    spec.optical_from_image = glam::DQuat::IDENTITY;
    let range = |(point, range): (&Option<DVec3>, &f32)| point.map_or(*range, |p| p.length() as f32);
    let ranges = points.iter().zip(frame.ranges()).map(range).collect();
    Frame::new(frame.stamp, Sensor::new(spec)?, Measurement::Range(ranges))
}

/// Refuses scans that would have to be measured at once with the next one; `since` the first frame `count` frames have come.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if a turn takes longer than the frames are apart, in the mean.
pub(super) fn check(frame: &Frame, since: f64, count: f64) -> Result<()> {
    let spec = frame.sensor().spec();
    let most = ROUNDING * since / count + 4.0 * spec.noise.stamp_sigma / count;
    if count < KNOWN || spec.turn_s.abs() <= most {
        return Ok(());
    }
    let what = format!("turn_s of {} s, but the scans come every {:.3} s", spec.turn_s, since / count);
    Err(Error::invalid(what, "give the time of one turn in the sensor file, or 0 if a scan is measured at once"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::sensor::{Angles, Scanner, SensorSpec};

    /// 360 beams in a tenth of a second; the first looks back.
    fn scanner(turn_s: f64) -> Sensor {
        let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 1.0, count: 360 };
        let elevation = Angles::Listed(vec![0.0]);
        let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
        let spec = SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner)).with_turn_s(turn_s);
        Sensor::new(spec).unwrap()
    }

    /// What the scanner reads in a room of 10 x 8 m with its middle at the origin, from poses that follow a twist; column by column.
    fn turned(twist: &Vector, turn_s: f64) -> Frame {
        let sensor = scanner(turn_s);
        let range = |c: usize| {
            let pose = along(twist, after_middle(turn_s, c, 360));
            let (p, d) = (pose.translation, pose.rotation * sensor.ray(c as u32, 0).unwrap());
            let to = |p: f64, d: f64, wall: f64| if d == 0.0 { f64::INFINITY } else { (wall * d.signum() - p) / d };
            to(p.x, d.x, 5.0).min(to(p.y, d.y, 4.0)) as f32
        };
        Frame::new(0.0, sensor.clone(), Measurement::Range((0..360).map(range).collect())).unwrap()
    }

    /// A robot at 1.5 m/s and 1 rad/s reads what one that stands reads, but for 5 mm on the walls, once its motion is undone. Without that
    /// it is off by decimetres. A wrong sign doubles the error.
    #[test]
    fn a_turn_is_undone_by_the_motion() {
        for twist in [[1.5, 0.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0, 0.0, -1.0], [1.5, 0.0, 0.0, 0.0, 0.0, 0.0]] {
            for turn_s in [0.1, -0.1] {
                let frame = turned(&twist, turn_s);
                let (still, truth) = (at_once(&frame, &twist).unwrap(), turned(&[0.0; 6], 0.1));
                assert_eq!(still.stamp, 0.05);
                let off = |ranges: &[f32]| {
                    let mut off: Vec<f32> = ranges
                        .iter()
                        .zip(truth.ranges())
                        .map(|(a, b)| (a - b).abs())
                        .filter(|d| d.is_finite())
                        .collect();
                    off.sort_by(f32::total_cmp);
                    (off.len(), off[off.len() * 98 / 100])
                };
                let (seen, most) = off(still.ranges());
                assert!(seen > 350 && most < 0.005, "{twist:?} {turn_s}: {seen} of 360, {most}");
                assert!(off(frame.ranges()).1 > 0.04, "{twist:?}: nothing to undo");
                let wrong = at_once(&frame, &twist.map(|x| -x)).unwrap();
                assert!(off(wrong.ranges()).1 > 0.08, "planted");
            }
        }
    }

    /// Scans of 0.1 s are refused if they come every 0.05 s, once that is known; every 0.1 s they are accepted.
    #[test]
    fn a_turn_longer_than_the_frame_distance_is_refused() {
        let frame = turned(&[0.0; 6], 0.1);
        let e = check(&frame, 0.2, 4.0).unwrap_err();
        assert!(e.to_string().contains("turn_s of 0.1 s, but the scans come every 0.050 s"), "{e}");
        assert!(check(&frame, 0.4, 4.0).is_ok() && check(&frame, 0.05, 1.0).is_ok());
    }
}
