//! The functions that scripts can call, in one table, which scenes/README.md lists.

mod landmarks;
mod materials;
mod math;
mod moving;
mod placing;
mod solids;

use super::assembly::Assembly;
use super::call::{Call, Function, Spot};
use super::fault::Fault;
use super::random::Random;
use super::shape::Shape;
use super::studio::Studio;
use presight_model::clock::Instant;
use presight_model::geometry::Pose;
use rhai::{Dynamic, Engine, EvalAltResult, NativeCallContext};
use std::any::TypeId;
use std::rc::Rc;

/// A heading and its part of the table.
type Section = (&'static str, &'static [Function]);

/// All functions.
const SECTIONS: [Section; 7] = [
    ("Shapes", solids::FUNCTIONS),
    ("Changing shapes", moving::FUNCTIONS),
    ("Materials", materials::FUNCTIONS),
    ("Placing", placing::FUNCTIONS),
    ("Features and landmarks", landmarks::FUNCTIONS),
    ("Checks and measures", placing::CHECKS),
    ("Numbers", math::FUNCTIONS),
];

/// Operators on our types.
const OPERATORS: [(&str, &str); 3] = [
    ("shape + shape", "joins two shapes"),
    ("pose * pose", "composes two poses; the second is given in the frame of the first"),
    ("pose * point", "transforms a point [x, y, z] from the pose's frame to its parent frame"),
];

/// The table as Markdown. A test compares it with scenes/README.md.
pub fn reference() -> String {
    let mut text = String::new();
    for (heading, functions) in SECTIONS {
        text += &format!("### {heading}\n\n| call | what it does |\n|---|---|\n");
        for f in functions {
            text += &format!("| `{}` | {} |\n", f.signature, f.does);
        }
        text += "\n";
    }
    text += "### Operators\n\n| operator | what it does |\n|---|---|\n";
    for (operator, does) in OPERATORS {
        text += &format!("| `{operator}` | {does} |\n");
    }
    text
}

/// The signatures of all functions with this name.
pub(super) fn signatures(name: &str) -> Vec<&'static str> {
    let all = SECTIONS.into_iter().flat_map(|(_, functions)| functions);
    all.filter(|f| f.name() == name).map(|f| f.signature).collect()
}

/// The place of a call.
fn spot(context: &NativeCallContext<'_>, studio: &Studio) -> Spot {
    let at = context.call_position();
    let number = |n: Option<usize>| n.and_then(|n| u32::try_from(n).ok()).unwrap_or(0);
    let file = context.call_source().map(|file| studio.file_name(file));
    Spot { file, line: number(at.line()), column: number(at.position()) }
}

/// Registers the functions with an engine.
pub(super) fn register(engine: &mut Engine, studio: &Rc<Studio>) {
    engine
        .register_type_with_name::<Shape>("shape")
        .register_type_with_name::<Assembly>("assembly")
        .register_type_with_name::<Pose>("pose")
        .register_type_with_name::<Random>("rng");
    for function in SECTIONS.into_iter().flat_map(|(_, functions)| functions) {
        let studio = studio.clone();
        let types = vec![TypeId::of::<Dynamic>(); function.parameters().count()];
        engine.register_raw_fn(
            function.name(),
            types,
            move |context: NativeCallContext<'_>, args: &mut [&mut Dynamic]| -> Result<Dynamic, Box<EvalAltResult>> {
                let mut call = Call { studio: &studio, function, at: spot(&context, &studio), args };
                let start = Instant::now();
                let done = (function.run)(&mut call);
                studio.busy.set(studio.busy.get() + start.elapsed());
                done.map_err(|e| Fault::in_call(e, function, context.call_position()))
            },
        );
    }
    let budget = studio.budget.clone();
    engine.register_fn("+", move |a: Shape, b: Shape| -> Result<Shape, Box<EvalAltResult>> {
        Shape::joined(&[a, b], &budget).map_err(Fault::bare)
    });
    engine.register_fn("*", |a: Pose, b: Pose| a * b);
    engine.register_fn("*", |a: Pose, p: rhai::Array| -> Result<rhai::Array, Box<EvalAltResult>> {
        let p = super::call::point_of(&Dynamic::from(p)).map_err(Fault::bare)?;
        Ok(a.transform_point(p).to_array().map(Dynamic::from).to_vec())
    });
}
