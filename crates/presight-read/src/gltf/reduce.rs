//! Reduces the JSON text of a scene to the properties that presight uses, before the crate `gltf` parses it. That crate
//! requires more than the schema does: properties of animations, cameras and textures, and whole numbers written
//! without a fraction. Here the rest of a file is skipped, 4.0 becomes 4, and defaults are filled in.

use super::schema::{Kind, Presence, Property, ROOT};
use presight_model::error::{Error, Result};
use serde::de::{DeserializeSeed, Deserializer, Error as _, IgnoredAny, MapAccess, SeqAccess, Unexpected, Visitor};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use std::fmt;

/// Maximum whole number up to which f64 represents every whole number.
const LARGEST_WHOLE: f64 = 9_007_199_254_740_992.0;

/// Returns the JSON text of the properties that presight uses.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] with JSON path and line for text that is not JSON, and for a property that is
/// missing, repeated or of a wrong type.
pub(super) fn reduced(text: &[u8]) -> Result<Vec<u8>> {
    let mut to = Output::default();
    let mut from = serde_json::Deserializer::from_slice(text);
    let root = Path { above: None, step: Step::Root };
    let done = Seed { kind: &ROOT, path: &root, to: &mut to }.deserialize(&mut from).and_then(|_| from.end());
    match done {
        Ok(()) => Ok(to.text),
        Err(e) => Err(error(&e, to.fault.as_deref().unwrap_or_default())),
    }
}

fn error(e: &serde_json::Error, path: &str) -> Error {
    let whole = e.to_string();
    // The place already names the line.
    let what = whole.rsplit_once(" at line ").map_or(whole.as_str(), |(what, _)| what).to_owned();
    let remedy = if e.is_eof() { "the file is truncated; export it again" } else { "export it again as glTF 2.0" };
    let place = format!("JSON line {}, column {}", e.line(), e.column());
    let error = Error::invalid(what, remedy).at(place);
    if path.is_empty() { error } else { error.at(path) }
}

#[derive(Default)]
struct Output {
    text: Vec<u8>,
    /// The innermost place of an error, a JSON pointer.
    fault: Option<String>,
}

impl Output {
    /// Writes a number, a text or a flag.
    fn write<E: serde::de::Error>(&mut self, value: impl Serialize) -> Result<bool, E> {
        serde_json::to_writer(&mut self.text, &value).map_err(E::custom)?;
        Ok(true)
    }

    /// Writes the name of a property.
    fn name<E: serde::de::Error>(&mut self, name: &str) -> Result<(), E> {
        if self.text.last() != Some(&b'{') {
            self.text.push(b',');
        }
        self.write(name)?;
        self.text.push(b':');
        Ok(())
    }
}

/// A place in the JSON text.
#[derive(Clone, Copy)]
struct Path<'a> {
    above: Option<&'a Path<'a>>,
    step: Step<'a>,
}

#[derive(Clone, Copy)]
enum Step<'a> {
    Root,
    Name(&'a str),
    Number(usize),
}

impl fmt::Display for Path<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.above.map_or(Ok(()), |above| above.fmt(f))?;
        match self.step {
            Step::Root => Ok(()),
            Step::Name(name) => write!(f, "/{name}"),
            Step::Number(number) => write!(f, "/{number}"),
        }
    }
}

/// Copies one value; returns false for null in place of an optional one.
struct Seed<'a> {
    kind: &'static Kind,
    path: &'a Path<'a>,
    to: &'a mut Output,
}

impl<'de> DeserializeSeed<'de> for Seed<'_> {
    type Value = bool;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<bool, D::Error> {
        let Self { kind, path, to } = self;
        let done = match kind {
            Kind::Raw => <&RawValue>::deserialize(from).map(|raw| {
                to.text.extend_from_slice(raw.get().as_bytes());
                true
            }),
            _ => from.deserialize_any(Visit { kind, path, to }),
        };
        if done.is_err() {
            to.fault.get_or_insert_with(|| path.to_string());
        }
        done
    }
}

struct Visit<'a> {
    kind: &'static Kind,
    path: &'a Path<'a>,
    to: &'a mut Output,
}

