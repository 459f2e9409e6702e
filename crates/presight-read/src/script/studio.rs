//! The scene that a running script builds: environment, features and report.

use super::assembly::{Assembly, ImportedObject, Part, Placeable, check_counts, check_not_empty};
use super::budget::{Budget, corners_worth};
use super::call::Spot;
use super::fault::shortened;
use super::folder::Folder;
use super::lost::LostPart;
use super::shape::{Mark, Shape};
use crate::gltf::{self, ImportOptions};
use crate::preparation::{ImportReport, ImportedScene as Outcome, Problem};
use presight_model::environment::{DEFAULT_TOLERANCE, Environment, Feature, FeatureLayer, Material, NewObject, Paths};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use presight_model::memory;
use presight_model::placement;
use presight_model::printable::did_you_mean;
use presight_model::world::World;
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

/// Maximum length of the names that an error lists, bytes.
const LISTED: usize = 240;
/// Bytes of a map entry, without its text.
const ENTRY: usize = 48;

/// The state of a running script.
pub(super) struct Studio {
    pub folder: Folder,
    pub budget: Rc<Budget>,
    pub lost: Rc<LostPart>,
    /// Time spent in our functions so far.
    pub busy: Rc<Cell<Duration>>,
    options: ImportOptions,
    /// Memory of all imports.
    imported: RefCell<gltf::Memory>,
    built: RefCell<SceneBuild>,
}

#[derive(Default)]
struct SceneBuild {
    environment: Environment,
    /// Paths of objects and placed assemblies.
    paths: Paths,
    report: ImportReport,
    /// Numbers of the materials that the script has defined, by name.
    materials: BTreeMap<String, u16>,
    default_material: Option<u16>,
    imports: HashMap<PathBuf, Assembly>,
    /// Features by sensor class.
    features: BTreeMap<String, Vec<ObjectFeature>>,
    feature_count: u64,
    /// The files of the imported models.
    models: Vec<PathBuf>,
    /// Names of the script files that placed features.
    files: BTreeSet<Rc<str>>,
}

/// A feature of a placed object.
struct ObjectFeature {
    /// The id, if the script gives one.
    id: Option<u32>,
    feature: Feature,
    /// Place of the call that placed the object.
    at: Spot,
}

impl Studio {
    pub fn new(folder: Folder, options: &ImportOptions) -> Self {
        let (budget, lost, busy, imported, built) = Default::default();
        Self { folder, budget, lost, busy, options: options.clone(), imported, built }
    }

    /// Defines a material. Repeating an equal definition is allowed; another material of that name is an error.
    pub fn define(&self, material: Material) -> Result<()> {
        let mut built = self.built.borrow_mut();
        if let Some(&known) = built.materials.get(&material.name) {
            if built.environment.materials()[usize::from(known)] == material {
                return Ok(());
            }
            let what = format!("material {:?} is defined already with other properties", material.name);
            return Err(Error::invalid(what, "give it another name"));
        }
        let name = material.name.clone();
        let classes: usize = material.appearance.keys().map(|class| class.len() + ENTRY).sum();
        self.budget.keep(corners_worth(size_of::<Material>() + ENTRY + 2 * name.len() + classes))?;
        let index = built.environment.add_material(material)?;
        built.materials.insert(name, index);
        Ok(())
    }

    /// Returns the number of a material that the script has defined.
    pub fn material(&self, name: &str) -> Result<u16> {
        let built = self.built.borrow();
        built.materials.get(name).copied().ok_or_else(|| {
            let mut room = LISTED;
            let mut fits = |known: &String| {
                room = room.saturating_sub(known.len() + 2);
                room > 0
            };
            let known: Vec<String> =
                built.materials.keys().map(|known| shortened(known)).take_while(|known| fits(known)).collect();
            let more = if built.materials.len() > known.len() { ", .." } else { "" };
            let alike = did_you_mean(name, known.iter().map(String::as_str));
            let name = shortened(name);
            let remedy = match known.is_empty() {
                true => format!("define it first: material({name:?}, #{{reflection: 0.5}})"),
                false => format!("{alike}define it first, or use one of {}{more}", known.join(", ")),
            };
            Error::invalid(format!("there is no material {name:?}"), remedy)
        })
    }

