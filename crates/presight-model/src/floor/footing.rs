//! The floor around one point of a world.

use super::Mobility;
use super::cover::uncovered;
use super::cut::{above_rectangle, between_heights, distance_from_above, from_above, height_at, heights};
use crate::geometry::Aabb;
use crate::index::{QueryResult, Region};
use crate::world::World;
use glam::{DVec2, DVec3};

/// A part of a floor polygon near a point.
#[derive(Clone, Debug)]
struct Part {
    corners: Vec<DVec3>,
    outline: Vec<DVec2>,
    low: f64,
    high: f64,
}

/// The floor below a robot. Parts that are marked as absent for all sensors do not count.
#[derive(Clone, Debug)]
pub struct Footing {
    /// Height of the floor at the point, metres in the world.
    pub height: f64,
    /// Lowest height of the floor around it, metres.
    pub lowest: f64,
    /// Horizontal distance to the nearest place without this floor, metres; infinite if there is none in the square of
    /// the radius.
    pub edge: f64,
    parts: Vec<Part>,
}

impl Footing {
    /// The floor below a point at about the height of `p`, for a robot of a radius, metres. `None` if there is no floor
    /// within a step, and the rise of the steepest floor over the radius. `found` is memory that queries share.
    pub fn at(world: &World, p: DVec3, radius: f64, mobility: &Mobility, found: &mut QueryResult) -> Option<Self> {
        let (environment, place) = (world.environment(), p.truncate());
        let (min, max) = (place - radius, place + radius);
        let reach = 2.0 * (mobility.step + mobility.rise(radius));
        let bounds = Aabb { min: min.extend(p.z - reach), max: max.extend(p.z + reach) };
        let mut parts: Vec<Part> = Vec::new();
        for (object, polygon) in world.polygons_in(&Region::cuboid(&bounds), None, found) {
            let corners = environment.objects()[object as usize].polygon_in_world(polygon);
            if mobility.facing(&corners).is_none() {
                continue;
            }
            // Relative to the place: differences are exact even far from the world's origin.
            let corners: Vec<DVec3> = corners.into_iter().map(|c| c - place.extend(0.0)).collect();
            let part = above_rectangle(&corners, DVec2::splat(-radius), DVec2::splat(radius));
            let part = between_heights(&part, bounds.min.z, bounds.max.z);
            if part.len() > 2 {
                let (low, high) = heights(&part);
                parts.push(Part { outline: from_above(&part), corners: part, low, high });
            }
        }
        parts.sort_by(|a, b| a.low.total_cmp(&b.low));
        let here = |part: &Part| {
            (distance_from_above(&part.outline, DVec2::ZERO) <= super::SEAM)
                .then(|| height_at(&part.corners, DVec2::ZERO).clamp(part.low, part.high))
        };
        let usual = mobility.step + mobility.rise(radius);
        let near = parts.iter().filter_map(here).filter(|height| (height - p.z).abs() <= usual);
        let height = near.reduce(f64::max)?;
        let group = group_at(&parts, height, mobility.step);
        let parts: Vec<Part> = parts.drain(group).collect();
        let square = [[-radius, -radius], [radius, -radius], [radius, radius], [-radius, radius]].map(DVec2::from);
        let rest = uncovered(&square, parts.iter().map(|part| part.outline.as_slice()));
        let edge = rest.iter().map(|piece| distance_from_above(piece, DVec2::ZERO)).fold(f64::INFINITY, f64::min);
        let lowest = parts.iter().map(|part| part.low).fold(height, f64::min);
        Some(Self { height, lowest, edge, parts })
    }

    /// True if a part of a surface, given by its corners relative to the point (heights in the world), rises above the
    /// floor by more than `clearance`, metres. Where there is no floor, the height at the point counts.
    pub fn is_below(&self, corners: &[DVec3], clearance: f64) -> bool {
        if self.lowest == self.height && self.parts.iter().all(|part| part.low == part.high) {
            return true;
        }
        let floor = |p: DVec3| {
            let above =
                self.parts.iter().filter(|part| distance_from_above(&part.outline, p.truncate()) <= super::SEAM);
            above.map(|part| height_at(&part.corners, p.truncate())).reduce(f64::max).unwrap_or(self.height)
        };
        corners.iter().any(|p| p.z >= floor(*p) + clearance - 1e-9)
    }
}

/// The parts, by rising height, that are connected by steps with the part at a height.
fn group_at(parts: &[Part], height: f64, step: f64) -> std::ops::Range<usize> {
    let (mut start, mut high) = (0, f64::NEG_INFINITY);
    for (k, part) in parts.iter().enumerate() {
        if part.low - high > step {
            if high >= height {
                return start..k;
            }
            start = k;
        }
        high = high.max(part.high);
    }
    start..parts.len()
}

/// Height of the highest floor below a point, metres in the world: of the highest surface that is level enough; `None`
/// if there is none within `reach`. Parts that are marked as absent for all sensors do not count.
pub fn height_below(world: &World, at: DVec3, reach: f64, mobility: &Mobility, found: &mut QueryResult) -> Option<f64> {
    let environment = world.environment();
    let below =
        world.polygons_in(&Region::ray(at, DVec3::NEG_Z, reach), None, found).filter_map(|(object, polygon)| {
            let corners = environment.objects()[object as usize].polygon_in_world(polygon);
            let corners: Vec<DVec3> = corners.into_iter().map(|c| c - at).collect();
            mobility.facing(&corners)?;
            let is_below = distance_from_above(&from_above(&corners), DVec2::ZERO) == 0.0;
            let height = is_below.then(|| height_at(&corners, DVec2::ZERO))?;
            (height <= 0.0 && height >= -reach).then_some(at.z + height)
        });
    below.reduce(f64::max)
}
