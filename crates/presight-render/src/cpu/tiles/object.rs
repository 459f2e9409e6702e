//! Objects in the view of a tile: a tree, with the tile's axes and the sensor in its frame.

use super::super::instance::RayInstance;
use crate::plan::{FramePlan, Instance};
use glam::{DMat3, DVec3};
use presight_model::geometry::{Aabb, Pose};
use presight_model::index::{ObjectTree, RayNode, RayTree};
use presight_model::sensor::RayTile;

/// Factors on the margins of the search, which docs/design/precision.md derives. Factors below 1 are faults, which
/// tests plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margins {
    /// Factor for edges and depths.
    pub edges: f32,
    /// Factor for boxes.
    pub boxes: f32,
    /// Factor for positions of triangles among the rays of a tile.
    pub places: f32,
}

impl Margins {
    /// The derived margins.
    pub const SOUND: Self = Self { edges: 1.0, boxes: 1.0, places: 1.0 };
}

/// Rounding of f32, relative.
const EPSILON: f32 = 0.5 * f32::EPSILON;

/// Error of a triangle's edge as a function of the ray, relative to reach times sides: see docs/design/precision.md,
/// *Tiles*.
const MARGIN: f32 = 32.0 * EPSILON;

/// Error of a box relative to a plane, as a share of the coordinates in the sum.
const BOX_MARGIN: f32 = 16.0 * EPSILON;

/// Error of a corner's position in the tile, relative to reach over depth.
const PLACE_MARGIN: f32 = 4e-6;

/// An object in a frame.
pub(super) struct PlacedObject<'a> {
    pub at: RayInstance<'a>,
    pub tree: &'a RayTree,
    /// The bundle of rays from whose pose it is seen.
    pub bundle: u32,
    instance: Instance,
    /// Upper bounds of the factor by which vectors grow from the mesh to the image, and of the difference between two
    /// such factors.
    stretch: [f32; 2],
    /// Boxes of the object in which polygons are absent.
    pub absent: Vec<Aabb>,
    /// True if no polygon requires a check of material or absence.
    pub plain: bool,
    pub mirrors: bool,
}

/// Result of placing an object.
pub(super) enum Placing<'a> {
    /// The sensor's class does not see it, or it is absent.
    Unseen,
    /// Its mesh has no tree yet.
    Lacking,
    Placed(Box<PlacedObject<'a>>),
}

impl<'a> Placing<'a> {
    #[cold]
    #[inline(never)]
    pub fn new(plan: &'a FramePlan, (bundle, world_from_sensor): (u32, &Pose), object: u32) -> Self {
        let environment = plan.environment();
        let mesh = &environment.objects()[object as usize].mesh;
        let Some(absent) = environment.absent_parts(object, &plan.sensor.spec().class) else { return Self::Unseen };
        if !mesh.materials().iter().any(|m| plan.facings[usize::from(*m)].opaque) {
            return Self::Unseen;
        }
        let Some(tree) = mesh.known_ray_tree() else { return Self::Lacking };
        let instance = plan.instance_from(world_from_sensor, object);
        let at = RayInstance::new(plan, &instance);
        Self::Placed(Box::new(PlacedObject {
            plain: at.plain && absent.is_empty(),
            at,
            tree,
            bundle,
            mirrors: instance.mirrors,
            stretch: stretch_of(&instance),
            instance,
            absent,
        }))
    }
}

/// See [`PlacedObject::stretch`].
fn stretch_of(instance: &Instance) -> [f32; 2] {
    let [length, inverse] = instance.norms.map(|norm| norm * (1.0 + 1e-6));
    // Both norms of a rotation are the root of three.
    let uniform = length * inverse <= 3.0 + 1e-5;
    let stretch = if uniform { [length / 3f64.sqrt(), 1.0] } else { [length, length * inverse] };
    stretch.map(|x| x as f32)
}

impl<'a> PlacedObject<'a> {
    /// Sees it from the pose of another bundle of rays.
    #[inline(never)]
    pub fn turn_to(&mut self, plan: &'a FramePlan, (bundle, world_from_sensor): (u32, &Pose)) {
        self.bundle = bundle;
        self.instance = self.instance.again(plan.environment(), &plan.sensor, world_from_sensor);
        self.at = RayInstance::new(plan, &self.instance);
        self.stretch = stretch_of(&self.instance);
    }
}

