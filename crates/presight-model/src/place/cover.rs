//! Decides whether polygons together cover a patch, by following borders instead of cutting up areas.
//!
//! The points within the tolerance of a polygon form a convex body; K is its section with the patch's plane. H is a
//! convex polygon around K that has K in its interior. H is nowhere farther from the polygon than (1 + [`SLACK`]) times
//! the tolerance. Let some point of the patch be in a K. For each polygon, let the sides of its H, where they are
//! inside the patch, be covered by the K of other polygons. Then the H together cover the patch. Proof: otherwise the
//! uncovered part would have a border inside the connected patch. A point of this border is on a side of an H, so it is
//! in the K of another polygon, and therefore in the interior of that polygon's H, where no border can be.
//!
//! Conversely, a point on a side of an H that no K contains is farther than the tolerance from all polygons, including
//! its own. So a rejected patch is off its polygons, and an accepted one exceeds the tolerance nowhere by more than the
//! slack. Doubled, overlapping and crossing polygons, seams and T-junctions need no special case: sides of an H run
//! inside their neighbours.

use super::coplanar::CoplanarPart;
use super::local::Local;
use super::plane::{PatchPlane, bounds_of, clip, inside, sides, within};
use super::segment::widest_gap;
use crate::error::Result;
use crate::geometry::Aabb;
use crate::index::{Params, QueryResult, Region, Skd, SpatialIndex};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Part of the tolerance by which a patch may exceed it between borders.
pub(super) const SLACK: f64 = 1.0 / 16.0;
/// Minimum distance of an H from its K, relative to the tolerance.
const MARGIN: f64 = 0.01;
/// Evaluations in the search for a point farther off: eight around each of 64 steps.
const FARTHER: usize = 8 * 64;
/// Maximum number of corners cut off an H to bring it near its K. Each cut halves an angle, so few are needed.
const MAX_CUTS: usize = 256;

/// A point of a convex outline that is off all polygons by more than the tolerance; `None` if all of it is covered. At
/// least one corner must be on a polygon. `compare` is called with the number of pairs before polygons are compared.
pub(super) fn uncovered(
    outline: &[DVec2],
    under: &[CoplanarPart<'_>],
    flat: &PatchPlane,
    compare: &dyn Fn(usize) -> Result<()>,
) -> Result<Option<DVec3>> {
    let holds_all = |u: &CoplanarPart<'_>| outline.iter().all(|p| u.local.holds(flat.lift(*p)));
    if under.iter().any(holds_all) {
        return Ok(None);
    }
    let mut cover = PatchCover::new(under, flat);
    for own in 0..under.len() {
        for (u, v) in sides(&under[own].around(flat)) {
            let Some((from, to)) = within((u, v), outline) else { continue };
            if let Some(p) = cover.gap((u.lerp(v, from), u.lerp(v, to)), own, compare)? {
                compare(FARTHER * under.len())?;
                return Ok(Some(flat.lift(farther(p, outline, under, flat))));
            }
        }
    }
    Ok(None)
}

struct PatchCover<'a> {
    under: &'a [CoplanarPart<'a>],
    flat: &'a PatchPlane,
    index: Skd<3>,
    found: QueryResult,
}

impl<'a> PatchCover<'a> {
    fn new(under: &'a [CoplanarPart<'a>], flat: &'a PatchPlane) -> Self {
        let grown = |l: &Local| {
            let b = Aabb::of(l.corners.iter().copied());
            Aabb { min: b.min - l.reach, max: b.max + l.reach }
        };
        let boxes: Vec<(u32, Aabb)> = (0..).zip(under.iter().map(|u| grown(u.local))).collect();
        Self { under, flat, index: Skd::build(Params::default(), &boxes), found: QueryResult::default() }
    }

    /// A point of a line that none of the other polygons covers.
    fn gap(
        &mut self,
        (u, v): (DVec2, DVec2),
        own: usize,
        compare: &dyn Fn(usize) -> Result<()>,
    ) -> Result<Option<DVec2>> {
        let (from, to) = (self.flat.lift(u), self.flat.lift(v));
        self.found.clear();
        self.index.query(&Region::cuboid(&Aabb::of([from, to])), &mut self.found);
        compare(self.found.all().count())?;
        let others = || {
            let all = self.found.all().map(|k| k as usize);
            all.filter(|k| *k != own).map(|k| self.under[k].local)
        };
        // The usual case: the line runs inside one neighbour.
        if others().any(|local| local.over(from, to - from) == Some((0.0, 1.0))) {
            return Ok(None);
        }
        let mut covered: Vec<_> = others().filter_map(|local| local.stretch(from, to - from)).collect();
        Ok(widest_gap(&mut covered).map(|(from, to)| u.lerp(v, 0.5 * (from + to))))
    }
}

