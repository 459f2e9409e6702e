//! Resident geometry: each mesh is uploaded once, in its own frame, and kept from frame to frame.

use super::buffers::Growable;
use super::device::Gpu;
use super::layout::{ArenaPolygon, BOX_WORDS, CORNER_WORDS, POLYGON_WORDS, VERTEX_WORDS};
use glam::DVec3;
use presight_model::environment::Mesh;
use presight_model::error::{ErrorKind, Result};
use std::collections::HashMap;
use std::sync::{Arc, Weak};

/// Offsets of a mesh in the arena, words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct MeshLocation {
    pub polygons_at: u32,
    pub corners_at: u32,
    pub vertices_at: u32,
    pub boxes_at: u32,
}

struct Resident {
    /// Weak: keeps the address from being reused, and shows when the mesh was dropped.
    mesh: Weak<Mesh>,
    place: MeshLocation,
}

/// All meshes in one buffer of words.
pub(super) struct Arena {
    words: Growable,
    used: u64,
    residents: HashMap<usize, Resident>,
    scratch: Vec<u32>,
}

impl Arena {
    pub fn new(gpu: &Gpu) -> Self {
        Self { words: Growable::storage(gpu, "meshes"), used: 0, residents: HashMap::new(), scratch: Vec::new() }
    }

    pub fn buffer(&self) -> &wgpu::Buffer {
        self.words.buffer()
    }

    /// Location of a mesh that [`Arena::admit`] uploaded.
    pub fn place(&self, mesh: &Arc<Mesh>) -> Option<MeshLocation> {
        self.residents.get(&key(mesh)).map(|r| r.place)
    }

    /// Uploads the missing meshes. Returns true if the buffer was replaced.
    ///
    /// # Errors
    /// [`ErrorKind::DeviceMemory`] if this frame's meshes alone do not fit.
    pub fn admit<'a>(&mut self, gpu: &Gpu, meshes: impl Iterator<Item = &'a Arc<Mesh>> + Clone) -> Result<bool> {
        let mut missing: u64 = 0;
        let mut seen = std::collections::HashSet::new();
        for mesh in meshes.clone() {
            if !self.residents.contains_key(&key(mesh)) && seen.insert(key(mesh)) {
                missing += words_of(mesh);
            }
        }
        if missing == 0 {
            return Ok(false);
        }
        let mut replaced = false;
        let dead = self.residents.values().any(|r| r.mesh.strong_count() == 0);
        if (self.used + missing) * 4 > self.words.buffer().size() {
            if dead || self.grow(gpu, self.used + missing).is_err() {
                // Restart with this frame's meshes only.
                self.residents.clear();
                self.used = 0;
                let mut seen = std::collections::HashSet::new();
                let wanted: u64 = meshes.clone().filter(|m| seen.insert(key(m))).map(words_of).sum();
                self.words.reserve(gpu, wanted * 4)?;
            }
            replaced = true;
        }
        for mesh in meshes {
            if !self.residents.contains_key(&key(mesh)) {
                self.upload(gpu, mesh)?;
            }
        }
        Ok(replaced)
    }

    /// Enlarges the buffer and keeps its contents.
    fn grow(&mut self, gpu: &Gpu, words: u64) -> Result<()> {
        let old = self.words.buffer().clone();
        if self.words.reserve(gpu, words * 4)? && self.used > 0 {
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            encoder.copy_buffer_to_buffer(&old, 0, self.words.buffer(), 0, self.used * 4);
            gpu.queue.submit([encoder.finish()]);
        }
        Ok(())
    }

    fn upload(&mut self, gpu: &Gpu, mesh: &Arc<Mesh>) -> Result<()> {
        let words = words_of(mesh);
        if self.used + words > u64::from(u32::MAX) {
            return Err(gpu.error(ErrorKind::DeviceMemory, "the meshes exceed 2^32 words"));
        }
        self.scratch.clear();
        pack(mesh, &mut self.scratch);
        debug_assert_eq!(self.scratch.len() as u64, words);
        gpu.write(self.words.buffer(), self.used * 4, bytemuck::cast_slice(&self.scratch));
        let polygons_at = self.used as u32;
        let corners_at = polygons_at + mesh.polygon_count() as u32 * POLYGON_WORDS;
        let vertices_at = corners_at + mesh.all_corners().len() as u32 * CORNER_WORDS;
        let boxes_at = vertices_at + mesh.vertices().len() as u32 * VERTEX_WORDS;
        let place = MeshLocation { polygons_at, corners_at, vertices_at, boxes_at };
        self.residents.insert(key(mesh), Resident { mesh: Arc::downgrade(mesh), place });
        self.used += words;
        Ok(())
    }
}

fn key(mesh: &Arc<Mesh>) -> usize {
    Arc::as_ptr(mesh) as usize
}

fn words_of(mesh: &Arc<Mesh>) -> u64 {
    mesh.polygon_count() as u64 * u64::from(POLYGON_WORDS)
        + mesh.all_corners().len() as u64 * u64::from(CORNER_WORDS)
        + mesh.vertices().len() as u64 * u64::from(VERTEX_WORDS)
        + mesh.clusters().len() as u64 * u64::from(BOX_WORDS)
}

/// Packs polygons, corners, vertices and cluster boxes in the layout of common.wgsl.
fn pack(mesh: &Mesh, words: &mut Vec<u32>) {
    debug_assert_eq!(mesh.polygons().len(), mesh.planes().len());
    for (polygon, plane) in mesh.polygons().iter().zip(mesh.planes()) {
        let first = polygon.first_corner as usize;
        let corners = &mesh.all_corners()[first..first + usize::from(polygon.corner_count)];
        let packed = ArenaPolygon {
            first_corner: polygon.first_corner,
            corners: u32::from(polygon.corner_count) | u32::from(polygon.material) << 8,
            source: polygon.source,
            normal: plane.normal.as_vec3().to_array(),
            spread: (spread(mesh, plane.normal, corners) as f32).next_up(),
        };
        words.extend_from_slice(bytemuck::cast_slice(&[packed]));
    }
    words.extend(mesh.all_corners());
    words.extend(mesh.vertices().iter().flat_map(|v| v.to_array().map(f32::to_bits)));
    // Boxes of f32 positions: the conversion is exact.
    let corners = mesh.clusters().iter().flat_map(|c| [c.bounds.min, c.bounds.max]);
    words.extend(corners.flat_map(|p| p.as_vec3().to_array().map(f32::to_bits)));
}

/// Extent of the corners along the normal, metres; 0 for triangles, which define their own plane.
pub(super) fn spread(mesh: &Mesh, normal: DVec3, corners: &[u32]) -> f64 {
    if corners.len() <= 3 {
        return 0.0;
    }
    let first = mesh.vertices()[corners[0] as usize].as_dvec3();
    let along = |c: &u32| normal.dot(mesh.vertices()[*c as usize].as_dvec3() - first);
    let most = corners.iter().map(along).fold(0.0, f64::max);
    most - corners.iter().map(along).fold(0.0, f64::min)
}
