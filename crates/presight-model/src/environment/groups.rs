//! Groups: paths that have objects below them and are not objects, such as `hall/line 1` above `hall/line 1/press`.
//! Each has a frame, so that it can be moved with everything below it.

use super::{Environment, check_pose};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::limits;
use std::collections::BTreeMap;

/// The entries below a path: entries whose key starts with it and a slash.
pub(super) fn below<'a, T>(
    all: &'a BTreeMap<String, T>,
    path: &str,
) -> impl Iterator<Item = (&'a String, &'a T)> + use<'a, T> {
    let prefix = format!("{path}/");
    let from = all.range(prefix.clone()..);
    from.take_while(move |(name, _)| name.starts_with(&prefix))
}

/// The parent path.
fn above(path: &str) -> Option<&str> {
    path.rsplit_once('/').map(|(above, _)| above)
}

impl Environment {
    /// All groups with their frames, `world_from_group`.
    ///
    /// ```
    /// use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
    /// use presight::Pose;
    /// let mut environment = Environment::new();
    /// let paint = environment.add_material(Material::named("paint"))?;
    /// let corners = [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y].to_vec();
    /// let mesh = Mesh::new("sign", corners, vec![Polygon::new(vec![0, 1, 2], paint)], PolygonOrder::Given)?;
    /// environment.insert(NewObject::new("hall/door/sign", Pose::IDENTITY, mesh.into()))?;
    /// let door = Pose::from_xyz_rpy(glam::DVec3::X, 0.0, 0.0, 0.0);
    /// environment.set_frame("hall/door", Some(door))?;
    /// assert_eq!(environment.groups(), [("hall", Pose::IDENTITY), ("hall/door", door)].into());
    /// # Ok::<(), presight::Error>(())
    /// ```
    pub fn groups(&self) -> BTreeMap<&str, Pose> {
        let mut found = BTreeMap::new();
        let mut last = "";
        for name in self.names.keys() {
            // Names are sorted, so `found` already has the paths shared with the previous name.
            let shared = last.bytes().zip(name.bytes()).take_while(|(a, b)| a == b).count();
            for (at, _) in name.match_indices('/').filter(|(at, _)| *at >= shared) {
                let path = &name[..at];
                if !path.is_empty() && !self.names.contains_key(path) {
                    let known = above(path).and_then(|above| found.get(above)).copied();
                    let inherited = || known.unwrap_or_else(|| self.frame_at(path));
                    let frame = self.groups.get(path).copied().unwrap_or_else(inherited);
                    found.insert(path, frame);
                }
            }
            last = name;
        }
        found
    }

    /// The frame of a path, `world_from_path`: the pose of its object, or the frame of a group. A group without its own
    /// frame inherits the nearest one above, or the world's. Returns `None` if there is no object at or below the path.
    pub fn frame(&self, path: &str) -> Option<Pose> {
        let there = self.object(path).is_some() || (!path.is_empty() && self.has_below(path));
        there.then(|| self.frame_at(path))
    }

    fn frame_at(&self, path: &str) -> Pose {
        let of = |path: &str| {
            let object = || self.object(path).map(|o| o.world_from_object);
            self.groups.get(path).copied().or_else(object)
        };
        std::iter::successors(Some(path), |path| above(path)).find_map(of).unwrap_or_default()
    }

    /// The frame of a path.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if there is no object at or below the path.
    pub fn frame_of(&self, path: &str) -> Result<Pose> {
        self.frame(path).ok_or_else(|| {
            let what = format!("there is no object {path:?}, and no object below it");
            Error::invalid(what, self.objects_remedy(path))
        })
    }

    /// Sets or removes the frame of a group, and returns the previous one. Objects below keep their poses
    /// ([`crate::Change::MoveObject`] moves them). A frame may be set before there are objects below; until then it is
    /// not content.
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the path belongs to an object, is empty or too long, or the pose is invalid.
    pub fn set_frame(&mut self, path: &str, world_from_group: Option<Pose>) -> Result<Option<Pose>> {
        let place = || format!("group {path:?}");
        let Some(pose) = world_from_group else {
            self.give_up(path);
            return Ok(self.groups.remove(path));
        };
        check_pose(&pose).map_err(|e| e.at(place()))?;
        if self.names.contains_key(path) {
            return Err(Error::invalid("this path is an object", "move the object").at(place()));
        }
        if path.is_empty() || path.len() > limits::MAX_NAME_BYTES {
            let what = format!("the path has {} bytes", path.len());
            return Err(Error::invalid(what, format!("give 1 to {}", limits::MAX_NAME_BYTES)).at(place()));
        }
        Ok(self.keep_frame(path.to_owned(), pose))
    }

    /// [`Environment::set_frame`] for a path with objects below and a pose that is already checked.
    pub(crate) fn keep_frame(&mut self, path: String, world_from_group: Pose) -> Option<Pose> {
        self.groups.insert(path, world_from_group)
    }

    /// The frame that was set for a group.
    pub fn group(&self, path: &str) -> Option<&Pose> {
        self.groups.get(path)
    }

    /// All frames that were set for groups, including groups without objects below.
    pub fn given_groups(&self) -> impl Iterator<Item = (&str, &Pose)> {
        self.groups.iter().map(|(path, pose)| (path.as_str(), pose))
    }

    /// The frames that were set for groups with objects below. These are content.
    pub fn framed_groups(&self) -> impl Iterator<Item = (&str, &Pose)> {
        self.given_groups().filter(|(path, _)| self.has_below(path))
    }

