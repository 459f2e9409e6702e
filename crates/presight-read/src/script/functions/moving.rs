//! Rotating, moving, scaling and joining shapes. Shapes are immutable: each call returns another.

use crate::script::call::{Call, Function};
use crate::script::shape::Shape;
use glam::{DMat3, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::rotation_deg;
use presight_model::limits;
use rhai::Dynamic;

fn moved(c: &Call<'_, '_>, rotation: DMat3, translation: DVec3) -> Result<Dynamic> {
    c.shape(0)?.moved(rotation, translation, &c.studio.budget).map(Dynamic::from)
}

fn rotated(c: &Call<'_, '_>, roll: f64, pitch: f64, yaw: f64) -> Result<Dynamic> {
    moved(c, rotation_deg(roll, pitch, yaw), DVec3::ZERO)
}

fn scaled(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let factor = |i: usize| -> Result<f64> {
        let f = c.number(i)?;
        if (1e-9..=1e9).contains(&f.abs()) {
            return Ok(f);
        }
        let name = c.function.parameters().nth(i).unwrap_or_default();
        Err(Error::invalid(format!("{name} is {f}"), "give a factor other than 0; a negative one mirrors"))
    };
    let factors = if c.has(2) { DVec3::new(factor(1)?, factor(2)?, factor(3)?) } else { DVec3::splat(factor(1)?) };
    c.shape(0)?.scaled(factors, &c.studio.budget).map(Dynamic::from)
}

/// Three numbers as coordinates.
pub(super) fn point(c: &Call<'_, '_>, first: usize) -> Result<DVec3> {
    let at = |i: usize| c.arg(first + i).coordinate();
    Ok(DVec3::new(at(0)?, at(1)?, at(2)?))
}

fn join(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let shapes = c.arg(0).list("an array of shapes", |g| g.shape())?;
    if shapes.is_empty() {
        return Err(Error::invalid("there are no shapes to join", "give at least one shape"));
    }
    Shape::joined(&shapes, &c.studio.budget).map(Dynamic::from)
}

fn repeat(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let (shape, count) = (c.shape(0)?, c.count(1)?);
    if !(1..=limits::MAX_SCRIPT_REPEAT).contains(&count) {
        let what = format!("count is {count}");
        return Err(Error::invalid(what, format!("give 1 to {}", limits::MAX_SCRIPT_REPEAT)));
    }
    let step = point(c, 2)?;
    // Checks the limit before any copy is made.
    c.studio.budget.work(u64::from(count) * shape.polygons() as u64)?;
    let copies = (0..count).map(|k| shape.moved(DMat3::IDENTITY, step * f64::from(k), &c.studio.budget));
    Shape::joined(&copies.collect::<Result<Vec<_>>>()?, &c.studio.budget).map(Dynamic::from)
}

pub(super) const FUNCTIONS: &[Function] = &[
    Function {
        signature: "translate(shape, x, y, z) -> shape",
        does: "moves the shape",
        run: |c| moved(c, DMat3::IDENTITY, point(c, 1)?),
    },
    Function {
        signature: "rotate(shape, roll_deg, pitch_deg, yaw_deg) -> shape",
        does: "rotates about the fixed axes x, then y, then z through the origin, in degrees (REP-103)",
        run: |c| rotated(c, c.number(1)?, c.number(2)?, c.number(3)?),
    },
    Function {
        signature: "rotate_x(shape, roll_deg) -> shape",
        does: "rotates about x, in degrees",
        run: |c| rotated(c, c.number(1)?, 0.0, 0.0),
    },
    Function {
        signature: "rotate_y(shape, pitch_deg) -> shape",
        does: "rotates about y, in degrees; a positive angle turns +x downwards",
        run: |c| rotated(c, 0.0, c.number(1)?, 0.0),
    },
    Function {
        signature: "rotate_z(shape, yaw_deg) -> shape",
        does: "rotates about z, in degrees",
        run: |c| rotated(c, 0.0, 0.0, c.number(1)?),
    },
    Function {
        signature: "transform(shape, pose) -> shape",
        does: "moves the shape to a pose",
        run: |c| {
            let pose = c.arg(1).pose()?;
            moved(c, pose.rotation_matrix(), pose.translation)
        },
    },
    Function {
        signature: "scale(shape, factor) -> shape",
        does: "scales the shape; a negative factor mirrors it",
        run: scaled,
    },
    Function {
        signature: "scale(shape, factor_x, factor_y, factor_z) -> shape",
        does: "scales along each axis",
        run: scaled,
    },
    Function {
        signature: "join(shapes) -> shape",
        does: "joins an array of shapes into one; overlaps are not cut",
        run: join,
    },
    Function {
        signature: "repeat(shape, count, step_x, step_y, step_z) -> shape",
        does: "joins `count` copies into one shape, each moved by the step from the one before",
        run: repeat,
    },
];
