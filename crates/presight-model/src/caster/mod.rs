//! Rays and nearest points in f64, where no image is needed.

mod surface;
mod tree;

pub use surface::SurfacePoint;

use crate::environment::{Appearance, Mesh};
use crate::geometry::{Aabb, Pose};
use crate::world::World;
use glam::{DAffine3, DVec3};
use std::collections::HashMap;
use std::sync::Arc;
use surface::Surface;
use tree::BoxTree;

/// The first polygon on a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayHit {
    /// Index of the object.
    pub object: u32,
    /// Index of the polygon in its mesh.
    pub polygon: u32,
    /// Metres along the ray.
    pub range: f64,
    /// Unit normal of the polygon's front, world frame.
    pub normal: DVec3,
}

#[derive(Clone, Debug)]
struct PlacedSurface {
    object: u32,
    surface: Arc<Surface>,
    world_from_object: Pose,
    object_from_world: Pose,
    /// World frame.
    bounds: Aabb,
}

impl PlacedSurface {
    /// The first hit of a ray (origin, unit direction, maximum range) if the object stands at this pose.
    fn cast(&self, world_from_object: &Pose, object_from_world: &Pose, ray: (DVec3, DVec3, f64)) -> Option<RayHit> {
        let (origin, direction, max_range) = ray;
        let (origin, direction) = (object_from_world.transform_point(origin), object_from_world.rotation * direction);
        let hit = self.surface.cast(origin, direction, max_range)?;
        let normal = world_from_object.rotation * hit.normal;
        Some(RayHit { object: self.object, polygon: hit.polygon, range: hit.range, normal })
    }
}

/// Casts rays in one version of a world as sensors of one class see it: rays pass through polygons that are not opaque
/// to the class and through those in regions marked as absent for it.
///
/// ```
/// use glam::DVec3;
/// use presight_model::caster::RayCaster;
/// use presight_model::{Environment, Pose, World};
/// let mut environment = Environment::new();
/// let at = |x: f64| Pose::from_xyz_rpy(DVec3::new(x, 0.0, 0.0), 0.0, 0.0, 0.0);
/// environment.add_cuboid("crate", at(3.0), DVec3::ONE)?;
/// environment.add_cuboid("wall", at(8.0), DVec3::new(1.0, 9.0, 9.0))?;
/// let caster = RayCaster::new(&World::new(environment), "laser");
/// let first = caster.cast(DVec3::ZERO, DVec3::X, 20.0, None).unwrap();
/// assert_eq!((first.object, first.range), (0, 2.5));
/// let second = caster.cast(DVec3::ZERO, DVec3::X, 20.0, Some(first.object)).unwrap();
/// assert_eq!((second.object, second.range), (1, 7.5));
/// # Ok::<(), presight_model::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct RayCaster {
    placed: Vec<PlacedSurface>,
    tree: BoxTree,
    /// Index in `placed` of each object.
    of_object: HashMap<u32, usize>,
}

impl RayCaster {
    /// Prepares all objects of a world for sensors of a class.
    pub fn new(world: &World, class: &str) -> Self {
        let environment = world.environment();
        let sides: Vec<Option<bool>> = environment
            .materials()
            .iter()
            .map(|m| (m.appearance(class) == Appearance::Opaque).then_some(m.one_sided))
            .collect();
        let mut shared: HashMap<(*const Mesh, [u64; 12]), Arc<Surface>> = HashMap::new();
        let mut placed = Vec::new();
        for (object, o) in (0..).zip(environment.objects()).filter(|(_, o)| !o.is_deleted()) {
            let Some(absent) = environment.absent_parts(object, class) else { continue };
            let make = || {
                Arc::new(Surface::new(&o.mesh, o.object_from_mesh, |polygon| {
                    let present = absent.is_empty() || !environment.lies_in(object, polygon, &absent);
                    sides[usize::from(o.mesh.material(polygon))].filter(|_| present)
                }))
            };
            let surface = if absent.is_empty() {
                let key = (Arc::as_ptr(&o.mesh), o.object_from_mesh.to_cols_array().map(f64::to_bits));
                shared.entry(key).or_insert_with(make).clone()
            } else {
                make()
            };
            if !surface.is_empty() {
                let world_from_object = o.world_from_object;
                let (object_from_world, bounds) = (world_from_object.inverse(), o.world_bounds());
                placed.push(PlacedSurface { object, surface, world_from_object, object_from_world, bounds });
            }
        }
        let tree = BoxTree::new(&mut placed, 1, &|p| p.bounds, &|p, axis| p.bounds.center()[axis]);
        let of_object = placed.iter().enumerate().map(|(at, p)| (p.object, at)).collect();
        Self { placed, tree, of_object }
    }

