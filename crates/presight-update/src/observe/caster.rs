//! What rays meet in one version of a world: first, and first of another object.

use crate::observe::solid::{Foot, Meeting, Solid};
use glam::{DAffine3, DVec3};
use presight_model::environment::{Appearance, Mesh};
use presight_model::geometry::{Aabb, Pose};
use presight_model::world::World;
use std::collections::HashMap;
use std::sync::Arc;

/// A surface that a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayHit {
    /// Index of the object.
    pub object: u32,
    /// Number of the polygon in its mesh.
    pub polygon: u32,
    /// Metres along the ray.
    pub range: f64,
    /// Unit normal of the polygon's front, world frame.
    pub normal: DVec3,
}

/// An object in the world.
#[derive(Clone, Debug)]
struct Placed {
    object: u32,
    solid: Arc<Solid>,
    world_from_object: Pose,
    object_from_world: Pose,
    bounds: Aabb,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Aabb,
    /// First object of a leaf, or the right child; the left one follows.
    at: usize,
    /// Objects of a leaf; 0 for others.
    count: usize,
}

/// Casts rays in one version of a world, as sensors of one class see it: polygons that are not opaque to the class, or
/// marked as absent for it, are not met.
///
/// ```
/// use glam::{DAffine3, DVec3};
/// use presight::environment::Environment;
/// use presight::update::Caster;
/// use presight::{Pose, World};
/// let mut environment = Environment::new();
/// let at = |x: f64| Pose::from_xyz_rpy(DVec3::new(x, 0.0, 0.0), 0.0, 0.0, 0.0);
/// environment.add_cuboid("crate", at(3.0), DVec3::ONE)?;
/// environment.add_cuboid("wall", at(8.0), DVec3::new(1.0, 9.0, 9.0))?;
/// let caster = Caster::new(&World::new(environment), "laser");
/// let first = caster.first(DVec3::ZERO, DVec3::X, 20.0, None).unwrap();
/// assert_eq!((first.object, first.range), (0, 2.5));
/// let second = caster.first(DVec3::ZERO, DVec3::X, 20.0, Some(first.object)).unwrap();
/// assert_eq!((second.object, second.range), (1, 7.5));
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Caster {
    placed: Vec<Placed>,
    nodes: Vec<Node>,
    /// Place in `placed` of each object.
    of_object: HashMap<u32, usize>,
}

impl Caster {
    /// Prepares all objects of a world for sensors of a class.
    pub fn new(world: &World, class: &str) -> Self {
        let environment = world.environment();
        let seen: Vec<Option<bool>> = environment
            .materials()
            .iter()
            .map(|m| (m.appearance(class) == Appearance::Opaque).then_some(m.one_sided))
            .collect();
        let mut solids: HashMap<(*const Mesh, [u64; 12]), Arc<Solid>> = HashMap::new();
        let mut placed = Vec::new();
        for (object, o) in (0..).zip(environment.objects()).filter(|(_, o)| !o.is_deleted()) {
            let Some(absent) = environment.absent_parts(object, class) else { continue };
            let keep = |polygon: u32| {
                let stands = absent.is_empty() || !environment.lies_in(object, polygon, &absent);
                seen[usize::from(o.mesh.material(polygon))].filter(|_| stands)
            };
            let solid = if absent.is_empty() {
                let key = (Arc::as_ptr(&o.mesh), o.object_from_mesh.to_cols_array().map(f64::to_bits));
                solids.entry(key).or_insert_with(|| Solid::new(o, keep).into()).clone()
            } else {
                Solid::new(o, keep).into()
            };
            if !solid.is_empty() {
                let world_from_object = o.world_from_object;
                let object_from_world = world_from_object.inverse();
                placed.push(Placed { object, solid, world_from_object, object_from_world, bounds: o.world_bounds() });
            }
        }
        let mut caster = Self { placed, nodes: Vec::new(), of_object: HashMap::new() };
        if !caster.placed.is_empty() {
            caster.grow(0, caster.placed.len());
        }
        caster.of_object = caster.placed.iter().enumerate().map(|(at, p)| (p.object, at)).collect();
        caster
    }

