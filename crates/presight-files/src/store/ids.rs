//! A caller's id names one change: said again after a crash it is known, and another change under it is an error.

use super::Store;
use super::context::Context;
use super::op::{InsertObject, Op, pose_fields, pose_of};
use super::rows::{from_json, json};
use super::schema::refusal;
use presight_model::change::Change;
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use presight_model::printable::quoted;
use std::sync::Arc;

/// What stands in the log under an id.
pub(super) struct RecordedChange {
    pub number: u64,
    change: String,
    request: Option<[u8; 32]>,
}

impl RecordedChange {
    /// The error of another change under the same id.
    fn taken(&self, id: &str) -> Error {
        let what = format!("id {} is that of change {}, which is another change", quoted(id), self.number);
        Error::invalid(what, "give each change an id of its own")
    }

    /// Its number, if a line says the same as the one that it was made by.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the line says something else.
    pub fn same_line(&self, id: &str, said: &Op) -> Result<u64> {
        if self.request == Some(request(said)?) {
            return Ok(self.number);
        }
        // The same in other words. Where a shape came from, only the line's own words tell; of an entry that lacks them
        // the rest must do.
        let lacks = self.request.is_none();
        let (said, logged) = (outline(said, lacks), outline(&from_json(&self.change)?, lacks));
        let told = lacks || said.iter().all(|part| !matches!(part, Part::Insert(..)));
        if told && said == logged { Ok(self.number) } else { Err(self.taken(id)) }
    }

    /// Its number, if a change is the same.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if it is another one.
    pub fn same_change(&self, id: &str, op: Option<&Op>) -> Result<u64> {
        let same = match op {
            Some(op) => json(op)? == self.change,
            // A shape that the store does not have.
            None => false,
        };
        if same { Ok(self.number) } else { Err(self.taken(id)) }
    }
}

/// The hash of what a line says, whatever the order of its keys; id and cause are no part of it.
pub(super) fn request(said: &Op) -> Result<[u8; 32]> {
    Ok(*blake3::hash(json(said)?.as_bytes()).as_bytes())
}

/// A step of a change, as far as it can be told without the environment it was made for.
#[derive(PartialEq)]
enum Part {
    /// An object's path and pose: its mesh and materials have other numbers, or words, each time.
    Insert(String, Vec<f64>),
    /// Anything else, in full.
    Step(String),
    /// What cannot be.
    Wrong,
}

/// The steps of a change, in order; `without_materials` leaves out those that the log adds to insertions.
fn outline(op: &Op, without_materials: bool) -> Vec<Part> {
    match op {
        Op::Group { changes } => {
            let own = changes.iter().filter(|op| !(without_materials && matches!(op, Op::AddMaterial(_))));
            own.flat_map(|op| outline(op, without_materials)).collect()
        }
        Op::InsertObject(new) => {
            let InsertObject { object, pose, .. } = &**new;
            let pose = pose.as_deref().map_or(Ok(Pose::IDENTITY), pose_of);
            vec![pose.map_or(Part::Wrong, |pose| Part::Insert(object.clone(), pose_fields(&pose)))]
        }
        other => vec![step(other).map_or(Part::Wrong, Part::Step)],
    }
}

/// A step in the words of the log.
fn step(op: &Op) -> Result<String> {
    let none = Arc::new(Environment::new());
    let mut no_mesh = |_| Err(Error::invalid("it has no mesh", ""));
    let mut context = Context::new(&none, None, &mut no_mesh);
    context.tolerance = Some(limits::MAX_COORDINATE);
    let change: Change = context.change(from_json(&json(op)?)?)?;
    json(&Op::of(&change, &mut |_| Ok(0))?)
}

impl Store {
    /// What stands in the log under an id.
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
