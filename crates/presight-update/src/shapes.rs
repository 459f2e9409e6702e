//! Meshes of things that may stand somewhere: files of a folder, and the model's own objects.

use glam::{DAffine3, DVec3};
use presight_model::environment::{Environment, Mesh, NewObject, Object};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Aabb, Pose};
use presight_read::gltf::{ImportOptions, import};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The longest thing, metres. A thing of 5 cm in millimetres is as long.
const LONGEST: f64 = 50.0;
/// A shorter thing falls into one voxel and is never seen as new, metres.
const SHORTEST: f64 = 0.1;
/// Most files of a library.
const MOST: usize = 1000;
/// Endings of meshes in other formats, which are named when they are left out.
const OTHERS: [&str; 6] = ["obj", "stl", "ply", "dae", "fbx", "3ds"];

/// A mesh in the frame of its object, metres, z up. Two are equal if they have the same name and origin.
#[derive(Clone, Debug)]
pub struct Shape {
    name: String,
    mesh: Arc<Mesh>,
    object_from_mesh: DAffine3,
    /// The file and its object; `None` for an object of the model.
    file: Option<(PathBuf, String)>,
}

impl PartialEq for Shape {
    fn eq(&self, other: &Self) -> bool {
        (&self.name, &self.file) == (&other.name, &other.file)
    }
}

impl Shape {
    /// The shape of an object of a model.
    pub fn of_object(object: &Object) -> Self {
        let (name, mesh, object_from_mesh) = (object.name.clone(), object.mesh.clone(), object.object_from_mesh);
        Self { name, mesh, object_from_mesh, file: None }
    }

    /// Its name: of its file without the ending, followed by its path in a file of several objects; or of the object of the model.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its polygons.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Scale, mirror and shear of the mesh.
    pub fn object_from_mesh(&self) -> DAffine3 {
        self.object_from_mesh
    }

    /// Its bounds in its own frame, metres.
    pub fn bounds(&self) -> Aabb {
        self.mesh.bounds().transformed(&self.object_from_mesh)
    }

    /// The change that inserts it, as `presight env apply` reads it.
    pub(crate) fn insertion(&self, object: &str, pose: &[f64]) -> Value {
        match &self.file {
            Some((path, within)) => {
                json!({"op": "insert_object", "object": object, "pose": pose, "from": path, "from_object": within})
            }
            None => json!({"op": "insert_object", "object": object, "pose": pose, "like": self.name}),
        }
    }

    /// The object that it becomes; its polygons get the first material.
    pub(crate) fn placed(&self, name: &str, pose: Pose) -> NewObject {
        let mesh = Arc::new(self.mesh.with_materials(|_| 0));
        NewObject { object_from_mesh: self.object_from_mesh, ..NewObject::new(name, pose, mesh) }
    }
}

/// The meshes of a folder.
///
/// ```
/// use presight::update::Library;
/// # use presight_model::environment::Environment;
/// # use presight_model::geometry::Pose;
/// # let folder = tempfile::tempdir()?;
/// # let mut environment = Environment::new();
/// # environment.add_cuboid("pallet", Pose::IDENTITY, glam::DVec3::new(1.2, 0.8, 0.144))?;
/// # presight_read::gltf::write_glb(&folder.path().join("pallet.glb"), &environment)?;
/// let (library, notices) = Library::open(folder.path())?;
/// assert_eq!(library.shapes()[0].name(), "pallet");
/// assert!(notices.is_empty());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Library {
    shapes: Vec<Arc<Shape>>,
}

impl Library {
    /// Reads all `.glb` and `.gltf` files of a folder, with their sidecars; folders in it are not searched. Each object of a file
    /// is a shape. Also returns notices: of the imports, on meshes in other formats, and on shapes that are too small.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the folder cannot be read; [`presight_model::ErrorKind::Invalid`] if it has no
    /// mesh, or one that is longer than 50 m, as of a file in millimetres; errors of [`import`].
    pub fn open(folder: &Path) -> Result<(Self, Vec<String>)> {
        let io = |e| Error::io(folder, "read the folder", e);
        let folder = std::fs::canonicalize(folder).map_err(io)?;
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(&folder).map_err(io)? {
            paths.push(entry.map_err(io)?.path());
        }
        paths.sort();
        let ending = |path: &Path| path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let others: Vec<String> =
            paths.iter().filter(|p| OTHERS.contains(&&*ending(p))).map(|p| file_name(p)).collect();
        paths.retain(|path| ["glb", "gltf"].contains(&&*ending(path)));
        if paths.is_empty() || paths.len() > MOST {
            let remedy = format!("put 1 to {MOST} meshes into it as .glb; trimesh converts other formats");
            return Err(Error::invalid(format!("{} files are .glb or .gltf", paths.len()), remedy).in_file(&folder));
        }
        let (mut library, mut notices) = (Self::default(), Vec::new());
        for path in &paths {
            let scene = import(path, &ImportOptions::default())?;
            notices.extend(scene.report.notices.iter().map(|notice| format!("{}: {notice}", file_name(path))));
            library.add(path, &scene.environment, &mut notices).map_err(|e| e.in_file(path))?;
        }
        if !others.is_empty() {
            notices.push(format!("{} are left out: convert them to .glb", others.join(", ")));
        }
        Ok((library, notices))
    }

    /// Its shapes, by the names of their files.
    pub fn shapes(&self) -> &[Arc<Shape>] {
        &self.shapes
    }

    fn add(&mut self, path: &Path, scene: &Environment, notices: &mut Vec<String>) -> Result<()> {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        for object in scene.objects() {
            let turn = object.world_from_object.rotation_matrix() * object.object_from_mesh.matrix3;
            // As the store inserts it: rotation and scale become part of the shape.
            let mesh = Arc::new(object.mesh.transformed(turn, |material| material)?);
            let name = if scene.objects().len() == 1 { stem.to_string() } else { format!("{stem}/{}", object.name) };
            let size = mesh.bounds().max - mesh.bounds().min;
            if size.max_element() > LONGEST {
                let what = format!("{:?} is {} m, longer than {LONGEST} m", object.name, in_words(size));
                let remedy = format!(
                    "if its unit is the millimetre, write the lines format = 1 and scale = 0.001 into {stem}.materials.toml"
                );
                return Err(Error::invalid(what, remedy));
            }
            if size.max_element() < SHORTEST {
                let size = in_words(size);
                notices.push(format!("{name} is {size} m, too small to be recognized, and is left out"));
                continue;
            }
            let file = Some((path.to_owned(), object.name.clone()));
            self.shapes.push(Arc::new(Shape { name, mesh, object_from_mesh: DAffine3::IDENTITY, file }));
        }
        Ok(())
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn in_words(size: DVec3) -> String {
    format!("{:.3} x {:.3} x {:.3}", size.x, size.y, size.z)
}
