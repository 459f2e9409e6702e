//! What other files hold, as changes of an environment.

use crate::gltf::{ImportOptions, import};
use crate::layer::LayerFile;
use presight_model::change::Change;
use presight_model::environment::{Environment, Feature, FeatureLayer, Material, Mesh, NewObject};
use presight_model::error::{Error, Result};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Numbers of materials, those to be added included.
pub(super) struct Materials<'a> {
    present: &'a [Material],
    added: &'a mut Vec<Material>,
}

impl<'a> Materials<'a> {
    pub fn new(environment: &'a Environment, added: &'a mut Vec<Material>) -> Self {
        Self { present: environment.materials(), added }
    }

    fn all(&self) -> impl Iterator<Item = &Material> {
        self.present.iter().chain(self.added.iter())
    }

    /// The last one of a name.
    pub fn named(&self, name: &str) -> Option<u16> {
        let found = self.all().zip(0..).filter(|(m, _)| m.name == name).last();
        found.map(|(_, number)| number)
    }

    /// That of an equal one, else of one added by a change.
    pub fn number_of(&mut self, material: &Material, changes: &mut Vec<Change>) -> Result<u16> {
        let hash = material.content_hash();
        let found = self.all().position(|m| m.name == material.name && m.content_hash() == hash);
        let number = found.unwrap_or(self.present.len() + self.added.len());
        if found.is_none() {
            self.added.push(material.clone());
            changes.push(Change::AddMaterial(material.clone()));
        }
        u16::try_from(number).map_err(|_| Error::invalid("over 65,535 materials", "merge equal materials"))
    }

    /// The materials of another environment, by their numbers there.
    fn map(&mut self, other: &Environment, changes: &mut Vec<Change>) -> Result<Vec<u16>> {
        other.materials().iter().map(|m| self.number_of(m, changes)).collect()
    }
}

/// The mesh of an object in a scene file, scaled as the object is.
pub(super) fn mesh_of_file(
    path: &Path,
    object: Option<&str>,
    materials: &mut Materials<'_>,
    changes: &mut Vec<Change>,
) -> Result<Arc<Mesh>> {
    let scene = import(path, &ImportOptions::default())?.environment;
    let found = match (object, scene.objects()) {
        (None, [only]) => Some(only),
        (None, _) => None,
        (Some(name), _) => scene.object(name),
    };
    let Some(found) = found else {
        let names: Vec<_> = scene.objects().iter().take(5).map(|o| format!("{:?}", o.name)).collect();
        let what = match object {
            Some(name) => format!("there is no object {name:?}"),
            None => format!("it holds {} objects", scene.objects().len()),
        };
        let remedy = format!("name one as \"from_object\", such as {}", names.join(", "));
        return Err(Error::invalid(what, remedy).in_file(path));
    };
    let map = materials.map(&scene, changes)?;
    // The turn from y-up and the node's scale become part of the shape; where it stood does not.
    let turn = found.world_from_object.rotation_matrix() * found.object_from_mesh.matrix3;
    found.mesh.transformed(turn, |m| map[usize::from(m)]).map(Arc::new).map_err(|e| e.in_file(path))
}

/// The changes by which an environment also holds another one: materials, objects, frames of groups, features. What is there already,
/// equal in everything, stays as it is. An object of the same path, but another content, gives way if it may be replaced;
/// features that are given in its frame stay.
///
/// # Errors
/// [`crate::ErrorKind::Invalid`] if such an object is there and may not be replaced.
pub(super) fn merge_scene(environment: &Environment, scene: &Environment, replace: bool) -> Result<Change> {
    let (mut changes, mut added) = (Vec::new(), Vec::new());
    let map = Materials::new(environment, &mut added).map(scene, &mut changes)?;
    let (ours, theirs) = (hashes(environment.materials()), hashes(scene.materials()));
    let mut meshes: HashMap<*const Mesh, Arc<Mesh>> = HashMap::new();
    let mut attached_to = None;
    for object in scene.objects().iter().filter(|o| !o.is_deleted()) {
        let mut kept = Vec::new();
        if let Some(present) = environment.object(&object.name) {
            let same_shape = present.object_from_mesh == object.object_from_mesh
                && present.first_source == object.first_source
                && present.mesh.content_hash(|m| ours[usize::from(m)])
                    == object.mesh.content_hash(|m| theirs[usize::from(m)]);
            let same_pose = present.world_from_object == object.world_from_object;
            if same_shape && same_pose {
                continue;
            }
            if !replace {
                let what = "it is there already, with another pose or shape";
                let remedy = "give --replace to put that of the file in its place, or give it another name";
                return Err(Error::invalid(what, remedy).at(format!("object {:?}", object.name)));
            }
            let name = object.name.clone();
            if same_shape {
                changes.push(Change::SetPose { name, world_from_object: object.world_from_object });
                continue;
            }
            let all = attached_to.get_or_insert_with(|| attached(environment));
            kept = all.remove(name.as_str()).unwrap_or_default();
            changes.push(Change::DeleteObject { name });
        }
        let mesh = meshes.entry(Arc::as_ptr(&object.mesh));
        let mesh = mesh.or_insert_with(|| Arc::new(object.mesh.with_materials(|m| map[usize::from(m)]))).clone();
        changes.push(Change::InsertObject(NewObject {
            name: object.name.clone(),
            world_from_object: object.world_from_object,
            object_from_mesh: object.object_from_mesh,
            mesh,
            first_source: object.first_source,
        }));
        changes.append(&mut kept);
    }
    merge_groups(environment, scene, replace, &mut changes)?;
    for layer in scene.layers() {
        merge_features(environment, layer, &[], &mut changes);
    }
    Ok(Change::Group(changes))
}

