//! Verdicts: the comparison of a measured image with the model, pixel by pixel.
//!
//! [`of_frame`] predicts the exact plane of each pixel's polygon and compares a [`Frame`] with it: each pixel is
//! confirmed, nearer, farther and so on ([`Verdict`]). The bounds follow from the noise of the sensor and the
//! uncertainty of the pose.

mod expected;
mod judge;
mod pixel;
mod strided;
mod surfaces;

pub use expected::{ExpectedImage, body_from_image};
pub use judge::{Verdict, Verdicts, judge};
pub use pixel::ExpectedPixel;
pub use strided::LANES;
pub use surfaces::{ObjectError, Surface, Surfaces};

use presight_model::error::{Error, Result};
use presight_model::geometry::PoseEstimate;
use presight_model::measured::Frame;
use presight_model::world::World;
use presight_predict::predict::Predictor;

/// Compares a frame of ranges with what its sensor should measure from a robot at this pose.
///
/// The sensor's mount leads from the robot to the sensor. The pose is that of the frame's stamp; a scan that takes time
/// is compared in its middle ([`Frame::at_one_moment`]), with a verdict for each pixel of that frame. A pixel is compared with all surfaces predicted within its
/// uncertainty: the standard deviation of a range is `s^2 = s_z^2 + (z s_a tan i)^2 + (J C J' + P) / cos^2 i`, with s_z
/// and s_a the sensor's noise, i the angle of incidence, C the covariance of the pose, and P that of the object's pose,
/// from the feature layer of the sensor's class. Nearer than the nearest by 3.3 s is [`Verdict::Nearer`], farther than
/// the farthest [`Verdict::Farther`].
///
/// # Errors
/// The errors of [`Predictor::predict_images`] and [`Frame::deskewed`];
/// [`presight_model::ErrorKind::Invalid`] for an invalid covariance;
/// [`presight_model::ErrorKind::Usage`] for a grey image.
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
    let moment = frame.at_one_moment()?;
    let (frame, robot) = (&*moment.frame, moment.robot(robot));
    let surfaces = &mut Surfaces::default();
    let expected = ExpectedImage::predict(predictor, world, surfaces, frame.sensor(), &robot.robot())?;
    predictor.on_threads(|| judge(frame, &expected, &robot, polygon_sigma))
}
