//! Spatial indexes over the world's polygons (paper section 2.2). They find the polygons that have a point in a region.
//!
//! [`WorldIndex`] keeps an index in step with an environment. By default it is a spatial-kD tree of objects over one
//! tree for each mesh ([`IndexKind::TwoLevel`]). Any [`SpatialIndex`] over ids with boxes can take its place, such as
//! [`Skd`], a spatial-kD tree of polygons (Ooi, Sacks-Davis, McDonell 1987/1991).

pub mod boxes;
mod mesh_tree;
mod ray;
mod region;
mod sector;
mod shapes;
mod skd;
mod world_index;

pub use ray::{
    Half, Item, LEAF, NO_CHILD, ObjectTree, RayNode, RayTree, TriangleBlock, WIDE, WideChild, WideTree, halve, widen,
};
pub use region::Region;
pub use sector::{Rect, Sector};
pub use shapes::Shape;
pub use skd::Skd;
pub use world_index::{ObjectRun, WorldIndex};
pub use {
    mesh_tree::{MeshTree, PolygonBoxes},
    world_index::Trees,
};

use crate::geometry::Aabb;
use boxes::Box32;

/// Method by which a world finds its polygons.
#[derive(Clone, Debug)]
pub enum IndexKind {
    /// No index: every cluster of every object is tested.
    None,
    /// Spatial-kD tree of objects over one tree per mesh, in the mesh's own frame and shared by its instances.
    #[doc(hidden)]
    TwoLevel(Params),
    /// An index of polygons, also one of your own ([`SpatialIndex`]). The world rebuilds it over its polygons.
    #[doc(hidden)]
    Polygons(Box<dyn SpatialIndex>),
}

impl Default for IndexKind {
    fn default() -> Self {
        Self::TwoLevel(Params::default())
    }
}

/// The split axis of a spatial-kD tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SplitAxis {
    /// The axis along which centroids spread most.
    #[default]
    Longest,
    /// x, y(, z), x, ...
    Alternating,
}

/// Tuning parameters. The default holds the best values of `presight index --sweep` for trees (benches/RESULTS.md).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Minimum size of a cell, metres.
    pub min_cell: f64,
    /// Maximum number of polygons per cell; a cell with more is split.
    pub cell_polygons: usize,
    /// For spatial-kD trees.
    pub split_axis: SplitAxis,
    /// If true, tests each polygon in cells that are partly in the region; if false, such cells are returned whole.
    pub filter: bool,
}

impl Default for Params {
    fn default() -> Self {
        Self { min_cell: 0.0, cell_polygons: 64, split_axis: SplitAxis::Longest, filter: true }
    }
}

/// The result of a query, with scratch memory that is reused between queries.
#[derive(Clone, Debug, Default)]
pub struct QueryResult {
    /// Ids found, each once, in no particular order.
    pub ids: Vec<u32>,
    /// Further ids found, as contiguous ranges: whole nodes of meshes, stored in this order.
    pub runs: Vec<std::ops::Range<u32>>,
    /// Number of nodes or cells visited.
    pub visited: usize,
    /// Number of polygon boxes tested.
    pub tested: usize,
    stack: Vec<(u32, Box32)>,
    /// Result for the tree of objects, in two-level indexes.
    near: Option<Box<QueryResult>>,
}

impl QueryResult {
    /// Clears the result and keeps its memory.
    pub fn clear(&mut self) {
        self.ids.clear();
        self.runs.clear();
        (self.visited, self.tested) = (0, 0);
    }

    /// Number of ids found.
    pub fn count(&self) -> usize {
        self.ids.len() + self.runs.iter().map(ExactSizeIterator::len).sum::<usize>()
    }

    /// Every id found.
    pub fn all(&self) -> impl Iterator<Item = u32> + '_ {
        self.ids.iter().copied().chain(self.runs.iter().cloned().flatten())
    }
}

