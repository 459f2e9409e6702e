//! Scenes: models from files, opened as worlds for predictions.

use presight_features::{PlacedFeatures, place};
use presight_model::change::Change;
use presight_model::environment::{Feature, FeatureLayer, FeatureShape};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::Pose;
use presight_model::index::IndexKind;
use presight_model::limits;
use presight_model::placement::{self, Placement};
use presight_model::printable;
use presight_model::threads::Threads;
use presight_model::world::World;
use presight_read::file;
use presight_read::gltf::{ImportOptions, import, import_bytes};
use presight_read::layer::{self, LayerFile, MergedLayers};
use presight_read::preparation::{ImportReport, ImportedScene, SceneFrame};
use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The first bytes of a store.
const SQLITE: &[u8; 16] = b"SQLite format 3\0";

/// A scene: the world of a model, and further data of its file.
///
/// ```
/// use presight::Scene;
/// let scene = Scene::open("scenes/room.glb")?;
/// assert!(scene.world.environment().objects().len() > 5);
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Scene {
    /// The file of the scene, or the name of a scene from memory.
    pub path: PathBuf,
    /// The world of the scene.
    pub world: World,
    /// The file's placement in the world; `None` for scripts and stores, which are in the world's frame.
    pub frame: Option<SceneFrame>,
    /// Transforms the file's axes (glTF's: y up), metres, into the world (z up), `world_from_scene` included.
    pub world_from_gltf: Pose,
    /// Counts and problems of the import.
    pub report: ImportReport,
    /// The files that the scene consists of: `path`, and all that it names, such as buffers, images and modules.
    pub files: Vec<PathBuf>,
    /// Paths of the objects that were left out ([`SceneOptions::exclude`]).
    pub excluded: BTreeSet<String>,
}

/// Options for opening a scene.
///
/// ```
/// use presight::environment::IndexKind;
/// use presight::files::ImportOptions;
/// use presight::{Scene, SceneOptions};
/// // Without merging, every triangle stays a polygon, as `source` ids need it.
/// let import = ImportOptions { merge: false, ..ImportOptions::default() };
/// let options = SceneOptions::default().with_import(import).with_index(IndexKind::None);
/// let scene = Scene::open_with("scenes/room.glb", &options, &mut |line| println!("{line}"))?;
/// assert!(scene.world.environment().objects().len() > 5);
/// // The door with its frame and leaf is left out.
/// let options = SceneOptions::default().with_exclude(&["room/door".into()]);
/// let open = Scene::open_with("scenes/room.glb", &options, &mut |line| println!("{line}"))?;
/// assert!(open.excluded.contains("room/door/leaf"));
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct SceneOptions {
    /// How models are imported, and on which threads.
    pub import: ImportOptions,
    /// The index that the world gets.
    pub index: IndexKind,
    /// Paths of objects and groups that are left out, with everything below them and the features on them: the robot
    /// itself, for example. Other objects keep their ids.
    pub exclude: Vec<String>,
}

impl SceneOptions {
    /// Sets the options of the import.
    #[must_use]
    pub fn with_import(self, import: ImportOptions) -> Self {
        Self { import, ..self }
    }

    /// Sets the index.
    #[must_use]
    pub fn with_index(self, index: IndexKind) -> Self {
        Self { index, ..self }
    }

    /// Sets the objects and groups that are left out.
    #[must_use]
    pub fn with_exclude(self, exclude: &[String]) -> Self {
        Self { exclude: exclude.to_vec(), ..self }
    }
}

/// Features of layers, on their polygons.
#[derive(Clone, Debug, Default)]
pub struct SceneFeatures {
    /// The features.
    pub placed: PlacedFeatures,
    /// Number of features for other sensor classes, which are left out.
    pub other_classes: usize,
}

