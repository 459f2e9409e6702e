//! One feature that is followed from frame to frame.

use super::common::CommonMotion;
use super::motion::{PointMotion, isotropic};
use super::options::TrackerOptions;
use crate::matching::{
    Detection, DetectionProperties, ExpectedFeature, ExpectedProperties, PropertyNoise, Shape, UncertainValue,
    turn_apart, unwrap,
};
use glam::{DMat2, DVec2, DVec3};
use std::f64::consts::PI;

/// A feature to be followed, as a full prediction or the caller has it.
#[derive(Clone, Debug, PartialEq)]
pub struct Seed {
    /// The feature's number.
    pub id: u32,
    /// Where it is in the image. Of a segment, ends that are no corner of the model slide from the start.
    pub shape: Shape,
    /// Covariance of each defining point, pixels squared.
    pub covariances: Vec<DMat2>,
    /// What is known of its properties.
    pub properties: ExpectedProperties,
    /// Its defining points in the world, metres, for [`super::Tracker::set_view`]; empty if not known.
    pub points_world: Vec<DVec3>,
}

/// How a detection's properties wander from frame to frame, as a share of their noise.
const WANDER: f64 = 0.2;

/// A feature that is followed from frame to frame.
#[derive(Clone, Debug)]
pub struct Track {
    pub(super) id: u32,
    /// Kind and corners; its points are those of `motions`.
    pub(super) shape: Shape,
    pub(super) motions: Vec<PointMotion>,
    pub(super) properties: ExpectedProperties,
    /// Of its last detection.
    pub(super) detection: DMat2,
    pub(super) misses: u32,
    pub(super) seen: u32,
    /// Mean square of its own innovations, by their predicted variances.
    pub(super) own: f64,
    /// Variance that an unknown acceleration may bring in the next interval, pixels squared.
    pub(super) changed: f64,
    pub(super) flow: Flow,
    /// Speed and acceleration that all tracks share, at its centre.
    pub(super) shared: [DVec2; 2],
}

/// The motion in the image that the sensor's own motion causes.
#[derive(Clone, Debug, Default)]
pub(super) struct Flow {
    pub points_world: Vec<DVec3>,
    /// Where the points were in the image by the last view; empty before the first.
    pub last: Vec<DVec2>,
    /// Where they are by the next; empty unless told.
    pub next: Vec<DVec2>,
    /// Pixels a second between the last two views, taken out of the speeds of motions; empty where it was not.
    pub speed: Vec<DVec2>,
}

impl Flow {
    /// Pixels from the last view to the next, the short way round.
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

    /// Where it is, by its history up to the last frame.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Speed of each defining point, pixels a second.
    pub fn speeds(&self) -> impl Iterator<Item = DVec2> + '_ {
        let flow = |i: usize| self.flow.speed.get(i).copied().unwrap_or(DVec2::ZERO);
        self.motions.iter().enumerate().map(move |(i, m)| m.speed + self.shared[0] + flow(i))
    }

    /// Acceleration of each defining point, pixels by s^2; that of a known motion's flow is not in it.
    pub fn accelerations(&self) -> impl Iterator<Item = DVec2> + '_ {
        self.motions.iter().map(|m| m.acceleration + self.shared[1])
    }

    /// Covariance of each defining point, pixels squared.
    pub fn covariances(&self) -> impl Iterator<Item = DMat2> + '_ {
        self.motions.iter().map(|m| m.pp)
    }

    /// What is known of its properties.
    pub fn properties(&self) -> &ExpectedProperties {
        &self.properties
    }

    /// Misses in a row.
    pub fn misses(&self) -> u32 {
        self.misses
    }

    /// Frames in which it was seen.
    pub fn seen(&self) -> u32 {
        self.seen
    }

    /// Variance of a detected coordinate, pixels squared.
    pub(super) fn detection_variance(&self) -> f64 {
        0.5 * (self.detection.x_axis.x + self.detection.y_axis.y)
    }

    /// Its points `interval` seconds later; `jerk` is process noise.
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
                    // Unknown so far: what is left beside the flow, of this track and what all share together, is slow. Known:
                    // the flow was part of it.
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

    /// Keeps what the flow between two frames was.
    pub(super) fn pass_flow(&mut self, interval: f64, turn: Option<f64>) {
        let flow = &mut self.flow;
        if interval > 0.0 {
            let is_known = flow.last.len() == flow.next.len();
            let known = if is_known { flow.next.len() } else { 0 };
            flow.speed = (0..known).map(|i| flow.shift(i, turn) / interval).collect();
        }
        // A frame without a view ends what was known of the last.
        if interval > 0.0 || !flow.next.is_empty() {
            flow.last = std::mem::take(&mut flow.next);
        }
    }

    /// What is expected of it where its points are `motions`, without a window.
    pub(super) fn expected(&self, motions: &[PointMotion], scale: f64, common: &CommonMotion) -> ExpectedFeature {
        let mut shape = self.shape.clone();
        for (p, motion) in shape.points_mut().iter_mut().zip(motions) {
            *p = motion.position;
        }
        let covariances = motions.iter().map(|m| m.pp * scale + common.covariance()).collect();
        ExpectedFeature { shape, covariances, window: [0.0; 4], properties: self.properties.clone() }
    }

    /// Takes a detection's properties in.
    pub(super) fn learn_properties(&mut self, found: &Detection, noise: &PropertyNoise) {
        // Ranges change with every pose: nothing is learnt of them.
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
