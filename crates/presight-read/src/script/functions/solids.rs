//! Shapes from parameters.

use crate::preparation::primitives::{self, Solid};
use crate::script::call::{Call, Function};
use crate::script::shape::Shape;
use presight_model::error::Result;
use rhai::Dynamic;

/// Default number of facets of round shapes.
const FACETS: u32 = 24;

fn shape(c: &Call<'_, '_>, solid: Result<Solid>) -> Result<Dynamic> {
    Shape::new(solid?, &c.studio.budget).map(Dynamic::from)
}

fn facets(c: &Call<'_, '_>, i: usize) -> Result<u32> {
    if c.has(i) { c.count(i) } else { Ok(FACETS) }
}

fn pyramid(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let [x, y, z] = [c.number(0)?, c.number(1)?, c.number(2)?];
    let [top_x, top_y] = if c.has(3) { [c.number(3)?, c.number(4)?] } else { [0.0; 2] };
    shape(c, primitives::pyramid(x, y, z, top_x, top_y))
}

fn cylinder(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    shape(c, primitives::cylinder(c.number(0)?, c.number(1)?, facets(c, 2)?))
}

fn cone(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    shape(c, primitives::cone(c.number(0)?, c.number(1)?, c.number(2)?, facets(c, 3)?))
}

fn sphere(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    shape(c, primitives::sphere(c.number(0)?, facets(c, 1)?))
}

fn tube(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    shape(c, primitives::tube(c.number(0)?, c.number(1)?, c.number(2)?, facets(c, 3)?))
}

fn extrude(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let outline = c.arg(0).list("points [[x, y], ..]", |g| g.point2())?;
    // Ear clipping takes quadratic time.
    c.studio.budget.work(outline.len() as u64 * outline.len() as u64)?;
    shape(c, primitives::extrude(&outline, c.number(1)?))
}

fn face(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    shape(c, primitives::face(&c.arg(0).list("points [[x, y, z], ..]", |g| g.point())?))
}

pub(super) const FUNCTIONS: &[Function] = &[
    Function {
        signature: "box(size_x, size_y, size_z) -> shape",
        does: "a box; like all shapes it stands on z = 0 and is centred in x and y, unless stated otherwise",
        run: |c| shape(c, primitives::cuboid(c.number(0)?, c.number(1)?, c.number(2)?)),
    },
    Function {
        signature: "wedge(size_x, size_y, height) -> shape",
        does: "a ramp that rises along +x",
        run: |c| shape(c, primitives::wedge(c.number(0)?, c.number(1)?, c.number(2)?)),
    },
    Function {
        signature: "pyramid(size_x, size_y, height) -> shape",
        does: "a pyramid over a rectangle",
        run: pyramid,
    },
    Function {
        signature: "pyramid(size_x, size_y, height, top_x, top_y) -> shape",
        does: "a truncated pyramid with a top of that size; if one of top_x and top_y is 0, a roof with a ridge",
        run: pyramid,
    },
    Function {
        signature: "prism(sides, radius, height) -> shape",
        does: "a prism over a regular polygon with a corner on +x",
        run: |c| shape(c, primitives::prism(c.count(0)?, c.number(1)?, c.number(2)?)),
    },
    Function {
        signature: "cylinder(radius, height) -> shape",
        does: "an upright cylinder with 24 facets; its corners lie on the circle",
        run: cylinder,
    },
    Function { signature: "cylinder(radius, height, facets) -> shape", does: "with that many facets", run: cylinder },
    Function {
        signature: "cone(radius_bottom, radius_top, height) -> shape",
        does: "an upright cone with 24 facets; truncated if neither radius is 0",
        run: cone,
    },
    Function {
        signature: "cone(radius_bottom, radius_top, height, facets) -> shape",
        does: "with that many facets",
        run: cone,
    },
    Function { signature: "sphere(radius) -> shape", does: "a sphere about the origin, 24 facets around", run: sphere },
    Function {
        signature: "sphere(radius, facets) -> shape",
        does: "with that many facets around, and half as many from pole to pole",
        run: sphere,
    },
    Function {
        signature: "tube(radius_outer, radius_inner, height) -> shape",
        does: "an upright tube with 24 facets",
        run: tube,
    },
    Function {
        signature: "tube(radius_outer, radius_inner, height, facets) -> shape",
        does: "with that many facets",
        run: tube,
    },
    Function {
        signature: "extrude(outline, height) -> shape",
        does: "an outline [[x, y], ..], convex or concave, extruded upwards from z = 0; not centred",
        run: extrude,
    },
    Function {
        signature: "stairs(steps, width, run, rise) -> shape",
        does: "solid stairs that start at x = 0 and rise along +x; each step is `run` deep and `rise` high",
        run: |c| shape(c, primitives::stairs(c.count(0)?, c.number(1)?, c.number(2)?, c.number(3)?)),
    },
    Function {
        signature: "rectangle(size_x, size_y) -> shape",
        does: "a flat sheet at z = 0 with its normal up, for markings, signs and panes",
        run: |c| shape(c, primitives::rectangle(c.number(0)?, c.number(1)?)),
    },
    Function {
        signature: "face(corners) -> shape",
        does: "one flat convex polygon [[x, y, z], ..]; seen from its front, the corners run counter-clockwise",
        run: face,
    },
];
