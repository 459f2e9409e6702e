//! Turns a scene into a change of an environment.

use super::merge::{Materials, merge_features};
use super::pair::{MeshHashes, Pairing, live};
use presight_model::change::Change;
use presight_model::environment::{Environment, Feature, FeatureLayer, Mesh, NewObject, Object};
use presight_model::error::{Error, Result};
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

/// What happens to stored objects when a scene is merged that has them with other content, or lacks them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// An object with other content is an error.
    Keep,
    /// Objects get the pose and the shape that the scene gives them. Features in their frame stay.
    Replace,
    /// As `Replace`, and objects that the scene lacks are deleted, with the features in their frame.
    Mirror,
}

/// The change that merges a scene, and lists of its effects. Objects are named by their paths in the store.
#[derive(Clone, Debug)]
pub struct SceneMerge {
    /// The change.
    pub change: Change,
    /// Objects that the store lacks.
    pub added: Vec<String>,
    /// Objects that get another pose.
    pub moved: Vec<String>,
    /// Objects that get another shape, and perhaps another pose.
    pub reshaped: Vec<String>,
    /// Number of objects that get only other numbers of their source triangles. Only [`Existing::Mirror`] does this.
    pub renumbered: usize,
    /// Groups that get another frame.
    pub reframed: Vec<String>,
    /// Stored objects that the scene lacks. [`Existing::Mirror`] deletes them.
    pub missing: Vec<String>,
    /// Class and id of the features that are deleted with their objects.
    pub features: Vec<(String, u32)>,
    /// Objects and groups whose repeated name has another number in the store: the path in the scene, and in the store.
    pub renamed: Vec<(String, String)>,
    /// Repeated paths of the scene that several pairings fit equally well.
    pub ties: Vec<String>,
}

/// Merges a scene into an environment.
struct Merger<'a> {
    environment: &'a Environment,
    scene: &'a Environment,
    existing: Existing,
    merge: SceneMerge,
    changes: Vec<Change>,
    /// By object, the changes that restore its features after it was replaced.
    attached: Option<HashMap<&'a str, Vec<Change>>>,
    /// The meshes of the scene, with the store's materials.
    meshes: HashMap<*const Mesh, Arc<Mesh>>,
}

/// Returns the change that merges a scene into an environment: materials, objects, frames of groups, features. Equal
/// content is not changed.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if an object or a group's frame differs and existing ones are kept.
pub(super) fn merge_scene(environment: &Environment, scene: &Environment, existing: Existing) -> Result<SceneMerge> {
    let (mut changes, mut added) = (Vec::new(), Vec::new());
    let map = Materials::new(environment, &mut added).map(scene, &mut changes)?;
    let (mut ours, mut theirs) = (MeshHashes::new(environment), MeshHashes::new(scene));
    let pairing = Pairing::new(environment, scene, [&mut ours, &mut theirs]);
    let kept: BTreeSet<&str> = live(scene).map(|o| pairing.name(&o.name)).collect();
    let missing: Vec<&str> = live(environment).map(|o| o.name.as_str()).filter(|name| !kept.contains(name)).collect();
    let merge = SceneMerge {
        change: Change::NOTHING,
        added: Vec::new(),
        moved: Vec::new(),
        reshaped: Vec::new(),
        renumbered: 0,
        reframed: Vec::new(),
        missing: missing.iter().map(|name| (*name).to_owned()).collect(),
        features: Vec::new(),
        renamed: pairing.renamed.clone(),
        ties: pairing.ties.clone(),
    };
    let (attached, meshes) = (None, HashMap::new());
    let mut merger = Merger { environment, scene, existing, merge, changes, attached, meshes };
    if existing == Existing::Mirror {
        merger.delete(&missing);
    }
    for object in live(scene) {
        let is_same = |present: &Object| {
            let same_mesh = ours.of(&present.mesh) == theirs.of(&object.mesh);
            same_mesh && present.object_from_mesh == object.object_from_mesh
        };
        merger.object(object, pairing.name(&object.name), is_same, &map)?;
    }
    merger.groups(&pairing)?;
    merger.features(&pairing);
    Ok(SceneMerge { change: Change::Group(merger.changes), ..merger.merge })
}

impl<'a> Merger<'a> {
    /// Deletes stored objects, and lists the features that go with them.
    fn delete(&mut self, missing: &[&str]) {
        let gone: BTreeSet<&str> = missing.iter().copied().collect();
        for layer in self.environment.layers() {
            let goes = |f: &&Arc<Feature>| f.object.as_deref().is_some_and(|object| gone.contains(object));
            self.merge.features.extend(layer.features.iter().filter(goes).map(|f| (layer.class.clone(), f.id)));
        }
        self.changes.extend(missing.iter().map(|name| Change::DeleteObject { name: (*name).to_owned() }));
    }

