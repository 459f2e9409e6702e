//! Edits of the store that changes consist of.

use crate::decide::shapes::LibraryShape;
use presight_model::change::Change;
use presight_model::environment::{Mark, MarkKind};
use presight_model::geometry::{Aabb, Pose};
use presight_store::{Edit, EditPose, ShapeSource};

/// Sets the pose of an object.
pub(crate) fn set_pose(object: &str, pose: &Pose) -> Edit {
    Edit::from(Change::SetPose { name: object.to_owned(), world_from_object: *pose })
}

/// Inserts an object at a pose.
pub(crate) fn insert(object: &str, pose: &Pose, shape: ShapeSource) -> Edit {
    Edit::Insert { object: object.to_owned(), pose: EditPose::Free(*pose), shape }
}

/// The source of a library's shape.
pub(crate) fn source(shape: &LibraryShape) -> ShapeSource {
    match &shape.file {
        Some((path, object)) => ShapeSource::File { path: path.clone(), object: object.clone() },
        None => ShapeSource::Like(shape.name().to_owned()),
    }
}

/// Sets a mark on an object.
pub(crate) fn mark(name: String, object: &str, kind: MarkKind, class: Option<String>, bounds: Option<Aabb>) -> Edit {
    let mark = Mark { object: object.to_owned(), kind, class, bounds };
    Edit::from(Change::SetMark { name, mark })
}
