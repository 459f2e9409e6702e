//! Residuals of points and segments that were found in an image.
//!
//! A point of the model is projected; its residuals are the columns and rows between it and the point that was found. A segment
//! that was found is a line: its residuals are the distances of the projected ends of the model's segment from it. Derivatives by
//! the pose are central differences, so that every lens and every scanner is served by one formula.

use super::normal::{CommonError, GroupSum, Normal};
use super::{Gate, Residuals};
use crate::features::turn;
use crate::geometry::Pose;
use crate::matching::{UncertainValue, unwrap};
use crate::motion::{Vector, moved};
use crate::sensor::Sensor;
use glam::{DMat2, DVec2, DVec3};

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

impl<'a> ImageSource<'a> {
    /// A source of what was matched in the image of a sensor.
    pub fn new(sensor: &'a Sensor, points: Vec<SeenPoint>, segments: Vec<SeenSegment>) -> Self {
        Self { sensor, points, segments, turn: turn(sensor) }
    }

    /// Pixel and range of a point of the model.
    fn project(&self, world_from_robot: &Pose, point: DVec3) -> Option<(DVec2, f64)> {
        let body = (*world_from_robot * self.sensor.spec().mount).inverse().transform_point(point);
        let (u, v) = self.sensor.project(self.sensor.body_from_image().transpose() * body)?;
        Some((DVec2::new(u, v), body.length()))
    }

    /// A place beside another one, where columns go round.
    fn unwrapped(&self, at: DVec2, near: DVec2) -> DVec2 {
        at + DVec2::new(unwrap(self.turn, near.x, at.x), 0.0)
    }

    /// The feature of each residual, and whether it is a point's.
    fn owners(&self) -> impl Iterator<Item = (u32, bool)> {
        let points =
            self.points.iter().flat_map(|p| std::iter::repeat_n((p.feature, true), 2 + usize::from(p.range.is_some())));
        points.chain(self.segments.iter().flat_map(|s| [(s.feature, false); 2]))
    }

    /// Residuals in standard deviations; `None` where the model's point is not in front of the sensor.
    fn residuals(&self, pose: &Pose) -> Vec<Option<f64>> {
        let mut all = Vec::with_capacity(2 * (self.points.len() + self.segments.len()));
        for p in &self.points {
            // Whitened by the inverse of a root of the covariance.
            let root = lower_root(p.covariance);
            let seen = self.project(pose, p.point);
            let off = seen.map(|(at, _)| root.inverse() * (self.unwrapped(at, p.found) - p.found));
            all.extend([off.map(|o| o.x), off.map(|o| o.y)]);
            if let Some(measured) = p.range {
                all.push(seen.map(|(_, range)| (range - measured.mean) / measured.variance.sqrt().max(1e-6)));
            }
        }
        for s in &self.segments {
            let [a, b] = s.found;
            let along = (b - a).normalize_or_zero();
            let off = |at: DVec2| along.perp_dot(self.unwrapped(at, a) - a) / s.sigma;
            all.extend(s.ends.map(|end| self.project(pose, end).map(|(at, _)| off(at))));
        }
        all
    }
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
        let here = self.residuals(world_from_robot);
        let shifted: Vec<[Vec<Option<f64>>; 2]> = (0..6)
            .map(|axis| {
                [STEP, -STEP].map(|step| {
                    let mut motion: Vector = [0.0; 6];
                    motion[axis] = step;
                    self.residuals(&moved(world_from_robot, &motion))
                })
            })
            .collect();
        let mut normal = Normal { measured: here.len(), ..Normal::default() };
        let mut sizes = Vec::new();
        for (i, (e, (feature, is_point))) in here.iter().zip(self.owners()).enumerate() {
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
            if !gate.finally {
                continue;
            }
            // Both ends of an edge are off by what the model has it off; a point that is off by d is a robot that is off by -d.
            let error = if is_point { CommonError::Place(feature) } else { CommonError::Edge(feature) };
            let group: &mut GroupSum = normal.groups.entry(error).or_default();
            if is_point {
                (0..6).for_each(|a| (0..3).for_each(|b| group.pull[a][b] -= weight * j[a] * j[b]));
            } else {
                let by_offset = (j[0] * j[0] + j[1] * j[1] + j[2] * j[2]).sqrt();
                (0..6).for_each(|a| group.pull[a][0] -= weight * j[a] * by_offset);
            }
        }
        sizes.sort_by(f64::total_cmp);
        normal.spread = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
        normal
    }
}
