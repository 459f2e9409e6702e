//! The surfaces of views.

use super::outline::{Areas, Piece};
use crate::geometry::Flat;
use glam::DVec3;
use std::collections::BTreeMap;

/// Convex polygons that explain views.
pub(crate) struct Surfaces {
    /// Origin of all coordinates, metres in the world.
    pub(crate) base: DVec3,
    /// Size of the smallest surfels, metres.
    pub(crate) detail: f64,
    /// Number of omitted points in mirrors.
    pub(crate) mirrored: usize,
    pub(crate) planes: Vec<Flat>,
    pub(crate) pieces: Vec<Piece>,
    /// By plane: weight of its hits, and weight of its passes.
    pub(crate) evidence: Vec<[f64; 2]>,
    /// By plane: the standard deviation along its normal, metres.
    pub(crate) sigmas: Vec<f64>,
    /// By plane: the lowest index of the planes that a chain of views connects with it.
    pub(crate) parts: Vec<u32>,
    /// By plane: unobserved places at its border, and the size of their cells, metres.
    pub(crate) unseen: Vec<(Vec<DVec3>, f64)>,
    /// Pairs of planes that touch, the lower index first.
    pub(crate) adjacent: Vec<[u32; 2]>,
    /// Areas of all planes.
    pub areas: Areas,
}

impl Surfaces {
    /// Areas of the parts that no chain of views connects, square metres, the largest first.
    pub(crate) fn parts(&self) -> Vec<f64> {
        let mut areas = BTreeMap::<u32, f64>::new();
        for piece in &self.pieces {
            *areas.entry(self.parts[piece.plane as usize]).or_default() += piece.area();
        }
        let mut areas: Vec<f64> = areas.into_values().collect();
        areas.sort_by(|a, b| b.total_cmp(a));
        areas
    }
}
