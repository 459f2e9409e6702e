//! Self-contained HTML pages: studies, updates, and drives to browse.

mod document;
pub mod replay;
mod section;
mod strip;

#[cfg(feature = "report")]
pub(crate) use document::PALETTE;
pub use section::{Label, Part, Section, Table, page};
pub use strip::Strip;
