//! Studies that measure costs and errors, and check where error bounds stop holding.

#[cfg(feature = "report")]
pub mod chart;
pub mod index;
pub mod index_study;
#[cfg(feature = "report")]
mod machine;
#[cfg(feature = "report")]
pub mod page;
#[cfg(feature = "report")]
pub mod replay;
#[cfg(feature = "report")]
pub mod stability;
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

/// The median; for an even count the mean of the two middle values, for no values 0.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
    0.5 * (at(n.saturating_sub(1) / 2) + at(n / 2))
}

/// The quantile by nearest rank; 0 for no values.
#[cfg(feature = "report")]
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil().max(1.0) as usize;
    sorted.get(rank - 1).copied().unwrap_or(0.0)
}