impl Scene {
    /// Opens a scene with the default options: a glTF model (`.glb`, `.gltf`) with its `SCENE.materials.toml`, a scene
    /// script (`.rhai`), or a stored environment (`.presight`). The output of a script is dropped.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] naming file and place; [`crate::ErrorKind::System`] if it cannot be read;
    /// [`crate::ErrorKind::Unsupported`] for a format that this build cannot read.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::open_with(path, &SceneOptions::default(), &mut |_| {})
    }

    /// A furnished room, 6 m x 4.5 m, for first steps: `scenes/room.glb` of this repository.
    ///
    /// ```
    /// let room = presight::Scene::example()?;
    /// assert!(room.world.environment().object("room/door/leaf").is_some());
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if memory or threads are short.
    pub fn example() -> Result<Self> {
        Self::from_bytes("room.glb", include_bytes!("../scenes/room.glb"), &SceneOptions::default())
    }

    /// As [`Scene::open`], with options; `say` receives each line that a script prints.
    ///
    /// # Errors
    /// As [`Scene::open`].
    pub fn open_with(path: impl AsRef<Path>, options: &SceneOptions, say: &mut dyn FnMut(&str)) -> Result<Self> {
        Self::read(Source::File(path.as_ref()), options, say)
    }

    /// Opens a scene that is in memory, such as one that a program downloaded or embeds: a `.glb`, a `.gltf` with
    /// embedded buffers, or a script (`.rhai`) that imports no files. `name` stands for the file in messages; its
    /// extension selects the format, as for [`Scene::open`]. There is no `SCENE.materials.toml`. The output of a
    /// script is dropped.
    ///
    /// ```
    /// use presight::{Scene, SceneOptions};
    /// # let downloaded = std::fs::read("scenes/room.glb").unwrap();
    /// let scene = Scene::from_bytes("room.glb", &downloaded, &SceneOptions::default())?;
    /// let opened = Scene::open("scenes/room.glb")?;
    /// assert_eq!(scene.world.environment().content_hash(), opened.world.environment().content_hash());
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`Scene::open`], naming `name`; [`crate::ErrorKind::Unsupported`] for a stored environment and for buffers in
    /// files of their own.
    pub fn from_bytes(name: &str, bytes: &[u8], options: &SceneOptions) -> Result<Self> {
        Self::read(Source::Memory(Path::new(name), bytes), options, &mut |_| {})
    }

    /// The scene of a world that a program made; `name` stands for its file.
    pub fn of_world(name: impl Into<PathBuf>, world: World) -> Self {
        Self {
            path: name.into(),
            report: report_of(&world),
            world,
            frame: None,
            // The axes of the file that `env export` writes.
            world_from_gltf: SceneFrame::default().world_from_axes(),
            files: Vec::new(),
            excluded: BTreeSet::new(),
        }
    }

    fn read(source: Source<'_>, options: &SceneOptions, say: &mut dyn FnMut(&str)) -> Result<Self> {
        let threads = options.import.threads.started()?;
        let mut scene = Self::read_unnamed(source, options, &threads, say).map_err(|e| e.in_file(source.path()))?;
        scene.leave_out(&options.exclude).map_err(|e| e.in_file(source.path()))?;
        Ok(scene)
    }

    /// Deletes objects and groups with everything below them.
    fn leave_out(&mut self, names: &[String]) -> Result<()> {
        let environment = self.world.environment();
        for name in names {
            let below = environment.below(name).map(|index| &environment.objects()[index as usize]);
            let before = self.excluded.len();
            self.excluded.extend(environment.object(name).into_iter().chain(below).map(|object| object.name.clone()));
            if self.excluded.len() == before && !self.excluded.contains(name) {
                let what = format!("`SceneOptions::exclude`: there is no object {}", printable::quoted(name));
                return Err(Error::usage(what, environment.objects_remedy(name)));
            }
        }
        // Objects below a path go first: a path with objects below it would become a group.
        let delete = |name: &String| Change::DeleteObject { name: name.clone() };
        let changes: Vec<Change> = self.excluded.iter().rev().map(delete).collect();
        if !changes.is_empty() {
            self.world.apply(Change::of(changes))?;
        }
        Ok(())
    }

    fn read_unnamed(
        source: Source<'_>,
        options: &SceneOptions,
        threads: &Threads,
        say: &mut dyn FnMut(&str),
    ) -> Result<Self> {
        let (path, kind) = (source.path(), &options.index);
        if source.is_store() {
            check_unframed(&options.import, "a store keeps the frame that it was made with")?;
            return match source {
                Source::File(path) => threads.run(|| stored(path, kind))?,
                Source::Memory(..) => Err(store_in_memory()),
            };
        }
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        let imported = match extension.as_str() {
            "rhai" => {
                check_unframed(&options.import, "a script is in metres and z-up")?;
                script(source, &options.import, say)?
            }
            "obj" | "stl" | "ply" | "off" | "dae" if source.exists() => return Err(mesh_file(path)),
            _ => match source {
                Source::File(path) => import(path, &options.import)?,
                Source::Memory(name, bytes) => import_bytes(name, bytes, &options.import)?,
            },
        };
        let world = threads.run(|| World::with_index(imported.environment, kind))?;
        let frame = imported.frame;
        let world_from_gltf = frame.unwrap_or_default().world_from_axes();
        Ok(Self {
            path: path.to_owned(),
            world,
            frame,
            world_from_gltf,
            report: imported.report,
            files: imported.files,
            excluded: BTreeSet::new(),
        })
    }

    /// Finds the polygons of the features of a layer in memory. Features that lie on no polygon are listed and left
    /// out.
    ///
    /// ```
    /// use presight::Scene;
    /// use presight::features::{GenerateOptions, generate};
    /// let scene = Scene::open("scenes/room.glb")?;
    /// let layer = generate(scene.world.environment(), "video", &GenerateOptions::default())?.layer;
    /// let placed = scene.place(&layer)?;
    /// assert!(placed.features.len() > 10 && placed.lost.is_empty());
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the layer is not valid, or names an object that the scene does not have.
    pub fn place(&self, layer: &FeatureLayer) -> Result<PlacedFeatures> {
        placement::place_layer(&self.world, layer)
    }

    /// Reads layer files on top of the scene's own layer for a sensor class, and finds the polygons of the features. A
    /// later layer replaces features with the same id. Features of the scene's own layer that have lost their surface
    /// are left out and listed. Features of a file must lie on polygons, unless the file lists them as lost.
    ///
    /// ```
    /// use presight::Scene;
    /// # use presight::features::{GenerateOptions, generate};
    /// let scene = Scene::open("scenes/room.glb")?;
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("room.video.layer.json");
    /// # let layer = generate(scene.world.environment(), "video", &GenerateOptions::default())?.layer;
    /// # presight::files::write_layer(&path, &layer)?;
    /// let features = scene.place_layers(&[&path], "video")?;
    /// assert!(features.placed.features.len() > 10);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// Errors of [`layer::load`] and [`place`], naming the layer's file.
    pub fn place_layers<P: AsRef<Path>>(&self, files: &[P], class: &str) -> Result<SceneFeatures> {
        self.place_layers_of(files, class, |_| true)
    }

    /// As [`Scene::place_layers`], only for features whose shape is `wanted`. Features on excluded objects are left
    /// out.
    ///
    /// # Errors
    /// As [`Scene::place_layers`].
    pub fn place_layers_of<P: AsRef<Path>>(
        &self,
        files: &[P],
        class: &str,
        wanted: impl Fn(&FeatureShape) -> bool,
    ) -> Result<SceneFeatures> {
        self.place_loaded(layer::load(self.world.environment().layer(class), files, class)?, wanted)
    }

    /// As [`Scene::place_layers`], for layer files that were read before.
    ///
    /// # Errors
    /// Errors of [`place`] and [`layer::merge`], naming the layer's file.
    pub fn place_files(&self, files: Vec<LayerFile>, class: &str) -> Result<SceneFeatures> {
        self.place_loaded(layer::select(self.world.environment().layer(class), files, class)?, |_| true)
    }

    fn place_loaded(&self, mut loaded: MergedLayers, wanted: impl Fn(&FeatureShape) -> bool) -> Result<SceneFeatures> {
        let is_there = |object: &String| !self.excluded.contains(object);
        for LayerFile { layer, .. } in &mut loaded.layers {
            layer.features.retain(|f| wanted(&f.shape) && f.object.as_ref().is_none_or(is_there));
            layer.pose_covariances.retain(|(object, _)| is_there(object));
        }
        let (mut all, mut objects) = (Placement::default(), Vec::new());
        for LayerFile { layer, path, lost, .. } in &loaded.layers {
            let in_file = |e: Error| e.in_file(path.as_ref().unwrap_or(&self.path));
            let mut set_apart = |layer: &FeatureLayer| -> Result<()> {
                let Placement { placed, off } = placement::find(&self.world, layer).map_err(in_file)?;
                all.placed.extend(placed);
                all.off.extend(off);
                Ok(())
            };
            match path {
                // A feature of the world may lie on an excluded object.
                _ if !self.excluded.is_empty() => set_apart(layer)?,
                None => set_apart(layer)?,
                Some(_) if lost.is_empty() => all.placed.extend(place(&self.world, layer).map_err(in_file)?),
                Some(_) => {
                    let is_lost = |f: &Arc<Feature>| lost.binary_search(&f.id).is_ok();
                    let (marked, others) = layer.features.iter().cloned().partition(is_lost);
                    set_apart(&FeatureLayer { features: marked, ..layer.clone() })?;
                    let others = FeatureLayer { features: others, ..layer.clone() };
                    all.placed.extend(place(&self.world, &others).map_err(in_file)?);
                }
            }
            for (object, covariance) in &layer.pose_covariances {
                objects.push((self.world.environment().index_of(object).map_err(in_file)?, *covariance));
            }
        }
        all.placed.sort_by_key(|p| p.feature.id);
        all.off.sort_unstable();
        let placed = PlacedFeatures { features: all.placed.into(), lost: all.off.into(), objects: objects.into() };
        Ok(SceneFeatures { placed, other_classes: loaded.other_classes })
    }
}

