//! Reads what commands name: scenes and sensors.

#[cfg(feature = "script")]
use super::print;
use glam::DVec3;
#[cfg(not(all(feature = "script", feature = "store", feature = "report")))]
use presight::ErrorKind;
use presight::World;
use presight::acquire::{ImportReport, Imported};
use presight::geometry::Pose;
use presight::index::{Params, Scheme};
use presight::internal::file;
use presight::io::gltf::{ImportOptions, import};
use presight::io::materials::Sidecar;
use presight::limits;
use presight::{Error, Result};
use std::path::{Path, PathBuf};

/// What a store starts with.
const SQLITE: &[u8; 16] = b"SQLite format 3\0";

/// A scene as commands use it.
pub struct Scene {
    /// Where it was read.
    pub path: PathBuf,
    /// The world it becomes.
    pub world: World,
    /// Turns the file's frame (y up) into the world's, the sidecar's `world_from_scene` included.
    pub world_from_gltf: Pose,
    /// What the import found.
    pub report: ImportReport,
}

/// Imports a scene on the threads of the options; its world gets an index of that scheme.
///
/// # Errors
/// Those of the import.
pub fn scene(path: &Path, options: &ImportOptions, scheme: Scheme) -> Result<Scene> {
    let threads = options.threads.started()?;
    if is_store(path) {
        return threads.run(|| stored(path, scheme))?;
    }
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let (imported, world_from_scene) = match extension.as_str() {
        "rhai" => (script(path, options)?, Pose::IDENTITY),
        _ => (import(path, options)?, Sidecar::beside(path)?.world_from_scene),
    };
    let z_up_from_y_up = Pose::from_xyz_rpy(DVec3::ZERO, std::f64::consts::FRAC_PI_2, 0.0, 0.0);
    let world = threads.run(|| World::with_index(imported.environment, scheme, Params::tuned(scheme)))?;
    Ok(Scene {
        path: path.to_owned(),
        world,
        world_from_gltf: world_from_scene * z_up_from_y_up,
        report: imported.report,
    })
}

/// Runs a scene script; what it prints goes to stderr.
#[cfg(feature = "script")]
fn script(path: &Path, options: &ImportOptions) -> Result<Imported> {
    presight::io::script::load(path, options, &mut print::message)
}

#[cfg(not(feature = "script"))]
fn script(path: &Path, _options: &ImportOptions) -> Result<Imported> {
    let what = "this presight was built without scene scripts";
    Err(Error::new(ErrorKind::Unsupported, what, "build it with the cargo feature `script`").in_file(path))
}

/// True for a stored environment, whatever its name.
fn is_store(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("presight")) || file::starts_with(path, SQLITE)
}

/// A store is in presight's frame already.
#[cfg(feature = "store")]
fn stored(path: &Path, scheme: Scheme) -> Result<Scene> {
    let world = presight::io::store::read_world(path, scheme, Params::tuned(scheme))?;
    let mut report = ImportReport::default();
    let mut seen = std::collections::HashSet::new();
    for object in world.environment().objects() {
        let polygons = object.mesh.polygon_count() as u64;
        report.polygons_in_scene += polygons;
        if seen.insert(std::sync::Arc::as_ptr(&object.mesh)) {
            report.polygons_stored += polygons;
        }
    }
    let world_from_gltf = Pose::from_xyz_rpy(DVec3::ZERO, std::f64::consts::FRAC_PI_2, 0.0, 0.0);
    Ok(Scene { path: path.to_owned(), world, world_from_gltf, report })
}

#[cfg(not(feature = "store"))]
fn stored(path: &Path, _scheme: Scheme) -> Result<Scene> {
    Err(no_store().in_file(path))
}

/// What a build without the cargo feature `store` answers.
#[cfg(not(feature = "store"))]
pub fn no_store() -> Error {
    let what = "this presight was built without stored environments";
    Error::new(ErrorKind::Unsupported, what, "build it with the cargo feature `store`")
}

/// What a build without the cargo feature `report` answers.
#[cfg(not(feature = "report"))]
pub fn no_report() -> Error {
    let what = "this presight was built without studies";
    Error::new(ErrorKind::Unsupported, what, "build it with the cargo feature `report`")
}

/// BLAKE3 of a file, hexadecimal.
///
/// # Errors
/// Those of reading it.
pub fn blake3_of(path: &Path) -> Result<String> {
    let file = file::open(path)?;
    if file.limit() > limits::MAX_FILE_BYTES && !file::starts_with(path, SQLITE) {
        // No scene: it is not read for minutes to be told so.
        let what = format!("the file is too large: it has {} bytes", file.limit());
        return Err(Error::invalid(what, format!("{} are the limit", limits::MAX_FILE_BYTES)).in_file(path));
    }
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file).map_err(|e| Error::io(path, "read it", e))?;
    Ok(hasher.finalize().to_hex().to_string())
}

#[cfg(all(test, not(feature = "script")))]
mod tests {
    use super::*;

    #[test]
    fn without_scripts_one_is_refused_with_a_remedy() {
        let e = scene(Path::new("hall.rhai"), &ImportOptions::default(), Scheme::None).err().expect("no scripts");
        assert_eq!((e.kind(), e.file()), (ErrorKind::Unsupported, Some(Path::new("hall.rhai"))));
        assert!(e.remedy().contains("script"), "{e}");
    }
}
