//! Writes an environment as a .glb that every other program can show. [`super::import`] reads it back bit for bit.
//!
//! Objects are root nodes named by their full paths. Groups that define a frame are root nodes without a mesh.
//! Meshes are triangles by material. `extras.presight` holds the data that glTF cannot express:
//!
//! - meshes: convex polygons (`rows`: an accessor with three u32 for each, number of corners, material and source
//!   triangle; `corners`: an accessor with all corners; `order`; `blake3` of positions, rows and corners);
//! - nodes: the pose without the scale (`world_from_object`, `world_from_group`);
//! - materials: reflection factor, sides and classes.
//!
//! If a mesh's hash or a node's matrix does not match, another program has changed it; then triangles and matrix are
//! used.
//!
//! Not written: objects without polygons, materials' empty names, numbers of objects and slots, ids of deleted
//! features, and feature layers, which are separate files.

use crate::atomic::write_atomically;
use crate::preparation::Z_UP_FROM_Y_UP;
use glam::{DAffine3, DMat4, DVec3};
use presight_model::environment::{Environment, Material, Mesh, Object, PolygonOrder};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;

/// Writes a scene file.
///
/// ```
/// # std::env::set_current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).unwrap();
/// use presight_read::gltf::{import, write_glb};
/// let scene = import("scenes/room.glb", &Default::default())?.environment;
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("again.glb");
/// write_glb(&path, &scene)?;
/// assert_eq!(import(&path, &Default::default())?.environment.content_hash(), scene.content_hash());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::System`] if the file cannot be written, [`presight_model::ErrorKind::Invalid`] if it
/// would exceed 4 GiB or have no polygons, because [`super::import`] refuses a scene without polygons.
pub fn write_glb(path: &Path, environment: &Environment) -> Result<()> {
    if environment.objects().iter().all(|o| o.mesh.polygon_count() == 0) {
        let what = "the environment has no polygons, so the scene could not be read back";
        return Err(Error::invalid(what, "insert an object first"));
    }
    let mut scene = Scene::default();
    let mut numbers: HashMap<*const Mesh, usize> = HashMap::new();
    for object in environment.objects().iter().filter(|o| o.mesh.polygon_count() > 0) {
        let mesh = match numbers.get(&std::sync::Arc::as_ptr(&object.mesh)) {
            Some(number) => *number,
            None => {
                let number = scene.mesh(&object.mesh);
                numbers.insert(std::sync::Arc::as_ptr(&object.mesh), number);
                number
            }
        };
        scene.nodes.push(node(object, mesh));
    }
    scene.nodes.extend(environment.framed_groups().map(|(path, pose)| group(path, pose)));
    let materials: Vec<Value> = environment.materials().iter().map(material).collect();
    let (json, bin) = scene.finish(&materials);
    let length = 12 + 8 + json.len() + 8 + bin.len();
    let length = u32::try_from(length)
        .map_err(|_| Error::invalid("the scene would be over 4 GiB", "split the environment").in_file(path))?;
    write_atomically(path, |file| {
        file.write_all(b"glTF")?;
        // The whole length fits, so each part's does too.
        [2, length, json.len() as u32].iter().try_for_each(|x: &u32| file.write_all(&x.to_le_bytes()))?;
        file.write_all(b"JSON")?;
        file.write_all(&json)?;
        file.write_all(&(bin.len() as u32).to_le_bytes())?;
        file.write_all(b"BIN\0")?;
        file.write_all(&bin)
    })
}

/// The matrix of an object's node. `import` compares with it.
pub(super) fn matrix_of(world_from_mesh: &DAffine3) -> [f64; 16] {
    let gltf_from_world = DAffine3::from_mat3(Z_UP_FROM_Y_UP.transpose());
    DMat4::from(gltf_from_world * *world_from_mesh).to_cols_array()
}

/// The hash that shows whether stored polygons match the vertices of a mesh.
pub(super) fn mesh_hash(vertices: &[glam::Vec3], rows: &[u32], corners: &[u32]) -> String {
    let mut hasher = blake3::Hasher::new();
    let mut bytes = Vec::with_capacity(12 * vertices.len());
    vertices.iter().flat_map(|v| v.to_array()).for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    for list in [rows, corners] {
        bytes.extend_from_slice(&(list.len() as u64).to_le_bytes());
        list.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    }
    hasher.update(&bytes);
    hasher.finalize().to_hex().to_string()
}

/// A group as a node without children. The names of its objects show that they belong to it.
fn group(path: &str, world_from_group: &Pose) -> Value {
    json!({
        "name": path,
        "matrix": matrix_of(&world_from_group.to_affine()),
        "extras": {"presight": {"world_from_group": world_from_group.to_array()}},
    })
}

