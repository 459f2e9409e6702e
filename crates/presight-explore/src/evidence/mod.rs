//! Evidence of rays for and against surfaces.

mod rays;

pub(crate) use rays::{Evidence, Fences, Margins, evidence, evidence_at};
