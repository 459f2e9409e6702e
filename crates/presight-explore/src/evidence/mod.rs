//! What rays say about places on surfaces.

mod rays;

pub(crate) use rays::{Evidence, Fences, Margins, evidence, evidence_at};
