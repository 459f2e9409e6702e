//! What takes a change back exactly, numbers and slots included: for groups of changes that fail halfway.
//!
//! [`crate::Change`]s undo content and give what comes back new numbers; a group that failed must leave no trace at all.

use super::{Environment, Feature};
use crate::geometry::Pose;
use std::sync::Arc;

/// How one step of a change is taken back. Steps are reverted newest first, so that each meets what it left.
#[derive(Clone, Debug)]
pub enum Revert {
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

    fn restore_covariance(&mut self, class: &str, object: String, before: Option<(usize, [[f64; 6]; 6])>) {
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
