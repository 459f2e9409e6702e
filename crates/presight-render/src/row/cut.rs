//! The intersection of the world with one height: all surfaces that a level one-row scanner can see, as segments.
//!
//! A segment has bounds of its difference from an engine's results, see `docs/design/row.md`: positions differ by the
//! rounding of transforms, an end by this rounding times the slope of its edge, and the plane by the errors of the
//! polygon's corners.

use super::segment::{NO_COPY, Segment, distance};
use super::tree::{self, Block, Node};
use crate::plan::facing::{Facing, facings};
use glam::{DAffine3, DMat3, DVec2, DVec3, Vec3};
use presight_model::environment::Object;
use presight_model::geometry::Aabb;
use presight_model::index::{QueryResult, Region};
use presight_model::world::World;
use std::collections::HashMap;
use std::time::Duration;

/// Maximum tilt of a scanner that can use a cut, radians. Poses from files are right to 1e-16.
pub const MAX_TILT: f64 = 1e-11;

/// Maximum distance of a scanner from the world's bounds, in diagonals of the bounds.
const MAX_APART: f64 = 1.0;

/// Upper bound of the time to make a cut, per polygon of the world.
const POLYGON: Duration = Duration::from_micros(1);

/// Relative rounding error of a chain of transforms.
const TRANSFORMS: f64 = 16.0 * f64::EPSILON;

/// One version of the world at one height, for one sensor class.
#[derive(Debug, Default)]
pub struct RowCut {
    /// Segments where polygons cross the height, in the order of the blocks, then the copies of segments, which no beam
    /// has to be tested against.
    pub segments: Vec<Segment>,
    /// The objects of the segments, with the corners of their polygons in the mesh frame: the data of a winner that
    /// engines need.
    pub(crate) objects: Vec<CutObject>,
    corners: Vec<Vec3>,
    /// The first node is the root.
    pub(super) nodes: Vec<Node>,
    pub(super) blocks: Vec<Block>,
    /// Factor on the margins within which an engine decides: 1, or 0 to plant a fault in tests.
    pub(crate) margin: f64,
    /// Visibility of the materials for the class.
    facings: Vec<Facing>,
    /// Horizontal bounds of the scanners that can use the cut.
    bounds: [DVec2; 2],
    /// Rounding error of the coordinates of boxes, and the maximum distance of a surface from a scanner, metres.
    pub(super) rounding: f64,
    pub(super) span: f64,
}

/// The part of an object's placement in plans that does not depend on the sensor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CutObject {
    pub rotation: DMat3,
    pub translation: DVec3,
    pub mesh_from_object: DAffine3,
    pub normal_from_mesh: DMat3,
}

/// The next f32 at or above a number.
fn up(x: f64) -> f32 {
    (x as f32).next_up()
}

impl RowCut {
    /// Upper bound of the time to make a cut, by the number of the world's polygons: about ten times the measured times
    /// of real scenes.
    pub fn max_time(world: &World) -> Duration {
        POLYGON * world.environment().slot_count()
    }

