//! Ray tables (lens distortion, listed rays): each polygon against the rays of the tiles that its cone may touch.

use super::Bands;
use super::batch::{Batch, NOTHING, SetUp};
use super::spans::{Buffer, EIGHT};
use crate::sensor::{RayGrid, Tile};
use glam::DVec3;

/// Bands hold whole rows of tiles.
pub(super) const BAND_MULTIPLE: usize = 8;

/// Tiles, side by side, that a polygon is held to at once.
const GROUP: usize = 8;

/// Directions about an axis.
#[derive(Clone, Copy, Debug)]
struct Cone {
    axis: DVec3,
    /// Of the half angle; above 1 where that is no bound.
    sine_squared: f64,
}

impl Cone {
    fn new(axis: DVec3, half_angle: f64) -> Self {
        /// Far more than roundings of angles and products.
        const SLACK: f64 = 1e-9;
        let sine = if half_angle < 1.5 { (half_angle + SLACK).sin() } else { 2.0 };
        Self { axis, sine_squared: sine * sine }
    }

    fn around(tiles: &[(&Tile, Self)]) -> Self {
        let axis = tiles.iter().map(|(t, _)| t.axis).sum::<DVec3>().normalize_or_zero();
        if axis == DVec3::ZERO {
            return Self::new(axis, f64::INFINITY);
        }
        let half = |t: &Tile| axis.cross(t.axis).length().atan2(axis.dot(t.axis)) + t.half_angle;
        Self::new(axis, tiles.iter().map(|(t, _)| half(t)).fold(0.0, f64::max))
    }

    /// False only if all of it is beyond one of a polygon's edge planes.
    #[inline(always)]
    fn may_meet(&self, edges: &[DVec3]) -> bool {
        edges.iter().all(|e| {
            let d = e.dot(self.axis);
            d >= 0.0 || d * d <= self.sine_squared * e.length_squared()
        })
    }
}

/// Draws the polygons of some batches into a band.
#[inline(always)]
pub(super) fn rasterize(
    buffer: &mut Buffer,
    grid: &RayGrid,
    batches: &[Batch],
    slots: &[u32],
    bands: &Bands,
    band: usize,
) {
    let lines = bands.lines(band);
    let tiles: Vec<(&Tile, Cone)> = grid
        .tiles()
        .iter()
        .filter(|t| lines.contains(&(t.row as usize)) && t.half_angle >= 0.0)
        .map(|t| (t, Cone::new(t.axis, t.half_angle)))
        .collect();
    let groups: Vec<(Cone, &[(&Tile, Cone)])> = tiles.chunks(GROUP).map(|some| (Cone::around(some), some)).collect();
    for batch in batches {
        for &i in batch.in_band(band) {
            let polygon = &batch.polygons[i as usize];
            let first = polygon.first_edge as usize;
            let edges = &batch.edges[first..first + usize::from(polygon.steep)];
            for (_, some) in groups.iter().filter(|(cone, _)| cone.may_meet(edges)) {
                for (tile, _) in some.iter().filter(|(_, cone)| cone.may_meet(edges)) {
                    draw(buffer, grid, (slots, batch.first_number + i), polygon, edges, tile, lines.start);
                }
            }
        }
    }
}

#[inline(always)]
fn draw(
    buffer: &mut Buffer,
    grid: &RayGrid,
    (slots, number): (&[u32], u32),
    polygon: &SetUp,
    edges: &[DVec3],
    tile: &Tile,
    first_line: usize,
) {
    let width = grid.width() as usize;
    for row in tile.row as usize..(tile.row + tile.height) as usize {
        let columns = tile.column as usize..(tile.column + tile.width) as usize;
        for column in columns {
            // A missing ray is NaN and fails every test.
            let ray = grid.directions()[row * width + column];
            if !edges.iter().all(|e| e.dot(ray) >= 0.0) {
                continue;
            }
            let k = polygon.m.dot(ray);
            let (at, i) = (buffer.at(row - first_line, column / EIGHT), column % EIGHT);
            let (inverse, before) = (&mut buffer.inverse[at].0[i], &mut buffer.winner[at].0[i]);
            let held = *before as u32;
            let lower = || held != NOTHING && slots[number as usize] < slots[held as usize];
            if k > *inverse || (k == *inverse && lower()) {
                *inverse = k;
                *before = number.into();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn direction() -> impl Strategy<Value = DVec3> {
        let some = proptest::array::uniform3(-1.0..1.0f64).prop_map(DVec3::from);
        some.prop_filter("no direction", |v| v.length() > 0.1).prop_map(DVec3::normalize)
    }

    proptest! {
        /// A polygon that covers a ray of a tile may meet the tile and the group around it.
        #[test]
        fn nothing_that_covers_a_ray_is_passed_over(
            axes in proptest::collection::vec(direction(), 1..9),
            half_angle in 0.0..1.6f64,
            turn in direction(),
            share in 0.0..=1.0f64,
            edges in proptest::collection::vec(direction(), 3..6),
        ) {
            let tile = |axis: &DVec3| Tile { column: 0, row: 0, width: 8, height: 8, axis: *axis, half_angle };
            let tiles: Vec<Tile> = axes.iter().map(tile).collect();
            let each: Vec<(&Tile, Cone)> = tiles.iter().map(|t| (t, Cone::new(t.axis, t.half_angle))).collect();
            let around = Cone::around(&each);
            for (tile, cone) in &each {
                let beside = (turn - tile.axis * turn.dot(tile.axis)).normalize_or_zero();
                let angle = share * half_angle;
                let ray = tile.axis * angle.cos() + beside * angle.sin();
                let inward: Vec<DVec3> = edges.iter().map(|e| *e * e.dot(ray).signum()).collect();
                prop_assert!(cone.may_meet(&inward) && around.may_meet(&inward));
            }
        }
    }
}
