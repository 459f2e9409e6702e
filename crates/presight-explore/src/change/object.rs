//! Objects of connected planes: floors, walls, ceilings and others, by direction and height.

use crate::geometry::Flat;
use crate::surface::{Piece, Surfaces, mesh};
use glam::DVec3;
use presight_model::environment::{Environment, Mesh, NewObject};
use presight_model::error::Result;
use presight_model::geometry::{Aabb, InObject, Pose, PoseCovariance};
use presight_model::matrix::{Matrix, inverse};
use presight_model::union_find::UnionFind;
use std::collections::BTreeMap;

/// Minimum cosine between the vertical and the normal of a floor or ceiling: 10 degrees.
const LEVEL: f64 = 0.985;
/// Maximum cosine between the vertical and the normal of a wall: 80 degrees.
const UPRIGHT: f64 = 0.17;
/// Minimum area of a plane in a floor, wall or ceiling, square metres.
const MIN_AREA: f64 = 0.5;
/// Maximum unevenness of floors and ceilings, metres.
const STEP: f64 = 0.1;
/// Minimum height of the top of a wall above the floor, metres.
const WALL: f64 = 1.2;
/// Minimum cosine between the normals of adjacent walls of one object: 15 degrees.
const PARALLEL: f64 = 0.966;
/// First components of paths, in the order of [`Kind`].
const GROUPS: [&str; 4] = ["floor", "wall", "ceiling", "explored"];

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Floor,
    Wall,
    Ceiling,
    Other,
}

/// An object of connected surfaces.
#[derive(Clone, Debug)]
pub struct ExploredObject {
    /// Its path, such as `explored/0007`.
    pub path: String,
    /// Its pose in the world, with the axes of the world and the origin in its middle.
    pub world_from_object: Pose,
    /// Its convex polygons.
    pub mesh: Mesh,
    /// Covariance of its pose, as far as the rays determine it.
    pub covariance: PoseCovariance<InObject>,
    /// Probability that it exists.
    pub existence: f64,
    /// Unobserved boxes at its border, in its frame, metres.
    pub unseen: Vec<Aabb>,
}

impl ExploredObject {
    /// The object for [`Environment::insert`].
    pub fn new_object(&self) -> NewObject {
        NewObject::new(&self.path, self.world_from_object, self.mesh.clone().into())
    }
}

struct Facts {
    area: f64,
    bounds: Aabb,
}

impl Surfaces {
    /// The objects, the largest of each kind first. Their numbers continue those in `taken`.
    ///
    /// # Errors
    /// Those of [`Mesh::new`].
    pub fn objects(&self, taken: &Environment) -> Result<Vec<ExploredObject>> {
        let facts = self.facts();
        let kinds = kinds(&self.planes, &facts);
        let mut groups: BTreeMap<(Kind, u32), Vec<u32>> = BTreeMap::new();
        let group = self.groups(&kinds);
        for (plane, fact) in facts.iter().enumerate() {
            if fact.area > 0.0 {
                groups.entry((kinds[plane], group[plane])).or_default().push(plane as u32);
            }
        }
        let area = |planes: &[u32]| planes.iter().map(|p| facts[*p as usize].area).sum::<f64>();
        let mut sorted: Vec<(Kind, Vec<u32>)> = groups.into_iter().map(|((kind, _), planes)| (kind, planes)).collect();
        sorted.sort_by(|a, b| a.0.cmp(&b.0).then(area(&b.1).total_cmp(&area(&a.1))));
        let mut next = GROUPS.map(|name| first_free(taken, name));
        let mut objects = Vec::new();
        for (kind, planes) in sorted {
            let number = &mut next[kind as usize];
            let path = format!("{}/{number:04}", GROUPS[kind as usize]);
            *number += 1;
            objects.push(self.object(path, &planes)?);
        }
        Ok(objects)
    }

    fn facts(&self) -> Vec<Facts> {
        let mut facts: Vec<Facts> = self.planes.iter().map(|_| Facts { area: 0.0, bounds: Aabb::EMPTY }).collect();
        for piece in &self.pieces {
            let fact = &mut facts[piece.plane as usize];
            fact.area += piece.area();
            fact.bounds = fact.bounds.union(Aabb::of(piece.corners.iter().copied()));
        }
        facts
    }

    /// By plane: the lowest index of the planes in its group.
    fn groups(&self, kinds: &[Kind]) -> Vec<u32> {
        let mut parts = UnionFind::new(self.planes.len());
        for [a, b] in &self.adjacent {
            let (i, j) = (*a as usize, *b as usize);
            let parallel = self.planes[i].normal.dot(self.planes[j].normal) > PARALLEL;
            if kinds[i] == kinds[j] && (kinds[i] != Kind::Wall || parallel) {
                parts.join(*a, *b);
            }
        }
        parts.into_roots()
    }

