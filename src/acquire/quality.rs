//! What is wrong with the triangles of a mesh.

use super::{ProblemKind, ProblemList, Site, TriangleMesh};

impl TriangleMesh {
    /// All problems of the triangles.
    pub(crate) fn problems(&self) -> ProblemList {
        let mut list = ProblemList::default();
        for &triangle in &self.degenerate {
            list.add(ProblemKind::DegenerateTriangle, Site { triangle, edge: None });
        }
        list
    }
}
