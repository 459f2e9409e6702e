//! Writers of predictions, one module per format, and the readers of images and corridors, which need the renderer's
//! types. This crate depends on the data types, but on no engine.

pub mod corridor;
pub mod costs;
pub mod exr;
pub mod npy;
pub mod npy_stack;
pub mod pcd;
pub mod ply;
mod point_fields;
pub mod prediction_json;

// Until all call sites name presight-read.
#[doc(hidden)]
pub use presight_read::{
    Robot, atomic, camera_info, cloud, depth_folder, file, files_named_by, gltf, growing, layer, load_rectified,
    load_robot, load_sensor, log, materials, not_built, pose_covariance, preparation, preset, robot_toml, sensor_toml,
    temporary, text, tum,
};