impl PlacedObject<'_> {
    /// True unless a polygon is left out for its material, for its side, or because it is absent.
    #[cold]
    #[inline(never)]
    pub fn shows(&self, plan: &FramePlan, polygon: u32, averted: bool) -> bool {
        let facing = plan.facings[usize::from(self.at.mesh.material(polygon))];
        let left_out = !facing.opaque || (facing.one_sided && averted);
        !left_out && (self.absent.is_empty() || !plan.environment().lies_in(self.at.object, polygon, &self.absent))
    }
}

/// A tree in the view of one tile.
#[derive(Clone)]
pub(super) struct TreeView<'a> {
    pub nodes: &'a [RayNode],
    /// Number of the placed object; unused for the tree of objects.
    pub object: u32,
    /// Axes of the tile in the frame of the tree, f64 and f32.
    axes: [DVec3; 3],
    pub turn: [[f32; 3]; 3],
    /// The sensor relative to the tree's origin.
    centre: DVec3,
    pub centre32: [f32; 3],
    /// Planes through the sensor around the tile's rays, inside positive.
    pub planes: [[f32; 3]; 4],
    /// A box up to this far outside a plane may be inside.
    pub slack: f32,
    /// Error of edges and of planes of depth.
    pub margin: f32,
    /// Error of a corner's position, relative to reach over depth.
    pub places: f32,
    pub stretch: f32,
}

impl<'a> TreeView<'a> {
    /// A view from the matrix from the tree's frame to the image, the sensor in that frame, and the bound of
    /// coordinates.
    #[inline(always)]
    fn new(
        nodes: &'a [RayNode],
        tile: &RayTile,
        image_from_tree: &DMat3,
        centre: DVec3,
        reach: f32,
        margins: Margins,
    ) -> Self {
        let turned = |axis: DVec3| {
            let m = image_from_tree;
            DVec3::new(m.x_axis.dot(axis), m.y_axis.dot(axis), m.z_axis.dot(axis))
        };
        let axes = [turned(tile.axes[0]), turned(tile.axes[1]), turned(tile.axes[2])];
        let [a, u, v] = axes;
        let [s0, s1, t0, t1] = [tile.s_range[0], tile.s_range[1], tile.t_range[0], tile.t_range[1]].map(f64::from);
        let planes = [u - a * s0, a * s1 - u, v - a * t0, a * t1 - v];
        let size = |p: DVec3| p.x.abs() + p.y.abs() + p.z.abs();
        let largest = planes.iter().fold(size(a), |most, p| most.max(size(*p))) as f32;
        let coordinates = centre.abs().max_element() as f32 + reach;
        let width = 1.0 + most(tile.s_range) + most(tile.t_range);
        let narrow = |p: DVec3| [p.x as f32, p.y as f32, p.z as f32];
        Self {
            nodes,
            object: u32::MAX,
            axes,
            turn: [narrow(a), narrow(u), narrow(v)],
            centre,
            centre32: narrow(centre),
            planes: [narrow(planes[0]), narrow(planes[1]), narrow(planes[2]), narrow(planes[3])],
            slack: margins.boxes * BOX_MARGIN * largest * coordinates,
            margin: margins.edges * MARGIN * width,
            places: margins.places * PLACE_MARGIN * width,
            stretch: 1.0,
        }
    }

    /// View of the tree of objects.
    #[inline(always)]
    pub fn of_world(
        tree: &'a ObjectTree,
        image_from_world: &DMat3,
        centre: DVec3,
        tile: &RayTile,
        margins: Margins,
    ) -> Self {
        Self::new(&tree.nodes, tile, image_from_world, centre - tree.origin, tree.reach, margins)
    }

    /// View of a placed object.
    #[inline(always)]
    pub fn of_object(placed: &PlacedObject<'a>, number: u32, tile: &RayTile, margins: Margins) -> Self {
        let tree = placed.tree;
        let centre = placed.at.center - tree.origin;
        let view = Self::new(&tree.nodes, tile, &placed.instance.image_from_mesh, centre, tree.reach, margins);
        let [stretch, apart] = placed.stretch;
        Self { object: number, margin: view.margin * apart, places: view.places * apart, stretch, ..view }
    }

    /// A point of the tree in the tile's axes, f64 until the sensor is subtracted.
    #[inline(always)]
    pub fn place(&self, p: [f32; 3]) -> [f32; 3] {
        let p = DVec3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2])) - self.centre;
        [self.axes[0].dot(p) as f32, self.axes[1].dot(p) as f32, self.axes[2].dot(p) as f32]
    }
}

fn most(range: [f32; 2]) -> f32 {
    range[0].abs().max(range[1].abs())
}
