//! Scenes and stores.

use super::arrays::{mesh_of, pose_numbers, pose_of};
use super::errors::{Failed, apart, raised, usage, warn};
use super::process::Shared;
use glam::Vec3;
use presight::environment::{Environment, Material, NewObject};
use presight::files::{ImportOptions, SceneFrame, Up, mesh_of_triangles};
use presight::store::{Note, Store as OurStore};
use presight::{Change, Error, Pose, Scene as Ours, SceneOptions, World};
use presight_cli::summary::objects_in;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

/// What a prediction needs of a scene.
pub struct Seen {
    pub world: World,
    pub world_from_gltf: Pose,
    /// Objects that are not deleted.
    pub objects: usize,
    pub path: PathBuf,
}

struct Held {
    scene: Ours,
    objects: usize,
}

/// A model of the robot's environment: objects with poses, polygons, materials and feature layers.
///
/// `Scene.open` reads what the command reads, `Scene.from_meshes` takes arrays. `move`, `insert`, `delete` and `apply` change the scene in
/// memory only; a prediction that runs keeps the version with which it began. Scenes pickle by content.
///
/// >>> import presight
/// >>> room = presight.Scene.example()
/// >>> room.objects[:2]
/// ['room/building/floor', 'room/building/ceiling']
#[pyclass(frozen, module = "presight")]
pub struct Scene {
    held: Mutex<Held>,
    notices: Vec<String>,
    messages: Vec<String>,
}

impl Scene {
    fn of(scene: Ours, messages: Vec<String>) -> Self {
        let objects = objects_in(scene.world.environment());
        let notices = scene.report.notices.clone();
        Self { held: Mutex::new(Held { scene, objects }), notices, messages }
    }

    /// Calls `look` with the scene; only work apart from the interpreter may wait for it.
    fn look<T: Send>(&self, py: Python<'_>, look: impl FnOnce(&mut Ours) -> Result<T, Error> + Send) -> PyResult<T> {
        apart(py, || Ok(look(&mut self.held.lock().unwrap_or_else(PoisonError::into_inner).scene)?))
    }

    /// Applies changes, all or none.
    fn change(
        &self,
        py: Python<'_>,
        change: impl FnOnce(&mut World) -> Result<Vec<String>, Error> + Send,
    ) -> PyResult<()> {
        let notices = apart(py, || {
            let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
            let notices = change(&mut held.scene.world)?;
            held.objects = objects_in(held.scene.world.environment());
            Ok(notices)
        })?;
        warn(py, &notices)
    }

    /// The version of now.
    pub fn seen(&self) -> Seen {
        let held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let Held { scene, objects } = &*held;
        let (world, path) = (scene.world.clone(), scene.path.clone());
        Seen { world, world_from_gltf: scene.world_from_gltf, objects: *objects, path }
    }

    /// A copy of the whole scene, for its layers.
    pub fn whole(&self) -> Ours {
        self.held.lock().unwrap_or_else(PoisonError::into_inner).scene.clone()
    }
}

/// Where a mesh of arrays goes.
struct Part {
    name: String,
    vertices: Vec<Vec3>,
    faces: Vec<[u32; 3]>,
    pose: Pose,
}

/// A mesh of arrays as a new object, and a notice of the triangles that were left out.
fn object(part: Part, material: u16) -> Result<(NewObject, Option<String>), Error> {
    let Part { name, vertices, faces, pose } = part;
    presight::tools::check_name(&name)?;
    let tolerance = ImportOptions::default().merge_tolerance;
    let (mesh, flat) = mesh_of_triangles(&name, &vertices, &faces, material, tolerance)?;
    let notice = (flat > 0).then(|| format!("mesh {name:?}: {flat} triangles without an area are left out"));
    Ok((NewObject::new(name, pose, Arc::new(mesh)), notice))
}

#[pymethods]
impl Scene {
    /// Opens a glTF model (.glb, .gltf) with its sidecar, a script (.rhai) or a store (.presight).
    ///
    /// `up` is the axis of the file that points up, "y" or "z"; `scale` the metres in one of its units; `exclude` names objects and
    /// groups to leave out. Problems of the file are warnings (`Notice`). Raises `Error` for an invalid file.
    #[staticmethod]
    #[pyo3(signature = (path, up = None, scale = None, exclude = Vec::new()))]
    fn open(
        py: Python<'_>,
        path: PathBuf,
        up: Option<&str>,
        scale: Option<f64>,
        exclude: Vec<String>,
    ) -> PyResult<Self> {
        let up =
            up.map(str::parse::<Up>).transpose().map_err(|e| raised(py, &Error::usage(e.to_string(), "").at("up")))?;
        scale.map_or(Ok(()), SceneFrame::check_scale).map_err(|e| raised(py, &e.at("scale")))?;
        let import = ImportOptions { up, scale, ..ImportOptions::default() };
        let options = SceneOptions::default().with_import(import).with_exclude(&exclude);
        let scene = apart(py, || {
            let mut messages = Vec::new();
            let scene = Ours::open_with(&path, &options, &mut |line| messages.push(line.to_owned()))?;
            Ok(Self::of(scene, messages))
        })?;
        warn(py, &scene.notices)?;
        Ok(scene)
    }

