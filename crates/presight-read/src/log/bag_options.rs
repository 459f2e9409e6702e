//! Choices for logs that are ROS 2 bags.

use presight_model::geometry::Pose;

/// Choices that a bag leaves open.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct BagOptions {
    /// The measured topic; by default the only one that presight can read.
    pub topic: Option<String>,
    /// The frame of the robot; by default `base_link`, else `base_footprint`.
    pub base: Option<String>,
    /// robot_from_sensor in body axes, instead of the one from the transforms.
    pub mount: Option<Pose>,
    /// The intensity of a full reflector in units of the driver; without it intensities are not read.
    pub reflector: Option<f32>,
}

presight_model::with_options!(
    BagOptions:
    with_topic topic: Option<String>,
    with_base base: Option<String>,
    with_mount mount: Option<Pose>,
    with_reflector reflector: Option<f32>,
);

impl BagOptions {
    /// True if nothing was chosen.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}
