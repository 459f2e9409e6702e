//! Estimates: the robot's pose from one or more measured frames, with its covariance.
//!
//! A scanner at the origin has a corner before it: walls at x = 3 and y = 2. It stands 2 cm farther forward than it believes.
//! ```
//! use presight::estimate::{EstimateOptions, Estimator, Freedom};
//! use presight::simulate::{Disturbances, Simulator};
//! use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
//! use presight::{Options, Pose, PoseEstimate, Predictor, RobotPose, World};
//! use glam::{DVec3, Vec3};
//! use std::sync::Arc;
//!
//! let mut environment = Environment::new();
//! let paint = environment.add_material(Material::named("paint"))?;
//! for (name, a, b) in [("ahead", [3.0, -4.0], [3.0, 2.0]), ("left", [3.0, 2.0], [-4.0, 2.0])] {
//!     let corners = [[a[0], a[1], 0.0], [b[0], b[1], 0.0], [b[0], b[1], 2.0], [a[0], a[1], 2.0]].map(Vec3::from);
//!     let mesh = Mesh::new(name, corners.to_vec(), vec![Polygon::new(vec![0, 1, 2, 3], paint)], PolygonOrder::Given)?;
//!     environment.insert(NewObject::new(name, Pose::IDENTITY, Arc::new(mesh)))?;
//! }
//! let world = World::new(environment);
//! let scanner = presight::preset("laser-scanner")?;
//! let predictor = || Predictor::new(Options::default());
//!
//! let truth = RobotPose::from_xyz_rpy(DVec3::new(0.02, 0.0, 0.5), 0.0, 0.0, 0.01);
//! let frame = Simulator::new(predictor()?, scanner, Disturbances::default(), 1)?.frame(&world, 0.0, &truth)?;
//! let believed = RobotPose::from_xyz_rpy(DVec3::new(0.0, 0.0, 0.5), 0.0, 0.0, 0.0);
//! let options = EstimateOptions::default().with_freedom(Freedom::Planar);
//! let prior = PoseEstimate::of_sigmas(believed, 0.05, 0.03);
//! let found = Estimator::new(predictor()?, options).estimate(&world, &[&frame], &prior)?;
//! assert!(found.is_determined() && found.weak.is_empty());
//! assert!((found.pose.world_from_robot.translation.x - 0.02).abs() < 4.0 * found.pose.covariance[0][0].sqrt());
//! # Ok::<(), presight::Error>(())
//! ```

#[doc(inline)]
pub use presight_localize::estimate::{Estimate, EstimateOptions, Estimator, Freedom};
