//! Files: scenes, sensors, images, points, layers, logs, poses and stores. Pictures are in the crate `presight-pictures`.
#![doc = include_str!("../docs/formats.md")]

#[doc(inline)]
pub use presight_files::camera_info::read as read_camera_info;
#[doc(inline)]
pub use presight_files::cloud::read as read_cloud;
#[doc(inline)]
pub use presight_files::corridor::read as read_corridor;
#[doc(inline)]
pub use presight_files::costs::{read as read_costs, write as write_costs};
#[doc(inline)]
pub use presight_files::exr::{Attributes as ExrAttributes, read as read_exr, write as write_exr};
#[doc(inline)]
pub use presight_files::gltf::{ImportOptions, import as import_gltf, import_bytes as import_gltf_bytes, write_glb};
#[doc(inline)]
pub use presight_files::layer::{read as read_layer, schema as layer_schema, write as write_layer};
#[doc(inline)]
pub use presight_files::log::lines::{header as range_log_header, line as range_log_line};
#[doc(inline)]
pub use presight_files::log::{Frames as LogFrames, LogFrame};
#[doc(inline)]
pub use presight_files::npy::{write_image as write_npy, write_rays as write_rays_npy};
#[doc(inline)]
pub use presight_files::pcd::write as write_pcd;
#[doc(inline)]
pub use presight_files::ply::write as write_ply;
#[doc(inline)]
pub use presight_files::pose_covariance::parse as parse_pose_covariance;
#[doc(inline)]
pub use presight_files::preparation::{SceneFrame, Up, mesh_of_triangles};
#[doc(inline)]
pub use presight_files::sensor_toml::{read as read_sensor_toml, to_string as sensor_to_toml};
#[doc(inline)]
pub use presight_files::tum::read as read_tum;
#[doc(inline)]
pub use presight_files::{load_rectified, load_robot, load_sensor};
#[doc(inline)]
pub use presight_model::poses::{ExternalPose, PoseFrame, PoseOf, WorldFrame};
#[doc(inline)]
pub use presight_render::points::{PointCloud, PointsFrame};
#[cfg(feature = "store")]
#[doc(inline)]
pub use presight_store::{
    ChangeEvidence, Edit, EditPose, Existing, Note as StoreNote, ProposedChange, ShapeSource, Store, apply_line,
    create as create_store,
};
