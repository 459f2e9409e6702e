//! An index of any kind, kept in step with an environment.

use super::boxes::{Box32, LANES, Shift};
use super::mesh_tree::MeshTree;
use super::ray::ObjectTree;
use super::region::ShapeVisitor;
use super::shapes::Shape;
use super::{IndexKind, Params, QueryResult, Region, Skd, SpatialIndex};
use crate::environment::{Environment, Mesh, Object};
use crate::geometry::Aabb;
use crate::threads::parallel_or_here;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

/// Finds the polygons of an environment that have a point in a region.
#[derive(Clone, Debug)]
pub struct WorldIndex {
    kind: Kind,
    /// Of the objects as they are; built when rays first want it.
    for_rays: OnceLock<Arc<ObjectTree>>,
}

#[derive(Clone, Debug)]
enum Kind {
    None,
    /// An index of slots.
    Flat(Box<dyn SpatialIndex>),
    /// An index of objects, and the tree of each object's mesh.
    TwoLevel {
        params: Params,
        objects: Box<Skd<3>>,
        trees: Vec<Arc<MeshTree>>,
        holders: Holders,
    },
}

/// Trees of meshes, by the address of the mesh.
pub type Trees = HashMap<*const Mesh, Arc<MeshTree>>;

/// Neighbouring polygons of one cluster of an object's mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectRun {
    /// Index of the object.
    pub object: u32,
    /// First polygon of the mesh.
    pub first: u32,
    /// Number of polygons.
    pub count: u32,
    /// Lower bound of the distance from the region's origin, metres.
    pub nearest: f64,
}

impl WorldIndex {
    /// Builds the index of an environment.
    pub fn new(environment: &Environment, kind: &IndexKind) -> Self {
        Self::with_trees(environment, kind, &Trees::default())
    }

    /// [`WorldIndex::new`], but [`IndexKind::TwoLevel`] uses the given trees of meshes where present.
    pub fn with_trees(environment: &Environment, kind: &IndexKind, trees: &Trees) -> Self {
        let kind = match kind {
            IndexKind::None => Kind::None,
            IndexKind::TwoLevel(params) => two_level(environment, *params, trees),
            IndexKind::Polygons(index) => {
                let boxes: Vec<(u32, Aabb)> = environment.objects().iter().flat_map(polygon_boxes).collect();
                Kind::Flat(index.rebuilt(&boxes))
            }
        };
        Self { kind, for_rays: OnceLock::new() }
    }

