//! Finds the polygons of contours.

use super::edges::MeshEdges;
use super::surface::{Reached, connected, is_flat};
use crate::environment::Environment;
use crate::error::{Error, Result};
use crate::limits;
use glam::DVec3;
use std::collections::HashMap;
use std::collections::hash_map::Entry;

/// Finds the polygons of contours; sets up the edges of each object once.
pub struct ContourFinder<'a> {
    environment: &'a Environment,
    class: &'a str,
    objects: HashMap<u32, (MeshEdges, Reached)>,
    known: KnownSurfaces,
    /// Number of facets of all surfaces found so far.
    facets: u64,
}

impl<'a> ContourFinder<'a> {
    /// A finder for a sensor class.
    pub fn new(environment: &'a Environment, class: &'a str) -> Self {
        Self { environment, class, objects: HashMap::new(), known: KnownSurfaces::default(), facets: 0 }
    }

    /// Returns true if [`limits::MAX_CONTOUR_FACETS`] is exceeded.
    pub fn is_full(&self) -> bool {
        self.facets > limits::MAX_CONTOUR_FACETS
    }

    /// The slots of the surface at some slots of one object, ascending. If there are several surfaces, the one with the
    /// most polygons. Empty if the class sees none of them.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if [`limits::MAX_CONTOUR_FACETS`] is exceeded, and the errors of setting up edges.
    pub fn find(&mut self, object: u32, slots: &[u32], crease_deg: f64) -> Result<Vec<u32>> {
        let of = &self.environment.objects()[object as usize];
        let (edges, reached) = match self.objects.entry(object) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => {
                let edges = MeshEdges::new(self.environment, of, self.class)?;
                let reached = Reached::new(&edges);
                new.insert((edges, reached))
            }
        };
        let mut largest = Vec::new();
        for slot in slots {
            let surface = self.known.of(object, slot - of.first_slot, crease_deg, edges, reached);
            if surface.len() > largest.len() {
                largest.clone_from(surface);
            }
        }
        self.facets += largest.len() as u64;
        if self.is_full() {
            let what = format!("the contours of the layer hold over {} polygons", limits::MAX_CONTOUR_FACETS);
            return Err(Error::invalid(what, "give fewer contours, or smaller crease angles"));
        }
        largest.iter_mut().for_each(|polygon| *polygon += of.first_slot);
        Ok(largest)
    }
}

/// Surfaces found before; many contours may share one.
#[derive(Default)]
struct KnownSurfaces {
    /// The index of the surface by object, polygon and bits of the crease angle.
    numbers: HashMap<(u32, u32, u64), u32>,
    /// Polygons of each surface, ascending.
    surfaces: Vec<Vec<u32>>,
    /// Number of their facets, at most [`limits::MAX_CONTOUR_FACETS`].
    facets: u64,
}

impl KnownSurfaces {
    /// The surface of a polygon of an object; each of the surface's polygons gives the same one.
    fn of(
        &mut self,
        object: u32,
        polygon: u32,
        crease_deg: f64,
        edges: &MeshEdges,
        reached: &mut Reached,
    ) -> &Vec<u32> {
        let key = |polygon: u32| (object, polygon, crease_deg.to_bits());
        if let Some(number) = self.numbers.get(&key(polygon)) {
            return &self.surfaces[*number as usize];
        }
        let polygons = connected(edges, polygon, crease_deg.to_radians(), reached);
        reached.forget(&polygons);
        if self.facets + polygons.len() as u64 > limits::MAX_CONTOUR_FACETS {
            *self = Self::default();
        }
        self.facets += polygons.len() as u64;
        let number = self.surfaces.len() as u32;
        self.numbers.extend(polygons.iter().map(|polygon| (key(*polygon), number)));
        self.surfaces.push(polygons);
        &self.surfaces[number as usize]
    }
}

/// A smooth surface for which a contour may be generated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothSurface {
    /// Index of its object.
    pub object: u32,
    /// The middle of its largest polygon, in the object's frame; among equal ones, the first by coordinates.
    pub anchor: DVec3,
    /// Its bounds in the frame of the object.
    pub bounds: crate::geometry::Aabb,
}

/// The smooth surfaces of an object that are not flat, and that `keeps` keeps by their polygons.
pub fn surfaces(
    environment: &Environment,
    object: u32,
    edges: &MeshEdges,
    crease: f64,
    mut keeps: impl FnMut(&[u32]) -> bool,
) -> Vec<SmoothSurface> {
    let of = &environment.objects()[object as usize];
    let mut reached = Reached::new(edges);
    let mut found = Vec::new();
    for polygon in 0..edges.normals.len() as u32 {
        if reached.holds(polygon) {
            continue;
        }
        let polygons = connected(edges, polygon, crease, &mut reached);
        if is_flat(edges, &polygons) || !keeps(&polygons) {
            continue;
        }
        let corners = |polygon: u32| of.mesh.corners_of(polygon).map(|p| of.object_from_mesh.transform_point3(p));
        let mut best: Option<(f64, DVec3)> = None;
        let mut bounds = crate::geometry::Aabb::EMPTY;
        for polygon in polygons {
            let own: Vec<DVec3> = corners(polygon).collect();
            bounds = bounds.union(crate::geometry::Aabb::of(own.iter().copied()));
            let doubled = own[1..].windows(2).map(|p| (p[0] - own[0]).cross(p[1] - own[0])).sum::<DVec3>().length();
            let center = edges.centers[polygon as usize];
            let first =
                |a: DVec3, b: DVec3| a.to_array().partial_cmp(&b.to_array()).is_some_and(std::cmp::Ordering::is_lt);
            if best.is_none_or(|(most, at)| doubled > most || doubled == most && first(center, at)) {
                best = Some((doubled, center));
            }
        }
        found.extend(best.map(|(_, anchor)| SmoothSurface { object, anchor, bounds }));
    }
    found
}
