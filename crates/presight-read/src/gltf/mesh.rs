//! The triangles of a glTF mesh: all its primitives, in any topology, with equal positions welded.

use super::accessor::{AccessorCounts, Document, Values, position_accessor};
use super::buffers::REPAIR;
use super::nodes::Shape;
use super::quoted;
use super::skin::{Posed, RestPose, influence_accessors};
use crate::preparation::{ProblemKind, TriangleMesh, Welder};
use glam::Vec3;
use gltf::json;
use json::accessor::Type;
use json::mesh::{Mode, Primitive};
use json::validation::Checked;
use presight_model::error::{Error, Result};

/// The triangles of a mesh, and problems that are not about single triangles.
pub(super) struct MeshTriangles {
    pub triangles: TriangleMesh,
    pub notes: Vec<(ProblemKind, String)>,
}

/// Number of triangles of a primitive; `None` for points and lines.
fn triangle_count(mode: Mode, corners: u64) -> Option<u64> {
    match mode {
        Mode::Triangles => Some(corners / 3),
        Mode::TriangleStrip | Mode::TriangleFan => Some(corners.saturating_sub(2)),
        Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => None,
    }
}

fn mode_of(primitive: &Primitive) -> Result<Mode> {
    match primitive.mode {
        Checked::Valid(mode) => Ok(mode),
        Checked::Invalid => Err(Error::invalid("unknown primitive mode", REPAIR)),
    }
}

/// Names a mesh in messages.
pub(super) fn mesh_words(root: &json::Root, mesh: usize) -> String {
    let name = root.meshes.get(mesh).and_then(|m| m.name.as_deref()).unwrap_or("");
    format!("mesh {mesh} {}", quoted(name))
}

impl Document<'_> {
    /// Number of triangles of a mesh, from the accessors' counts. Checks that their data exist.
    pub fn claimed_triangles(&self, shape: Shape, proven: &mut AccessorCounts) -> Result<u64> {
        let mesh = shape.mesh;
        let place = |e: Error| e.at(mesh_words(&self.root, mesh));
        let Some(m) = self.root.meshes.get(mesh) else {
            let what = format!("mesh {mesh} does not exist, there are {}", self.root.meshes.len());
            return Err(Error::invalid(what, REPAIR));
        };
        let mut sum = 0u64;
        for (i, primitive) in m.primitives.iter().enumerate() {
            let inner = |e: Error| place(e.at(format!("primitive {i}")));
            let Some(positions) = position_accessor(primitive) else { continue };
            let vertices = self.proven_count(positions, proven).map_err(inner)?;
            let corners = primitive.indices.map(|i| self.proven_count(i, proven)).transpose().map_err(inner)?;
            let corners = corners.unwrap_or(vertices);
            if shape.skin.is_some() {
                self.prove_influences(primitive, proven).map_err(inner)?;
            }
            sum = sum.saturating_add(triangle_count(mode_of(primitive).map_err(inner)?, corners).unwrap_or(0));
        }
        Ok(sum)
    }

    /// Reads a mesh, whose index must be valid, in its own frame or in that of `pose`. Primitives without a material
    /// get `default_material`.
    pub fn read_mesh(&self, mesh: usize, pose: Option<&RestPose>, default_material: u16) -> Result<MeshTriangles> {
        let mut read = MeshTriangles { triangles: TriangleMesh::default(), notes: Vec::new() };
        let mut welder = Welder::default();
        let mut shared = None;
        for (i, primitive) in self.root.meshes[mesh].primitives.iter().enumerate() {
            let words = || format!("{}: primitive {i}", mesh_words(&self.root, mesh));
            self.read_primitive((primitive, pose), default_material, &mut welder, &mut shared, &mut read)
                .map_err(|e| e.at(words()))?
                .into_iter()
                .for_each(|(kind, what)| read.notes.push((kind, format!("{}: {what}", words()))));
            read.triangles.end_primitive();
        }
        Ok(read)
    }

    fn read_primitive<'a>(
        &'a self,
        (primitive, pose): (&Primitive, Option<&'a RestPose>),
        default_material: u16,
        welder: &mut Welder,
        shared: &mut Option<PositionCache<'a>>,
        read: &mut MeshTriangles,
    ) -> Result<Vec<(ProblemKind, String)>> {
        let mut notes = Vec::new();
        let mode = mode_of(primitive)?;
        let Some(accessor) = position_accessor(primitive) else {
            return Ok(vec![(ProblemKind::IgnoredPrimitive, "no positions".into())]);
        };
        // Skips points and lines before anything is read: any number of them can share large accessors.
        let corners = self.accessor(primitive.indices.unwrap_or(accessor))?.count.0;
        let Some(count) = triangle_count(mode, corners) else {
            return Ok(vec![(ProblemKind::IgnoredPrimitive, format!("{mode:?} with {corners} indices"))]);
        };
        let influences = pose.map_or_else(Vec::new, |_| influence_accessors(primitive));
        let is_same = |s: &PositionCache<'_>| s.accessor == accessor.value() && s.influences == influences;
        let positions = match shared.take().filter(is_same) {
            Some(known) => shared.insert(known),
            None => {
                let positions = self.values(accessor, Type::Vec3, "positions")?;
                let posed = pose.map(|pose| self.posed(primitive, pose, positions.count())).transpose()?;
                let (accessor, welded) = (accessor.value(), Vec::new());
                shared.insert(PositionCache { accessor, influences, positions, posed, welded })
            }
        };
        let indices = primitive.indices.map(|i| self.indices(i)).transpose()?;
        let corners = indices.as_ref().map_or(positions.positions.count(), Vec::len);
        if primitive.targets.as_ref().is_some_and(|t| !t.is_empty()) {
            notes.push((ProblemKind::IgnoredFeature, "morph targets: the base shape is used".into()));
        }
        let leftover = match mode {
            Mode::Triangles => corners % 3,
            _ if corners < 3 => corners,
            _ => 0,
        };
        if leftover > 0 {
            notes.push((ProblemKind::LeftoverIndices, format!("{leftover} of {corners} indices")));
        }
        let material = self.material_of(primitive)?.unwrap_or(default_material);
        positions.prepare(corners);
        let mut corner = Corners { shared: positions, indices: indices.as_deref(), welder };
        let mesh = &mut read.triangles;
        for t in 0..count as usize {
            let at = match mode {
                Mode::TriangleStrip => [t, t + 1 + t % 2, t + 2 - t % 2],
                Mode::TriangleFan => [t + 1, t + 2, 0],
                _ => [3 * t, 3 * t + 1, 3 * t + 2],
            };
            let mut triangle = [0; 3];
            for (slot, at) in triangle.iter_mut().zip(at) {
                *slot = corner.vertex(at, &mut mesh.vertices)?;
            }
            mesh.push(triangle, material);
        }
        Ok(notes)
    }

    fn material_of(&self, primitive: &Primitive) -> Result<Option<u16>> {
        let count = self.root.materials.len();
        match primitive.material.map(|m| m.value()) {
            Some(material) if material >= count => {
                Err(Error::invalid(format!("material {material} does not exist, there are {count}"), REPAIR))
            }
            material => Ok(material.map(|m| m as u16)),
        }
    }
}

