//! Solids with facets around the z axis.

use super::{Solid, count, length, length_or_none};
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::sin_cos_of_turn;

/// An upright prism over a regular polygon.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming the invalid parameter.
pub fn prism(sides: u32, radius: f64, height: f64) -> Result<Solid> {
    let n = count("sides", sides, 3)?;
    let (radius, height) = (length("radius", radius)?, length("height", height)?);
    Ok(frustum(n, radius, radius, height))
}

/// An upright cylinder with this many facets.
///
/// # Errors
/// As [`prism`].
pub fn cylinder(radius: f64, height: f64, facets: u32) -> Result<Solid> {
    prism(count("facets", facets, 3)?, radius, height)
}

/// An upright cone; truncated if neither radius is 0.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming the invalid parameter, or if both radii are 0.
pub fn cone(radius_bottom: f64, radius_top: f64, height: f64, facets: u32) -> Result<Solid> {
    let n = count("facets", facets, 3)?;
    let low = length_or_none("radius_bottom", radius_bottom)?;
    let high = length_or_none("radius_top", radius_top)?;
    if low == 0.0 && high == 0.0 {
        return Err(Error::invalid("both radii are 0", "give one of them metres above 0"));
    }
    Ok(frustum(n, low, high, length("height", height)?))
}

/// Adds a ring of corners, or one corner on the axis, and returns their indices.
fn ring(solid: &mut Solid, n: u32, radius: f64, z: f64) -> Vec<u32> {
    let first = solid.vertices.len() as u32;
    if radius == 0.0 {
        solid.vertices.push(DVec3::new(0.0, 0.0, z));
        return vec![first; n as usize];
    }
    solid.vertices.extend((0..n).map(|k| {
        let (s, c) = sin_cos_of_turn(k, n);
        DVec3::new(radius * c, radius * s, z)
    }));
    (first..first + n).collect()
}

/// Adds facets between two rings. They face outwards if `low` is below `high`.
fn band(solid: &mut Solid, low: &[u32], high: &[u32]) {
    let n = low.len();
    for k in 0..n {
        let next = (k + 1) % n;
        let mut corners = vec![low[k], low[next], high[next], high[k]];
        corners.dedup();
        solid.push(corners);
    }
}

fn frustum(n: u32, low: f64, high: f64, height: f64) -> Solid {
    let mut solid = Solid::default();
    let bottom = ring(&mut solid, n, low, 0.0);
    let top = ring(&mut solid, n, high, height);
    if low > 0.0 {
        solid.push(bottom.iter().rev().copied());
    }
    band(&mut solid, &bottom, &top);
    if high > 0.0 {
        solid.push(top);
    }
    solid
}

/// A sphere about the origin with its poles on the z axis: `facets` around, half as many from pole to pole.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming the invalid parameter.
pub fn sphere(radius: f64, facets: u32) -> Result<Solid> {
    let (n, radius) = (count("facets", facets, 4)?, length("radius", radius)?);
    let bands = n / 2;
    let mut solid = Solid::default();
    let mut below = ring(&mut solid, n, 0.0, -radius);
    for k in 1..=bands {
        // Half a turn from the south pole to the north pole.
        let (s, c) = sin_cos_of_turn(k, 2 * bands);
        let above = ring(&mut solid, n, if k == bands { 0.0 } else { radius * s }, -radius * c);
        band(&mut solid, &below, &above);
        below = above;
    }
    Ok(solid)
}

/// An upright tube: a cylinder with a coaxial hole through it.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming the invalid parameter, or if the hole leaves no wall.
pub fn tube(radius_outer: f64, radius_inner: f64, height: f64, facets: u32) -> Result<Solid> {
    let n = count("facets", facets, 3)?;
    let (outer, inner) = (length("radius_outer", radius_outer)?, length("radius_inner", radius_inner)?);
    if inner >= outer {
        return Err(Error::invalid(format!("the hole of radius {inner} m leaves no wall"), "make it smaller"));
    }
    let height = length("height", height)?;
    let mut solid = Solid::default();
    let [outer_low, outer_high] = [0.0, height].map(|z| ring(&mut solid, n, outer, z));
    let [inner_low, inner_high] = [0.0, height].map(|z| ring(&mut solid, n, inner, z));
    band(&mut solid, &outer_low, &outer_high);
    band(&mut solid, &outer_high, &inner_high);
    band(&mut solid, &inner_high, &inner_low);
    band(&mut solid, &inner_low, &outer_low);
    Ok(solid)
}
