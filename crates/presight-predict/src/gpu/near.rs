//! Sets up in f64 the polygons seen so nearly edge-on that f32 cannot decide their side or keeps too little of their
//! distance; `verify::bound` relies on it. Only clusters near the sensor are checked: farther polygons that are as flat
//! are hardly thicker than a ray.

use super::geometry::spread;
use super::grid::Tables;
use super::layout::{
    EDGE_WORDS, GridKind, ITEMS_PER_POLYGON, Item, LINES_PER_ITEM, RECORD_WORDS, Record, SAMPLES_PER_ITEM, Slot,
    TILE_SIDE, TILES_PER_SUPERTILE,
};
use glam::{DMat3, DVec3};
use presight_model::environment::Mesh;
use presight_render::plan::{FramePlan, Instance, Run};
use presight_render::verify::SET_UP_FINELY;

/// Ratio |d| / |v| below which the CPU takes over. It includes rounding, and is far above the shader's own limit.
const FLAT: f64 = 1.001 * SET_UP_FINELY;
/// Ratio |d| / |c| below which the CPU takes over, because two f32 may not represent the centre well enough.
const CENTER: f64 = 6.0e-11;

/// Flag that distinguishes stamps from record offsets.
pub(super) const STAMPED: u32 = 1 << 31;

/// Records and items made on the CPU, in the layout of the setup stage.
#[derive(Default)]
pub(super) struct NearList {
    pub records: Vec<u32>,
    pub items: Vec<Item>,
    /// Each polygon's slot, with the data that the resolve stage reads.
    pub slots: Vec<(u32, Slot)>,
    /// Frame number with the highest bit set. The shader skips polygons whose slot carries it.
    pub stamp: u32,
    /// Number of polygons that are edge-on within f64 rounding; they cover no ray.
    pub edge_on: u32,
}

/// Index of the cluster in which a run begins.
pub(super) fn cluster_of(mesh: &Mesh, run: &Run) -> usize {
    mesh.clusters().partition_point(|c| c.first + c.count <= run.first)
}

/// True if the sensor is within one cluster size of a cluster of the run.
pub(super) fn is_near(mesh: &Mesh, instance: &Instance, run: &Run) -> bool {
    mesh.clusters()[cluster_of(mesh, run)..].iter().take_while(|c| c.first < run.first + run.count).any(|c| {
        let size = c.bounds.size();
        c.bounds.distance_squared(instance.center_in_mesh) <= size * size
    })
}

impl NearList {
    /// Begins a new frame.
    pub fn clear(&mut self) {
        self.stamp = STAMPED | self.stamp.wrapping_add(1);
        self.records.clear();
        self.items.clear();
        self.slots.clear();
        self.edge_on = 0;
    }

    /// Adds the nearly edge-on polygons of a near run.
    pub fn add(&mut self, plan: &FramePlan, tables: &Tables, instance: &Instance, run: &Run) {
        let mesh = &plan.environment().objects()[instance.object as usize].mesh;
        for polygon in run.first..run.first + run.count {
            let normal = mesh.plane(polygon).normal;
            let from_center = mesh.corners_of(polygon).map(|p| p - instance.center_in_mesh);
            let nearer = |a: DVec3, b: DVec3| if b.length_squared() < a.length_squared() { b } else { a };
            let nearest = from_center.reduce(nearer).unwrap_or(DVec3::ZERO);
            let distance = normal.dot(nearest);
            let spread = spread(mesh, normal, mesh.corner_indices(polygon));
            let doubt = FLAT * nearest.length() + CENTER * instance.center_in_mesh.length() + 1.001 * spread;
            if distance.abs() > doubt + f64::from(f32::MIN_POSITIVE) {
                continue;
            }
            let facing = plan.facings[usize::from(mesh.material(polygon))];
            if !facing.opaque || facing.one_sided && distance > 0.0 {
                continue;
            }
            // As in the other engines: the side is certain, and the distance exceeds the corners' spread.
            if distance.abs() <= 16.0 * f64::EPSILON * nearest.length() + spread {
                self.edge_on += 1;
                continue;
            }
            self.set_up(plan, tables, instance, polygon, distance);
        }
    }

