//! Imports glTF 2.0 scenes, .glb and .gltf, into an [`Environment`].
//!
//! The `gltf` crate parses the properties that presight uses, but reads node transforms as f32 and does not check
//! sizes. So node transforms are read again as f64, and accessors are read here with every size checked first.
//! Positions keep the file's f32 bits in the mesh's own frame. The object's f64 matrix is the product of
//! `world_from_scene` from the sidecar, the rotation from y-up to z-up, and the node matrices. A node that is not an
//! object but has objects below becomes a group; its frame is the rigid part of that product.

mod accessor;
mod buffers;
mod container;
mod dataless;
mod exact;
mod extensions;
mod instances;
mod memory;
mod mesh;
mod nodes;
mod notices;
mod objects;
mod paths;
mod reduce;
mod schema;
mod skin;
mod write;

pub use write::write_glb;

use crate::file;
use crate::materials::{self, Sidecar};
use crate::preparation::{
    self, Edges, ImportReport, ImportedScene, ProblemBook, ProblemKind, ProblemList, TriangleMesh,
};
use crate::preparation::{SceneFrame, Up};
use accessor::{AccessorCounts, Document};
use buffers::Buffers;
use gltf::json;
pub(crate) use memory::Memory;
use mesh::mesh_words;
use nodes::{NodeText, SceneNode, Shape};
use notices::{Described, FileExtensions};
use objects::Placement;
use presight_model::environment::{Environment, Material, Mesh, PolygonOrder};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::limits;
use presight_model::threads::Threads;
use rayon::prelude::*;
use skin::RestPoses;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Options for importing a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportOptions {
    /// Merge coplanar neighbours into convex polygons. Without merging, every triangle stays a polygon, in source
    /// order, as `source` ids require.
    pub merge: bool,
    /// Maximum distance of a vertex from its merged polygon's plane, relative to the size of its mesh.
    pub merge_tolerance: f64,
    /// The axis of the file that points up; `None`: from the sidecar, else y.
    pub up: Option<Up>,
    /// Metres in one unit of the file; `None`: from the sidecar, else 1.
    pub scale: Option<f64>,
    /// Threads that build meshes in parallel.
    pub threads: Threads,
}

impl ImportOptions {
    /// Up axis, scale and world pose of a file with this sidecar.
    fn frame(&self, sidecar: &Sidecar) -> SceneFrame {
        let default = SceneFrame::default();
        SceneFrame {
            up: self.up.or(sidecar.up).unwrap_or(default.up),
            scale: self.scale.or(sidecar.scale).unwrap_or(default.scale),
            world_from_scene: sidecar.world_from_scene,
        }
    }
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self { merge: true, merge_tolerance: 1e-6, up: None, scale: None, threads: Threads::SHARED }
    }
}

/// Reads a scene and its sidecar `SCENE.materials.toml`, if it exists.
///
/// # Errors
/// [`ErrorKind::Invalid`] with file, place and remedy for a file that is missing, truncated, not glTF, or inconsistent;
/// [`ErrorKind::Unsupported`] for a required extension or a version that is not supported; [`ErrorKind::Usage`] for
/// invalid options. As [`Threads::new`].
pub fn import(path: impl AsRef<Path>, options: &ImportOptions) -> Result<ImportedScene> {
    import_within(path.as_ref(), None, options, &mut Memory::default())
}

/// Reads a scene that is in memory: a .glb, or a .gltf whose buffers are embedded. `name` stands in messages for the
/// file. There is no sidecar: `options` and the materials' `extras` hold its content.
///
/// ```
/// # std::env::set_current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).unwrap();
/// use presight_read::gltf::{ImportOptions, import, import_bytes};
/// let bytes = std::fs::read("scenes/room.glb")?;
/// let scene = import_bytes("room.glb", &bytes, &ImportOptions::default())?;
/// assert_eq!(scene.report, import("scenes/room.glb", &ImportOptions::default())?.report);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As [`import`]; [`ErrorKind::Unsupported`] if a buffer is in a separate file.
pub fn import_bytes(name: impl AsRef<Path>, bytes: &[u8], options: &ImportOptions) -> Result<ImportedScene> {
    check_options(options)?;
    let name = name.as_ref();
    import_memory(name, bytes, options).map_err(|e| e.in_file(name))
}

