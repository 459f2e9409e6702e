//! Trees for rays: eight-wide nodes over the triangles of a mesh, in the mesh's frame, and over the objects of a world.
//!
//! Boxes are f32, rounded outward. Trees have their own order of triangles; polygons, slots and clusters keep theirs.

mod build;

use super::boxes::{down, up};
use crate::environment::{Environment, Mesh, PolygonRecord};
use crate::error::Result;
use crate::geometry::Plane;
use crate::memory;
pub use build::{Half, Item, WideChild, WideTree, halve, widen};
use glam::{DVec3, Vec3, Vec4};

/// Children of a node, and triangles of a block.
pub const WIDE: usize = 8;

/// Marks a child that is not a node: the rest is the number of a block, or of an object.
pub const LEAF: u32 = 1 << 31;

/// No child.
pub const NO_CHILD: u32 = u32::MAX;

/// The boxes of eight children relative to the tree's origin, metres. Boxes of missing children hold nothing.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub struct RayNode {
    /// Minimum corners, by axis.
    pub low: [[f32; WIDE]; 3],
    /// Maximum corners, by axis.
    pub high: [[f32; WIDE]; 3],
    /// Number of a node, or [`LEAF`] with another number, or [`NO_CHILD`].
    pub children: [u32; WIDE],
}

/// Eight triangles. Convex polygons are fans of them.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub struct TriangleBlock {
    /// First corners relative to `base`, by axis.
    pub corner: [[f32; WIDE]; 3],
    /// Edges from the first corner to the second and to the third one, by axis.
    pub edges: [[[f32; WIDE]; 3]; 2],
    /// Polygon of each triangle.
    pub polygons: [u32; WIDE],
    /// Position relative to the tree's origin.
    pub base: [f32; 3],
    /// Maximum distance of the corners from `base`.
    pub diagonal: f32,
    /// Maximum distance between corners of one of its polygons along the normal.
    pub spread: f32,
    /// Number of triangles; the other lanes are empty.
    pub count: u32,
}

/// The triangles of a mesh.
#[derive(Clone, Debug)]
pub struct RayTree {
    /// The first node is the root; empty if there are no triangles.
    pub nodes: Vec<RayNode>,
    /// Blocks, to which leaves refer by index.
    pub blocks: Vec<TriangleBlock>,
    /// Origin of the boxes, in the frame of the mesh.
    pub origin: DVec3,
    /// Maximum absolute coordinate of the boxes.
    pub reach: f32,
}

/// The objects of a world: leaves name them by index.
#[derive(Clone, Debug)]
pub struct ObjectTree {
    /// The first node is the root; empty if there are no polygons.
    pub nodes: Vec<RayNode>,
    /// Origin of the boxes, in the world.
    pub origin: DVec3,
    /// Maximum absolute coordinate of the boxes.
    pub reach: f32,
}

/// Memory for building, bytes per triangle: an item, and half a node of two children.
const BUILDING: u64 = 80;

impl RayTree {
    /// # Errors
    /// [`crate::ErrorKind::System`] if memory is short.
    pub fn new(mesh: &Mesh) -> Result<Self> {
        let triangles: u64 = mesh.polygons().iter().map(|p| u64::from(p.corner_count) - 2).sum();
        if triangles > 100_000 {
            memory::require(triangles * (BUILDING + 80))?;
        }
        let origin = if mesh.bounds().is_empty() { DVec3::ZERO } else { mesh.bounds().center() };
        let mut items = memory::reserved(triangles as usize)?;
        let mut fans = memory::reserved(triangles as usize)?;
        let mut copies = Copies::new(mesh)?;
        for (polygon, record) in (0..).zip(mesh.polygons()) {
            if copies.is_copy(polygon) {
                continue;
            }
            let corners = record.corners(mesh.all_corners());
            for second in 1..corners.len() as u8 - 1 {
                let [a, b, c] = [0, second, second + 1].map(|k| mesh.vertices()[corners[usize::from(k)] as usize]);
                let low = rounded(a.min(b).min(c).as_dvec3() - origin, down);
                let high = rounded(a.max(b).max(c).as_dvec3() - origin, up);
                items.push(Item::new(low, high, fans.len() as u32));
                fans.push(Fan { polygon, second });
            }
        }
        drop(copies);
        let halves = halve(&mut items, WIDE);
        let mut blocks = Vec::new();
        let leaf = |own: &[Item]| {
            blocks.push(TriangleBlock::new(mesh, origin, own.iter().map(|item| fans[item.id() as usize])));
            LEAF | (blocks.len() - 1) as u32
        };
        let mut nodes = nodes_of(&halves, &items, leaf);
        nodes.shrink_to_fit();
        blocks.shrink_to_fit();
        Ok(Self { nodes, blocks, origin, reach: reach_of(&halves) })
    }

