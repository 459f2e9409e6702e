//! Which triangles meet at which edge.
//!
//! Half-edge 3 t + k runs from corner k of triangle t to its next corner. Half-edges between the same two vertices are
//! found by sorting into buckets by lower vertex, which takes linear time and no hashing.

use super::{Triangle, TriangleMesh};

/// No half-edge.
pub(super) const NONE: u32 = u32::MAX;

/// Half-edges, sorted so that those between the same two vertices are adjacent.
pub(crate) struct Edges<'a> {
    triangles: &'a [Triangle],
    /// Sorted by lower vertex; the high half holds the upper vertex, the low half the half-edge.
    sorted: Vec<u64>,
}

/// First and second vertex of a half-edge.
pub(super) fn ends(triangles: &[Triangle], half_edge: u32) -> (u32, u32) {
    let corners = triangles[half_edge as usize / 3].corners;
    let k = half_edge as usize % 3;
    (corners[k], corners[if k == 2 { 0 } else { k + 1 }])
}

/// The vertex of its triangle that a half-edge does not touch.
pub(super) fn opposite(triangles: &[Triangle], half_edge: u32) -> u32 {
    triangles[half_edge as usize / 3].corners[(half_edge as usize + 2) % 3]
}

impl<'a> Edges<'a> {
    pub fn of(mesh: &'a TriangleMesh) -> Self {
        let triangles = &mesh.triangles;
        let half_edges = || (0..3 * triangles.len() as u32).map(|h| (h, ends(triangles, h)));
        // Counting sort by the lower vertex.
        let mut starts = vec![0u32; mesh.vertices.len() + 1];
        for (_, (a, b)) in half_edges() {
            starts[a.min(b) as usize + 1] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut sorted = vec![0u64; 3 * triangles.len()];
        let mut next = starts.clone();
        for (h, (a, b)) in half_edges() {
            let at = &mut next[a.min(b) as usize];
            sorted[*at as usize] = u64::from(a.max(b)) << 32 | u64::from(h);
            *at += 1;
        }
        for bucket in starts.windows(2) {
            sorted[bucket[0] as usize..bucket[1] as usize].sort_unstable();
        }
        Self { triangles, sorted }
    }

    /// The half-edges between each pair of vertices, in rising order.
    pub fn groups(&self) -> impl Iterator<Item = &[u64]> {
        // Neighbouring buckets may meet at the same upper vertex, so the lower vertex is compared too.
        self.sorted.chunk_by(|&x, &y| x >> 32 == y >> 32 && self.lower(x) == self.lower(y))
    }

    fn lower(&self, entry: u64) -> u32 {
        let (a, b) = ends(self.triangles, entry as u32);
        a.min(b)
    }

    /// For each half-edge its opposite, if exactly two different triangles with consistent windings meet there;
    /// [`NONE`] at borders, non-manifold edges, duplicate faces and inconsistent windings.
    pub fn twins(&self) -> Vec<u32> {
        let mut twins = vec![NONE; self.sorted.len()];
        for group in self.groups() {
            let &[x, y] = group else { continue };
            let (g, h) = (x as u32, y as u32);
            let consistent = ends(self.triangles, g).0 != ends(self.triangles, h).0;
            if consistent && opposite(self.triangles, g) != opposite(self.triangles, h) {
                twins[g as usize] = h;
                twins[h as usize] = g;
            }
        }
        twins
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn only_plain_neighbours_are_twins() {
        let mut mesh = TriangleMesh {
            vertices: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE, Vec3::Z, Vec3::NEG_X],
            ..Default::default()
        };
        mesh.push([0, 1, 2], 0);
        mesh.push([2, 1, 3], 0);
        let twins = Edges::of(&mesh).twins();
        assert_eq!(twins, [NONE, 3, NONE, 1, NONE, NONE]);
        // A third triangle at the edge makes it non-manifold.
        let mut fin = mesh.clone();
        fin.push([1, 2, 4], 0);
        assert!(Edges::of(&fin).twins().iter().all(|&t| t == NONE));
        // A neighbour with opposite winding, and a duplicate face with opposite winding.
        for other in [[1, 2, 3], [2, 1, 0]] {
            let mut pair = TriangleMesh { vertices: mesh.vertices.clone(), ..Default::default() };
            pair.push([0, 1, 2], 0);
            pair.push(other, 0);
            assert!(Edges::of(&pair).twins().iter().all(|&t| t == NONE), "{other:?}");
        }
    }
}
