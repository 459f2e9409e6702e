//! One line for everything in a file that presight does not follow or leaves out although it shapes the scene, with the
//! number of objects.

use super::extensions::{INSTANCING, RTC, VISIBILITY, is_known};
use super::nodes::{SceneNode, SceneNodes};
use super::quoted;
use crate::materials::sidecar_path;
use glam::DVec3;
use gltf::json;
use json::material::AlphaMode;
use json::validation::Checked;
use presight_model::environment::Material;
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Names in a line; further ones are counted.
const LISTED: usize = 5;

/// The extensions of a file that the crate `gltf` does not read.
#[derive(Deserialize)]
pub(super) struct FileExtensions {
    #[serde(default)]
    extensions: RootExtensions,
    #[serde(default)]
    meshes: Vec<MeshExtensions>,
    #[serde(default)]
    materials: Vec<MaterialExtensions>,
}

type Names = BTreeMap<String, IgnoredAny>;

#[derive(Default, Deserialize)]
struct RootExtensions {
    #[serde(rename = "CESIUM_RTC")]
    rtc: Option<RelativeToCenter>,
}

#[derive(Deserialize)]
struct RelativeToCenter {
    center: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct MeshExtensions {
    #[serde(default)]
    extensions: Names,
    primitives: Vec<PrimitiveExtensions>,
}

#[derive(Deserialize)]
struct PrimitiveExtensions {
    #[serde(default)]
    extensions: Names,
}

#[derive(Deserialize)]
struct MaterialExtensions {
    #[serde(default)]
    extensions: KnownMaterialExtensions,
}

#[derive(Default, Deserialize)]
struct KnownMaterialExtensions {
    #[serde(rename = "KHR_materials_transmission")]
    transmission: Option<Transmission>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Transmission {
    transmission_factor: Option<f64>,
}

impl MeshExtensions {
    fn names(&self) -> impl Iterator<Item = &str> {
        self.extensions.keys().chain(self.primitives.iter().flat_map(|p| p.extensions.keys())).map(String::as_str)
    }
}

/// A scene, as far as notices are about it.
pub(super) struct Described<'a> {
    pub root: &'a json::Root,
    pub file: &'a FileExtensions,
    /// Its file or name.
    pub path: &'a Path,
    pub scene: &'a SceneNodes,
    /// The materials of the file, with the properties of the sidecar.
    pub materials: &'a [Material],
}

impl Described<'_> {
    /// The extensions that presight does not follow.
    pub fn unfollowed(&self) -> BTreeSet<&str> {
        let used = self.root.extensions_used.iter().map(String::as_str);
        let of_nodes = self.scene.extensions.keys().map(String::as_str);
        let of_meshes =
            self.meshes().into_iter().filter_map(|i| self.file.meshes.get(i)).flat_map(MeshExtensions::names);
        let rtc = self.file.extensions.rtc.as_ref().map(|_| RTC);
        let mut all: BTreeSet<&str> =
            used.chain(of_nodes).chain(of_meshes).chain(rtc).filter(|extension| !is_known(extension)).collect();
        all.extend(self.scene.nodes.iter().any(is_skinned_instance).then_some(INSTANCING));
        all
    }

