//! Files: one module per format. Knows the data types and no engine.

pub mod gltf;
mod load;
pub mod materials;
pub mod sensor_toml;
pub(crate) mod text;

pub use load::{load_sensor, preset};