    /// Returns the shared copy of a file's name.
    pub fn file_name(&self, name: &str) -> Rc<str> {
        let mut built = self.built.borrow_mut();
        if let Some(known) = built.files.get(name) {
            return known.clone();
        }
        let new: Rc<str> = name.into();
        built.files.insert(new.clone());
        new
    }

    /// Places a shape or an assembly with all its parts under a path. `at` is the place of the call.
    pub fn place(&self, path: &str, thing: &Placeable, world_from_thing: &Pose, at: &Spot) -> Result<()> {
        check_not_empty(thing)?;
        thing.mark_used();
        let mut built = self.built.borrow_mut();
        let objects = built.environment.objects().len() as u64 + thing.objects();
        check_counts(objects, u64::from(built.environment.slot_count()) + thing.polygons())?;
        let (options, budget) = (&self.options, &self.budget);
        PlaceCall { built: &mut built, options, budget, at }.place(path, thing, world_from_thing)
    }

    /// Imports the objects of a glTF file as an assembly. Each file is read once.
    pub fn import(&self, relative: &str) -> Result<Assembly> {
        let (shown, real) = self.folder.file(relative)?;
        if let Some(known) = self.built.borrow().imports.get(&real) {
            return Ok(known.clone());
        }
        // Read no more once a limit is exceeded.
        self.budget.work(0)?;
        let mut memory = *self.imported.borrow();
        // `shown`, not `real`: it appears in messages, and its sidecar applies.
        let outcome = gltf::import_within(&shown, self.folder.real(), &self.options, &mut memory);
        if outcome.is_err() {
            // A failed import is not cached, so the script may repeat it: count its work.
            let taken = memory.bytes() - self.imported.borrow().bytes();
            self.budget.work(corners_worth(usize::try_from(taken).unwrap_or(usize::MAX)))?;
        }
        let outcome = outcome?;
        *self.imported.borrow_mut() = memory.after_import();
        let assembly = self.built.borrow_mut().take_over(outcome, relative, &self.budget)?;
        self.built.borrow_mut().imports.insert(real, assembly.clone());
        Ok(assembly)
    }

    /// Returns the scene that the script has built.
    pub fn finish(&self) -> Result<Outcome> {
        self.lost.check()?;
        let mut built = self.built.take();
        let at_end = |e: Error| e.at("at its end");
        if built.environment.slot_count() == 0 {
            let remedy = "place something: place(\"floor\", rectangle(4, 3))";
            return Err(at_end(Error::invalid("the script places no polygons", remedy)));
        }
        built.environment.settle_groups();
        let mut spots = BTreeMap::new();
        for (class, features) in std::mem::take(&mut built.features) {
            let place = |e: Error| at_end(e.at(format!("features for class {class:?}")));
            let (features, of_features) = numbered(features).map_err(place)?;
            spots.insert(class.clone(), of_features);
            let features = features.into_iter().map(Arc::new).collect();
            let layer = FeatureLayer { class, tolerance: DEFAULT_TOLERANCE, features, pose_covariances: Vec::new() };
            built.environment.add_layer(layer).map_err(at_end)?;
        }
        let environment = check_features(built.environment, &spots)?;
        built.report.polygons_in_scene = u64::from(environment.slot_count());
        Ok(Outcome { environment, report: built.report, frame: None, files: built.models })
    }
}

