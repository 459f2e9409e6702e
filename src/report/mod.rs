//! Studies: what things cost, measured, and where they stop to hold.

#[cfg(feature = "report")]
pub mod chart;
pub mod index_study;
#[cfg(feature = "report")]
pub mod page;
#[cfg(feature = "report")]
mod plot;
#[cfg(feature = "report")]
pub mod stability;
#[cfg(feature = "report")]
pub mod work_precision;
