//! Predictions at many poses, within a deadline, and what is read from images: samples, points, statistics.
//!
//! # Deadlines
//!
//! A deadline makes a prediction finish in time and report the parts that it gave up.
//!
//! ```
//! use presight::environment::Environment;
//! use presight::{Backend, ErrorKind, Options, Predictor, Request, SensorPose, World};
//! use std::time::Duration;
//! let world = World::new(Environment::new());
//! let sensor = presight::preset("laser-scanner")?;
//! let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1))?;
//! let within = |time| Request::default().with_deadline(time);
//! let seen = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &within(Duration::from_secs(10)))?;
//! assert_eq!(seen.degradation(), None);
//! let impossible = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &within(Duration::from_nanos(1)));
//! assert_eq!(impossible.unwrap_err().kind(), ErrorKind::Deadline);
//! # Ok::<(), presight::Error>(())
//! ```
#![doc = include_str!("../docs/deadline.md")]
#![doc = include_str!("../docs/batches.md")]

#[doc(inline)]
pub use presight_predict::batch::{Batch, BatchItem, BatchRequest, Headings, PoseCell, RangeLikelihood};
#[doc(inline)]
pub use presight_predict::free_poses::free_poses;
#[doc(inline)]
pub use presight_render::cost::CostModel;
#[doc(inline)]
pub use presight_render::deadline::{
    DeadlineOutcome, Degradation, DegradationKind, DegradationStep, Opening, Priority,
};
#[doc(inline)]
pub use presight_render::plan::{Samples, SamplesMut, StageRow};
#[doc(inline)]
pub use presight_render::points::{PointCloud, PointsFrame};
