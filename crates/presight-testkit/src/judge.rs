//! The accuracy with which an environment predicts measurements, by dense rays of the oracle.

use super::oracle::Oracle;
use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::geometry::Pose;
use presight_model::measured::Frame;
use presight_read::log::{Frames, Observation};
use std::path::Path;

/// A frame with the pose of its sensor.
pub type Placed = (Frame, Pose);

/// The frames of a log at their poses, thinned.
pub fn frames(log: &Path, stride: u32) -> Vec<Placed> {
    let placed = |o: Observation| {
        let frame = o.frame.thinned(stride).unwrap();
        let pose = o.reference.unwrap().sensor(frame.sensor()).world_from_sensor();
        (frame, pose)
    };
    Frames::open(log, None, &Default::default()).unwrap().map(|o| placed(o.unwrap())).collect()
}

/// Distances between predicted and measured ranges.
#[derive(Debug)]
pub struct Judged {
    /// Median distance, metres.
    pub median: f64,
    /// Percentage of all measured pixels with a right prediction.
    pub within: f64,
    /// Percentage with a prediction.
    pub covered: f64,
    /// Percentage with a prediction that is too near.
    pub nearer: f64,
    /// Percentage of the covered pixels with a right prediction.
    pub within_of_hits: f64,
}

/// Compares predictions with measurements. A prediction within `near` of the measurement is right, one more than `far`
/// before it is too near; both in metres.
pub fn judge(environment: &Environment, frames: &[Placed], near: f64, far: f64) -> Judged {
    let oracle = Oracle::new(environment, frames[0].1.translation).expect("polygons");
    let (mut off, mut all, mut nearer) = (Vec::new(), 0.0, 0.0);
    for (frame, pose) in frames {
        let width = frame.sensor().width();
        for (pixel, measured) in (0..).zip(frame.ranges()).filter(|(_, r)| r.is_finite()) {
            all += 1.0;
            let cast =
                oracle.cast(frame.sensor(), pose, (pixel % width, pixel / width)).and_then(|values| values.range);
            if let Some(range) = cast.filter(|range| range.is_finite()) {
                off.push(f64::from((range - measured).abs()));
                nearer += f64::from(u8::from(f64::from(range) < f64::from(*measured) - far));
            }
        }
    }
    let right = off.iter().filter(|o| **o < near).count() as f64;
    let hits = off.len() as f64;
    let median = presight_model::statistics::median(&mut off).unwrap_or(f64::NAN);
    let percent = |part: f64, of: f64| 100.0 * part / of;
    Judged {
        median,
        within: percent(right, all),
        covered: percent(hits, all),
        nearer: percent(nearer, all),
        within_of_hits: percent(right, hits),
    }
}

/// True if a surface lies between two points.
pub fn is_blocked(environment: &Environment, from: DVec3, to: DVec3) -> bool {
    let ray = to - from;
    Oracle::new(environment, from).is_some_and(|o| o.hides(from, ray.normalize(), ray.length(), &[]))
}

/// Number of frames with a ray that ended within `near` metres of a place.
pub fn sights(frames: &[Placed], place: DVec3, near: f64) -> usize {
    let is_seen = |(frame, pose): &&Placed| {
        let sensor = frame.sensor();
        let p = (pose.rotation_matrix() * sensor.body_from_image()).transpose() * (place - pose.translation);
        let Some((u, v)) = sensor.project_nearly(p.as_vec3()) else { return false };
        let (u, v) = ((u + 0.5).floor(), (v + 0.5).floor());
        let is_in = u >= 0.0 && v >= 0.0 && u < sensor.width() as f32 && v < sensor.height() as f32;
        is_in
            && (f64::from(frame.ranges()[v as usize * sensor.width() as usize + u as usize]) - p.length()).abs() < near
    };
    frames.iter().filter(is_seen).count()
}