    /// A caster of the same world with further objects, given by mesh and `object_from_mesh`. They have no pose: only
    /// [`RayCaster::cast_at`] and [`RayCaster::nearest_on`] find them. Their indices count up from `first`.
    #[must_use]
    pub fn with_meshes<'a>(&self, first: u32, meshes: impl IntoIterator<Item = (&'a Mesh, DAffine3)>) -> Self {
        let mut caster = self.clone();
        for (object, (mesh, object_from_mesh)) in (first..).zip(meshes) {
            caster.of_object.insert(object, caster.placed.len());
            caster.placed.push(PlacedSurface {
                object,
                surface: Arc::new(Surface::new(mesh, object_from_mesh, |_| Some(false))),
                world_from_object: Pose::IDENTITY,
                object_from_world: Pose::IDENTITY,
                bounds: Aabb::EMPTY,
            });
        }
        caster
    }

    fn object(&self, object: u32) -> Option<&PlacedSurface> {
        Some(&self.placed[*self.of_object.get(&object)?])
    }

    /// The first hit of a ray from `origin` along the unit `ray` (world frame) within `max_range` metres, on any object
    /// but `without`.
    pub fn cast(&self, origin: DVec3, ray: DVec3, max_range: f64, without: Option<u32>) -> Option<RayHit> {
        let mut first = None;
        self.tree.along_ray(origin, ray, max_range, |leaf, nearest| {
            for placed in self.placed[leaf].iter().filter(|placed| Some(placed.object) != without) {
                let ray = (origin, ray, *nearest);
                if let Some(hit) = placed.cast(&placed.world_from_object, &placed.object_from_world, ray) {
                    *nearest = hit.range;
                    first = Some(hit);
                }
            }
        });
        first
    }

    /// The first hit of a ray (origin, unit direction, maximum range in metres; world frame) on one object, as if it
    /// stood at another pose.
    pub fn cast_at(&self, object: u32, world_from_object: &Pose, ray: (DVec3, DVec3, f64)) -> Option<RayHit> {
        self.object(object)?.cast(world_from_object, &world_from_object.inverse(), ray)
    }

    /// The point of an object's surface that is nearest to a point of its frame, within `max_distance` metres.
    pub fn nearest_on(&self, object: u32, p_in_object: DVec3, max_distance: f64) -> Option<SurfacePoint> {
        self.object(object)?.surface.nearest(p_in_object, max_distance * max_distance)
    }

    /// The object whose surface is nearest to a point of the world, within `max_distance` metres, and the nearest point
    /// of that surface in the object's frame.
    pub fn nearest(&self, p_in_world: DVec3, max_distance: f64) -> Option<(u32, SurfacePoint)> {
        let mut nearest = None;
        self.tree.around_point(p_in_world, max_distance * max_distance, |leaf, least| {
            for placed in &self.placed[leaf] {
                let p = placed.object_from_world.transform_point(p_in_world);
                if let Some(point) = placed.surface.nearest(p, *least) {
                    *least = point.distance_squared;
                    nearest = Some((placed.object, point));
                }
            }
        });
        nearest
    }
}
