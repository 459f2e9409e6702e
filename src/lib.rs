//! presight predicts what a robot's sensors should see.
//!
//! It takes a polygonal 3D model, a sensor and a pose, and returns images: range, depth, polygon, object and incidence
//! angle of each pixel. It also predicts which features of the model are visible, and the image box that will contain
//! each.
//!
//! # A tour
//!
//! ```
//! use presight::features::{BoxOptions, FeatureOptions};
//! use presight::{Options, Predictor, Request, Scene, SensorPose};
//! # use presight::features::{GenerateOptions, generate};
//!
//! let scene = Scene::open("scenes/room.glb")?;
//! # let folder = tempfile::tempdir().unwrap();
//! # let layer = folder.path().join("room.video.layer.json");
//! # let made = generate(scene.world.environment(), "video", &GenerateOptions::default())?;
//! # presight::files::write_layer(&layer, &made.layer)?;
//! let features = scene.place_layers(&[layer], "video")?; // written by `presight features`
//! let camera = presight::preset("realsense-d435")?;
//! let pose = SensorPose::from_xyz_rpy(glam::DVec3::new(0.3, 0.35, 1.65), 0.0, 0.2, 0.66);
//! let request = Request::default()
//!     .with_features(FeatureOptions::default().with_placed(features.placed))
//!     .with_regions(BoxOptions::default().with_sensor_sigmas([0.02, 0.02, 0.0, 0.0, 0.0, 0.01]));
//! let mut predictor = Predictor::new(Options::default())?;
//! let seen = predictor.predict(&scene.world, &camera, &pose, &request)?;
//! let found = seen.features.iter().flat_map(|f| &f.features).filter(|f| f.roi.is_some()).count();
//! assert!(seen.images.range.iter().any(|r| r.is_finite()) && found > 10);
//! # Ok::<(), presight::Error>(())
//! ```
//!
//! 1. **Scene.** [`Scene::open`] reads a glTF model, a script or a stored environment. Its [`World`] is one version of
//!    an [`environment::Environment`] (objects, polygons, materials, feature layers) with its spatial index.
//!    [`World::apply`] makes the next version.
//! 2. **Sensor.** A [`Sensor`] is a [`preset`], a file ([`files::load_sensor`]), or made from a [`sensor::SensorSpec`].
//!    [`SensorPose`] is where it is, and [`RobotPose`] where its robot is; its mount leads from one to the other.
//!    [`sensor::ExternalPose`] reads poses of robots, optical frames and glTF axes as the pose of a sensor.
//! 3. **Prediction.** [`Predictor::predict`] takes world, sensor, pose and [`Request`]. Its [`Prediction`] holds the
//!    [`Images`], the visible parts of each [feature](features) and its [region of
//!    interest](features#regions-of-interest), and [`Stats`]. [`predict`] predicts at many poses and within a deadline.
//! 4. **Tasks.** [`virtual_sensors`] reduce a view, predicted or measured, to what one task needs, such as free floor.
//! 5. **Reality.** A [`measured::Frame`] holds a measurement. [`verdict`] compares it with the prediction pixel by
//!    pixel, [`localize`] computes the robot's pose, tracks it and follows features. [`simulate`]
//!    makes measurements for tests. `update` learns what differs from the model.
//! 6. **ROS 2.** `ros` turns answers, predictions and models into messages and bags.
//! 7. **Files.** [`files`] reads and writes EXR, PLY, PCD, NumPy, JSON and TOML. The crate `presight-pictures` draws
//!    PNG.
//!
//! A world can also be built in code:
//!
//! ```
//! use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
//! use presight::{Options, Pose, Predictor, Request, SensorPose, World};
//! use std::sync::Arc;
//!
//! // A wall 2 m ahead of the origin, 4 m wide and 2 m high.
//! let mut environment = Environment::new();
//! let paint = environment.add_material(Material::named("paint"))?;
//! let corners = [[2.0, -2.0, -1.0], [2.0, -2.0, 1.0], [2.0, 2.0, 1.0], [2.0, 2.0, -1.0]].map(glam::Vec3::from);
//! let face = Polygon::new(vec![0, 1, 2, 3], paint);
//! let mesh = Mesh::new("wall", corners.to_vec(), vec![face], PolygonOrder::Given)?;
//! environment.insert(NewObject::new("wall", Pose::IDENTITY, Arc::new(mesh)))?;
//!
//! let mut predictor = Predictor::new(Options::default())?;
//! let scanner = presight::preset("laser-scanner")?; // 361 beams, half a degree apart; 180 looks ahead
//! let seen = predictor.predict(&World::new(environment), &scanner, &SensorPose::IDENTITY, &Request::default())?;
//! assert_eq!(seen.images.range[180], 2.0);
//! assert_eq!(seen.images.object_id[180], 1);
//! assert_eq!(seen.images.range[0], f32::INFINITY);
//! # Ok::<(), presight::Error>(())
//! ```
//!
//! # Conventions
//!
//! Lengths are metres and angles are radians. Frames are right-handed: x forward, y left, z up. The optical frame of a
//! camera has z forward, x right, y down. `a_from_b` turns coordinates in b into coordinates in a. Every function that
//! can fail returns [`Error`], which names the file, the place in it and a remedy.
//!
//! # Cargo features
//!
//! `gpu` (the wgpu engine), `ros` (ROS 2 bags), `script` (scenes as scripts) and `store` (stored environments) are on by
//! default.
//! Everything else works without them.

pub mod environment;
#[cfg(feature = "store")]
pub mod explore;
pub mod features;
pub mod files;
pub mod localize;
pub mod measured;
pub mod predict;
pub mod query;
#[cfg(feature = "ros")]
pub mod ros;
mod scene;
pub mod sensor;
pub mod simulate;
#[cfg(feature = "store")]
pub mod store;
pub mod supervise;
pub mod tools;
#[cfg(feature = "store")]
pub mod update;
pub mod verdict;
pub mod virtual_sensors;

#[doc(inline)]
pub use presight_model::clock::set_clock;
#[doc(inline)]
pub use presight_model::geometry::{
    InObject, InRobot, InWorld, Pose, PoseCovariance, PoseEstimate, RobotPose, SensorPose, Twist,
};
#[doc(inline)]
pub use presight_model::{Change, Error, ErrorKind, Result, Sensor, Threads, World};
#[doc(inline)]
pub use presight_predict::{Backend, Options, Prediction, Predictor, Request};
#[doc(inline)]
pub use presight_read::preset;
#[doc(inline)]
pub use presight_render::{IdScheme, ImageRequest, Images, Output, Outputs, Raster, Stats, Way};
pub use scene::{Scene, SceneFeatures, SceneOptions, blake3_of};

/// The README's example is compiled and run as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