    /// The name in statistics.
    pub fn name(&self) -> &'static str {
        match &self.kind {
            Kind::None => "none",
            Kind::TwoLevel { .. } => "two-level",
            Kind::Flat(index) => index.name(),
        }
    }

    /// The kind, with which another index like this one can be built.
    pub fn kind(&self) -> IndexKind {
        match &self.kind {
            Kind::None => IndexKind::None,
            Kind::TwoLevel { params, .. } => IndexKind::TwoLevel(*params),
            Kind::Flat(index) => IndexKind::Polygons(index.rebuilt(&[])),
        }
    }

    /// Adds an object, or moves it to its current pose; `environment` must have it already.
    pub fn insert_object(&mut self, environment: &Environment, object: u32) {
        self.for_rays = OnceLock::new();
        let o = &environment.objects()[object as usize];
        match &mut self.kind {
            Kind::None => {}
            Kind::Flat(index) => polygon_boxes(o).for_each(|(slot, b)| index.insert(slot, &b)),
            Kind::TwoLevel { objects, trees, holders, .. } => {
                for new in trees.len()..=object as usize {
                    let tree = tree_of(new, environment, trees, holders);
                    trees.push(tree);
                }
                if o.mesh.polygon_count() > 0 {
                    objects.insert(object, &o.world_bounds());
                }
            }
        }
    }

    /// Removes an object that `environment` still has.
    pub fn remove_object(&mut self, environment: &Environment, object: u32) {
        self.for_rays = OnceLock::new();
        let o = &environment.objects()[object as usize];
        match &mut self.kind {
            Kind::None => {}
            Kind::Flat(index) => {
                for slot in o.first_slot..o.first_slot + o.mesh.polygon_count() as u32 {
                    index.remove(slot);
                }
            }
            Kind::TwoLevel { objects, .. } => {
                objects.remove(object);
            }
        }
    }

    /// Removes the object that was added last, as if it had never been there.
    pub(crate) fn remove_last(&mut self, environment: &Environment, object: u32) {
        self.remove_object(environment, object);
        if let Kind::TwoLevel { trees, .. } = &mut self.kind {
            trees.truncate(object as usize);
        }
    }

    /// The objects of this version for rays; built on the first call.
    pub fn object_tree(&self, environment: &Environment) -> &ObjectTree {
        self.for_rays.get_or_init(|| Arc::new(ObjectTree::new(environment)))
    }

    /// Appends the slots of all polygons whose box meets the region.
    pub fn query(&self, environment: &Environment, region: &Region, found: &mut QueryResult) {
        match &self.kind {
            Kind::Flat(index) => index.query(region, found),
            Kind::None => {
                for (_, slot, b) in all_boxes(environment) {
                    found.tested += 1;
                    if region.meets(&b) {
                        found.ids.push(slot);
                    }
                }
            }
            Kind::TwoLevel { params, objects, trees, .. } => {
                let mut near = found.near.take().unwrap_or_default();
                near.clear();
                objects.query(region, &mut near);
                for object in &near.ids {
                    let (o, tree) = (&environment.objects()[*object as usize], &trees[*object as usize]);
                    let filter = params.filter;
                    with_mesh(o, tree, region, MeshQuery { tree, first_slot: o.first_slot, filter, found });
                }
                found.visited += near.visited;
                found.near = Some(near);
            }
        }
    }

    /// Appends the polygons for a prediction to draw: runs of polygons that may have a point in the region, each within
    /// one cluster, object by object.
    pub fn select(
        &self,
        environment: &Environment,
        region: &Region,
        found: &mut QueryResult,
        runs: &mut Vec<ObjectRun>,
    ) {
        found.clear();
        match &self.kind {
            Kind::None => {
                for (object, o) in (0..).zip(environment.objects()) {
                    if o.mesh.polygon_count() > 0 {
                        let matrix = region.region_from_world * o.world_from_mesh().matrix3;
                        region.with_turned(matrix, Clusters { object, o, origin: region.origin(), runs });
                    }
                }
            }
            Kind::Flat(index) => {
                index.query(region, found);
                found.ids.sort_unstable();
                gather(environment, index.as_ref(), region, &found.ids, runs);
            }
            Kind::TwoLevel { params, objects, trees, .. } => {
                objects.query(region, found);
                for at in 0..found.ids.len() {
                    let object = found.ids[at];
                    let (o, tree) = (&environment.objects()[object as usize], &trees[object as usize]);
                    let filter = params.filter;
                    with_mesh(o, tree, region, MeshSelect { tree, mesh: &o.mesh, object, filter, runs });
                }
            }
        }
    }

    /// Memory in bytes, boxes included.
    pub fn bytes(&self) -> usize {
        match &self.kind {
            Kind::None => 0,
            Kind::Flat(index) => index.bytes(),
            Kind::TwoLevel { objects, trees, holders, .. } => {
                let mut seen: Vec<*const MeshTree> = trees.iter().map(Arc::as_ptr).collect();
                seen.sort_unstable();
                let own: usize = trees.iter().filter(|t| first_of(&mut seen, Arc::as_ptr(t))).map(|t| t.bytes()).sum();
                let lists =
                    trees.capacity() * size_of::<Arc<MeshTree>>() + holders.capacity() * size_of::<(usize, usize)>();
                objects.bytes() + lists + own
            }
        }
    }

    /// Checks the invariants between its parts and the environment.
    ///
    /// # Panics
    /// If one is violated, which is a bug.
    pub fn assert_well_formed(&self, environment: &Environment) {
        match &self.kind {
            Kind::None => {}
            Kind::Flat(index) => {
                index.assert_well_formed();
                let mut count = 0;
                for (_, slot, b) in all_boxes(environment) {
                    let stored = index.bounds_of(slot);
                    assert!(stored.is_some_and(|s| s.min.cmple(b.min).all() && s.max.cmpge(b.max).all()));
                    count += 1;
                }
                assert_eq!(count, index.len());
            }
            Kind::TwoLevel { objects, trees, .. } => {
                objects.assert_well_formed();
                let mut count = 0;
                for (object, o) in (0..).zip(environment.objects()).filter(|(_, o)| o.mesh.polygon_count() > 0) {
                    let (stored, b) = (objects.bounds_of(object), o.world_bounds());
                    assert!(stored.is_some_and(|s| s.min.cmple(b.min).all() && s.max.cmpge(b.max).all()));
                    trees[object as usize].assert_well_formed(&o.mesh);
                    count += 1;
                }
                assert_eq!(count, objects.len());
            }
        }
    }
}

