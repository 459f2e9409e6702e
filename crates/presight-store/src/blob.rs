//! Meshes as blobs, little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 16 | u32 V vertices, P polygons, C corners, and polygon order: 1 spatial, 0 as given |
//! | 24 V | positions x, y, z in the mesh frame, metres: the model's f32 values, stored as f64 |
//! | 32 P | planes of the polygons, f64: unit normal n, and offset n . p for points p of the plane, metres |
//! | 12 P | per polygon: u32 number of corners, material number in `materials`, number of its first source triangle |
//! | 4 C | corners, polygon by polygon: u32 vertex number |
//!
//! Planes follow from positions. They are stored because computing them would dominate the time to open a store.

use super::schema::damaged;
use bytemuck::{Pod, cast_slice, cast_slice_mut};
use glam::{DVec3, Vec3};
use presight_model::environment::{Mesh, PolygonOrder, PolygonRecord};
use presight_model::error::Result;
use presight_model::geometry::Plane;

pub(super) fn encode(mesh: &Mesh) -> Vec<u8> {
    let corners = mesh.all_corners();
    let size = 16 + 24 * mesh.vertices().len() + 44 * mesh.polygon_count() + 4 * corners.len();
    let mut bytes = Vec::with_capacity(size);
    let spatial = u32::from(mesh.order() == PolygonOrder::Spatial);
    // The limits for meshes keep all counts below 2^32.
    let counts = [mesh.vertices().len() as u32, mesh.polygon_count() as u32, corners.len() as u32, spatial];
    counts.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    for v in mesh.vertices() {
        v.to_array().iter().for_each(|x| bytes.extend_from_slice(&f64::from(*x).to_le_bytes()));
    }
    for plane in mesh.planes() {
        let row = [plane.normal.x, plane.normal.y, plane.normal.z, plane.offset];
        row.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    }
    for r in mesh.polygons() {
        let row = [u32::from(r.corner_count), u32::from(r.material), r.source];
        row.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    }
    corners.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    bytes
}

/// The parts of a blob in separate buffers. Building the mesh from them copies each at most once.
pub(super) struct Parts {
    /// V, P, C and the polygon order.
    counts: [u32; 4],
    positions: Vec<[f64; 3]>,
    planes: Vec<[f64; 4]>,
    records: Vec<[u32; 3]>,
    corners: Vec<u32>,
}

impl Parts {
    /// Reads a blob of `size` bytes. `read` fills a buffer with the bytes that begin at an offset.
    pub fn read(size: usize, mut read: impl FnMut(&mut [u8], usize) -> Result<()>) -> Result<Self> {
        let wrong = || damaged("the length of its content contradicts its counts");
        let mut counts = [0u32; 4];
        if size < size_of_val(&counts) {
            return Err(wrong());
        }
        let mut at = 0;
        let mut fill = |to: &mut [u8]| {
            at += to.len();
            read(to, at - to.len())
        };
        fill(cast_slice_mut(&mut counts))?;
        let [v, p, c, _] = counts.map(|n| u64::from(u32::from_le(n)));
        if size as u64 != 16 + 24 * v + 44 * p + 4 * c {
            return Err(wrong());
        }
        // The allocator provides zeroed pages, so `vec![0; n]` does not write to them.
        let mut parts = Self {
            counts,
            positions: vec![[0.0; 3]; v as usize],
            planes: vec![[0.0; 4]; p as usize],
            records: vec![[0; 3]; p as usize],
            corners: vec![0; c as usize],
        };
        fill(cast_slice_mut(&mut parts.positions))?;
        fill(cast_slice_mut(&mut parts.planes))?;
        fill(cast_slice_mut(&mut parts.records))?;
        fill(cast_slice_mut(&mut parts.corners))?;
        Ok(parts)
    }

    /// Number of polygons.
    pub fn polygons(&self) -> usize {
        self.records.len()
    }

    /// The bytes of the blob, in five pieces.
    pub fn bytes(&self) -> [&[u8]; 5] {
        let Self { counts, positions, planes, records, corners } = self;
        [cast_slice(counts), cast_slice(positions), cast_slice(planes), cast_slice(records), cast_slice(corners)]
    }

    /// Builds the mesh and passes the extent of each polygon to `visit`. Does not check that its materials exist.
    pub fn into_mesh(mut self, name: &str, visit: impl FnMut(usize, (Vec3, Vec3))) -> Result<Mesh> {
        from_le(&mut self.counts, u32::from_le);
        from_le(self.positions.as_flattened_mut(), |x| f64::from_bits(u64::from_le(x.to_bits())));
        from_le(self.planes.as_flattened_mut(), |x| f64::from_bits(u64::from_le(x.to_bits())));
        from_le(self.records.as_flattened_mut(), u32::from_le);
        from_le(&mut self.corners, u32::from_le);
        let vertices = self.positions.iter().map(|p| DVec3::from_array(*p).as_vec3()).collect();
        let (mut first_corner, mut fits) = (0u32, true);
        let record = |&[count, material, source]: &[u32; 3]| {
            fits &= count <= u32::from(u8::MAX) && material <= u32::from(u16::MAX);
            let record = PolygonRecord { first_corner, source, material: material as u16, corner_count: count as u8 };
            first_corner = first_corner.wrapping_add(count);
            record
        };
        let polygons = self.records.iter().map(record).collect();
        if !fits {
            return Err(damaged("a polygon has too many corners, or its material number is too large"));
        }
        let planes: Vec<Plane> = bytemuck::allocation::cast_vec(self.planes);
        let order = if self.counts[3] == 1 { PolygonOrder::Spatial } else { PolygonOrder::Given };
        Mesh::restored(name.to_owned(), vertices, self.corners, polygons, Some(planes), order, visit)
    }
}

