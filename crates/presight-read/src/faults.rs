//! Collects all mistakes in a settings file, so that one run reports them all.

use super::text::line_of;
use presight_model::error::{Error, Result};
use serde::de::{DeserializeOwned, IntoDeserializer};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A table of a TOML text. Known keys are taken from it; the keys left over are unknown.
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
    /// Notes a mistake.
    pub fn note(&mut self, place: impl Into<String>, what: impl Into<String>, remedy: impl Into<String>) {
        self.0.push(Fault { place: place.into(), what: what.into(), remedy: remedy.into() });
    }

    /// Parses a text.
    ///
    /// # Errors
    /// All syntax errors.
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

    /// Takes a value from a table. A value of another type is noted as a mistake and gives `None`.
    pub fn take<T: DeserializeOwned>(&mut self, text: &str, table: &mut Table<'_>, key: &str) -> Option<T> {
        let value = table.remove(key)?;
        self.read(text, value)
    }

    /// Reads a value. A value of another type is noted as a mistake and gives `None`.
    pub fn read<T: DeserializeOwned>(&mut self, text: &str, value: Spanned<DeValue<'_>>) -> Option<T> {
        let start = value.span().start;
        T::deserialize(value.into_deserializer()).map_err(|e| self.note_of(text, &e, start)).ok()
    }

    /// Takes a table of tables; a missing one is empty.
    pub fn take_table<'t>(&mut self, text: &str, table: &mut Table<'t>, key: &str) -> Table<'t> {
        table.remove(key).map(|value| self.as_table(text, value)).unwrap_or_default()
    }

    /// Returns a value as a table. Any other value is noted as a mistake and gives an empty table.
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
            self.note(format!("line {line}"), format!("unknown key {:?}", key.get_ref()), format!("known: {known}"));
        }
    }

    /// Fails if there are mistakes.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] listing all of them.
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