/// True on the first call for a pointer of the sorted list.
fn first_of(sorted: &mut Vec<*const MeshTree>, pointer: *const MeshTree) -> bool {
    let range = sorted.partition_point(|p| *p < pointer)..sorted.partition_point(|p| *p <= pointer);
    let first = !range.is_empty();
    sorted.drain(range);
    first
}

/// Builds trees for meshes without one in `known`.
fn two_level(environment: &Environment, params: Params, known: &Trees) -> Kind {
    let mut numbers: HashMap<*const Mesh, usize> = HashMap::new();
    let mut meshes = Vec::new();
    for o in environment.objects() {
        let address = Arc::as_ptr(&o.mesh);
        numbers.entry(address).or_insert_with(|| {
            meshes.push((&o.mesh, known.get(&address)));
            meshes.len() - 1
        });
    }
    let tree = |(mesh, known): &(&Arc<Mesh>, Option<&Arc<MeshTree>>)| {
        known.map_or_else(|| Arc::new(MeshTree::new(mesh)), Arc::clone)
    };
    let each: Vec<Arc<MeshTree>> = parallel_or_here(|| meshes.par_iter().with_max_len(1).map(tree).collect());
    let trees = environment.objects().iter().map(|o| each[numbers[&Arc::as_ptr(&o.mesh)]].clone()).collect();
    let boxes: Vec<(u32, Aabb)> = (0..)
        .zip(environment.objects())
        .filter(|(_, o)| o.mesh.polygon_count() > 0)
        .map(|(i, o)| (i, o.world_bounds()))
        .collect();
    let holders = environment.objects().iter().map(|o| address_of(&o.mesh)).zip(0..).collect();
    Kind::TwoLevel { params, objects: Box::new(Skd::build(params, &boxes)), trees, holders }
}

/// The tree of a new object's mesh, shared with an object that already has this mesh. Every mesh of an earlier object
/// has a holder. That holder may be gone, and another mesh may have its address by now.
fn tree_of(new: usize, environment: &Environment, trees: &[Arc<MeshTree>], holders: &mut Holders) -> Arc<MeshTree> {
    let objects = environment.objects();
    let mesh = &objects[new].mesh;
    let holds = |object: &usize| trees.len() > *object && Arc::ptr_eq(&objects[*object].mesh, mesh);
    let known = holders
        .insert(address_of(mesh), new)
        .and_then(|holder| if holds(&holder) { Some(holder) } else { (0..new).rev().find(holds) });
    known.map_or_else(|| Arc::new(MeshTree::new(mesh)), |holder| trees[holder].clone())
}

/// By mesh address, the latest object with that mesh.
type Holders = HashMap<usize, usize>;

fn address_of(mesh: &Arc<Mesh>) -> usize {
    Arc::as_ptr(mesh).addr()
}

/// Slot and box in the world of each polygon of an object.
fn polygon_boxes(o: &Object) -> impl Iterator<Item = (u32, Aabb)> + '_ {
    let world_from_mesh = o.world_from_mesh();
    let m = world_from_mesh.matrix3;
    let growth = [m.x_axis, m.y_axis, m.z_axis].map(|a| a.abs().element_sum()).into_iter().fold(0.0, f64::max);
    (0..o.mesh.polygon_count() as u32).map(move |polygon| {
        let mut b = Aabb::EMPTY;
        let mut reach: f64 = 0.0;
        for p in o.mesh.corners_of(polygon) {
            b = b.with(world_from_mesh.transform_point3(p));
            reach = reach.max(p.abs().max_element());
        }
        // Covers the rounding of the transform.
        let slack = 8.0 * f64::EPSILON * (reach * growth + world_from_mesh.translation.abs().max_element());
        (o.first_slot + polygon, Aabb { min: b.min - slack, max: b.max + slack })
    })
}

fn all_boxes(environment: &Environment) -> impl Iterator<Item = (u32, u32, Aabb)> + '_ {
    let objects = (0..).zip(environment.objects());
    objects.flat_map(|(object, o)| polygon_boxes(o).map(move |(slot, b)| (object, slot, b)))
}

/// Calls the visitor with the region's shape in the frame of an object's mesh.
fn with_mesh<V: MeshVisitor>(o: &Object, tree: &MeshTree, region: &Region, visitor: V) {
    let matrix = region.region_from_world * o.world_from_mesh().matrix3;
    let origin = o.point_in_mesh(region.origin());
    let shift = Shift::new(DVec3::ZERO, origin, &tree.bounds(), 3);
    // The subtraction of world positions is exact up to their last digits: this slack, in the mesh's units.
    let slack = point_slack(o, region.origin());
    region.with_turned(matrix, Dispatch { shift: shift.grown(slack), visitor });
}

