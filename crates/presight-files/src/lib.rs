//! Writers of predictions, one module per format, ROS 2 messages among them, and the readers of images and corridors,
//! which need the renderer's types. This crate depends on the data types, but on no engine.

pub mod corridor;
pub mod costs;
pub mod exr;
pub mod npy;
pub mod npy_stack;
pub mod pcd;
pub mod ply;
mod point_fields;
pub mod prediction_json;
#[cfg(feature = "ros")]
pub mod ros;
