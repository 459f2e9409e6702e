//! Mirrors: points behind an opening of a surface that are images of points before that surface are not a room.

use super::region::Regions;
use crate::geometry::Flat;
use crate::observe::{View, Views, oriented};
use crate::surfels::Surface;
use glam::{DVec2, DVec3};
use std::collections::{BTreeMap, BTreeSet};

/// Least area of a surface that has a mirror, square metres.
const LARGE: f64 = 0.5;
/// Points this far behind the surface are behind it, metres.
const BEHIND: f64 = 0.1;
/// Side of the cells of an opening, metres.
const CELL: f64 = 0.1;
/// Number of views in which mirrors are searched.
const VIEWS: usize = 16;
/// Surfaces across the mirror's plane, such as the floor, go on behind a door, too: cosine between the normals.
const ACROSS: f64 = 0.3;
/// Largest distance of a mirrored point from its original, in sizes of surfels, and in metres: larger pieces match by chance.
const SAME: f64 = 2.0;
const NEAR: f64 = 0.05;
/// Number of points that decide on an opening, and the share of images among them. Behind a door fewer match by chance.
const LEAST_POINTS: u32 = 100;
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

/// Where the ray of a point behind a plane goes through it from the front.
fn crossing(plane: &Flat, view: &View, pixel: usize) -> Option<DVec2> {
    let (from, to) = (plane.above(view.origin()), plane.above(view.point(pixel)));
    (from > 0.0 && to < -BEHIND).then(|| plane.place(view.origin().lerp(view.point(pixel), from / (from - to))))
}

/// The views without what mirrors show, and the number of points that are left out; `None` if there is no mirror.
pub(crate) fn without_images(views: &Views, surface: &Surface, regions: &Regions) -> Option<(Views, usize)> {
    let large = |(plane, members): (&Flat, Vec<u32>)| {
        let area: f64 = members.iter().map(|m| surface.surfels[*m as usize].size.powi(2)).sum();
        if area > LARGE { mirrors(views, surface, plane, &members) } else { Default::default() }
    };
    let found: Vec<Mirror> = regions.planes.iter().zip(regions.members()).flat_map(large).collect();
    if found.is_empty() {
        return None;
    }
    Some(views.without(|view, pixel| found.iter().any(|mirror| mirror.shows(view, pixel))))
}

/// The openings of a plane that show images.
fn mirrors(views: &Views, surface: &Surface, plane: &Flat, members: &[u32]) -> Vec<Mirror> {
    let places = members.iter().map(|m| plane.place(surface.surfels[*m as usize].at));
    let infinite = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    let (least, most) = places.fold(infinite, |(a, b), q| (a.min(q), b.max(q)));
    let size = surface.surfels[members[0] as usize].size;
    // By cell: points that may be images, and points that are images.
    let mut counts: BTreeMap<[i64; 2], [u32; 2]> = BTreeMap::new();
    for view in views.some(VIEWS).all() {
        for pixel in view.inner_pixels() {
            let Some(q) = crossing(plane, view, pixel).filter(|q| q.cmpge(least).all() && q.cmple(most).all()) else {
                continue;
            };
            let count = counts.entry(cell(q)).or_default();
            let Some((p, normal, _)) = oriented(view, pixel) else { continue };
            if view.turned(normal).dot(plane.normal).abs() > ACROSS {
                let p: DVec3 = view.origin() + view.turned(p);
                let image = p - 2.0 * plane.above(p) * plane.normal;
                count[0] += 1;
                count[1] += u32::from(surface.near(image, NEAR.min(SAME * size)).next().is_some());
            }
        }
    }
    let is_mirror = |cells: &BTreeSet<[i64; 2]>| {
        let [all, images] = cells.iter().fold([0; 2], |sum, cell| [0, 1].map(|k| sum[k] + counts[cell][k]));
        all >= LEAST_POINTS && f64::from(images) > IMAGES * f64::from(all)
    };
    let openings = parts(counts.keys().copied().collect());
    openings.into_iter().filter(is_mirror).map(|cells| Mirror { plane: *plane, cells }).collect()
}

/// Cells that hang together.
fn parts(mut left: BTreeSet<[i64; 2]>) -> Vec<BTreeSet<[i64; 2]>> {
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
