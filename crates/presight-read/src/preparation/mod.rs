//! Preparation of environments: welds, checks and merges the triangles of a file into convex polygons, and reports
//! problems. Also makes solids from parameters.

mod edges;
mod frame;
mod from_arrays;
mod merge;
pub mod primitives;
mod quality;
mod report;
mod triangles;

pub(crate) use edges::Edges;
pub use frame::Z_UP_FROM_Y_UP;
pub use frame::{SceneFrame, Up};
pub use from_arrays::mesh_of_triangles;
pub(crate) use merge::{merge, unmerged};
pub use report::{ImportReport, ImportedScene, Problem, ProblemKind, lost_features};
pub(crate) use report::{ProblemBook, ProblemList, Site};
pub(crate) use triangles::{Triangle, TriangleMesh, Welder, place_of};
