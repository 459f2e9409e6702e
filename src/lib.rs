//! presight: the engine that tells a robot what its sensors should see.
//!
//! A scene becomes an [`Environment`] ([`io::gltf::import`], a script, or objects added one by one), a version of it a [`World`].
//! A [`Sensor`] is a preset, a file ([`io::load_sensor`]) or made from a [`SensorSpec`]. A [`Predictor`] answers for a
//! sensor at a [`Pose`] with [`Images`]: range, depth, which polygon and object each pixel sees, and at which angle.
//! [`virtual_sensors`] reduce that to what one task wants to know.
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
//! Lengths are metres, angles inside are radians, frames right-handed: x forward, y left, z up; a camera's optical frame
//! is z forward, x right, y down. `a_from_b` turns coordinates in b into coordinates in a. Errors are one type,
//! [`Error`], that names file, place and remedy. The cargo features `gpu`, `store` and `report` (default) bring the
//! wgpu engine, stored environments ([`io`]`::store`) and plots; everything else works without them.

pub mod acquire;
mod change;
#[doc(hidden)]
pub mod cli;
pub mod compare;
pub mod cost;
pub mod cpu;
pub mod environment;
mod error;
pub mod features;
pub mod free_poses;
pub mod geometry;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod history;
pub mod index;
pub mod io;
pub mod limits;
pub mod matching;
pub mod placement;
pub mod plan;
mod predict;
pub mod probe;
mod random;
pub mod reference;
pub mod report;
pub mod sensor;
pub mod virtual_sensors;
mod world;

pub use change::Change;
pub use environment::{Appearance, Environment, Material, Mesh, NewObject, Object, Polygon, PolygonOrder};
pub use error::{Error, ErrorKind, Result};
pub use geometry::{Aabb, Pose};
pub use io::preset;
pub use plan::{FramePlan, IdScheme, Images, LeftOut, Output, Outputs, Request, StageRow, Stats, Work};
#[doc(hidden)]
pub use predict::Opening;
pub use predict::{Backend, Options, Prediction, Predictor};
pub use sensor::{Angles, Camera, Distortion, Geometry, Noise, RayTable, Scanner, Sensor, SensorSpec};
pub use world::World;

/// The README's example is compiled and run as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
