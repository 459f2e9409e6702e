//! What a running script builds: the environment, its features, and the account of it.

use super::assembly::{Assembly, Imported, Part, Thing, check_counts};
use super::budget::Budget;
use super::folder::Folder;
use super::shape::{Mark, Shape};
use crate::acquire::{ImportReport, Imported as Outcome, Problem};
use crate::environment::{DEFAULT_TOLERANCE, Environment, Feature, FeatureLayer, Material, NewObject};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::io::gltf::{self, ImportOptions};
use crate::limits;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;

/// Where a script builds.
pub(super) struct Studio {
    pub folder: Folder,
    pub budget: Rc<Budget>,
    options: ImportOptions,
    built: RefCell<Built>,
}

#[derive(Default)]
struct Built {
    environment: Environment,
    report: ImportReport,
    /// Materials that the script has defined, by name.
    materials: BTreeMap<String, u16>,
    default_material: Option<u16>,
    imports: HashMap<PathBuf, Assembly>,
    /// By class: the id, if the script gives one.
    features: BTreeMap<String, Vec<(Option<u32>, Feature)>>,
    feature_count: u64,
}

impl Studio {
    pub fn new(folder: Folder, options: &ImportOptions) -> Self {
        Self { folder, budget: Rc::default(), options: options.clone(), built: RefCell::default() }
    }

    /// Defines a material; the same again is no error, another of that name is.
    pub fn define(&self, material: Material) -> Result<()> {
        let mut built = self.built.borrow_mut();
        if let Some(&known) = built.materials.get(&material.name) {
            if built.environment.materials()[usize::from(known)] == material {
                return Ok(());
            }
            let what = format!("material {:?} is defined already, with other properties", material.name);
            return Err(Error::invalid(what, "give it another name"));
        }
        let name = material.name.clone();
        let index = built.environment.add_material(material)?;
        built.materials.insert(name, index);
        Ok(())
    }

    /// A material that the script has defined.
    pub fn material(&self, name: &str) -> Result<u16> {
        let built = self.built.borrow();
        built.materials.get(name).copied().ok_or_else(|| {
            let known: Vec<&str> = built.materials.keys().map(String::as_str).collect();
            let remedy = match known.is_empty() {
                true => format!("define it first: material({name:?}, #{{reflection: 0.5}})"),
                false => format!("define it first, or take one of {}", known.join(", ")),
            };
            Error::invalid(format!("there is no material {name:?}"), remedy)
        })
    }

    /// Places a thing, and all that is in it, under a path.
    pub fn place(&self, path: &str, thing: &Thing, world_from_thing: &Pose) -> Result<()> {
        let mut built = self.built.borrow_mut();
        let objects = built.environment.objects().len() as u64 + thing.objects();
        check_counts(objects, u64::from(built.environment.slot_count()) + thing.polygons())?;
        built.place(path, thing, world_from_thing, &self.options)
    }

    /// The objects of a glTF file as an assembly, read once.
    pub fn import(&self, relative: &str) -> Result<Assembly> {
        let (shown, real) = self.folder.file(relative)?;
        if let Some(known) = self.built.borrow().imports.get(&real) {
            return Ok(known.clone());
        }
        // By the name the script gives: messages and the sidecar belong to it.
        let outcome = gltf::import_within(&shown, Some(self.folder.real()), &self.options)?;
        let assembly = self.built.borrow_mut().take_over(outcome, relative, &self.budget)?;
        self.built.borrow_mut().imports.insert(real, assembly.clone());
        Ok(assembly)
    }

    /// What the script has built.
    pub fn finish(&self) -> Result<Outcome> {
        let mut built = self.built.take();
        if built.environment.slot_count() == 0 {
            let remedy = "place something: place(\"floor\", rectangle(4, 3))";
            return Err(Error::invalid("the script places no polygons", remedy));
        }
        for (class, features) in std::mem::take(&mut built.features) {
            let features = numbered(features).map_err(|e| e.at(format!("features for class {class:?}")))?;
            let layer = FeatureLayer { class, tolerance: DEFAULT_TOLERANCE, features, pose_covariances: Vec::new() };
            built.environment.add_layer(layer)?;
        }
        built.report.polygons_in_scene = u64::from(built.environment.slot_count());
        Ok(Outcome { environment: built.environment, report: built.report })
    }
}

impl Built {
    fn place(&mut self, path: &str, thing: &Thing, world_from_thing: &Pose, options: &ImportOptions) -> Result<()> {
        if path.len() > limits::MAX_NAME_BYTES {
            let what = format!("a path is over {} bytes", limits::MAX_NAME_BYTES);
            return Err(Error::invalid(what, "give shorter names"));
        }
        match thing {
            Thing::Shape(shape) => self.place_shape(path, shape, world_from_thing, options),
            Thing::Imported(imported) => {
                let object = NewObject {
                    object_from_mesh: imported.object_from_mesh,
                    ..NewObject::new(path, *world_from_thing, imported.mesh.clone())
                };
                self.insert(object, imported.triangles).map(|_| ())
            }
            Thing::Assembly(assembly) => {
                for Part { name, assembly_from_part, thing } in assembly.parts() {
                    let world_from_part = world_from_thing.then(assembly_from_part);
                    self.place(&format!("{path}/{name}"), thing, &world_from_part, options)?;
                }
                Ok(())
            }
        }
    }