    fn set_up(&mut self, plan: &FramePlan, tables: &Tables, instance: &Instance, polygon: u32, distance: f64) {
        let object = &plan.environment().objects()[instance.object as usize];
        let mesh = &object.mesh;
        let line_vector = tables.image_from_line.transpose();
        let normal = instance.normal_from_mesh * mesh.plane(polygon).normal;
        let m = line_vector * (normal / distance);
        let slot = object.first_slot + polygon;
        let at = self.records.len() as u32;
        let corners: Vec<DVec3> =
            mesh.corners_of(polygon).map(|p| instance.image_from_mesh * (p - instance.center_in_mesh)).collect();
        let wedge = wedge(&corners, normal.normalize());
        let edge_count = (corners.len() + wedge.len()) as u32;
        // No cap.
        let (cap_axis, cap_chord) = ([1.0, 0.0, 0.0], -1.0);
        let record = Record { m: m.as_vec3().to_array(), slot, edge_count, cap_axis, cap_chord };
        self.records.extend_from_slice(bytemuck::cast_slice(&[record]));
        let sign = (distance * instance.image_from_mesh.determinant()).signum();
        for (k, b) in corners.iter().enumerate() {
            let a = corners[(k + corners.len() - 1) % corners.len()];
            self.records.extend(edge(a, *b, sign, line_vector).map(f32::to_bits));
        }
        for e in &wedge {
            self.records.extend(scaled(line_vector * *e).map(f32::to_bits));
        }
        debug_assert_eq!(self.records.len() as u32, at + RECORD_WORDS + edge_count * EDGE_WORDS);
        let distance = (distance.abs() / normal.length()) as f32;
        let source = object.first_source + mesh.source(polygon) + 1;
        self.slots.push((slot, Slot { distance, object: instance.object + 1, source, record: self.stamp }));
        self.add_items(at, tables);
    }

    /// Adds items for every line: computing bounds does not pay for so few polygons.
    fn add_items(&mut self, record: u32, tables: &Tables) {
        let (lines, samples) = (tables.params.line_count, tables.params.sample_count);
        if tables.kind == GridKind::Rays {
            // Two rows of tiles each.
            let (high, wide) = (2 * TILE_SIDE, TILES_PER_SUPERTILE * TILE_SIDE);
            for row in (0..lines).step_by(high as usize) {
                for column in (0..samples).step_by(wide as usize) {
                    let (end_row, end_column) = ((row + high).min(lines), (column + wide).min(samples));
                    self.items.push(Item { record, part: row | column << 16, within: end_row | end_column << 16 });
                }
            }
            return;
        }
        let share = lines.div_ceil(ITEMS_PER_POLYGON).max(LINES_PER_ITEM);
        for first in (0..lines).step_by(share as usize) {
            let part = first | share.min(lines - first) << 16;
            for sample in (0..samples).step_by(SAMPLES_PER_ITEM as usize) {
                let end = samples.min(sample + SAMPLES_PER_ITEM);
                self.items.push(Item { record, part, within: sample | end << 16 });
            }
        }
    }
}

/// The plane through the sensor and an edge, in the line frame.
fn edge(a: DVec3, b: DVec3, sign: f64, line_vector: DMat3) -> [f32; 3] {
    let anchor = if b.length_squared() < a.length_squared() { b } else { a };
    scaled(line_vector * (sign * anchor.cross(b - a)))
}

/// Scales to unit magnitude, in the middle of f32's range.
fn scaled(e: DVec3) -> [f32; 3] {
    let largest = e.abs().max_element();
    if largest > 0.0 { (e / largest).as_vec3().to_array() } else { [0.0; 3] }
}

