//! Lines of `presight env apply`.

use super::context::Context;
use super::op::{Op, Was};
use super::unique::UniqueKeys;
use presight_model::error::{Error, Result};
use presight_model::placement;
use presight_model::printable::did_you_mean;
use presight_model::world::World;
use presight_read::text::check_json_memory;
use serde_json::Value;
use std::path::Path;

/// The change of a line, with its own reason and id.
pub(super) struct Line {
    pub cause: Option<String>,
    pub id: Option<String>,
    pub evidence: Option<String>,
    pub was: Vec<Was>,
    pub op: Op,
}

/// The suggestion for a fault of the form "unknown variant `a`, expected one of `b`, `c`".
fn alike_variant(what: &str) -> String {
    let mut quoted = what.split('`').skip(1).step_by(2);
    let word = quoted.next().filter(|_| what.starts_with("unknown variant"));
    word.map_or(String::new(), |word| did_you_mean(word, quoted))
}

impl Line {
    pub fn parse(line: &str) -> Result<Self> {
        let wrong = |e: serde_json::Error| {
            let what = e.to_string();
            let what = what.split(" at line ").next().unwrap_or(&what).to_owned();
            let alike = alike_variant(&what);
            Error::invalid(what, format!("{alike}the help of presight env apply lists the changes")).caused_by(e)
        };
        check_json_memory(line)?;
        let UniqueKeys(mut value) = serde_json::from_str(line).map_err(wrong)?;
        let mut take = |key: &str| value.as_object_mut().and_then(|o| o.remove(key));
        let cause = match take("cause") {
            None | Some(Value::Null) => None,
            Some(Value::String(cause)) => Some(cause),
            Some(_) => return Err(Error::invalid("the cause is not a string", "give the reason as a string")),
        };
        let id = match take("id") {
            None | Some(Value::Null) => None,
            Some(Value::String(id)) => Some(id),
            Some(Value::Number(id)) => Some(id.to_string()),
            Some(_) => return Err(Error::invalid("the id is neither a string nor a number", "give a string")),
        };
        let evidence = take("evidence").filter(|value| !value.is_null()).map(|value| value.to_string());
        let was = take("was").map(serde_json::from_value::<Vec<Was>>).transpose().map_err(wrong)?.unwrap_or_default();
        Ok(Self { cause, id, evidence, was, op: serde_json::from_value(value).map_err(wrong)? })
    }
}

/// Applies a line of `presight env apply` to a world in memory; files that it names are relative to `folder`. No log is
/// kept, so its cause and id have no effect. Returns notices of the scene files that it names.
///
/// ```
/// use presight::Scene;
/// use presight::store::apply_line;
/// let mut world = Scene::example()?.world;
/// let away = r#"{"op": "move", "object": "room/table", "pose": [1, 1, 0, 0, 0, 30]}"#;
/// apply_line(&mut world, away, ".".as_ref())?;
/// assert_eq!(world.version(), 2);
/// assert!(apply_line(&mut world, r#"{"op": "paint"}"#, ".".as_ref()).is_err());
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the line is not a valid change; as [`World::apply`]. The world then does
/// not change.
pub fn apply_line(world: &mut World, line: &str, folder: &Path) -> Result<Vec<String>> {
    let mut mesh = |_| Err(Error::invalid("mesh numbers are valid only in the log", "give \"like\""));
    let environment = world.environment().clone();
    let mut context = Context::new(&environment, Some(folder), &mut mesh);
    let change = context.change(Line::parse(line)?.op)?;
    let notices = std::mem::take(&mut context.notices);
    drop(context);
    // Nobody else holds this version then, and the change is made in place.
    drop(environment);
    placement::apply(world, change, true, &[])?;
    Ok(notices)
}
