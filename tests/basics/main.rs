//! Tests that take seconds: poses, lenses and visibility reasons calculated by hand, the image comparison, and the
//! rules of this repository.

mod architecture;
mod facade;
mod feature_reasons;
mod from_bytes;
mod lens_opencv;
mod links;
mod names;
mod outputs;
mod pictures;
mod portable;
mod poses;
mod skipped;
mod verify;
mod versions;
