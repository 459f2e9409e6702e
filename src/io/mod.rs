//! Files: one module per format. Knows the data types and no engine.

pub mod gltf;
pub mod materials;
