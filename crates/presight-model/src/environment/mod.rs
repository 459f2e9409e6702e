//! The environment: objects in groups, meshes, materials and feature layers (paper section 2.1).

mod cluster_vertices;
mod content_hash;
mod cuboid;
mod feature;
mod feature_check;
mod groups;
mod layers;
mod marks;
mod material;
mod mesh;
mod open;
mod paths;
mod revert;

pub use cluster_vertices::{MAX_VERTICES, Positions};
pub use content_hash::ContentHash;
pub use cuboid::{CUBOID_FACES, cuboid_corners};
pub use feature::{DEFAULT_TOLERANCE, Existence, Feature, FeatureLayer, FeatureShape, Properties};
pub use feature_check::check_covariance;
pub use marks::{Mark, MarkKind};
pub use material::{Appearance, Material};
pub use mesh::{Cluster, Mesh, Polygon, PolygonOrder};
pub use mesh::{Parts, PolygonRecord, canonical_plane};
pub use paths::Paths;
pub(crate) use revert::Revert;

use crate::error::{Error, ErrorKind, Result};
use crate::geometry::{Aabb, Pose};
use crate::limits;
use crate::printable;
use glam::{DAffine3, DMat3, DVec3};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt;
use std::sync::Arc;

/// A named rigid object with a pose in the world and a mesh in its own frame.
#[derive(Clone, Debug)]
pub struct Object {
    /// Full path, unique in the environment.
    pub name: String,
    /// The rigid pose. Moving the object changes only this.
    pub world_from_object: Pose,
    /// Scale, mirror and shear of this instance; usually the identity.
    pub object_from_mesh: DAffine3,
    /// Shared by all instances.
    pub mesh: Arc<Mesh>,
    /// Slot of the mesh's polygon 0. Polygon i has slot `first_slot + i`; its `model` id is the slot plus one.
    pub first_slot: u32,
    /// Number of the object's first triangle in the source file (`source` ids).
    pub first_source: u32,
    deleted: bool,
}

impl Object {
    /// The whole transform of the mesh, f64.
    #[inline]
    pub fn world_from_mesh(&self) -> DAffine3 {
        self.world_from_object.to_affine() * self.object_from_mesh
    }

    /// True if the mesh is mirrored in the world, which reverses the winding. Normals are transformed by the inverse
    /// transpose, so the front of a polygon stays its front (glTF 2.0, section 3.7.4).
    #[inline]
    pub fn mirrors(&self) -> bool {
        self.object_from_mesh.matrix3.determinant() < 0.0
    }

    /// Corners of a polygon in the world, metres, counter-clockwise as seen from its front.
    #[inline]
    pub fn polygon_in_world(&self, polygon: u32) -> Vec<DVec3> {
        let world_from_mesh = self.world_from_mesh();
        let mut corners: Vec<DVec3> =
            self.mesh.corners_of(polygon).map(|p| world_from_mesh.transform_point3(p)).collect();
        if self.mirrors() {
            // The first corner stays first.
            corners[1..].reverse();
        }
        corners
    }

    /// Bounds in the world, conservative.
    pub fn world_bounds(&self) -> Aabb {
        let b = self.mesh.bounds();
        let world_from_mesh = self.world_from_mesh();
        let m = world_from_mesh.matrix3;
        let turned = b.transformed(&world_from_mesh);
        // Covers the rounding of the transform.
        let reach = b.min.abs().max(b.max.abs());
        let size = m.x_axis.abs() * reach.x + m.y_axis.abs() * reach.y + m.z_axis.abs() * reach.z;
        let slack = 16.0 * f64::EPSILON * (size + world_from_mesh.translation.abs());
        if b.is_empty() { b } else { Aabb { min: turned.min - slack, max: turned.max + slack } }
    }

