//! Localization: the robot's pose followed from frame to frame, or found without a first guess.
//!
//! A scanner at an unknown pose, in a room where no two places look alike:
//! ```
//! use presight::localize::{EstimateOptions, Estimator, LocalizeOptions, Localizer, Phase, Search, SearchOptions};
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
//! (spec.range_max, spec.mount.translation.z) = (10.0, 1.0);
//! spec.noise = Noise { range_sigma: 0.02, ..Noise::default() };
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
//!
//! # Estimates
//!
//! An estimate is the robot's pose from one or more measured frames, with its covariance.
//!
//! A scanner at the origin has a corner before it: walls at x = 3 and y = 2. It stands 2 cm farther forward than it
//! believes.
//! ```
//! use presight::localize::{EstimateOptions, Estimator, Freedom};
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
//!
//! # History
//!
//! A tracker follows features from frame to frame and matches detections to them.
//!
//! ```
//! use glam::{DMat2, DVec2};
//! use presight::localize::{Detection, ExpectedProperties, ImageExtent, Seed, Shape, Tracker, TrackerOptions};
//!
//! let mut tracker = Tracker::new(TrackerOptions::new(ImageExtent::new(640, 480)))?;
//! let at = |time: f64| DVec2::new(100.0 + 80.0 * time, 200.0);
//! let seed = Seed {
//!     id: 1,
//!     shape: Shape::Point(at(0.0)),
//!     covariances: vec![DMat2::IDENTITY],
//!     properties: ExpectedProperties::default(),
//! };
//! tracker.seed(0.0, vec![seed])?;
//! let mut areas = Vec::new();
//! for k in 0..20 {
//!     let time = 0.05 * f64::from(k);
//!     let [x0, y0, x1, y1] = tracker.predict(time)?[0].bounds;
//!     areas.push((x1 - x0) * (y1 - y0));
//!     tracker.correct(time, &[Detection::point(at(time), 0.5)])?;
//! }
//! // The speed was unknown at first.
//! assert!(areas[19] < 0.1 * areas[1]);
//! let speed = tracker.tracks()[0].speeds().next().expect("a point has one");
//! assert!((speed - DVec2::new(80.0, 0.0)).length() < 1.0);
//! # Ok::<(), presight::Error>(())
//! ```
#![doc = include_str!("../docs/history.md")]

#[doc(inline)]
pub use presight_localize::estimate::{
    Estimate, EstimateOptions, EstimateState, Estimator, Freedom, Hypothesis, SeenDeviation, WeakDirection, nees,
};
#[doc(inline)]
pub use presight_localize::extract::{FeatureClass, FeatureFinding, FeatureFindings, is_sought};
#[doc(inline)]
pub use presight_localize::history::{
    End, ImageExtent, Match, MatchOutcome, Seed, Track, Tracker, TrackerOptions, Window,
};
#[doc(inline)]
pub use presight_localize::localize::{
    Candidate, ErrorRates, LocalizeOptions, Localizer, MotionNoise, Phase, Search, SearchOptions, Step,
};
#[doc(inline)]
pub use presight_localize::matching::{
    Detection, DetectionProperties, ExpectedProperties, Marker, Matcher, PropertyNoise, Rejection, Shape,
    UncertainValue,
};