    /// Bytes of memory.
    pub fn bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<RayNode>() + self.blocks.capacity() * size_of::<TriangleBlock>()
    }
}

impl ObjectTree {
    /// The objects with polygons.
    pub fn new(environment: &Environment) -> Self {
        let boxes: Vec<_> = (0..)
            .zip(environment.objects())
            .filter(|(_, object)| object.mesh.polygon_count() > 0)
            .map(|(i, object)| (i, object.world_bounds()))
            .collect();
        let all = boxes.iter().fold(crate::geometry::Aabb::EMPTY, |all, (_, b)| all.union(*b));
        let origin = if all.is_empty() { DVec3::ZERO } else { all.center() };
        let item = |(id, b): &(u32, crate::geometry::Aabb)| {
            // Covers the rounding of the subtraction.
            let slack = f64::EPSILON * (b.min.abs().max(b.max.abs()) + origin.abs());
            Item::new(rounded(b.min - origin - slack, down), rounded(b.max - origin + slack, up), *id)
        };
        let mut items: Vec<Item> = boxes.iter().map(item).collect();
        let halves = halve(&mut items, 1);
        let nodes = nodes_of(&halves, &items, |own: &[Item]| LEAF | own[0].id());
        Self { nodes, origin, reach: reach_of(&halves) }
    }

    /// Bytes of memory.
    pub fn bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<RayNode>()
    }
}

/// A tree under construction. `leaf` returns the reference of each leaf.
struct RayNodes<L> {
    nodes: Vec<RayNode>,
    leaf: L,
}

impl<L: FnMut(&[Item]) -> u32> WideTree for RayNodes<L> {
    fn add_node(&mut self, children: &[WideChild<'_>]) -> u32 {
        let (low, high) = ([[f32::INFINITY; WIDE]; 3], [[f32::NEG_INFINITY; WIDE]; 3]);
        let mut node = RayNode { low, high, children: [NO_CHILD; WIDE] };
        for (lane, child) in children.iter().enumerate() {
            for axis in 0..3 {
                (node.low[axis][lane], node.high[axis][lane]) = (child.low[axis], child.high[axis]);
            }
        }
        self.nodes.push(node);
        (self.nodes.len() - 1) as u32
    }

    fn add_leaf(&mut self, items: &[Item]) -> u32 {
        (self.leaf)(items)
    }

    fn name_child(&mut self, node: u32, lane: usize, name: u32) {
        self.nodes[node as usize].children[lane] = name;
    }
}

fn nodes_of(halves: &[Half], items: &[Item], leaf: impl FnMut(&[Item]) -> u32) -> Vec<RayNode> {
    let mut tree = RayNodes { nodes: Vec::new(), leaf };
    widen(halves, items, &mut tree);
    tree.nodes
}

/// Finds polygons that no ray ever sees, because an earlier one has the same corners in the same order, the same plane
/// and the same material: edges and inverse depths have the same bits, and the earlier polygon wins ties.
struct Copies<'a> {
    mesh: &'a Mesh,
    /// Polygons by a hash of their corners.
    table: Vec<u32>,
}

/// Number of table entries to probe. A copy that is not found among them only costs time.
const PROBES: usize = 8;

impl<'a> Copies<'a> {
    fn new(mesh: &'a Mesh) -> Result<Self> {
        let size = (2 * mesh.polygon_count()).next_power_of_two();
        let mut table = memory::reserved(size)?;
        table.resize(size, u32::MAX);
        Ok(Self { mesh, table })
    }

