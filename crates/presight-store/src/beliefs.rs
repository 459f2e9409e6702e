//! Rows of marks and of the trust in objects, which exist from format 5 on.

use super::Store;
use super::hash::{Field, Hash, of_row};
use super::op::{MarkFields, TrustFields};
use super::read::{Reader, get};
use super::rows::{from_json, json};
use super::schema::{FORMAT, damaged, refusal, upgrade};
use presight_model::environment::Environment;
use presight_model::error::Result;
use rusqlite::params;

/// The hash of a row: its key and its JSON text.
fn hash_of(table: &str, key: &str, text: &str) -> Hash {
    of_row(table.as_bytes(), &[Field::Text(key), Field::Text(text)])
}

impl Reader<'_> {
    /// Reads marks and trust into an environment that has all objects.
    pub fn beliefs(&self, environment: &mut Environment) -> Result<()> {
        self.each("marks", "name, mark, hash", |row| {
            let (name, text): (String, String) = (get(row, 0)?, get(row, 1)?);
            self.prove(hash_of("marks", &name, &text), get(row, 2)?)?;
            let before = environment.set_mark(&name, from_json::<MarkFields>(&text)?.mark()?)?;
            before.map_or(Ok(()), |_| Err(damaged("two marks have one name")))
        })?;
        self.each("trust", "object, trust, hash", |row| {
            let (object, text): (String, String) = (get(row, 0)?, get(row, 1)?);
            self.prove(hash_of("trust", &object, &text), get(row, 2)?)?;
            environment.set_trust(&object, Some(from_json::<TrustFields>(&text)?.existence())).map(drop)
        })
    }
}

impl Store {
    /// Gives a store of an older format the tables and columns of the newest, in the open transaction.
    pub(super) fn upgrade(&mut self) -> Result<()> {
        if self.format < FORMAT {
            upgrade(&self.connection).map_err(|e| refusal(&self.path, "write to the store", e))?;
            self.format = FORMAT;
        }
        Ok(())
    }

    pub(super) fn write_mark(&mut self, now: &Environment, name: &str) -> Result<()> {
        self.remove("DELETE FROM marks WHERE name = ?1 RETURNING hash", params![name])?;
        let Some(mark) = now.mark(name) else { return Ok(()) };
        let text = json(&MarkFields::of(mark))?;
        let hash = hash_of("marks", name, &text);
        self.run("INSERT INTO marks VALUES(?1, ?2, ?3)", params![name, text, hash])?;
        self.meta.digest.add(&hash);
        Ok(())
    }

    pub(super) fn write_trust(&mut self, now: &Environment, object: &str) -> Result<()> {
        self.remove("DELETE FROM trust WHERE object = ?1 RETURNING hash", params![object])?;
        let Some(trust) = now.trust(object) else { return Ok(()) };
        let text = json(&TrustFields::of(trust))?;
        let hash = hash_of("trust", object, &text);
        self.run("INSERT INTO trust VALUES(?1, ?2, ?3)", params![object, text, hash])?;
        self.meta.digest.add(&hash);
        Ok(())
    }
}
