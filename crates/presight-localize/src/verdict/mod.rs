//! Verdicts: what a measured image says of the model, pixel by pixel.
//!
//! [`of_frame`] predicts what the frame's sensor should see from a robot at a pose and compares: each pixel is confirmed,
//! nearer, farther and so on ([`Verdict`]). The noise of the sensor and the covariance of the pose set the limits.
//!
//! # Examples
//! ```
//! use presight::frame::{Frame, Measurement};
//! use presight::geometry::PoseEstimate;
//! use presight::verdict::{self, Verdict};
//! use presight::{Environment, Options, Pose, Predictor, World};
//! use glam::DVec3;
//!
//! // A wall 2 m ahead of the robot, 4 m wide, and a scanner that sees a box 1 m before it.
//! let mut environment = Environment::new();
//! let wall = Pose::from_xyz_rpy(DVec3::new(2.05, 0.0, 0.0), 0.0, 0.0, 0.0);
//! environment.add_cuboid("wall", wall, DVec3::new(0.1, 4.0, 2.0))?;
//! let world = World::new(environment);
//! let scanner = presight::preset("laser-scanner")?; // 361 beams, half a degree apart; 180 looks ahead
//!
//! let mut predictor = Predictor::new(Options::default())?;
//! let mut ranges = predictor.predict(&world, &scanner, &Pose::IDENTITY, &Default::default())?.images.range;
//! ranges[180] = 1.0;
//! ranges[170] += 0.5;
//! let frame = Frame::new(0.0, scanner, Measurement::Range(ranges))?;
//! let verdicts = verdict::of_frame(&mut predictor, &world, &frame, &PoseEstimate::exact(Pose::IDENTITY))?;
//! assert_eq!(verdicts.pixels[180], Verdict::Nearer);
//! assert_eq!(verdicts.pixels[170], Verdict::Farther);
//! assert_eq!(verdicts.pixels[175], Verdict::Confirmed);
//! assert_eq!(verdicts.pixels[0], Verdict::Beyond);
//! # Ok::<(), presight::Error>(())
//! ```

mod expected;
mod judge;
mod strided;
mod surfaces;

#[doc(hidden)]
pub use expected::{ExpectedImage, ExpectedPixel, body_from_image};
pub(crate) use judge::judge;
pub use judge::{Verdict, Verdicts};
#[doc(hidden)]
pub use strided::LANES;
#[doc(hidden)]
pub use surfaces::{ObjectError, Surface, Surfaces};

use presight_model::error::{Error, Result};
use presight_model::frame::Frame;
use presight_model::geometry::PoseEstimate;
use presight_model::world::World;
use presight_predict::predict::Predictor;

/// Compares a frame of ranges with what its sensor should measure from a robot at this pose.
///
/// The sensor's mount leads from the robot to the sensor. A pixel is compared with all that is predicted within its
/// uncertainty: the standard deviation of a range is `s^2 = s_z^2 + (z s_a tan i)^2 + (J C J' + P) / cos^2 i`, with s_z
/// and s_a the sensor's noise, i the angle of incidence, C the covariance of the pose, and P that of the object's pose,
/// from the feature layer of the sensor's class. Nearer than the nearest by 3.3 s is [`Verdict::Nearer`], farther than
/// the farthest [`Verdict::Farther`].
///
/// # Errors
/// The errors of [`Predictor::predict_images`]; [`crate::ErrorKind::Invalid`] for an invalid covariance;
/// [`crate::ErrorKind::Usage`] for a grey image.
pub fn of_frame(predictor: &mut Predictor, world: &World, frame: &Frame, robot: &PoseEstimate) -> Result<Verdicts> {
    of_coarse_model(predictor, world, frame, robot, 0.0)
}

/// As [`of_frame`], for a model with polygons that may be off along their normals: `polygon_sigma` is one standard
/// deviation, metres.
///
/// # Errors
/// The errors of [`of_frame`].
pub fn of_coarse_model(
    predictor: &mut Predictor,
    world: &World,
    frame: &Frame,
    robot: &PoseEstimate,
    polygon_sigma: f64,
) -> Result<Verdicts> {
    if frame.grey().is_some() {
        return Err(Error::usage("verdicts on a grey image", "give a frame of ranges"));
    }
    robot.covariance.check().map_err(|e| e.at("the robot's pose"))?;
    let (surfaces, pose) = (&mut Surfaces::default(), &robot.world_from_robot);
    let expected = ExpectedImage::predict(predictor, world, surfaces, frame.sensor(), pose)?;
    predictor.on_threads(|| judge(frame, &expected, robot, polygon_sigma))
}
