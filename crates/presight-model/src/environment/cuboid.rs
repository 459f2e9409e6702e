//! Boxes as meshes.

use super::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use crate::error::Result;
use crate::geometry::Pose;
use glam::{DVec3, Vec3};
use std::sync::Arc;

/// Name of the material of boxes that are added without one.
const PLAIN: &str = "plain";

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

impl Environment {
    /// Adds a box with its centre at a pose, and returns its index (`object_id` in images minus one). `size` is its
    /// extent along its own axes, metres. All such boxes share one opaque material, `plain`.
    ///
    /// ```
    /// use presight::Pose;
    /// use presight::environment::Environment;
    /// use glam::DVec3;
    /// let mut environment = Environment::new();
    /// // A wall 10 cm thick, 4 m wide and 2 m high; its near face is 2 m ahead of the origin.
    /// let centre = Pose::from_xyz_rpy(DVec3::new(2.05, 0.0, 1.0), 0.0, 0.0, 0.0);
    /// environment.add_cuboid("wall", centre, DVec3::new(0.1, 4.0, 2.0))?;
    /// assert!((environment.bounds().max.z - 2.0).abs() < 1e-9);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// The errors of [`Environment::insert`]; [`crate::ErrorKind::Invalid`] for a box without volume.
    pub fn add_cuboid(&mut self, name: &str, world_from_cuboid: Pose, size: DVec3) -> Result<u32> {
        let half = (0.5 * size).as_vec3();
        let known = self.materials.iter().position(|material| *material == Material::named(PLAIN));
        // Made without a material first: a refused box must not leave one.
        let mesh = Mesh::cuboid(name, -half, half, known.unwrap_or(self.materials.len()) as u16)?;
        if known.is_none() {
            self.add_material(Material::named(PLAIN))?;
        }
        self.insert(NewObject::new(name, world_from_cuboid, Arc::new(mesh)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_share_their_material_and_bad_ones_are_refused() {
        let mut environment = Environment::new();
        assert!(environment.add_cuboid("flat", Pose::IDENTITY, DVec3::new(1.0, 0.0, 1.0)).is_err());
        assert!(environment.materials().is_empty());
        for name in ["a", "b"] {
            environment.add_cuboid(name, Pose::IDENTITY, DVec3::ONE).unwrap();
        }
        assert_eq!((environment.materials().len(), environment.objects().len()), (1, 2));
        assert!((environment.bounds().max - DVec3::splat(0.5)).length() < 1e-12);
    }
}
