//! Planes.

use glam::{DVec2, DVec3};

/// A plane with a point in its middle, relative to the base of the views.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Flat {
    pub centre: DVec3,
    /// Unit, towards the sensor.
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