    /// All lines.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        let unfollowed = self.unfollowed();
        lines.extend(unfollowed.iter().take(4 * LISTED).map(|extension| self.of_extension(extension)));
        let more = unfollowed.len().saturating_sub(4 * LISTED);
        lines.extend((more > 0).then(|| format!("{more} more extensions are not followed")));
        let has_targets = |mesh: usize| {
            let primitives = self.root.meshes.get(mesh).map_or(&[][..], |mesh| &mesh.primitives);
            primitives.iter().any(|p| p.targets.as_ref().is_some_and(|targets| !targets.is_empty()))
        };
        let morphed = self.objects_with(has_targets);
        lines.extend(
            (morphed > 0)
                .then(|| format!("morph targets are not followed: the base shape is used ({})", objects(morphed))),
        );
        lines.extend(self.see_through());
        let hidden = self.scene.hidden;
        lines.extend(
            (hidden > 0).then(|| format!("{VISIBILITY} hides objects: they are left out ({})", objects(hidden))),
        );
        lines
    }

    fn of_extension(&self, extension: &str) -> String {
        let count = objects(self.users(extension));
        let center = self.file.extensions.rtc.as_ref().and_then(|rtc| rtc.center);
        let Some(center) = center.filter(|_| extension == RTC) else {
            let extension = quoted(extension);
            return format!("extension {extension} is not followed: the data without it is used ({count})");
        };
        let away = kilometres(DVec3::from_array(center).length());
        let sidecar = name_of(&sidecar_path(self.path));
        format!(
            "extension \"{RTC}\" is not followed: the scene stays at its own origin, {away} from the center {center:?} \
             ({count}); give that place as world_from_scene in {sidecar}, where it keeps all its digits"
        )
    }

    /// Number of objects at or below nodes with an extension, or with meshes that have it. `CESIUM_RTC` concerns all.
    fn users(&self, extension: &str) -> usize {
        let meshes = self.meshes().into_iter();
        let with = |mesh: &usize| self.file.meshes.get(*mesh).is_some_and(|m| m.names().any(|name| name == extension));
        let meshes: BTreeSet<usize> = meshes.filter(with).collect();
        let nodes = self.scene.extensions.get(extension);
        let mut concerned: Vec<bool> = Vec::with_capacity(self.scene.nodes.len());
        let mut count = 0;
        for node in &self.scene.nodes {
            let own = nodes.is_some_and(|nodes| nodes.contains(&node.node))
                || node.mesh.is_some_and(|mesh| meshes.contains(&mesh))
                || (extension == INSTANCING && is_skinned_instance(node))
                || extension == RTC;
            concerned.push(own || node.parent.is_some_and(|parent| concerned[parent]));
            count += usize::from(concerned[concerned.len() - 1] && node.mesh.is_some());
        }
        count
    }

    /// The meshes of the scene.
    fn meshes(&self) -> BTreeSet<usize> {
        self.scene.nodes.iter().filter_map(|node| node.mesh).collect()
    }

    /// Number of objects whose mesh has a property.
    fn objects_with(&self, has: impl Fn(usize) -> bool) -> usize {
        let meshes: BTreeSet<usize> = self.meshes().into_iter().filter(|mesh| has(*mesh)).collect();
        self.scene.nodes.iter().filter(|node| node.mesh.is_some_and(|mesh| meshes.contains(&mesh))).count()
    }

    /// Materials that a renderer shows see-through, unless the user has given their appearance to a sensor.
    fn see_through(&self) -> Option<String> {
        let is_see_through = |i: usize| {
            let blends = self.root.materials[i].alpha_mode == Checked::Valid(AlphaMode::Blend);
            let transmission = self.file.materials.get(i).and_then(|m| m.extensions.transmission.as_ref());
            let transmits = transmission.is_some_and(|t| t.transmission_factor.unwrap_or(0.0) > 0.0);
            (blends || transmits) && self.materials[i].appearance.is_empty()
        };
        let all: BTreeSet<usize> = (0..self.root.materials.len()).filter(|&i| is_see_through(i)).collect();
        let of_mesh = |mesh: usize| {
            let primitives = self.root.meshes.get(mesh).map_or(&[][..], |mesh| &mesh.primitives);
            primitives.iter().filter_map(|p| p.material).map(|m| m.value()).filter(|m| all.contains(m))
        };
        let used: BTreeSet<&str> =
            self.meshes().into_iter().flat_map(of_mesh).map(|m| self.materials[m].name.as_str()).collect();
        let first = used.first()?;
        let count = objects(self.objects_with(|mesh| of_mesh(mesh).next().is_some()));
        let names = listed(used.iter().map(|name| quoted(name)), used.len());
        let (first, sidecar) = (quoted(first), name_of(&sidecar_path(self.path)));
        Some(format!(
            "see-through materials are opaque here: {names} ({count}); to change that, write \
             material.{first}.classes.laser = \"transparent\" below format = 1 in {sidecar}"
        ))
    }
}

/// A skin ignores the transform of its node, and with it the instances.
fn is_skinned_instance(node: &SceneNode) -> bool {
    node.instances.is_some() && node.skin.is_some() && node.mesh.is_some()
}

/// Objects that are left out for one reason: their number, and the first of them.
#[derive(Default)]
pub(super) struct LeftOut {
    count: usize,
    first: Vec<String>,
}

impl LeftOut {
    pub fn add(&mut self, place: impl FnOnce() -> String) {
        self.count += 1;
        self.first.extend((self.count <= LISTED).then(place));
    }

    /// The notice about them, if there are any.
    pub fn notice(&self, why: &str) -> Option<String> {
        let names = listed(self.first.iter().cloned(), self.count);
        (self.count > 0).then(|| format!("left out, because {why}: {names} ({})", objects(self.count)))
    }
}

/// A number of objects in words.
pub(super) fn objects(count: usize) -> String {
    if count == 1 { "1 object".into() } else { format!("{count} objects") }
}

/// The first names, and the number of the others. `count`: of all.
fn listed(names: impl Iterator<Item = String>, count: usize) -> String {
    let shown: Vec<String> = names.take(LISTED).collect();
    let more = count - shown.len();
    let shown = shown.join(", ");
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}

/// A length in metres, in kilometres.
pub(super) fn kilometres(metres: f64) -> String {
    format!("{:.1} km", metres / 1000.0)
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
