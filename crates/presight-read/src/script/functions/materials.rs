//! Materials with their properties for each sensor class.

use crate::script::call::{Call, Function, NamedValue, Options};
use presight_model::environment::{Appearance, Material};
use presight_model::error::{Error, Result};
use rhai::Dynamic;

fn define(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let name = c.arg(0).text()?;
    let mut material = Material::named(&name);
    let options = match c.has(1) {
        true => c.options(1, &["reflection", "one_sided", "color", "transparent", "invisible"])?,
        false => Options::none(),
    };
    material.reflection = options.number("reflection")?.unwrap_or(material.reflection);
    if let Some(one_sided) = options.get("one_sided") {
        material.one_sided = one_sided.flag()?;
    }
    if let Some(color) = options.get("color") {
        let rgb = color.numbers::<3>()?;
        if !rgb.iter().all(|v| (0.0..=1.0).contains(v)) {
            return Err(Error::invalid(format!("color is {rgb:?}"), "give linear [red, green, blue], each 0 to 1"));
        }
        material.color = rgb.map(|v| v as f32);
    }
    for (key, appearance) in [("transparent", Appearance::Transparent), ("invisible", Appearance::Invisible)] {
        let classes = options.get(key).map(|g: NamedValue<'_>| g.texts()).transpose()?;
        for class in classes.unwrap_or_default() {
            if let Some(other) = material.appearance.insert(class.clone(), appearance)
                && other != appearance
            {
                let what = format!("the material is both transparent and invisible to {class:?}");
                return Err(Error::invalid(what, "leave one of them out"));
            }
        }
    }
    material.check()?;
    c.studio.define(material)?;
    Ok(Dynamic::from(name))
}

pub(super) const FUNCTIONS: &[Function] = &[
    Function {
        signature: "material(name) -> string",
        does: "defines an opaque material with reflection factor 1; returns its name",
        run: define,
    },
    Function {
        signature: "material(name, options) -> string",
        does: "with `reflection` (0 to 1), `one_sided` (true: visible only from outside), `color` (linear [r, g, b]), \
               `transparent` and `invisible` (a sensor class or an array of them)",
        run: define,
    },
    Function {
        signature: "made_of(shape, material) -> shape",
        does: "gives the whole shape one material; join shapes to combine several",
        run: |c| {
            let material = c.studio.material(&c.arg(1).text()?)?;
            c.shape(0)?.made_of(material, &c.studio.budget).map(Dynamic::from)
        },
    },
];
