//! Sums over surfels, and the planes that fit them.

use crate::geometry::Flat;
use crate::surfels::Surfel;
use glam::{DMat3, DVec3};
use presight_model::matrix;

/// Sums over surfels that determine a plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moments {
    pub count: f64,
    /// Sum of the weights.
    pub weight: f64,
    at: DVec3,
    outer: DMat3,
    normal: DVec3,
    weighted_normal: DVec3,
}

impl Moments {
    pub const ZERO: Self = Self {
        count: 0.0,
        weight: 0.0,
        at: DVec3::ZERO,
        outer: DMat3::ZERO,
        normal: DVec3::ZERO,
        weighted_normal: DVec3::ZERO,
    };

    /// Adds a surfel with this weight.
    pub fn add(&mut self, s: &Surfel, weight: f64) {
        let p = s.at * weight;
        self.count += 1.0;
        self.weight += weight;
        self.at += p;
        self.outer += DMat3::from_cols(s.at * p.x, s.at * p.y, s.at * p.z);
        self.normal += s.normal;
        self.weighted_normal += s.normal * weight;
    }

    /// The sums of both.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            weight: self.weight + other.weight,
            at: self.at + other.at,
            outer: self.outer + other.outer,
            normal: self.normal + other.normal,
            weighted_normal: self.weighted_normal + other.weighted_normal,
        }
    }

    /// Variances along the principal axes, ascending, and the direction of the smallest.
    fn principal(&self) -> ([f64; 3], DVec3) {
        let c = self.at / self.weight;
        let m = self.outer * (1.0 / self.weight) - DMat3::from_cols(c * c.x, c * c.y, c * c.z);
        let mut a = [[0.0; 6]; 6];
        (0..3).for_each(|i| (0..3).for_each(|j| a[i][j] = m.col(j)[i]));
        let (values, vectors) = matrix::eigen(a, 3);
        let mut order = [0, 1, 2];
        order.sort_by(|i, j| values[*i].total_cmp(&values[*j]));
        let axis = order[0];
        (order.map(|k| values[k].max(0.0)), DVec3::new(vectors[0][axis], vectors[1][axis], vectors[2][axis]))
    }

    /// The plane that fits best. The mean normal decides for few surfels and for surfels along a line.
    pub fn plane(&self) -> Flat {
        let (variances, axis) = self.principal();
        let mean = self.weighted_normal.normalize_or(DVec3::Z);
        let normal = if self.count < 6.0 || variances[1] < 4.0 * variances[0] { mean } else { axis };
        let normal = if normal.dot(mean) < 0.0 { -normal } else { normal };
        Flat { centre: self.at / self.weight, normal }
    }

    /// The cost of one plane for all surfels, square metres: squared distances, and `normals` times the spread of the
    /// normals.
    pub fn cost(&self, normals: f64) -> f64 {
        if self.count < 1.0 {
            return 0.0;
        }
        self.principal().0[0] * self.weight + normals * (self.count - self.normal.length())
    }
}
