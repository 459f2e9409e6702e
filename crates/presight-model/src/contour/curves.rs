//! The silhouette of a smooth surface from a viewpoint: curves along edges where its front meets its back.

use super::surface::Surface;
use glam::DVec3;

/// A chain of neighbouring edges of a surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// One more point than edges, in the object's frame; a closed curve ends at its first point.
    pub points: Vec<DVec3>,
    /// By piece: the index of its edge.
    edges: Vec<u32>,
}

impl Curve {
    /// Each piece, with the slots of the polygons that touch it; these do not hide it.
    pub fn pieces<'a>(&'a self, surface: &'a Surface) -> impl Iterator<Item = ([DVec3; 2], &'a [u32])> {
        let ends = self.points.windows(2).map(|pair| [pair[0], pair[1]]);
        ends.zip(self.edges.iter().map(|edge| surface.slots_of(&surface.edges[*edge as usize])))
    }

    /// Length in metres.
    pub fn length(&self) -> f64 {
        self.points.windows(2).map(|pair| pair[0].distance(pair[1])).sum()
    }
}

impl Surface {
    /// The curves seen from a viewpoint (the object's frame), in a deterministic order. A curve ends where no other
    /// edge continues it, or several do.
    pub fn curves(&self, from: DVec3) -> Vec<Curve> {
        let fronts = self.fronts(from);
        let shown: Vec<u32> =
            (0..self.edges.len() as u32).filter(|edge| self.shows(&self.edges[*edge as usize], &fronts)).collect();
        // By point: the edges that end there.
        let both = shown.iter().flat_map(|edge| self.edges[*edge as usize].ends.map(|end| (end, *edge)));
        let mut at: Vec<(u32, u32)> = both.collect();
        at.sort_unstable();
        let ends_at = |point: u32| {
            let first = at.partition_point(|(p, _)| *p < point);
            let end = first + at[first..].partition_point(|(p, _)| *p == point);
            &at[first..end]
        };
        let mut used = vec![false; self.edges.len()];
        let mut curves = Vec::new();
        let mut follow = |start: u32, edge: u32| {
            let mut curve = Curve { points: vec![self.points[start as usize]], edges: Vec::new() };
            let (mut point, mut next) = (start, Some(edge));
            while let Some(edge) = next.filter(|edge| !std::mem::replace(&mut used[*edge as usize], true)) {
                let [a, b] = self.edges[edge as usize].ends;
                point = if a == point { b } else { a };
                curve.points.push(self.points[point as usize]);
                curve.edges.push(edge);
                next = match ends_at(point) {
                    [(_, one), (_, other)] => Some(if *one == edge { *other } else { *one }),
                    _ => None,
                };
            }
            if !curve.edges.is_empty() {
                curves.push(curve);
            }
        };
        for of_point in at.chunk_by(|a, b| a.0 == b.0).filter(|of_point| of_point.len() != 2) {
            of_point.iter().for_each(|(point, edge)| follow(*point, *edge));
        }
        // The remaining curves are closed.
        shown.iter().for_each(|edge| follow(self.edges[*edge as usize].ends[0], *edge));
        curves
    }
}