    /// Transforms a point of the world into the mesh's frame. Subtracts the translation first, so that the difference
    /// is exact even at 5,000,000 m.
    pub fn point_in_mesh(&self, p_in_world: DVec3) -> DVec3 {
        let object_from_world = self.world_from_object.rotation_matrix().transpose();
        let p_in_object = object_from_world * (p_in_world - self.world_from_object.translation);
        self.object_from_mesh.inverse().transform_point3(p_in_object)
    }

    /// True if the object is deleted. It keeps its number and its slots, which are never reused, and has no polygons.
    pub fn is_deleted(&self) -> bool {
        self.deleted
    }
}

/// A new object for [`Environment::insert`].
#[derive(Clone, Debug)]
pub struct NewObject {
    /// The name. A repeated name gets `#2` and so on.
    pub name: String,
    /// See [`Object::world_from_object`].
    pub world_from_object: Pose,
    /// See [`Object::object_from_mesh`].
    pub object_from_mesh: DAffine3,
    /// See [`Object::mesh`].
    pub mesh: Arc<Mesh>,
    /// See [`Object::first_source`].
    pub first_source: u32,
}

impl NewObject {
    /// An object whose mesh is not scaled.
    pub fn new(name: impl Into<String>, world_from_object: Pose, mesh: Arc<Mesh>) -> Self {
        Self { name: name.into(), world_from_object, object_from_mesh: DAffine3::IDENTITY, mesh, first_source: 0 }
    }

    /// Splits a node's transform into a rigid pose and what remains of it (scale, mirror, shear).
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if the matrix is not finite or flattens the mesh.
    pub fn from_affine(name: impl Into<String>, world_from_mesh: DAffine3, mesh: Arc<Mesh>) -> Result<Self> {
        let m = world_from_mesh.matrix3;
        let lengths = [m.x_axis.length(), m.y_axis.length(), m.z_axis.length()];
        let volume = m.determinant().abs();
        let sound = world_from_mesh.is_finite()
            && world_from_mesh.translation.abs().max_element() <= limits::MAX_COORDINATE
            && volume > 1e-12 * lengths.iter().product::<f64>()
            && lengths.iter().all(|l| (1e-9..=1e9).contains(l));
        if !sound {
            return Err(Error::invalid(
                format!("transform with scale {lengths:?} and volume {volume:e} is not finite or flattens the object"),
                "give every axis a finite scale other than zero",
            ));
        }
        let pose = Pose::rigid_part(&world_from_mesh);
        let mut rest = pose.rotation_matrix().transpose() * m;
        // A pure rotation leaves an identity with rounding errors: make it exact.
        if (rest - DMat3::IDENTITY).to_cols_array().iter().all(|d| d.abs() < 1e-15) {
            rest = DMat3::IDENTITY;
        }
        Ok(Self { object_from_mesh: DAffine3::from_mat3(rest), ..Self::new(name, pose, mesh) })
    }
}

/// Numbers of repeated names. They save work and change no result, so `Debug` leaves them out.
#[derive(Clone, Default)]
struct NextNumbers(HashMap<String, u32>);

impl fmt::Debug for NextNumbers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("..")
    }
}

/// Objects in groups, materials and feature layers. Each polygon has a slot; slots are never reused.
#[derive(Clone, Debug, Default)]
pub struct Environment {
    objects: Vec<Object>,
    materials: Vec<Material>,
    layers: Vec<FeatureLayer>,
    /// The content of the layers during a series of changes, by class ([`Environment::open_layers`]).
    open: Option<BTreeMap<String, open::OpenLayer>>,
    /// Sorted, so that everything below a path follows it.
    names: BTreeMap<String, u32>,
    /// Frames that were set for groups. None of these paths is an object.
    groups: BTreeMap<String, Pose>,
    /// Ids of deleted features, by class; they are never reused.
    retired: BTreeMap<String, BTreeSet<u32>>,
    /// Marks on objects, and trust in them.
    beliefs: marks::Beliefs,
    /// For repeated names, the number to try next; all lower ones are taken.
    next_numbers: NextNumbers,
    next_slot: u32,
}