    /// Cuts all polygons that are opaque to the class.
    pub fn new(world: &World, class: &str, height: f64) -> Self {
        let environment = world.environment();
        let facings: Vec<_> = facings(environment, class).collect();
        let bounds = environment.bounds();
        let mut cut = Self { facings: facings.clone(), margin: 1.0, ..Self::default() };
        if bounds.is_empty() {
            return cut;
        }
        let diagonal = (bounds.max - bounds.min).length();
        let apart = MAX_APART * diagonal;
        cut.bounds = [bounds.min.truncate() - apart, bounds.max.truncate() + apart];
        let greatest = bounds.min.abs().max(bounds.max.abs()).max_element().max(height.abs()) + apart;
        (cut.rounding, cut.span) = (TRANSFORMS * greatest, 3.0 * diagonal);
        // Maximum change of height that a tilted scanner sees.
        let tilted = MAX_TILT * cut.span;
        let margins: Vec<f64> = environment.objects().iter().map(|o| position_error(o, greatest)).collect();
        let most = margins.iter().copied().fold(0.0, f64::max) + tilted;
        if !(bounds.min.z - most <= height && height <= bounds.max.z + most) {
            return cut;
        }
        let slice = Aabb { min: bounds.min.with_z(height - most), max: bounds.max.with_z(height + most) };
        let (mut found, mut runs) = (QueryResult::default(), Vec::new());
        world.index().select(environment, &Region::cuboid(&slice), &mut found, &mut runs);
        let (mut segments, mut copies) = (Vec::new(), Copies::default());
        for objects in runs.chunk_by(|a, b| a.object == b.object) {
            let number = objects[0].object;
            let object = &environment.objects()[number as usize];
            let Some(absent) = environment.absent_parts(number, class) else { continue };
            let is_absent = |polygon| environment.lies_in(number, polygon, &absent);
            let mut cutter = Cutter::new(object, number, height, margins[number as usize], tilted);
            let place = cut.objects.len() as u32;
            cut.objects.push(CutObject {
                rotation: object.world_from_object.rotation_matrix(),
                translation: object.world_from_object.translation,
                mesh_from_object: object.object_from_mesh.inverse(),
                normal_from_mesh: object.object_from_mesh.matrix3.inverse().transpose(),
            });
            let mut polygons: Vec<u32> = objects.iter().flat_map(|run| run.first..run.first + run.count).collect();
            polygons.sort_unstable();
            for polygon in polygons.into_iter().filter(|p| !is_absent(*p)) {
                let facing = facings[usize::from(object.mesh.material(polygon))];
                let segment = if facing.opaque { cutter.cross(polygon) } else { None };
                let Some(segment) = segment else { continue };
                let first_corner = cut.corners.len() as u32;
                let corners = object.mesh.corner_indices(polygon);
                let corner_count = corners.len() as u32;
                let segment = Segment { place, first_corner, corner_count, one_sided: facing.one_sided, ..segment };
                if !copies.take(object, &segment, &segments) {
                    cut.corners.extend(corners.iter().map(|c| object.mesh.vertices()[*c as usize]));
                    segments.push(segment);
                }
            }
        }
        (cut.nodes, cut.blocks, cut.segments) = tree::grow(segments);
        copies.add_to(&mut cut.segments);
        cut
    }

    /// This cut without margins for rounding, a fault that tests have to find.
    #[must_use]
    pub fn without_margins(self) -> Self {
        Self { margin: 0.0, ..self }
    }

    /// The segment and its copies.
    pub(crate) fn with_copies(&self, segment: u32) -> impl Iterator<Item = &Segment> {
        let next = |at: &u32| Some(self.segments[*at as usize].copy).filter(|copy| *copy != NO_COPY);
        std::iter::successors(Some(segment), next).map(|at| &self.segments[at as usize])
    }

    /// The corners of a segment's polygon in the mesh frame; empty for copies.
    pub(crate) fn corners(&self, segment: &Segment) -> &[Vec3] {
        self.corners
            .get(segment.first_corner as usize..)
            .and_then(|c| c.get(..segment.corner_count as usize))
            .unwrap_or(&[])
    }

    /// True if other faces have the same corners.
    pub(crate) fn has_copies(&self, segment: u32) -> bool {
        self.segments[segment as usize].copy != NO_COPY
    }

    /// Visibility of the materials for the class, by material index.
    pub(crate) fn facings(&self) -> &[Facing] {
        &self.facings
    }

    /// True if a scanner at this position is near enough for the cut's margins.
    pub fn serves(&self, place: DVec2) -> bool {
        self.segments.is_empty() || (place.cmpge(self.bounds[0]).all() && place.cmple(self.bounds[1]).all())
    }
}