impl<'de> Visitor<'de> for Visit<'_> {
    type Value = bool;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind {
            Kind::Index | Kind::Count => f.write_str("a whole number"),
            Kind::Number => f.write_str("a number"),
            Kind::Text => f.write_str("a string"),
            Kind::Flag => f.write_str("true or false"),
            Kind::Numbers(count) => write!(f, "{count} numbers"),
            Kind::List(_) => f.write_str("a list"),
            Kind::Raw | Kind::Map(_) | Kind::Object(_) | Kind::Extensions(_) => f.write_str("an object"),
        }
    }

    fn visit_unit<E: serde::de::Error>(self) -> Result<bool, E> {
        match self.kind {
            Kind::List(_) | Kind::Map(_) | Kind::Object(_) | Kind::Extensions(_) => {
                Err(E::invalid_type(Unexpected::Unit, &self))
            }
            _ => Ok(false),
        }
    }

    fn visit_bool<E: serde::de::Error>(self, value: bool) -> Result<bool, E> {
        match self.kind {
            Kind::Flag => self.to.write(value),
            _ => Err(E::invalid_type(Unexpected::Bool(value), &self)),
        }
    }

    fn visit_str<E: serde::de::Error>(self, value: &str) -> Result<bool, E> {
        match self.kind {
            Kind::Text => self.to.write(value),
            _ => Err(E::invalid_type(Unexpected::Str(value), &self)),
        }
    }

    fn visit_u64<E: serde::de::Error>(self, value: u64) -> Result<bool, E> {
        match self.kind {
            Kind::Index if value > u64::from(u32::MAX) => Err(E::custom(format!("{value} is too large"))),
            Kind::Index | Kind::Count | Kind::Number => self.to.write(value),
            _ => Err(E::invalid_type(Unexpected::Unsigned(value), &self)),
        }
    }

    fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<bool, E> {
        match self.kind {
            Kind::Number => self.to.write(value),
            Kind::Index | Kind::Count => Err(E::custom(format!("{value} is below 0"))),
            _ => Err(E::invalid_type(Unexpected::Signed(value), &self)),
        }
    }

    fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<bool, E> {
        match self.kind {
            Kind::Number => self.to.write(value),
            Kind::Index | Kind::Count if value.fract() == 0.0 && (0.0..=LARGEST_WHOLE).contains(&value) => {
                self.visit_u64(value as u64)
            }
            _ => Err(E::invalid_type(Unexpected::Float(value), &self)),
        }
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut from: A) -> Result<bool, A::Error> {
        let kind = match self.kind {
            Kind::Numbers(_) => &Kind::Number,
            Kind::List(kind) => kind,
            _ => return Err(A::Error::invalid_type(Unexpected::Seq, &self)),
        };
        self.to.text.push(b'[');
        let mut count = 0;
        loop {
            let end = self.to.text.len();
            if count > 0 {
                self.to.text.push(b',');
            }
            let path = Path { above: Some(self.path), step: Step::Number(count) };
            match from.next_element_seed(Seed { kind, path: &path, to: self.to })? {
                None => {
                    self.to.text.truncate(end);
                    break;
                }
                Some(true) => count += 1,
                Some(false) => {
                    self.to.fault = Some(path.to_string());
                    return Err(A::Error::custom("null is not an entry of a list"));
                }
            }
        }
        match self.kind {
            Kind::Numbers(wanted) if *wanted != count => Err(A::Error::invalid_length(count, &self)),
            _ => {
                self.to.text.push(b']');
                Ok(true)
            }
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut from: A) -> Result<bool, A::Error> {
        let (properties, any): (&[Property], _) = match self.kind {
            Kind::Object(properties) => (properties, None),
            Kind::Extensions(properties) => (properties, None),
            Kind::Map(kind) => (&[], Some(*kind)),
            _ => return Err(A::Error::invalid_type(Unexpected::Map, &self)),
        };
        self.to.text.push(b'{');
        // No object has as many as 64 properties here.
        let mut seen = 0u64;
        while let Some(name) = from.next_key::<String>()? {
            let known = properties.iter().position(|p| p.name == name);
            let Some(kind) = known.map(|i| &properties[i].kind).or(any) else {
                from.next_value::<IgnoredAny>()?;
                if matches!(self.kind, Kind::Extensions(_)) {
                    self.to.name(&name)?;
                    self.to.text.extend_from_slice(b"null");
                }
                continue;
            };
            let path = Path { above: Some(self.path), step: Step::Name(&name) };
            let end = self.to.text.len();
            self.to.name(&name)?;
            if !from.next_value_seed(Seed { kind, path: &path, to: self.to })? {
                self.to.text.truncate(end);
            } else if let Some(bit) = known.map(|i| 1 << i) {
                if seen & bit != 0 {
                    return Err(A::Error::custom(format!("it has {name:?} twice")));
                }
                seen |= bit;
            }
        }
        for (i, property) in properties.iter().enumerate().filter(|(i, _)| seen & (1 << i) == 0) {
            debug_assert!(i < 64);
            match property.presence {
                Presence::Optional => {}
                Presence::Required => return Err(A::Error::custom(format!("{:?} is missing", property.name))),
                Presence::Default(value) => {
                    self.to.name(property.name)?;
                    self.to.text.extend_from_slice(value.as_bytes());
                }
            }
        }
        self.to.text.push(b'}');
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_reduced_to_the_properties_in_use() {
        let text = r#"{"asset": {"generator": 5, "version": "2.0"}, "cameras": [{}], "extensions": {"ABC": [1]},
            "scene": 0.0, "scenes": [{"name": "a"}, {"nodes": [1e0, 2]}], "buffers": [{"byteLength": 4.0, "uri": null}],
            "nodes": [{"matrix": null, "extras": [1.50, {"a": 1, "a": 2}], "translation": [1, 2.5, -3]}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 3.0}, "mode": 4.0}]}]}"#;
        let found = String::from_utf8(reduced(text.as_bytes()).unwrap()).unwrap();
        let expected =
            r#"{"asset":{"version":"2.0"},"extensions":{"ABC":null},"scene":0,"scenes":[{"nodes":[]},{"nodes":[1,2]}],"#
                .to_owned()
                + r#""buffers":[{"byteLength":4}],"nodes":[{"extras":[1.50, {"a": 1, "a": 2}],"#
                + r#""translation":[1,2.5,-3]}],"meshes":[{"primitives":[{"attributes":{"POSITION":3},"mode":4}]}]}"#;
        assert_eq!(found, expected);
    }

    #[test]
    fn faults_name_their_path_and_line() {
        for (text, path, what) in [
            (r#""scenes": [{"nodes": [0, 0.5]}]"#, "/scenes/0/nodes/1", "invalid type: floating point `0.5`"),
            (r#""scenes": [{"nodes": [null]}]"#, "/scenes/0/nodes/0", "null is not an entry of a list"),
            (r#""scenes": [{"nodes": null}]"#, "/scenes/0/nodes", "invalid type: null, expected a list"),
            (r#""scene": -1"#, "/scene", "-1 is below 0"),
            (r#""scene": 4294967296"#, "/scene", "4294967296 is too large"),
            (r#""buffers": [{"byteLength": 1e30}]"#, "/buffers/0/byteLength", "expected a whole number"),
            (r#""buffers": [{"byteLength": "4"}]"#, "/buffers/0/byteLength", "invalid type: string \"4\""),
            (r#""buffers": [{"byteLength": 4}, {"uri": ""}]"#, "/buffers/1", "\"byteLength\" is missing"),
            (r#""buffers": [{"byteLength": 4, "byteLength": 5}]"#, "/buffers/0", "it has \"byteLength\" twice"),
            (r#""nodes": [{"scale": [1, 2]}]"#, "/nodes/0/scale", "invalid length 2, expected 3 numbers"),
            (r#""nodes": [{"name": 5}]"#, "/nodes/0/name", "expected a string"),
            (r#""nodes": [{"children": {}}]"#, "/nodes/0/children", "invalid type: map, expected a list"),
            (r#""nodes": 3"#, "/nodes", "invalid type: integer `3`, expected a list"),
        ] {
            let text = format!(r#"{{"asset": {{"version": "2.0"}}, {text}}}"#);
            let e = reduced(text.as_bytes()).unwrap_err();
            let said = e.to_string();
            assert!(said.starts_with(&format!("{path}: JSON line 1, column ")), "{text}: {said}");
            assert!(said.contains(what) && !e.remedy().is_empty(), "{text}: {said}");
        }
        let cut = reduced(br#"{"asset": {"version": "2.0"}, "nodes": ["#).unwrap_err();
        assert!(cut.remedy().contains("truncated"), "{cut}");
    }
}
