//! Finds places inside solids, where no sensor can be.
//!
//! A *solid* is a connected part of an object that is closed, wound outward, and too thin to be a room that holds a
//! sensor (3 V / A below [`ROOM`]). A part is closed if its vector area is 0, which T-junctions do not disturb.

use super::effort::steps;
use super::soup::Soup;
use glam::DVec3;
use presight_model::error::Result;
use presight_model::geometry::Aabb;
use presight_model::index::{Params, QueryResult, Region, Skd, SpatialIndex};
use presight_model::union_find::UnionFind;

/// Maximum mean thickness of a solid, metres: three times the volume divided by the area. A cube of 2 m or a wide slab
/// of 0.67 m has this value. A thicker part may be a room.
const ROOM: f64 = 1.0;

/// Marks faces that bound no solid.
const NONE: u32 = u32::MAX;

/// The solid that each face bounds.
#[derive(Debug)]
pub(super) struct Solids {
    of_face: Vec<u32>,
    /// Bounding boxes of the solids.
    boxes: Vec<Aabb>,
    /// Index over the boxes.
    index: Skd<3>,
}

#[derive(Clone, Copy)]
struct Sum {
    origin: DVec3,
    vector: DVec3,
    area: f64,
    volume: f64,
    bounds: Aabb,
}

impl Solids {
    pub fn new(soup: &Soup) -> Self {
        let mut parts = UnionFind::new(soup.vertex_count as usize);
        for face in 0..soup.faces.len() as u32 {
            for pair in soup.vertices(face).windows(2) {
                parts.join(pair[0], pair[1]);
            }
        }
        let mut sums: Vec<Option<Sum>> = vec![None; soup.vertex_count as usize];
        for face in 0..soup.faces.len() as u32 {
            let part = parts.root(soup.vertices(face)[0]);
            let corners = soup.corners(face);
            let start = Sum { origin: corners[0], vector: DVec3::ZERO, area: 0.0, volume: 0.0, bounds: Aabb::EMPTY };
            let sum = sums[part as usize].get_or_insert(start);
            let a = corners[0] - sum.origin;
            for pair in corners[1..].windows(2) {
                let (b, c) = (pair[0] - sum.origin, pair[1] - sum.origin);
                let half = 0.5 * (b - a).cross(c - a);
                (sum.vector, sum.area) = (sum.vector + half, sum.area + half.length());
                sum.volume += a.dot(half) / 3.0;
            }
            sum.bounds = sum.bounds.union(soup.faces[face as usize].bounds);
        }
        let index = Skd::build(Params::default(), &[]);
        let mut solids = Self { of_face: Vec::new(), boxes: Vec::new(), index };
        let mut number = vec![NONE; soup.vertex_count as usize];
        for face in 0..soup.faces.len() as u32 {
            let part = parts.root(soup.vertices(face)[0]) as usize;
            if let Some(sum) = sums[part].take().filter(is_solid) {
                number[part] = solids.boxes.len() as u32;
                solids.boxes.push(sum.bounds);
            }
            solids.of_face.push(number[part]);
        }
        let boxes: Vec<(u32, Aabb)> = (0..).zip(solids.boxes.iter().copied()).collect();
        solids.index = Skd::build(Params::default(), &boxes);
        solids
    }

    /// Returns true if the point (world) lies in a solid. Counts the faces above and below it.
    ///
    /// # Errors
    /// The errors of `spend`, which counts the steps.
    pub fn hold(
        &self,
        soup: &Soup,
        p: DVec3,
        found: &mut QueryResult,
        mut spend: impl FnMut(usize) -> Result<()>,
    ) -> Result<bool> {
        // A point rarely lies in a box. If it does, the search column is limited to the boxes.
        found.clear();
        self.index.query(&Region::cuboid(&Aabb::of([p])), found);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for b in found.all().map(|solid| &self.boxes[solid as usize]).filter(|b| b.distance_squared(p) == 0.0) {
            (low, high) = (low.min(b.min.z), high.max(b.max.z));
        }
        if low > high {
            return Ok(false);
        }
        let column = Aabb { min: p.truncate().extend(low), max: p.truncate().extend(high) };
        // One entry for each face: solid, exits above, exits below.
        let mut exits: Vec<(u32, i32, i32)> = Vec::new();
        let faces = soup.near(&column, found);
        spend(steps::FOUND * faces.len())?;
        for &face in faces {
            let solid = self.of_face[face as usize];
            if solid == NONE || self.boxes[solid as usize].distance_squared(p) > 0.0 {
                continue;
            }
            let turns = turns_around(soup.corners(face), p);
            if turns == 0 {
                continue;
            }
            let plane = soup.faces[face as usize].plane;
            let above = (plane.offset - plane.normal.dot(p)) / plane.normal.z > 0.0;
            exits.push(if above { (solid, turns, 0) } else { (solid, 0, -turns) });
        }
        exits.sort_unstable();
        let both = |of_one: &[(u32, i32, i32)]| {
            let (above, below) = of_one.iter().fold((0, 0), |(a, b), exit| (a + exit.1, b + exit.2));
            above > 0 && below > 0
        };
        Ok(exits.chunk_by(|a, b| a.0 == b.0).any(both))
    }
}

fn is_solid(sum: &Sum) -> bool {
    sum.vector.length() <= 1e-5 * sum.area && sum.volume > 0.0 && 3.0 * sum.volume < ROOM * sum.area
}

/// Winding number of a loop around a point, seen from above. Crossings are half-open, so a vertical line through a
/// shared edge crosses exactly one of its faces.
fn turns_around(corners: &[DVec3], p: DVec3) -> i32 {
    let mut turns = 0;
    for k in 0..corners.len() {
        let (a, b) = (corners[k], corners[(k + 1) % corners.len()]);
        // The lower end comes first, so both directions of an edge give the same rounding.
        let left = |a: DVec3, b: DVec3| (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x) > 0.0;
        if a.y <= p.y && b.y > p.y && left(a, b) {
            turns += 1;
        } else if b.y <= p.y && a.y > p.y && left(b, a) {
            turns -= 1;
        }
    }
    turns
}
