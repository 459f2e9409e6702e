//! Residuals of points and segments that were found in an image.
//!
//! A point of the model is projected; its residuals are the columns and rows between it and the point that was found. A segment
//! that was found is a line: its residuals are the distances of the projected ends of the model's segment from it. Derivatives by
//! the pose are central differences, so that every lens and every scanner is served by one formula.

use super::normal::{CommonError, GroupSum, Normal};
use super::range::EXPLAINED;
use super::{Gate, Residuals};
use crate::extract::range_to;
use crate::matching::{UncertainValue, unwrap};
use crate::motion::{Vector, moved};
use glam::{DMat2, DMat3, DVec2, DVec3};
use presight_features::turn;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::statistics::upper_median;

/// A point of the model, and where it was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenPoint {
    /// In the world, metres.
    pub point: DVec3,
    /// Column and row.
    pub found: DVec2,
    /// Of the place that was found, pixels squared.
    pub covariance: DMat2,
    /// Metres along the ray, where the sensor measured them: of a reflector in a scan.
    pub range: Option<UncertainValue>,
    /// Covariance of where the model has it, world axes, metres squared, as a part of its residuals' noise: of a reflector, whose
    /// columns, rows and range it makes depend on each other. Of others it is 0: their error is shared ([`CommonError::Place`]).
    pub place: DMat3,
    /// Points of one feature share the error of its place.
    pub feature: u32,
}

/// A segment of the model, and the line on which it was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenSegment {
    /// Ends of the visible part, in the world, metres.
    pub ends: [DVec3; 2],
    /// Two points of the line: column and row.
    pub found: [DVec2; 2],
    /// How far each of these may be off across the line, one standard deviation, pixels.
    pub sigma: f64,
    /// Parts of one feature share the feature's own error.
    pub feature: u32,
}

/// What an image says of the pose.
#[derive(Clone, Debug)]
pub struct ImageSource<'a> {
    sensor: &'a Sensor,
    points: Vec<SeenPoint>,
    segments: Vec<SeenSegment>,
    /// Columns of a full turn.
    turn: Option<f64>,
}

/// Steps of the differences: metres and radians. Far below a pixel, far above rounding.
const STEP: f64 = 1e-5;
/// Least standard deviation of a range, metres.
const LEAST_RANGE: f64 = 1e-6;

impl<'a> ImageSource<'a> {
    /// A source of what was matched in the image of a sensor.
    pub fn new(sensor: &'a Sensor, points: Vec<SeenPoint>, segments: Vec<SeenSegment>) -> Self {
        Self { sensor, points, segments, turn: turn(sensor) }
    }

    /// Column, row and range of a point of the model.
    fn project(&self, world_from_robot: &Pose, point: DVec3) -> Option<DVec3> {
        let body = (*world_from_robot * self.sensor.spec().mount).inverse().transform_point(point);
        let p = self.sensor.body_from_image().transpose() * body;
        let (u, v) = self.sensor.project(p)?;
        Some(DVec3::new(u, v, range_to(self.sensor, p)))
    }

    /// What makes residuals of a point independent ones of variance 1.
    fn whitening(&self, pose: &Pose, p: &SeenPoint) -> Option<DMat3> {
        let c = p.covariance;
        let Some(range) = p.range else {
            let inverse = lower_root(c).inverse();
            return Some(DMat3::from_cols(inverse.x_axis.extend(0.0), inverse.y_axis.extend(0.0), DVec3::ZERO));
        };
        let (own, variance) = (DMat3::from_mat2(c), range.variance.max(LEAST_RANGE * LEAST_RANGE));
        let own = DMat3 { z_axis: DVec3::new(0.0, 0.0, variance), ..own };
        if p.place == DMat3::ZERO {
            return lower_root3(own);
        }
        let here = self.project(pose, p.point)?;
        let by = |axis: DVec3| -> Option<DVec3> {
            let there = self.project(pose, p.point + STEP * axis)?;
            Some((self.near(there, here.truncate()) - here) / STEP)
        };
        let moves = DMat3::from_cols(by(DVec3::X)?, by(DVec3::Y)?, by(DVec3::Z)?);
        lower_root3(own + moves * p.place * moves.transpose())
    }

    /// A place beside another one, where columns go round.
    fn near(&self, at: DVec3, near: DVec2) -> DVec3 {
        self.unwrapped(at.truncate(), near).extend(at.z)
    }

    /// A place beside another one, where columns go round.
    fn unwrapped(&self, at: DVec2, near: DVec2) -> DVec2 {
        at + DVec2::new(unwrap(self.turn, near.x, at.x), 0.0)
    }

    /// The error that each residual shares with others; `None` if its noise has all of it.
    fn shared(&self) -> impl Iterator<Item = Option<CommonError>> {
        let of_point = |p: &SeenPoint| {
            let error = (p.place == DMat3::ZERO).then_some(CommonError::Place(p.feature));
            std::iter::repeat_n(error, 2 + usize::from(p.range.is_some()))
        };
        let of_segment = |s: &SeenSegment| [Some(CommonError::Edge(s.feature)); 2];
        self.points.iter().flat_map(of_point).chain(self.segments.iter().flat_map(of_segment))
    }