impl CoplanarPart<'_> {
    /// The greatest extent of K in a direction of the plane. Each point of the polygon contributes a disc in the plane,
    /// the smaller the higher the point is. The farthest disc belongs to a point on the polygon's outline.
    fn reaches(&self, direction: DVec2) -> f64 {
        let (r, n) = (self.local.reach, self.part.len());
        let of_side = |k: usize| {
            let l = (k + 1) % n;
            let (at, height) = (direction.dot(self.part[k]), self.heights[k]);
            let (along, rise) = (direction.dot(self.part[l]) - at, self.heights[l] - height);
            // The derivative of along + radius is 0 at the height r along / hypot(along, rise), on the falling side.
            let best = (r * along * rise.signum() / along.hypot(rise) - height) / rise;
            let t = if best.is_finite() { best.clamp(0.0, 1.0) } else { f64::from(along > 0.0) };
            at + t * along + (r * r - (height + t * rise).powi(2)).max(0.0).sqrt()
        };
        (0..n).map(of_side).fold(f64::NEG_INFINITY, f64::max)
    }

    pub(super) fn around(&self, flat: &PatchPlane) -> Vec<DVec2> {
        let stand = MARGIN * self.local.reach + self.local.warp;
        let (low, high) = bounds_of(&self.part);
        let (low, high) = (low - 2.0 * self.local.reach - stand, high + 2.0 * self.local.reach + stand);
        let cut = |rest: &[DVec2], n: DVec2| {
            let reach = self.reaches(n) + stand;
            clip(rest, |p| reach - n.dot(*p))
        };
        let compass = (0..8).map(|k| DVec2::from_angle(TAU * f64::from(k) / 8.0));
        let outward = sides(&self.part).filter_map(|(u, v)| (u - v).perp().try_normalize());
        let start = vec![low, DVec2::new(high.x, low.y), high, DVec2::new(low.x, high.y)];
        let mut around = compass.chain(outward).fold(start, |rest, n| cut(&rest, n));
        let most = (1.0 + SLACK) * self.local.reach + self.local.warp;
        for _ in 0..MAX_CUTS {
            let far = |p: &DVec2| self.local.distance(flat.lift(*p)) > most;
            let Some(k) = around.iter().position(far) else { break };
            let n = around.len();
            let outward = |u: DVec2, v: DVec2| (u - v).perp().normalize_or_zero();
            let (before, here, after) = (around[(k + n - 1) % n], around[k], around[(k + 1) % n]);
            let Some(between) = (outward(before, here) + outward(here, after)).try_normalize() else { break };
            around = cut(&around, between);
        }
        around
    }
}

/// From a point that is off, climbs to one nearby that is farther off. Only for the message: no result depends on it.
fn farther(start: DVec2, outline: &[DVec2], under: &[CoplanarPart<'_>], flat: &PatchPlane) -> DVec2 {
    let off = |p: DVec2| under.iter().map(|u| u.local.distance(flat.lift(p))).fold(f64::INFINITY, f64::min);
    let (low, high) = bounds_of(outline);
    let (mut at, mut best, mut step) = (start, off(start), 0.25 * (high - low).max_element());
    for _ in 0..FARTHER / 8 {
        let around = (0..8).map(|k| at + step * DVec2::from_angle(TAU * f64::from(k) / 8.0));
        let inner = around.filter(|p| sides(outline).all(|side| inside(side, *p) >= 0.0));
        match inner.map(|p| (off(p), p)).max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(o, _)| *o > best) {
            Some((o, p)) => (best, at) = (o, p),
            None => step *= 0.5,
        }
    }
    at
}
