//! Planes, and convex polygons on them.

use glam::{DVec2, DVec3};

/// A plane through a centre, in coordinates relative to [`crate::Views::base`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Flat {
    pub centre: DVec3,
    /// Unit normal towards the sensor.
    pub normal: DVec3,
}

impl Flat {
    /// Signed distance of a point, metres.
    #[inline]
    pub fn above(&self, p: DVec3) -> f64 {
        (p - self.centre).dot(self.normal)
    }

    /// Two unit vectors that span the plane; with the normal they are right-handed.
    pub fn axes(&self) -> [DVec3; 2] {
        let other = if self.normal.z.abs() < 0.9 { DVec3::Z } else { DVec3::X };
        let x = other.cross(self.normal).normalize();
        [x, self.normal.cross(x)]
    }

    /// Coordinates in the plane, along its axes from its centre.
    pub fn place(&self, p: DVec3) -> DVec2 {
        let [x, y] = self.axes();
        let q = p - self.centre;
        DVec2::new(q.dot(x), q.dot(y))
    }

    /// The point with these coordinates.
    pub fn point(&self, q: DVec2) -> DVec3 {
        let [x, y] = self.axes();
        self.centre + x * q.x + y * q.y
    }
}

/// The vector of twice the area of a planar polygon: along its normal, from whose side the corners run
/// counter-clockwise.
pub(crate) fn doubled_area(corners: &[DVec3]) -> DVec3 {
    corners.windows(2).skip(1).map(|pair| (pair[0] - corners[0]).cross(pair[1] - corners[0])).sum()
}

/// Bounds of points in a plane: the lower and the upper corner. Both are infinite without points.
pub(crate) fn bounds(points: impl IntoIterator<Item = DVec2>) -> (DVec2, DVec2) {
    let empty = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    points.into_iter().fold(empty, |(min, max), q| (min.min(q), max.max(q)))
}

/// True if a point lies in a convex polygon whose corners run counter-clockwise. `slack` is the tolerance of the cross
/// products of the sides with the directions to the point.
pub(crate) fn is_inside(q: DVec2, corners: &[DVec2], slack: f64) -> bool {
    let mut sides = corners.iter().zip(corners.iter().cycle().skip(1));
    sides.all(|(a, b)| (b - a).perp_dot(q - a) >= -slack)
}
