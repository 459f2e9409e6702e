//! Localization: the robot's pose followed from frame to frame, or found without a first guess.
//!
//! A scanner at an unknown pose, in a room where no two places look alike:
//! ```
//! use presight::estimate::{EstimateOptions, Estimator};
//! use presight::localize::{LocalizeOptions, Localizer, Phase, Search, SearchOptions, Step};
//! use presight::simulate::{Disturbances, Simulator};
//! use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
//! use presight::sensor::Noise;
//! use presight::{Options, Pose, Predictor, RobotPose, Sensor, World};
//! use glam::{DVec3, Vec3};
//! use std::sync::Arc;
//!
//! let mut environment = Environment::new();
//! let paint = environment.add_material(Material::named("paint"))?;
//! let corners = [[0.0, 0.0], [5.0, 0.0], [5.0, 2.0], [3.0, 2.5], [2.0, 4.0], [0.0, 3.0]];
//! for (k, (a, b)) in corners.iter().zip(corners.iter().cycle().skip(1)).enumerate() {
//!     let wall = [[a[0], a[1], 0.0], [b[0], b[1], 0.0], [b[0], b[1], 2.0], [a[0], a[1], 2.0]].map(Vec3::from);
//!     let name = format!("wall {k}");
//!     let mesh = Mesh::new(&name, wall.to_vec(), vec![Polygon::new(vec![0, 1, 2, 3], paint)], PolygonOrder::Given)?;
//!     environment.insert(NewObject::new(&name, Pose::IDENTITY, Arc::new(mesh)))?;
//! }
//! let world = World::new(environment);
//! let mut spec = presight::preset("laser-scanner")?.spec().clone();
//! (spec.range_max, spec.mount.translation.z, spec.noise) = (10.0, 1.0, Noise { range_sigma: 0.02, ..Noise::default() });
//! let scanner = Sensor::new(spec)?;
//!
//! let mut estimator = Estimator::new(Predictor::new(Options::default())?, EstimateOptions::planar());
//! let coarse = SearchOptions::default().with_headings(72).with_candidates(10);
//! let search = Search::new(&mut estimator, &world, &scanner, coarse)?;
//! let mut localizer = Localizer::unknown(estimator, search, LocalizeOptions::default());
//! let mut simulator = Simulator::new(Predictor::new(Options::default())?, scanner, Disturbances::default(), 1)?;
//! for k in 0..5 {
//!     let truth = RobotPose::from_xyz_rpy(DVec3::new(1.0 + 0.2 * f64::from(k), 1.2, 0.0), 0.0, 0.0, 0.4);
//!     let step = localizer.step(&world, &simulator.frame(&world, f64::from(k), &truth)?)?;
//!     // One scan is not enough; the fifth is.
//!     assert!(k > 0 || step.phase == Phase::Candidates, "{}", step.reason);
//!     assert!(k < 4 || step.phase == Phase::Tracking, "{}", step.reason);
//!     assert!(step.pose.world_from_robot.translation.distance(truth.world_from_robot().translation) < 0.05);
//! }
//! # Ok::<(), presight::Error>(())
//! ```
#![doc = include_str!("../docs/localization.md")]

#[doc(inline)]
pub use presight_localize::localize::{ErrorRates, LocalizeOptions, Localizer, Phase, Search, SearchOptions, Step};
