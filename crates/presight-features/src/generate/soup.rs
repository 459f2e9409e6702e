//! All polygons visible to a sensor class, in the world, with a spatial index.

use glam::DVec3;
use presight_model::environment::{Appearance, Environment, Object};
use presight_model::geometry::{Aabb, Plane, plane_of_loop};
use presight_model::index::{Params, QueryResult, Region, Skd, SpatialIndex};
use std::collections::{HashMap, HashSet};

/// A convex polygon in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Face {
    first: u32,
    count: u32,
    pub object: u32,
    pub material: u16,
    /// The normal points to the front.
    pub plane: Plane,
    pub bounds: Aabb,
}

/// Faces with their corners and an index over their boxes.
#[derive(Debug)]
pub(super) struct Soup {
    pub faces: Vec<Face>,
    corners: Vec<DVec3>,
    /// Parallel to `corners`: equal positions in one object have equal numbers, all others differ.
    vertices: Vec<u32>,
    /// Number of distinct vertices.
    pub vertex_count: u32,
    index: Skd<3>,
    /// Number of polygons invisible to the class.
    pub invisible: usize,
    /// Number of duplicates, with equal corners and winding in one object, that are omitted.
    pub equal: usize,
}

impl Soup {
    /// The polygons of `environment` that are visible to `class`, of all objects or of those near a region.
    pub fn new(environment: &Environment, class: &str, near: Option<&Aabb>) -> Self {
        let seen: Vec<bool> =
            environment.materials().iter().map(|m| m.appearance(class) != Appearance::Invisible).collect();
        let mut soup = Self {
            faces: Vec::new(),
            corners: Vec::new(),
            vertices: Vec::new(),
            vertex_count: 0,
            index: Skd::build(Params::default(), &[]),
            invisible: 0,
            equal: 0,
        };
        let region = near.map(Region::cuboid);
        for (index, object) in environment.objects().iter().enumerate() {
            if region.is_none_or(|r| r.meets(&object.world_bounds())) {
                soup.add(index as u32, object, &seen);
            }
        }
        let boxes: Vec<(u32, Aabb)> = (0..).zip(soup.faces.iter().map(|f| f.bounds)).collect();
        soup.index = Skd::build(Params::default(), &boxes);
        soup
    }

    fn add(&mut self, index: u32, object: &Object, seen: &[bool]) {
        let (mesh, world_from_mesh, mirrored) = (&object.mesh, object.world_from_mesh(), object.mirrors());
        let mut known: HashMap<[u32; 3], u32> = HashMap::with_capacity(mesh.vertices().len());
        // Adding 0 turns -0 into 0.
        let key = |v: glam::Vec3| (v + glam::Vec3::ZERO).to_array().map(f32::to_bits);
        let welded: Vec<u32> = mesh
            .vertices()
            .iter()
            .map(|v| {
                let next = self.vertex_count + known.len() as u32;
                *known.entry(key(*v)).or_insert(next)
            })
            .collect();
        let placed: Vec<DVec3> =
            mesh.vertices().iter().map(|v| world_from_mesh.transform_point3(v.as_dvec3())).collect();
        self.vertex_count += known.len() as u32;
        let mut equal: HashSet<(u16, Vec<u32>)> = HashSet::with_capacity(mesh.polygon_count());
        for polygon in 0..mesh.polygon_count() as u32 {
            let material = mesh.material(polygon);
            if !seen[usize::from(material)] {
                self.invisible += 1;
                continue;
            }
            let corners = mesh.corner_indices(polygon);
            let count = corners.len();
            // A mirror reverses the winding, but the front stays the same.
            let number = |k: usize| if mirrored { (count - k) % count } else { k };
            let at = |k: usize| placed[corners[number(k)] as usize];
            // A scale may flatten a sliver beyond f64; it is then invisible.
            let Some(plane) = plane_of_loop(count, at) else { continue };
            if !equal.insert((material, turned(corners.iter().map(|c| welded[*c as usize]).collect()))) {
                self.equal += 1;
                continue;
            }
            let first = self.corners.len() as u32;
            self.corners.extend((0..count).map(at));
            self.vertices.extend((0..count).map(|k| welded[corners[number(k)] as usize]));
            let bounds = Aabb::of(self.corners[first as usize..].iter().copied());
            self.faces.push(Face { first, count: count as u32, object: index, material, plane, bounds });
        }
    }

    /// Corners of a face, counter-clockwise as seen from its front.
    pub fn corners(&self, face: u32) -> &[DVec3] {
        let f = &self.faces[face as usize];
        &self.corners[f.first as usize..][..f.count as usize]
    }

    /// Numbers of the corners of a face.
    pub fn vertices(&self, face: u32) -> &[u32] {
        let f = &self.faces[face as usize];
        &self.vertices[f.first as usize..][..f.count as usize]
    }

    /// Faces whose box meets a box, sorted.
    pub fn near<'a>(&self, bounds: &Aabb, found: &'a mut QueryResult) -> &'a [u32] {
        self.near_any([*bounds], found)
    }

    /// Faces whose box meets any of some boxes, sorted, without duplicates.
    pub fn near_any<'a>(&self, boxes: impl IntoIterator<Item = Aabb>, found: &'a mut QueryResult) -> &'a [u32] {
        found.clear();
        for bounds in boxes {
            self.index.query(&Region::cuboid(&bounds), found);
        }
        let runs: Vec<u32> = found.runs.drain(..).flatten().collect();
        found.ids.extend(runs);
        found.ids.sort_unstable();
        found.ids.dedup();
        &found.ids
    }
}

/// Rotates a loop so that it starts with its smallest number.
fn turned(mut numbers: Vec<u32>) -> Vec<u32> {
    let lowest = (0..numbers.len()).min_by_key(|k| numbers[*k]).unwrap_or(0);
    numbers.rotate_left(lowest);
    numbers
}

/// The edges of a convex polygon: start, and unit normal in the polygon's plane that points inward.
pub(super) fn sides(corners: &[DVec3], normal: DVec3) -> impl Iterator<Item = (DVec3, DVec3)> + '_ {
    (0..corners.len()).filter_map(move |k| {
        let (a, b) = (corners[k], corners[if k + 1 == corners.len() { 0 } else { k + 1 }]);
        normal.cross(b - a).try_normalize().map(|inward| (a, inward))
    })
}

/// The part of `range` in which `at + rate * t >= 0`.
pub fn clip(range: (f64, f64), at: f64, rate: f64) -> (f64, f64) {
    if rate == 0.0 {
        return if at >= 0.0 { range } else { (1.0, 0.0) };
    }
    let t = -at / rate;
    if rate > 0.0 { (range.0.max(t), range.1) } else { (range.0, range.1.min(t)) }
}

pub(super) fn grown(b: &Aabb, margin: f64) -> Aabb {
    Aabb { min: b.min - margin, max: b.max + margin }
}
