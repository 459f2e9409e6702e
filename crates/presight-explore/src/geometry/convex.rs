//! Decomposition of an area with holes into convex polygons.

use super::cells::area;
use glam::DVec2;
use presight_model::limits;
use presight_model::union_find::UnionFind;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};
use std::collections::HashMap;

/// Maximum number of corners of a polygon. It stays far below the limit of a model, because many corners slow every
/// engine's worst case.
const MAX_CORNERS: usize = if limits::MAX_CORNERS < 24 { limits::MAX_CORNERS } else { 24 };

/// Convex polygons that cover what the closed lines enclose an odd number of times, counter-clockwise. Lines may cross.
pub(crate) fn convex(lines: &[Vec<DVec2>]) -> Vec<Vec<DVec2>> {
    let mut triangulation = ConstrainedDelaunayTriangulation::<Point2<f64>>::new();
    for line in lines {
        let inserted: Result<Vec<_>, _> = line.iter().map(|p| triangulation.insert(Point2::new(p.x, p.y))).collect();
        // The points are finite, so they can be inserted.
        let Ok(corners) = inserted else { continue };
        for k in 0..corners.len() {
            let (from, to) = (corners[k], corners[(k + 1) % corners.len()]);
            // Simplified lines may cross. Each triangle around such a crossing is kept if its centroid is enclosed.
            if triangulation.can_add_constraint(from, to) {
                triangulation.add_constraint(from, to);
            }
        }
    }
    let mut pieces = Pieces::default();
    for face in triangulation.inner_faces() {
        let corners = face.vertices().map(|v| v.index() as u32);
        let [a, b, c] = face.positions().map(|p| DVec2::new(p.x, p.y));
        let is_flat = (b - a).perp_dot(c - a) < 1e-10;
        if !is_flat && is_enclosed((a + b + c) / 3.0, lines) {
            pieces.polygons.push(corners.to_vec());
        }
    }
    pieces.points = triangulation.vertices().map(|v| DVec2::new(v.position().x, v.position().y)).collect();
    pieces.merge();
    pieces.straighten();
    let is_sound = |p: &Vec<DVec2>| p.len() > 2 && area(p) > 1e-9;
    pieces.polygons.iter().map(|p| p.iter().map(|k| pieces.points[*k as usize]).collect()).filter(is_sound).collect()
}

/// True if the lines enclose a point an odd number of times.
fn is_enclosed(p: DVec2, lines: &[Vec<DVec2>]) -> bool {
    let crosses =
        |a: DVec2, b: DVec2| (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x);
    let crossed = |line: &Vec<DVec2>| (0..line.len()).filter(|k| crosses(line[*k], line[(k + 1) % line.len()])).count();
    lines.iter().map(crossed).sum::<usize>() % 2 == 1
}

#[derive(Default)]
struct Pieces {
    points: Vec<DVec2>,
    polygons: Vec<Vec<u32>>,
}

impl Pieces {
    /// Drops inner edges, the longest first, as long as the pieces stay convex (Hertel and Mehlhorn).
    fn merge(&mut self) {
        let mut sides: HashMap<(u32, u32), u32> = HashMap::new();
        for (polygon, i) in self.polygons.iter().zip(0..) {
            sides.extend((0..polygon.len()).map(|k| ((polygon[k], polygon[(k + 1) % polygon.len()]), i)));
        }
        let is_inner = |e: &&(u32, u32)| e.0 < e.1 && sides.contains_key(&(e.1, e.0));
        let mut inner: Vec<(u32, u32)> = sides.keys().filter(is_inner).copied().collect();
        let length = |e: &(u32, u32)| self.points[e.0 as usize].distance_squared(self.points[e.1 as usize]);
        inner.sort_by(|a, b| length(b).total_cmp(&length(a)).then(a.cmp(b)));
        let mut merges = UnionFind::new(self.polygons.len());
        for (a, b) in inner {
            let (i, j) = (merges.root(sides[&(a, b)]), merges.root(sides[&(b, a)]));
            if i == j {
                continue;
            }
            if let Some(merged) = self.joined(i, j, (a, b)) {
                self.polygons[i as usize] = merged;
                self.polygons[j as usize].clear();
                merges.join_to(i, j);
            }
        }
        self.polygons.retain(|p| !p.is_empty());
    }

    /// The union of two polygons that share the first one's edge from a to b, if the union is convex.
    fn joined(&self, i: u32, j: u32, (a, b): (u32, u32)) -> Option<Vec<u32>> {
        let from = |polygon: u32, start: u32| {
            let polygon = &self.polygons[polygon as usize];
            let at = polygon.iter().position(|p| *p == start)?;
            Some([&polygon[at..], &polygon[..at]].concat())
        };
        let (p, q) = (from(i, b)?, from(j, a)?);
        if p.last() != Some(&a) || q.last() != Some(&b) || p.len() + q.len() - 2 > MAX_CORNERS {
            return None;
        }
        let merged = [&p[..], &q[1..q.len() - 1]].concat();
        let n = merged.len();
        let at = |k: usize| self.points[merged[k % n] as usize];
        let is_convex = (0..n).all(|k| (at(k + 1) - at(k)).perp_dot(at(k + 2) - at(k + 1)) >= 0.0);
        is_convex.then_some(merged)
    }

    /// Drops the corners that are straight in all polygons that share them.
    fn straighten(&mut self) {
        let mut bent = vec![false; self.points.len()];
        for polygon in &self.polygons {
            let n = polygon.len();
            let at = |k: usize| self.points[polygon[k % n] as usize];
            for k in 0..n {
                let (before, after) = (at(k + 1) - at(k), at(k + 2) - at(k + 1));
                bent[polygon[(k + 1) % n] as usize] |= before.perp_dot(after) > 1e-9 * before.length() * after.length();
            }
        }
        // A corner at which a third polygon ends is straight in one of them only.
        self.polygons.iter_mut().for_each(|p| p.retain(|k| bent[*k as usize]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of 4 x 4 m with a square hole of 2 x 2 m has 12 square metres, which take at least four convex
    /// polygons.
    #[test]
    fn a_hole_stays_open() {
        let square =
            |low: f64, high: f64| [[low, low], [high, low], [high, high], [low, high]].map(DVec2::from).to_vec();
        let hole: Vec<DVec2> = square(1.0, 3.0).into_iter().rev().collect();
        let pieces = convex(&[square(0.0, 4.0), hole]);
        let total: f64 = pieces.iter().map(|p| area(p)).sum();
        assert!((total - 12.0).abs() < 1e-9 && (4..=8).contains(&pieces.len()), "{} pieces, {total}", pieces.len());
        assert!(pieces.iter().all(|p| !is_enclosed(DVec2::splat(2.0), std::slice::from_ref(p))));
        assert_eq!(convex(&[square(0.0, 4.0)]).len(), 1);
    }

    /// A bow tie encloses two triangles of one square metre each. The triangulation has no corner at the crossing, so
    /// the area may differ, but it stays within the square.
    #[test]
    fn lines_may_cross() {
        let tie = [[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 2.0]].map(DVec2::from).to_vec();
        let total: f64 = convex(&[tie]).iter().map(|p| area(p)).sum();
        assert!((0.0..=4.0).contains(&total), "{total}");
    }
}