    /// A furnished room, 6 m x 4.5 m, for first steps.
    ///
    /// >>> len(presight.Scene.example().objects) > 5
    /// True
    #[staticmethod]
    fn example(py: Python<'_>) -> PyResult<Self> {
        apart(py, || Ok(Self::of(Ours::example()?, Vec::new())))
    }

    /// Makes a scene of arrays: for each name, vertices (n, 3) in metres and triangles (m, 3), or an object with `vertices` and
    /// `faces` (trimesh) or `triangles` (Open3D). z is up. `poses` places them by name; without a pose a mesh is in the world's frame.
    ///
    /// Vertices are rounded to float32; place a mesh that is far away by its pose. Raises `Error`, naming the mesh.
    ///
    /// >>> corners, faces = [[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]], [[0, 1, 2], [0, 2, 3]]
    /// >>> hall = presight.Scene.from_meshes({"floor": (corners, faces)}, poses={"floor": [0, 0, -1, 0, 0, 0]})
    /// >>> hall.objects
    /// ['floor']
    #[staticmethod]
    #[pyo3(signature = (meshes, poses = None))]
    fn from_meshes(py: Python<'_>, meshes: &Bound<'_, PyDict>, poses: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut parts = Vec::with_capacity(meshes.len());
        for (name, mesh) in meshes {
            let name: String = name.extract()?;
            let (vertices, faces) = mesh_of(&mesh, &name)?;
            let pose = poses.and_then(|poses| poses.get_item(&name).transpose()).transpose()?;
            let pose = pose.map_or(Ok(Pose::IDENTITY), |pose| pose_of(&pose, &format!("poses[{name:?}]")))?;
            parts.push(Part { name, vertices, faces, pose });
        }
        for name in poses.into_iter().flat_map(|poses| poses.keys()) {
            if !meshes.contains(&name)? {
                return Err(usage(
                    py,
                    "poses",
                    format!("there is no mesh {}", name.repr()?),
                    "use the names of meshes",
                ));
            }
        }
        let (scene, notices) = apart(py, || {
            let (mut environment, mut notices) = (Environment::new(), Vec::new());
            let material = environment.add_material(Material::named("default"))?;
            for part in parts {
                let (object, notice) = object(part, material)?;
                environment.insert(object)?;
                notices.extend(notice);
            }
            Ok((Self::of(Ours::of_world("meshes", World::new(environment)), Vec::new()), notices))
        })?;
        warn(py, &notices)?;
        Ok(scene)
    }

    /// The objects by `object_id` - 1; deleted ones are empty texts.
    #[getter]
    fn objects(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        let name = |o: &presight::environment::Object| if o.is_deleted() { String::new() } else { o.name.clone() };
        self.look(py, |scene| Ok(scene.world.environment().objects().iter().map(name).collect()))
    }

