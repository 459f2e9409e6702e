//! All that is wrong with a file of settings, told at once: a mistake a run would cost as many runs.

use super::text::line_of;
use presight_model::error::{Error, Result};
use serde::de::{DeserializeOwned, IntoDeserializer};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A table of a TOML text: keys are taken from it, and what is left is unknown.
pub type Table<'t> = DeTable<'t>;

/// Mistakes, in the order in which they were found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faults(Vec<Fault>);

#[derive(Clone, Debug, PartialEq)]
struct Fault {
    place: String,
    what: String,
    remedy: String,
}

impl Faults {
    /// Notes one.
    pub fn note(&mut self, place: impl Into<String>, what: impl Into<String>, remedy: impl Into<String>) {
        self.0.push(Fault { place: place.into(), what: what.into(), remedy: remedy.into() });
    }

    /// Parses a text.
    ///
    /// # Errors
    /// All mistakes of its syntax.
    pub fn parse(text: &str) -> Result<Table<'_>> {
        let (table, wrong) = DeTable::parse_recoverable(text);
        let mut faults = Self::default();
        wrong.iter().for_each(|e| faults.note_of(text, e, 0));
        faults.check()?;
        Ok(table.into_inner())
    }

    fn note_of(&mut self, text: &str, e: &toml::de::Error, start: usize) {
        let line = line_of(text, e.span().map_or(start, |span| span.start));
        self.note(format!("line {line}"), e.message(), "correct the file; docs/formats.md describes its keys");
    }

    /// Takes a value from a table; `None`, noted, if it is of another type.
    pub fn take<T: DeserializeOwned>(&mut self, text: &str, table: &mut Table<'_>, key: &str) -> Option<T> {
        let value = table.remove(key)?;
        self.read(text, value)
    }

    /// Reads a value; `None`, noted, if it is of another type.
    pub fn read<T: DeserializeOwned>(&mut self, text: &str, value: Spanned<DeValue<'_>>) -> Option<T> {
        let start = value.span().start;
        T::deserialize(value.into_deserializer()).map_err(|e| self.note_of(text, &e, start)).ok()
    }

    /// Takes a table of tables, or nothing.
    pub fn take_table<'t>(&mut self, text: &str, table: &mut Table<'t>, key: &str) -> Table<'t> {
        table.remove(key).map(|value| self.as_table(text, value)).unwrap_or_default()
    }

    /// A value as a table; an empty one, noted, if it is none.
    pub fn as_table<'t>(&mut self, text: &str, value: Spanned<DeValue<'t>>) -> Table<'t> {
        let line = line_of(text, value.span().start);
        match value.into_inner() {
            DeValue::Table(table) => table,
            other => {
                let what = format!("a table is expected here, not a value of type {}", other.type_str());
                self.note(format!("line {line}"), what, "correct the file; docs/formats.md describes its keys");
                Table::new()
            }
        }
    }

    /// Notes all keys that were not taken.
    pub fn check_empty(&mut self, text: &str, table: Table<'_>, known: &str) {
        for key in table.into_iter().map(|(key, _)| key) {
            let line = line_of(text, key.span().start);
            self.note(format!("line {line}"), format!("unknown key {:?}", key.get_ref()), format!("known are {known}"));
        }
    }

    /// Refuses if there are mistakes.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] with all of them.
    pub fn check(&self) -> Result<()> {
        match &self.0[..] {
            [] => Ok(()),
            [one] => Err(Error::invalid(&one.what, &one.remedy).at(&one.place)),
            all => {
                let mistake = |fault: &Fault| format!("{}: {} ({})", fault.place, fault.what, fault.remedy);
                let words: Vec<String> = all.iter().map(mistake).collect();
                Err(Error::invalid(words.join("; "), "").at(format!("{} mistakes", all.len())))
            }
        }
    }
}
