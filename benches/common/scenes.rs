//! The scenes that benches can name.

#[path = "office.rs"]
mod office;

use office::{office, office_poses};
use presight_model::environment::Environment;
use presight_model::geometry::Pose;
use presight_model::world::World;
use presight_predict::free_poses::free_poses;
use presight_read::gltf::{ImportOptions, import};
use presight_testkit::hall::{hall_poses, open_hall};
use std::path::{Path, PathBuf};

/// A hall without walls and roof, with 300,000 triangles of 1 to 5 cm.
pub const OPEN_HALL: &str = "open_hall";

/// The path of a scene file: a `.glb` or `.rhai` file in the repository, or a name from the shared data
/// (`PRESIGHT_DATA`, default `../shared/data`).
fn path_of(scene: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    if scene.contains('.') {
        return root.join(scene);
    }
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    data.join("env").join(scene).with_extension("glb")
}

/// The triangle count of a scene of closed rooms such as `office:1000000`.
fn office_triangles(scene: &str) -> Option<usize> {
    scene.strip_prefix("office:").map(|count| count.parse().expect("a number of triangles"))
}

/// The file of a scene that comes from a `.glb`.
#[allow(dead_code, reason = "not every bench asks")]
pub fn glb_of(scene: &str) -> Option<PathBuf> {
    let generated = scene == OPEN_HALL || office_triangles(scene).is_some();
    Some(path_of(scene)).filter(|path| !generated && path.extension().is_some_and(|extension| extension == "glb"))
}

/// The environment of a scene; [`OPEN_HALL`] and offices are generated.
pub fn environment(scene: &str) -> Environment {
    if scene == OPEN_HALL {
        return open_hall(3, 300_000);
    }
    if let Some(count) = office_triangles(scene) {
        return office(count);
    }
    #[cfg(feature = "script")]
    if scene.ends_with(".rhai") {
        let loaded = presight_read::script::load(path_of(scene), &ImportOptions::default(), &mut |_| {});
        return loaded.unwrap_or_else(|e| panic!("{e}")).environment;
    }
    import(path_of(scene), &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}")).environment
}

/// Seeded free poses: in the aisles of the hall, in the first room of an office, and otherwise anywhere in free space.
pub fn poses(scene: &str, world: &World, count: usize) -> Vec<Pose> {
    if scene == OPEN_HALL {
        return hall_poses(world.environment(), 5, count);
    }
    if office_triangles(scene).is_some() {
        return office_poses(count);
    }
    free_poses(world, count, 1995).expect("free poses")
}
