//! Files: one module per format. Knows the data types and no engine.

mod load;
pub mod sensor_toml;
pub(crate) mod text;

pub use load::{load_sensor, preset};
