//! Making environments: triangles of a file welded, checked and merged into convex polygons, and what was found
//! on the way.

mod quality;
mod report;
mod triangles;

pub use report::{ImportReport, Imported, Problem, ProblemKind};
pub(crate) use report::{ProblemBook, ProblemList, Site};
pub(crate) use triangles::place_of;
pub use triangles::{Triangle, TriangleMesh, Welder};
