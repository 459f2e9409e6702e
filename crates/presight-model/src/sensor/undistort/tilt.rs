//! The tilted image sensor of `rational_polynomial` (OpenCV's tauX, tauY; the Scheimpflug model).
//!
//! R = Ry(tauY) Rx(tauX) turns points of the upright plane z = 1 into the axes of the sensor, where the axis of the
//! lens is a = R e_z. The sensor is the plane z = a_z. Points are projected onto it through the centre of the lens, and
//! their coordinates are relative to a.

use glam::{DMat3, DVec2, DVec3};

/// The perspective map between the upright plane and the sensor's.
#[derive(Clone, Debug)]
pub(super) struct Tilt {
    tilted_from_upright: DMat3,
    upright_from_tilted: DMat3,
}

impl Tilt {
    /// Angles in radians, less than a right angle.
    pub fn new(tau_x: f64, tau_y: f64) -> Self {
        let ((sx, cx), (sy, cy)) = (tau_x.sin_cos(), tau_y.sin_cos());
        let axis = DVec3::new(-sy * cx, sx, cy * cx);
        let turn = DMat3::from_cols(DVec3::new(cy, 0.0, sy), DVec3::new(sy * sx, cx, -cy * sx), axis);
        let onto_sensor = DMat3::from_cols(
            DVec3::new(axis.z, 0.0, 0.0),
            DVec3::new(0.0, axis.z, 0.0),
            DVec3::new(-axis.x, -axis.y, 1.0),
        );
        let tilted_from_upright = onto_sensor * turn;
        Self { tilted_from_upright, upright_from_tilted: tilted_from_upright.inverse() }
    }

    /// The sensor's coordinates of an upright point; `None` beyond the line where the sensor's plane meets the lens.
    pub fn tilted(&self, upright: DVec2) -> Option<DVec2> {
        seen(self.tilted_from_upright * upright.extend(1.0))
    }

    /// The inverse of [`Tilt::tilted`].
    pub fn upright(&self, tilted: DVec2) -> Option<DVec2> {
        seen(self.upright_from_tilted * tilted.extend(1.0))
    }
}

fn seen(p: DVec3) -> Option<DVec2> {
    (p.z > 0.0).then(|| p.truncate() / p.z)
}
