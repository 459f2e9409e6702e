//! Surfaces that were found.

use super::outline::{Areas, Piece};
use crate::geometry::Flat;
use glam::DVec3;
use std::collections::BTreeMap;

/// Convex polygons that explain views.
pub(crate) struct Surfaces {
    /// Metres in the world: what all coordinates count from.
    pub(crate) base: DVec3,
    pub(crate) detail: f64,
    /// Points behind mirrors, which are left out.
    pub(crate) mirrored: usize,
    pub(crate) planes: Vec<Flat>,
    pub(crate) pieces: Vec<Piece>,
    /// By plane: rays that ended on it, and that went through.
    pub(crate) evidence: Vec<[f64; 2]>,
    /// By plane: its standard deviation along its normal, metres.
    pub(crate) sigmas: Vec<f64>,
    /// By plane: the lowest plane that a chain of views joins it with.
    pub(crate) parts: Vec<u32>,
    /// By plane: places at its border that nobody saw, and the side of their cells.
    pub(crate) unseen: Vec<(Vec<DVec3>, f64)>,
    /// Numbers of planes that touch, rising.
    pub(crate) beside: Vec<[u32; 2]>,
    /// Areas over all planes.
    pub areas: Areas,
}

impl Surfaces {
    /// Area of each part that no chain of views joins with another, square metres, the largest first.
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