    /// The pose of an object: (7,) x y z qx qy qz qw.
    ///
    /// >>> room.pose("room/door/leaf").shape
    /// (7,)
    fn pose<'py>(&self, py: Python<'py>, path: &str) -> PyResult<Bound<'py, PyAny>> {
        let pose = self.look(py, |scene| {
            let environment = scene.world.environment();
            Ok(environment.objects()[environment.index_of(path)? as usize].world_from_object)
        })?;
        super::arrays::array(py, pose_numbers(&pose).to_vec(), &[7])
    }

    /// Moves an object, or a group, with everything below its path.
    ///
    /// >>> room.move("room/table", [1, 1, 0, 0, 0, 30])
    #[pyo3(name = "move")]
    fn move_to(&self, py: Python<'_>, path: String, pose: &Bound<'_, PyAny>) -> PyResult<()> {
        let world_from_object = pose_of(pose, "pose")?;
        self.change(py, |world| {
            world.apply(Change::MoveObject { name: path, world_from_object })?;
            Ok(Vec::new())
        })
    }

    /// Adds an object: a mesh as `from_meshes` takes it, at a pose. The path must be free; `material` is the name of one of the
    /// scene's, or of another, which is opaque.
    #[pyo3(signature = (path, mesh, pose = None, material = "default"))]
    fn insert(
        &self,
        py: Python<'_>,
        path: String,
        mesh: &Bound<'_, PyAny>,
        pose: Option<&Bound<'_, PyAny>>,
        material: &str,
    ) -> PyResult<()> {
        let (vertices, faces) = mesh_of(mesh, &path)?;
        let pose = pose.map_or(Ok(Pose::IDENTITY), |pose| pose_of(pose, "pose"))?;
        self.change(py, |world| {
            let environment = world.environment();
            if environment.object(&path).is_some() {
                return Err(Error::invalid("it already exists", "delete it first").at(format!("object {path:?}")));
            }
            let known = environment.materials().iter().position(|m| m.name == material);
            let number = known.unwrap_or(environment.materials().len()) as u16;
            let (object, notice) = object(Part { name: path, vertices, faces, pose }, number)?;
            let added = known.is_none().then(|| Change::AddMaterial(Material::named(material)));
            world.apply(Change::of(added.into_iter().chain([Change::InsertObject(object)]).collect()))?;
            Ok(notice.into_iter().collect())
        })
    }

    /// Deletes an object with its features, or a group with all objects below it. Other objects keep their ids.
    fn delete(&self, py: Python<'_>, path: String) -> PyResult<()> {
        self.change(py, |world| {
            world.apply(Change::DeleteObject { name: path })?;
            Ok(Vec::new())
        })
    }

    /// Applies a change in the JSON of `presight env apply`, in memory only; `Store.apply` writes. Files that it names are relative to
    /// `folder`.
    ///
    /// >>> room.apply('{"op": "delete_object", "object": "room/lamp"}')
    /// >>> "room/lamp" in room.objects
    /// False
    #[pyo3(signature = (json, folder = PathBuf::from(".")))]
    fn apply(&self, py: Python<'_>, json: &str, folder: PathBuf) -> PyResult<()> {
        self.change(py, |world| presight::store::apply_line(world, json, &folder))
    }

    /// A scene with the same content, which later changes of this one do not reach.
    fn copy(&self, py: Python<'_>) -> PyResult<Self> {
        let scene = self.look(py, |scene| Ok(scene.clone()))?;
        Ok(Self { messages: self.messages.clone(), ..Self::of(scene, Vec::new()) })
    }

    /// The file, or the name of a scene from memory.
    #[getter]
    fn path(&self, py: Python<'_>) -> PyResult<String> {
        self.look(py, |scene| Ok(scene.path.display().to_string()))
    }

    /// Number of the version: each change makes the next.
    #[getter]
    fn version(&self, py: Python<'_>) -> PyResult<u64> {
        self.look(py, |scene| Ok(scene.world.version()))
    }

    /// Least and greatest coordinates of everything: ((x, y, z), (x, y, z)), metres.
    #[getter]
    fn bounds(&self, py: Python<'_>) -> PyResult<([f64; 3], [f64; 3])> {
        let bounds = self.look(py, |scene| Ok(scene.world.environment().bounds()))?;
        Ok((bounds.min.to_array(), bounds.max.to_array()))
    }

    /// Problems of the file, one line each.
    #[getter]
    fn notices(&self) -> Vec<String> {
        self.notices.clone()
    }

    /// What a script printed.
    #[getter]
    fn messages(&self) -> Vec<String> {
        self.messages.clone()
    }

    /// The BLAKE3 hash of the content: equal for equal scenes, wherever they come from.
    fn content_hash(&self, py: Python<'_>) -> PyResult<String> {
        self.look(py, |scene| Ok(scene.world.environment().content_hash().to_string()))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        self.look(py, |scene| {
            Ok(format!(
                "<presight.Scene {} of {} objects>",
                scene.path.display(),
                objects_in(scene.world.environment())
            ))
        })
    }

    /// By content: the bytes of a store with its hash.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let scene = self.look(py, |scene| Ok(scene.clone()))?;
        let (bytes, hash) = apart(py, || {
            let environment = scene.world.environment();
            let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), "make a folder", e))?;
            let file = folder.path().join("scene.presight");
            presight::store::create(&file, environment, &Note::new("a pickle", 0.0))?;
            let bytes = std::fs::read(&file).map_err(|e| Error::io(&file, "read it", e))?;
            Ok((bytes, environment.content_hash().to_string()))
        })?;
        let excluded: Vec<String> = scene.excluded.iter().cloned().collect();
        let state = (
            PyBytes::new(py, &bytes),
            hash,
            scene.path.to_string_lossy().into_owned(),
            pose_numbers(&scene.world_from_gltf),
            excluded,
        );
        Ok((py.get_type::<Self>().getattr("_restored")?, state.into_pyobject(py)?.into_any()))
    }

    #[staticmethod]
    fn _restored(
        py: Python<'_>,
        bytes: &[u8],
        hash: &str,
        path: PathBuf,
        axes: [f64; 7],
        excluded: Vec<String>,
    ) -> PyResult<Self> {
        let axes = super::arrays::exact_pose(axes);
        apart(py, || {
            let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), "make a folder", e))?;
            let file = folder.path().join("scene.presight");
            std::fs::write(&file, bytes).map_err(|e| Error::io(&file, "write it", e))?;
            let mut scene = Ours::open(&file).map_err(|e| e.in_place().at("the pickle of a scene"))?;
            let found = scene.world.environment().content_hash().to_string();
            if found != hash {
                let what = format!("its content is {found}, and {hash} was pickled");
                return Err(Error::invalid(what, "pickle the scene again").at("the pickle of a scene").into());
            }
            (scene.path, scene.world_from_gltf, scene.files) = (path, axes, Vec::new());
            scene.excluded = excluded.into_iter().collect::<BTreeSet<_>>();
            Ok(Self::of(scene, Vec::new()))
        })
    }
}

