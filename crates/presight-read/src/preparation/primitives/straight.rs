//! Solids with flat sides.

use super::outline::prismatic;
use super::{Solid, count, length, length_or_none};
use glam::{DVec2, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::plane_of_polygon;
use presight_model::limits;

/// A box.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming a size that is not a length above 0.
pub fn cuboid(size_x: f64, size_y: f64, size_z: f64) -> Result<Solid> {
    pyramid_like([size_x, size_y, size_z], [size_x, size_y])
}

/// A pyramid over a rectangle, cut off where its top is `top_x` by `top_y`: an apex if both are 0, a ridge (roof) if
/// one is.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming a size that is not a length.
pub fn pyramid(size_x: f64, size_y: f64, height: f64, top_x: f64, top_y: f64) -> Result<Solid> {
    let top = [length_or_none("top_x", top_x)?, length_or_none("top_y", top_y)?];
    pyramid_like([size_x, size_y, height], top)
}

fn pyramid_like([x, y, z]: [f64; 3], [top_x, top_y]: [f64; 2]) -> Result<Solid> {
    let (x, y, z) = (0.5 * length("size_x", x)?, 0.5 * length("size_y", y)?, length("the height", z)?);
    let mut solid = Solid::default();
    let corner = |(sx, sy): (f64, f64), x: f64, y: f64, z: f64| DVec3::new(sx * x, sy * y, z);
    let round = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    solid.vertices.extend(round.map(|at| corner(at, x, y, 0.0)));
    // Coinciding corners of the top are merged.
    let mut top = [0u32; 4];
    for (k, at) in round.into_iter().enumerate() {
        let p = corner(at, 0.5 * top_x, 0.5 * top_y, z);
        let known = solid.vertices[4..].iter().position(|v| *v == p);
        top[k] = 4 + known.unwrap_or_else(|| {
            solid.vertices.push(p);
            solid.vertices.len() - 5
        }) as u32;
    }
    solid.push([3, 2, 1, 0]);
    for k in 0..4u32 {
        let next = (k + 1) % 4;
        let (a, b) = (top[k as usize], top[next as usize]);
        solid.push([k, next, b, a].into_iter().take(if a == b { 3 } else { 4 }));
    }
    if top_x > 0.0 && top_y > 0.0 {
        solid.push(top);
    }
    Ok(solid)
}

/// A ramp that rises along +x from 0 to its height.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming a size that is not a length above 0.
pub fn wedge(size_x: f64, size_y: f64, height: f64) -> Result<Solid> {
    let (x, y) = (0.5 * length("size_x", size_x)?, 0.5 * length("size_y", size_y)?);
    let outline = [DVec2::new(-x, 0.0), DVec2::new(x, 0.0), DVec2::new(x, length("the height", height)?)];
    upright(&outline, y)
}

/// Solid stairs that rise along +x from x = 0: each step is `run` deep, `rise` high and `width` wide about y = 0.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming a size that is not a length above 0, or an impossible number of steps.
pub fn stairs(steps: u32, width: f64, run: f64, rise: f64) -> Result<Solid> {
    let n = count("steps", steps, 1)?.min(limits::MAX_OUTLINE as u32);
    if n != steps || 2 * n + 2 > limits::MAX_OUTLINE as u32 {
        let most = limits::MAX_OUTLINE / 2 - 1;
        return Err(Error::invalid(format!("{steps} steps"), format!("give at most {most} in one flight")));
    }
    let (y, run, rise) = (0.5 * length("width", width)?, length("run", run)?, length("rise", rise)?);
    let at = |k: u32, l: u32| DVec2::new(f64::from(k) * run, f64::from(l) * rise);
    let mut outline = vec![at(0, 0), at(n, 0)];
    for k in (0..n).rev() {
        outline.extend([at(k + 1, k + 1), at(k, k + 1)]);
    }
    upright(&outline, y)
}

/// Extrudes an outline in x and z to both sides of y = 0.
fn upright(outline: &[DVec2], half: f64) -> Result<Solid> {
    prismatic(outline, -half, half, |p, w| DVec3::new(p.x, -w, p.y))
}

/// A flat rectangle in the plane z = 0 with its normal up, visible from both sides unless its material says otherwise.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming a size that is not a length above 0.
pub fn rectangle(size_x: f64, size_y: f64) -> Result<Solid> {
    let (x, y) = (0.5 * length("size_x", size_x)?, 0.5 * length("size_y", size_y)?);
    face(&[DVec3::new(-x, -y, 0.0), DVec3::new(x, -y, 0.0), DVec3::new(x, y, 0.0), DVec3::new(-x, y, 0.0)])
}

/// One flat convex polygon. Its normal points to the side from which its corners run counter-clockwise. The mesh checks
/// later that it is planar and convex.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] for fewer than 3 or too many corners, a corner that is not finite, or no
/// area.
pub fn face(corners: &[DVec3]) -> Result<Solid> {
    if !(3..=limits::MAX_CORNERS).contains(&corners.len()) {
        let what = format!("{} corners", corners.len());
        return Err(Error::invalid(what, format!("give 3 to {}, or several faces", limits::MAX_CORNERS)));
    }
    let far = |p: &DVec3| !(p.abs().max_element() <= limits::MAX_COORDINATE);
    if let Some(k) = corners.iter().position(far) {
        return Err(Error::invalid(format!("corner {k} is {}", corners[k]), "give finite metres"));
    }
    if plane_of_polygon(corners).is_none() {
        return Err(Error::invalid("the face has no area", "give corners that are not all in one line"));
    }
    let mut solid = Solid { vertices: corners.to_vec(), ..Solid::default() };
    solid.push(0..corners.len() as u32);
    Ok(solid)
}
