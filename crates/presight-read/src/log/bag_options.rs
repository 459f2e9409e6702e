//! Choices for logs that are ROS 2 bags.

use presight_model::geometry::Pose;

presight_model::options! {
    /// Choices that a bag leaves open.
    #[derive(Clone, Debug, PartialEq)]
    pub struct BagOptions {
        /// The measured topic; by default the only one that presight can read.
        topic: Option<String> = None, with_topic;
        /// The frame of the robot; by default `base_link`, else `base_footprint`.
        base: Option<String> = None, with_base;
        /// robot_from_sensor in body axes; by default it follows from the transforms.
        mount: Option<Pose> = None, with_mount;
        /// The intensity of a full reflector in units of the driver; without it intensities are not read.
        reflector: Option<f32> = None, with_reflector;
    }
}

impl BagOptions {
    /// True if every choice is the default.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}
