//! Files: scenes, sensors, images, points, layers, logs, poses and stores. Pictures are in the crate `presight-pictures`.
#![doc = include_str!("../docs/formats.md")]

#[doc(inline)]
pub use presight_files::corridor::read as read_corridor;
#[doc(inline)]
pub use presight_files::costs::{read as read_costs, write as write_costs};
#[doc(inline)]
pub use presight_files::exr::{Attributes as ExrAttributes, read as read_exr, write as write_exr};
#[doc(inline)]
pub use presight_files::npy::{write_image as write_npy, write_rays as write_rays_npy};
#[doc(inline)]
pub use presight_files::pcd::write as write_pcd;
#[doc(inline)]
pub use presight_files::ply::write as write_ply;
#[doc(inline)]
pub use presight_model::poses::{ExternalPose, PoseFrame, PoseOf, WorldFrame};
#[doc(inline)]
pub use presight_read::camera_info::read as read_camera_info;
#[doc(inline)]
pub use presight_read::cloud::read as read_cloud;
#[doc(inline)]
pub use presight_read::gltf::{ImportOptions, import as import_gltf, import_bytes as import_gltf_bytes, write_glb};
#[doc(inline)]
pub use presight_read::layer::{read as read_layer, schema as layer_schema, write as write_layer};
#[doc(inline)]
pub use presight_read::log::lines::{header as range_log_header, line as range_log_line};
#[doc(inline)]
pub use presight_read::log::{Frames as LogFrames, LogFrame};
#[doc(inline)]
pub use presight_read::pose_covariance::parse as parse_pose_covariance;
#[doc(inline)]
pub use presight_read::preparation::{SceneFrame, Up, mesh_of_triangles};
#[doc(inline)]
pub use presight_read::sensor_toml::{read as read_sensor_toml, to_string as sensor_to_toml};
#[doc(inline)]
pub use presight_read::tum::read as read_tum;
#[doc(inline)]
pub use presight_read::{load_rectified, load_robot, load_sensor};
#[doc(inline)]
pub use presight_render::points::{PointCloud, PointsFrame};
#[cfg(feature = "store")]
#[doc(inline)]
pub use presight_store::{Existing, Note as StoreNote, Store, apply_line, create as create_store};
