//! Predictions: the GPU engine, one call from world, sensor and pose to images and features, batches, virtual sensors.
//!
//! Use it through the crate `presight`, which gives the same names.

pub mod batch;
pub mod engine;
pub mod free_poses;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod predict;
pub mod probe;
pub mod request;
pub mod virtual_sensors;

pub use predict::{Backend, Options, Prediction, Predictor};
pub use request::Request;
