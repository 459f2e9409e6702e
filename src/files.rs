//! Files: scenes, sensors, images, points, layers, logs, poses and stores. Pictures are in the crate
//! `presight-pictures`.
#![doc = include_str!("../docs/formats.md")]

#[doc(inline)]
pub use presight_files::corridor::read as read_corridor;
#[doc(inline)]
pub use presight_files::costs::{read as read_costs, write as write_costs};
#[doc(inline)]
pub use presight_files::exr::{Attributes as ExrAttributes, ImageFile, read as read_exr, write as write_exr};
#[doc(inline)]
pub use presight_files::npy::{image_shape as npy_shape, write_image as write_npy, write_rays as write_rays_npy};
#[doc(inline)]
pub use presight_files::npy_stack::NpyStack;
#[doc(inline)]
pub use presight_files::pcd::write as write_pcd;
#[doc(inline)]
pub use presight_files::ply::write as write_ply;
#[doc(inline)]
pub use presight_files::prediction_json::{
    Header as PredictionHeader, to_string as prediction_to_json, write as write_prediction_json,
};
#[doc(inline)]
pub use presight_read::beams::ouster::read as read_ouster;
#[doc(inline)]
pub use presight_read::beams::pattern::{RayPattern, read as read_pattern};
#[doc(inline)]
pub use presight_read::beams::velodyne::read as read_velodyne;
#[doc(inline)]
pub use presight_read::camera_info::read as read_camera_info;
#[doc(inline)]
pub use presight_read::cloud::{Cloud, PointTimes, read as read_cloud};
#[doc(inline)]
pub use presight_read::depth_folder::{DepthFolder, camera_json, image_name, poses_txt};
#[doc(inline)]
pub use presight_read::gltf::{ImportOptions, write_glb};
#[doc(inline)]
pub use presight_read::layer::{
    LayerFile, entry as layer_entry, parse as parse_layer, read as read_layer, schema as layer_schema,
    serializable as layer_fields, to_string as layer_to_string, write as write_layer,
    write_with_lost as write_layer_with_lost,
};
#[cfg(feature = "ros")]
#[doc(inline)]
pub use presight_read::log::bag::BagReport;
#[doc(inline)]
pub use presight_read::log::lines::{header as range_log_header, line as range_log_line};
#[doc(inline)]
pub use presight_read::log::{
    BagOptions, Frames as LogFrames, LogFrame, Observation, Recorded, notice_of_readings, read_frame,
};
#[doc(inline)]
pub use presight_read::pose_covariance::{file as pose_covariance_file, parse as parse_pose_covariance};
#[doc(inline)]
pub use presight_read::preparation::{
    ImportReport, Problem, ProblemKind, SceneFrame, Up, lost_features as problem_of_lost_features, mesh_of_triangles,
};
#[doc(inline)]
pub use presight_read::sensor_toml::{
    parse as parse_sensor_toml, read as read_sensor_toml, to_string as sensor_to_toml,
};
#[doc(inline)]
pub use presight_read::tum::{
    StampedPose, read as read_tum, read_with_stamps as read_tum_with_stamps, stream as stream_tum,
    stream_with_stamps as stream_tum_with_stamps,
};
#[doc(inline)]
pub use presight_read::{Robot, SensorOptions, files_named_by, load_robot, load_sensor, load_sensor_with, not_built};
