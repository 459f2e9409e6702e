//! Keeps deadlines: decides what cannot be done in time and when drawing must stop, and learns from finished frames.
//!
//! The engine stops by the clock, which keeps the deadline. The unit costs only decide whether even an empty image
//! would be late, how much time images need after drawing, and which runs to skip because even a low estimate of their
//! time is too long.

mod control;
mod cut;
mod features;
mod frame;
mod stopping;
#[cfg(test)]
mod tests;
mod thinning;
mod whole;

pub use control::Controller;
pub use features::FeatureGroups;
pub use frame::DeadlineFrame;
