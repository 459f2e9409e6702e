//! Segments of a cut.

use glam::{DVec2, DVec3};

/// Intersection of a polygon with the height.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// One end.
    pub a: DVec2,
    /// The other end.
    pub b: DVec2,
    /// Horizontal part of the polygon's unit normal.
    pub normal: DVec2,
    /// The polygon's plane at this height is `normal . p = offset`.
    pub offset: f64,
    /// Index of the object.
    pub object: u32,
    /// Index of the polygon in its mesh.
    pub polygon: u32,
    /// Rounding error of positions, metres.
    pub(super) position: f32,
    /// Metres along the ground for each metre of height, of the edges that end at `a` and `b`.
    pub(super) slopes: [f32; 2],
    /// Maximum distance of a corner from `a`, metres.
    pub(super) extent: f32,
    /// Maximum distance of the corners from the plane, metres.
    pub(super) spread: f32,
    /// Minimum distance of the corners from the height, metres.
    pub(super) clearance: f32,
    /// Minimum length of an edge, metres.
    pub(super) shortest: f32,
    /// Maximum distance from the segment of points of the polygon at this height, and of points of its plane there,
    /// metres.
    pub(super) pad: f32,
    /// True if the polygon only touches the height within rounding: it may be anywhere within `pad` of the segment, at
    /// unknown depth.
    pub(super) touches: bool,
    /// Index in [`super::RowCut::objects`].
    pub(crate) place: u32,
    /// First corner in `corners` of the cut, and the number of corners.
    pub(super) first_corner: u32,
    pub(super) corner_count: u32,
    /// Unit normal in the mesh frame.
    pub(crate) mesh_normal: DVec3,
    /// Visible only from the normal's side.
    pub one_sided: bool,
    /// Next segment in `segments` of a face with the same corners, which is equally near; or [`NO_COPY`].
    pub(super) copy: u32,
}

/// Value of [`Segment::copy`] without a further copy.
pub(super) const NO_COPY: u32 = u32::MAX;

/// Distance of a point from a segment.
pub(super) fn distance(p: DVec2, [a, b]: [DVec2; 2]) -> f64 {
    let along = b - a;
    let length_squared = along.length_squared();
    let t = if length_squared > 0.0 { ((p - a).dot(along) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
    p.distance(a + along * t)
}
