//! Requirements on the vertices and polygons of a mesh.

use super::polygon::{Polygon, PolygonRecord};
use crate::error::{Error, Result};
use crate::geometry::{Aabb, PLANARITY, Plane, plane_of_loop};
use crate::limits;
use glam::{DVec3, Vec3};

pub fn check_vertices(vertices: &[Vec3]) -> Result<()> {
    let sound = |x: &f32| x.abs() <= limits::MAX_COORDINATE as f32;
    // No early exit: the loop would not be unrolled otherwise.
    let all: &[f32] = bytemuck::cast_slice(vertices);
    if all.iter().fold(true, |all, x| all & sound(x)) {
        return Ok(());
    }
    match vertices.iter().position(|v| !v.to_array().iter().all(sound)) {
        None => Ok(()),
        Some(i) => Err(Error::invalid(
            format!("vertex {i} is {}, not a finite position", vertices[i]),
            "repair the model and export it again",
        )),
    }
}

/// Checks stored records: consecutive polygons with a valid number of corners each.
pub fn check_records(polygons: &[PolygonRecord], corners: usize) -> Result<()> {
    let follows = |end: &mut usize, record: &PolygonRecord| {
        let n = usize::from(record.corner_count);
        let sound = (3..=limits::MAX_CORNERS).contains(&n) & (record.first_corner as usize == *end);
        *end += n;
        sound & (*end <= corners)
    };
    let mut end = 0;
    if polygons.iter().fold(true, |all, record| all & follows(&mut end, record)) {
        return Ok(());
    }
    end = 0;
    let bad = polygons.iter().position(|record| !follows(&mut end, record)).unwrap_or_default();
    Err(Error::invalid("its corners are out of range", "").at(format!("polygon {bad}")))
}

pub fn check_polygon(polygon: &Polygon, vertices: &[Vec3], extent: f64) -> Result<Plane> {
    let n = polygon.corners.len();
    if !(3..=limits::MAX_CORNERS).contains(&n) {
        return Err(Error::invalid(
            format!("{n} corners; 3 to {} are allowed", limits::MAX_CORNERS),
            "split the polygon",
        ));
    }
    if let Some(c) = polygon.corners.iter().find(|&&c| c as usize >= vertices.len()) {
        return Err(Error::invalid(
            format!("vertex index {c} is out of range, there are {} vertices", vertices.len()),
            "repair the model and export it again",
        ));
    }
    let points: Vec<DVec3> = polygon.corners.iter().map(|&c| vertices[c as usize].as_dvec3()).collect();
    let plane = canonical_plane(n, |k| points[k])
        .ok_or_else(|| Error::invalid("the polygon has no area", "drop it or give it distinct vertices"))?;
    if n > 3 {
        check_shape(&points, plane, extent)?;
    }
    Ok(plane)
}

/// The plane, computed from a canonical start and direction of the loop. Coincident faces of either winding thus get
/// the same bits up to the sign, and their ties go to the lower id. Returns `None` if the loop has no area.
pub fn canonical_plane(n: usize, point: impl Fn(usize) -> DVec3) -> Option<Plane> {
    let key = |k: usize| point(k).to_array();
    let start = (1..n).fold(0, |least, k| if key(k) < key(least) { k } else { least });
    let (before, after) = (if start == 0 { n - 1 } else { start - 1 }, if start + 1 == n { 0 } else { start + 1 });
    let reversed = key(before) < key(after);
    let plane = plane_of_loop(n, |k| {
        let turned = if reversed { start + n - k } else { start + k };
        point(if turned >= n { turned - n } else { turned })
    })?;
    Some(if reversed { Plane { normal: -plane.normal, offset: -plane.offset } } else { plane })
}

fn check_shape(points: &[DVec3], plane: Plane, extent: f64) -> Result<()> {
    let n = points.len();
    let size = Aabb::of(points.iter().copied()).size();
    let reach = points.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let tolerance = PLANARITY * size.max(extent).max(reach);
    for k in 0..n {
        let off = (plane.normal.dot(points[k]) - plane.offset).abs();
        if off > tolerance {
            return Err(Error::invalid(
                format!("corner {k} is {off:.3e} m off the plane; {tolerance:.3e} m is allowed"),
                "split the polygon into planar ones",
            ));
        }
        let before = points[k] - points[(k + n - 1) % n];
        let after = points[(k + 1) % n] - points[k];
        let turn = before.cross(after).dot(plane.normal);
        if turn < -tolerance * before.length().max(after.length()) {
            return Err(Error::invalid(
                format!("corner {k} turns inwards: the polygon is not convex"),
                "split the polygon into convex ones",
            ));
        }
    }
    // A star is locally convex everywhere but winds more than once.
    let turning: f64 = (0..n)
        .map(|k| {
            let a = points[(k + 1) % n] - points[k];
            let b = points[(k + 2) % n] - points[(k + 1) % n];
            plane.normal.dot(a.cross(b)).atan2(a.dot(b))
        })
        .sum();
    if (turning - std::f64::consts::TAU).abs() > 1.0 {
        return Err(Error::invalid("the outline winds more than once", "split the polygon into convex ones"));
    }
    Ok(())
}
