//! A caller's id names one change. The store recognizes the change if repeated, and refuses others with its id.

use super::Store;
use super::context::Context;
use super::op::{InsertObject, Op, pose_fields};
use super::rows::{from_json, json};
use super::schema::refusal;
use presight_model::change::Change;
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use presight_model::printable::quoted;
use std::sync::Arc;

/// The log entry with an id.
pub(super) struct RecordedChange {
    pub number: u64,
    change: String,
    request: Option<[u8; 32]>,
}

impl RecordedChange {
    /// The error for another change with the same id.
    fn taken(&self, id: &str) -> Error {
        let what = format!("id {} belongs to change {}, which is different", quoted(id), self.number);
        Error::invalid(what, "give each change a different id")
    }

    /// Returns the entry's number if a line describes the same change.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the line describes another change.
    pub fn same_line(&self, id: &str, said: &Op) -> Result<u64> {
        if self.request == Some(request(said)?) {
            return Ok(self.number);
        }
        // The line may describe the same change differently. Only the request hash covers the source of a shape, so
        // lines that insert objects must match it, unless the entry has none; then paths and poses must suffice.
        let lacks = self.request.is_none();
        let (said, logged) = (outline(said, lacks), outline(&from_json(&self.change)?, lacks));
        let told = lacks || said.iter().all(|part| !matches!(part, Part::Insert(..)));
        if told && said == logged { Ok(self.number) } else { Err(self.taken(id)) }
    }

    /// Returns the entry's number if `op` is the same change.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if it is another change.
    pub fn same_change(&self, id: &str, op: Option<&Op>) -> Result<u64> {
        let same = match op {
            Some(op) => json(op)? == self.change,
            // The change inserts a shape that is not stored.
            None => false,
        };
        if same { Ok(self.number) } else { Err(self.taken(id)) }
    }
}

/// The hash of a line's operation. It does not depend on the order of keys, the id or the cause.
pub(super) fn request(said: &Op) -> Result<[u8; 32]> {
    Ok(*blake3::hash(json(said)?.as_bytes()).as_bytes())
}

/// A step of a change, without the details that depend on the environment.
#[derive(PartialEq)]
enum Part {
    /// An object's path and pose. Its mesh and materials may be given by other numbers or words each time.
    Insert(String, Vec<f64>),
    /// Any other step, complete, as JSON.
    Step(String),
    /// An invalid step.
    Wrong,
}

/// The steps of a change, in order. `without_materials` omits the material steps that the log adds to insertions.
fn outline(op: &Op, without_materials: bool) -> Vec<Part> {
    match op {
        Op::Group { changes } => {
            let own = changes.iter().filter(|op| !(without_materials && matches!(op, Op::AddMaterial(_))));
            own.flat_map(|op| outline(op, without_materials)).collect()
        }
        Op::InsertObject(new) => {
            let InsertObject { object, pose, .. } = &**new;
            let pose = pose.as_deref().map_or(Ok(Pose::IDENTITY), Pose::of_numbers);
            vec![pose.map_or(Part::Wrong, |pose| Part::Insert(object.clone(), pose_fields(&pose)))]
        }
        other => vec![step(other).map_or(Part::Wrong, Part::Step)],
    }
}

/// Converts a step to the form that the log uses.
fn step(op: &Op) -> Result<String> {
    let none = Arc::new(Environment::new());
    let mut no_mesh = |_| Err(Error::invalid("it has no mesh", ""));
    let mut context = Context::new(&none, None, &mut no_mesh);
    context.tolerance = Some(limits::MAX_COORDINATE);
    let change: Change = context.change(from_json(&json(op)?)?)?;
    json(&Op::of(&change, &mut |_| Ok(0))?)
}

impl Store {
    /// Returns the log entry with an id.
    pub(super) fn known(&self, id: &str) -> Result<Option<RecordedChange>> {
        let Some(number) = self.ids.get(id).copied() else { return Ok(None) };
        let columns = |row: &rusqlite::Row<'_>| Ok((row.get(0)?, row.get(1)?));
        let found = self
            .connection
            .prepare_cached("SELECT change, request FROM log WHERE number = ?1")
            .and_then(|mut statement| statement.query_row([number as i64], columns));
        let (change, request) = found.map_err(|e| refusal(&self.path, "read the log", e))?;
        Ok(Some(RecordedChange { number, change, request }))
    }
}
