//! Exploration: from frames with poses to a stored model, and occupancy grids of models.
//!
//! A camera in an unknown room:
//! ```
//! use presight::environment::{Environment, Mesh, NewObject};
//! use presight::explore::{Exploration, ExploreOptions, Known, Views};
//! use presight::simulate::{Disturbances, Simulator};
//! use presight::{Options, Pose, Predictor, RobotPose, World};
//! use glam::{DVec3, Vec3};
//!
//! let mut environment = Environment::new();
//! environment.add_material(presight::environment::Material::named("paint"))?;
//! let room = Mesh::cuboid("room", Vec3::new(-2.0, -2.0, 0.0), Vec3::new(2.0, 2.0, 2.5), 0)?;
//! environment.insert(NewObject::new("room", Pose::IDENTITY, room.into()))?;
//! let world = World::new(environment);
//! let camera = presight::preset("realsense-d435")?;
//! let mut simulator = Simulator::new(Predictor::new(Options::default())?, camera, Disturbances::default(), 7)?;
//! let mut views = Views::default();
//! for k in 0..8 {
//!     let robot = RobotPose::from_xyz_rpy(DVec3::new(0.0, 0.0, 1.2), 0.0, 0.3, f64::from(k) * 0.1);
//!     let frame = simulator.frame(&world, f64::from(k), &robot)?.thinned(8)?;
//!     views.push(&frame, robot.sensor(frame.sensor()))?;
//! }
//! let options = ExploreOptions::default();
//! let found = Exploration::of(&Environment::new(), Known::Explored, &views, &options)?;
//! assert!(found.objects.iter().any(|o| o.path == "floor/0001"));
//! // Nothing behind the camera is made up.
//! assert!(found.environment().objects().iter().all(|o| o.world_bounds().max.x > 0.0));
//! # Ok::<(), presight::Error>(())
//! ```
#![doc = include_str!("../docs/explore.md")]

#[doc(inline)]
pub use presight_explore::occupancy::{Cell, Grid, GridOptions};
#[doc(inline)]
pub use presight_explore::{Areas, Exploration, ExploreOptions, ExploredObject, Follower, FoundPose, Known, Views};
#[doc(inline)]
pub use presight_model::floor::Level;
