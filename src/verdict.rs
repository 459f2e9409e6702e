//! Verdicts: the agreement of a measured image with its prediction, pixel by pixel.
//!
//! ```
//! use glam::DVec3;
//! use presight::environment::Environment;
//! use presight::measured::{Frame, Measurement};
//! use presight::verdict::{self, Verdict};
//! use presight::{Options, Pose, PoseEstimate, Predictor, Request, RobotPose, SensorPose, World};
//!
//! // A wall whose face is 2 m ahead. The scanner measures a box 1 m before it, and a hole in the wall.
//! let mut environment = Environment::new();
//! let middle = Pose::from_xyz_rpy(DVec3::new(2.5, 0.0, 0.0), 0.0, 0.0, 0.0);
//! environment.add_cuboid("wall", middle, DVec3::new(1.0, 4.0, 2.0))?;
//! let world = World::new(environment);
//! let scanner = presight::preset("laser-scanner")?; // 180 looks ahead
//! let mut predictor = Predictor::new(Options::default())?;
//!
//! let mut ranges = predictor.predict(&world, &scanner, &SensorPose::IDENTITY, &Request::default())?.images.range;
//! ranges[180] = 1.0;
//! ranges[170] += 0.5;
//! let frame = Frame::new(0.0, scanner, Measurement::Range(ranges))?;
//! let robot = PoseEstimate::of_sigmas(RobotPose::IDENTITY, 0.001, 0.0005);
//! let verdicts = verdict::of_frame(&mut predictor, &world, &frame, &robot)?;
//! assert_eq!(verdicts.pixels[180], Verdict::Nearer);
//! assert_eq!(verdicts.pixels[170], Verdict::Farther);
//! assert_eq!(verdicts.pixels[175], Verdict::Confirmed);
//! # Ok::<(), presight::Error>(())
//! ```

#[doc(inline)]
pub use presight_localize::verdict::{Verdict, Verdicts, of_coarse_model, of_frame};