/// The changes that give groups their frames; what is an object here keeps its own.
fn merge_groups(environment: &Environment, scene: &Environment, replace: bool, to: &mut Vec<Change>) -> Result<()> {
    for (path, frame) in scene.groups().into_iter().filter(|(path, _)| environment.object(path).is_none()) {
        let (present, given) = (environment.group(path).copied(), scene.group(path).copied());
        match (present, given) {
            (None, None) => continue,
            (Some(present), _) if present == frame => continue,
            (Some(_), _) if !replace => {
                let what = "its frame is there already, another one";
                let remedy = "give --replace to put that of the file in its place";
                return Err(Error::invalid(what, remedy).at(format!("group {path:?}")));
            }
            _ => to.push(Change::SetFrame { name: path.to_owned(), world_from_group: given }),
        }
    }
    Ok(())
}

/// What brings back the features and covariances that are given in objects' frames, after these were replaced.
fn attached(environment: &Environment) -> HashMap<&str, Vec<Change>> {
    let mut all: HashMap<&str, Vec<Change>> = HashMap::new();
    for FeatureLayer { class, features, pose_covariances, .. } in environment.layers() {
        for feature in features {
            let Some(object) = &feature.object else { continue };
            let change = Change::RestoreFeature { class: class.clone(), feature: Feature::clone(feature) };
            all.entry(object).or_default().push(change);
        }
        for (object, covariance) in pose_covariances {
            let (class, covariance) = (class.clone(), Some(*covariance));
            let change = Change::SetPoseCovariance { class, object: object.clone(), covariance };
            all.entry(object).or_default().push(change);
        }
    }
    all
}

fn hashes(materials: &[Material]) -> Vec<presight_model::environment::ContentHash> {
    materials.iter().map(Material::content_hash).collect()
}

/// The changes that a layer file says: later features win by id.
pub(super) fn merge_layer(environment: &Environment, file: &LayerFile) -> Change {
    let mut changes = Vec::new();
    merge_features(environment, &file.layer, &file.removed, &mut changes);
    Change::Group(changes)
}

fn merge_features(environment: &Environment, layer: &FeatureLayer, removed: &[u32], changes: &mut Vec<Change>) {
    let class = &layer.class;
    let present = environment.layer(class);
    if present.is_none_or(|p| p.tolerance < layer.tolerance) {
        changes.push(Change::SetTolerance { class: class.clone(), tolerance: layer.tolerance });
    }
    let known = |id: u32| environment.feature(class, id);
    for id in removed.iter().filter(|id| known(**id).is_some()) {
        changes.push(Change::DeleteFeature { class: class.clone(), id: *id });
    }
    for feature in &layer.features {
        let (class, feature): (String, Feature) = (class.clone(), Feature::clone(feature));
        match known(feature.id) {
            None => changes.push(Change::InsertFeature { class, feature }),
            Some(present) if *present != feature => changes.push(Change::SetFeature { class, feature }),
            Some(_) => {}
        }
    }
    for (object, covariance) in &layer.pose_covariances {
        let same = |(path, c): &(String, _)| path == object && c == covariance;
        if !present.is_some_and(|p| p.pose_covariances.iter().any(same)) {
            let (class, object) = (class.clone(), object.clone());
            changes.push(Change::SetPoseCovariance { class, object, covariance: Some(*covariance) });
        }
    }
}
