//! Calls from a script. Errors name the argument that is wrong.

use super::assembly::{Assembly, ImportedObject, Placeable};
use super::random::Random;
use super::shape::Shape;
use super::studio::Studio;
use glam::{DVec2, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use rhai::{Dynamic, Map};
use std::rc::Rc;

/// A function that scripts can call.
pub(super) struct Function {
    /// `name(parameter, parameter) -> type`, for scripts and the documentation.
    pub signature: &'static str,
    /// Its description in the documentation, one line.
    pub does: &'static str,
    /// The implementation.
    pub run: fn(&mut Call<'_, '_>) -> Result<Dynamic>,
}

impl Function {
    pub fn name(&self) -> &'static str {
        self.signature.split('(').next().unwrap_or_default()
    }

    /// The names of its parameters.
    pub fn parameters(&self) -> impl Iterator<Item = &'static str> + use<> {
        let inner = self.signature.split(['(', ')']).nth(1).unwrap_or_default();
        inner.split(", ").filter(|p| !p.is_empty())
    }
}

/// A place in a script.
#[derive(Clone, Debug, Default)]
pub(super) struct Spot {
    /// The name of the file in errors.
    pub file: Option<Rc<str>>,
    pub line: u32,
    pub column: u32,
}

impl Spot {
    /// Adds this place and the call of `function` to an error.
    pub fn place(&self, e: Error, function: &str) -> Error {
        let e = e.at(format!("line {}, column {}, in the call of {function}", self.line, self.column));
        match &self.file {
            Some(file) => e.in_file(&**file),
            None => e,
        }
    }
}

/// One call.
pub(super) struct Call<'a, 'b> {
    pub studio: &'a Studio,
    pub function: &'static Function,
    /// Place of the call.
    pub at: Spot,
    pub args: &'a mut [&'b mut Dynamic],
}

impl Call<'_, '_> {
    /// Returns argument `i`, from 0.
    pub fn arg(&self, i: usize) -> NamedValue<'_> {
        let name = self.function.parameters().nth(i).unwrap_or_default();
        NamedValue { name: name.to_owned(), value: &*self.args[i] }
    }

    /// True if argument `i` is given.
    pub fn has(&self, i: usize) -> bool {
        i < self.args.len()
    }

    pub fn number(&self, i: usize) -> Result<f64> {
        self.arg(i).number()
    }

    pub fn count(&self, i: usize) -> Result<u32> {
        self.arg(i).count()
    }

    pub fn shape(&self, i: usize) -> Result<Shape> {
        self.arg(i).shape()
    }

    /// An argument with options. Other keys than `keys` are an error.
    pub fn options(&self, i: usize, keys: &[&str]) -> Result<Options> {
        let given = self.arg(i);
        let map = given.value.as_map_ref().map_err(|_| given.wrong("an object map #{..}"))?.clone();
        match map.keys().find(|key| !keys.contains(&key.as_str())) {
            None => Ok(Options { name: given.name, map }),
            Some(key) => {
                let what = format!("{} has the unknown key {key:?}", given.name);
                Err(Error::invalid(what, format!("known keys are {}", keys.join(", "))))
            }
        }
    }
}

/// The entries of an options argument.
pub(super) struct Options {
    name: String,
    map: Map,
}

impl Options {
    pub fn none() -> Self {
        Self { name: String::new(), map: Map::new() }
    }

    /// The entry of a key, if given.
    pub fn get(&self, key: &str) -> Option<NamedValue<'_>> {
        self.map.get(key).map(|value| NamedValue { name: format!("{}.{key}", self.name), value })
    }

    /// The number of a key, if given.
    pub fn number(&self, key: &str) -> Result<Option<f64>> {
        self.get(key).map(|g| g.number()).transpose()
    }
}

/// A value with its name in errors.
pub(super) struct NamedValue<'a> {
    name: String,
    value: &'a Dynamic,
}

/// Describes a value for an error message.
fn in_words(value: &Dynamic) -> String {
    if let Ok(text) = value.as_immutable_string_ref() {
        let shown: String = text.chars().take(40).collect();
        return format!("the string {shown:?}");
    }
    if value.is_int() || value.is_float() || value.is_bool() {
        return value.to_string();
    }
    let word = match value.type_name() {
        name if name == std::any::type_name::<Shape>() => "a shape",
        name if name == std::any::type_name::<Assembly>() => "an assembly",
        name if name == std::any::type_name::<ImportedObject>() => "an imported object",
        name if name == std::any::type_name::<Pose>() => "a pose",
        name if name == std::any::type_name::<Random>() => "random numbers",
        _ if value.is_array() => "an array",
        _ if value.is_map() => "an object map",
        _ if value.is_unit() => "nothing",
        "Fn" => "a function",
        _ => "something else",
    };
    word.to_owned()
}