/// Error bound of [`Object::point_in_mesh`], in the mesh's units.
fn point_slack(o: &Object, p: DVec3) -> f64 {
    // The mesh's extent covers the rounding of the matrix elements.
    let apart = p.abs().max_element() + o.world_from_object.translation.abs().max_element() + o.world_bounds().size();
    let least = {
        let m = o.object_from_mesh.matrix3.inverse();
        [m.x_axis, m.y_axis, m.z_axis].map(|a| a.abs().element_sum()).into_iter().fold(0.0, f64::max)
    };
    32.0 * f64::EPSILON * apart * least
}

/// An operation in the frame of a mesh.
trait MeshVisitor {
    fn visit<S: Shape>(self, shape: &S, shift: &Shift);
}

struct Dispatch<V> {
    shift: Shift,
    visitor: V,
}

impl<V: MeshVisitor> ShapeVisitor for Dispatch<V> {
    type Out = ();

    fn visit<S: Shape>(self, shape: &S) {
        struct Run<'a, S, V>(&'a S, Dispatch<V>);
        impl<S: Shape, V: MeshVisitor> pulp::WithSimd for Run<'_, S, V> {
            type Output = ();

            #[inline(always)]
            fn with_simd<D: pulp::Simd>(self, _: D) {
                self.1.visitor.visit(self.0, &self.1.shift);
            }
        }
        pulp::Arch::new().dispatch(Run(shape, self));
    }
}

/// Collects the slots of a mesh's polygons.
struct MeshQuery<'a> {
    tree: &'a MeshTree,
    first_slot: u32,
    filter: bool,
    found: &'a mut QueryResult,
}

impl MeshVisitor for MeshQuery<'_> {
    #[inline(always)]
    fn visit<S: Shape>(self, shape: &S, shift: &Shift) {
        let Self { tree, first_slot, filter, found } = self;
        let (mut at, mut visited) = (0, 0);
        while let Some(part) = tree.next_part(&mut at, shape, shift, &mut visited) {
            if part.whole || !filter {
                let first = first_slot + part.first;
                found.runs.push(first..first + part.count);
                continue;
            }
            found.tested += part.count as usize;
            for group in MeshTree::groups(&part) {
                let mut met = tree.filter(group, &part, shape, shift);
                while met != 0 {
                    found.ids.push(first_slot + group * LANES as u32 + met.trailing_zeros());
                    met &= met - 1;
                }
            }
        }
        found.visited += visited;
    }
}

/// Collects runs of a mesh's polygons.
struct MeshSelect<'a> {
    tree: &'a MeshTree,
    mesh: &'a Mesh,
    object: u32,
    filter: bool,
    runs: &'a mut Vec<ObjectRun>,
}

impl MeshVisitor for MeshSelect<'_> {
    #[inline(always)]
    fn visit<S: Shape>(self, shape: &S, shift: &Shift) {
        let Self { tree, mesh, object, filter, runs } = self;
        let mut at = 0;
        while let Some(part) = tree.next_part(&mut at, shape, shift, &mut 0) {
            if part.whole {
                let clusters = mesh.clusters();
                let from = clusters.partition_point(|c| c.first < part.first);
                for c in clusters[from..].iter().take_while(|c| c.first < part.first + part.count) {
                    let b = shift.apply(&Box32::around(&c.bounds, DVec3::ZERO));
                    runs.push(ObjectRun { object, first: c.first, count: c.count, nearest: shape.distance(&b) });
                }
                continue;
            }
            let (mut first, mut end) = (part.first, part.first + part.count);
            if filter {
                // Also draws the polygons between the first and the last: one run is cheaper than several.
                (first, end) = (u32::MAX, 0);
                for group in MeshTree::groups(&part) {
                    let met = tree.filter(group, &part, shape, shift);
                    if met != 0 {
                        first = first.min(group * LANES as u32 + met.trailing_zeros());
                        end = group * LANES as u32 + u32::BITS - met.leading_zeros();
                    }
                }
            }
            if first < end {
                let nearest = shape.distance(&part.bounds);
                runs.push(ObjectRun { object, first, count: end - first, nearest });
            }
        }
    }
}

/// Collects the clusters of a mesh, without a tree.
struct Clusters<'a> {
    object: u32,
    o: &'a Object,
    origin: DVec3,
    runs: &'a mut Vec<ObjectRun>,
}