/// The positions of the last accessor. Primitives of a mesh often share one.
struct PositionCache<'a> {
    accessor: usize,
    /// The accessors of joints and weights, if a skin poses the mesh.
    influences: Vec<usize>,
    positions: Values<'a>,
    posed: Option<Posed<'a>>,
    /// The welded vertex for each vertex of the accessor, `u32::MAX` if not welded yet; empty if not worth the memory.
    welded: Vec<u32>,
}

impl PositionCache<'_> {
    /// Allocates `welded`, unless the primitive uses only a small part of a large accessor.
    fn prepare(&mut self, corners: usize) {
        let count = self.positions.count();
        if self.welded.is_empty() && count <= 4 * corners {
            self.welded = vec![u32::MAX; count];
        }
    }
}

/// Maps the corner numbers of a primitive to welded vertices.
struct Corners<'a, 'b> {
    shared: &'a mut PositionCache<'b>,
    indices: Option<&'a [u32]>,
    welder: &'a mut Welder,
}

impl Corners<'_, '_> {
    fn vertex(&mut self, corner: usize, vertices: &mut Vec<Vec3>) -> Result<u32> {
        let vertex = self.indices.map_or(corner, |i| i[corner] as usize);
        let count = self.shared.positions.count();
        if vertex >= count {
            return Err(Error::invalid(
                format!("index {corner} is {vertex}, out of range: there are {count} vertices"),
                REPAIR,
            ));
        }
        if let Some(&known) = self.shared.welded.get(vertex).filter(|&&known| known != u32::MAX) {
            return Ok(known);
        }
        let mut position = self.shared.positions.get(vertex);
        if let Some(posed) = &self.shared.posed {
            position = posed.place(vertex, position)?;
        }
        let reach = f64::from(position.abs().max_element());
        if !position.is_finite() || reach > presight_model::limits::MAX_COORDINATE {
            return Err(Error::invalid(format!("vertex {vertex} is {position}, not a finite position"), REPAIR));
        }
        let welded = self.welder.weld(position, vertices);
        if let Some(known) = self.shared.welded.get_mut(vertex) {
            *known = welded;
        }
        Ok(welded)
    }
}
