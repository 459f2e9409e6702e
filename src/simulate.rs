//! Simulated measurements: frames of a sensor with noise, drop-outs, odometry that slips, people who walk, and a scene
//! that differs from its model.

#[doc(inline)]
pub use presight_localize::simulate::{Disturbances, GreySimulator, Simulator, Walkers, displace};
