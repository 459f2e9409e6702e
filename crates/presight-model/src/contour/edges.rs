//! The edges of an object's polygons; finds the edges that its surface crosses smoothly.

use crate::environment::{Environment, Object};
use crate::error::{Error, Result};
use crate::geometry::{Aabb, PLANARITY, plane_of_polygon};
use crate::index::{Params, QueryResult, Region, Skd, SpatialIndex};
use crate::limits;
use glam::DVec3;
use std::collections::HashMap;

/// Polygons whose directions at an edge differ by less than this lie on each other, radians.
const SAME_WING: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// Maximum number of polygons around a smooth edge; the cost grows with its square.
const MAX_AROUND: usize = 16;

/// Tolerance of crease angles, radians, so that every edge is a crease, smooth, or both.
const SLACK: f64 = 1e-6;

/// An edge and the polygons around it, without repeats.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MeshEdge {
    /// The indices of its corners, the lower one first.
    pub ends: [u32; 2],
    around: (u32, u32),
}

/// The edges of all polygons of one object that a sensor class sees. Polygons whose sides touch share the common part.
#[derive(Debug)]
pub struct MeshEdges {
    /// Corners, in the object's frame; equal corners share one index.
    pub(crate) positions: Vec<DVec3>,
    pub(crate) edges: Vec<MeshEdge>,
    around: Vec<u32>,
    /// Unit normals by polygon; `None` if the polygon has no area or the class does not see it.
    pub(crate) normals: Vec<Option<DVec3>>,
    /// A point inside each polygon.
    pub(crate) centers: Vec<DVec3>,
    /// By polygon: where its edges begin in `edges_of`.
    starts: Vec<u32>,
    edges_of: Vec<u32>,
}

/// A side of a polygon: the indices of its corners, the lower one first, and the polygon.
type Side = ([u32; 2], u32);

/// The two polygons over which a surface crosses an edge.
pub(crate) struct Fold {
    /// One polygon on each side.
    pub sides: [u32; 2],
    /// True if the normals of the two polygons point to opposite sides of the surface.
    pub flips: bool,
}

impl MeshEdges {
    /// The edges of the polygons of an object that a sensor class sees.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if splitting sides at corners exceeds [`limits::MAX_CONTOUR_STEPS`].
    pub fn new(environment: &Environment, object: &Object, class: &str) -> Result<Self> {
        let mesh = &object.mesh;
        let seen = super::seen_materials(environment, class);
        let is_seen = |polygon: u32| seen[usize::from(mesh.material(polygon))];
        let mut known: HashMap<[u32; 3], u32> = HashMap::with_capacity(mesh.vertices().len());
        let mut positions = Vec::with_capacity(mesh.vertices().len());
        // Adding 0 turns -0 into 0.
        let key = |v: glam::Vec3| (v + glam::Vec3::ZERO).to_array().map(f32::to_bits);
        let mut number = |v: &glam::Vec3| {
            *known.entry(key(*v)).or_insert_with(|| {
                positions.push(object.object_from_mesh.transform_point3(v.as_dvec3()));
                positions.len() as u32 - 1
            })
        };
        let numbers: Vec<u32> = mesh.vertices().iter().map(&mut number).collect();
        let count = mesh.polygon_count();
        let (mut normals, mut centers) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let mut sides: Vec<Side> = Vec::with_capacity(3 * count);
        let mut corners = Vec::new();
        for polygon in 0..count as u32 {
            let own = mesh.corner_indices(polygon);
            corners.clear();
            corners.extend(own.iter().map(|c| positions[numbers[*c as usize] as usize]));
            let normal = plane_of_polygon(&corners).map(|p| p.normal).filter(|_| is_seen(polygon));
            normals.push(normal);
            centers.push(corners.iter().sum::<DVec3>() / corners.len() as f64);
            if normal.is_some() {
                let side = |k: usize| [own[k], own[(k + 1) % own.len()]].map(|c| numbers[c as usize]);
                let ends = (0..own.len()).map(side).filter(|[a, b]| a != b);
                sides.extend(ends.map(|[a, b]| ([a.min(b), a.max(b)], polygon)));
            }
        }
        sides.sort_unstable();
        let sides = split(sides, &positions)?;
        Ok(Self::grouped(sides, positions, normals, centers))
    }