fn import_memory(name: &Path, bytes: &[u8], options: &ImportOptions) -> Result<ImportedScene> {
    let length = bytes.len() as u64;
    if length > limits::MAX_FILE_BYTES {
        let remedy = format!("the limit is {}: give several scenes", limits::MAX_FILE_BYTES);
        return Err(Error::invalid(format!("the scene is too large: it has {length} bytes"), remedy));
    }
    // The caller holds the bytes already, but other limits count them too.
    let mut memory = Memory::default();
    memory.take(length, "the scene itself")?;
    let (sidecar, origin) = (Sidecar::default(), Origin { scene: name, buffers: BufferFiles::None });
    import_from(bytes, origin, &sidecar, options, &mut memory)
}

/// A scene and the files that it may name.
#[derive(Clone, Copy)]
struct Origin<'a> {
    /// Its file, or its name in messages.
    scene: &'a Path,
    buffers: BufferFiles<'a>,
}

/// Files that may hold buffers.
#[derive(Clone, Copy)]
enum BufferFiles<'a> {
    /// All in the scene's folder, and what links there lead to.
    Linked,
    /// All in this folder, with symbolic links resolved.
    Within(&'a Path),
    /// None: the scene is in memory.
    None,
}

/// Like [`import`], but reads buffers and materials only from the folder `within` (with symbolic links resolved), and
/// adds to the memory of earlier imports.
///
/// # Errors
/// As [`import`]; [`ErrorKind::Invalid`] if a buffer or the sidecar is outside.
pub(crate) fn import_within(
    path: &Path,
    within: Option<&Path>,
    options: &ImportOptions,
    memory: &mut Memory,
) -> Result<ImportedScene> {
    check_options(options)?;
    import_file(path, within, options, memory).map_err(|e| e.in_file(path))
}

fn import_file(
    path: &Path,
    within: Option<&Path>,
    options: &ImportOptions,
    memory: &mut Memory,
) -> Result<ImportedScene> {
    if let Some(within) = within {
        container::check_within(&materials::sidecar_path(path), within)?;
    }
    let file = file::open(path)?;
    memory.take(file.limit(), "the file itself")?;
    let bytes = file::read(file, path, limits::MAX_FILE_BYTES)?;
    let sidecar = Sidecar::for_scene(path)?;
    let origin = Origin { scene: path, buffers: within.map_or(BufferFiles::Linked, BufferFiles::Within) };
    import_from(&bytes, origin, &sidecar, options, memory)
}

fn check_options(options: &ImportOptions) -> Result<()> {
    if !(0.0..=limits::MAX_MERGE_TOLERANCE).contains(&options.merge_tolerance) {
        return Err(Error::usage(
            format!("merge tolerance {} is outside 0..={}", options.merge_tolerance, limits::MAX_MERGE_TOLERANCE),
            "give a share of the object's size, such as 1e-6",
        ));
    }
    options.scale.map_or(Ok(()), SceneFrame::check_scale)
}

fn import_from(
    bytes: &[u8],
    origin: Origin<'_>,
    sidecar: &Sidecar,
    options: &ImportOptions,
    memory: &mut Memory,
) -> Result<ImportedScene> {
    let container = container::open(bytes)?;
    memory.take_json(container.json)?;
    let text = reduce::reduced(container.json)?;
    let root: json::Root = parse(&text)?;
    check_version(&root)?;
    let (nodes, extensions): (NodeText, FileExtensions) = (parse(&text)?, parse(&text)?);
    drop(text);
    let images = container::images(&root, origin.scene);
    let buffers = Buffers::load(&root, &container, origin, memory)?;
    let files = match origin.buffers {
        BufferFiles::None => Vec::new(),
        _ => {
            let sidecar_file = Some(materials::sidecar_path(origin.scene)).filter(|path| path.exists());
            let own = std::iter::once(origin.scene.to_owned()).chain(sidecar_file);
            own.chain(buffers.files.iter().cloned()).chain(images).collect()
        }
    };
    let document = Document { root, buffers };
    let mut scene = nodes.scene_nodes(memory)?;
    let mut book = ProblemBook::default();
    let dataless = dataless::leave_out(&document, &mut scene.nodes, &mut book);
    let skins = skin::pose(&document, &nodes, &mut scene.nodes, &mut book)?;
    scene.nodes = instances::expanded(&document, scene.nodes, memory)?;
    let claims = claims_of(&document, &scene.nodes)?;
    let meshes = claims.iter().map(|&(Shape { mesh, .. }, triangles)| {
        (triangles, document.exact_numbers(mesh), mesh_words(&document.root, mesh))
    });
    memory.take_meshes(meshes)?;
    let mut environment = Environment::new();
    let default_material = add_materials(&document.root, sidecar, origin.scene, &mut environment)?;
    let (root, materials) = (&document.root, environment.materials().to_vec());
    let described = Described { root, file: &extensions, path: origin.scene, scene: &scene, materials: &materials };

    let frame = options.frame(sidecar);
    for extension in described.unfollowed() {
        book.note(ProblemKind::IgnoredFeature, || format!("extension {extension}: the data without it is used"));
    }
    let mut placement = Placement::new(environment, book, frame);
    let build = |&claim: &(Shape, u64)| build_mesh(&document, claim, &skins.poses, default_material, options);
    let built: Vec<Result<BuiltMesh>> = options.threads.run(|| claims.par_iter().map(build).collect())?;
    let mut by_shape = HashMap::with_capacity(claims.len());
    for (&(shape, _), built) in claims.iter().zip(built) {
        let built = built?;
        placement.count(&built, &mesh_words(root, shape.mesh));
        by_shape.insert(shape, built);
    }
    placement.insert_all(&scene.nodes, &by_shape)?;
    let mut notices: Vec<String> = container.unpadded.map(unpadded).into_iter().chain(described.lines()).collect();
    let holds = |line: String| format!("{line}; export the scene as .glb, which holds its buffers");
    notices.extend(dataless.notice("their buffer has no data").map(holds));
    notices.extend(skins.notice());
    notices.extend(placement.notices(|mesh| mesh_words(root, mesh)));
    let Placement { environment, report, book, .. } = placement;
    let report = ImportReport { problems: book.into_problems(), notices, ..report };
    Ok(ImportedScene { environment, report, frame: Some(frame), files })
}

