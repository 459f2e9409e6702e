//! Outlines extruded into solids.

use super::split::{convex_parts, turn};
use super::{Solid, length};
use glam::{DVec2, DVec3};
use presight_model::error::{Error, Result};
use presight_model::limits;

/// Extrudes an outline in x and y upwards from z = 0. The outline may be concave and run in either direction, but must
/// not cross or touch itself.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming the point or the sides at fault.
pub fn extrude(outline: &[DVec2], height: f64) -> Result<Solid> {
    prismatic(outline, 0.0, length("height", height)?, |p, w| p.extend(w))
}

/// Extrudes an outline from `low` to `high`; `place`, a rotation, puts it into space.
pub(super) fn prismatic(outline: &[DVec2], low: f64, high: f64, place: impl Fn(DVec2, f64) -> DVec3) -> Result<Solid> {
    let outline = counter_clockwise(outline)?;
    let n = outline.len() as u32;
    let mut solid = Solid::default();
    for w in [low, high] {
        solid.vertices.extend(outline.iter().map(|p| place(*p, w)));
    }
    for part in convex_parts(&outline)? {
        solid.push(part.iter().rev().copied());
        solid.push(part.iter().map(|k| k + n));
    }
    for k in 0..n {
        let next = (k + 1) % n;
        solid.push([k, next, next + n, k + n]);
    }
    Ok(solid)
}

/// Checks an outline and makes it counter-clockwise.
fn counter_clockwise(outline: &[DVec2]) -> Result<Vec<DVec2>> {
    let n = outline.len();
    if !(3..=limits::MAX_OUTLINE).contains(&n) {
        let what = format!("the outline has {n} points");
        return Err(Error::invalid(what, format!("give 3 to {} points [x, y]", limits::MAX_OUTLINE)));
    }
    if let Some(k) = outline.iter().position(|p| !(p.abs().max_element() <= limits::MAX_COORDINATE)) {
        return Err(Error::invalid(format!("outline point {k} is {}", outline[k]), "give finite metres"));
    }
    check_simple(outline)?;
    let doubled_area: f64 = (0..n).map(|k| (outline[k] - outline[0]).perp_dot(outline[(k + 1) % n] - outline[0])).sum();
    let mut outline = outline.to_vec();
    if doubled_area < 0.0 {
        outline.reverse();
    }
    Ok(outline)
}

fn check_simple(outline: &[DVec2]) -> Result<()> {
    let n = outline.len();
    let side = |k: usize| (outline[k], outline[(k + 1) % n]);
    for i in 0..n {
        let (a, b) = side(i);
        let (_, c) = side((i + 1) % n);
        let back = turn(a, b, c) == 0.0 && (b - a).dot(c - b) <= 0.0;
        if a == b || back {
            let what = format!("the outline runs back on itself at point {} ({}, {})", (i + 1) % n, b.x, b.y);
            return Err(Error::invalid(what, "leave out repeated points and spikes"));
        }
        for j in i + 2..n {
            if (j + 1) % n != i && meet(side(i), side(j)) {
                let what = format!("side {i} of the outline meets side {j}");
                return Err(Error::invalid(what, "give an outline that does not cross or touch itself"));
            }
        }
    }
    Ok(())
}

/// True if two segments have a point in common.
fn meet((a, b): (DVec2, DVec2), (c, d): (DVec2, DVec2)) -> bool {
    let apart = a.max(b).cmplt(c.min(d)).any() || c.max(d).cmplt(a.min(b)).any();
    !apart && turn(a, b, c) * turn(a, b, d) <= 0.0 && turn(c, d, a) * turn(c, d, b) <= 0.0
}