    fn object(&self, path: String, planes: &[u32]) -> Result<ExploredObject> {
        let own = |piece: &&Piece| planes.binary_search(&piece.plane).is_ok();
        let pieces: Vec<&Piece> = self.pieces.iter().filter(own).collect();
        let bounds = Aabb::of(pieces.iter().flat_map(|p| p.corners.iter().copied()));
        // Whole millimetres are readable.
        let middle = (bounds.center() * 1e3).round() / 1e3;
        let (mesh, _) = mesh(&path, pieces.iter().map(|p| &p.corners[..]), middle)?;
        let evidence = planes.iter().map(|p| self.evidence[*p as usize]);
        let [hit, pass] = evidence.fold([0.0; 2], |sum, e| [sum[0] + e[0], sum[1] + e[1]]);
        let unseen = planes.iter().flat_map(|p| boxes(&self.unseen[*p as usize], middle)).collect();
        Ok(ExploredObject {
            path,
            world_from_object: Pose { translation: middle + self.base, ..Pose::IDENTITY },
            mesh,
            covariance: self.covariance(planes, middle, bounds.half_extent().length()),
            // Laplace's rule of succession.
            existence: (hit + 1.0) / (hit + pass + 2.0),
            unseen,
        })
    }

    /// Each plane constrains the object along its normal and about the two perpendicular axes. Borders constrain it to
    /// a cell.
    fn covariance(&self, planes: &[u32], middle: DVec3, radius: f64) -> PoseCovariance<InObject> {
        let mut information: Matrix = [[0.0; 6]; 6];
        let constrain = |j: [f64; 6], sigma: f64, information: &mut Matrix| {
            (0..6).for_each(|a| (0..6).for_each(|b| information[a][b] += j[a] * j[b] / (sigma * sigma)));
        };
        let border = self.detail;
        for axis in 0..3 {
            let unit = |k: usize| std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 });
            constrain(unit(axis), border, &mut information);
            constrain(unit(3 + axis), border / radius.max(border), &mut information);
        }
        for plane in planes {
            let Flat { centre, normal } = self.planes[*plane as usize];
            let lever = (centre - middle).cross(normal);
            let j = [normal.x, normal.y, normal.z, lever.x, lever.y, lever.z];
            constrain(j, self.sigmas[*plane as usize], &mut information);
        }
        let rows = inverse(&information, &[0, 1, 2, 3, 4, 5]);
        let symmetric: Matrix = std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (rows[i][j] + rows[j][i])));
        PoseCovariance::unchecked_row_major(symmetric.as_flattened())
            .unwrap_or_else(|_| PoseCovariance::from_sigmas([border; 6]))
    }
}

fn kinds(planes: &[Flat], facts: &[Facts]) -> Vec<Kind> {
    let large = |up: f64| {
        let of = move |(p, f): &(&Flat, &Facts)| p.normal.z * up > LEVEL && f.area > MIN_AREA;
        planes.iter().zip(facts).filter(of).map(|(_, f)| f.bounds.center().z)
    };
    let floor = large(1.0).fold(f64::INFINITY, f64::min);
    let ceiling = large(-1.0).fold(f64::NEG_INFINITY, f64::max);
    let lowest = facts.iter().map(|f| f.bounds.min.z).fold(f64::INFINITY, f64::min);
    let ground = if floor.is_finite() { floor } else { lowest };
    let kind = |(plane, fact): (&Flat, &Facts)| {
        let (up, height) = (plane.normal.z, fact.bounds.center().z);
        if up > LEVEL && (height - floor).abs() < STEP {
            Kind::Floor
        } else if up < -LEVEL && (height - ceiling).abs() < STEP {
            Kind::Ceiling
        } else if up.abs() < UPRIGHT && fact.area > MIN_AREA && fact.bounds.max.z > ground + WALL {
            Kind::Wall
        } else {
            Kind::Other
        }
    };
    planes.iter().zip(facts).map(kind).collect()
}

/// The number after the highest one in a group.
pub(crate) fn first_free(taken: &Environment, group: &str) -> u32 {
    let number = |i: u32| taken.objects()[i as usize].name.strip_prefix(&format!("{group}/"))?.parse::<u32>().ok();
    taken.below(group).filter_map(number).max().map_or(1, |max| max + 1)
}

/// Boxes of at most eight cells a side around the unobserved cells; neighbours along z become one box.
fn boxes((cells, side): &(Vec<DVec3>, f64), middle: DVec3) -> Vec<Aabb> {
    let block = 8.0 * side;
    if cells.is_empty() {
        return Vec::new();
    }
    let mut blocks: BTreeMap<[i64; 3], Aabb> = BTreeMap::new();
    for cell in cells {
        let at = (*cell / block).floor().to_array().map(|c| c as i64);
        let half = DVec3::splat(0.5 * side);
        let own = Aabb { min: *cell - half - middle, max: *cell + half - middle };
        let all = blocks.entry(at).or_insert(Aabb::EMPTY);
        *all = all.union(own);
    }
    let mut merged: Vec<([i64; 3], Aabb)> = Vec::new();
    for (at, own) in blocks {
        match merged.last_mut() {
            Some((before, all)) if before[..2] == at[..2] && before[2] + 1 == at[2] => {
                (*before, *all) = (at, all.union(own));
            }
            _ => merged.push((at, own)),
        }
    }
    merged.into_iter().map(|(_, b)| b).collect()
}
