//! Studies: what things cost, measured, and where they stop to hold.

#[cfg(feature = "report")]
pub mod chart;
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

#[cfg(feature = "report")]
pub use machine::Machine;

/// A text as a field of CSV (RFC 4180): other fields and rows stay what they are whatever is in it.
fn csv_field(text: &str) -> std::borrow::Cow<'_, str> {
    let special = text.contains([',', '"', '\n', '\r']);
    if special { format!("\"{}\"", text.replace('"', "\"\"")).into() } else { text.into() }
}

/// The middle value; the mean of both of an even number, 0 of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
    0.5 * (at(n.saturating_sub(1) / 2) + at(n / 2))
}

/// The least value that so large a share of them does not exceed (nearest rank), 0 of none.
#[cfg(feature = "report")]
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil().max(1.0) as usize;
    sorted.get(rank - 1).copied().unwrap_or(0.0)
}
