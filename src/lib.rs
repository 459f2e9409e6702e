//! presight predicts what a robot's sensors should see.
//!
//! It takes a polygonal 3D model, a sensor and a pose, and returns images: range, depth, which polygon and object each
//! pixel sees, and at which angle. It also predicts which features of the model are visible, and in which image box each
//! will be found.
//!
//! # A tour
//!
//! 1. **Model.** An [`Environment`] holds objects, polygons, materials and feature layers. It comes from a glTF file
//!    ([`io::gltf::import`]), a script, a store, or from objects that you insert. A [`World`] is one version of it with its
//!    spatial index; [`World::apply`] makes the next version.
//! 2. **Sensor.** A [`Sensor`] is a [`preset`], a file ([`io::load_sensor`]), or made from a [`SensorSpec`].
//! 3. **Prediction.** [`Predictor::predict`] takes world, sensor, [`Pose`] and [`Request`], and returns a [`Prediction`] with
//!    [`Images`] and [`Stats`].
//! 4. **Features.** [`Predictor::predict_features`] says what is visible of each feature, and [`Predictor::add_boxes`] adds
//!    its region of interest ([`features`]).
//! 5. **Tasks.** [`virtual_sensors`] reduce a prediction to what one task wants to know, such as free floor.
//! 6. **Files.** [`io`] has one module per format: EXR, PNG, PLY, PCD, JSON, TOML.
//!
//! ```text
//! Environment -> World -+
//! Sensor, Pose, Request-+-> FramePlan -> cpu | gpu -> Prediction { images, stats } -> io::exr, png, ply, pcd
//! ```
//!
//! ```
//! use presight::{Environment, Material, Mesh, NewObject, Options, Polygon, PolygonOrder};
//! use presight::{Pose, Predictor, Request, World};
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
//! let seen = predictor.predict(&World::new(environment), &scanner, &Pose::IDENTITY, &Request::default())?;
//! assert_eq!(seen.images.range[180], 2.0);
//! assert_eq!(seen.images.object_id[180], 1);
//! assert_eq!(seen.images.range[0], f32::INFINITY);
//! # Ok::<(), presight::Error>(())
//! ```
//!
//! # Conventions
//!
//! Lengths are metres and angles are radians. Frames are right-handed: x forward, y left, z up. The optical frame of a
//! camera has z forward, x right, y down. `a_from_b` turns coordinates in b into coordinates in a. Every function that can
//! fail returns [`Error`], which names the file, the place in it and a remedy.
//!
//! # Cargo features
//!
//! `gpu` (the wgpu engine), `script` (scenes as scripts) and `store` (stored environments) are on by default. Everything else
//! works without them.

pub mod acquire;
pub mod batch;
mod change;
pub mod compare;
pub mod cost;
pub mod cpu;
pub mod engine;
pub mod environment;
mod error;
pub mod features;
pub mod free_poses;
pub mod geometry;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod history;
pub mod index;
#[doc(hidden)]
pub mod internal;
pub mod io;
pub mod limits;
pub mod matching;
pub mod memory;
pub mod placement;
pub mod plan;
mod predict;
mod printable;
pub mod probe;
mod random;
pub mod reference;
#[doc(hidden)]
pub mod row;
pub mod sensor;
mod threads;
pub mod virtual_sensors;
mod world;

pub use change::Change;
pub use environment::{Appearance, Environment, Material, Mesh, NewObject, Object, Polygon, PolygonOrder};
pub use error::{Error, ErrorKind, Result};
pub use geometry::{Aabb, Pose};
pub use io::preset;
pub use plan::{FramePlan, IdScheme, Images, LeftOut, Output, Outputs, Request, StageRow, Stats, Work};
pub use predict::{Backend, Options, Prediction, Predictor};
pub use sensor::{Angles, Camera, Distortion, Geometry, Mixture, Noise, RayTable, Scanner, Sensor, SensorSpec};
pub use threads::Threads;
pub use world::World;

/// The README's example is compiled and run as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
