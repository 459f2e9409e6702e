//! The surfaces of all contours among some features, in one version of the world.

use super::edges::MeshEdges;
use super::surface::Surface;
use crate::environment::{Environment, FeatureShape};
use crate::error::Result;
use crate::geometry::{Aabb, plane_of_polygon};
use crate::index::{Params, QueryResult, Region, Skd, SpatialIndex};
use crate::placement::PlacedFeature;
use crate::world::World;
use glam::DVec3;
use std::collections::HashMap;

/// Maximum distance between touching features and polygons, metres, as in generated layers.
const TOUCH: f64 = 5e-4;

/// Surfaces by index of the feature.
#[derive(Debug, Default)]
pub struct ContourSet {
    surfaces: HashMap<u32, Surface>,
    /// Indices of the contours, ascending.
    numbers: Vec<u32>,
}

impl ContourSet {
    /// # Errors
    /// The errors of setting up edges.
    pub fn new(world: &World, class: &str, placed: &[PlacedFeature]) -> Result<Self> {
        let mut set = Self::default();
        if !placed.iter().any(|p| p.feature.shape.is_contour()) {
            return Ok(set);
        }
        let environment = world.environment();
        let mut ends = EdgeEnds {
            world,
            seen: super::seen_materials(environment, class),
            segments: Segments::new(environment, placed),
            found: QueryResult::default(),
        };
        let mut known: HashMap<u32, MeshEdges> = HashMap::new();
        for (number, p) in placed.iter().enumerate() {
            let FeatureShape::Contour { crease_deg, .. } = &p.feature.shape else { continue };
            set.numbers.push(number as u32);
            let Some((object, _)) = p.slots.first().and_then(|slot| environment.locate(*slot)) else { continue };
            let of = &environment.objects()[object as usize];
            if let std::collections::hash_map::Entry::Vacant(new) = known.entry(object) {
                new.insert(MeshEdges::new(environment, of, class)?);
            }
            let end = of.first_slot + of.mesh.polygon_count() as u32;
            let mut polygons: Vec<u32> = p
                .slots
                .iter()
                .filter(|slot| (of.first_slot..end).contains(slot))
                .map(|slot| slot - of.first_slot)
                .collect();
            polygons.sort_unstable();
            let crease = crease_deg.to_radians();
            let pose = of.world_from_object;
            let keeps = |edge: [DVec3; 2], slot: u32, wing: DVec3| {
                ends.count(edge.map(|p| pose.transform_point(p)), slot, pose.rotation * wing, crease)
            };
            let mut surface = Surface::new(&known[&object], object, of.first_slot, &polygons, crease, keeps);
            if p.object != Some(object) {
                surface.hull = surface.hull.map(|corner| pose.transform_point(corner));
            }
            set.surfaces.insert(number as u32, surface);
        }
        Ok(set)
    }

    /// The surface of a contour, by index of the feature.
    pub fn get(&self, number: usize) -> Option<&Surface> {
        self.surfaces.get(&(number as u32))
    }

    /// Indices of the contours, ascending.
    pub fn numbers(&self) -> &[u32] {
        &self.numbers
    }

    /// Returns true if there are no contours.
    pub fn is_empty(&self) -> bool {
        self.surfaces.is_empty()
    }
}

/// Finds the edges where surfaces visibly end and no segment lies.
struct EdgeEnds<'a> {
    world: &'a World,
    /// By material: true if the class sees it.
    seen: Vec<bool>,
    segments: Segments,
    found: QueryResult,
}

impl EdgeEnds<'_> {
    /// Returns true for an edge (world) of the polygon in `slot`, which extends from it along `wing`, unless another
    /// polygon continues smoothly there or a segment of the layer contains the edge.
    fn count(&mut self, edge: [DVec3; 2], slot: u32, wing: DVec3, crease: f64) -> bool {
        !self.goes_on(edge, slot, wing, crease) && !self.segments.have(edge, &mut self.found)
    }

    fn goes_on(&mut self, [a, b]: [DVec3; 2], slot: u32, wing: DVec3, crease: f64) -> bool {
        let environment = self.world.environment();
        let middle = a.midpoint(b);
        let Some(along) = (b - a).try_normalize() else { return true };
        self.found.clear();
        let near = Aabb { min: middle - 4.0 * TOUCH, max: middle + 4.0 * TOUCH };
        self.world.index().query(environment, &Region::cuboid(&near), &mut self.found);
        self.found.all().filter(|other| *other != slot).any(|other| {
            let seen = environment.locate(other).is_some_and(|(object, polygon)| {
                self.seen[usize::from(environment.objects()[object as usize].mesh.material(polygon))]
            });
            let Some(corners) = environment.polygon_in_world(other).filter(|_| seen) else { return false };
            let about: Vec<DVec3> = corners.iter().map(|c| *c - middle).collect();
            let Some(normal) = plane_of_polygon(&about).map(|p| p.normal) else { return false };
            let Some(across) = normal.cross(along).try_normalize() else { return false };
            // Away from the first polygon.
            let onward = if across.dot(wing) > 0.0 { -across } else { across };
            onward.angle_between(-wing) <= crease
                && normal.dot(along).abs() < 0.1
                && holds(&about, normal, DVec3::ZERO)
                && holds(&about, normal, onward * (2.0 * TOUCH))
        })
    }
}

/// Returns true if a point is on a convex polygon, within [`TOUCH`].
fn holds(corners: &[DVec3], normal: DVec3, p: DVec3) -> bool {
    (normal.dot(p - corners[0])).abs() <= TOUCH
        && (0..corners.len()).all(|k| {
            let (u, v) = (corners[k], corners[(k + 1) % corners.len()]);
            normal.cross(v - u).dot(p - u) >= -TOUCH * (v - u).length()
        })
}

/// The segments of some features, in the world.
struct Segments {
    ends: Vec<[DVec3; 2]>,
    index: Skd<3>,
}

impl Segments {
    fn new(environment: &Environment, placed: &[PlacedFeature]) -> Self {
        let in_world = |p: &PlacedFeature| {
            let FeatureShape::Segment { ends, .. } = &p.feature.shape else { return None };
            let pose = p.object.map(|o| environment.objects()[o as usize].world_from_object);
            Some(ends.map(|end| pose.map_or(end, |pose| pose.transform_point(end))))
        };
        let ends: Vec<[DVec3; 2]> = placed.iter().filter_map(in_world).collect();
        let boxes: Vec<(u32, Aabb)> = (0..).zip(ends.iter().map(|ends| Aabb::of(*ends))).collect();
        Self { index: Skd::build(Params::default(), &boxes), ends }
    }

    /// Returns true if one segment contains all of an edge.
    fn have(&self, edge: [DVec3; 2], found: &mut QueryResult) -> bool {
        let bounds = Aabb::of(edge);
        found.clear();
        let near = Aabb { min: bounds.min - 2.0 * TOUCH, max: bounds.max + 2.0 * TOUCH };
        self.index.query(&Region::cuboid(&near), found);
        found.all().any(|i| {
            let [a, b] = self.ends[i as usize];
            let d = b - a;
            let on = |p: DVec3| {
                let t = ((p - a).dot(d) / d.length_squared()).clamp(0.0, 1.0);
                (a + d * t).distance(p) <= 2.0 * TOUCH
            };
            edge.into_iter().all(on)
        })
    }
}