    /// Merges an object of the scene, which has this name in the store. `map` gives the store's number for each of its
    /// materials.
    fn object(
        &mut self,
        object: &Object,
        name: &str,
        is_same: impl FnOnce(&Object) -> bool,
        map: &[u16],
    ) -> Result<()> {
        let named = || name.to_owned();
        let Some(present) = self.environment.object(name) else {
            self.merge.added.push(named());
            self.insert(object, name, map);
            return Ok(());
        };
        let same_shape = is_same(present);
        let same_pose = present.world_from_object == object.world_from_object;
        if self.existing == Existing::Keep && !(same_shape && same_pose) {
            let what = "it already exists with another pose or shape";
            let remedy = "use `Existing::Replace` to replace it with the object of the file, or rename one of the two";
            return Err(Error::invalid(what, remedy).at(format!("object {name:?}")));
        }
        // An object keeps the numbers of its source triangles, unless the store is to become equal to the scene: one
        // new object in the file shifts the numbers of all objects behind it.
        let same_source = self.existing != Existing::Mirror || present.first_source == object.first_source;
        match (same_shape, same_pose) {
            (true, true) if same_source => return Ok(()),
            (true, true) => self.merge.renumbered += 1,
            (true, false) => self.merge.moved.push(named()),
            (false, _) => self.merge.reshaped.push(named()),
        }
        if same_shape && same_source {
            self.changes.push(Change::SetPose { name: named(), world_from_object: object.world_from_object });
            return Ok(());
        }
        let environment = self.environment;
        let all = self.attached.get_or_insert_with(|| attached(environment));
        let mut kept = all.remove(name).unwrap_or_default();
        self.changes.push(Change::DeleteObject { name: named() });
        self.insert(object, name, map);
        self.changes.append(&mut kept);
        Ok(())
    }

    fn insert(&mut self, object: &Object, name: &str, map: &[u16]) {
        let mesh = self.meshes.entry(Arc::as_ptr(&object.mesh));
        let mesh = mesh.or_insert_with(|| Arc::new(object.mesh.with_materials(|m| map[usize::from(m)]))).clone();
        self.changes.push(Change::InsertObject(NewObject {
            name: name.to_owned(),
            world_from_object: object.world_from_object,
            object_from_mesh: object.object_from_mesh,
            mesh,
            first_source: object.first_source,
        }));
    }

    /// Sets the frames of groups. A path that stays an object of the store is skipped.
    fn groups(&mut self, pairing: &Pairing) -> Result<()> {
        let gone: BTreeSet<&str> = match self.existing {
            Existing::Mirror => self.merge.missing.iter().map(String::as_str).collect(),
            _ => BTreeSet::new(),
        };
        for (path, frame) in self.scene.groups() {
            let (name, given) = (pairing.name(path), self.scene.group(path).copied());
            let present = match self.environment.object(name) {
                // A deleted object leaves its pose as a frame.
                Some(object) if gone.contains(name) => Some(object.world_from_object),
                Some(_) => continue,
                None => self.environment.group(name).copied(),
            };
            match (present, given) {
                _ if present == given => continue,
                (Some(present), _) if present == frame && self.existing != Existing::Mirror => continue,
                (Some(_), _) if self.existing == Existing::Keep => {
                    let what = "it already has another frame";
                    let remedy = "use `Existing::Replace` to replace it with the frame of the file";
                    return Err(Error::invalid(what, remedy).at(format!("group {name:?}")));
                }
                _ => {}
            }
            self.merge.reframed.push(name.to_owned());
            self.changes.push(Change::SetFrame { name: name.to_owned(), world_from_group: given });
        }
        Ok(())
    }

    /// Merges the layers of the scene, whose objects may have other names in the store.
    fn features(&mut self, pairing: &Pairing) {
        for layer in self.scene.layers() {
            let mut layer = FeatureLayer::clone(layer);
            let name = |object: &mut String| *object = pairing.name(object).to_owned();
            layer.features.iter_mut().filter(|f| f.object.is_some()).for_each(|feature| {
                Arc::make_mut(feature).object.iter_mut().for_each(name);
            });
            layer.pose_covariances.iter_mut().for_each(|(object, _)| name(object));
            merge_features(self.environment, &layer, &[], &mut self.changes);
        }
    }
}

/// By object, the changes that restore its features, covariances, marks and trust after the object was replaced.
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
    for (name, mark) in environment.marks() {
        let change = Change::SetMark { name: name.to_owned(), mark: mark.clone() };
        all.entry(&mark.object).or_default().push(change);
    }
    for (object, trust) in environment.trusts() {
        let change = Change::SetTrust { object: object.to_owned(), trust: Some(*trust) };
        all.entry(object).or_default().push(change);
    }
    all
}
