//! One feature that is followed from frame to frame.

use super::common::CommonMotion;
use super::motion::{PointMotion, isotropic};
use super::options::TrackerOptions;
use super::unaided::Unaided;
use crate::matching::{
    Detection, DetectionProperties, ExpectedFeature, ExpectedProperties, PropertyNoise, Shape, UncertainValue,
    turn_apart, unwrap,
};
use glam::{DMat2, DVec2, DVec3};
use std::f64::consts::PI;

/// A feature to follow, from a full prediction or from the caller.
#[derive(Clone, Debug, PartialEq)]
pub struct Seed {
    /// The feature's number.
    pub id: u32,
    /// Position in the image. The ends of a segment that are not corners of the model slide from the start.
    pub shape: Shape,
    /// Covariance of each defining point, pixels squared.
    pub covariances: Vec<DMat2>,
    /// Expected properties.
    pub properties: ExpectedProperties,
    /// Defining points in the world, metres, for [`super::Tracker::set_view`]; empty if unknown.
    pub points_world: Vec<DVec3>,
}

/// Standard deviation of the change of a property between frames, as a share of its noise.
const WANDER: f64 = 0.2;

/// A feature that is followed from frame to frame.
#[derive(Clone, Debug)]
pub struct Track {
    pub(super) id: u32,
    /// Kind and corners. Its points equal the positions in `motions`.
    pub(super) shape: Shape,
    pub(super) motions: Vec<PointMotion>,
    pub(super) properties: ExpectedProperties,
    /// Covariance of the last detection.
    pub(super) detection: DMat2,
    /// The followed track from which detections cannot distinguish it. It has no window then, but takes part in the
    /// assignment.
    pub(super) waits: Option<u32>,
    pub(super) unaided: Unaided,
    pub(super) misses: u32,
    pub(super) seen: u32,
    /// Mean squared innovation of this track, relative to the predicted variance.
    pub(super) own: f64,
    /// Variance that an unknown acceleration may add in the next interval, pixels squared.
    pub(super) changed: f64,
    pub(super) flow: Flow,
    /// Speed and acceleration shared by all tracks, at the track's centre.
    pub(super) shared: [DVec2; 2],
}

/// Motion in the image caused by the known motion of the sensor.
#[derive(Clone, Debug, Default)]
pub(super) struct Flow {
    pub points_world: Vec<DVec3>,
    /// Positions of the points in the last view; empty before the first.
    pub last: Vec<DVec2>,
    /// Positions of the points in the next view; empty unless the view was set.
    pub next: Vec<DVec2>,
    /// Flow between the last two views, pixels per second, removed from the motions' speeds; empty if none.
    pub speed: Vec<DVec2>,
}

impl Flow {
    /// Displacement from the last view to the next, pixels, the short way round.
    fn shift(&self, i: usize, turn: Option<f64>) -> DVec2 {
        let shift = self.next[i] - self.last[i];
        shift + DVec2::new(unwrap(turn, 0.0, shift.x), 0.0)
    }
}

impl Track {
    pub(super) fn new(seed: Seed, options: &TrackerOptions) -> Self {
        let speed = options.speed_sigma.powi(2);
        let acceleration = options.acceleration_sigma.powi(2);
        let motion = |(p, c): (&DVec2, &DMat2)| PointMotion::new(*p, *c, speed, acceleration);
        let last = if seed.points_world.is_empty() { Vec::new() } else { seed.shape.points().to_vec() };
        Self {
            id: seed.id,
            motions: seed.shape.points().iter().zip(&seed.covariances).map(motion).collect(),
            shape: seed.shape,
            properties: seed.properties,
            detection: isotropic(options.detection_sigma.powi(2)),
            waits: Some(seed.id),
            unaided: Unaided::default(),
            misses: 0,
            seen: 0,
            own: 1.0,
            changed: 0.0,
            flow: Flow { points_world: seed.points_world, last, ..Flow::default() },
            shared: [DVec2::ZERO; 2],
        }
    }

