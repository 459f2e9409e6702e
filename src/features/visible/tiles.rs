//! What may hide something in a direction: polygons by tiles of a cube around the sensor, found once for all features.

use super::Frame;
use super::known::Faces;
use crate::index::{Found, Region};
use glam::DVec3;
use std::collections::HashMap;

/// About how wide a tile is, pixels: smaller ones ask the index more often, larger ones hold more polygons.
const PIXELS: f64 = 64.0;
/// Most tiles along a side of the cube: their numbers fit in 32 bits.
const MAX_ACROSS: f64 = 16_384.0;
/// How far a tile reaches over its sides, in coordinates on the cube: places between two in a tile may be out of it by
/// rounding.
const SLACK: f64 = 1e-9;
/// How much farther than needed polygons are asked for, so that the next feature need not ask again.
const FARTHER: f64 = 1.25;

/// A polygon that covers a ray of the tile.
pub(super) struct Candidate {
    /// n / d, beside its number: most are passed over by it alone.
    pub inverse: DVec3,
    /// Number among the faces.
    pub face: u32,
}

/// Tiles of the cube [-1, 1]^3 around the sensor, image axes: pyramids with their apex at the sensor, so that what lies
/// between two places in a tile lies in it.
pub(super) struct Tiles {
    /// Tiles along a side.
    across: f64,
    known: HashMap<u32, Tile>,
    found: Found,
}

/// Polygons in a tile, up to a range in metres.
struct Tile {
    radius: f64,
    candidates: Vec<Candidate>,
}

impl Tiles {
    /// For a sensor whose neighbouring rays are about that far apart, radians.
    pub fn new(pixel_angle: f64) -> Self {
        let across = (2.0 / (PIXELS * pixel_angle)).ceil().clamp(1.0, MAX_ACROSS);
        Self { across, known: HashMap::new(), found: Found::default() }
    }

    /// The tile of a place that is not the sensor's.
    #[inline]
    pub fn of(&self, at: DVec3) -> u32 {
        let size = at.abs();
        let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 1 + usize::from(size.z > size.y) };
        let half = 0.5 * self.across / size[axis];
        let number = |other: usize| (at[other] * half + 0.5 * self.across).clamp(0.0, self.across - 1.0) as u32;
        let side = 2 * axis as u32 + u32::from(at[axis] < 0.0);
        let across = self.across as u32;
        (side * across + number((axis + 1) % 3)) * across + number((axis + 2) % 3)
    }

    /// Rays along the edges of a tile, in turn.
    fn corners(&self, tile: u32) -> [DVec3; 4] {
        let across = self.across as u32;
        let (side, first, second) = (tile / across / across, tile / across % across, tile % across);
        let axis = (side / 2) as usize;
        let bounds = |number: u32| {
            let at = |n: u32| 2.0 * f64::from(n) / self.across - 1.0;
            [at(number) - SLACK, at(number + 1) + SLACK]
        };
        let (u, v) = (bounds(first), bounds(second));
        [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| {
            let mut ray = DVec3::ZERO;
            ray[axis] = if side % 2 == 0 { 1.0 } else { -1.0 };
            ray[(axis + 1) % 3] = u[i];
            ray[(axis + 2) % 3] = v[j];
            ray
        })
    }

    /// Polygons that may hide something in a tile, up to a range in metres at least.
    pub fn candidates(&mut self, frame: &Frame<'_>, faces: &mut Faces, tile: u32, farthest: f64) -> &[Candidate] {
        if self.known.get(&tile).is_none_or(|known| known.radius < farthest) {
            let candidates = self.find(frame, faces, tile, FARTHER * farthest);
            self.known.insert(tile, Tile { radius: FARTHER * farthest, candidates });
        }
        &self.known[&tile].candidates
    }

    fn find(&mut self, frame: &Frame<'_>, faces: &mut Faces, tile: u32, radius: f64) -> Vec<Candidate> {
        let corners = self.corners(tile);
        let middle: DVec3 = corners.iter().sum();
        let world_from_image = frame.image_from_world.transpose();
        let planes = [0, 1, 2, 3].map(|k| {
            let normal = corners[k].cross(corners[(k + 1) % 4]);
            world_from_image * (normal.dot(middle).signum() * normal.normalize())
        });
        let region = Region::frustum(frame.world_from_sensor.translation, &planes, radius);
        self.found.clear();
        frame.world.index().query(frame.environment, &region, &mut self.found);
        let mut candidates = Vec::new();
        for slot in self.found.all() {
            let Some(face) = faces.of_slot(frame, slot) else { continue };
            let known = &faces.known[face];
            let beside = |e: &DVec3| corners.iter().all(|c| e.dot(*c) < 0.0);
            if known.covers && !faces.planes_of(known).iter().any(beside) {
                candidates.push(Candidate { inverse: known.inverse, face: face as u32 });
            }
        }
        candidates
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// What is between two places in a tile is in the tile's pyramid, and so are both.
        #[test]
        fn tiles_are_convex(
            a in proptest::array::uniform3(-1.0..1.0f64),
            near in proptest::array::uniform3(-0.1..0.1f64),
            share in 0.0..=1.0f64,
            angle in 1e-4..0.5f64,
        ) {
            let tiles = Tiles::new(angle);
            let (a, b) = (DVec3::from(a), 3.0 * (DVec3::from(a) + angle * DVec3::from(near)));
            prop_assume!(a.length() > 0.1 && tiles.of(a) == tiles.of(b));
            let corners = tiles.corners(tiles.of(a));
            let middle: DVec3 = corners.iter().sum();
            for k in 0..4 {
                let normal = corners[k].cross(corners[(k + 1) % 4]);
                let inward = normal.dot(middle).signum() * normal.normalize();
                for p in [a, b, a.lerp(b, share)] {
                    prop_assert!(inward.dot(p) >= 0.0, "{inward} {p}");
                }
            }
        }
    }

    #[test]
    fn all_tiles_are_different() {
        let tiles = Tiles::new(0.01);
        let mut seen = std::collections::HashSet::new();
        for tile in 0..6 * (tiles.across * tiles.across) as u32 {
            let middle: DVec3 = tiles.corners(tile).iter().sum();
            assert_eq!(tiles.of(middle), tile);
            assert!(seen.insert(middle.to_array().map(f64::to_bits)));
        }
    }
}