/// The source of a scene.
#[derive(Clone, Copy)]
enum Source<'a> {
    File(&'a Path),
    /// A name for messages, and the content.
    Memory(&'a Path, &'a [u8]),
}

impl<'a> Source<'a> {
    fn path(self) -> &'a Path {
        match self {
            Self::File(path) | Self::Memory(path, _) => path,
        }
    }

    fn exists(self) -> bool {
        matches!(self, Self::Memory(..)) || self.path().exists()
    }

    /// True for a stored environment, by its extension or its content.
    fn is_store(self) -> bool {
        self.path().extension().is_some_and(|e| e.eq_ignore_ascii_case("presight"))
            || match self {
                Self::File(path) => file::starts_with(path, SQLITE),
                Self::Memory(_, bytes) => bytes.starts_with(SQLITE),
            }
    }
}

/// BLAKE3 of a scene's file, hexadecimal, as predictions in EXR files name it.
///
/// # Errors
/// Errors of reading the file; [`crate::ErrorKind::Invalid`] for a file too large for a scene.
pub fn blake3_of(path: &Path) -> Result<String> {
    let file = file::open(path)?;
    if file.limit() > limits::MAX_FILE_BYTES && !file::starts_with(path, SQLITE) {
        // Too large for a scene: refused before reading it for minutes.
        let what = format!("the file is too large: it has {} bytes", file.limit());
        return Err(Error::invalid(what, format!("the limit is {}", limits::MAX_FILE_BYTES)).in_file(path));
    }
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file).map_err(|e| Error::io(path, "read it", e))?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Refuses an up axis or a scale for a scene that has its own frame.
fn check_unframed(options: &ImportOptions, why: &str) -> Result<()> {
    let option = match (options.up, options.scale) {
        (None, None) => return Ok(()),
        (Some(_), _) => "`ImportOptions::up`",
        _ => "`ImportOptions::scale`",
    };
    let remedy = format!("drop {option}, or give it where the glTF file is read");
    Err(Error::usage(format!("{option}: {why}"), remedy))
}

