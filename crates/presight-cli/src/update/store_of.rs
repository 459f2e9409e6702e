//! The version of the map that findings are of, and their way into the store.

use crate::print;
use presight::Scene;
use presight_model::error::Result;
use presight_model::index::IndexKind;
use presight_store as store;
use presight_store::{Note, Store};
use std::path::Path;

/// A version of a map.
pub struct Version {
    pub is_store: bool,
    /// The same for all versions of one store; the content of another scene.
    pub origin: String,
    /// Names this version: ids of changes begin with it.
    pub base: String,
}

/// The version of a map that was just opened.
///
/// # Errors
/// Errors from reading the store.
pub fn version_of(map: &Path, scene: &Scene) -> Result<Version> {
    let content = scene.world.environment().content_hash().to_string();
    if !map.extension().is_some_and(|e| e.eq_ignore_ascii_case("presight")) {
        return Ok(Version { is_store: false, base: content[..12].to_owned(), origin: content });
    }
    let info = store::info(map)?;
    Ok(Version { is_store: true, origin: info.genesis, base: info.head[..12].to_owned() })
}

/// Applies lines to the store at a time (UTC seconds), each on its own; those whose objects changed in the meantime are refused by name. Returns
/// the numbers of the lines that were applied.
///
/// # Errors
/// Errors from opening the store and from writing to it.
pub fn apply(map: &Path, lines: &[String], time: f64) -> Result<Vec<usize>> {
    let mut store = Store::open_with_index(map, &IndexKind::None)?;
    let note = Note::new("presight update", time);
    let mut batch = store.batch()?;
    let mut applied = Vec::new();
    for (number, line) in lines.iter().enumerate() {
        match batch.apply_line(line, Path::new("."), &note) {
            Ok((_, is_new)) => applied.extend(is_new.then_some(number)),
            Err(e) if batch.is_whole() => print::message(&format!("change {}: {e}", number + 1)),
            Err(e) => return Err(e),
        }
    }
    batch.commit()?;
    Ok(applied)
}
