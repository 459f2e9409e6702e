//! Changes of an environment, applied by [`crate::World::apply`], and their inverses.

use crate::environment::{Existence, Feature, Mark, Material, NewObject};
use crate::geometry::{InObject, Pose, PoseCovariance};

/// A change of an environment. [`crate::World::apply`] applies it and returns its inverse.
///
/// Objects and groups are named by their full path, features by sensor class and id. Numbers are never reused: a
/// restored object gets new slots and polygon ids. A restored feature ([`Change::RestoreFeature`]) keeps its id.
#[derive(Clone, Debug)]
pub enum Change {
    /// Adds a material for later meshes. Its inverse does nothing, because an unused material is not content.
    AddMaterial(Material),
    /// Adds an object. It replaces a group at its path, and objects below that path then belong to it.
    InsertObject(NewObject),
    /// Sets the pose of an object or a group. Everything below its path (`cart/wheel` below `cart`) moves with it,
    /// rigidly.
    MoveObject {
        /// Full path of an object or a group.
        name: String,
        /// The new pose; for a group, the new frame ([`crate::Environment::frame`]).
        world_from_object: Pose,
    },
    /// Sets the pose of this object alone. A group moves with everything below it.
    SetPose {
        /// Its full path.
        name: String,
        /// The new pose.
        world_from_object: Pose,
    },
    /// Deletes an object, with the features and pose covariances in its frame, its marks and the trust in it. Its
    /// number and its slots are never reused. Objects below its path stay; the path becomes a group whose frame is the
    /// object's last pose. Deleting a group deletes everything below it.
    DeleteObject {
        /// Its full path.
        name: String,
    },
    /// Sets or removes the frame of a group. Objects below keep their poses.
    SetFrame {
        /// Its full path; no object may have it.
        name: String,
        /// See [`crate::Environment::set_frame`].
        world_from_group: Option<Pose>,
    },
    /// Adds a feature with an id that was never used for its class.
    InsertFeature {
        /// Sensor class.
        class: String,
        /// The feature.
        feature: Feature,
    },
    /// Restores a deleted feature with its id: the inverse of its deletion.
    RestoreFeature {
        /// Sensor class.
        class: String,
        /// The feature.
        feature: Feature,
    },
    /// Replaces the feature with the same id.
    SetFeature {
        /// Sensor class.
        class: String,
        /// The feature.
        feature: Feature,
    },
    /// Deletes a feature.
    DeleteFeature {
        /// Sensor class.
        class: String,
        /// Its id.
        id: u32,
    },
    /// Sets the tolerance of a layer, which is created if it does not exist.
    SetTolerance {
        /// Sensor class.
        class: String,
        /// Allowed distance of features from their polygons, metres.
        tolerance: f64,
    },
    /// Sets or removes the covariance of an object's pose.
    SetPoseCovariance {
        /// Sensor class of the layer.
        class: String,
        /// Path of the object.
        object: String,
        /// See [`crate::environment::FeatureLayer::pose_covariances`].
        covariance: Option<PoseCovariance<InObject>>,
    },
    /// Sets a mark; it replaces a mark of the same name.
    SetMark {
        /// Name of the mark.
        name: String,
        /// The mark.
        mark: Mark,
    },
    /// Removes a mark.
    RemoveMark {
        /// Name of the mark.
        name: String,
    },
    /// Sets or removes the trust in an object.
    SetTrust {
        /// Full path of the object.
        object: String,
        /// Probability that it exists, last confirmation and decay.
        trust: Option<Existence>,
    },
    /// Applies all of these changes, or none.
    Group(Vec<Change>),
}

impl Change {
    /// Does nothing.
    pub const NOTHING: Self = Self::Group(Vec::new());

    /// A single change, or a group of several.
    pub fn of(mut changes: Vec<Change>) -> Self {
        match changes.len() {
            1 => changes.remove(0),
            _ => Self::Group(changes),
        }
    }
}