/// Converts numbers to native byte order. On little-endian machines this compiles to nothing.
fn from_le<T: Pod>(numbers: &mut [T], native: impl Fn(T) -> T) {
    numbers.iter_mut().for_each(|x| *x = native(*x));
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::environment::Polygon;
    use presight_model::index::{MeshTree, PolygonBoxes};
    use proptest::prelude::*;

    /// Quads and triangles in two materials.
    fn sheet(order: PolygonOrder) -> Mesh {
        let side = 9u32;
        let vertices = (0..side * side).map(|i| Vec3::new((i % side) as f32, (i / side) as f32, 0.25)).collect();
        let places = (0..side * (side - 1)).filter(|i| i % side + 1 < side);
        let polygon = |a: u32| {
            let corners =
                if a.is_multiple_of(2) { vec![a, a + 1, a + side + 1, a + side] } else { vec![a, a + 1, a + side] };
            Polygon { corners, material: (a / 30) as u16, source: a }
        };
        Mesh::new("sheet", vertices, places.map(polygon).collect(), order).unwrap()
    }

    fn parts(bytes: &[u8]) -> Result<Parts> {
        Parts::read(bytes.len(), |to, at| {
            to.copy_from_slice(&bytes[at..at + to.len()]);
            Ok(())
        })
    }

    #[test]
    fn meshes_come_back() {
        for order in [PolygonOrder::Spatial, PolygonOrder::Given] {
            let mesh = sheet(order);
            let bytes = encode(&mesh);
            let parts = parts(&bytes).unwrap();
            assert_eq!(parts.bytes().concat(), bytes);
            let again = parts.into_mesh("sheet", |_, _| ()).unwrap();
            assert_eq!(encode(&again), bytes);
            assert_eq!((again.clusters(), again.bounds()), (mesh.clusters(), mesh.bounds()));
            assert_eq!((again.planes(), again.materials()), (mesh.planes(), mesh.materials()));
        }
    }

    #[test]
    fn each_word_that_cannot_be_is_refused() {
        let bytes = encode(&sheet(PolygonOrder::Given));
        let [v, p] = [81, 64];
        let records = 16 + 24 * v + 32 * p;
        let with = |at: usize, word: u32| {
            let mut bytes = bytes.clone();
            bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
            parts(&bytes).and_then(|parts| parts.into_mesh("sheet", |_, _| ())).map(drop)
        };
        assert!(with(16 + 24 * v + 36, 0).is_ok(), "the last bits of a plane");
        for (at, word, what) in [
            (0, v as u32 + 1, "vertices"),
            (4, p as u32 - 1, "polygons"),
            (8, 7, "corners"),
            (16 + 4, 0x7ff0_0000, "infinity"),
            (16 + 24 * v + 32 + 20, 0x7ff8_0000, "a normal that is NaN"),
            (records, 2, "two corners"),
            (records + 12, 200, "more corners than are allowed"),
            (records, 300, "more than a record can hold"),
            (records + 12, 5, "the next polygon's corners, with none left for the last"),
            (records + 4, 1 << 16, "a material number that is too large"),
            (records + 12 * p + 40, v as u32, "a vertex that does not exist"),
        ] {
            assert!(with(at, word).is_err(), "{what}");
        }
        assert!(parts(&bytes[..bytes.len() - 1]).is_err() && parts(&bytes[..15]).is_err() && parts(&[]).is_err());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// Arbitrary words yield a valid mesh or an error.
        #[test]
        fn changed_words_make_no_unsound_mesh(
            changes in prop::collection::vec((any::<prop::sample::Index>(), prop_oneof![0..90u32, any::<u32>()]), 0..4),
        ) {
            let mut bytes = encode(&sheet(PolygonOrder::Spatial));
            for (at, word) in changes {
                let at = 4 * at.index(bytes.len() / 4);
                bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
            }
            let Ok(parts) = parts(&bytes) else { return Ok(()) };
            let mut boxes = PolygonBoxes::new(parts.polygons());
            if let Ok(mesh) = parts.into_mesh("sheet", |i, extent| boxes.set(i, extent)) {
                MeshTree::with_boxes(&mesh, boxes).assert_well_formed(&mesh);
                prop_assert!((0..mesh.polygon_count() as u32).all(|i| mesh.corners_of(i).all(|p| p.is_finite())));
            }
        }
    }
}
