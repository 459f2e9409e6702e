//! Turns the content of scene and layer files into changes of an environment.

use crate::gltf::{ImportOptions, import};
use crate::layer::LayerFile;
use presight_model::change::Change;
use presight_model::environment::{Environment, Feature, FeatureLayer, Material, Mesh, NewObject};
use presight_model::error::{Error, Result};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Numbers of materials, including materials that are about to be added.
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

    /// Returns the last material with this name.
    pub fn named(&self, name: &str) -> Option<u16> {
        let found = self.all().zip(0..).filter(|(m, _)| m.name == name).last();
        found.map(|(_, number)| number)
    }

    /// Returns the number of an equal material. If there is none, appends a change that adds it.
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

    /// Maps the material numbers of another environment to ours.
    fn map(&mut self, other: &Environment, changes: &mut Vec<Change>) -> Result<Vec<u16>> {
        other.materials().iter().map(|m| self.number_of(m, changes)).collect()
    }
}

/// The mesh of an object in a scene file, with the object's rotation and scale applied; and the notices of the import.
pub(super) fn mesh_of_file(
    path: &Path,
    object: Option<&str>,
    materials: &mut Materials<'_>,
    changes: &mut Vec<Change>,
) -> Result<(Arc<Mesh>, Vec<String>)> {
    let scene = import(path, &ImportOptions::default())?;
    let mesh = mesh_of(&scene.environment, object, materials, changes).map_err(|e| e.in_file(path))?;
    Ok((mesh, scene.report.notices))
}

fn mesh_of(
    scene: &Environment,
    object: Option<&str>,
    materials: &mut Materials<'_>,
    changes: &mut Vec<Change>,
) -> Result<Arc<Mesh>> {
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
        return Err(Error::invalid(what, remedy));
    };
    let map = materials.map(scene, changes)?;
    // The rotation from y-up and the node's scale become part of the shape; its position does not.
    let turn = found.world_from_object.rotation_matrix() * found.object_from_mesh.matrix3;
    found.mesh.transformed(turn, |m| map[usize::from(m)]).map(Arc::new)
}

/// Returns the change that merges a scene into an environment: materials, objects, frames of groups, features. Equal
/// content is not changed. With `replace`, an object of the scene replaces a different object of the same path;
/// features in the frame of the replaced object are kept.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if an object or a group's frame differs and `replace` is false.
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
                let what = "it already exists with another pose or shape";
                let remedy = "use `replace: true` to replace it with the object of the file, or rename one of the two";
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

/// Appends the changes that set the frames of groups. A path that names an object of the environment is skipped.
fn merge_groups(environment: &Environment, scene: &Environment, replace: bool, to: &mut Vec<Change>) -> Result<()> {
    for (path, frame) in scene.groups().into_iter().filter(|(path, _)| environment.object(path).is_none()) {
        let (present, given) = (environment.group(path).copied(), scene.group(path).copied());
        match (present, given) {
            (None, None) => continue,
            (Some(present), _) if present == frame => continue,
            (Some(_), _) if !replace => {
                let what = "it already has another frame";
                let remedy = "use `replace: true` to replace it with the frame of the file";
                return Err(Error::invalid(what, remedy).at(format!("group {path:?}")));
            }
            _ => to.push(Change::SetFrame { name: path.to_owned(), world_from_group: given }),
        }
    }
    Ok(())
}

/// By object, the changes that restore its features and covariances after the object was replaced.
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

/// Returns the change that merges a layer file. Its features replace those of the same id.
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
