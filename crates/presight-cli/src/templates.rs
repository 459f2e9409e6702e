//! File names for many poses, sensors and images, such as `run/{i:06}.{output}.npy`.
//!
//! | field | meaning |
//! |---|---|
//! | `{i}` | the index of the pose from 0; `{i:06}` pads it with zeros to six digits |
//! | `{t}` | the time stamp of the pose, with the digits of its file |
//! | `{sensor}` | the name of the sensor |
//! | `{output}` | the name of the image, such as `range` |
//! | `{{`, `}}` | a brace |

use presight::tools::quoted;
use presight::{Error, Result};
use std::path::{Path, PathBuf};

/// A field of a template.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Field {
    /// `{i}`.
    Index,
    /// `{t}`.
    Stamp,
    /// `{sensor}`.
    Sensor,
    /// `{output}`.
    Output,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Part {
    Text(String),
    /// A field and its minimum number of digits.
    Field(Field, usize),
}

/// A file name with fields.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Template(Kind);

#[derive(Clone, Debug, PartialEq, Eq)]
enum Kind {
    Fields(Vec<Part>),
    Name(PathBuf),
}

/// The values of the fields for one file.
#[derive(Clone, Copy, Debug, Default)]
pub struct Names<'a> {
    /// Index of the pose, from 0.
    pub index: usize,
    /// Its time stamp as written; empty if there is none.
    pub stamp: &'a str,
    /// Name of the sensor.
    pub sensor: &'a str,
    /// Name of the image.
    pub output: &'a str,
}

const REMEDY: &str = "the fields are {i}, {i:06}, {t}, {sensor} and, for arrays, {output}; write {{ for a brace";

impl Template {
    /// A template without fields: always this file.
    pub fn literal(path: &Path) -> Self {
        Self(Kind::Name(path.to_owned()))
    }

    /// True if the name has this field.
    pub fn has(&self, field: Field) -> bool {
        let Kind::Fields(parts) = &self.0 else { return false };
        parts.iter().any(|part| matches!(part, Part::Field(f, _) if *f == field))
    }

    /// True if every pose gets its own name, provided that time stamps differ.
    pub fn tells_poses_apart(&self) -> bool {
        self.has(Field::Index) || self.has(Field::Stamp)
    }

    /// The name of one file.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] if a field is empty, or would lead into another folder.
    pub fn path(&self, names: &Names<'_>) -> Result<PathBuf> {
        let parts = match &self.0 {
            Kind::Name(path) => return Ok(path.clone()),
            Kind::Fields(parts) => parts,
        };
        let mut path = String::new();
        for part in parts {
            match part {
                Part::Text(text) => path += text,
                Part::Field(Field::Index, digits) => path += &format!("{:0digits$}", names.index),
                Part::Field(Field::Stamp, _) => path += sound("{t}", names.stamp)?,
                Part::Field(Field::Sensor, _) => path += sound("{sensor}", names.sensor)?,
                Part::Field(Field::Output, _) => path += sound("{output}", names.output)?,
            }
        }
        Ok(path.into())
    }
}

/// Checks that the value of a field can be part of a file name.
fn sound<'a>(field: &str, name: &'a str) -> Result<&'a str> {
    let strange = |c: char| c.is_control() || matches!(c, '/' | '\\');
    if name.is_empty() {
        return Err(Error::usage(format!("{field} has no value here"), "leave it out of the name"));
    }
    if name.contains(strange) || name.starts_with('.') {
        let what = format!("{field} is {}, which cannot be part of a file name", quoted(name));
        return Err(Error::usage(what, "give it another name"));
    }
    Ok(name)
}

impl std::str::FromStr for Template {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let wrong = |what: String| Error::usage(what, REMEDY);
        let (mut parts, mut plain, mut rest) = (Vec::new(), String::new(), text);
        while let Some(at) = rest.find(['{', '}']) {
            plain += &rest[..at];
            let brace = &rest[at..=at];
            rest = &rest[at + 1..];
            if let Some(after) = rest.strip_prefix(brace) {
                plain += brace;
                rest = after;
                continue;
            }
            let (inside, after) = match brace {
                "{" => rest.split_once('}').ok_or_else(|| wrong(format!("a {{ without }} in {}", quoted(text))))?,
                _ => return Err(wrong(format!("a }} without {{ in {}", quoted(text)))),
            };
            if !plain.is_empty() {
                parts.push(Part::Text(std::mem::take(&mut plain)));
            }
            let unknown = || wrong(format!("{{{inside}}} is not a valid field"));
            parts.push(field(inside).ok_or_else(unknown)?);
            rest = after;
        }
        plain += rest;
        if !plain.is_empty() {
            parts.push(Part::Text(plain));
        }
        Ok(Self(Kind::Fields(parts)))
    }
}

fn field(inside: &str) -> Option<Part> {
    /// Digits of the largest index.
    const DIGITS: usize = 20;
    let (name, digits) = match inside.split_once(':') {
        None => (inside, 0),
        Some(("i", digits)) => {
            let number = digits.strip_prefix('0').filter(|n| n.bytes().all(|b| b.is_ascii_digit()));
            ("i", number?.parse().ok().filter(|n| (1..=DIGITS).contains(n))?)
        }
        Some(_) => return None,
    };
    let field = match name {
        "i" => Field::Index,
        "t" => Field::Stamp,
        "sensor" => Field::Sensor,
        "output" => Field::Output,
        _ => return None,
    };
    Some(Part::Field(field, digits))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expand(text: &str, names: &Names<'_>) -> Result<String> {
        text.parse::<Template>()?.path(names).map(|path| path.to_str().unwrap().to_owned())
    }

    #[test]
    fn fields_are_filled_in() {
        let names = Names { index: 12, stamp: "1305031102.175304", sensor: "front", output: "depth_z" };
        for (text, path) in [
            ("a.exr", "a.exr"),
            ("d/{i}.exr", "d/12.exr"),
            ("{i:06}{i:01}.exr", "00001212.exr"),
            ("{t}/{sensor}.{output}.npy", "1305031102.175304/front.depth_z.npy"),
            ("{{i}}{i}}}", "{i}12}"),
        ] {
            assert_eq!(expand(text, &names).unwrap(), path, "{text}");
        }
        assert_eq!(Template::literal(Path::new("{i}.exr")).path(&names).unwrap(), Path::new("{i}.exr"));
    }

    #[test]
    fn a_template_knows_its_fields() {
        let template: Template = "run/{i:04}-{output}.npy".parse().unwrap();
        assert!(template.has(Field::Index) && template.has(Field::Output) && !template.has(Field::Stamp));
    }

    #[test]
    fn wrong_templates_are_wrong_usage() {
        let names = Names { index: 1, stamp: "", sensor: "a/../b", output: "..range" };
        for text in [
            "{", "}", "{i", "i}", "{}", "{j}", "{i:}", "{i:6}", "{i:06d}", "{i:0}", "{i:099}", "{t:06}", "{ i }",
            "{t}", "{sensor}", "{output}", "{i:0-1}",
        ] {
            let e = expand(text, &names).unwrap_err();
            assert_eq!(e.kind(), presight::ErrorKind::Usage, "{text}: {e}");
            assert!(!e.remedy().is_empty(), "{e}");
        }
    }
}
