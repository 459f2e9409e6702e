//! Turns the content of layer files, and of objects in scene files, into changes of an environment.

use presight_model::change::Change;
use presight_model::environment::{Environment, Feature, FeatureLayer, Material, Mesh};
use presight_model::error::{Error, Result};
use presight_read::gltf::{ImportOptions, import};
use presight_read::layer::LayerFile;
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

    /// The names of all materials.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.all().map(|m| m.name.as_str())
    }

    /// Returns the last material with this name.
    pub fn named(&self, name: &str) -> Option<u16> {
        let found = self.all().zip(0..).filter(|(m, _)| m.name == name).last();
        found.map(|(_, number)| number)
    }

    /// Returns the number of an equal material; appends a change that adds it if the environment lacks it.
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
    pub fn map(&mut self, other: &Environment, changes: &mut Vec<Change>) -> Result<Vec<u16>> {
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

/// Returns the change that merges a layer file. Its features replace features of the same id.
pub(super) fn merge_layer(environment: &Environment, file: &LayerFile) -> Change {
    let mut changes = Vec::new();
    merge_features(environment, &file.layer, &file.removed, &mut changes);
    Change::Group(changes)
}

/// Appends the changes that merge a layer.
pub(super) fn merge_features(
    environment: &Environment,
    layer: &FeatureLayer,
    removed: &[u32],
    changes: &mut Vec<Change>,
) {
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
