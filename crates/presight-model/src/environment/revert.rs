//! Takes a change back exactly, including numbers and slots, when a group of changes fails halfway.
//!
//! [`crate::Change`]s only undo content, and restored objects get new numbers. A failed group must leave no trace.

use super::{Environment, Existence, Feature, Mark};
use crate::geometry::{InObject, Pose, PoseCovariance};
use std::sync::Arc;

/// Takes back one step of a change. Steps are reverted newest first, so that each finds the state that it left.
#[derive(Clone, Debug)]
pub(crate) enum Revert {
    /// Removes the object that was added last; a group at its path gets its frame back.
    Insert { frame: Option<Pose> },
    /// Restores the pose of an object.
    Pose { object: u32, world_from_object: Pose },
    /// Restores a deleted object's polygons and name.
    Delete { object: u32, mesh: Arc<super::Mesh> },
    /// Restores the frame of a group.
    Frame { path: String, frame: Option<Pose> },
    /// Removes the material that was added last.
    Material,
    /// Removes a feature and restores whether its id was retired.
    InsertFeature { class: String, id: u32, retired: bool },
    /// Restores the previous feature with this id.
    SetFeature { class: String, feature: Feature },
    /// Restores a deleted feature.
    DeleteFeature { class: String, feature: Feature },
    /// Restores the tolerance of a layer.
    Tolerance { class: String, tolerance: f64 },
    /// Restores the covariance of an object's pose, if it had one, at its position in the list.
    PoseCovariance { class: String, object: String, before: Option<(usize, PoseCovariance<InObject>)> },
    /// Restores the mark that had this name, if any.
    Mark { name: String, before: Option<Mark> },
    /// Restores the trust in an object, if any.
    Trust { object: String, before: Option<Existence> },
    /// Removes a layer that the change created.
    NewLayer { class: String },
}

impl Environment {
    /// Reverts one step.
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
            Revert::Mark { name, before } => self.restore_mark(name, before),
            Revert::Trust { object, before } => self.restore_trust(object, before),
            other => self.revert_in_layer(other),
        }
    }

    fn revert_in_layer(&mut self, step: Revert) {
        match step {
            Revert::InsertFeature { class, id, retired } => {
                self.take_feature(&class, id);
                if retired {
                    self.retire(&class, id);
                }
            }
            Revert::SetFeature { class, feature } => drop(self.put_feature(&class, feature)),
            Revert::DeleteFeature { class, feature } => {
                self.unretire(&class, feature.id);
                self.put_feature(&class, feature);
            }
            Revert::Tolerance { class, tolerance } => {
                self.layers.iter_mut().filter(|l| l.class == class).for_each(|l| l.tolerance = tolerance);
            }
            Revert::PoseCovariance { class, object, before } => self.restore_covariance(&class, object, before),
            Revert::NewLayer { class } => {
                self.layers.retain(|l| l.class != class);
                if let Some(open) = &mut self.open {
                    open.remove(&class);
                }
            }
            _ => {}
        }
    }

    fn restore_covariance(&mut self, class: &str, object: String, before: Option<(usize, PoseCovariance<InObject>)>) {
        if let Some(open) = &mut self.open {
            if let Some(layer) = open.get_mut(class) {
                layer.restore_covariance(object, before);
            }
        } else if let Some(layer) = self.layers.iter_mut().find(|l| l.class == class) {
            layer.pose_covariances.retain(|(path, _)| *path != object);
            if let Some((place, covariance)) = before {
                layer.pose_covariances.insert(place, (object, covariance));
            }
        }
    }
}
