//! Spatial indexes over the world's polygons (paper section 2.2). They find the polygons that have a point in a region.
//!
//! | scheme | cells | a polygon is in | source |
//! |---|---|---|---|
//! | [`Scheme::Grid`] | equal squares | every cell it overlaps | paper section 2.2 |
//! | [`Scheme::Plop`] | slices of each axis at quantiles | the cell of its centroid | Kriegel and Seeger 1988 |
//! | [`Scheme::S2d`], [`Scheme::S3d`] | halves of halves | the leaf of its centroid | Ooi, Sacks-Davis, McDonell 1987/1991 |
//! | [`Scheme::TwoLevel`] | a spatial-kD tree of objects over trees of their meshes | its mesh | here |
//!
//! The first four are [`SpatialIndex`]es over ids with boxes. [`WorldIndex`] keeps one in step with an environment.

mod boxes;
mod cells;
mod exact;
mod grid;
mod mesh_tree;
mod plop;
mod region;
mod sector;
mod shapes;
mod skd;
#[cfg(test)]
mod tests;
mod world_index;

pub use exact::polygon_meets;
pub use grid::Grid;
pub use plop::Plop;
pub use region::Region;
pub use sector::{Rect, Sector};
pub use skd::Skd;
pub use world_index::{ObjectRun, WorldIndex};
pub use {
    mesh_tree::{MeshTree, PolygonBoxes},
    world_index::Trees,
};

use crate::error::{Error, Result};
use crate::geometry::Aabb;
use boxes::Box32;
use shapes::Shape;

/// A method to find polygons.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Scheme {
    /// No index: every cluster of every object is tested.
    None,
    /// Uniform grid of square cells.
    Grid,
    /// Piecewise linear order preserving hashing.
    Plop,
    /// Spatial-kD tree over x and y.
    S2d,
    /// Spatial-kD tree over x, y and z.
    S3d,
    /// Spatial-kD tree of objects over one tree per mesh, in the mesh's own frame and shared by its instances.
    #[default]
    TwoLevel,
}

impl Scheme {
    /// Every scheme.
    pub const ALL: [Self; 6] = [Self::None, Self::Grid, Self::Plop, Self::S2d, Self::S3d, Self::TwoLevel];

    /// The name in flags and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Grid => "grid",
            Self::Plop => "plop",
            Self::S2d => "s2d",
            Self::S3d => "s3d",
            Self::TwoLevel => "two-level",
        }
    }
}

impl std::str::FromStr for Scheme {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let names = Self::ALL.map(Self::name).join(", ");
        let found = Self::ALL.into_iter().find(|s| s.name() == name);
        found.ok_or_else(|| Error::usage(format!("unknown index {name:?}"), format!("choose from {names}")))
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

/// Tuning parameters. The default suits trees; [`Params::tuned`] returns the best values of `presight index --sweep`
/// for each scheme (benches/RESULTS.md).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Least size of a cell, metres.
    pub least_cell: f64,
    /// Most polygons per cell; a cell with more is split.
    pub cell_polygons: usize,
    /// For spatial-kD trees.
    pub split_axis: SplitAxis,
    /// If true, tests each polygon in cells that are partly in the region; if false, such cells are returned whole.
    pub filter: bool,
}

impl Default for Params {
    fn default() -> Self {
        Self { least_cell: 0.0, cell_polygons: 64, split_axis: SplitAxis::Longest, filter: true }
    }
}

impl Params {
    /// The best parameters for a scheme.
    pub fn tuned(scheme: Scheme) -> Self {
        let cell_polygons = match scheme {
            Scheme::Grid | Scheme::Plop => 32,
            Scheme::None | Scheme::S2d | Scheme::S3d | Scheme::TwoLevel => 64,
        };
        Self { cell_polygons, ..Self::default() }
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
    /// Epoch of the last query that met an id; the grid uses it to drop duplicates.
    seen: Vec<u32>,
    epoch: u32,
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
}

impl QueryResult {
    /// Number of ids found.
    pub fn count(&self) -> usize {
        self.ids.len() + self.runs.iter().map(ExactSizeIterator::len).sum::<usize>()
    }

    /// Every id found.
    pub fn all(&self) -> impl Iterator<Item = u32> + '_ {
        self.ids.iter().copied().chain(self.runs.iter().cloned().flatten())
    }
}

/// An index over ids (slots of polygons, or objects) with boxes in the world. Boxes are kept in f32, rounded outward.
pub trait SpatialIndex: std::fmt::Debug + Send + Sync {
    /// Number of ids.
    fn len(&self) -> usize;

    /// True if there are no ids.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The stored box of an id; contains the box that was inserted.
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

/// The traversal of an index for a query, compiled for each shape.
trait Traversal {
    fn walk<S: Shape>(&self, shape: &S, region: &Region, found: &mut QueryResult);
}

/// Traverses an index, compiled for the vector width of this machine.
fn ask<T: Traversal>(index: &T, region: &Region, found: &mut QueryResult) {
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
    region.with(IndexQuery(index, region, found));
}

/// An index over ids 0, 1, .. with these boxes; `None` for schemes that do not index polygons.
pub fn build(scheme: Scheme, params: Params, boxes: &[(u32, Aabb)]) -> Option<Box<dyn SpatialIndex>> {
    match scheme {
        Scheme::None | Scheme::TwoLevel => None,
        Scheme::Grid => Some(Box::new(Grid::build(params, boxes))),
        Scheme::Plop => Some(Box::new(Plop::build(params, boxes))),
        Scheme::S2d => Some(Box::new(Skd::<2>::build(params, boxes))),
        Scheme::S3d => Some(Box::new(Skd::<3>::build(params, boxes))),
    }
}