/// The notice about a chunk of a .glb without padding.
fn unpadded(bytes: usize) -> String {
    format!("a chunk of the GLB has {bytes} bytes, which is not a multiple of 4: it is read as it was written")
}

/// Quotes a name for a message. Long names are cut.
fn quoted(name: &str) -> String {
    const LONGEST: usize = 80;
    match name.char_indices().nth(LONGEST) {
        None => format!("{name:?}"),
        Some((end, _)) => format!("{:?}...", &name[..end]),
    }
}

/// Parses the reduced text of a scene.
fn parse<'de, T: serde::Deserialize<'de>>(text: &'de [u8]) -> Result<T> {
    serde_json::from_slice(text)
        .map_err(|e| Error::invalid(e.to_string(), "export it again as glTF 2.0").at("its JSON"))
}

fn check_version(root: &json::Root) -> Result<()> {
    let needed = root.asset.min_version.as_deref().unwrap_or(&root.asset.version);
    let supported = match &root.asset.min_version {
        Some(min) => min == "2.0",
        None => root.asset.version.starts_with("2."),
    };
    if !supported {
        let what = format!("this is glTF version {needed:?}");
        return Err(Error::new(ErrorKind::Unsupported, what, "export it as glTF 2.0").at("asset"));
    }
    for extension in &root.extensions_required {
        if !extensions::is_known(extension) {
            return Err(Error::new(
                ErrorKind::Unsupported,
                format!("the file requires the extension {extension:?}"),
                "export it without that extension",
            )
            .at("extensionsRequired"));
        }
    }
    Ok(())
}

/// The meshes of the scene in the order of their first use, with their claimed numbers of triangles. Checks these
/// against the limits.
fn claims_of(document: &Document<'_>, nodes: &[SceneNode]) -> Result<Vec<(Shape, u64)>> {
    let mut claimed: HashMap<Shape, u64> = HashMap::new();
    let mut proven = AccessorCounts::default();
    let mut claims = Vec::new();
    let (mut stored, mut in_scene) = (0u64, 0u64);
    for (node, shape) in nodes.iter().filter_map(|node| Some((node, node.shape()?))) {
        let count = match claimed.get(&shape) {
            Some(&count) => count,
            None => {
                let count = document.claimed_triangles(shape, &mut proven).map_err(|e| e.at(place_of(node)))?;
                claimed.insert(shape, count);
                claims.push((shape, count));
                stored = stored.saturating_add(count);
                count
            }
        };
        in_scene = in_scene.saturating_add(count);
    }
    if stored > limits::MAX_STORED_TRIANGLES || in_scene > limits::MAX_POLYGONS {
        return Err(Error::invalid(
            format!(
                "{stored} triangles are claimed, {in_scene} with all instances; {} and {} are the limits",
                limits::MAX_STORED_TRIANGLES,
                limits::MAX_POLYGONS
            ),
            "split the environment into several files",
        ));
    }
    presight_model::memory::require(presight_model::memory::of_meshes(claims.iter().map(|(_, triangles)| *triangles)))?;
    Ok(claims)
}

