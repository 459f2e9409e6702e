//! Studies that measure costs and errors, and check where error bounds stop holding.

#[cfg(feature = "report")]
pub mod chart;
pub mod comparison;
pub mod doctor;
pub mod index;
pub mod index_study;
#[cfg(feature = "report")]
mod machine;
pub mod page;
pub mod pick;
#[cfg(feature = "report")]
pub mod stability;
pub mod statistics;
#[cfg(feature = "report")]
pub mod work_precision;
pub mod worth;

#[cfg(feature = "report")]
pub use machine::Machine;

/// Quotes a CSV field if necessary (RFC 4180).
fn csv_field(text: &str) -> std::borrow::Cow<'_, str> {
    let special = text.contains([',', '"', '\n', '\r']);
    if special { format!("\"{}\"", text.replace('"', "\"\"")).into() } else { text.into() }
}

/// The median; 0 for no values.
fn median(mut values: Vec<f64>) -> f64 {
    presight_model::statistics::median(&mut values).unwrap_or(0.0)
}