/// Two planes perpendicular to the polygon's own that enclose it, for a sensor in its plane but outside of it. There
/// all edge planes nearly coincide with the polygon's plane, and their f32 roundings may intersect anywhere along it.
fn wedge(corners: &[DVec3], normal: DVec3) -> Vec<DVec3> {
    let turn = |a: DVec3, b: DVec3| normal.dot(a.cross(b));
    let (mut least, mut most) = (corners[0], corners[0]);
    for v in corners {
        least = if turn(least, *v) < 0.0 { *v } else { least };
        most = if turn(most, *v) > 0.0 { *v } else { most };
    }
    let (a, b) = (least.normalize_or_zero(), most.normalize_or_zero());
    // The outermost corners are 0 within rounding.
    let beyond = |turned: f64, v: &DVec3| turned < -1e-12 * v.length();
    let around = corners.iter().any(|v| beyond(turn(a, *v), v) || beyond(turn(*v, b), v));
    if around || turn(a, b) <= 0.0 {
        return Vec::new();
    }
    // Wider than an edge's rounding error.
    let slack = 1e-5 * (a + b);
    vec![normal.cross(a) + slack, b.cross(normal) + slack]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DAffine3, Vec3};
    use presight_model::{Environment, Material, NewObject, Polygon, PolygonOrder, Pose, World};
    use presight_read::preset;
    use presight_render::plan::ImageRequest;
    use presight_render::reference::Face;
    use presight_render::verify::is_set_up_finely;
    use proptest::prelude::*;
    use std::sync::Arc;

    /// Plates of many sizes in or near the sensor's plane, among others that only share their clusters.
    fn plates(shift: [f64; 3], size: f64, scale: [f64; 3], turn: f64) -> World {
        let mut environment = Environment::new();
        environment.add_material(Material::named("paint")).unwrap();
        let (mut vertices, mut polygons) = (Vec::new(), Vec::new());
        for i in 0..150 {
            let side = size * 1.05f64.powi(i % 50);
            let z = if i % 3 == 0 { 0.0 } else { f64::from(i - 75) * 0.03 * size };
            let (x, y) = (f64::from(i % 12 - 6) * size, f64::from(i / 12 - 6) * size);
            let corner = |a: f64, b: f64| Vec3::new((x + a * side) as f32, (y + b * side) as f32, z as f32);
            let first = vertices.len() as u32;
            vertices.extend([corner(0.0, 0.0), corner(1.0, 0.1), corner(0.9, 1.0)]);
            polygons.push(Polygon::new(vec![first, first + 1, first + 2], 0));
        }
        let mesh = Arc::new(Mesh::new("plates", vertices, polygons, PolygonOrder::Spatial).unwrap());
        let pose = Pose::from_xyz_rpy(DVec3::from(shift), 0.3 * turn, -0.2 * turn, turn);
        let object_from_mesh = DAffine3::from_scale(DVec3::from(scale));
        environment.insert(NewObject { object_from_mesh, ..NewObject::new("plates", pose, mesh) }).unwrap();
        World::new(environment)
    }

    proptest! {
        /// Every polygon that `verify::bound` assumes to be set up in f64 is in the list.
        #[test]
        fn what_the_bound_counts_on_is_in_the_list(
            height in -9.0..0.0f64,
            at in proptest::array::uniform2(-8.0..8.0f64),
            size in -2.0..2.0f64,
            scale in proptest::array::uniform3(0.3..3.0f64),
            turn in 0.0..1.0f64,
        ) {
            let size = size.exp2();
            let world = plates([0.0; 3], size, scale, turn);
            let object = &world.environment().objects()[0];
            let above = DVec3::new(at[0] * size, at[1] * size, height.exp2() * 0.02 * size);
            let place = object.world_from_mesh().transform_point3(above);
            let sensor = preset("microwave-radar-image").unwrap();
            let pose = Pose::from_xyz_rpy(place, 0.1, 0.2, turn);
            let plan = FramePlan::new(&world, &sensor, &pose, ImageRequest::default()).unwrap();
            let (tables, mut list) = (Tables::new(&sensor).unwrap(), NearList::default());
            let (mut wanted, mut edge_on) = (Vec::new(), 0);
            for run in &plan.runs {
                let instance = &plan.instances[run.instance as usize];
                if is_near(&object.mesh, instance, run) {
                    list.add(&plan, &tables, instance, run);
                }
                for polygon in run.first..run.first + run.count {
                    let face = Face::new(instance, &object.mesh, polygon);
                    if is_set_up_finely(&face) {
                        wanted.push(object.first_slot + polygon);
                        edge_on += u32::from(face.edge_on());
                    }
                }
            }
            prop_assume!(!wanted.is_empty());
            let taken: Vec<u32> = list.slots.iter().map(|s| s.0).collect();
            let missing = wanted.iter().filter(|slot| !taken.contains(slot)).count() as u32;
            prop_assert!(missing <= list.edge_on.max(edge_on), "{missing} of {} are missing", wanted.len());
        }
    }
}
