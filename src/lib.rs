//! presight: the engine that tells a robot what its sensors should see.

pub mod acquire;
#[doc(hidden)]
pub mod cli;
pub mod compare;
pub mod cpu;
pub mod environment;
mod error;
pub mod free_poses;
pub mod geometry;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod io;
pub mod limits;
pub mod plan;
mod predict;
pub mod reference;
pub mod sensor;
mod world;

pub use environment::{Appearance, Environment, Material, Mesh, NewObject, Object, Polygon, PolygonOrder};
pub use error::{Error, ErrorKind, Result};
pub use geometry::{Aabb, Pose};
pub use io::preset;
pub use plan::{FramePlan, IdScheme, Images, LeftOut, Output, Outputs, Request, Stats};
pub use predict::{Backend, Options, Prediction, Predictor};
pub use sensor::{Angles, Camera, Distortion, Geometry, Noise, RayTable, Scanner, Sensor, SensorSpec};
pub use world::World;

/// The README's example is compiled and run as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
