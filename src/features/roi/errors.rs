//! The error model: sensor, object and feature as one standard normal vector, and what it does to material points.

use super::PoseCovariance;
use crate::environment::FeatureShape;
use crate::features::normal::square_root;
use crate::geometry::Pose;
use glam::{DMat3, DQuat, DVec3};

/// The uncertain state of one feature: all errors, through one matrix.
#[derive(Clone, Debug)]
pub struct Uncertain {
    body_from_world: DMat3,
    /// Body from the feature's frame, composed in f64 with world positions subtracted first.
    body_from_frame: DMat3,
    /// The frame's origin relative to the sensor's, world axes.
    apart: DVec3,
    /// Columns of the square root: what one unit of each standard normal does.
    columns: Vec<Error>,
}

/// Errors of all kinds: sensor (world axes), object (its own axes), both ends of the feature (its frame).
#[derive(Clone, Copy, Debug, Default)]
struct Error {
    sensor: [DVec3; 2],
    object: [DVec3; 2],
    ends: [DVec3; 2],
}

/// A material point of a feature: where it is in the feature's frame, and how much of each end's error it takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Position in the feature's frame, metres.
    pub at: DVec3,
    /// Shares of the errors of the first and the second end; (1, 0) for features that move as a whole.
    pub shares: [f64; 2],
}

impl Material {
    /// A point of a feature: by its share t of the length for segments, or anywhere on one that moves as a whole.
    pub fn on_segment(ends: &[DVec3; 2], t: f64) -> Self {
        Self { at: ends[0].lerp(ends[1], t), shares: [1.0 - t, t] }
    }

    /// A point of a feature that moves as a whole.
    pub fn rigid(at: DVec3) -> Self {
        Self { at, shares: [1.0, 0.0] }
    }
}

impl Uncertain {
    /// The errors of a feature seen from a pose. `world_from_frame` is the pose of the feature's object (identity for
    /// the world) with its covariance in the object's own axes; the sensor's covariance is along the world's axes,
    /// rotation by Exp(dtheta) from the left.
    pub fn new(
        world_from_body: &Pose,
        sensor: &PoseCovariance,
        world_from_frame: &Pose,
        object: Option<&PoseCovariance>,
        shape: &FeatureShape,
    ) -> Self {
        let body_from_world = world_from_body.rotation_matrix().transpose();
        let mut columns = Vec::new();
        let pair = |f: &[[f64; 6]; 6], c: usize| {
            [DVec3::new(f[0][c], f[1][c], f[2][c]), DVec3::new(f[3][c], f[4][c], f[5][c])]
        };
        let mut add = |factor: [[f64; 6]; 6], put: fn([DVec3; 2]) -> Error| {
            for c in 0..6 {
                let column = pair(&factor, c);
                if column != [DVec3::ZERO; 2] {
                    columns.push(put(column));
                }
            }
        };
        add(square_root(sensor), |sensor| Error { sensor, ..Error::default() });
        if let Some(object) = object {
            add(square_root(object), |object| Error { object, ..Error::default() });
        }
        add(square_root(&ends_covariance(shape)), |ends| Error { ends, ..Error::default() });
        Self {
            body_from_world,
            body_from_frame: body_from_world * world_from_frame.rotation_matrix(),
            apart: world_from_frame.translation - world_from_body.translation,
            columns,
        }
    }

    /// Number of independent errors.
    pub fn dimensions(&self) -> usize {
        self.columns.len()
    }

    /// Where a point comes to be, body frame, under errors `xi` (standard normal, one for each dimension); exact.
    pub fn place(&self, point: &Material, xi: &[f64]) -> DVec3 {
        let mut e = Error::default();
        for (column, x) in self.columns.iter().zip(xi) {
            for i in 0..2 {
                e.sensor[i] += column.sensor[i] * *x;
                e.object[i] += column.object[i] * *x;
                e.ends[i] += column.ends[i] * *x;
            }
        }
        let p = point.at + e.ends[0] * point.shares[0] + e.ends[1] * point.shares[1];
        let p = DQuat::from_scaled_axis(e.object[1]) * p + e.object[0];
        // Object and sensor may turn by large angles: their pose errors are exact, not linear.
        let in_body = self.body_from_frame * p + self.body_from_world * (self.apart - e.sensor[0]);
        let turned = self.body_from_world * e.sensor[1];
        DQuat::from_scaled_axis(-turned) * in_body
    }

    /// Derivatives of [`Uncertain::place`] at no error, one a dimension.
    pub(super) fn slopes(&self, point: &Material) -> Vec<DVec3> {
        let in_body = self.place(point, &[]);
        let slope = |c: &Error| {
            let p =
                c.ends[0] * point.shares[0] + c.ends[1] * point.shares[1] + c.object[1].cross(point.at) + c.object[0];
            let turned = self.body_from_world * c.sensor[1];
            self.body_from_frame * p - self.body_from_world * c.sensor[0] - turned.cross(in_body)
        };
        self.columns.iter().map(slope).collect()
    }
}

/// Covariance of both ends, 6 x 6; features that move as a whole have one end.
fn ends_covariance(shape: &FeatureShape) -> [[f64; 6]; 6] {
    let mut all = [[0.0; 6]; 6];
    let mut put = |row: usize, column: usize, m: &DMat3| {
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            all[row + i][column + j] = m.col(j)[i];
        }
    };
    match shape {
        FeatureShape::Segment { covariances: [a, b], cross, .. } => {
            put(0, 0, a);
            put(3, 3, b);
            put(0, 3, cross);
            put(3, 0, &cross.transpose());
        }
        FeatureShape::Point { covariance, .. }
        | FeatureShape::Patch { covariance, .. }
        | FeatureShape::Reflector { covariance, .. }
        | FeatureShape::Fiducial { covariance, .. } => put(0, 0, covariance),
    }
    all
}