    /// Residuals in standard deviations; `None` where the model's point is not in front of the sensor. `whitening` is that of each point.
    fn residuals(&self, pose: &Pose, whitening: &[Option<DMat3>]) -> Vec<Option<f64>> {
        let mut all = Vec::with_capacity(3 * self.points.len() + 2 * self.segments.len());
        for (p, whitening) in self.points.iter().zip(whitening) {
            let found = p.found.extend(p.range.map_or(0.0, |r| r.mean));
            let seen = self.project(pose, p.point).zip(*whitening);
            let off = seen.map(|(at, whitening)| whitening * (self.near(at, p.found) - found));
            all.extend([off.map(|o| o.x), off.map(|o| o.y)]);
            if p.range.is_some() {
                all.push(off.map(|o| o.z));
            }
        }
        for s in &self.segments {
            let [a, b] = s.found;
            let along = (b - a).normalize_or_zero();
            let off = |at: DVec2| along.perp_dot(self.unwrapped(at, a) - a) / s.sigma;
            all.extend(s.ends.map(|end| self.project(pose, end).map(|at| off(at.truncate()))));
        }
        all
    }

    fn whitenings(&self, pose: &Pose) -> Vec<Option<DMat3>> {
        self.points.iter().map(|p| self.whitening(pose, p)).collect()
    }

    /// Features of points with a range, and whether the pose explains all residuals of each.
    pub(super) fn ranged(&self, pose: &Pose) -> Vec<(u32, bool)> {
        let residuals = self.residuals(pose, &self.whitenings(pose));
        let mut at = 0;
        let mut told = Vec::new();
        for p in &self.points {
            let count = 2 + usize::from(p.range.is_some());
            let fits = |e: &Option<f64>| e.is_some_and(|e| e.abs() <= EXPLAINED);
            if p.range.is_some() {
                told.push((p.feature, residuals[at..at + count].iter().all(fits)));
            }
            at += count;
        }
        told
    }
}

/// The inverse of L with L L' = m; `None` unless m is positive.
fn lower_root3(m: DMat3) -> Option<DMat3> {
    let a = m.x_axis.x.sqrt();
    let (b, d) = (m.x_axis.y / a, m.x_axis.z / a);
    let c = (m.y_axis.y - b * b).sqrt();
    let e = (m.y_axis.z - d * b) / c;
    let f = (m.z_axis.z - d * d - e * e).sqrt();
    let root = DMat3::from_cols(DVec3::new(a, b, d), DVec3::new(0.0, c, e), DVec3::new(0.0, 0.0, f));
    let inverse = root.inverse();
    inverse.is_finite().then_some(inverse)
}

/// L with L L' = m, of a positive matrix.
fn lower_root(m: DMat2) -> DMat2 {
    let a = m.x_axis.x.max(1e-12).sqrt();
    let b = m.x_axis.y / a;
    DMat2::from_cols(DVec2::new(a, b), DVec2::new(0.0, (m.y_axis.y - b * b).max(1e-12).sqrt()))
}

/// Of one residual by the six numbers of the pose.
fn derivatives(shifted: &[[Vec<Option<f64>>; 2]], i: usize) -> Option<Vector> {
    let mut j = [0.0; 6];
    for (axis, [ahead, back]) in shifted.iter().enumerate() {
        j[axis] = (ahead[i]? - back[i]?) / (2.0 * STEP);
    }
    Some(j)
}

impl Residuals for ImageSource<'_> {
    fn linearize(&self, world_from_robot: &Pose, gate: &Gate) -> Normal {
        let whitening = self.whitenings(world_from_robot);
        let here = self.residuals(world_from_robot, &whitening);
        let shifted: Vec<[Vec<Option<f64>>; 2]> = (0..6)
            .map(|axis| {
                [STEP, -STEP].map(|step| {
                    let mut motion: Vector = [0.0; 6];
                    motion[axis] = step;
                    self.residuals(&moved(world_from_robot, &motion), &whitening)
                })
            })
            .collect();
        let mut normal = Normal { measured: here.len(), ..Normal::default() };
        let mut sizes = Vec::new();
        for (i, (e, shared)) in here.iter().zip(self.shared()).enumerate() {
            let j = derivatives(&shifted, i);
            let (Some(e), Some(j)) = (*e, j) else {
                normal.chi2 += gate.kernel.most();
                continue;
            };
            // In pixels the gate is as wide as the pose's uncertainty moves this very residual.
            let metres = (0..3).map(|k| j[k].abs()).fold(0.0, f64::max) * gate.translation;
            let radians = (3..6).map(|k| j[k].abs()).fold(0.0, f64::max) * gate.rotation;
            sizes.push(e.abs());
            let weight = normal.add_residual(e, &j, metres + radians, gate.kernel);
            let Some(error) = shared.filter(|_| gate.finally) else { continue };
            // Both ends of an edge are off by what the model has it off; a point that is off by d is a robot that is off by -d.
            let group: &mut GroupSum = normal.groups.entry(error).or_default();
            if matches!(error, CommonError::Place(_)) {
                (0..6).for_each(|a| (0..3).for_each(|b| group.pull[a][b] -= weight * j[a] * j[b]));
            } else {
                let by_offset = (j[0] * j[0] + j[1] * j[1] + j[2] * j[2]).sqrt();
                (0..6).for_each(|a| group.pull[a][0] -= weight * j[a] * by_offset);
            }
        }
        normal.spread = upper_median(&mut sizes, f64::total_cmp).unwrap_or(0.0);
        normal
    }
}
