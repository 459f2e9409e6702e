//! The view of a level one-row scanner in a [`RowCut`]: visits nodes nearest first, and skips hidden ones.

use super::cut::{Node, RowCut, Segment};
use glam::{DVec2, DVec3};
use presight_model::geometry::Pose;
use presight_model::sensor::{Geometry, Sensor};
use std::ops::Range;

/// Beams that share one farthest range.
const BLOCK: usize = 4;

/// Relative margin: a node or segment must be farther by this much to count as hidden.
const SLACK: f64 = 1e-9;

/// The beams of a one-row scanner, by ascending azimuth, with scratch memory.
#[derive(Clone, Debug)]
pub struct RowView {
    /// Unit vectors in the sensor's frame, none twice.
    rays: Vec<DVec2>,
    /// Number of pixels.
    width: usize,
    /// Value of [`turn_of`] for the first ray.
    first_turn: f64,
    /// For equal slices of 0..4 ([`turn_of`] minus `first_turn`): the first beam at or after the slice's start.
    slices: Vec<u32>,
    /// True if the last pixel belongs to the first ray.
    reversed: bool,
    range_min: f64,
    range_max: f64,
    /// Per ray: the largest inverse range so far, and its segment or [`NONE`].
    inverse: Vec<f64>,
    winner: Vec<u32>,
    /// The least inverse range of each block.
    farthest: Vec<f64>,
    stack: Vec<(u32, f64)>,
    /// Number of segments tested by the last [`RowView::see`].
    pub tested: usize,
}

const NONE: u32 = u32::MAX;

impl RowView {
    /// Returns `None` unless the sensor is a one-row scanner in its own horizontal plane.
    pub fn new(sensor: &Sensor) -> Option<Self> {
        let Geometry::Scanner(scanner) = &sensor.spec().geometry else { return None };
        if scanner.elevation.len() != 1 || scanner.elevation.degrees(0) != 0.0 {
            return None;
        }
        let (width, n) = (scanner.azimuth.len(), sensor.distinct_columns() as usize);
        let reversed = width > 1 && scanner.azimuth.degrees(1) < scanner.azimuth.degrees(0);
        let column = |i: usize| if reversed { width - 1 - i } else { i } as u32;
        let rays: Vec<DVec2> = (0..n).filter_map(|i| sensor.ray(column(i), 0)).map(|ray| ray.truncate()).collect();
        let first_turn = turn_of(rays[0]);
        let mut turns: Vec<f64> = rays.iter().map(|ray| since(turn_of(*ray), first_turn)).collect();
        turns[0] = 0.0;
        let count = (8 * n).next_power_of_two();
        let slices =
            (0..=count).map(|s| turns.partition_point(|t| *t < 4.0 * s as f64 / count as f64) as u32).collect();
        let (range_min, range_max) = (sensor.spec().range_min, sensor.spec().range_max);
        let blocks = n.div_ceil(BLOCK);
        Some(Self {
            rays,
            width,
            first_turn,
            slices,
            reversed,
            range_min,
            range_max,
            inverse: vec![0.0; n],
            winner: vec![NONE; n],
            farthest: vec![0.0; blocks],
            stack: Vec::new(),
            tested: 0,
        })
    }

    /// Fills the images of range and cos_incidence.
    pub fn see(&mut self, cut: &RowCut, world_from_sensor: &Pose, range: &mut Vec<f32>, cos_incidence: &mut Vec<f32>) {
        // Slightly beyond the limit, so that surfaces exactly at the limit are decided by their range.
        let horizon = (1.0 - SLACK) / self.range_max;
        self.inverse.fill(horizon);
        self.winner.fill(NONE);
        self.farthest.fill(horizon);
        self.tested = 0;
        let eye = ScannerView::new(world_from_sensor);
        let mut stack = std::mem::take(&mut self.stack);
        stack.clear();
        if let Some(root) = cut.nodes.first() {
            stack.push((0, eye.nearest(root)));
        }
        while let Some((at, nearest)) = stack.pop() {
            let node = &cut.nodes[at as usize];
            if self.hides(&eye, node, nearest) {
                continue;
            }
            if node.count > 0 {
                for s in node.at..node.at + node.count {
                    self.draw(&eye, cut, s);
                }
                continue;
            }
            let children = [at + 1, node.at].map(|child| (child, eye.nearest(&cut.nodes[child as usize])));
            // The nearer child is popped first.
            let [one, other] = children;
            stack.extend(if one.1 <= other.1 { [other, one] } else { [one, other] });
        }
        self.stack = stack;
        self.resolve(&eye, cut, range, cos_incidence);
    }

