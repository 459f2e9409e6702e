//! What takes a change back exactly, numbers and slots included: for groups of changes that fail halfway.
//!
//! [`crate::Change`]s undo content and give what comes back new numbers; a group that failed must leave no trace at all.

use super::{Environment, Feature};
use crate::geometry::Pose;
use std::sync::Arc;

/// How one step of a change is taken back. Steps are reverted newest first, so that each meets what it left.
#[derive(Clone, Debug)]
pub(crate) enum Revert {
    /// The object added last is removed; a group of its path gets its frame back.
    Insert { frame: Option<Pose> },
    /// An object stands where it stood.
    Pose { object: u32, world_from_object: Pose },
    /// A deleted object has its polygons and its name again.
    Delete { object: u32, mesh: Arc<super::Mesh> },
    /// A group has the frame that it had.
    Frame { path: String, frame: Option<Pose> },
    /// The material added last is removed.
    Material,
    /// A feature is removed, and its id is as used or unused as before.
    InsertFeature { class: String, id: u32, retired: bool },
    /// A feature is what it was.
    SetFeature { class: String, feature: Feature },
    /// A deleted feature is back.
    DeleteFeature { class: String, feature: Feature },
    /// A layer has the tolerance that it had.
    Tolerance { class: String, tolerance: f64 },
    /// The pose of an object has the covariance that it had, if any, in its place among the others.
    PoseCovariance { class: String, object: String, before: Option<(usize, [[f64; 6]; 6])> },
    /// A layer that was made on the way is removed.
    NewLayer { class: String },
}

impl Environment {
    /// Takes one step back.
    pub(crate) fn revert(&mut self, step: Revert) {
        match step {
            Revert::Insert { frame } => {
                if let Some(object) = self.objects.pop() {
                    self.names.remove(&object.name);
                    self.next_slot = object.first_slot;
                    self.groups.extend(frame.map(|frame| (object.name, frame)));
                }
            }
            Revert::Pose { object, world_from_object } => {
                self.objects[object as usize].world_from_object = world_from_object;
            }
            Revert::Delete { object, mesh } => {
                let restored = &mut self.objects[object as usize];
                (restored.mesh, restored.deleted) = (mesh, false);
                self.names.insert(restored.name.clone(), object);
            }
            Revert::Frame { path, frame: Some(frame) } => {
                self.groups.insert(path, frame);
            }
            Revert::Frame { path, frame: None } => {
                self.groups.remove(&path);
            }
            Revert::Material => {
                self.materials.pop();
            }
            other => self.revert_in_layer(other),
        }
    }

    fn revert_in_layer(&mut self, step: Revert) {
        let class = match &step {
            Revert::InsertFeature { class, .. }
            | Revert::SetFeature { class, .. }
            | Revert::DeleteFeature { class, .. }
            | Revert::Tolerance { class, .. }
            | Revert::PoseCovariance { class, .. }
            | Revert::NewLayer { class } => class,
            _ => return,
        };
        let Ok(at) = self.layers.binary_search_by(|l| l.class.as_str().cmp(class)) else { return };
        let layer = &mut self.layers[at];
        match step {
            Revert::InsertFeature { class, id, retired } => {
                layer.features.retain(|f| f.id != id);
                if retired {
                    self.retire(&class, id);
                }
            }
            Revert::SetFeature { feature, .. } => {
                layer.features.iter_mut().filter(|f| f.id == feature.id).for_each(|f| *f = feature.clone());
            }
            Revert::DeleteFeature { class, feature } => {
                let place = layer.features.partition_point(|f| f.id < feature.id);
                if let Some(ids) = self.retired.get_mut(&class) {
                    ids.remove(&feature.id);
                }
                self.layers[at].features.insert(place, feature);
            }
            Revert::Tolerance { tolerance, .. } => layer.tolerance = tolerance,
            Revert::PoseCovariance { object, before, .. } => {
                layer.pose_covariances.retain(|(path, _)| *path != object);
                if let Some((place, covariance)) = before {
                    layer.pose_covariances.insert(place, (object, covariance));
                }
            }
            _ => drop(self.layers.remove(at)),
        }
    }
}
