//! Builds glTF files.

use presight_model::environment::Object;
use presight_model::error::Error;
use presight_model::threads::Threads;
use presight_read::gltf::{ImportOptions, import};
use presight_read::preparation::ImportedScene;
use serde_json::{Value, json};
use std::path::PathBuf;
use tempfile::TempDir;

pub const F32: u32 = 5126;
pub const I16: u32 = 5122;
pub const U8: u32 = 5121;
pub const U16: u32 = 5123;
pub const U32: u32 = 5125;

/// Imports every triangle separately, in source order.
pub const SOURCE: ImportOptions =
    ImportOptions { merge: false, merge_tolerance: 1e-6, up: None, scale: None, threads: Threads::SHARED };

/// The four corners of a unit square and a fifth point off it.
pub const SQUARE: [[f32; 3]; 5] =
    [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.25, 0.75, 0.5]];

/// A glTF file under construction: its JSON, and the bytes of buffer 0.
#[derive(Clone)]
pub struct Gltf {
    pub json: Value,
    pub bin: Vec<u8>,
}

impl Gltf {
    /// No nodes, no meshes; a default scene with node 0.
    pub fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
            "buffers": [{"byteLength": 0}],
        });
        Self { json, bin: Vec::new() }
    }

    /// One triangle in one node.
    pub fn triangle() -> Self {
        let mut g = Self::new();
        let positions = g.positions(&SQUARE[..3]);
        let indices = g.indices(U16, &[0, 1, 2]);
        g.mesh(json!([{"attributes": {"POSITION": positions}, "indices": indices}]));
        g.node(json!({"name": "a", "mesh": 0}));
        g
    }

    pub fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    pub fn node(&mut self, node: Value) -> usize {
        self.push("nodes", node)
    }

    pub fn mesh(&mut self, primitives: Value) -> usize {
        let name = format!("mesh {}", self.json["meshes"].as_array().unwrap().len());
        self.push("meshes", json!({"name": name, "primitives": primitives}))
    }

    pub fn view(&mut self, bytes: &[u8]) -> usize {
        while !self.bin.len().is_multiple_of(4) {
            self.bin.push(0);
        }
        let offset = self.bin.len();
        self.bin.extend_from_slice(bytes);
        self.json["buffers"][0]["byteLength"] = json!(self.bin.len());
        self.push("bufferViews", json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}))
    }

    pub fn accessor(&mut self, bytes: &[u8], component: u32, kind: &str, count: usize) -> usize {
        let view = self.view(bytes);
        self.push("accessors", json!({"bufferView": view, "componentType": component, "type": kind, "count": count}))
    }

    pub fn positions(&mut self, positions: &[[f32; 3]]) -> usize {
        let bytes: Vec<u8> = positions.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
        self.accessor(&bytes, F32, "VEC3", positions.len())
    }

    pub fn indices(&mut self, component: u32, indices: &[u32]) -> usize {
        let bytes: Vec<u8> = match component {
            U8 => indices.iter().map(|&i| i as u8).collect(),
            U16 => indices.iter().flat_map(|&i| (i as u16).to_le_bytes()).collect(),
            _ => indices.iter().flat_map(|&i| i.to_le_bytes()).collect(),
        };
        self.accessor(&bytes, component, "SCALAR", indices.len())
    }

    pub fn glb(&self) -> Vec<u8> {
        let mut text = self.json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bin = self.bin.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut out = Vec::from(*b"glTF\x02\0\0\0");
        out.extend(((12 + 8 + text.len() + 8 + bin.len()) as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &bin)] {
            out.extend((chunk.len() as u32).to_le_bytes());
            out.extend(kind);
            out.extend(chunk);
        }
        out
    }

    /// Imports without merging.
    pub fn import(&self) -> Result<ImportedScene, Error> {
        self.import_with(&SOURCE, None)
    }

    pub fn import_with(&self, options: &ImportOptions, sidecar: Option<&str>) -> Result<ImportedScene, Error> {
        let folder = Folder::new();
        if let Some(text) = sidecar {
            folder.write("s.materials.toml", text.as_bytes());
        }
        import(folder.write("s.glb", &self.glb()), options)
    }
}

/// A temporary folder.
pub struct Folder(TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

/// Corner positions of all polygons in the mesh frame, in order.
pub fn mesh_triangles(object: &Object) -> Vec<Vec<[f64; 3]>> {
    (0..object.mesh.polygon_count() as u32).map(|i| object.mesh.corners_of(i).map(|p| p.to_array()).collect()).collect()
}

/// The triangles of `SQUARE` with these indices.
pub fn square_triangles(indices: &[[usize; 3]]) -> Vec<Vec<[f64; 3]>> {
    indices.iter().map(|t| t.iter().map(|&i| SQUARE[i].map(f64::from)).collect()).collect()
}

/// RFC 4648 base64, with padding.
pub fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let groups = bytes.chunks(3).flat_map(|c| {
        let word = (0..3).fold(0u32, |w, i| w << 8 | u32::from(c.get(i).copied().unwrap_or(0)));
        (0..4).map(move |i| match i <= c.len() {
            true => DIGITS[(word >> (18 - 6 * i) & 63) as usize] as char,
            false => '=',
        })
    });
    groups.collect()
}
