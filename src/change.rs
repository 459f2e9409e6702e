//! Changes of an environment: what [`crate::World::apply`] does, and what undoes it.

use crate::environment::{Feature, Material, NewObject};
use crate::geometry::Pose;

/// One change. [`crate::World::apply`] answers with the change that undoes it.
///
/// Objects and groups are meant by their full path, features by sensor class and id. A number is never used again: an object that
/// comes back gets new slots, and so new polygon ids; a feature that comes back ([`Change::RestoreFeature`]) is the same
/// feature and keeps its id.
#[derive(Clone, Debug)]
pub enum Change {
    /// Adds a material, for meshes to come. Nothing undoes it: a material that no polygon has is no content.
    AddMaterial(Material),
    /// Adds an object. A group of its path gives way: what is below then hangs on the object.
    InsertObject(NewObject),
    /// Gives an object or a group another pose; what is below its path (`cart/wheel` of `cart`) moves with it, rigidly.
    MoveObject {
        /// Full path of the object, or a path that objects are below.
        name: String,
        /// The new pose; of a group, that of its frame ([`crate::Environment::frame`]).
        world_from_object: Pose,
    },
    /// Gives this one object another pose. A group is nothing without what is below it: it is moved.
    SetPose {
        /// Its full path.
        name: String,
        /// The new pose.
        world_from_object: Pose,
    },
    /// Takes an object out, with the features and pose covariances given in its frame. Its number and its slots are
    /// never used again. Objects below its path stay; the path is then a group, its frame the object's last pose. Of a group
    /// everything below is deleted.
    DeleteObject {
        /// Its full path.
        name: String,
    },
    /// Gives a group another frame, or none of its own; what is below stays where it is.
    SetGroup {
        /// Its full path; no object may have it.
        name: String,
        /// See [`crate::Environment::set_group`].
        world_from_group: Option<Pose>,
    },
    /// Adds a feature, under an id that was never used for its class.
    InsertFeature {
        /// Sensor class.
        class: String,
        /// The feature.
        feature: Feature,
    },
    /// Brings a deleted feature back under its id: what undoes its deletion.
    RestoreFeature {
        /// Sensor class.
        class: String,
        /// The feature.
        feature: Feature,
    },
    /// Puts another feature in the place of the one with its id.
    SetFeature {
        /// Sensor class.
        class: String,
        /// The feature.
        feature: Feature,
    },
    /// Takes a feature out.
    DeleteFeature {
        /// Sensor class.
        class: String,
        /// Its id.
        id: u32,
    },
    /// Gives a layer another tolerance; the layer is made if there is none.
    SetTolerance {
        /// Sensor class.
        class: String,
        /// How far features may be off their polygons, metres.
        tolerance: f64,
    },
    /// Gives the pose of an object another covariance, or none.
    SetPoseCovariance {
        /// Sensor class of the layer.
        class: String,
        /// Path of the object.
        object: String,
        /// See [`crate::environment::FeatureLayer::pose_covariances`].
        covariance: Option<[[f64; 6]; 6]>,
    },
    /// All of them, or none.
    Group(Vec<Change>),
}

impl Change {
    /// Does nothing.
    pub const NOTHING: Self = Self::Group(Vec::new());

    /// One change of many.
    pub(crate) fn of(mut changes: Vec<Change>) -> Self {
        match changes.len() {
            1 => changes.remove(0),
            _ => Self::Group(changes),
        }
    }
}
