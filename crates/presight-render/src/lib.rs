//! Rasterizers: what a frame has to do, the reference, the CPU engine, and the comparison that holds engines to the
//! reference.
//!
//! Use it through the crate `presight`, which gives the same names.

pub mod cost;
pub mod cpu;
pub mod deadline;
pub mod plan;
pub mod points;
pub mod reference;
pub mod row;
pub mod verify;

pub use plan::{
    FramePlan, IdScheme, ImageRequest, Images, Omission, Output, Outputs, Raster, StageRow, Stats, Way, Work,
};
