//! Makes hard scenes from bytes, so that a coverage-guided fuzzer can steer them.

use crate::common::hard::{Case, Shape, ShapePlacement};
use arbitrary::{Result, Unstructured};

/// Returns a scene; `None` if there are too few bytes for one.
pub fn case(bytes: &[u8]) -> Option<Case> {
    let mut u = Unstructured::new(bytes);
    if bytes.len() < 16 {
        return None;
    }
    build(&mut u).ok()
}

fn build(u: &mut Unstructured<'_>) -> Result<Case> {
    let unit = *u.choose(&[1.0, 1e-3, 1e2, 1e3])?;
    let at = *u.choose(&[[0.0; 3], [12.3, -4.5, 1.7], [5e6, -5e6, 100.0], [5e6 + 0.1, 3e6 + 0.7, 0.0]])?;
    let turn = if u.arbitrary()? { [0.0; 3] } else { triple(u, 3.0)? };
    let limits = if u.ratio(2, 5)? { Some((between(u, 0.05, 2.0)?, between(u, 3.0, 60.0)?)) } else { None };
    let fine = u.ratio(1, 8)?;
    let mut shapes = Vec::new();
    for _ in 0..u.int_in_range(1..=7)? {
        shapes.push((shape(u)?, placing(u)?));
    }
    Ok(Case { shapes, unit, at, turn, limits, fine })
}

fn shape(u: &mut Unstructured<'_>) -> Result<Shape> {
    let (at, normal) = (place(u)?, direction(u)?);
    let corners = u.int_in_range(3..=8)?;
    Ok(match u.int_in_range(0..=9)? {
        0 => Shape::Disc { at, normal, radius: length(u, 1e-4, 1e3)?, corners },
        1 => Shape::Sliver { at, along: normal, long: length(u, 1e-2, 1e2)?, aspect: length(u, 1e1, 1e6)? },
        2 => {
            let off = *u.choose(&[0.0, 1e-9, -1e-9, 1e-6, -1e-6, 1e-12, 1e-3])?;
            Shape::InPlane { normal, off, shift: between(u, 0.0, 3.0)?, radius: length(u, 1e-2, 1e2)?, corners }
        }
        3 => Shape::Touching { normal, radius: length(u, 1e-2, 1e2)?, edge: u.arbitrary()? },
        4 => Shape::Pole { height: *u.choose(&[1.0, -1.0, 20.0])?, radius: length(u, 1e-2, 1e2)?, corners },
        5 => Shape::Seam { distance: length(u, 0.1, 50.0)?, half: length(u, 0.01, 100.0)? },
        6 => {
            let (radius, half_height) = (length(u, 0.1, 50.0)?, length(u, 0.01, 20.0)?);
            Shape::Horizon { radius, half_height, quads: u.int_in_range(3..=19)? }
        }
        7 => {
            let (radius, turn, reversed) = (length(u, 1e-2, 1e2)?, u.int_in_range(0..=4)?, u.arbitrary()?);
            Shape::Twice { at, normal, radius, turn, reversed }
        }
        8 => {
            let (distance, half) = (length(u, 0.1, 50.0)?, length(u, 0.01, 100.0)?);
            Shape::Wall { distance, half, shift: *u.choose(&[0.0, 0.5, 1.0, 2.0])? }
        }
        _ => Shape::Carpet { at, normal, cell: length(u, 1e-4, 1.0)?, cells: u.int_in_range(1..=11)? },
    })
}

fn placing(u: &mut Unstructured<'_>) -> Result<ShapePlacement> {
    if u.arbitrary()? {
        return Ok(ShapePlacement { turn: [0.0; 3], scale: [1.0; 3], shear: 0.0 });
    }
    let turn = triple(u, 3.0)?;
    let mut scale = [0.0; 3];
    for s in &mut scale {
        *s = between(u, 0.1, 10.0)? * if u.arbitrary()? { 1.0 } else { -1.0 };
    }
    Ok(ShapePlacement { turn, scale, shear: between(u, -2.0, 2.0)? })
}

fn between(u: &mut Unstructured<'_>, least: f64, most: f64) -> Result<f64> {
    Ok(least + (most - least) * f64::from(u.arbitrary::<u32>()?) / f64::from(u32::MAX))
}

/// A length over several orders of magnitude.
fn length(u: &mut Unstructured<'_>, least: f64, most: f64) -> Result<f64> {
    Ok(between(u, least.ln(), most.ln())?.exp())
}

fn triple(u: &mut Unstructured<'_>, most: f64) -> Result<[f64; 3]> {
    Ok([between(u, -most, most)?, between(u, -most, most)?, between(u, -most, most)?])
}

fn direction(u: &mut Unstructured<'_>) -> Result<[f64; 3]> {
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0], [0.0, 1.0, 1.0]];
    if u.ratio(1, 3)? { Ok(*u.choose(&axes)?) } else { triple(u, 1.0) }
}

fn place(u: &mut Unstructured<'_>) -> Result<[f64; 3]> {
    let d = glam::DVec3::from(direction(u)?).try_normalize().unwrap_or(glam::DVec3::Z);
    Ok((d * length(u, 1e-3, 1e2)?).into())
}