    /// The groups below a path for which a frame was set.
    pub(crate) fn groups_below<'a>(&'a self, path: &str) -> impl Iterator<Item = (&'a str, &'a Pose)> + use<'a> {
        below(&self.groups, path).map(|(path, pose)| (path.as_str(), pose))
    }

    /// True if an object is below a path.
    pub fn has_below(&self, path: &str) -> bool {
        below(&self.names, path).next().is_some()
    }

    /// Drops the frames of groups without objects below, and frames equal to the inherited one: in models half of all
    /// nodes have the same frame as their parent.
    pub fn settle_groups(&mut self) {
        // Parents come first.
        for (path, pose) in std::mem::take(&mut self.groups) {
            let inherited = above(&path).map_or(Pose::IDENTITY, |above| self.frame_at(above));
            if inherited != pose && self.has_below(&path) {
                self.groups.insert(path, pose);
            } else {
                self.give_up(&path);
            }
        }
    }

    /// Restores frames whose poses are already checked.
    ///
    /// # Errors
    /// As [`Environment::set_frame`].
    pub fn restore_groups(&mut self, groups: Vec<(String, Pose)>) -> Result<()> {
        match groups.iter().find(|(path, _)| self.names.contains_key(path)) {
            Some((path, pose)) => self.set_frame(path, Some(*pose)).map(drop),
            None => {
                // The entries are sorted, so one pass builds the map.
                self.groups = groups.into_iter().collect();
                self.next_numbers.0.clear();
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Material, Mesh, NewObject, Polygon, PolygonOrder};
    use super::*;
    use glam::{DVec3, Vec3};

    fn at(x: f64) -> Pose {
        Pose::from_xyz_rpy(DVec3::new(x, 0.0, 0.0), 0.0, 0.0, 0.1)
    }

    fn environment(names: &[&str]) -> Environment {
        let mut environment = Environment::new();
        environment.add_material(Material::named("m")).unwrap();
        let polygons = vec![Polygon::new(vec![0, 1, 2], 0)];
        let corners = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
        let mesh = std::sync::Arc::new(Mesh::new("t", corners, polygons, PolygonOrder::Spatial).unwrap());
        for (name, x) in names.iter().zip(1..) {
            environment.insert(NewObject::new(*name, at(f64::from(x)), mesh.clone())).unwrap();
        }
        environment
    }

    #[test]
    fn each_path_above_objects_is_a_group_once() {
        let e = environment(&["a/b/c", "a/b/d", "a b/c", "a/b.c", "x", "x/y/z", "x/y/w", "/odd", "end/"]);
        assert_eq!(e.groups().into_keys().collect::<Vec<_>>(), ["a", "a b", "a/b", "end", "x/y"]);
    }

    #[test]
    fn a_frame_is_given_or_that_of_what_is_above() {
        let mut e = environment(&["a/b/c/d", "x", "x/y/z"]);
        assert_eq!(e.frame("a/b"), Some(Pose::IDENTITY));
        assert_eq!(e.set_frame("a", Some(at(7.0))).unwrap(), None);
        assert_eq!(e.frame("a/b/c"), Some(at(7.0)));
        assert_eq!(e.frame("x/y"), Some(at(2.0)), "that of the object above");
        assert_eq!(e.frame("x"), Some(at(2.0)));
        assert_eq!((e.frame("a/b/c/d/e"), e.frame("a/"), e.frame("")), (None, None, None));
        assert_eq!(environment(&["/odd"]).frame(""), None);
        let all = e.groups();
        assert!(["a", "a/b", "a/b/c"].iter().all(|path| all[path] == at(7.0)) && all["x/y"] == at(2.0), "{all:?}");
        assert_eq!(e.set_frame("a", None).unwrap(), Some(at(7.0)));
        assert_eq!(e.frame("a/b/c"), Some(Pose::IDENTITY));
    }

    #[test]
    fn a_path_is_an_object_or_a_group() {
        let mut e = environment(&["a", "a/b"]);
        let far = Pose { translation: DVec3::splat(1e13), ..Pose::IDENTITY };
        for (path, pose) in [("a", at(1.0)), ("", at(1.0)), ("g", far)] {
            let refused = e.set_frame(path, Some(pose)).unwrap_err();
            assert!(!refused.remedy().is_empty() && refused.place() == Some(&format!("group {path:?}")), "{refused}");
        }
        e.set_frame("g", Some(at(1.0))).unwrap();
        e.set_frame("a#2", Some(at(1.0))).unwrap();
        let mesh = e.objects()[0].mesh.clone();
        e.insert(NewObject::new("g", at(2.0), mesh.clone())).unwrap();
        assert!(e.group("g").is_none(), "the object takes its place");
        e.insert(NewObject::new("a", at(2.0), mesh)).unwrap();
        assert!(e.object("a#3").is_some() && e.group("a#2").is_some(), "a number does not");
        e.settle_groups();
        assert!(e.group("a#2").is_none());
    }

    #[test]
    fn what_the_path_above_gives_need_not_be_kept() {
        let mut e = environment(&["a/b/c/d", "x", "x/y/z", "w/v"]);
        let frames = [("a", 1.0), ("a/b", 1.0), ("a/b/c", 2.0), ("x/y", 2.0), ("w", 0.5), ("nothing", 1.0)];
        for (path, x) in frames {
            e.set_frame(path, Some(at(x))).unwrap();
        }
        e.set_frame("w", Some(Pose::IDENTITY)).unwrap();
        let before: Vec<_> = e.groups().into_iter().map(|(path, pose)| (path.to_owned(), pose)).collect();
        e.settle_groups();
        assert_eq!(e.framed_groups().map(|(path, _)| path).collect::<Vec<_>>(), ["a", "a/b/c"]);
        let after: Vec<_> = e.groups().into_iter().map(|(path, pose)| (path.to_owned(), pose)).collect();
        assert_eq!(after, before, "all stand where they stood");
    }
}
