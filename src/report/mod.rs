//! Studies: what things cost, measured.

pub mod index_study;
#[cfg(feature = "report")]
mod plot;
