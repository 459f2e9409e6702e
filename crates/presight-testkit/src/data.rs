//! Real scenes and sensors.

use super::skip::skip;
use presight_model::geometry::Pose;
use presight_model::sensor::{Geometry, PRESETS, Sensor};
use presight_model::world::World;
use presight_predict::free_poses::free_poses;
use presight_read::gltf::{ImportOptions, import};
use std::path::PathBuf;

/// The scenes on which every engine is tested.
pub const SCENES: [&str; 5] = ["warehouse_small", "office_willowgarage", "factory_hall", "hospital", "city"];

/// The root of this repository.
pub fn root() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// A file of the shared data; `None` if it is missing and not required.
pub fn file(relative: &str) -> Option<PathBuf> {
    let root = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root().join("../shared/data"), PathBuf::from);
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    let missing = if root.exists() { &path } else { &root };
    skip(&format!("the shared data {} is not there; set PRESIGHT_DATA", missing.display()));
    None
}

/// A scene of the shared data. Without `merge`, triangles stay separate, as with `--ids source`.
pub fn scene(name: &str, merge: bool) -> Option<World> {
    let path = file(&format!("env/{name}.glb"))?;
    let options = ImportOptions { merge, ..ImportOptions::default() };
    Some(World::new(import(path, &options).expect("the scene imports").environment))
}

/// Free poses of a scene.
pub fn poses(world: &World, n: usize, seed: u64) -> Vec<Pose> {
    free_poses(world, n, seed).expect("the scene has free poses")
}

/// Every preset sensor whose rays start at one point, in lines.
pub fn presets() -> Vec<Sensor> {
    let all = PRESETS.iter().map(|p| presight_read::preset(p.name).expect("a sound preset"));
    all.filter(|sensor| !matches!(sensor.spec().geometry, Geometry::Rays(_))).collect()
}

/// A selection of `share` of these. Consecutive poses, or consecutive turns at one pose, cover all of them.
pub fn presets_at(turn: usize, pose: usize, share: usize) -> Vec<Sensor> {
    let all = presets();
    let share = share.min(all.len());
    let first = (turn + pose) * share % all.len();
    all.iter().cycle().skip(first).take(share).cloned().collect()
}
