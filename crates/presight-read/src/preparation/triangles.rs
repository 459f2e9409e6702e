//! Triangles of a file over welded vertices: the step between a file format and a mesh.

use glam::{DVec3, Vec3};
use presight_model::environment::canonical_plane;

/// One source triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Triangle {
    /// Indices of welded vertices, in winding order.
    pub corners: [u32; 3],
    /// Number within the mesh: across its primitives in order, degenerate triangles counted.
    pub source: u32,
    /// Index of the material in the environment.
    pub material: u16,
}

/// The triangles of one mesh that have an area, over distinct vertices.
#[derive(Clone, Debug, Default)]
pub(crate) struct TriangleMesh {
    /// Positions, metres, mesh frame: the f32 bits of the file (negative zeros made positive).
    pub vertices: Vec<Vec3>,
    /// In source order.
    pub triangles: Vec<Triangle>,
    /// Source triangles, degenerate ones included.
    pub source_count: u32,
    /// For each primitive the number of source triangles up to its end.
    pub primitive_ends: Vec<u32>,
    /// Source numbers of the triangles that were left out because they have no area.
    pub degenerate: Vec<u32>,
}

impl TriangleMesh {
    /// Appends a source triangle, or notes that it has no area.
    pub fn push(&mut self, corners: [u32; 3], material: u16) {
        let source = self.source_count;
        self.source_count += 1;
        if self.is_flat(corners) {
            self.degenerate.push(source);
        } else {
            self.triangles.push(Triangle { corners, source, material });
        }
    }

    fn is_flat(&self, corners: [u32; 3]) -> bool {
        let [a, b, c] = corners;
        if a == b || b == c || c == a {
            return true;
        }
        let points @ [p, q, r] = self.positions(corners);
        let doubled_area_squared = (q - p).cross(r - p).length_squared();
        let sides = (q - p).length_squared() + (r - p).length_squared();
        // Nearly all triangles are far from degenerate, so their plane need not be computed.
        doubled_area_squared <= (1e-9 * sides).powi(2) && canonical_plane(3, |k| points[k]).is_none()
    }

    /// Closes a primitive: later triangles belong to the next.
    pub fn end_primitive(&mut self) {
        self.primitive_ends.push(self.source_count);
    }

    /// Corner positions in f64.
    pub fn positions(&self, corners: [u32; 3]) -> [DVec3; 3] {
        corners.map(|c| self.vertices[c as usize].as_dvec3())
    }
}

/// Primitive of a source triangle and its number within the primitive, from [`TriangleMesh::primitive_ends`].
pub(crate) fn place_of(primitive_ends: &[u32], source: u32) -> (u32, u32) {
    let primitive = primitive_ends.partition_point(|&end| end <= source);
    let start = primitive.checked_sub(1).map_or(0, |p| primitive_ends[p]);
    (primitive as u32, source - start)
}

/// Finds equal positions, so that neighbouring triangles share vertex indices and their edges have the same bits.
///
/// Open addressing over the vertices found so far; the standard map's safe hash would take most of an import's time.
#[derive(Debug, Default)]
pub(crate) struct Welder {
    /// Vertex index + 1; 0 is free. Length a power of two.
    table: Vec<u32>,
}

impl Welder {
    /// The index of `position` in `vertices`, appended if it is new.
    pub fn weld(&mut self, position: Vec3, vertices: &mut Vec<Vec3>) -> u32 {
        if vertices.len() * 2 >= self.table.len() {
            self.grow(vertices);
        }
        // -0 equals 0 but has other bits: adding 0 makes it 0.
        let position = position + Vec3::ZERO;
        let mask = self.table.len() - 1;
        let mut slot = hash(position) as usize & mask;
        loop {
            match self.table[slot] {
                0 => {
                    vertices.push(position);
                    self.table[slot] = vertices.len() as u32;
                    return vertices.len() as u32 - 1;
                }
                found if vertices[found as usize - 1] == position => return found - 1,
                _ => slot = (slot + 1) & mask,
            }
        }
    }

    fn grow(&mut self, vertices: &[Vec3]) {
        let size = (vertices.len() * 4).next_power_of_two().max(64);
        let mask = size - 1;
        self.table.clear();
        self.table.resize(size, 0);
        for (i, &v) in vertices.iter().enumerate() {
            let mut slot = hash(v) as usize & mask;
            while self.table[slot] != 0 {
                slot = (slot + 1) & mask;
            }
            self.table[slot] = i as u32 + 1;
        }
    }
}

/// Multiply-and-fold over the bits; the odd constants are from the golden ratio and pi.
fn hash(v: Vec3) -> u64 {
    let [x, y, z] = v.to_array().map(|c| u64::from(c.to_bits()));
    let mixed = ((x << 32 | y) ^ 0x243F_6A88_85A3_08D3).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 29) ^ z.wrapping_mul(0xC2B2_AE3D_27D4_EB4F)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    mixed ^ (mixed >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_positions_share_an_index_and_near_ones_do_not() {
        let (mut welder, mut vertices) = (Welder::default(), Vec::new());
        let mut all = Vec::new();
        for round in 0..2 {
            for i in 0..1000 {
                let v = Vec3::new((i % 10) as f32 * 0.1, (i / 10) as f32, f32::from_bits(1.0f32.to_bits() + i % 3));
                let index = welder.weld(v, &mut vertices);
                if round == 0 { all.push(index) } else { assert_eq!(index, all[i as usize]) }
            }
        }
        assert_eq!(vertices.len(), 1000);
        let zero = welder.weld(Vec3::ZERO, &mut vertices);
        assert_eq!(welder.weld(-Vec3::ZERO, &mut vertices), zero);
        assert!(vertices[zero as usize].x.is_sign_positive());
    }

    #[test]
    fn places_count_through_primitives() {
        let mut mesh =
            TriangleMesh { vertices: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::X * 2.0], ..Default::default() };
        mesh.push([0, 1, 2], 0);
        mesh.push([0, 1, 3], 0);
        mesh.end_primitive();
        mesh.end_primitive();
        mesh.push([0, 1, 1], 0);
        mesh.push([2, 1, 0], 7);
        mesh.end_primitive();
        assert_eq!(mesh.degenerate, [1, 2]);
        assert_eq!(mesh.triangles.len(), 2);
        assert_eq!(mesh.triangles[1].source, 3);
        assert_eq!(place_of(&mesh.primitive_ends, 1), (0, 1));
        assert_eq!(place_of(&mesh.primitive_ends, 3), (2, 1));
    }
}