    fn place_shape(&mut self, path: &str, shape: &Shape, pose: &Pose, options: &ImportOptions) -> Result<()> {
        let default = if shape.needs_default() { self.default_material()? } else { 0 };
        let name = path.rsplit('/').next().unwrap_or(path);
        let (mesh, new) = shape.mesh(name, default, options).map_err(|e| e.at(format!("object {path:?}")))?;
        if new {
            self.report.triangles_stored += u64::from(shape.triangles());
            self.report.polygons_stored += mesh.polygon_count() as u64;
        }
        let object = self.insert(NewObject::new(path, *pose, mesh), shape.triangles())?;
        if !shape.marks().is_empty() {
            let path = self.environment.objects()[object as usize].name.clone();
            shape.marks().iter().try_for_each(|mark| self.mark(mark, &path))?;
        }
        Ok(())
    }

    fn insert(&mut self, new: NewObject, triangles: u32) -> Result<u32> {
        let far = !(new.world_from_object.translation.abs().max_element() <= limits::MAX_COORDINATE);
        if far {
            let what = format!("object {:?} is beyond {:e} m", new.name, limits::MAX_COORDINATE);
            return Err(Error::invalid(what, "place it nearer"));
        }
        // Within 32 bits: the polygons are under the limit, and so are the corners of each.
        let first_source = u32::try_from(self.report.triangles_in_scene).unwrap_or(u32::MAX);
        self.report.triangles_in_scene += u64::from(triangles);
        self.environment.insert(NewObject { first_source, ..new })
    }

    fn default_material(&mut self) -> Result<u16> {
        if let Some(index) = self.default_material {
            return Ok(index);
        }
        let index = self.environment.add_material(Material::named("default"))?;
        self.default_material = Some(index);
        Ok(index)
    }

    fn mark(&mut self, mark: &Mark, object: &str) -> Result<()> {
        self.feature_count += mark.classes.len() as u64;
        if self.feature_count > limits::MAX_SCRIPT_FEATURES {
            let what = format!("{} features are asked for", self.feature_count);
            return Err(Error::invalid(what, format!("{} is the limit", limits::MAX_SCRIPT_FEATURES)));
        }
        for class in &mark.classes {
            let feature = Feature {
                id: 0,
                name: mark.name.clone(),
                object: Some(object.to_owned()),
                shape: mark.shape.clone(),
                existence: mark.existence,
                properties: mark.properties.clone(),
            };
            self.features.entry(class.clone()).or_default().push((mark.id, feature));
        }
        Ok(())
    }

    /// Materials and report of an imported scene; its objects as parts.
    fn take_over(&mut self, outcome: Outcome, file: &str, budget: &Rc<Budget>) -> Result<Assembly> {
        let Outcome { environment, report } = outcome;
        let mut materials = Vec::with_capacity(environment.materials().len());
        for material in environment.materials() {
            materials.push(self.environment.add_material(material.clone())?);
        }
        let mut meshes: HashMap<*const _, Arc<_>> = HashMap::new();
        let mut assembly = Assembly::new();
        let ends = environment.objects().iter().skip(1).map(|o| o.first_source);
        let last = u32::try_from(report.triangles_in_scene).unwrap_or(u32::MAX);
        for (object, end) in environment.objects().iter().zip(ends.chain([last])) {
            let mesh = meshes
                .entry(Arc::as_ptr(&object.mesh))
                .or_insert_with(|| Arc::new(object.mesh.with_materials(|m| materials[usize::from(m)])));
            let thing = Thing::Imported(Imported {
                mesh: mesh.clone(),
                object_from_mesh: object.object_from_mesh,
                triangles: end - object.first_source,
            });
            let part = Part { name: object.name.clone(), assembly_from_part: object.world_from_object, thing };
            assembly.add(part, budget)?;
        }
        self.account(&report, file);
        Ok(assembly)
    }

    fn account(&mut self, of_file: &ImportReport, file: &str) {
        let report = &mut self.report;
        report.triangles_stored += of_file.triangles_stored;
        report.polygons_stored += of_file.polygons_stored;
        report.merges += of_file.merges;
        report.largest_deviation_m = report.largest_deviation_m.max(of_file.largest_deviation_m);
        for problem in &of_file.problems {
            let places = problem.places.iter().map(|place| format!("{file}: {place}"));
            match report.problems.iter_mut().find(|p| p.kind == problem.kind) {
                Some(known) => {
                    known.total += problem.total;
                    let room = limits::LISTED_PROBLEMS.saturating_sub(known.places.len());
                    known.places.extend(places.take(room));
                }
                None => report.problems.push(Problem { places: places.collect(), ..problem.clone() }),
            }
        }
        report.problems.sort_by_key(|p| p.kind);
    }
}

/// Gives numbers to features that have none: from 1, in the order they were placed, leaving out those in use.
fn numbered(features: Vec<(Option<u32>, Feature)>) -> Result<Vec<Feature>> {
    let mut taken = BTreeSet::new();
    for id in features.iter().filter_map(|(id, _)| *id) {
        if !taken.insert(id) {
            let remedy =
                "give each feature of a class an id of its own; one on a shape that is placed often none at all";
            return Err(Error::invalid(format!("id {id} is given twice"), remedy));
        }
    }
    let mut free = (1u32..).filter(|id| !taken.contains(id));
    let mut all: Vec<Feature> = Vec::with_capacity(features.len());
    for (id, feature) in features {
        let id = id.or_else(|| free.next()).unwrap_or_default();
        all.push(Feature { id, ..feature });
    }
    all.sort_by_key(|f| f.id);
    Ok(all)
}