    fn corners(&self, polygon: u32) -> impl Iterator<Item = Vec3> + '_ {
        self.mesh.corner_indices(polygon).iter().map(|corner| self.mesh.vertices()[*corner as usize])
    }

    /// For each edge, true if its vertices are in ascending order: the canonical order in which engines subtract them.
    fn rises(&self, polygon: u32) -> impl Iterator<Item = bool> + '_ {
        let corners = self.mesh.corner_indices(polygon);
        corners.iter().zip(corners.iter().cycle().skip(1)).map(|(a, b)| a < b)
    }

    /// True for a copy of an earlier polygon. Records the polygon otherwise.
    fn is_copy(&mut self, polygon: u32) -> bool {
        let mix = |hash: u64, p: Vec3| {
            let [x, y, z] = p.to_array().map(|c| u64::from(c.to_bits()));
            let hash = (hash ^ x ^ y << 32).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            (hash ^ hash >> 29 ^ z).wrapping_mul(0xbf58_476d_1ce4_e5b9)
        };
        let hash = self.corners(polygon).fold(0, mix);
        for step in 0..PROBES {
            let at = ((hash >> 20) as usize + step) & (self.table.len() - 1);
            let known = self.table[at];
            if known == u32::MAX {
                self.table[at] = polygon;
                return false;
            }
            let surface = |i| (self.mesh.material(i), self.mesh.plane(i));
            let same = surface(known) == surface(polygon) && self.corners(known).eq(self.corners(polygon));
            if same && self.rises(known).eq(self.rises(polygon)) {
                return true;
            }
        }
        false
    }
}

/// A triangle of a polygon: its first corner, this one and the next.
#[derive(Clone, Copy)]
struct Fan {
    polygon: u32,
    second: u8,
}

impl TriangleBlock {
    fn new(mesh: &Mesh, origin: DVec3, fans: impl Iterator<Item = Fan> + Clone) -> Self {
        let place = |fan: Fan| {
            let corners = mesh.corner_indices(fan.polygon);
            let second = usize::from(fan.second);
            [0, second, second + 1].map(|k| mesh.vertices()[corners[k] as usize].as_dvec3() - origin)
        };
        let base = fans.clone().flat_map(place).fold(DVec3::INFINITY, DVec3::min).as_vec3();
        let mut block = Self {
            corner: [[0.0; WIDE]; 3],
            edges: [[[0.0; WIDE]; 3]; 2],
            polygons: [u32::MAX; WIDE],
            base: base.to_array(),
            diagonal: 0.0,
            spread: 0.0,
            count: 0,
        };
        let (mut farthest, mut spread) = (0.0f64, 0.0f64);
        for (lane, fan) in fans.enumerate() {
            let [a, b, c] = place(fan);
            let from_base = [a, b, c].map(|p| p - base.as_dvec3());
            farthest = from_base.iter().map(|p| p.length()).fold(farthest, f64::max);
            for axis in 0..3 {
                block.corner[axis][lane] = from_base[0][axis] as f32;
                block.edges[0][axis][lane] = (b - a)[axis] as f32;
                block.edges[1][axis][lane] = (c - a)[axis] as f32;
            }
            block.polygons[lane] = fan.polygon;
            block.count += 1;
            let record = mesh.polygons()[fan.polygon as usize];
            spread = spread.max(spread_of(mesh, record, mesh.plane(fan.polygon)));
        }
        (block.diagonal, block.spread) = ((farthest as f32).next_up(), (1.01 * spread) as f32);
        block
    }
}

/// Maximum distance between corners of a polygon along its normal: 0 for a triangle.
fn spread_of(mesh: &Mesh, record: PolygonRecord, plane: Plane) -> f64 {
    if record.corner_count == 3 {
        return 0.0;
    }
    let corners = record.corners(mesh.all_corners());
    let place = |corner: u32| mesh.vertices()[corner as usize].as_dvec3();
    let offs = corners.iter().map(|&c| plane.normal.dot(place(c) - place(corners[0])));
    let (low, high) = offs.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), off| (low.min(off), high.max(off)));
    high - low
}

fn rounded(p: DVec3, round: impl Fn(f64) -> f32) -> Vec3 {
    Vec3::from_array(p.to_array().map(round))
}

fn reach_of(binary: &[Half]) -> f32 {
    let greatest = |p: Vec4| p.truncate().abs().max_element();
    binary.first().map_or(0.0, |root| greatest(root.low).max(greatest(root.high)))
}

#[cfg(test)]
mod tests;