/// Maximum error of the positions of an object's corners, in the world and relative to any scanner in it, metres.
fn position_error(object: &Object, greatest: f64) -> f64 {
    let matrix = object.object_from_mesh.matrix3;
    let norm = |m: DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
    let bounds = object.mesh.bounds();
    let own = bounds.min.abs().max(bounds.max.abs()).max_element() * norm(matrix);
    let far = greatest + object.world_from_object.translation.abs().max_element();
    let far = far + object.object_from_mesh.translation.abs().max_element() + own;
    if bounds.is_empty() { 0.0 } else { TRANSFORMS * norm(matrix) * norm(matrix.inverse()) * far }
}

/// Faces with the corners of an earlier face of their object. Their planes have the same bits up to the sign, so that
/// the first face wins wherever rounding does not decide.
#[derive(Default)]
struct Copies {
    /// First face, by object and a hash that does not depend on the order of the corners.
    first: HashMap<(u32, u64), u32>,
    /// Copies, with object and polygon of the first face.
    all: Vec<((u32, u32), Segment)>,
}

impl Copies {
    /// Takes a segment if it is a copy of an earlier one. Returns true in that case.
    fn take(&mut self, object: &Object, segment: &Segment, before: &[Segment]) -> bool {
        if segment.touches || segment.one_sided {
            return false;
        }
        let corners =
            |polygon: u32| object.mesh.corner_indices(polygon).iter().map(|c| object.mesh.vertices()[*c as usize]);
        let mixed = |p: Vec3| {
            p.to_array()
                .iter()
                .fold(0u64, |sum, x| (sum ^ u64::from(x.to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29))
        };
        let key = corners(segment.polygon).fold(0u64, |sum, p| sum.wrapping_add(mixed(p)));
        let first = *self.first.entry((segment.object, key)).or_insert(before.len() as u32);
        let Some(of) = before.get(first as usize) else { return false };
        let same = corners(of.polygon).len() == corners(segment.polygon).len()
            && corners(segment.polygon).all(|p| corners(of.polygon).any(|q| p == q));
        // The lower slot wins, and polygons are cut in ascending order.
        if same && !of.one_sided && of.polygon < segment.polygon {
            self.all.push(((of.object, of.polygon), *segment));
        }
        same && !of.one_sided && of.polygon < segment.polygon
    }

    /// Appends the copies, each after the last copy of its face.
    fn add_to(self, segments: &mut Vec<Segment>) {
        if self.all.is_empty() {
            return;
        }
        let mut last: HashMap<(u32, u32), usize> =
            segments.iter().enumerate().map(|(i, s)| ((s.object, s.polygon), i)).collect();
        for (of, copy) in self.all {
            let Some(before) = last.insert(of, segments.len()) else { continue };
            segments[before].copy = segments.len() as u32;
            segments.push(copy);
        }
    }
}

/// Cuts the polygons of one object.
struct Cutter<'a> {
    object: &'a Object,
    number: u32,
    height: f64,
    position: f64,
    /// Corners nearer to the height than this touch it, metres.
    touch: f64,
    world_from_mesh: DAffine3,
    normal_from_mesh: DMat3,
    /// Corners of a polygon in the world, above the height.
    corners: Vec<DVec3>,
    /// Points where it crosses the height.
    points: Vec<(DVec2, f64)>,
}

impl<'a> Cutter<'a> {
    fn new(object: &'a Object, number: u32, height: f64, position: f64, tilted: f64) -> Self {
        let world_from_mesh = object.world_from_mesh();
        let normal_from_mesh = world_from_mesh.matrix3.inverse().transpose();
        let (corners, points) = (Vec::new(), Vec::new());
        let touch = position + tilted;
        Self { object, number, height, position, touch, world_from_mesh, normal_from_mesh, corners, points }
    }

