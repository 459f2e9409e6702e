//! Splits simple polygons into convex parts: cuts off ears, then joins triangles while the union stays convex (S.
//! Hertel, K. Mehlhorn, Fast triangulation of simple polygons, 1983: at most four times the least number of parts).

use glam::DVec2;
use presight_model::error::{Error, Result};
use presight_model::limits;

/// Twice the signed area of a triangle; positive if it runs counter-clockwise.
pub(super) fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - a)
}

/// Convex parts of a simple counter-clockwise outline, as indices of its points, counter-clockwise. Points within
/// straight sides stay corners, so that no corner lies within another part's side.
pub(super) fn convex_parts(outline: &[DVec2]) -> Result<Vec<Vec<u32>>> {
    let whole: Vec<u32> = (0..outline.len() as u32).collect();
    if outline.len() <= limits::MAX_CORNERS && is_convex(outline, &whole) {
        return Ok(vec![whole]);
    }
    let mut parts: Vec<Vec<u32>> = ears(outline)?.iter().map(|t| t.to_vec()).collect();
    let mut first = 0;
    while first < parts.len() {
        match (first + 1..parts.len()).find_map(|other| Some((other, joined(outline, &parts[first], &parts[other])?))) {
            Some((other, union)) => {
                parts[first] = union;
                parts.remove(other);
            }
            None => first += 1,
        }
    }
    Ok(parts)
}

fn is_convex(outline: &[DVec2], part: &[u32]) -> bool {
    let at = |k: usize| outline[part[k % part.len()] as usize];
    (0..part.len()).all(|k| turn(at(k), at(k + 1), at(k + 2)) >= 0.0)
}

/// The union of two parts that share a side, if it is convex and not too large.
fn joined(outline: &[DVec2], a: &[u32], b: &[u32]) -> Option<Vec<u32>> {
    if a.len() + b.len() - 2 > limits::MAX_CORNERS {
        return None;
    }
    for i in 0..a.len() {
        let (from, to) = (a[i], a[(i + 1) % a.len()]);
        let Some(j) = (0..b.len()).find(|&j| b[j] == to && b[(j + 1) % b.len()] == from) else { continue };
        // The corners of `a` from `to` round to `from`, then the other corners of `b`.
        let mut union: Vec<u32> = (1..=a.len()).map(|k| a[(i + k) % a.len()]).collect();
        union.extend((2..b.len()).map(|k| b[(j + k) % b.len()]));
        return is_convex(outline, &union).then_some(union);
    }
    None
}

fn ears(outline: &[DVec2]) -> Result<Vec<[u32; 3]>> {
    let mut left: Vec<u32> = (0..outline.len() as u32).collect();
    let mut triangles = Vec::with_capacity(outline.len().saturating_sub(2));
    while left.len() > 3 {
        let n = left.len();
        let corners = |k: usize| [left[(k + n - 1) % n], left[k], left[(k + 1) % n]];
        let Some(ear) = (0..n).find(|&k| is_ear(outline, &left, corners(k))) else {
            return Err(Error::invalid(
                "the outline comes too close to itself",
                "give one that does not cross or touch itself",
            ));
        };
        triangles.push(corners(ear));
        left.remove(ear);
    }
    triangles.push([left[0], left[1], left[2]]);
    Ok(triangles)
}

/// True if the triangle has an area, and no other point lies inside it or on its border.
fn is_ear(outline: &[DVec2], left: &[u32], corners: [u32; 3]) -> bool {
    let [a, b, c] = corners.map(|k| outline[k as usize]);
    if !(turn(a, b, c) > 0.0) {
        return false;
    }
    let inside = |p: DVec2| turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 && turn(c, a, p) >= 0.0;
    !left.iter().any(|k| !corners.contains(k) && inside(outline[*k as usize]))
}
