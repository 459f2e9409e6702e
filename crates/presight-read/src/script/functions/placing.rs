//! Objects from shapes, assemblies of named parts, poses; checks and measures.

use super::moving::point;
use crate::script::assembly::{Assembly, Part, Placeable, check_not_empty};
use crate::script::call::{Call, Function};
use crate::text::check_name;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, quat_deg};
use rhai::{Dynamic, Map};

fn pose(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let translation = if c.has(0) { point(c, 0)? } else { DVec3::ZERO };
    let [roll, pitch, yaw] = match c.args.len() {
        0 | 3 => [0.0; 3],
        4 => [0.0, 0.0, c.number(3)?],
        _ => [c.number(3)?, c.number(4)?, c.number(5)?],
    };
    Ok(Dynamic::from(Pose { rotation: quat_deg(roll, pitch, yaw).normalize(), translation }))
}

fn name(c: &Call<'_, '_>, i: usize) -> Result<String> {
    let name = c.arg(i).text()?;
    check_name(&name).map(|()| name)
}

fn pose_or_none(c: &Call<'_, '_>, i: usize) -> Result<Pose> {
    if c.has(i) { c.arg(i).pose() } else { Ok(Pose::IDENTITY) }
}

fn place(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    c.studio.place(&name(c, 0)?, &c.arg(1).placeable()?, &pose_or_none(c, 2)?, &c.at)?;
    Ok(Dynamic::UNIT)
}

fn add(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let part = Part { name: name(c, 1)?, thing: c.arg(2).placeable()?, assembly_from_part: pose_or_none(c, 3)? };
    check_not_empty(&part.thing)?;
    if matches!(c.arg(0).placeable()?, Placeable::Shape(_)) {
        return Err(Error::invalid("assembly is a shape", "give an assembly"));
    }
    let constant = || Error::invalid("assembly is a constant and cannot change", "declare it with let");
    if c.args[0].is_read_only() {
        return Err(constant());
    }
    let mut assembly = c.args[0].write_lock::<Assembly>().ok_or_else(constant)?;
    assembly.add(part, &c.studio.budget, (&c.studio.lost, &c.at))?;
    Ok(Dynamic::UNIT)
}

fn import(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    c.studio.import(&c.arg(0).text()?).map(Dynamic::from)
}

fn require(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let message = c.arg(1).text()?;
    if c.arg(0).flag()? {
        return Ok(Dynamic::UNIT);
    }
    Err(Error::invalid(message, "the script requires this"))
}

fn bounds(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let shape = c.shape(0)?;
    // `bounds` reads every corner.
    c.studio.budget.work(shape.polygons() as u64)?;
    let bounds = shape.bounds();
    let list = |p: DVec3| Dynamic::from(p.to_array().map(Dynamic::from).to_vec());
    Ok(Dynamic::from(Map::from([("min".into(), list(bounds.min)), ("max".into(), list(bounds.max))])))
}

pub(super) const FUNCTIONS: &[Function] = &[
    Function {
        signature: "place(name, thing) -> ()",
        does: "places a shape as an object, or an assembly as one object for each part, `name/part`; the objects of a \
               shape share its mesh; a repeated name gets `#2`, for an assembly `name#2/part`",
        run: place,
    },
    Function { signature: "place(name, thing, pose) -> ()", does: "places it at a pose in the world", run: place },
    Function {
        signature: "assembly() -> assembly",
        does: "an empty assembly: add parts, then place it or add it to another",
        run: |_| Ok(Dynamic::from(Assembly::new())),
    },
    Function {
        signature: "add(assembly, name, thing) -> ()",
        does: "adds a shape or an assembly as a named part; if the assembly is in an array or a map, write \
               `a[0].add(..)`",
        run: add,
    },
    Function { signature: "add(assembly, name, thing, pose) -> ()", does: "adds it at a pose", run: add },
    Function { signature: "pose() -> pose", does: "the origin", run: pose },
    Function { signature: "pose(x, y, z) -> pose", does: "a position without rotation", run: pose },
    Function { signature: "pose(x, y, z, yaw_deg) -> pose", does: "rotated about z, in degrees", run: pose },
    Function {
        signature: "pose(x, y, z, roll_deg, pitch_deg, yaw_deg) -> pose",
        does: "rotated about the fixed axes x, then y, then z, in degrees (REP-103: positive pitch looks down)",
        run: pose,
    },
    Function {
        signature: "inverse(pose) -> pose",
        does: "the inverse pose",
        run: |c| Ok(Dynamic::from(c.arg(0).pose()?.inverse())),
    },
    Function {
        signature: "import_gltf(file) -> assembly",
        does: "the objects of a glTF file in the scene's folder, with its materials and its `.materials.toml`, z up",
        run: import,
    },
];

pub(super) const CHECKS: &[Function] = &[
    Function {
        signature: "require(condition, message) -> ()",
        does: "ends the script with the message if the condition is false",
        run: require,
    },
    Function { signature: "bounds(shape) -> map", does: "`min` and `max`, each [x, y, z]", run: bounds },
    Function {
        signature: "polygons(thing) -> int",
        does: "number of polygons of all objects that it becomes",
        run: |c| {
            let thing = c.arg(0).placeable()?;
            thing.mark_seen();
            Ok(Dynamic::from(thing.polygons() as i64))
        },
    },
];