impl ShapeVisitor for Clusters<'_> {
    type Out = ();

    fn visit<S: Shape>(self, shape: &S) {
        let Self { object, o, origin, runs } = self;
        let (center, slack) = (o.point_in_mesh(origin), point_slack(o, origin));
        let here = |b: &Aabb| {
            let slack = slack + 4.0 * f64::EPSILON * (center.abs() + b.min.abs().max(b.max.abs()));
            Aabb { min: b.min - center - slack, max: b.max - center + slack }
        };
        if !shape.meets(&here(&o.mesh.bounds())) {
            return;
        }
        for c in o.mesh.clusters() {
            let b = here(&c.bounds);
            if shape.meets(&b) {
                runs.push(ObjectRun { object, first: c.first, count: c.count, nearest: shape.distance(&b) });
            }
        }
    }
}

/// Turns rising slots into runs: in each cluster, from the first to the last slot found.
fn gather(
    environment: &Environment,
    index: &dyn SpatialIndex,
    region: &Region,
    slots: &[u32],
    runs: &mut Vec<ObjectRun>,
) {
    let mut at = 0;
    while at < slots.len() {
        let Some((object, _)) = environment.locate(slots[at]) else { break };
        let o = &environment.objects()[object as usize];
        let end = o.first_slot + o.mesh.polygon_count() as u32;
        let mut clusters = o.mesh.clusters().iter();
        while at < slots.len() && slots[at] < end {
            let polygon = slots[at] - o.first_slot;
            let Some(cluster) = clusters.find(|c| polygon < c.first + c.count) else { break };
            let cluster_end = o.first_slot + cluster.first + cluster.count;
            let mut nearest = f64::INFINITY;
            let mut last = slots[at];
            while at < slots.len() && slots[at] < cluster_end {
                last = slots[at];
                let b = index.bounds_of(last);
                nearest = b.map_or(0.0, |b| b.distance_squared(region.origin())).min(nearest);
                at += 1;
            }
            let first = polygon;
            // Polygons between the found ones may be nearer. The key ignores them because they were not requested.
            runs.push(ObjectRun { object, first, count: last - o.first_slot - first + 1, nearest: nearest.sqrt() });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{Material, NewObject, Polygon, PolygonOrder};
    use crate::{Change, Pose, World};

    /// Meshes are distinguished and shared, even after an object that had one is deleted.
    #[test]
    fn a_mesh_has_one_tree_while_an_object_has_the_mesh() {
        let mut environment = Environment::new();
        environment.add_material(Material::named("m")).unwrap();
        let mesh = |x: f32| {
            let corners = [glam::Vec3::ZERO, glam::Vec3::X * x, glam::Vec3::Y].to_vec();
            Arc::new(Mesh::new("t", corners, vec![Polygon::new(vec![0, 1, 2], 0)], PolygonOrder::Given).unwrap())
        };
        let (shared, other) = (mesh(1.0), mesh(2.0));
        let mut world = World::new(environment);
        let insert = |world: &mut World, name: &str, mesh: &Arc<Mesh>| {
            world.apply(Change::InsertObject(NewObject::new(name, Pose::IDENTITY, mesh.clone()))).unwrap()
        };
        let tree = |world: &World, name: &str| {
            let Kind::TwoLevel { trees, .. } = &world.index().kind else { panic!("another index") };
            Arc::as_ptr(&trees[world.environment().index_of(name).unwrap() as usize])
        };
        insert(&mut world, "a", &shared);
        insert(&mut world, "b", &other);
        let last = insert(&mut world, "c", &shared);
        assert_eq!(tree(&world, "c"), tree(&world, "a"));
        assert_ne!(tree(&world, "b"), tree(&world, "a"));
        // The latest object with the mesh is deleted; the first still has it.
        world.apply(last).unwrap();
        insert(&mut world, "d", &shared);
        assert_eq!(tree(&world, "d"), tree(&world, "a"));
        // A group that fails removes its objects again.
        let failing = Change::Group(vec![
            Change::InsertObject(NewObject::new("e", Pose::IDENTITY, other.clone())),
            Change::DeleteObject { name: "none".into() },
        ]);
        world.apply(failing).unwrap_err();
        insert(&mut world, "e", &mesh(3.0));
        insert(&mut world, "f", &other);
        assert_eq!(tree(&world, "f"), tree(&world, "b"));
        assert_ne!(tree(&world, "e"), tree(&world, "b"));
        world.index().assert_well_formed(world.environment());
        // One holder per object, so that lookups do not grow.
        let Kind::TwoLevel { holders, .. } = &world.index().kind else { panic!("another index") };
        assert_eq!(holders.len(), 3);
    }
}
