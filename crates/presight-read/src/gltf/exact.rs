//! Reads the data of [`super::write_glb`] in `extras.presight`, which make the round trip lossless: polygons of meshes,
//! poses of objects and groups.

use super::accessor::Document;
use super::write::{matrix_of, mesh_hash};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use gltf::json;
use json::accessor::Type;
use json::mesh::Semantic;
use json::validation::Checked;
use presight_model::environment::{Mesh, NewObject, PolygonOrder, PolygonRecord};
use presight_model::geometry::Pose;
use serde::Deserialize;
use std::sync::Arc;

/// The polygons of a mesh, if our own writer stored them.
pub(super) enum Exact {
    /// No polygons are stored.
    None,
    /// The stored polygons do not match the vertices, because another program changed the mesh.
    Stale,
    /// The mesh as it was written.
    Mesh(Arc<Mesh>),
}

#[derive(Deserialize)]
struct MeshExtras {
    presight: Option<Polygons>,
}

/// See [`super::write_glb`].
#[derive(Deserialize)]
struct Polygons {
    rows: u32,
    corners: u32,
    order: Order,
    blake3: String,
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Order {
    Spatial,
    Given,
}

/// Our own writer's data of a mesh.
fn polygons_in(mesh: &json::Mesh) -> Option<Polygons> {
    serde_json::from_str::<MeshExtras>(mesh.extras.as_ref()?.get()).ok()?.presight
}

impl Document<'_> {
    /// Count of numbers in the exact mesh that presight wrote; 0 if the file has none.
    pub fn exact_numbers(&self, index: usize) -> u64 {
        let mesh = &self.root.meshes[index];
        let Some(polygons) = polygons_in(mesh) else { return 0 };
        let positions = mesh.primitives.first().and_then(|p| p.attributes.get(&Checked::Valid(Semantic::Positions)));
        let count = |i| self.accessor(i).map_or(0, |accessor| accessor.count.0);
        let vertices = positions.map_or(0, |i| count(*i));
        let lists = [polygons.rows, polygons.corners].map(|i| count(json::Index::new(i)));
        lists.into_iter().fold(vertices.saturating_mul(3), u64::saturating_add)
    }

    /// Reads the exact mesh of our own writer.
    pub fn exact_mesh(&self, index: usize) -> Exact {
        let mesh = &self.root.meshes[index];
        let Some(polygons) = polygons_in(mesh) else { return Exact::None };
        // If another program broke the stored polygons, the triangles are used.
        self.polygons_of(mesh, &polygons).map_or(Exact::Stale, |mesh| Exact::Mesh(Arc::new(mesh)))
    }

    fn polygons_of(&self, mesh: &json::Mesh, polygons: &Polygons) -> Option<Mesh> {
        let first = mesh.primitives.first()?;
        let positions = *first.attributes.get(&Checked::Valid(Semantic::Positions))?;
        let positions = self.values(positions, Type::Vec3, "positions").ok()?;
        let vertices: Vec<Vec3> = (0..positions.count()).map(|i| positions.get(i)).collect();
        let rows = self.indices(json::Index::new(polygons.rows)).ok()?;
        let corners = self.indices(json::Index::new(polygons.corners)).ok()?;
        if mesh_hash(&vertices, &rows, &corners) != polygons.blake3 {
            return None;
        }
        let mut records = Vec::with_capacity(rows.len() / 3);
        let mut first_corner = 0u32;
        for row in rows.as_chunks::<3>().0 {
            let [count, material, source] = *row;
            let material = u16::try_from(material).ok().filter(|m| usize::from(*m) < self.root.materials.len())?;
            records.push(PolygonRecord { first_corner, source, material, corner_count: u8::try_from(count).ok()? });
            first_corner = first_corner.checked_add(count)?;
        }
        let order = match polygons.order {
            Order::Spatial => PolygonOrder::Spatial,
            Order::Given => PolygonOrder::Given,
        };
        let name = mesh.name.clone().unwrap_or_default();
        Mesh::restored(name, vertices, corners, records, None, order, |_, _| ()).ok()
    }
}

/// Our own writer's data of a root node.
pub(super) enum RootPlacement {
    /// The pose of an object.
    Object(PlacedObject),
    /// The frame of a group.
    Group(PlacedGroup),
}

#[derive(Deserialize)]
pub(super) struct PlacedObject {
    world_from_object: [f64; 7],
    object_from_mesh: [f64; 12],
    first_source: u32,
}

#[derive(Deserialize)]
pub(super) struct PlacedGroup {
    world_from_group: [f64; 7],
}

impl RootPlacement {
    /// Reads a node's extras.
    pub fn of(extras: &serde_json::Value) -> Option<Self> {
        let ours = extras.get("presight")?;
        let object = PlacedObject::deserialize(ours).ok().map(Self::Object);
        object.or_else(|| PlacedGroup::deserialize(ours).ok().map(Self::Group))
    }
}

impl PlacedObject {
    /// Returns the object, if the node still has the matrix that was written.
    pub fn object(&self, scene_from_node: &DAffine3, path: &str, mesh: Arc<Mesh>) -> Option<NewObject> {
        let new = NewObject {
            object_from_mesh: DAffine3::from_cols_array(&self.object_from_mesh),
            first_source: self.first_source,
            ..NewObject::new(path, pose(self.world_from_object), mesh)
        };
        is_at(scene_from_node, &(new.world_from_object.to_affine() * new.object_from_mesh)).then_some(new)
    }
}

impl PlacedGroup {
    /// Returns the frame, if the node still has the matrix that was written.
    pub fn frame(&self, scene_from_node: &DAffine3) -> Option<Pose> {
        let frame = pose(self.world_from_group);
        is_at(scene_from_node, &frame.to_affine()).then_some(frame)
    }
}

fn pose([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Pose {
    Pose { translation: DVec3::new(x, y, z), rotation: DQuat::from_xyzw(qx, qy, qz, qw) }
}

/// True if a node has exactly the matrix that our writer gives for `world_from_node`.
fn is_at(scene_from_node: &DAffine3, world_from_node: &DAffine3) -> bool {
    let matrix = matrix_of(world_from_node);
    let column = |i: usize| DVec3::new(matrix[i], matrix[i + 1], matrix[i + 2]);
    let DAffine3 { matrix3, translation } = *scene_from_node;
    [0, 4, 8, 12].map(column) == [matrix3.x_axis, matrix3.y_axis, matrix3.z_axis, translation]
}