    fn resolve(&self, eye: &ScannerView, cut: &RowCut, range: &mut Vec<f32>, cos_incidence: &mut Vec<f32>) {
        let n = self.width;
        range.resize(n, 0.0);
        cos_incidence.resize(n, 0.0);
        for i in 0..n {
            let pixel = if self.reversed { n - 1 - i } else { i };
            let i = i % self.rays.len();
            let exact = 1.0 / self.inverse[i];
            let seen = self.winner[i] != NONE && exact <= self.range_max;
            range[pixel] = match seen {
                false => f32::INFINITY,
                true if exact < self.range_min => f32::NEG_INFINITY,
                true => exact as f32,
            };
            cos_incidence[pixel] = match seen {
                true => {
                    (eye.turned(cut.segments[self.winner[i] as usize].normal).dot(self.rays[i]).abs() as f32).min(1.0)
                }
                false => f32::NAN,
            };
        }
    }

    /// True if nothing in the node is visible.
    fn hides(&self, eye: &ScannerView, node: &Node, nearest: f64) -> bool {
        if nearest == 0.0 {
            return false;
        }
        let (from, to) = eye.silhouette(node);
        let inverse = (1.0 + SLACK) / nearest;
        let (first, count) = self.between(turn_of(from), turn_of(to));
        self.blocks(first, count).into_iter().flatten().all(|block| inverse < self.farthest[block])
    }

    /// The blocks of some beams, which may wrap around.
    fn blocks(&self, first: usize, count: usize) -> [Range<usize>; 2] {
        let (n, end) = (self.rays.len(), first + count);
        let up = if count == 0 { 0..0 } else { first / BLOCK..end.min(n).div_ceil(BLOCK) };
        [up, 0..end.saturating_sub(n).div_ceil(BLOCK)]
    }

    /// The first beam and number of beams counter-clockwise between two turns; may include one more at each end.
    fn between(&self, from: f64, to: f64) -> (usize, usize) {
        let margin = 1e-9;
        let from = since(from - margin, self.first_turn);
        let to = since(to + margin, self.first_turn);
        let slices = self.slices.len() - 1;
        // Exact: the number of slices is a power of two.
        let slice = |turn: f64| ((turn * (slices as f64 / 4.0)) as usize).min(slices - 1);
        let (first, end) = (self.slices[slice(from)] as usize, self.slices[slice(to) + 1] as usize);
        if from <= to { (first, end - first) } else { (first, self.rays.len() - first + end) }
    }

    fn draw(&mut self, eye: &ScannerView, cut: &RowCut, number: u32) {
        self.tested += 1;
        let segment = &cut.segments[number as usize];
        let (mut a, mut b) = (eye.seen(segment.a), eye.seen(segment.b));
        // Negative if the scanner is on the normal's side.
        let distance = eye.offset(cut, segment) - segment.normal.dot(eye.place);
        if segment.one_sided && distance >= 0.0 {
            return;
        }
        let doubled = a.perp_dot(b);
        if doubled < 0.0 {
            (a, b) = (b, a);
        }
        // Edge-on within rounding: it covers no ray.
        let (near, far) = (a.length().min(b.length()), a.length().max(b.length()));
        if !(doubled.abs() > 8.0 * f64::EPSILON * near * far && distance.abs() > 8.0 * f64::EPSILON * near) {
            return;
        }
        let m = eye.turned(segment.normal) / distance;
        let (first, count) = self.between(turn_of(a), turn_of(b));
        let n = self.rays.len();
        let mut drawn = false;
        // The beams may wrap around.
        for beams in [first..(first + count).min(n), 0..(first + count).saturating_sub(n)] {
            let so_far = self.inverse[beams.clone()].iter_mut().zip(&mut self.winner[beams.clone()]);
            for (ray, (nearest, winner)) in self.rays[beams].iter().zip(so_far) {
                let inverse = m.dot(*ray);
                if inverse > *nearest && a.perp_dot(*ray) >= 0.0 && ray.perp_dot(b) >= 0.0 {
                    (*nearest, *winner) = (inverse, number);
                    drawn = true;
                }
            }
        }
        if drawn {
            self.blocks(first, count).into_iter().flatten().for_each(|block| self.measure(block));
        }
    }

