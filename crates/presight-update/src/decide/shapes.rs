//! Meshes of objects that may be recognized: files of a folder, and objects of the model.

use glam::{DAffine3, DVec3};
use presight_model::environment::{Environment, Mesh, NewObject, Object};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Aabb, Pose};
use presight_read::gltf::{ImportOptions, import};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Maximum length of an object, metres. A file in millimetres exceeds it for an object of 5 cm.
const MAX_LENGTH: f64 = 50.0;
/// Minimum length of an object, metres. A shorter one is in one voxel and is never detected as new.
const MIN_LENGTH: f64 = 0.1;
/// Maximum number of files of a library.
const MAX_FILES: usize = 1000;
/// Endings of meshes in other formats, which a notice lists.
const OTHERS: [&str; 6] = ["obj", "stl", "ply", "dae", "fbx", "3ds"];

/// A mesh in the frame of its object, metres, z up. Two are equal if they have the same name and origin.
#[derive(Clone, Debug)]
pub struct LibraryShape {
    name: String,
    mesh: Arc<Mesh>,
    object_from_mesh: DAffine3,
    /// The file and the object in it; `None` for an object of the model.
    pub(crate) file: Option<(PathBuf, String)>,
}

impl PartialEq for LibraryShape {
    fn eq(&self, other: &Self) -> bool {
        (&self.name, &self.file) == (&other.name, &other.file)
    }
}

impl LibraryShape {
    /// The shape of an object of a model.
    pub fn of_object(object: &Object) -> Self {
        let (name, mesh, object_from_mesh) = (object.name.clone(), object.mesh.clone(), object.object_from_mesh);
        Self { name, mesh, object_from_mesh, file: None }
    }

    /// The name of its file without the ending, followed by its path in a file of several objects; or the name of the
    /// object of the model.
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

    /// A new object of this shape; its polygons get the first material.
    pub(crate) fn object(&self, name: &str, pose: Pose) -> NewObject {
        let mesh = Arc::new(self.mesh.with_materials(|_| 0));
        NewObject { object_from_mesh: self.object_from_mesh, ..NewObject::new(name, pose, mesh) }
    }
}

/// A new object of a known shape.
#[derive(Clone, Debug, PartialEq)]
pub struct Recognized {
    /// Its shape.
    pub shape: Arc<LibraryShape>,
    /// Its pose.
    pub world_from_object: Pose,
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
    shapes: Vec<Arc<LibraryShape>>,
}

impl Library {
    /// Reads all `.glb` and `.gltf` files of a folder with their sidecars, without its subfolders. Each object of a
    /// file is a shape. Also returns notices: of the imports, on meshes in other formats, and on shapes that are too
    /// small.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the folder cannot be read; [`presight_model::ErrorKind::Invalid`] if it
    /// has no mesh, or one that is longer than 50 m, as of a file in millimetres; errors of [`import`].
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
        if paths.is_empty() || paths.len() > MAX_FILES {
            let remedy = format!("put 1 to {MAX_FILES} meshes into it as .glb; trimesh converts other formats");
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
    pub fn shapes(&self) -> &[Arc<LibraryShape>] {
        &self.shapes
    }

    fn add(&mut self, path: &Path, scene: &Environment, notices: &mut Vec<String>) -> Result<()> {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        for object in scene.objects() {
            let turn = object.world_from_object.rotation_matrix() * object.object_from_mesh.matrix3;
            // The store also makes rotation and scale a part of the inserted shape.
            let mesh = Arc::new(object.mesh.transformed(turn, |material| material)?);
            let name = if scene.objects().len() == 1 { stem.to_string() } else { format!("{stem}/{}", object.name) };
            let size = mesh.bounds().max - mesh.bounds().min;
            if size.max_element() > MAX_LENGTH {
                let what = format!("{:?} is {} m, longer than {MAX_LENGTH} m", object.name, in_words(size));
                let remedy = format!(
                    "if its unit is the millimetre, write the lines format = 1 and scale = 0.001 into \
                     {stem}.materials.toml"
                );
                return Err(Error::invalid(what, remedy));
            }
            if size.max_element() < MIN_LENGTH {
                let size = in_words(size);
                notices.push(format!("{name} is {size} m, too small to be recognized, and is left out"));
                continue;
            }
            let file = Some((path.to_owned(), object.name.clone()));
            self.shapes.push(Arc::new(LibraryShape { name, mesh, object_from_mesh: DAffine3::IDENTITY, file }));
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
