//! Verdicts: what a measured image says of the prediction, pixel by pixel.
//!
//! [`ExpectedImage`] is a prediction with the exact plane of each pixel's polygon. [`judge`] compares a
//! [`presight_model::measured::Frame`] with it: each pixel is confirmed, nearer, farther and so on ([`Verdict`]), tight
//! by what is known of the noise and of the pose.

mod expected;
mod judge;
mod strided;
mod surfaces;

pub use expected::body_from_image;
pub use expected::{ExpectedImage, ExpectedPixel};
pub use judge::{Uncertainty, Verdict, Verdicts, judge};
pub use strided::LANES;
pub use surfaces::{ObjectError, Surface, Surfaces};