impl Environment {
    /// An empty environment.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a material and returns its index, for [`Polygon::material`].
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if the reflection factor is outside 0..=1 or there are over 65,535 materials.
    pub fn add_material(&mut self, material: Material) -> Result<u16> {
        material.check()?;
        let index = u16::try_from(self.materials.len())
            .ok()
            .filter(|&index| index < u16::MAX)
            .ok_or_else(|| Error::invalid("over 65,535 materials", "merge equal materials"))?;
        self.materials.push(material);
        Ok(index)
    }

    /// Adds an object and returns its index (`object_id` in images minus one). The object replaces a group at its path.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if the mesh names a material that does not exist, the pose is not finite or out
    /// of bounds, or a limit is exceeded.
    pub fn insert(&mut self, new: NewObject) -> Result<u32> {
        let place = || format!("object {:?}", new.name);
        check_pose(&new.world_from_object).map_err(|e| e.at(place()))?;
        if !new.object_from_mesh.is_finite() {
            return Err(Error::invalid("its scale is not finite", "give a finite object_from_mesh").at(place()));
        }
        if let Some(material) = new.mesh.materials().iter().find(|m| usize::from(**m) >= self.materials.len()) {
            return Err(Error::invalid(
                format!("material {material} does not exist"),
                "add the materials before the objects",
            )
            .at(place()));
        }
        let polygons = new.mesh.polygons().len() as u64;
        if u64::from(self.next_slot) + polygons > limits::MAX_POLYGONS || self.objects.len() >= limits::MAX_OBJECTS {
            return Err(Error::invalid(
                format!("over {} polygons or {} objects", limits::MAX_POLYGONS, limits::MAX_OBJECTS),
                "split the environment",
            )
            .at(place()));
        }
        let index = self.objects.len() as u32;
        let name = self.unique_name(&new.name);
        self.names.insert(name.clone(), index);
        // The path now belongs to an object, whose pose is the frame of everything below.
        self.groups.remove(&name);
        self.objects.push(Object {
            name,
            world_from_object: new.world_from_object,
            object_from_mesh: new.object_from_mesh,
            mesh: new.mesh,
            first_slot: self.next_slot,
            first_source: new.first_source,
            deleted: false,
        });
        self.next_slot += polygons as u32;
        Ok(index)
    }

    /// Sets the pose of an object.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if there is no such object or the pose is not finite or out of bounds.
    pub fn set_pose(&mut self, name: &str, world_from_object: Pose) -> Result<u32> {
        let index = self.index_of(name)?;
        check_pose(&world_from_object).map_err(|e| e.at(format!("object {name:?}")))?;
        self.objects[index as usize].world_from_object = world_from_object;
        Ok(index)
    }

    /// Deletes an object and returns its index. Its name may be reused; its number and slots are not.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if there is no such object.
    pub fn delete(&mut self, name: &str) -> Result<u32> {
        let index = self.index_of(name)?;
        self.names.remove(name);
        self.give_up(name);
        let object = &mut self.objects[index as usize];
        (object.mesh, object.deleted) = (Arc::new(Mesh::empty(object.mesh.name())), true);
        Ok(index)
    }

    /// The index of the object with this full path.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if there is no such object.
    pub fn index_of(&self, name: &str) -> Result<u32> {
        self.names
            .get(name)
            .copied()
            .ok_or_else(|| Error::invalid(format!("there is no object {name:?}"), self.objects_remedy(name)))
    }

    /// The remedy for a name that no object has.
    pub fn objects_remedy(&self, name: &str) -> String {
        let alike = printable::did_you_mean(name, self.names.keys().map(String::as_str));
        alike + "presight inspect lists the objects"
    }