    fn measure(&mut self, block: usize) {
        let beams = &self.inverse[block * BLOCK..((block + 1) * BLOCK).min(self.inverse.len())];
        self.farthest[block] = beams.iter().copied().fold(f64::INFINITY, f64::min);
    }
}

/// Position and heading of the scanner.
struct ScannerView {
    place: DVec2,
    height: f64,
    /// The sensor's x axis in the world.
    ahead: DVec2,
}

impl ScannerView {
    fn new(world_from_sensor: &Pose) -> Self {
        let ahead = world_from_sensor.rotation_matrix().x_axis.truncate().normalize();
        let DVec3 { x, y, z } = world_from_sensor.translation;
        Self { place: DVec2::new(x, y), height: z, ahead }
    }

    fn turned(&self, direction: DVec2) -> DVec2 {
        DVec2::new(self.ahead.dot(direction), self.ahead.perp_dot(direction))
    }

    /// Transforms a point from the world into the sensor's frame.
    fn seen(&self, point: DVec2) -> DVec2 {
        self.turned(point - self.place)
    }

    /// Offset of the plane of a segment's polygon.
    fn offset(&self, cut: &RowCut, segment: &Segment) -> f64 {
        let corners = &cut.corners[segment.corners.0 as usize..segment.corners.1 as usize];
        let apart = |p: &DVec3| p.distance_squared(self.place.extend(self.height));
        let nearest = corners.iter().min_by(|(a, _), (b, _)| apart(a).total_cmp(&apart(b)));
        nearest.map_or(segment.offset, |(_, offset)| *offset)
    }

    /// Distance to a box.
    fn nearest(&self, node: &Node) -> f64 {
        (node.min - self.place).max(self.place - node.max).max(DVec2::ZERO).length()
    }

    /// The silhouette corners of a box seen from outside, right corner first, in the sensor's frame.
    fn silhouette(&self, node: &Node) -> (DVec2, DVec2) {
        let (low, high, p) = (node.min, node.max, self.place);
        let side = |x: f64, low: f64, high: f64| i32::from(x > high) - i32::from(x < low);
        let (right, left) = match (side(p.x, low.x, high.x), side(p.y, low.y, high.y)) {
            (-1, -1) => (DVec2::new(high.x, low.y), DVec2::new(low.x, high.y)),
            (-1, 0) => (low, DVec2::new(low.x, high.y)),
            (-1, _) => (low, high),
            (0, -1) => (DVec2::new(high.x, low.y), low),
            (0, _) => (DVec2::new(low.x, high.y), high),
            (_, -1) => (high, low),
            (_, 0) => (high, DVec2::new(high.x, low.y)),
            _ => (DVec2::new(low.x, high.y), DVec2::new(high.x, low.y)),
        };
        (self.seen(right), self.seen(left))
    }
}

/// A number in 0..4 that increases counter-clockwise with the direction; cheaper than an angle.
fn turn_of(v: DVec2) -> f64 {
    let p = v.y / (v.x.abs() + v.y.abs());
    if v.x < 0.0 {
        2.0 - p
    } else if v.y < 0.0 {
        4.0 + p
    } else {
        p
    }
}

/// Counter-clockwise difference of two turns, 0..4.
fn since(turn: f64, first: f64) -> f64 {
    let t = turn - first;
    let t = if t < 0.0 { t + 4.0 } else { t };
    if t >= 4.0 { t - 4.0 } else { t }
}
