//! Sensors: cameras, scanners and ray tables, with range limits, mount and noise.
//!
//! A [`crate::Sensor`] is a [`crate::preset`], a file ([`crate::files::load_sensor`]), or made from a [`SensorSpec`].

#[doc(inline)]
pub use presight_model::poses::{ExternalPose, PoseFrame, PoseOf, WorldFrame};
#[doc(inline)]
pub use presight_model::sensor::{
    Angles, BeamTable, Camera, Distortion, Geometry, Mixture, Noise, PRESETS, Preset, RayTable, RayTimes, Scanner,
    SensorSpec, StampAt,
};