    /// The feature's number.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// Position estimated from the history up to the last frame.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Speed of each defining point, pixels per second.
    pub fn speeds(&self) -> impl Iterator<Item = DVec2> + '_ {
        let flow = |i: usize| self.flow.speed.get(i).copied().unwrap_or(DVec2::ZERO);
        self.motions.iter().enumerate().map(move |(i, m)| m.speed + self.shared[0] + flow(i))
    }

    /// Acceleration of each defining point, pixels per s^2, without the acceleration of the flow of a known motion.
    pub fn accelerations(&self) -> impl Iterator<Item = DVec2> + '_ {
        self.motions.iter().map(|m| m.acceleration + self.shared[1])
    }

    /// Covariance of each defining point, pixels squared.
    pub fn covariances(&self) -> impl Iterator<Item = DMat2> + '_ {
        self.motions.iter().map(|m| m.pp)
    }

    /// Expected properties.
    pub fn properties(&self) -> &ExpectedProperties {
        &self.properties
    }

    /// Number of consecutive misses.
    pub fn misses(&self) -> u32 {
        self.misses
    }

    /// Number of frames in which the feature was detected.
    pub fn seen(&self) -> u32 {
        self.seen
    }

    /// Mean variance of a detected coordinate, pixels squared.
    pub(super) fn detection_variance(&self) -> f64 {
        0.5 * (self.detection.x_axis.x + self.detection.y_axis.y)
    }

    /// Spectral density of the process noise, and the variance that an unknown acceleration adds in `interval` seconds,
    /// where frames are `usual` seconds apart (0 if unknown).
    pub(super) fn disturbance(&self, interval: f64, usual: f64, options: &TrackerOptions) -> (f64, f64) {
        if usual <= 0.0 {
            return (0.0, 0.0);
        }
        let jerk = options.memory.powi(-6) * self.detection_variance() / usual.powi(5);
        (jerk, self.changed * (interval / usual).powi(4))
    }

    /// Appends the points `interval` seconds later; `jerk` is the spectral density of the process noise.
    pub(super) fn propagated(&self, interval: f64, jerk: f64, options: &TrackerOptions, into: &mut Vec<PointMotion>) {
        if interval <= 0.0 {
            into.extend_from_slice(&self.motions);
            return;
        }
        let flow = &self.flow;
        let has_flow = !flow.next.is_empty() && flow.last.len() == flow.next.len();
        let first = into.len();
        into.extend_from_slice(&self.motions);
        for (i, motion) in into[first..].iter_mut().enumerate() {
            let was = flow.speed.get(i).copied();
            let mut shift = DVec2::ZERO;
            if has_flow {
                shift = flow.shift(i, options.image.turn);
                if was.is_none() {
                    let rest = isotropic(options.residual_speed_sigma.powi(2));
                    // First flow of this track. A new track's speed is unknown, so the speed left after the flow is
                    // assumed small. An old track's speed included the flow, which is subtracted.
                    if self.seen <= 1 {
                        [motion.speed, motion.acceleration] = self.shared.map(|shared| -shared);
                        motion.vv = rest;
                    } else {
                        motion.speed -= shift / interval;
                        motion.vv += rest;
                    }
                }
            } else if let Some(was) = was {
                motion.speed += was;
            }
            motion.advance(interval, jerk);
            motion.position += shift;
        }
    }

    /// Stores the flow between two frames for the next interval.
    pub(super) fn pass_flow(&mut self, interval: f64, turn: Option<f64>) {
        let flow = &mut self.flow;
        if interval > 0.0 {
            let is_known = flow.last.len() == flow.next.len();
            let known = if is_known { flow.next.len() } else { 0 };
            flow.speed = (0..known).map(|i| flow.shift(i, turn) / interval).collect();
        }
        // Without a view of this frame, the flow of the next interval is unknown.
        if interval > 0.0 || !flow.next.is_empty() {
            flow.last = std::mem::take(&mut flow.next);
        }
    }

    /// Returns the expected feature for points at `motions`, without a window.
    pub(super) fn expected(&self, motions: &[PointMotion], scale: f64, common: &CommonMotion) -> ExpectedFeature {
        let mut shape = self.shape.clone();
        for (p, motion) in shape.points_mut().iter_mut().zip(motions) {
            *p = motion.position;
        }
        let covariances = motions.iter().map(|m| m.pp * scale + common.covariance()).collect();
        ExpectedFeature { shape, covariances, window: [0.0; 4], properties: self.properties.clone() }
    }

    /// Updates the expected properties from a detection.
    pub(super) fn learn_properties(&mut self, found: &Detection, noise: &PropertyNoise) {
        // The range changes with every pose, so it is not learnt.
        let DetectionProperties { strength, contrast, direction, marker, range: _ } = &found.properties;
        let known = &mut self.properties;
        learn(&mut known.strength, *strength, noise.strength, |a, b| a - b);
        learn(&mut known.contrast, *contrast, noise.contrast, |a, b| a - b);
        learn(&mut known.direction, *direction, noise.direction, turn_apart);
        if let Some(UncertainValue { mean, .. }) = &mut known.direction {
            *mean = mean.rem_euclid(PI);
        }
        if known.marker.is_none() {
            known.marker.clone_from(marker);
        }
    }
}

fn learn(known: &mut Option<UncertainValue>, told: Option<f64>, sigma: f64, apart: impl Fn(f64, f64) -> f64) {
    let Some(told) = told else { return };
    let noise = sigma * sigma;
    *known = Some(match known {
        None => UncertainValue { mean: told, variance: noise },
        Some(UncertainValue { mean, variance }) => {
            let before = *variance + WANDER * WANDER * noise;
            let gain = before / (before + noise);
            UncertainValue { mean: *mean + gain * apart(told, *mean), variance: (1.0 - gain) * before }
        }
    });
}