    fn grouped(sides: Vec<Side>, positions: Vec<DVec3>, normals: Vec<Option<DVec3>>, centers: Vec<DVec3>) -> Self {
        let (mut edges, mut around) = (Vec::new(), Vec::with_capacity(sides.len()));
        let mut starts = vec![0u32; normals.len() + 1];
        for group in sides.chunk_by(|a, b| a.0 == b.0) {
            let first = around.len() as u32;
            around.extend(group.iter().map(|(_, polygon)| *polygon));
            edges.push(MeshEdge { ends: group[0].0, around: (first, around.len() as u32) });
            group.iter().for_each(|(_, polygon)| starts[*polygon as usize + 1] += 1);
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let (mut next, mut edges_of) = (starts.clone(), vec![0; sides.len()]);
        for (number, edge) in edges.iter().enumerate() {
            for polygon in &around[edge.around.0 as usize..edge.around.1 as usize] {
                let at = &mut next[*polygon as usize];
                edges_of[*at as usize] = number as u32;
                *at += 1;
            }
        }
        Self { positions, edges, around, normals, centers, starts, edges_of }
    }

    /// Number of polygons of the object.
    pub fn polygon_count(&self) -> usize {
        self.normals.len()
    }

    pub(crate) fn around(&self, edge: u32) -> &[u32] {
        let (first, end) = self.edges[edge as usize].around;
        &self.around[first as usize..end as usize]
    }

    pub(crate) fn edges_of(&self, polygon: u32) -> &[u32] {
        let range = polygon as usize..polygon as usize + 2;
        let [first, end] = [self.starts[range.start], self.starts[range.end - 1]];
        &self.edges_of[first as usize..end as usize]
    }

    /// The unit direction of an edge, and the perpendicular direction in which a polygon extends from it.
    pub(crate) fn wing(&self, edge: u32, polygon: u32) -> Option<(DVec3, DVec3)> {
        let [a, b] = self.edges[edge as usize].ends.map(|end| self.positions[end as usize]);
        let along = (b - a).try_normalize()?;
        let across = self.normals[polygon as usize]?.cross(along).try_normalize()?;
        let inward = (self.centers[polygon as usize] - a).dot(across);
        Some((along, if inward < 0.0 { -across } else { across }))
    }

    /// The two polygons of an edge that the surface crosses smoothly; `None` at creases, borders and branchings.
    /// Polygons that lie on each other count once.
    pub(crate) fn fold(&self, edge: u32, crease: f64) -> Option<Fold> {
        let around = self.around(edge);
        if around.len() > MAX_AROUND {
            return None;
        }
        let first = around[0];
        let (along, x) = self.wing(edge, first)?;
        let y = along.cross(x);
        let mut other: Option<(f64, u32)> = None;
        for polygon in &around[1..] {
            let (_, wing) = self.wing(edge, *polygon)?;
            let angle = wing.dot(y).atan2(wing.dot(x));
            match other {
                _ if angle.abs() <= SAME_WING => {}
                Some((known, _)) if (angle - known).abs() <= SAME_WING => {}
                // The difference wraps at half a turn.
                Some((known, _)) if (angle - known).abs() >= std::f64::consts::TAU - SAME_WING => {}
                Some(_) => return None,
                None => other = Some((angle, *polygon)),
            }
        }
        let (angle, second) = other.filter(|(angle, _)| std::f64::consts::PI - angle.abs() <= crease + SLACK)?;
        let turns = |polygon: u32, wing: DVec3| Some(self.normals[polygon as usize]?.cross(along).dot(wing) > 0.0);
        let wing = x * angle.cos() + y * angle.sin();
        Some(Fold { sides: [first, second], flips: turns(first, x)? == turns(second, wing)? })
    }
}

/// Splits sides of single polygons at the corners that lie on them.
fn split(sides: Vec<Side>, positions: &[DVec3]) -> Result<Vec<Side>> {
    let mut lone = Vec::new();
    let mut rest = Vec::with_capacity(sides.len());
    for group in sides.chunk_by(|a, b| a.0 == b.0) {
        if group.len() == 1 { lone.push(group[0]) } else { rest.extend_from_slice(group) }
    }
    let mut corners: Vec<u32> = lone.iter().flat_map(|(ends, _)| *ends).collect();
    corners.sort_unstable();
    corners.dedup();
    let boxes: Vec<(u32, Aabb)> = corners.iter().map(|c| (*c, Aabb::of([positions[*c as usize]]))).collect();
    let index: Skd<3> = Skd::build(Params::default(), &boxes);
    let mut found = QueryResult::default();
    let (mut on, mut steps) = (Vec::new(), 0u64);
    for (ends, polygon) in lone {
        let [a, b] = ends.map(|end| positions[end as usize]);
        let (d, bounds) = (b - a, Aabb::of([a, b]));
        let off = PLANARITY * bounds.min.abs().max(bounds.max.abs()).max_element();
        found.clear();
        index.query(&Region::cuboid(&Aabb { min: bounds.min - off, max: bounds.max + off }), &mut found);
        steps += 1 + found.count() as u64;
        if steps > limits::MAX_CONTOUR_STEPS {
            let what = "too many corners lie near sides of other polygons to find the smooth surfaces";
            return Err(Error::invalid(what, "weld the model's corners"));
        }
        on.clear();
        for corner in found.all() {
            let w = positions[corner as usize] - a;
            let t = w.dot(d) / d.length_squared();
            if !ends.contains(&corner) && t > 0.0 && t < 1.0 && (w - d * t).length() <= off {
                on.push((t, corner));
            }
        }
        on.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        let mut from = ends[0];
        for to in on.iter().map(|(_, corner)| *corner).chain([ends[1]]) {
            rest.push(([from.min(to), from.max(to)], polygon));
            from = to;
        }
    }
    rest.sort_unstable();
    rest.dedup();
    Ok(rest)
}
