//! Problems of the triangles of a mesh: counted and listed, never repaired.

use super::edges::{Edges, NONE, ends, opposite};
use super::{ProblemKind, ProblemList, Site, TriangleMesh};
use glam::DVec3;

/// A triangle whose height is under this share of its longest side is a sliver.
const SLIVER: f64 = 1e-3;

impl TriangleMesh {
    /// All problems of the triangles.
    pub(crate) fn problems(&self, edges: &Edges<'_>, twins: &[u32]) -> ProblemList {
        let mut list = ProblemList::default();
        for &triangle in &self.degenerate {
            list.add(ProblemKind::DegenerateTriangle, Site { triangle, edge: None });
        }
        for triangle in self.triangles.iter().filter(|t| is_sliver(self.positions(t.corners))) {
            list.add(ProblemKind::Sliver, Site { triangle: triangle.source, edge: None });
        }
        let mut thirds = Vec::new();
        for group in edges.groups() {
            self.judge_edge(group, &mut thirds, &mut list);
        }
        self.judge_shells(twins, &mut list);
        list
    }

    fn judge_edge(&self, group: &[u64], thirds: &mut Vec<(u32, u32)>, list: &mut ProblemList) {
        let first = group[0] as u32;
        let (a, b) = ends(&self.triangles, first);
        let site = |half_edge: u32, with_edge: bool| Site {
            triangle: self.triangles[half_edge as usize / 3].source,
            edge: with_edge.then(|| [self.vertices[a as usize], self.vertices[b as usize]]),
        };
        match *group {
            [_] => list.add(ProblemKind::OpenBorder, site(first, true)),
            [_, second] if ends(&self.triangles, second as u32).0 == a => {
                list.add(ProblemKind::InconsistentWinding, site(second as u32, true));
            }
            [_, _] => {}
            _ => list.add(ProblemKind::NonManifoldEdge, site(first, true)),
        }
        if group.len() < 2 {
            return;
        }
        // Duplicate faces share all three edges: count them only at the edge opposite their highest vertex.
        thirds.clear();
        let all = group.iter().map(|&e| (opposite(&self.triangles, e as u32), e as u32));
        thirds.extend(all.filter(|&(third, _)| third > a.max(b)));
        thirds.sort_unstable();
        for pair in thirds.windows(2) {
            if pair[0].0 == pair[1].0 {
                list.add(ProblemKind::DuplicateFace, site(pair[1].1, false));
            }
        }
    }

    /// Finds closed shells (every edge shared by exactly two triangles) whose volume is negative.
    fn judge_shells(&self, twins: &[u32], list: &mut ProblemList) {
        let mut seen = vec![false; self.triangles.len()];
        let mut stack = Vec::new();
        for start in 0..self.triangles.len() {
            if seen[start] {
                continue;
            }
            seen[start] = true;
            stack.push(start);
            let origin = self.vertices[self.triangles[start].corners[0] as usize].as_dvec3();
            let (mut closed, mut volume, mut scale) = (true, 0.0, 0.0);
            while let Some(t) = stack.pop() {
                let [a, b, c] = self.positions(self.triangles[t].corners).map(|p| p - origin);
                let part = a.dot(b.cross(c));
                volume += part;
                scale += part.abs();
                for &twin in &twins[3 * t..3 * t + 3] {
                    if twin == NONE {
                        closed = false;
                    } else if !std::mem::replace(&mut seen[twin as usize / 3], true) {
                        stack.push(twin as usize / 3);
                    }
                }
            }
            // The volume of a flat shell is only rounding, of either sign.
            if closed && volume < -1e-9 * scale {
                list.add(ProblemKind::InsideOut, Site { triangle: self.triangles[start].source, edge: None });
            }
        }
    }
}

fn is_sliver([a, b, c]: [DVec3; 3]) -> bool {
    let doubled_area_squared = (b - a).cross(c - a).length_squared();
    let longest_squared = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    // height = doubled area / longest side
    doubled_area_squared < (SLIVER * longest_squared).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use presight_model::environment::{CUBOID_FACES, cuboid_corners};

    fn cube(turned: bool) -> TriangleMesh {
        let vertices = cuboid_corners(Vec3::ZERO, Vec3::ONE).to_vec();
        let mut mesh = TriangleMesh { vertices, ..Default::default() };
        for [a, b, c, d] in CUBOID_FACES {
            for t in [[a, b, c], [a, c, d]] {
                mesh.push(if turned { [t[0], t[2], t[1]] } else { t }, 0);
            }
        }
        mesh
    }

    fn totals(mesh: &TriangleMesh) -> Vec<(ProblemKind, u64)> {
        let edges = Edges::of(mesh);
        let list = mesh.problems(&edges, &edges.twins());
        let mut book = super::super::ProblemBook::default();
        book.extend(&list, |t| format!("triangle {t}"));
        book.into_problems().iter().map(|p| (p.kind, p.total)).collect()
    }

    #[test]
    fn a_cube_is_sound_and_its_inside_out_twin_is_not() {
        assert_eq!(totals(&cube(false)), []);
        assert_eq!(totals(&cube(true)), [(ProblemKind::InsideOut, 1)]);
    }

    #[test]
    fn each_fault_is_counted_once() {
        let mut open = cube(false);
        open.triangles.pop();
        assert_eq!(totals(&open), [(ProblemKind::OpenBorder, 3)]);
        let mut double = cube(false);
        double.push([5, 3, 7], 0);
        double.push([1, 3, 7], 0);
        assert_eq!(
            totals(&double),
            [(ProblemKind::DuplicateFace, 1), (ProblemKind::NonManifoldEdge, 4), (ProblemKind::OpenBorder, 1)]
        );
        let mut flipped = cube(false);
        flipped.triangles[3].corners.swap(0, 1);
        assert_eq!(totals(&flipped), [(ProblemKind::InconsistentWinding, 3)]);
        let mut sliver = cube(false);
        sliver.vertices.push(Vec3::new(0.5, -0.0009, -3.0));
        sliver.vertices.push(Vec3::new(0.0, 0.0, -3.0));
        sliver.vertices.push(Vec3::new(1.0, 0.0, -3.0));
        sliver.push([8, 9, 10], 0);
        sliver.push([8, 8, 10], 0);
        let found = totals(&sliver);
        assert_eq!(
            found,
            [(ProblemKind::DegenerateTriangle, 1), (ProblemKind::OpenBorder, 3), (ProblemKind::Sliver, 1)]
        );
    }
}
