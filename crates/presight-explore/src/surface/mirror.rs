//! Detection of mirrors: points behind an opening of a surface that are images of points in front of the surface.

use super::region::Regions;
use crate::geometry::{Flat, bounds};
use crate::observe::{View, Views, oriented};
use crate::surfels::Surface;
use glam::{DVec2, DVec3};
use std::collections::{BTreeMap, BTreeSet};

/// Minimum area of a surface with a mirror, square metres.
const MIN_AREA: f64 = 0.5;
/// Minimum depth of a point behind a surface, metres.
const BEHIND: f64 = 0.1;
/// Side of the cells of an opening, metres.
const CELL: f64 = 0.1;
/// Minimum cosine between the normals of a point and the mirror. Surfaces perpendicular to the mirror's plane, such as
/// the floor, also continue behind an open door.
const ACROSS: f64 = 0.3;
/// Maximum distance of a mirrored point from its original, in sizes of surfels and in metres. Larger surfels would
/// match by chance.
const SAME: f64 = 2.0;
const NEAR: f64 = 0.05;
/// Minimum number of points behind an opening, and minimum share of images among them. Behind a door fewer match by
/// chance.
const MIN_POINTS: u32 = 100;
const IMAGES: f64 = 0.8;

/// The plane of a mirror, and the cells of its opening.
struct Mirror {
    plane: Flat,
    cells: BTreeSet<[i64; 2]>,
}

impl Mirror {
    fn shows(&self, view: &View, pixel: usize) -> bool {
        crossing(&self.plane, view, pixel).is_some_and(|q| self.cells.contains(&cell(q)))
    }
}

fn cell(q: DVec2) -> [i64; 2] {
    (q / CELL).floor().to_array().map(|c| c as i64)
}

/// The intersection of a plane with the ray to a point behind it, if the sensor is in front.
fn crossing(plane: &Flat, view: &View, pixel: usize) -> Option<DVec2> {
    let (from, to) = (plane.above(view.origin()), plane.above(view.point(pixel)));
    (from > 0.0 && to < -BEHIND).then(|| plane.place(view.origin().lerp(view.point(pixel), from / (from - to))))
}

/// The views without the points in mirrors, and the number of those points; `None` if there is no mirror.
pub(crate) fn without_images(views: &Views, surface: &Surface, regions: &Regions) -> Option<(Views, usize)> {
    let large = |(plane, members): (&Flat, Vec<u32>)| {
        let area: f64 = members.iter().map(|m| surface.surfels[*m as usize].size.powi(2)).sum();
        if area > MIN_AREA { mirrors(views, surface, plane, &members) } else { Default::default() }
    };
    let found: Vec<Mirror> = regions.planes.iter().zip(regions.members()).flat_map(large).collect();
    if found.is_empty() {
        return None;
    }
    Some(views.without(|view, pixel| found.iter().any(|mirror| mirror.shows(view, pixel))))
}

/// The openings of a plane that show images.
fn mirrors(views: &Views, surface: &Surface, plane: &Flat, members: &[u32]) -> Vec<Mirror> {
    let (min, max) = bounds(members.iter().map(|m| plane.place(surface.surfels[*m as usize].at)));
    let size = surface.surfels[members[0] as usize].size;
    // By cell: number of points that could be images, and number of images.
    let mut counts: BTreeMap<[i64; 2], [u32; 2]> = BTreeMap::new();
    for view in views.sample().all() {
        for pixel in view.inner_pixels() {
            let Some(q) = crossing(plane, view, pixel).filter(|q| q.cmpge(min).all() && q.cmple(max).all()) else {
                continue;
            };
            let count = counts.entry(cell(q)).or_default();
            let Some((p, normal, _)) = oriented(view, pixel) else { continue };
            if view.direction_to_world(normal).dot(plane.normal).abs() > ACROSS {
                let p: DVec3 = view.origin() + view.direction_to_world(p);
                let image = p - 2.0 * plane.above(p) * plane.normal;
                count[0] += 1;
                count[1] += u32::from(surface.near(image, NEAR.min(SAME * size)).next().is_some());
            }
        }
    }
    let is_mirror = |cells: &BTreeSet<[i64; 2]>| {
        let [all, images] = cells.iter().fold([0; 2], |sum, cell| [0, 1].map(|k| sum[k] + counts[cell][k]));
        all >= MIN_POINTS && f64::from(images) > IMAGES * f64::from(all)
    };
    let openings = connected(counts.keys().copied().collect());
    openings.into_iter().filter(is_mirror).map(|cells| Mirror { plane: *plane, cells }).collect()
}

/// Connected sets of cells, with neighbours along sides and diagonals.
fn connected(mut left: BTreeSet<[i64; 2]>) -> Vec<BTreeSet<[i64; 2]>> {
    let mut parts = Vec::new();
    while let Some(first) = left.pop_first() {
        let (mut part, mut front) = (BTreeSet::from([first]), vec![first]);
        while let Some([x, y]) = front.pop() {
            for next in (-1..=1).flat_map(|i| (-1..=1).map(move |j| [x + i, y + j])) {
                if left.remove(&next) {
                    part.insert(next);
                    front.push(next);
                }
            }
        }
        parts.push(part);
    }
    parts
}
