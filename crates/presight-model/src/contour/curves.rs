//! Where the front of a smooth surface meets its back, seen from a pose: curves along its edges.

use super::surface::Surface;
use glam::DVec3;

/// Neighbouring edges of a surface, in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// One more than edges; of a closed curve the last is the first. The object's frame.
    pub points: Vec<DVec3>,
    /// By edge.
    edges: Vec<u32>,
}

impl Curve {
    /// Each piece with the slots of the polygons that touch it: these do not hide it.
    pub fn pieces<'a>(&'a self, surface: &'a Surface) -> impl Iterator<Item = ([DVec3; 2], &'a [u32])> {
        let ends = self.points.windows(2).map(|pair| [pair[0], pair[1]]);
        ends.zip(self.edges.iter().map(|edge| surface.slots_of(&surface.edges[*edge as usize])))
    }

    pub fn length(&self) -> f64 {
        self.points.windows(2).map(|pair| pair[0].distance(pair[1])).sum()
    }
}

impl Surface {
    /// The curves of a viewpoint (the object's frame), in an order that the surface and the viewpoint decide. A curve ends where none
    /// or several others go on.
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
        // What is left is closed.
        shown.iter().for_each(|edge| follow(self.edges[*edge as usize].ends[0], *edge));
        curves
    }
}
