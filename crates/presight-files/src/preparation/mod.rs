//! Making environments: triangles of a file welded, checked and merged into convex polygons, and what was found
//! on the way; solids from parameters.

mod edges;
mod frame;
mod merge;
pub mod primitives;
mod quality;
mod report;
mod triangles;

pub use edges::Edges;
pub use frame::Z_UP_FROM_Y_UP;
pub use frame::{SceneFrame, Up};
pub use merge::MERGED_CORNERS;
pub use merge::{merge, unmerged};
pub use report::{ImportReport, ImportedScene, Problem, ProblemKind, lost_features};
pub use report::{ProblemBook, ProblemList, Site};
pub use triangles::place_of;
pub use triangles::{Triangle, TriangleMesh, Welder};
