//! Reads what commands name: scenes and sensors.

use crate::acquire::ImportReport;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::index::{Params, Scheme};
use crate::io::gltf::{ImportOptions, import};
use crate::io::materials::Sidecar;
use crate::world::World;
use glam::DVec3;
use std::path::Path;

/// A scene as commands use it.
pub struct Scene {
    /// The world it becomes.
    pub world: World,
    /// Turns the file's frame (y up) into the world's, the sidecar's `world_from_scene` included.
    pub world_from_gltf: Pose,
    /// What the import found.
    pub report: ImportReport,
}

/// Imports a scene; its world gets an index of that scheme.
///
/// # Errors
/// Those of the import.
pub fn scene(path: &Path, options: &ImportOptions, scheme: Scheme) -> Result<Scene> {
    let imported = import(path, options)?;
    let z_up_from_y_up = Pose::from_xyz_rpy(DVec3::ZERO, std::f64::consts::FRAC_PI_2, 0.0, 0.0);
    Ok(Scene {
        world: World::with_index(imported.environment, scheme, Params::tuned(scheme)),
        world_from_gltf: Sidecar::beside(path)?.world_from_scene.then(&z_up_from_y_up),
        report: imported.report,
    })
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
