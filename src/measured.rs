//! What a sensor delivered: ranges or grey values, with their time and the motion of the robot since the previous ones.

#[doc(inline)]
pub use presight_model::measured::{
    Frame, FrameAtMoment, GreyImage, MAX_POSE_GAP_S, Measurement, Motion, OdometryNoise, RangeNoise, ScanMotion,
    Trajectory,
};
