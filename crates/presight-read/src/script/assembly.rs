//! Assemblies of named parts with poses. Assemblies can nest; a placed assembly becomes a group of objects under one
//! path.

use super::budget::{Budget, BudgetShare, corners_worth};
use super::call::Spot;
use super::lost::{LostPart, PendingPart};
use super::shape::Shape;
use glam::DAffine3;
use presight_model::environment::Mesh;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::sync::Arc;

/// Something that can be placed.
#[derive(Clone, Debug)]
pub(super) enum Placeable {
    Shape(Shape),
    Assembly(Assembly),
    Imported(ImportedObject),
}

/// An object of a glTF file.
#[derive(Clone, Debug)]
pub(super) struct ImportedObject {
    pub mesh: Arc<Mesh>,
    pub object_from_mesh: DAffine3,
    /// Number of source triangles, including degenerate ones.
    pub triangles: u32,
}

/// An assembly with the value semantics of scripts: its data are copied on write.
#[derive(Clone, Debug)]
pub(super) struct Assembly(Rc<Data>);

#[derive(Debug)]
struct Data {
    parts: Vec<Part>,
    /// Frames of groups inside that are not assemblies. They come from glTF files.
    groups: Vec<(String, Pose)>,
    objects: u64,
    polygons: u64,
    depth: u32,
    held: Vec<BudgetShare>,
    /// True if it is a copy, was placed, or was added to another. Parts added after that may be meant for the other.
    known_elsewhere: Cell<bool>,
    /// The first part added after that, until the assembly is used.
    unused: RefCell<Option<PendingPart>>,
}

/// A named part.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub name: String,
    pub assembly_from_part: Pose,
    pub thing: Placeable,
}

impl Part {
    /// Its memory, expressed in polygon corners.
    fn corners(&self) -> u64 {
        worth(&self.name)
    }
}

/// The memory of a part or group with this name, expressed in polygon corners.
fn worth(name: &str) -> u64 {
    16 + corners_worth(name.len())
}

impl Placeable {
    /// Number of objects it becomes when placed.
    pub fn objects(&self) -> u64 {
        match self {
            Self::Assembly(Assembly(data)) => data.objects,
            _ => 1,
        }
    }

    /// Number of polygons of these objects.
    pub fn polygons(&self) -> u64 {
        match self {
            Self::Shape(shape) => shape.polygons() as u64,
            Self::Assembly(Assembly(data)) => data.polygons,
            Self::Imported(imported) => imported.mesh.polygon_count() as u64,
        }
    }

    fn depth(&self) -> u32 {
        match self {
            Self::Assembly(Assembly(data)) => data.depth,
            _ => 0,
        }
    }

    /// Records that it is placed or added to another. Parts added so far are not lost; parts added from now on may be.
    pub fn mark_used(&self) {
        if let Self::Assembly(Assembly(data)) = self {
            data.mark_used();
        }
    }

    /// Records that the script has read it, so that parts added so far are not lost.
    pub fn mark_seen(&self) {
        if let Self::Assembly(Assembly(data)) = self {
            data.mark_seen();
        }
    }
}

impl Data {
    fn of(parts: Vec<Part>, groups: Vec<(String, Pose)>) -> Self {
        let (known_elsewhere, unused) = Default::default();
        Self { parts, groups, objects: 0, polygons: 0, depth: 1, held: Vec::new(), known_elsewhere, unused }
    }

    fn mark_used(&self) {
        self.known_elsewhere.set(true);
        self.mark_seen();
    }

    fn mark_seen(&self) {
        if let Some(added) = self.unused.take() {
            added.forget();
        }
    }
}

impl Assembly {
    pub fn new() -> Self {
        Self::with_groups(Vec::new())
    }

    /// An assembly with no parts yet, but with the frames (`assembly_from_group`) of groups.
    pub fn with_groups(groups: Vec<(String, Pose)>) -> Self {
        Self(Rc::new(Data::of(Vec::new(), groups)))
    }

    /// Paths and frames (`assembly_from_group`) of groups.
    pub fn groups(&self) -> &[(String, Pose)] {
        &self.0.groups
    }

    /// Its parts, in the order they were added.
    pub fn parts(&self) -> &[Part] {
        &self.0.parts
    }

    /// Adds a part. `lost` records it if the part is never used.
    pub fn add(&mut self, part: Part, budget: &Rc<Budget>, (lost, at): (&Rc<LostPart>, &Spot)) -> Result<()> {
        let (objects, polygons) = (part.thing.objects(), part.thing.polygons());
        let depth = self.0.depth.max(part.thing.depth() + 1);
        check_counts(self.0.objects.saturating_add(objects), self.0.polygons.saturating_add(polygons))?;
        if depth > limits::MAX_SCRIPT_ASSEMBLIES {
            let what = format!("assemblies nest over {} levels", limits::MAX_SCRIPT_ASSEMBLIES);
            return Err(Error::invalid(what, "nest fewer"));
        }
        let held = budget.take(part.corners())?;
        if Rc::get_mut(&mut self.0).is_none() {
            let Data { parts, groups, objects, polygons, depth, .. } = &*self.0;
            let of_groups: u64 = groups.iter().map(|(path, _)| worth(path)).sum();
            let held = vec![budget.take(of_groups + parts.iter().map(Part::corners).sum::<u64>())?];
            let copy = Data::of(parts.clone(), groups.clone());
            let copy = Data { objects: *objects, polygons: *polygons, depth: *depth, held, ..copy };
            self.0.mark_used();
            copy.known_elsewhere.set(true);
            self.0 = Rc::new(copy);
        }
        part.thing.mark_used();
        if let Some(data) = Rc::get_mut(&mut self.0) {
            if data.known_elsewhere.get() && data.unused.get_mut().is_none() {
                data.unused = RefCell::new(Some(PendingPart::new(&part.name, at, lost)));
            }
            data.parts.push(part);
            data.held.push(held);
            data.objects += objects;
            data.polygons += polygons;
            data.depth = depth;
        }
        Ok(())
    }
}

/// Checks that a shape or an assembly to be placed or added has at least one object.
pub(super) fn check_not_empty(thing: &Placeable) -> Result<()> {
    if thing.objects() > 0 {
        return Ok(());
    }
    let what = "thing is an assembly without parts";
    let remedy =
        "add parts first, with a.add(name, thing): add(a[0], ..), add(m.a, ..) and add(CONST, ..) change a copy";
    Err(Error::invalid(what, remedy))
}

/// Checks the numbers of objects and polygons against the limits.
pub(super) fn check_counts(objects: u64, polygons: u64) -> Result<()> {
    if objects > limits::MAX_SCRIPT_OBJECTS {
        let what = format!("the script places {objects} objects");
        return Err(Error::invalid(what, format!("{} is the limit", limits::MAX_SCRIPT_OBJECTS)));
    }
    if polygons > limits::MAX_SCRIPT_POLYGONS {
        let what = format!("the script places {polygons} polygons");
        return Err(Error::invalid(what, format!("{} is the limit", limits::MAX_SCRIPT_POLYGONS)));
    }
    Ok(())
}
