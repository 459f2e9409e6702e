//! Reads what commands name: scenes and sensors.

use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::sensor::Sensor;
use crate::world::World;
use std::path::Path;

/// How a scene is to be imported.
#[derive(Clone, Copy, Debug)]
pub struct SceneOptions {
    /// Relative tolerance of merging; `None` merges nothing.
    pub merge_tolerance: Option<f64>,
}

/// A scene as commands use it.
pub struct Scene {
    /// The world it becomes.
    pub world: World,
    /// Turns the file's frame into the world's.
    pub world_from_gltf: Pose,
    /// Things to know.
    pub notices: Vec<String>,
}

/// Imports a scene.
///
/// # Errors
/// Those of the import.
pub fn scene(path: &Path, _options: SceneOptions) -> Result<Scene> {
    Err(Error::invalid("import is not there yet", "").in_file(path))
}

/// BLAKE3 of a file, hexadecimal.
///
/// # Errors
/// Those of reading it.
pub fn blake3_of(path: &Path) -> Result<String> {
    let wrap = |e| Error::io(path, "read", e);
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(std::fs::File::open(path).map_err(wrap)?).map_err(wrap)?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// A sensor as sensor TOML.
pub fn sensor_text(sensor: &Sensor) -> String {
    format!("{:?}", sensor.spec())
}
