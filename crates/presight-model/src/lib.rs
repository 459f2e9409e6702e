//! The model that presight predicts from: environment, spatial index, world, sensors, and what sensors measured.
//!
//! Use it through the crate `presight`, which gives the same names.

pub mod caster;
pub mod change;
pub mod clock;
pub mod contour;
pub mod environment;
pub mod error;
pub mod flat;
pub mod floor;
pub mod geometry;
pub mod index;
pub mod limits;
pub mod matrix;
pub mod measured;
pub mod memory;
mod options;
pub mod place;
mod placed;
pub mod placement;
pub mod plausible;
pub mod poses;
pub mod printable;
pub mod random;
pub mod sensor;
pub mod statistics;
pub mod threads;
pub mod union_find;
mod words;
pub mod world;

pub use change::Change;
pub use environment::{Appearance, Environment, Material, Mesh, NewObject, Object, Polygon, PolygonOrder};
pub use error::{Error, ErrorKind, Result};
pub use geometry::{Aabb, Pose};
pub use sensor::{Angles, Camera, Distortion, Geometry, Mixture, Noise, RayTable, Scanner, Sensor, SensorSpec};
pub use threads::Threads;
pub use world::World;
