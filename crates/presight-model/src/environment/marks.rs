//! Marks and trust: knowledge of objects in addition to their shape and pose.

use super::{Environment, Existence};
use crate::error::{Error, Result};
use crate::geometry::Aabb;
use crate::limits;
use glam::DVec3;
use std::collections::BTreeMap;

crate::words! {
    /// The statement of a mark.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum MarkKind {
        /// It may or may not be there. It is predicted; verdicts on it are `undecidable`, and estimates give it no
        /// weight.
        Uncertain = "uncertain",
        /// It is not there for sensors of the mark's class, and is not predicted for them.
        Absent = "absent",
        /// No sensor saw this region: the surface of the object may continue in the box. It is left out of predictions.
        Unseen = "unseen",
    }
}

/// A mark on an object, or on the part of it within a box.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Full path of the object.
    pub object: String,
    /// The statement.
    pub kind: MarkKind,
    /// The sensor class that it concerns; `None` concerns all.
    pub class: Option<String>,
    /// A box in the frame of the object, metres; `None` is the whole object. An absent part is made of the polygons
    /// that lie wholly in the box.
    pub bounds: Option<Aabb>,
}

impl Mark {
    /// True if it concerns sensors of a class.
    pub fn concerns(&self, class: &str) -> bool {
        self.class.as_deref().is_none_or(|own| own == class)
    }

    /// True if it covers a point, in the frame of its object, metres.
    pub fn covers(&self, p_in_object: DVec3) -> bool {
        self.bounds.is_none_or(|b| p_in_object.cmpge(b.min).all() && p_in_object.cmple(b.max).all())
    }

    fn check(&self) -> Result<()> {
        if let Some(class) = self.class.as_deref().filter(|c| c.is_empty()) {
            return Err(Error::invalid(format!("the sensor class {class:?} is empty"), "name one, or leave it out"));
        }
        let sound = |p: DVec3| p.is_finite() && p.abs().max_element() <= limits::MAX_COORDINATE;
        match self.bounds {
            Some(b) if !sound(b.min) || !sound(b.max) || b.is_empty() => {
                let what = format!("the box from {} to {} holds no point", b.min, b.max);
                Err(Error::invalid(what, "give its least and its greatest corner, finite, metres"))
            }
            _ => Ok(()),
        }
    }
}

/// The marks, by name, and the trust in objects, by path.
#[derive(Clone, Debug, Default)]
pub(super) struct Beliefs {
    marks: BTreeMap<String, Mark>,
    trust: BTreeMap<String, Existence>,
}

impl Environment {
    /// All marks by rising name.
    pub fn marks(&self) -> impl ExactSizeIterator<Item = (&str, &Mark)> {
        self.beliefs.marks.iter().map(|(name, mark)| (name.as_str(), mark))
    }

    /// The mark with this name.
    pub fn mark(&self, name: &str) -> Option<&Mark> {
        self.beliefs.marks.get(name)
    }

