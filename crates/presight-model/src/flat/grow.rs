//! Grows planes over the facets of a scanned mesh.

use super::FlatSurface;
use super::facets::Facets;
use super::fit::{Fit, PLANE};
use super::noise::Seed;
use crate::geometry::Plane;

/// Corners this many tolerances from a plane still lie on it where the plane continues around them. At a tolerance of
/// three standard deviations, one corner in 16,000 is farther off.
pub const FRINGE: f64 = 4.0 / 3.0;

/// Rounds of growing a surface and fitting its plane.
const ROUNDS: usize = 3;

/// The planes through facets that lie within `tolerance` of them, of at least `least` square metres. Planes are tried
/// in the order of the seeds, and each facet belongs to one plane.
pub(super) fn planes(facets: &Facets<'_>, seeds: &[Seed], tolerance: f64, least: f64) -> Vec<FlatSurface> {
    let count = facets.areas.len();
    let mut growth = Growth { facets, taken: vec![false; count], reached: vec![0; count], search: 0 };
    let mut found = Vec::new();
    for seed in seeds {
        if seed.curved || growth.taken[seed.polygon as usize] {
            continue;
        }
        let Some((plane, polygons)) = growth.grow(seed, tolerance) else { continue };
        let area: f64 = polygons.iter().map(|p| facets.areas[*p as usize]).sum();
        if area >= least {
            polygons.iter().for_each(|p| growth.taken[*p as usize] = true);
            found.push(FlatSurface { plane, polygons, area });
        }
    }
    // The fringes come last, so that no plane takes facets of another.
    for surface in &mut found {
        let (mut plane, polygons) = (surface.plane, std::mem::take(&mut surface.polygons));
        surface.polygons = growth.reach(polygons, &mut plane, FRINGE * tolerance, |_, _| {});
        surface.polygons.iter().for_each(|p| growth.taken[*p as usize] = true);
        surface.polygons.sort_unstable();
    }
    found
}

struct Growth<'a> {
    facets: &'a Facets<'a>,
    taken: Vec<bool>,
    /// By polygon: the number of the last search that reached it.
    reached: Vec<u32>,
    /// Number of searches.
    search: u32,
}

impl Growth<'_> {
    /// The plane from a seed and its polygons; `None` if the seed itself is not on it.
    fn grow(&mut self, seed: &Seed, tolerance: f64) -> Option<(Plane, Vec<u32>)> {
        let (facets, frame) = (self.facets, &seed.frame);
        let (normal, offset) = frame.plane(seed.plane);
        let mut plane = Plane { normal, offset };
        let mut polygons = Vec::new();
        // Area to which the plane is fitted, square metres. It is fitted again when the surface has twice that.
        let mut fitted = frame.area();
        for _ in 0..ROUNDS {
            if !self.is_on(seed.polygon, &plane, tolerance) {
                return None;
            }
            let (mut fit, mut area) = (Fit::<PLANE>::new(), 0.0);
            let refit = |fit: &Fit<PLANE>, plane: &mut Plane| {
                if let Some((normal, offset)) = fit.solve().map(|c| frame.plane(c)) {
                    *plane = Plane { normal, offset };
                }
            };
            polygons = self.reach(vec![seed.polygon], &mut plane, tolerance, |polygon, plane| {
                let own = facets.areas[polygon as usize];
                let weight = own / facets.corners_of(polygon).count() as f64;
                facets.corners_of(polygon).for_each(|c| fit.add(frame.place(facets.position(c)), weight));
                area += own;
                if area >= 2.0 * fitted {
                    refit(&fit, plane);
                    fitted = area;
                }
            });
            refit(&fit, &mut plane);
            fitted = area.max(frame.area());
        }
        polygons.retain(|p| self.is_on(*p, &plane, tolerance));
        Some((plane, polygons))
    }

    /// Adds to some polygons all others on a plane that edges connect with them. `visit` may change the plane.
    fn reach(
        &mut self,
        mut all: Vec<u32>,
        plane: &mut Plane,
        tolerance: f64,
        mut visit: impl FnMut(u32, &mut Plane),
    ) -> Vec<u32> {
        self.search += 1;
        all.iter().for_each(|p| self.reached[*p as usize] = self.search);
        let mut next = 0;
        while let Some(polygon) = all.get(next).copied() {
            next += 1;
            visit(polygon, plane);
            for other in self.facets.beside(polygon) {
                let at = other as usize;
                if !self.taken[at] && self.reached[at] != self.search && self.is_on(other, plane, tolerance) {
                    self.reached[at] = self.search;
                    all.push(other);
                }
            }
        }
        all
    }

    fn is_on(&self, polygon: u32, plane: &Plane, tolerance: f64) -> bool {
        let height = |c: u32| plane.normal.dot(self.facets.position(c)) - plane.offset;
        self.facets.areas[polygon as usize] > 0.0
            && self.facets.corners_of(polygon).all(|c| height(c).abs() <= tolerance)
    }
}