impl NamedValue<'_> {
    /// The error for a value of the wrong type or range.
    fn wrong(&self, needed: &str) -> Error {
        Error::invalid(format!("{} is {}", self.name, in_words(self.value)), format!("give {needed}"))
    }

    /// A finite number.
    pub fn number(&self) -> Result<f64> {
        let any = self.value.as_float().or_else(|_| self.value.as_int().map(|i| i as f64));
        any.ok().filter(|x| x.is_finite()).ok_or_else(|| self.wrong("a finite number"))
    }

    /// A number within the limits of coordinates, metres.
    pub fn coordinate(&self) -> Result<f64> {
        let within = |x: &f64| x.abs() <= limits::MAX_COORDINATE;
        let metres = self.number()?;
        Some(metres).filter(within).ok_or_else(|| self.wrong("a smaller number of metres"))
    }

    /// A whole number.
    pub fn integer(&self) -> Result<i64> {
        self.value.as_int().map_err(|_| self.wrong("a whole number"))
    }

    /// A whole number of 0 or more.
    pub fn count(&self) -> Result<u32> {
        u32::try_from(self.integer()?).map_err(|_| self.wrong("a whole number from 0 to 4294967295"))
    }

    pub fn flag(&self) -> Result<bool> {
        self.value.as_bool().map_err(|_| self.wrong("true or false"))
    }

    /// A string that is not empty.
    pub fn text(&self) -> Result<String> {
        let text = self.value.as_immutable_string_ref().map_err(|_| self.wrong("a string"))?;
        if text.is_empty() { Err(self.wrong("a string that is not empty")) } else { Ok(text.to_string()) }
    }

    /// The elements of an array.
    pub fn list<T>(&self, needed: &str, read: impl Fn(&NamedValue<'_>) -> Result<T>) -> Result<Vec<T>> {
        let array = self.value.as_array_ref().map_err(|_| self.wrong(needed))?;
        let element = |(i, value)| read(&NamedValue { name: format!("{}[{i}]", self.name), value });
        array.iter().enumerate().map(element).collect()
    }

    /// A string, or several in an array.
    pub fn texts(&self) -> Result<Vec<String>> {
        if self.value.is_array() { self.list("strings", |g| g.text()) } else { Ok(vec![self.text()?]) }
    }

    /// An array of `N` coordinates.
    pub fn numbers<const N: usize>(&self) -> Result<[f64; N]> {
        let needed = format!("an array of {N} numbers");
        let numbers = self.list(&needed, |g| g.coordinate())?;
        numbers.try_into().map_err(|_| self.wrong(&needed))
    }

    /// `[x, y, z]`.
    pub fn point(&self) -> Result<DVec3> {
        self.numbers().map(DVec3::from_array)
    }

    /// `[x, y]`.
    pub fn point2(&self) -> Result<DVec2> {
        self.numbers().map(DVec2::from_array)
    }

    /// A value of a type that presight registers.
    fn held<T: Clone + 'static>(&self, needed: &str) -> Result<T> {
        self.value.read_lock::<T>().map(|held| held.clone()).ok_or_else(|| self.wrong(needed))
    }

    pub fn shape(&self) -> Result<Shape> {
        self.held("a shape")
    }

    pub fn pose(&self) -> Result<Pose> {
        self.held("a pose, such as pose(x, y, z, yaw_deg)")
    }

    /// Anything that can be placed.
    pub fn placeable(&self) -> Result<Placeable> {
        let assembly = || self.held::<Assembly>("").map(Placeable::Assembly);
        self.held::<Shape>("")
            .map(Placeable::Shape)
            .or_else(|_| assembly())
            .map_err(|_| self.wrong("a shape or an assembly"))
    }
}

/// Reads the right operand of an operator as a point.
pub(super) fn point_of(value: &Dynamic) -> Result<DVec3> {
    NamedValue { name: "the right side".to_owned(), value }.point()
}