/// An index over ids (slots of polygons, or objects) with boxes in the world, metres.
///
/// ```
/// use presight::environment::{Environment, IndexKind};
/// use presight::{Pose, World};
/// use presight_model::geometry::Aabb;
/// use presight_model::index::{QueryResult, Region, SpatialIndex};
/// use std::collections::BTreeMap;
///
/// /// Tests every box.
/// #[derive(Clone, Debug, Default)]
/// struct Everything(BTreeMap<u32, Aabb>);
///
/// impl SpatialIndex for Everything {
///     fn name(&self) -> &'static str { "everything" }
///     fn rebuilt(&self, boxes: &[(u32, Aabb)]) -> Box<dyn SpatialIndex> {
///         Box::new(Self(boxes.iter().copied().collect()))
///     }
///     fn boxed_clone(&self) -> Box<dyn SpatialIndex> { Box::new(self.clone()) }
///     fn len(&self) -> usize { self.0.len() }
///     fn bytes(&self) -> usize { self.0.len() * size_of::<(u32, Aabb)>() }
///     fn bounds_of(&self, id: u32) -> Option<Aabb> { self.0.get(&id).copied() }
///     fn insert(&mut self, id: u32, bounds: &Aabb) { self.0.insert(id, *bounds); }
///     fn remove(&mut self, id: u32) -> bool { self.0.remove(&id).is_some() }
///     fn query(&self, region: &Region, found: &mut QueryResult) {
///         found.ids.extend(self.0.iter().filter(|(_, b)| region.meets(b)).map(|(id, _)| id));
///     }
///     fn assert_well_formed(&self) {}
/// }
///
/// let mut environment = Environment::new();
/// environment.add_cuboid("crate", Pose::IDENTITY, glam::DVec3::ONE)?;
/// // `SceneOptions::with_index` takes the kind for scenes from files.
/// let kind = IndexKind::Polygons(Box::new(Everything::default()));
/// let world = World::with_index(environment, &kind);
/// let mut found = QueryResult::default();
/// world.index().query(world.environment(), &Region::everything(), &mut found);
/// assert_eq!(found.count(), 6);
/// # Ok::<(), presight::Error>(())
/// ```
pub trait SpatialIndex: std::fmt::Debug + Send + Sync {
    /// The name in statistics.
    fn name(&self) -> &'static str;

    /// A new index of this kind, with the same parameters, over these ids.
    fn rebuilt(&self, boxes: &[(u32, Aabb)]) -> Box<dyn SpatialIndex>;

    /// Number of ids.
    fn len(&self) -> usize;

    /// True if there are no ids.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The stored box of an id, which contains the box that was inserted.
    fn bounds_of(&self, id: u32) -> Option<Aabb>;

    /// Adds an id, or moves it if present. Boxes must be finite and not empty.
    fn insert(&mut self, id: u32, bounds: &Aabb);

    /// Removes an id; returns false if it was not present.
    fn remove(&mut self, id: u32) -> bool;

    /// Appends to `found` every id whose box meets the region, with few others.
    fn query(&self, region: &Region, found: &mut QueryResult);

    /// Memory in bytes.
    fn bytes(&self) -> usize;

    /// A boxed clone.
    fn boxed_clone(&self) -> Box<dyn SpatialIndex>;

    /// Checks the invariants between its parts.
    ///
    /// # Panics
    /// If one is violated, which is a bug.
    fn assert_well_formed(&self);
}

impl Clone for Box<dyn SpatialIndex> {
    fn clone(&self) -> Self {
        self.boxed_clone()
    }
}

/// The traversal of an index for a query, compiled for each shape of regions and for the vector width of this machine.
pub trait Traversal: Sized {
    /// Appends the ids whose box meets the region, which has this shape. Implement it with `#[inline(always)]`.
    fn walk<S: Shape>(&self, shape: &S, region: &Region, found: &mut QueryResult);

    /// [`SpatialIndex::query`] by [`Traversal::walk`].
    fn traverse(&self, region: &Region, found: &mut QueryResult) {
        struct IndexQuery<'a, T>(&'a T, &'a Region, &'a mut QueryResult);
        struct ShapeQuery<'a, T, S>(IndexQuery<'a, T>, &'a S);
        impl<T: Traversal> region::ShapeVisitor for IndexQuery<'_, T> {
            type Out = ();

            fn visit<S: Shape>(self, shape: &S) {
                pulp::Arch::new().dispatch(ShapeQuery(self, shape));
            }
        }
        impl<T: Traversal, S: Shape> pulp::WithSimd for ShapeQuery<'_, T, S> {
            type Output = ();

            #[inline(always)]
            fn with_simd<D: pulp::Simd>(self, _: D) {
                let Self(IndexQuery(index, region, found), shape) = self;
                index.walk(shape, region, found);
            }
        }
        region.with(IndexQuery(self, region, found));
    }
}
