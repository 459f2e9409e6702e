//! Changes of objects and of their groups.

use super::World;
use crate::change::Change;
use crate::environment::{Existence, Mark, NewObject, Revert, check_pose};
use crate::error::Result;
use crate::geometry::Pose;
use std::sync::Arc;

impl World {
    pub(super) fn insert_object(&mut self, new: NewObject) -> Result<Change> {
        let frame = self.environment.group(&new.name).copied();
        let environment = Arc::make_mut(&mut self.environment);
        let object = environment.insert(new)?;
        self.note(|_| Revert::Insert { frame });
        let environment = &*self.environment;
        Arc::make_mut(&mut self.index).insert_object(environment, object);
        let name = environment.objects()[object as usize].name.clone();
        let mut undo = vec![Change::DeleteObject { name: name.clone() }];
        if frame.is_some() || environment.has_below(&name) {
            // Deleting the object leaves its pose as the frame of the group: the undo restores the group's own frame.
            undo.push(Change::SetFrame { name, world_from_group: frame });
        }
        Ok(Change::of(undo))
    }

    pub(super) fn set_pose(&mut self, name: String, world_from_object: Pose) -> Result<Change> {
        if self.environment.object(&name).is_none() {
            return self.move_path(&name, world_from_object);
        }
        // Check before anything is copied.
        check_pose(&world_from_object).map_err(|e| e.at(format!("object {name:?}")))?;
        let environment = Arc::make_mut(&mut self.environment);
        let object = environment.index_of(&name)?;
        let before = environment.objects()[object as usize].world_from_object;
        environment.set_pose(&name, world_from_object)?;
        self.note(|_| Revert::Pose { object, world_from_object: before });
        let environment = &*self.environment;
        Arc::make_mut(&mut self.index).insert_object(environment, object);
        Ok(Change::SetPose { name, world_from_object: before })
    }

    pub(super) fn set_frame(&mut self, name: String, world_from_group: Option<Pose>) -> Result<Change> {
        let world_from_group = Arc::make_mut(&mut self.environment).set_frame(&name, world_from_group)?;
        self.note(|_| Revert::Frame { path: name.clone(), frame: world_from_group });
        Ok(Change::SetFrame { name, world_from_group })
    }

    /// Moves an object or a group, and everything below it, by one rigid motion.
    pub(super) fn move_path(&mut self, path: &str, world_from_path: Pose) -> Result<Change> {
        let environment = &self.environment;
        let new_from_old = world_from_path * environment.frame_of(path)?.inverse();
        let is_object = environment.object(path).is_some();
        let mut objects: Vec<(String, Pose)> = Vec::new();
        let mut groups: Vec<(String, Pose)> = Vec::new();
        // The path itself gets exactly the requested pose.
        if is_object { &mut objects } else { &mut groups }.push((path.to_owned(), world_from_path));
        for index in environment.below(path) {
            let below = &environment.objects()[index as usize];
            objects.push((below.name.clone(), new_from_old * below.world_from_object));
        }
        let below = environment.groups_below(path);
        groups.extend(below.map(|(path, pose)| (path.to_owned(), new_from_old * *pose)));
        for (kind, poses) in [("object", &objects), ("group", &groups)] {
            for (path, pose) in poses {
                check_pose(pose).map_err(|e| e.at(format!("{kind} {path:?}")))?;
            }
        }
        let mut undo = Vec::with_capacity(objects.len() + groups.len());
        for (name, pose) in objects {
            undo.push(self.set_pose(name, pose)?);
        }
        for (name, pose) in groups {
            let world_from_group = self.keep_frame(name.clone(), pose);
            undo.push(Change::SetFrame { name, world_from_group });
        }
        Ok(Change::of(undo))
    }

    /// Deletes an object alone, or a group with everything below it.
    pub(super) fn delete_path(&mut self, path: String) -> Result<Change> {
        if self.environment.object(&path).is_some() {
            return self.delete_object(path);
        }
        let environment = &self.environment;
        environment.frame_of(&path)?;
        let mut objects: Vec<String> =
            environment.below(&path).map(|index| environment.objects()[index as usize].name.clone()).collect();
        let mut groups: Vec<String> = environment.groups_below(&path).map(|(path, _)| path.to_owned()).collect();
        groups.push(path);
        let mut undo = Vec::with_capacity(groups.len() + objects.len());
        // Delete the objects below first, so that no path becomes a group before it is deleted.
        while let Some(name) = objects.pop() {
            undo.push(self.delete_object(name)?);
        }
        for name in groups.into_iter().filter(|name| self.environment.group(name).is_some()).collect::<Vec<_>>() {
            undo.push(self.set_frame(name, None)?);
        }
        undo.reverse();
        Ok(Change::of(undo))
    }

    fn delete_object(&mut self, name: String) -> Result<Change> {
        let object = self.environment.index_of(&name)?;
        let o = &self.environment.objects()[object as usize];
        let world_from_object = o.world_from_object;
        let mut undo = vec![Change::InsertObject(NewObject {
            name: o.name.clone(),
            world_from_object,
            object_from_mesh: o.object_from_mesh,
            mesh: o.mesh.clone(),
            first_source: o.first_source,
        })];
        let mesh = o.mesh.clone();
        for (class, covariance, ids) in self.environment.attached_to(&name) {
            for id in ids {
                undo.push(self.step_features(Change::DeleteFeature { class: class.clone(), id })?);
            }
            if covariance {
                let none = Change::SetPoseCovariance { class, object: name.clone(), covariance: None };
                undo.push(self.step_features(none)?);
            }
        }
        for mark in self.environment.marks_of(&name) {
            undo.push(self.remove_mark(mark)?);
        }
        if self.environment.trust(&name).is_some() {
            undo.push(self.set_trust(name.clone(), None)?);
        }
        let environment = Arc::make_mut(&mut self.environment);
        Arc::make_mut(&mut self.index).remove_object(environment, object);
        environment.delete(&name)?;
        self.note(|_| Revert::Delete { object, mesh });
        if self.environment.has_below(&name) {
            // Inserting the object again removes this frame.
            self.keep_frame(name, world_from_object);
        }
        Ok(Change::of(undo))
    }

    pub(super) fn set_mark(&mut self, name: String, mark: Mark) -> Result<Change> {
        let before = Arc::make_mut(&mut self.environment).set_mark(&name, mark)?;
        self.note(|_| Revert::Mark { name: name.clone(), before: before.clone() });
        Ok(match before {
            Some(mark) => Change::SetMark { name, mark },
            None => Change::RemoveMark { name },
        })
    }

    pub(super) fn remove_mark(&mut self, name: String) -> Result<Change> {
        let mark = Arc::make_mut(&mut self.environment).remove_mark(&name)?;
        self.note(|_| Revert::Mark { name: name.clone(), before: Some(mark.clone()) });
        Ok(Change::SetMark { name, mark })
    }

    pub(super) fn set_trust(&mut self, object: String, trust: Option<Existence>) -> Result<Change> {
        let trust_before = Arc::make_mut(&mut self.environment).set_trust(&object, trust)?;
        self.note(|_| Revert::Trust { object: object.clone(), before: trust_before });
        Ok(Change::SetTrust { object, trust: trust_before })
    }

    /// Sets the frame of a path to a checked pose; returns the previous frame.
    fn keep_frame(&mut self, path: String, pose: Pose) -> Option<Pose> {
        let before = Arc::make_mut(&mut self.environment).keep_frame(path.clone(), pose);
        self.note(|_| Revert::Frame { path, frame: before });
        before
    }
}