/// Checks that all features lie on polygons of the complete scene. `spots`: where each was placed, by class and id.
fn check_features(environment: Environment, spots: &BTreeMap<String, BTreeMap<u32, Spot>>) -> Result<Environment> {
    if environment.layers().is_empty() {
        return Ok(environment);
    }
    let world = World::new(environment);
    for layer in world.environment().layers() {
        let off = placement::find(&world, layer)?.off;
        let feature = off.first().and_then(|id| world.environment().feature(&layer.class, *id));
        let why = feature.and_then(|feature| placement::why_off(&world, &layer.class, layer.tolerance, feature));
        let spot = off.first().and_then(|id| spots.get(&layer.class)?.get(id)).cloned().unwrap_or_default();
        if let Some(why) = why {
            return Err(spot.place(why, "place"));
        }
    }
    Ok(Arc::unwrap_or_clone(world.into_environment()))
}

/// One call of `place`.
struct PlaceCall<'a> {
    built: &'a mut SceneBuild,
    options: &'a ImportOptions,
    budget: &'a Rc<Budget>,
    at: &'a Spot,
}

impl PlaceCall<'_> {
    fn place(&mut self, path: &str, thing: &Placeable, world_from_thing: &Pose) -> Result<()> {
        if path.len() > limits::MAX_NAME_BYTES {
            let what = format!("a path is over {} bytes", limits::MAX_NAME_BYTES);
            return Err(Error::invalid(what, "give shorter names"));
        }
        // The path is stored twice in the environment and twice in `paths`.
        self.budget.keep(4 + corners_worth(4 * path.len()))?;
        match thing {
            Placeable::Shape(shape) => self.place_shape(path, shape, world_from_thing),
            Placeable::Imported(imported) => {
                let path = self.built.paths.take(path.to_owned());
                let object = NewObject {
                    object_from_mesh: imported.object_from_mesh,
                    ..NewObject::new(path, *world_from_thing, imported.mesh.clone())
                };
                self.built.insert(object, imported.triangles).map(|_| ())
            }
            Placeable::Assembly(assembly) => {
                let path = self.built.paths.take(path.to_owned());
                self.built.environment.set_frame(&path, Some(*world_from_thing))?;
                for Part { name, assembly_from_part, thing } in assembly.parts() {
                    let world_from_part = *world_from_thing * *assembly_from_part;
                    self.place(&format!("{path}/{name}"), thing, &world_from_part)?;
                }
                for (below, assembly_from_group) in assembly.groups() {
                    self.frame(format!("{path}/{below}"), &(*world_from_thing * *assembly_from_group))?;
                }
                Ok(())
            }
        }
    }

    /// Sets the frame of a group, unless the script placed something at its path.
    fn frame(&mut self, path: String, world_from_group: &Pose) -> Result<()> {
        self.budget.keep(4 + corners_worth(4 * path.len()))?;
        if self.built.paths.reserve(&path) {
            self.built.environment.set_frame(&path, Some(*world_from_group))?;
        }
        Ok(())
    }

    fn place_shape(&mut self, path: &str, shape: &Shape, pose: &Pose) -> Result<()> {
        let built = &mut *self.built;
        let default = if shape.needs_default() { built.default_material()? } else { 0 };
        if !shape.has_mesh() {
            self.budget.keep(shape.corners())?;
            self.budget.room(memory::of_meshes(std::iter::once(u64::from(shape.triangles()))))?;
        }
        let name = path.rsplit('/').next().unwrap_or(path);
        let (mesh, new) = shape.mesh(name, default, self.options).map_err(|e| e.at(format!("object {path:?}")))?;
        if new {
            built.report.triangles_stored += u64::from(shape.triangles());
            built.report.polygons_stored += mesh.polygon_count() as u64;
        }
        let path = built.paths.take(path.to_owned());
        built.insert(NewObject::new(path.clone(), *pose, mesh), shape.triangles())?;
        shape.marks().iter().try_for_each(|mark| self.mark(mark, &path))
    }

    fn mark(&mut self, mark: &Mark, object: &str) -> Result<()> {
        self.built.feature_count += mark.classes.len() as u64;
        if self.built.feature_count > limits::MAX_SCRIPT_FEATURES {
            let what = format!("the script places {} features", self.built.feature_count);
            return Err(Error::invalid(what, format!("{} is the limit", limits::MAX_SCRIPT_FEATURES)));
        }
        let texts = mark.name.as_ref().map_or(0, String::len) + object.len();
        let bytes = size_of::<ObjectFeature>() + texts + size_of_val(mark.shape.points());
        for class in &mark.classes {
            self.budget.keep(corners_worth(bytes + class.len()))?;
            let feature = Feature {
                id: 0,
                name: mark.name.clone(),
                object: Some(object.to_owned()),
                shape: mark.shape.clone(),
                existence: mark.existence,
                properties: mark.properties.clone(),
            };
            let marked = ObjectFeature { id: mark.id, feature, at: self.at.clone() };
            self.built.features.entry(class.clone()).or_default().push(marked);
        }
        Ok(())
    }
}