    /// The segment of a polygon; `None` if it is certainly above or below the height.
    fn cross(&mut self, polygon: u32) -> Option<Segment> {
        self.corners.clear();
        let (mut least, mut greatest, mut clearance) = (f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY);
        for p in self.object.mesh.corners_of(polygon) {
            let p = self.world_from_mesh.transform_point3(p) - DVec3::Z * self.height;
            (least, greatest, clearance) = (least.min(p.z), greatest.max(p.z), clearance.min(p.z.abs()));
            self.corners.push(p);
        }
        if least > self.touch || greatest < -self.touch {
            return None;
        }
        let normal = (self.normal_from_mesh * self.object.mesh.plane(polygon).normal).normalize();
        let off = |p: &DVec3| normal.dot(*p);
        let offset = off(&self.corners[0]);
        let spread = self.corners.iter().map(|p| (off(p) - offset).abs()).fold(0.0, f64::max);
        let spread = if self.corners.len() > 3 { spread } else { 0.0 };
        self.meet();
        let flat = normal.truncate().length();
        let touches = clearance <= self.touch || self.points.len() != 2 || flat < 1e-9;
        let ([(a, slope), (b, other)], pad) = if touches {
            let ([a, b], pad) = self.around();
            ([(a, 0.0), (b, 0.0)], pad)
        } else {
            let ends = [self.points[0], self.points[1]];
            (ends, 8.0 * self.touch * (1.0 + ends[0].1.max(ends[1].1)) + spread / flat)
        };
        let sides = self.corners.iter().zip(self.corners.iter().cycle().skip(1));
        let shortest = sides.map(|(p, q)| p.distance(*q)).fold(f64::INFINITY, f64::min);
        let extent = self.corners.iter().map(|p| p.distance(a.extend(0.0))).fold(0.0, f64::max);
        Some(Segment {
            a,
            b,
            normal: normal.truncate(),
            offset,
            object: self.number,
            polygon,
            position: up(self.position),
            slopes: [slope, other].map(up),
            extent: up(extent),
            spread: if spread > 0.0 { up(spread) } else { 0.0 },
            clearance: (clearance as f32).next_down(),
            shortest: (shortest as f32).next_down(),
            pad: up(pad),
            touches,
            place: 0,
            first_corner: 0,
            corner_count: 0,
            mesh_normal: self.object.mesh.plane(polygon).normal,
            one_sided: false,
            copy: NO_COPY,
        })
    }

    /// Finds where edges cross the height, with their slopes.
    fn meet(&mut self) {
        self.points.clear();
        for (k, p) in self.corners.iter().enumerate() {
            let q = self.corners[(k + 1) % self.corners.len()];
            if (p.z < 0.0) != (q.z < 0.0) {
                let along = q - *p;
                let slope = along.truncate().length() / along.z.abs();
                self.points.push(((*p - along * (p.z / along.z)).truncate(), slope));
            }
        }
    }

    /// For a polygon that touches the height: the two most distant points at which it may cross the height, and the
    /// maximum distance of other points from the segment between them.
    fn around(&self) -> ([DVec2; 2], f64) {
        let (mut points, mut slack) = (Vec::new(), self.touch);
        for (k, p) in self.corners.iter().enumerate() {
            let q = self.corners[(k + 1) % self.corners.len()];
            let near = [p, &q].map(|p| p.z.abs() <= 2.0 * self.touch);
            if near[0] {
                points.push(p.truncate());
            }
            if near[0] != near[1] {
                let length = (q - *p).truncate().length();
                slack = f64::max(slack, self.touch + length.min(4.0 * self.touch * length / (q.z - p.z).abs()));
            } else if !near[0] && (p.z < 0.0) != (q.z < 0.0) {
                let slope = (q - *p).truncate().length() / (q.z - p.z).abs();
                points.push((*p - (q - *p) * (p.z / (q.z - p.z))).truncate());
                slack = slack.max(2.0 * self.touch * (1.0 + slope));
            }
        }
        let pairs = points.iter().flat_map(|p| points.iter().map(move |q| [*p, *q]));
        let far = |[p, q]: &[DVec2; 2]| p.distance_squared(*q);
        let ends = pairs.max_by(|a, b| far(a).total_cmp(&far(b))).unwrap_or([self.corners[0].truncate(); 2]);
        let beside = points.iter().map(|p| distance(*p, ends)).fold(0.0, f64::max);
        (ends, slack + beside)
    }
}