/// A stored environment, opened for changes: one file, with a log of all that was changed and why.
///
/// It holds the file's write lock until it is closed, or left as a context. Other processes can read the file meanwhile.
///
/// >>> import presight, tempfile, os
/// >>> path = os.path.join(tempfile.mkdtemp(), "room.presight")
/// >>> with presight.Store.create(path, presight.Scene.example(), cause="a first survey") as store:
/// ...     number = store.apply('{"op": "move", "object": "room/table", "pose": [1, 1, 0, 0, 0, 0]}', cause="moved")
/// >>> number, presight.Scene.open(path).objects[36]
/// (1, 'room/table/top')
#[pyclass(frozen, module = "presight")]
pub struct Store {
    path: PathBuf,
    /// Empty in a process that has not opened it.
    open: Shared<Option<OurStore>>,
}

impl Store {
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut OurStore) -> Result<T, Error> + Send,
    ) -> PyResult<T> {
        let closed = || Error::usage("the store is closed, or was opened by another process", "open it again");
        apart(py, || self.open.with(|| Ok(None), |store| Ok(work(store.as_mut().ok_or_else(closed)?)?)))
    }
}

#[pymethods]
impl Store {
    /// Opens a store and takes its write lock. Raises `SystemFault` if another writer has it.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        apart(py, || {
            let (store, open) = (OurStore::open(&path)?, Shared::new());
            open.with(|| Ok(Some(store)), |_| Ok::<_, Failed>(()))?;
            Ok(Self { path, open })
        })
    }

    /// Stores a scene in a new file and opens it.
    #[staticmethod]
    #[pyo3(signature = (path, scene, cause = "created"))]
    fn create(py: Python<'_>, path: PathBuf, scene: &Bound<'_, Scene>, cause: &str) -> PyResult<Self> {
        let (scene, note) = (scene.get(), Note::new(cause, now()));
        apart(py, || Ok(presight::store::create(&path, scene.seen().world.environment(), &note)?))?;
        Self::new(py, path)
    }

    /// Applies a change in the JSON of `presight env apply`, and returns its number in the log once it is on disk. `cause` and `time`
    /// (UTC seconds, by default now) go into the log.
    #[pyo3(signature = (json, cause = "", time = None))]
    fn apply(&self, py: Python<'_>, json: &str, cause: &str, time: Option<f64>) -> PyResult<u64> {
        let note = Note::new(cause, time.unwrap_or_else(now));
        let (number, notices) = self.with(py, |store| {
            let mut batch = store.batch()?;
            let (number, _) = batch.apply_line(json, Path::new("."), &note)?;
            let notices = batch.take_notices();
            batch.commit()?;
            Ok((number, notices))
        })?;
        warn(py, &notices)?;
        Ok(number)
    }

    /// The stored scene with all changes so far, in memory.
    fn scene(&self, py: Python<'_>) -> PyResult<Scene> {
        let path = self.path.clone();
        self.with(py, |store| Ok(Scene::of(Ours::of_world(path, store.world().clone()), Vec::new())))
    }

    /// Number of changes in the log.
    #[getter]
    fn changes(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |store| Ok(store.changes()))
    }

    /// Gives the write lock back.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let close = |store: &mut Option<OurStore>| {
            *store = None;
            Ok(())
        };
        apart(py, || self.open.with(|| Ok(None), close))
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_why))]
    fn __exit__(&self, py: Python<'_>, _why: &Bound<'_, PyAny>) -> PyResult<bool> {
        self.close(py).map(|()| false)
    }
}

fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}