    /// Indices of the objects below a path: objects whose path starts with it and a slash.
    pub fn below(&self, path: &str) -> impl Iterator<Item = u32> + '_ {
        groups::below(&self.names, path).map(|(_, index)| *index)
    }

    /// Adds an object with the index and slots that it had before. Skipped numbers stay unused.
    pub fn insert_at(&mut self, index: u32, first_slot: u32, new: NewObject) -> Result<()> {
        let name = new.name.clone();
        if self.names.contains_key(&name) {
            return Err(Error::invalid(format!("two objects are named {name:?}"), ""));
        }
        self.skip_to(index, first_slot)?;
        self.insert(new).map(drop)
    }

    /// Fills up with deleted objects, so that the next object gets this index and this slot.
    pub fn skip_to(&mut self, index: u32, slot: u32) -> Result<()> {
        let known = self.objects.len();
        if (index as usize) < known || slot < self.next_slot || index as usize > limits::MAX_OBJECTS {
            let what =
                format!("object number {index} with slot {slot} after {known} objects and {} slots", self.next_slot);
            return Err(Error::invalid(what, "numbers and slots must rise"));
        }
        let gone = Object {
            name: String::new(),
            world_from_object: Pose::IDENTITY,
            object_from_mesh: DAffine3::IDENTITY,
            mesh: Arc::new(Mesh::empty("")),
            first_slot: self.next_slot,
            first_source: 0,
            deleted: true,
        };
        self.objects.resize(index as usize, gone);
        self.next_slot = slot;
        Ok(())
    }

    /// The wanted name, or the first free one of `#2`, `#3` and so on, for an object that is inserted next.
    fn unique_name(&mut self, wanted: &str) -> String {
        if !self.names.contains_key(wanted) {
            return wanted.to_owned();
        }
        let next = self.next_numbers.0.entry(wanted.to_owned()).or_insert(2);
        loop {
            let name = format!("{wanted}#{next}");
            *next += 1;
            if !self.names.contains_key(&name) && !self.groups.contains_key(&name) {
                return name;
            }
        }
    }

    /// Notes that a path is free again.
    fn give_up(&mut self, path: &str) {
        let Some((name, number)) = path.rsplit_once('#') else { return };
        if let (Some(next), Ok(number @ 2..)) = (self.next_numbers.0.get_mut(name), number.parse()) {
            *next = number.min(*next);
        }
    }

    /// All objects, by index.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// The object with this full path.
    pub fn object(&self, name: &str) -> Option<&Object> {
        self.names.get(name).map(|&i| &self.objects[i as usize])
    }

    /// All materials, by index.
    pub fn materials(&self) -> &[Material] {
        &self.materials
    }

    /// Number of slots used so far; every slot is below it.
    pub fn slot_count(&self) -> u32 {
        self.next_slot
    }

    /// Object index and polygon index of a slot.
    #[inline]
    pub fn locate(&self, slot: u32) -> Option<(u32, u32)> {
        if slot >= self.next_slot {
            return None;
        }
        let after = self.objects.partition_point(|o| o.first_slot <= slot);
        let object = after.checked_sub(1)?;
        let polygon = slot - self.objects[object].first_slot;
        // A deleted object keeps its slots and has no polygons.
        ((polygon as usize) < self.objects[object].mesh.polygon_count()).then_some((object as u32, polygon))
    }

    /// [`Object::polygon_in_world`] of the polygon in a slot; `None` for an empty slot.
    #[inline]
    pub fn polygon_in_world(&self, slot: u32) -> Option<Vec<DVec3>> {
        let (object, polygon) = self.locate(slot)?;
        Some(self.objects[object as usize].polygon_in_world(polygon))
    }

    /// Bounds of everything, in the world.
    pub fn bounds(&self) -> Aabb {
        self.objects.iter().fold(Aabb::EMPTY, |b, o| b.union(o.world_bounds()))
    }
}

