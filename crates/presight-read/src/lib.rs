//! Readers of scenes, sensors, layers, logs, poses and points, one module per format; the preparation of models; and
//! the writers of models and layers. They know the data types of `presight-model` and no renderer.

pub mod atomic;
pub mod beams;
pub mod camera_info;
pub mod cloud;
pub mod depth_folder;
pub mod exr;
mod faults;
pub mod file;
pub mod gltf;
pub mod growing;
pub mod layer;
mod load;
pub mod log;
pub mod materials;
mod picture;
pub mod pose_covariance;
pub mod preparation;
pub mod robot_toml;
#[cfg(feature = "script")]
pub mod script;
pub mod sensor_toml;
pub mod temporary;
pub mod text;
pub mod tum;
mod yaml;

pub use load::{SensorOptions, files_named_by, load_sensor, load_sensor_with, preset};
pub use robot_toml::{Robot, load_robot};

use presight_model::error::{Error, ErrorKind};

/// The error of a build without a cargo feature.
pub fn not_built(what: &str, feature: &str) -> Error {
    let what = format!("this presight was built without {what}");
    Error::new(ErrorKind::Unsupported, what, format!("build it with the cargo feature `{feature}`"))
}
