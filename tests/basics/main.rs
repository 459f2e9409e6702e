//! Tests that take seconds: poses, lenses and visibility reasons calculated by hand, the image comparison, and the
//! rules of this repository.

mod architecture;
mod feature_reasons;
mod lens_opencv;
mod outputs;
mod pictures;
mod poses;
mod skipped;
mod verify;
mod versions;