    /// The same world with shapes that have no place: rays meet them only at the poses of a call. Their indexes rise from `first`.
    pub(crate) fn with_shapes<'a>(&self, first: u32, shapes: impl Iterator<Item = (&'a Mesh, DAffine3)>) -> Self {
        let mut caster = self.clone();
        for (object, (mesh, object_from_mesh)) in (first..).zip(shapes) {
            caster.of_object.insert(object, caster.placed.len());
            let solid = Arc::new(Solid::of(mesh, object_from_mesh, |_| Some(false)));
            let pose = Pose::IDENTITY;
            let bounds = mesh.bounds().transformed(&object_from_mesh);
            caster.placed.push(Placed { object, solid, world_from_object: pose, object_from_world: pose, bounds });
        }
        caster
    }

    fn grow(&mut self, from: usize, to: usize) {
        let bounds = self.placed[from..to].iter().fold(Aabb::EMPTY, |all, p| all.union(p.bounds));
        let node = self.nodes.len();
        self.nodes.push(Node { bounds, at: from, count: to - from });
        if to - from <= 1 {
            return;
        }
        let size = bounds.half_extent();
        let axis = (0..3).max_by(|a, b| size[*a].total_cmp(&size[*b])).unwrap_or(0);
        let half = (to - from) / 2;
        let middle = |p: &Placed| p.bounds.center()[axis];
        self.placed[from..to].select_nth_unstable_by(half, |a, b| middle(a).total_cmp(&middle(b)));
        self.grow(from, from + half);
        (self.nodes[node].at, self.nodes[node].count) = (self.nodes.len(), 0);
        self.grow(from + half, to);
    }

    fn walk(&self, meets: impl Fn(&Aabb) -> bool, mut visit: impl FnMut(&Placed)) {
        let mut stack = [0usize; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let at = stack[depth];
            let node = &self.nodes[at];
            if !meets(&node.bounds) {
                continue;
            }
            if node.count > 0 {
                self.placed[node.at..node.at + node.count].iter().for_each(&mut visit);
            } else {
                (stack[depth], stack[depth + 1]) = (node.at, at + 1);
                depth += 2;
            }
        }
    }

    /// What a ray from `origin` along the unit `ray` (world frame) meets first within `reach` metres, of all objects but
    /// `without`.
    pub fn first(&self, origin: DVec3, ray: DVec3, reach: f64, without: Option<u32>) -> Option<RayHit> {
        let (inverse, best) = (ray.recip(), std::cell::Cell::new((reach, None)));
        let meets = |b: &Aabb| {
            let (a, b) = ((b.min - origin) * inverse, (b.max - origin) * inverse);
            let near = a.x.min(b.x).max(a.y.min(b.y)).max(a.z.min(b.z)).max(0.0);
            let far = a.x.max(b.x).min(a.y.max(b.y)).min(a.z.max(b.z));
            near <= far && near < best.get().0
        };
        self.walk(meets, |placed| {
            if Some(placed.object) == without {
                return;
            }
            if let Some(found) =
                placed.cast(&placed.world_from_object, &placed.object_from_world, (origin, ray, best.get().0))
            {
                best.set((found.range, Some(found)));
            }
        });
        best.get().1
    }

    /// What a ray meets first of one object, as if it stood at another pose.
    pub(crate) fn meet(&self, object: u32, at: &Pose, ray: (DVec3, DVec3, f64)) -> Option<RayHit> {
        self.placed.get(*self.of_object.get(&object)?)?.cast(at, &at.inverse(), ray)
    }

    /// The point of an object's surface that is nearest to a point of its frame, within `reach` metres.
    pub(crate) fn foot(&self, object: u32, p_in_object: DVec3, reach: f64) -> Option<Foot> {
        self.placed.get(*self.of_object.get(&object)?)?.solid.nearest(p_in_object, reach)
    }

    /// The object whose surface is nearest to a point of the world, within `reach` metres, and the point of that surface in the
    /// object's frame.
    pub(crate) fn on(&self, p_in_world: DVec3, reach: f64) -> Option<(u32, DVec3)> {
        let object = self.near(p_in_world, reach)?;
        let placed = &self.placed[*self.of_object.get(&object)?];
        let foot = placed.solid.nearest(placed.object_from_world.transform_point(p_in_world), 2.0 * reach)?;
        Some((object, foot.point))
    }

    /// The object whose surface is nearest to a point of the world, if one is within `reach` metres.
    pub fn near(&self, p_in_world: DVec3, reach: f64) -> Option<u32> {
        let best = std::cell::Cell::new((reach, None));
        self.walk(
            |bounds| bounds.distance_squared(p_in_world) <= best.get().0.powi(2),
            |placed| {
                let p = placed.object_from_world.transform_point(p_in_world);
                if let Some(foot) = placed.solid.nearest(p, best.get().0) {
                    best.set((foot.distance_squared.sqrt(), Some(placed.object)));
                }
            },
        );
        best.get().1
    }
}

impl Placed {
    fn cast(&self, at: &Pose, inverse: &Pose, (origin, ray, reach): (DVec3, DVec3, f64)) -> Option<RayHit> {
        let Meeting { range, polygon, normal } =
            self.solid.cast(inverse.transform_point(origin), inverse.rotation * ray, reach)?;
        Some(RayHit { object: self.object, polygon, range, normal: at.rotation * normal })
    }
}