fn node(object: &Object, mesh: usize) -> Value {
    json!({
        "name": object.name,
        "mesh": mesh,
        "matrix": matrix_of(&object.world_from_mesh()),
        "extras": {"presight": {
            "world_from_object": object.world_from_object.to_array(),
            "object_from_mesh": object.object_from_mesh.to_cols_array(),
            "first_source": object.first_source,
        }},
    })
}

fn material(m: &Material) -> Value {
    let [r, g, b] = m.color.map(f64::from);
    json!({
        "name": m.name,
        "doubleSided": !m.one_sided,
        "pbrMetallicRoughness": {"baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0},
        "extras": {"presight": {"reflection": m.reflection, "one_sided": m.one_sided, "classes": m.appearance}},
    })
}

#[derive(Default)]
struct Scene {
    bin: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    nodes: Vec<Value>,
}

impl Scene {
    fn mesh(&mut self, mesh: &Mesh) -> usize {
        let positions = self.positions(mesh);
        let mut by_material: Vec<(u16, Vec<u32>)> = Vec::new();
        let mut rows = Vec::with_capacity(3 * mesh.polygon_count());
        for polygon in 0..mesh.polygon_count() as u32 {
            let (corners, material) = (mesh.corner_indices(polygon), mesh.material(polygon));
            rows.extend([corners.len() as u32, u32::from(material), mesh.source(polygon)]);
            let at = by_material.iter().position(|(m, _)| *m == material).unwrap_or_else(|| {
                by_material.push((material, Vec::new()));
                by_material.len() - 1
            });
            let triangles = corners.windows(2).skip(1).flat_map(|pair| [corners[0], pair[0], pair[1]]);
            by_material[at].1.extend(triangles);
        }
        let primitive = |(material, indices): (u16, Vec<u32>)| {
            let indices = self.integers(&indices);
            json!({"attributes": {"POSITION": positions}, "indices": indices, "material": material})
        };
        let primitives: Vec<Value> = by_material.into_iter().map(primitive).collect();
        let hash = mesh_hash(mesh.vertices(), &rows, mesh.all_corners());
        let order = if mesh.order() == PolygonOrder::Spatial { "spatial" } else { "given" };
        let (rows, corners) = (self.integers(&rows), self.integers(mesh.all_corners()));
        self.meshes.push(json!({
            "name": mesh.name(),
            "primitives": primitives,
            "extras": {"presight": {"rows": rows, "corners": corners, "order": order, "blake3": hash}},
        }));
        self.meshes.len() - 1
    }

    fn positions(&mut self, mesh: &Mesh) -> usize {
        let bytes = mesh.vertices().iter().flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes);
        let view = self.view(bytes);
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let all = mesh.vertices().iter().map(|v| v.as_dvec3());
        let (min, max) = all.fold(start, |(min, max), v| (min.min(v), max.max(v)));
        self.accessors.push(json!({
            "bufferView": view, "componentType": FLOAT, "type": "VEC3", "count": mesh.vertices().len(),
            "min": min.to_array(), "max": max.to_array(),
        }));
        self.accessors.len() - 1
    }

    fn integers(&mut self, values: &[u32]) -> usize {
        let view = self.view(values.iter().flat_map(|x| x.to_le_bytes()));
        self.accessors.push(json!({
            "bufferView": view, "componentType": UNSIGNED_INT, "type": "SCALAR", "count": values.len(),
        }));
        self.accessors.len() - 1
    }

    /// Adds a buffer view. All elements have four bytes, so views stay aligned.
    fn view(&mut self, bytes: impl Iterator<Item = u8>) -> usize {
        let start = self.bin.len();
        self.bin.extend(bytes);
        let length = self.bin.len() - start;
        self.views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": length}));
        self.views.len() - 1
    }

    /// Returns the JSON chunk and the binary chunk.
    fn finish(self, materials: &[Value]) -> (Vec<u8>, Vec<u8>) {
        let Self { bin, views, accessors, meshes, nodes } = self;
        let mut root = json!({
            "asset": {"version": "2.0", "generator": concat!("presight ", env!("CARGO_PKG_VERSION"))},
            "scene": 0,
            "scenes": [{"nodes": (0..nodes.len()).collect::<Vec<_>>()}],
            "nodes": nodes,
        });
        // glTF does not allow empty lists.
        let lists = [("meshes", meshes), ("accessors", accessors), ("bufferViews", views)];
        for (name, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            root[name] = list.into();
        }
        if !materials.is_empty() {
            root["materials"] = materials.into();
        }
        if !bin.is_empty() {
            root["buffers"] = json!([{"byteLength": bin.len()}]);
        }
        let mut text = root.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        (text, bin)
    }
}