/// Returns an error unless the pose is finite and its rotation a unit quaternion.
pub fn check_pose(pose: &Pose) -> Result<()> {
    pose.check_as(ErrorKind::Invalid)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, Vec3};

    fn triangle() -> Arc<Mesh> {
        let polygon = vec![0, 1, 2];
        Arc::new(
            Mesh::new("t", vec![Vec3::ZERO, Vec3::X, Vec3::Y], vec![Polygon::new(polygon, 0)], PolygonOrder::Spatial)
                .unwrap(),
        )
    }

    /// No taken number is tried twice, and a number that is free again is the next.
    #[test]
    fn repeated_names_get_the_first_free_number() {
        let mut env = Environment::new();
        env.add_material(Material::named("m")).unwrap();
        let insert = |env: &mut Environment| {
            let index = env.insert(NewObject::new("a", Pose::IDENTITY, triangle())).unwrap();
            env.objects()[index as usize].name.clone()
        };
        env.set_frame("a#3", Some(Pose::IDENTITY)).unwrap();
        assert_eq!([(); 4].map(|()| insert(&mut env)), ["a", "a#2", "a#4", "a#5"]);
        assert_eq!(env.next_numbers.0["a"], 6);
        env.delete("a#4").unwrap();
        env.delete("a#2").unwrap();
        assert_eq!([(); 3].map(|()| insert(&mut env)), ["a#2", "a#4", "a#6"]);
        env.set_frame("a#3", None).unwrap();
        assert_eq!([(); 2].map(|()| insert(&mut env)), ["a#3", "a#7"]);
        env.set_frame("a#8", Some(Pose::IDENTITY)).unwrap();
        assert_eq!(insert(&mut env), "a#9");
        env.settle_groups();
        assert_eq!([(); 2].map(|()| insert(&mut env)), ["a#8", "a#10"]);
    }

    #[test]
    fn names_stay_unique_and_slots_are_found() {
        let mut env = Environment::new();
        env.add_material(Material::named("m")).unwrap();
        for _ in 0..3 {
            env.insert(NewObject::new("a", Pose::IDENTITY, triangle())).unwrap();
        }
        let names: Vec<_> = env.objects().iter().map(|o| o.name.as_str()).collect();
        assert_eq!(names, ["a", "a#2", "a#3"]);
        assert_eq!(env.locate(2), Some((2, 0)));
        assert_eq!(env.locate(3), None);
    }

    #[test]
    fn errors_of_poses_say_which_rule_is_broken() {
        let said = |translation: DVec3, rotation: DQuat| {
            let e = check_pose(&Pose { translation, rotation }).unwrap_err();
            assert!(!e.remedy().is_empty());
            e.to_string()
        };
        let nan = said(DVec3::new(0.5, f64::NAN, 0.0), DQuat::IDENTITY);
        assert!(nan.starts_with("the pose [0.5, NaN, 0.0, 0.0, 0.0, 0.0, 1.0] is not finite; "), "{nan}");
        let long = said(DVec3::ZERO, DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0));
        assert!(
            long.starts_with("the pose [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0] is not a rotation")
                && long.contains("length 2,"),
            "{long}"
        );
        let far = said(DVec3::new(-1e300, 0.0, 0.0), DQuat::IDENTITY);
        assert!(far.starts_with("the pose [-1e300, 0.0,") && far.contains("too far away: over 1e12 m"), "{far}");
    }

    #[test]
    fn unknown_material_is_an_error() {
        let mut env = Environment::new();
        assert!(env.insert(NewObject::new("a", Pose::IDENTITY, triangle())).is_err());
    }

    #[test]
    fn mirror_and_scale_survive_the_split() {
        let m = DMat3::from_quat(DQuat::from_rotation_z(0.4)) * DMat3::from_diagonal(DVec3::new(2.0, -3.0, 0.5));
        let whole = DAffine3::from_mat3_translation(m, DVec3::new(5e6, 1.0, 2.0));
        let new = NewObject::from_affine("a", whole, triangle()).unwrap();
        let again = new.world_from_object.to_affine() * new.object_from_mesh;
        let apart = again.matrix3 - whole.matrix3;
        assert!(apart.to_cols_array().iter().all(|d| d.abs() < 1e-14));
        assert_eq!(again.translation, whole.translation);
        assert!(NewObject::from_affine("a", DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0)), triangle()).is_err());
    }
}
