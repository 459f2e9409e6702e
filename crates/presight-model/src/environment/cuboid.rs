//! Boxes as meshes.

use super::{Mesh, Polygon, PolygonOrder};
use crate::error::Result;
use glam::Vec3;

/// Faces of a box as corner numbers of [`cuboid_corners`], wound outward: -z, +z, -y, +y, -x, +x.
pub const CUBOID_FACES: [[u32; 4]; 6] =
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];

/// Corners of a box. Bits 0, 1 and 2 of a corner's number select x, y and z: from `least` for 0, from `most` for 1.
pub fn cuboid_corners(least: Vec3, most: Vec3) -> [Vec3; 8] {
    std::array::from_fn(|i| {
        let pick = |axis: usize| if i >> axis & 1 == 0 { least[axis] } else { most[axis] };
        Vec3::new(pick(0), pick(1), pick(2))
    })
}

impl Mesh {
    /// A box of six polygons of one material, fronts outwards: -z, +z, -y, +y, -x, +x.
    ///
    /// ```
    /// use glam::Vec3;
    /// let press = presight::environment::Mesh::cuboid("press", Vec3::ZERO, Vec3::new(2.0, 1.0, 1.5), 0)?;
    /// assert_eq!((press.polygon_count(), press.vertices()[7]), (6, Vec3::new(2.0, 1.0, 1.5)));
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// Those of [`Mesh::new`], for example for a box without volume.
    pub fn cuboid(name: impl Into<String>, least: Vec3, most: Vec3, material: u16) -> Result<Self> {
        let polygons = CUBOID_FACES.map(|face| Polygon::new(face.to_vec(), material));
        Self::new(name, cuboid_corners(least, most).to_vec(), polygons.to_vec(), PolygonOrder::Given)
    }
}
