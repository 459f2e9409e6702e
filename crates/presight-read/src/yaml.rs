//! YAML with a bound on its size.

use crate::text::line_of;
use presight_model::error::{Error, Result};
use serde::de::DeserializeOwned;

/// Maximum number of nodes in a file, with every use of an alias counted. A camera has under a hundred, a calibration
/// of 128 lasers 3600.
const MAX_NODES: usize = 10_000;

/// Reads YAML; an error names the line.
pub fn yaml<T: DeserializeOwned>(text: &str, remedy: &str) -> Result<T> {
    // Aliases can expand into very many nodes.
    let options = serde_saphyr::options! { budget: serde_saphyr::budget! { max_nodes: MAX_NODES } };
    serde_saphyr::from_str_with_options(text, options).map_err(|e| {
        let wrong = Error::invalid(e.without_snippet().to_string(), remedy);
        match e.location() {
            // Line 0 means unknown.
            Some(place) if place.line() > 0 => {
                wrong.at(format!("line {}", place.line().min(line_of(text, text.len()) as u64)))
            }
            _ => wrong,
        }
    })
}
