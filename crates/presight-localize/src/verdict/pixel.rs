//! A pixel of an expected image.

use glam::Vec3;

/// A pixel of a prediction, in the image frame of the predicted pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedPixel {
    /// The predicted point, metres; NaN without a prediction.
    pub point: Vec3,
    /// Metres along the ray; not finite without a point.
    pub range: f32,
    /// Unit normal of the polygon.
    pub normal: Vec3,
    /// `normal . point`, metres.
    pub offset: f32,
    /// Index of the object.
    pub object: u32,
    /// See [`super::Surface::group`].
    pub group: u32,
}

/// A pixel without a prediction.
pub(super) const NOTHING: ExpectedPixel = ExpectedPixel {
    point: Vec3::NAN,
    range: f32::INFINITY,
    normal: Vec3::NAN,
    offset: f32::NAN,
    object: u32::MAX,
    group: u32::MAX,
};
