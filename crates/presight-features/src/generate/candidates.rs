//! Candidate edges: sides of polygons that are not clearly smooth, and lines where polygons cross.

use super::FeatureKind;
use super::effort::{Effort, steps};
use super::line::Line;
use super::soup::{Soup, clip, grown, sides};
use super::wings::{creased, join, sectors};
use glam::DVec3;
use presight_model::error::Result;
use presight_model::geometry::Aabb;
use presight_model::index::QueryResult;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Sides of polygons, one for each pair of corners. Sides where exactly two surfaces of one material continue smoothly
/// are omitted. Sides that a neighbour only partly shares stay, and are classified later.
pub(super) fn sides_of_polygons(soup: &Soup, crease: f64) -> Vec<Line> {
    let mut all: Vec<(u32, u32, u32, u32)> = Vec::new();
    for face in 0..soup.faces.len() as u32 {
        let vertices = soup.vertices(face);
        for k in 0..vertices.len() {
            let (a, b) = (vertices[k], vertices[(k + 1) % vertices.len()]);
            if a != b {
                all.push((a.min(b), a.max(b), face, k as u32));
            }
        }
    }
    all.sort_unstable();
    let groups: Vec<_> = all.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)).collect();
    let line = |group: &&[(u32, u32, u32, u32)]| {
        let (_, _, face, k) = group[0];
        let corners = soup.corners(face);
        let (a, b) = (corners[k as usize], corners[(k as usize + 1) % corners.len()]);
        let d = (b - a).try_normalize()?;
        let u = d.any_orthonormal_vector();
        let v = d.cross(u);
        let mut wings: Vec<(f64, u16)> = group
            .iter()
            .map(|&(_, _, face, k)| {
                let (f, corners) = (&soup.faces[face as usize], soup.corners(face));
                let along = corners[(k as usize + 1) % corners.len()] - corners[k as usize];
                let inward = f.plane.normal.cross(along);
                (inward.dot(v).atan2(inward.dot(u)), f.material)
            })
            .collect();
        let wings = join(&mut wings);
        let smooth = wings.len() == 2 && sectors(&wings).all(|(_, span, differ)| !differ && !creased(span, crease));
        let object = soup.faces[face as usize].object;
        (!smooth).then_some(Line { start: a, end: b, object, kind: FeatureKind::Crease })
    };
    groups.par_iter().filter_map(line).collect()
}

/// Lines where two polygons cross away from their sides, as in parts sunk into each other. A line belongs to the
/// smaller of the two objects.
pub(super) fn crossings(
    soup: &Soup,
    touch: f64,
    sizes: &[f64],
    near: Option<&Aabb>,
    effort: &Effort<'_>,
) -> Result<Vec<Line>> {
    let faces = 0..soup.faces.len() as u32;
    let stage = effort.stage("crossings", faces.len());
    let lines: Vec<Vec<Line>> = faces
        .into_par_iter()
        .map_init(QueryResult::default, |found, i| {
            let f = &soup.faces[i as usize];
            stage.step();
            if near.is_some_and(|n| !meet(n, &f.bounds)) {
                return Ok(Vec::new());
            }
            let others = soup.near(&grown(&f.bounds, -touch.min(0.25 * f.bounds.size())), found);
            let mut thing = effort.allowance(f.object);
            thing.spend(steps::FOUND * others.len(), || f.bounds.center())?;
            let crossing = |&j: &u32| crossing(soup, i, j, touch, sizes);
            let lines: Vec<Line> = others.iter().filter(|&&j| j > i).filter_map(crossing).collect();
            // Each line will be examined several times.
            thing.spend(steps::LINE * lines.len(), || f.bounds.center())?;
            Ok(lines)
        })
        .collect::<Result<_>>()?;
    Ok(lines.into_iter().flatten().collect())
}

pub(super) fn meet(a: &Aabb, b: &Aabb) -> bool {
    a.min.cmple(b.max).all() && b.min.cmple(a.max).all()
}

fn crossing(soup: &Soup, i: u32, j: u32, touch: f64, sizes: &[f64]) -> Option<Line> {
    let (f, g) = (&soup.faces[i as usize], &soup.faces[j as usize]);
    let (corners_f, corners_g) = (soup.corners(i), soup.corners(j));
    let straddles = |corners: &[DVec3], normal: DVec3, offset: f64| {
        let (low, high) =
            corners.iter().map(|p| normal.dot(*p) - offset).fold((0f64, 0f64), |(l, h), x| (l.min(x), h.max(x)));
        low < -2.0 * touch && high > 2.0 * touch
    };
    let crosses =
        straddles(corners_g, f.plane.normal, f.plane.offset) && straddles(corners_f, g.plane.normal, g.plane.offset);
    if !crosses {
        return None;
    }
    let across = f.plane.normal.cross(g.plane.normal);
    let d = across.try_normalize().filter(|_| across.length() > (5.0 * PI / 180.0).sin())?;
    // The point on both planes nearest to a corner of the first face.
    let p = corners_f[0];
    let (a, b) = (f.plane.offset - f.plane.normal.dot(p), g.plane.offset - g.plane.normal.dot(p));
    let (n, m) = (f.plane.normal, g.plane.normal);
    let at = p + (m.cross(d) * a + d.cross(n) * b) / n.cross(m).dot(d);
    let mut range = (f64::NEG_INFINITY, f64::INFINITY);
    for (corners, normal) in [(corners_f, n), (corners_g, m)] {
        for (corner, inward) in sides(corners, normal) {
            range = clip(range, inward.dot(at - corner), inward.dot(d));
        }
    }
    let (from, to) = range;
    if !(to - from > 2.0 * touch && (to - from).is_finite()) {
        return None;
    }
    // Near a side of either polygon, that side is already a candidate.
    let middle = at + d * (0.5 * (from + to));
    let inner = |corners: &[DVec3], normal: DVec3| {
        sides(corners, normal).all(|(corner, inward)| inward.dot(middle - corner) > 2.0 * touch)
    };
    if !inner(corners_f, n) || !inner(corners_g, m) {
        return None;
    }
    let owner = |x: u32, y: u32| if (sizes[y as usize], y) < (sizes[x as usize], x) { y } else { x };
    let object = owner(f.object, g.object);
    Some(Line { start: at + d * from, end: at + d * to, object, kind: FeatureKind::Intersection })
}