/// Adds all materials of the file and, if needed, one for primitives without a material. Returns the index of the last.
fn add_materials(root: &json::Root, sidecar: &Sidecar, path: &Path, environment: &mut Environment) -> Result<u16> {
    let mut all = Vec::with_capacity(root.materials.len() + 1);
    for (i, source) in root.materials.iter().enumerate() {
        let name = source.name.clone().filter(|n| !n.is_empty()).unwrap_or_else(|| format!("material{i}"));
        let [r, g, b, _] = source.pbr_metallic_roughness.base_color_factor.0;
        let mut material = Material { color: [r, g, b].map(|c| c.clamp(0.0, 1.0)), ..Material::named(name) };
        if let Some(extras) = &source.extras
            && let Some(properties) = materials::from_extras(extras.get()).map_err(|e| e.at(format!("material {i}")))?
        {
            properties.apply_to(&mut material);
        }
        all.push(material);
    }
    let without = |p: &json::mesh::Primitive| p.material.is_none();
    if root.meshes.iter().any(|m| m.primitives.iter().any(without)) || all.is_empty() {
        all.push(Material::named("default"));
    }
    let blame = |e: Error| e.in_file(materials::sidecar_path(path));
    sidecar.apply_to(&mut all).map_err(blame)?;
    let mut last = 0;
    for material in all {
        last = environment.add_material(material)?;
    }
    Ok(last)
}

/// A mesh ready for its instances.
struct BuiltMesh {
    mesh: Arc<Mesh>,
    source_count: u32,
    primitive_ends: Vec<u32>,
    problems: ProblemList,
    notes: Vec<(ProblemKind, String)>,
    merges: u64,
    /// Metres in the mesh frame.
    deviation: f64,
    /// True if it has the exact polygons of our own writer.
    exact: bool,
}

impl BuiltMesh {
    /// An exact mesh of our own writer.
    fn exact(mesh: Arc<Mesh>, triangles: u64) -> Self {
        Self {
            mesh,
            // Fits, because of the limit on triangles.
            source_count: triangles as u32,
            primitive_ends: Vec::new(),
            problems: ProblemList::default(),
            notes: Vec::new(),
            merges: 0,
            deviation: 0.0,
            exact: true,
        }
    }

    fn place_of(&self, source: u32) -> (u32, u32) {
        preparation::place_of(&self.primitive_ends, source)
    }
}

fn build_mesh(
    document: &Document<'_>,
    (Shape { mesh: index, skin }, claimed): (Shape, u64),
    poses: &RestPoses,
    default_material: u16,
    options: &ImportOptions,
) -> Result<BuiltMesh> {
    let pose = skin.and_then(|skin| poses.get(&skin));
    let exact = if options.merge && pose.is_none() { document.exact_mesh(index) } else { exact::Exact::None };
    let stale = match exact {
        exact::Exact::Mesh(mesh) => return Ok(BuiltMesh::exact(mesh, claimed)),
        exact::Exact::Stale => true,
        exact::Exact::None => false,
    };
    let mesh::MeshTriangles { triangles, mut notes } = document.read_mesh(index, pose, default_material)?;
    if stale {
        let what = format!(
            "{}: its stored polygons do not match its vertices: its triangles are used",
            mesh_words(&document.root, index)
        );
        notes.push((ProblemKind::IgnoredFeature, what));
    }
    let edges = Edges::of(&triangles);
    let twins = edges.twins();
    let problems = triangles.problems(&edges, &twins);
    drop(edges);
    let (merged, order) = match options.merge {
        true => (preparation::merge(&triangles, twins, options.merge_tolerance), PolygonOrder::Spatial),
        false => (preparation::unmerged(&triangles), PolygonOrder::Given),
    };
    let TriangleMesh { vertices, source_count, primitive_ends, .. } = triangles;
    let name = document.root.meshes[index].name.clone().unwrap_or_else(|| format!("mesh{index}"));
    let mesh = Arc::new(Mesh::from_parts(name, vertices, &merged.parts, order));
    let (merges, deviation) = (merged.merges, merged.largest_deviation);
    Ok(BuiltMesh { mesh, source_count, primitive_ends, problems, notes, merges, deviation, exact: false })
}

/// Names a node in messages.
fn place_of(node: &SceneNode) -> String {
    format!("node {} {}", node.node, quoted(&node.path))
}
