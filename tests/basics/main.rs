//! What takes seconds: poses, lenses and reasons worked out by hand, the comparison, and the rules of this repository.

mod architecture;
mod feature_reasons;
mod from_bytes;
mod lens_opencv;
mod outputs;
mod pictures;
mod portable;
mod poses;
mod skipped;
mod verify;
mod versions;