impl SceneBuild {
    fn insert(&mut self, new: NewObject, triangles: u32) -> Result<u32> {
        let far = !(new.world_from_object.translation.abs().max_element() <= limits::MAX_COORDINATE);
        if far {
            let what = format!("object {:?} is beyond {:e} m", new.name, limits::MAX_COORDINATE);
            return Err(Error::invalid(what, "place it nearer"));
        }
        // The limits on polygons and their corners keep this within 32 bits.
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

    /// Adds the materials and report of an imported scene. Returns its objects as parts of an assembly.
    fn take_over(&mut self, outcome: Outcome, file: &str, budget: &Rc<Budget>) -> Result<Assembly> {
        let Outcome { environment, report, files, .. } = outcome;
        self.models.extend(files);
        let mut materials = Vec::with_capacity(environment.materials().len());
        for material in environment.materials() {
            materials.push(self.environment.add_material(material.clone())?);
        }
        let mut meshes: HashMap<*const _, Arc<_>> = HashMap::new();
        let groups = environment.framed_groups().map(|(path, pose)| (path.to_owned(), *pose)).collect();
        let mut assembly = Assembly::with_groups(groups);
        let ends = environment.objects().iter().skip(1).map(|o| o.first_source);
        let last = u32::try_from(report.triangles_in_scene).unwrap_or(u32::MAX);
        for (object, end) in environment.objects().iter().zip(ends.chain([last])) {
            let mesh = meshes
                .entry(Arc::as_ptr(&object.mesh))
                .or_insert_with(|| Arc::new(object.mesh.with_materials(|m| materials[usize::from(m)])));
            let thing = Placeable::Imported(ImportedObject {
                mesh: mesh.clone(),
                object_from_mesh: object.object_from_mesh,
                triangles: end - object.first_source,
            });
            let part = Part { name: object.name.clone(), assembly_from_part: object.world_from_object, thing };
            assembly.add(part, budget, (&Rc::default(), &Spot::default()))?;
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
        report.notices.extend(of_file.notices.iter().map(|notice| format!("{file}: {notice}")));
    }
}

/// Gives features without an id the free ids from 1, in the order of placing. Also returns where each was placed.
fn numbered(features: Vec<ObjectFeature>) -> Result<(Vec<Feature>, BTreeMap<u32, Spot>)> {
    let mut taken = BTreeSet::new();
    for id in features.iter().filter_map(|marked| marked.id) {
        if !taken.insert(id) {
            let remedy =
                "give each feature of a class its own id, but no id to features of a shape that is placed repeatedly";
            return Err(Error::invalid(format!("id {id} is given twice"), remedy));
        }
    }
    let mut free = (1u32..).filter(|id| !taken.contains(id));
    let mut all: Vec<Feature> = Vec::with_capacity(features.len());
    let mut spots = BTreeMap::new();
    for ObjectFeature { id, feature, at } in features {
        let id = id.or_else(|| free.next()).unwrap_or_default();
        all.push(Feature { id, ..feature });
        spots.insert(id, at);
    }
    all.sort_by_key(|f| f.id);
    Ok((all, spots))
}