    /// The marks of one kind on an object that concern a sensor class.
    pub fn marks_on<'a>(
        &'a self,
        object: &'a str,
        kind: MarkKind,
        class: &'a str,
    ) -> impl Iterator<Item = &'a Mark> + 'a {
        let all = self.beliefs.marks.values();
        all.filter(move |mark| mark.kind == kind && mark.object == object && mark.concerns(class))
    }

    /// Trust in objects, by rising path: probability of existence, last confirmation and decay. Objects that are not
    /// listed were never verified.
    pub fn trusts(&self) -> impl ExactSizeIterator<Item = (&str, &Existence)> {
        self.beliefs.trust.iter().map(|(object, trust)| (object.as_str(), trust))
    }

    /// The trust in an object, if it is stored.
    pub fn trust(&self, object: &str) -> Option<&Existence> {
        self.beliefs.trust.get(object)
    }

    /// Sets a mark and returns the mark that had its name.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if its object does not exist, or name, class or box are invalid.
    pub fn set_mark(&mut self, name: &str, mark: Mark) -> Result<Option<Mark>> {
        let check = || {
            if name.is_empty() || name.len() > limits::MAX_NAME_BYTES {
                let what = format!("the name has {} bytes", name.len());
                return Err(Error::invalid(what, format!("give 1 to {}", limits::MAX_NAME_BYTES)));
            }
            self.index_of(&mark.object)?;
            mark.check()
        };
        check().map_err(|e| e.at(format!("mark {name:?}")))?;
        Ok(self.beliefs.marks.insert(name.to_owned(), mark))
    }

    /// Removes a mark and returns it.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if there is no such mark.
    pub fn remove_mark(&mut self, name: &str) -> Result<Mark> {
        let none = || Error::invalid(format!("there is no mark {name:?}"), "presight env info lists the marks");
        self.beliefs.marks.remove(name).ok_or_else(none)
    }

    /// Sets or removes the trust in an object and returns the previous one.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the object does not exist, or a number is invalid.
    pub fn set_trust(&mut self, object: &str, trust: Option<Existence>) -> Result<Option<Existence>> {
        self.index_of(object)?;
        let Some(trust) = trust else { return Ok(self.beliefs.trust.remove(object)) };
        trust.check().map_err(|e| e.at(format!("object {object:?}")))?;
        Ok(self.beliefs.trust.insert(object.to_owned(), trust))
    }

    /// Puts a mark back, or takes it away, without a check.
    pub(super) fn restore_mark(&mut self, name: String, before: Option<Mark>) {
        match before {
            Some(mark) => drop(self.beliefs.marks.insert(name, mark)),
            None => drop(self.beliefs.marks.remove(&name)),
        }
    }

    /// Puts trust back, or takes it away, without a check.
    pub(super) fn restore_trust(&mut self, object: String, before: Option<Existence>) {
        match before {
            Some(trust) => drop(self.beliefs.trust.insert(object, trust)),
            None => drop(self.beliefs.trust.remove(&object)),
        }
    }

    /// Names of the marks on an object.
    pub(crate) fn marks_of(&self, object: &str) -> Vec<String> {
        let own = self.beliefs.marks.iter().filter(|(_, mark)| mark.object == object);
        own.map(|(name, _)| name.clone()).collect()
    }

    /// The absent parts of an object for a sensor class; `None` if it is absent as a whole.
    pub fn absent_parts(&self, object: u32, class: &str) -> Option<Vec<Aabb>> {
        let mut parts = Vec::new();
        if !self.beliefs.marks.is_empty() {
            let name = &self.objects()[object as usize].name;
            for mark in self.marks_on(name, MarkKind::Absent, class) {
                parts.push(mark.bounds?);
            }
        }
        Some(parts)
    }

    /// True if a polygon of an object lies wholly in one of the boxes, given in the object's frame.
    pub fn lies_in(&self, object: u32, polygon: u32, parts: &[Aabb]) -> bool {
        let object = &self.objects()[object as usize];
        let inside = |b: &Aabb| {
            object
                .mesh
                .corners_of(polygon)
                .map(|p| object.object_from_mesh.transform_point3(p))
                .all(|p| p.cmpge(b.min).all() && p.cmple(b.max).all())
        };
        parts.iter().any(inside)
    }

    /// True if a polygon of an object is absent for a sensor class; without a class, if it is absent for all sensors.
    pub fn is_absent(&self, object: u32, polygon: u32, class: Option<&str>) -> bool {
        // No mark names the empty class.
        !self.beliefs.marks.is_empty()
            && self
                .absent_parts(object, class.unwrap_or_default())
                .is_none_or(|parts| self.lies_in(object, polygon, &parts))
    }

    /// Object and polygon of all surfaces that stand in the way of a robot: without deleted objects and without surfaces
    /// marked as absent for all sensors.
    pub fn present_polygons(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let live = (0u32..).zip(self.objects()).filter(|(_, object)| !object.is_deleted());
        live.flat_map(|(index, object)| (0..object.mesh.polygon_count() as u32).map(move |polygon| (index, polygon)))
            .filter(|(object, polygon)| !self.is_absent(*object, *polygon, None))
    }

    /// True if a point of the world on an object lies in a part that is marked as uncertain for a sensor class.
    pub fn is_uncertain(&self, object: u32, p_in_world: DVec3, class: &str) -> bool {
        if self.beliefs.marks.is_empty() {
            return false;
        }
        let object = &self.objects()[object as usize];
        let p_in_object = || object.world_from_object.inverse().transform_point(p_in_world);
        self.marks_on(&object.name, MarkKind::Uncertain, class).any(|mark| mark.covers(p_in_object()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::Change;
    use crate::environment::{Material, Mesh, NewObject, Polygon, PolygonOrder};
    use crate::geometry::Pose;
    use crate::world::World;
    use glam::Vec3;

    /// Two tiles, at x = 0 and x = 2, in one mesh.
    fn world() -> World {
        let mut environment = Environment::new();
        environment.add_material(Material::named("m")).unwrap();
        let corners = |x: f32| [[x, 0.0], [x + 1.0, 0.0], [x + 1.0, 1.0], [x, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
        let polygons = vec![Polygon::new(vec![0, 1, 2, 3], 0), Polygon::new(vec![4, 5, 6, 7], 0)];
        let vertices = [corners(0.0), corners(2.0)].concat();
        let mesh = Mesh::new("tiles", vertices, polygons, PolygonOrder::Given).unwrap();
        let pose = Pose::from_xyz_rpy(DVec3::new(5.0, 0.0, 0.0), 0.0, 0.0, 0.0);
        environment.insert(NewObject::new("tiles", pose, mesh.into())).unwrap();
        World::new(environment)
    }

    fn set(name: &str, kind: MarkKind, bounds: Option<Aabb>) -> Change {
        let mark = Mark { object: "tiles".into(), kind, class: Some("laser".into()), bounds };
        Change::SetMark { name: name.into(), mark }
    }

    fn first_tile() -> Aabb {
        Aabb { min: DVec3::splat(-0.1), max: DVec3::new(1.1, 1.1, 0.1) }
    }

    #[test]
    fn marks_concern_their_class_and_their_box() {
        let mut world = world();
        world.apply(set("a", MarkKind::Absent, Some(first_tile()))).unwrap();
        world.apply(set("b", MarkKind::Uncertain, Some(first_tile()))).unwrap();
        let environment = world.environment();
        let parts = environment.absent_parts(0, "laser").unwrap();
        assert_eq!([0, 1].map(|polygon| environment.lies_in(0, polygon, &parts)), [true, false]);
        assert_eq!(environment.absent_parts(0, "radar"), Some(vec![]));
        let at = |x: f64, class: &str| environment.is_uncertain(0, DVec3::new(x, 0.5, 0.0), class);
        assert_eq!((at(5.5, "laser"), at(7.5, "laser"), at(5.5, "radar")), (true, false, false));
        world.apply(set("a", MarkKind::Absent, None)).unwrap();
        assert_eq!(world.environment().absent_parts(0, "laser"), None, "the whole object");
        let absent = |class| world.environment().is_absent(0, 0, class);
        assert!(absent(Some("laser")) && !absent(Some("radar")) && !absent(None));
    }

    #[test]
    fn marks_and_trust_are_content_that_comes_back() {
        let mut world = world();
        let plain = world.environment().content_hash();
        let trust = Some(Existence { p0: 0.5, confirmed: 10.0, rate: 0.0 });
        let changes = vec![
            set("a", MarkKind::Absent, None),
            set("b", MarkKind::Uncertain, Some(first_tile())),
            Change::SetTrust { object: "tiles".into(), trust },
            set("a", MarkKind::Uncertain, None),
            Change::RemoveMark { name: "b".into() },
        ];
        let (mut undo, mut hashes) = (Vec::new(), vec![plain]);
        for change in changes {
            undo.push(world.apply(change).unwrap());
            assert!(!hashes.contains(&world.environment().content_hash()));
            hashes.push(world.environment().content_hash());
        }
        // Deleting the object takes both with it, and its undo brings them back.
        let inverse = world.apply(Change::DeleteObject { name: "tiles".into() }).unwrap();
        assert_eq!((world.environment().marks().len(), world.environment().trusts().len()), (0, 0));
        world.apply_unchecked(inverse).unwrap();
        while let Some(change) = undo.pop() {
            assert_eq!(Some(world.environment().content_hash()), hashes.pop());
            world.apply_unchecked(change).unwrap();
        }
        assert_eq!(world.environment().content_hash(), plain);
    }

    #[test]
    fn a_group_that_fails_leaves_no_mark() {
        let mut world = world();
        world.apply(set("a", MarkKind::Uncertain, None)).unwrap();
        let before = world.environment().content_hash();
        let trust = Some(Existence::default());
        let wrong = [
            Change::RemoveMark { name: "none".into() },
            Change::SetTrust { object: "none".into(), trust },
            Change::SetTrust { object: "tiles".into(), trust: Some(Existence { p0: 1.5, ..Existence::default() }) },
            set("", MarkKind::Absent, None),
            set("c", MarkKind::Absent, Some(Aabb::EMPTY)),
        ];
        for last in wrong {
            let first = [
                set("a", MarkKind::Absent, None),
                set("b", MarkKind::Absent, None),
                Change::RemoveMark { name: "a".into() },
                Change::SetTrust { object: "tiles".into(), trust },
                last,
            ];
            assert!(world.apply(Change::Group(first.to_vec())).is_err());
            assert_eq!(world.environment().content_hash(), before);
        }
    }
}
