//! Reads what commands name: scenes and sensors.

use super::print;
use crate::acquire::{ImportReport, Imported};
#[cfg(not(feature = "script"))]
use crate::error::ErrorKind;
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
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let (imported, world_from_scene) = match extension.as_str() {
        "rhai" => (script(path, options)?, Pose::IDENTITY),
        _ => (import(path, options)?, Sidecar::beside(path)?.world_from_scene),
    };
    let z_up_from_y_up = Pose::from_xyz_rpy(DVec3::ZERO, std::f64::consts::FRAC_PI_2, 0.0, 0.0);
    Ok(Scene {
        world: World::with_index(imported.environment, scheme, Params::tuned(scheme)),
        world_from_gltf: world_from_scene.then(&z_up_from_y_up),
        report: imported.report,
    })
}

/// Runs a scene script; what it prints goes to stderr.
#[cfg(feature = "script")]
fn script(path: &Path, options: &ImportOptions) -> Result<Imported> {
    crate::io::script::load(path, options, &mut print::message)
}

#[cfg(not(feature = "script"))]
fn script(path: &Path, _options: &ImportOptions) -> Result<Imported> {
    let what = "this presight was built without scene scripts";
    Err(Error::new(ErrorKind::Unsupported, what, "build it with the cargo feature `script`").in_file(path))
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