/// The error for meshes of other formats, with a command that converts them.
fn mesh_file(path: &Path) -> Error {
    let (from, to) = (path.display(), path.with_extension("glb"));
    let remedy = format!(
        "convert it: python3 -c \"import trimesh; trimesh.load('{from}', force='scene').export('{}')\" \
         (pip install trimesh), then give `ImportOptions::up` z if it is z-up",
        to.display()
    );
    Error::new(ErrorKind::Unsupported, "presight reads scenes from glTF, scripts and stores", remedy)
}

/// Runs a scene script.
#[cfg(feature = "script")]
fn script(source: Source<'_>, options: &ImportOptions, say: &mut dyn FnMut(&str)) -> Result<ImportedScene> {
    match source {
        Source::File(path) => presight_read::script::load(path, options, say),
        Source::Memory(name, bytes) => presight_read::script::load_bytes(name, bytes, options, say),
    }
}

#[cfg(not(feature = "script"))]
fn script(_source: Source<'_>, _options: &ImportOptions, _say: &mut dyn FnMut(&str)) -> Result<ImportedScene> {
    Err(presight_read::not_built("scene scripts", "script"))
}

/// The error for a store that is not in a file.
fn store_in_memory() -> Error {
    let remedy = "write it to a file and open that, or export its scene.glb: presight env export STORE DIR";
    Error::new(ErrorKind::Unsupported, "a stored environment in memory cannot be opened", remedy)
}

/// The counts of a world that was not imported.
fn report_of(world: &World) -> ImportReport {
    let mut report = ImportReport::default();
    let mut seen = HashSet::new();
    for object in world.environment().objects() {
        let polygons = object.mesh.polygon_count() as u64;
        report.polygons_in_scene += polygons;
        if seen.insert(Arc::as_ptr(&object.mesh)) {
            report.polygons_stored += polygons;
        }
    }
    report
}

/// Opens a store, which is already in presight's frame.
#[cfg(feature = "store")]
fn stored(path: &Path, kind: &IndexKind) -> Result<Scene> {
    let world = presight_store::read_world(path, kind)?;
    Ok(Scene { files: vec![path.to_owned()], ..Scene::of_world(path, world) })
}

#[cfg(not(feature = "store"))]
fn stored(_path: &Path, _kind: &IndexKind) -> Result<Scene> {
    Err(presight_read::not_built("stored environments", "store"))
}

#[cfg(all(test, not(feature = "script")))]
mod tests {
    use super::*;

    #[test]
    fn without_scripts_one_is_refused_with_a_remedy() {
        let e = Scene::open("hall.rhai").expect_err("no scripts");
        assert_eq!((e.kind(), e.file()), (ErrorKind::Unsupported, Some(Path::new("hall.rhai"))));
        assert!(e.remedy().contains("script"), "{e}");
    }
}
