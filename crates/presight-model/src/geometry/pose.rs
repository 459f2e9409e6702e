//! Rigid transforms in f64.

use super::trig;
use crate::error::{Error, ErrorKind, Result};
use crate::limits;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::ops::Mul;

/// A rigid transform `a_from_b`: rotation, then translation in metres.
///
/// ```
/// use presight::Pose;
/// use glam::DVec3;
/// let world_from_robot = Pose::from_xyz_rpy(DVec3::new(1.0, 2.0, 0.0), 0.0, 0.0, 90f64.to_radians());
/// let p_in_world = world_from_robot.transform_point(DVec3::X);
/// assert!((p_in_world - DVec3::new(1.0, 3.0, 0.0)).length() < 1e-15);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Metres.
    pub translation: DVec3,
}

impl Default for Pose {
    fn default() -> Self {
        Self::IDENTITY
    }
}

/// Largest deviation of a quaternion's length from 1: rounding stays below it (tf2 has the same limit). Quaternions in another
/// order or unit are often of another length.
const MAX_LENGTH_OFF: f64 = 0.01;

impl Pose {
    /// The identity.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// From a translation and a rotation; the quaternion is normalized.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] on NaN, infinity, a translation beyond [`limits::MAX_COORDINATE`], or a quaternion
    /// whose length is off 1 by more than 1 %.
    pub fn new(translation: DVec3, rotation: DQuat) -> Result<Self> {
        let near = translation.is_finite() && translation.abs().max_element() <= limits::MAX_COORDINATE;
        if !near {
            return Err(Error::usage(
                format!("a pose must be within {:e} m", limits::MAX_COORDINATE),
                "give x,y,z,roll_deg,pitch_deg,yaw_deg or x,y,z,qx,qy,qz,qw, in metres",
            ));
        }
        let length = rotation.length();
        if !((length - 1.0).abs() <= MAX_LENGTH_OFF) {
            let what = format!("a quaternion of length {length:.6}, not 1");
            return Err(Error::usage(what, "give qx,qy,qz,qw in this order, divided by the length"));
        }
        Ok(Self { rotation: rotation.normalize(), translation })
    }

    /// Checks that this is a rigid transform: finite numbers, a quaternion of length 1, no translation beyond
    /// [`limits::MAX_COORDINATE`]. Every function that takes a sensor's pose does this check.
    ///
    /// ```
    /// use presight::{ErrorKind, Pose};
    /// assert!(Pose::IDENTITY.check().is_ok());
    /// let long = Pose { rotation: glam::DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0), ..Pose::IDENTITY };
    /// assert_eq!(long.check().unwrap_err().kind(), ErrorKind::Usage);
    /// ```
    ///
    /// # Errors
    /// [`ErrorKind::Usage`], naming the pose and the fault.
    pub fn check(&self) -> Result<()> {
        self.check_as(ErrorKind::Usage)
    }

    /// [`Pose::check`] with another kind of error.
    pub fn check_as(&self, kind: ErrorKind) -> Result<()> {
        let Self { rotation, translation } = self;
        // The tolerance matches the precision of written quaternions, so that reading one never has to change its bits.
        let (rule, remedy) = if !translation.is_finite() || !rotation.is_finite() {
            ("is not finite".to_owned(), "give finite numbers")
        } else if (rotation.length_squared() - 1.0).abs() > 1e-9 {
            let length = rotation.length();
            (format!("is not a rotation: its quaternion has length {length}, not 1"), "divide it by its length")
        } else if translation.abs().max_element() > limits::MAX_COORDINATE {
            (format!("is too far away: over {:e} m", limits::MAX_COORDINATE), "give metres; subtract a common offset")
        } else {
            return Ok(());
        };
        // Debug format, because Display has no exponents: 1e300 would fill the screen.
        Err(Error::new(kind, format!("the pose {:?} {rule}", self.to_array()), remedy))
    }

    /// From x, y, z and roll, pitch, yaw in degrees about fixed axes, or x, y, z, qx, qy, qz, qw. A quaternion of
    /// length 1 keeps its bits, so that a written pose reads back equal; any other is normalized.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] for another count of numbers, and as [`Pose::new`].
    pub fn of_numbers(numbers: &[f64]) -> Result<Self> {
        let given = Self::unchecked(numbers).ok_or_else(|| {
            let remedy = "give [x, y, z, roll_deg, pitch_deg, yaw_deg] or [x, y, z, qx, qy, qz, qw]";
            Error::invalid(format!("the pose has {} numbers", numbers.len()), remedy)
        })?;
        let checked = given.check_as(ErrorKind::Invalid);
        checked.map(|()| given).or_else(|e| Self::new(given.translation, given.rotation).map_err(|_| e))
    }

    fn unchecked(numbers: &[f64]) -> Option<Self> {
        match *numbers {
            [x, y, z, roll, pitch, yaw] => {
                let [roll, pitch, yaw] = [roll, pitch, yaw].map(f64::to_radians);
                Some(Self::from_xyz_rpy(DVec3::new(x, y, z), roll, pitch, yaw))
            }
            [x, y, z, qx, qy, qz, qw] => {
                Some(Self { translation: DVec3::new(x, y, z), rotation: DQuat::from_xyzw(qx, qy, qz, qw) })
            }
            _ => None,
        }
    }

    /// x, y, z, qx, qy, qz, qw.
    pub fn to_array(&self) -> [f64; 7] {
        let (t, q) = (self.translation, self.rotation);
        [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
    }

    /// From a translation in metres and roll, pitch, yaw in radians about fixed axes:
    /// Rz(yaw) Ry(pitch) Rx(roll), positive pitch looks down (REP-103). The same bits on every machine.
    pub fn from_xyz_rpy(translation: DVec3, roll: f64, pitch: f64, yaw: f64) -> Self {
        let half = |angle: f64| libm::sincos(0.5 * angle);
        Self { rotation: trig::quat_of_halves(half(roll), half(pitch), half(yaw)), translation }
    }

    /// The rigid part of a transform: its origin, its x axis, and the part of its y axis orthogonal to x. The remainder
    /// is scale, mirror and shear. Not finite if an axis has zero length.
    pub fn rigid_part(transform: &DAffine3) -> Self {
        let m = transform.matrix3;
        // Gram-Schmidt, right-handed, so a mirror stays in the remainder.
        let x = m.x_axis.normalize();
        let y = (m.y_axis - x * x.dot(m.y_axis)).normalize();
        let rotation = DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y))).normalize();
        Self { rotation, translation: transform.translation }
    }

    /// The inverse transform.
    #[must_use]
    #[inline]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// The pose at a share of the distance to another: linear in the position, spherically linear in the orientation.
    pub fn between(&self, other: &Self, share: f64) -> Self {
        Self {
            rotation: self.rotation.slerp(other.rotation, share).normalize(),
            translation: self.translation.lerp(other.translation, share),
        }
    }

    /// Transforms a point from frame b to frame a.
    #[inline]
    pub fn transform_point(&self, p_in_b: DVec3) -> DVec3 {
        self.rotation * p_in_b + self.translation
    }

    /// The rotation as a matrix.
    #[inline]
    pub fn rotation_matrix(&self) -> DMat3 {
        DMat3::from_quat(self.rotation)
    }

    /// This transform as a 3 x 4 matrix.
    #[inline]
    pub fn to_affine(&self) -> DAffine3 {
        DAffine3::from_rotation_translation(self.rotation, self.translation)
    }

    /// Roll, pitch, yaw in radians, the inverse of [`Pose::from_xyz_rpy`]; pitch in -pi/2..pi/2.
    pub fn rpy(&self) -> (f64, f64, f64) {
        let m = self.rotation_matrix();
        let pitch = (-m.x_axis.z).clamp(-1.0, 1.0).asin();
        if m.x_axis.x.hypot(m.x_axis.y) < 1e-12 {
            // Gimbal lock: only the difference or sum of roll and yaw is defined. Yaw takes all of it.
            return (0.0, pitch, (-m.y_axis.x).atan2(m.y_axis.y));
        }
        (m.y_axis.z.atan2(m.z_axis.z), pitch, m.x_axis.y.atan2(m.x_axis.x))
    }
}

/// Composition: `a_from_c = a_from_b * b_from_c`, as glam composes transforms. The rotation stays of unit length.
///
/// ```
/// use presight::Pose;
/// use glam::DVec3;
/// let world_from_robot = Pose::from_xyz_rpy(DVec3::X, 0.0, 0.0, 90f64.to_radians());
/// let robot_from_sensor = Pose::from_xyz_rpy(DVec3::X, 0.0, 0.0, 0.0);
/// let world_from_sensor = world_from_robot * robot_from_sensor;
/// assert!((world_from_sensor.translation - DVec3::new(1.0, 1.0, 0.0)).length() < 1e-15);
/// ```
impl Mul for Pose {
    type Output = Self;

    #[inline]
    fn mul(self, b_from_c: Self) -> Self {
        Self {
            rotation: (self.rotation * b_from_c.rotation).normalize(),
            translation: self.transform_point(b_from_c.translation),
        }
    }
}

/// As `[x, y, z, qx, qy, qz, qw]`.
impl Serialize for Pose {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        self.to_array().serialize(serializer)
    }
}

/// From `[x, y, z, qx, qy, qz, qw]` or `[x, y, z, roll_deg, pitch_deg, yaw_deg]`.
impl<'de> Deserialize<'de> for Pose {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let numbers = Vec::<f64>::deserialize(deserializer)?;
        let wrong = || D::Error::custom(format!("a pose of {} numbers; give 6 or 7", numbers.len()));
        let pose = Self::unchecked(&numbers).ok_or_else(wrong)?;
        pose.check().map_err(D::Error::custom)?;
        Ok(pose)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn positive_pitch_looks_down() {
        let p = Pose::from_xyz_rpy(DVec3::ZERO, 0.0, 0.3, 0.0);
        assert!(p.transform_point(DVec3::X).z < 0.0);
    }

    #[test]
    fn nan_is_refused() {
        assert!(Pose::new(DVec3::NAN, DQuat::IDENTITY).is_err());
        for w in [0.0, 2.0, 0.98, 1e200, f64::INFINITY] {
            let e = Pose::new(DVec3::ZERO, DQuat::from_xyzw(0.0, 0.0, 0.0, w)).unwrap_err();
            assert!(e.to_string().contains("quaternion of length"), "{e}");
        }
        assert!(Pose::new(DVec3::ZERO, DQuat::from_xyzw(0.0, 0.0, 0.0, 0.995)).is_ok());
    }

    proptest! {
        #[test]
        fn rpy_round_trips(r in -3.1..3.1f64, p in -1.57..1.57f64, y in -3.1..3.1f64) {
            let pose = Pose::from_xyz_rpy(DVec3::ZERO, r, p, y);
            let (r2, p2, y2) = pose.rpy();
            let again = Pose::from_xyz_rpy(DVec3::ZERO, r2, p2, y2);
            let apart = pose.rotation_matrix() - again.rotation_matrix();
            prop_assert!(apart.to_cols_array().iter().all(|d| d.abs() < 1e-9));
        }

        #[test]
        fn inverse_undoes(x in -1e3..1e3f64, y in -1e3..1e3f64, yaw in -3.0..3.0f64) {
            let pose = Pose::from_xyz_rpy(DVec3::new(x, y, 1.0), 0.1, 0.2, yaw);
            let p = DVec3::new(3.0, -2.0, 5.0);
            let back = pose.inverse().transform_point(pose.transform_point(p));
            prop_assert!((back - p).length() < 1e-9);
        }
    }

    #[test]
    fn poses_keep_their_bits_and_bad_ones_are_refused() {
        let pose = Pose::from_xyz_rpy(DVec3::new(5e6, -0.1, 1.0 / 3.0), 0.1, 0.2, 3.0);
        assert_eq!(serde_json::from_str::<Pose>(&serde_json::to_string(&pose).unwrap()).unwrap(), pose);
        let degrees: Pose = serde_json::from_str("[1, 2, 3, 0, 0, 90]").unwrap();
        assert!((degrees.rotation * DVec3::X - DVec3::Y).length() < 1e-12);
        for bad in ["[1, 2, 3]", "[0, 0, 0, 0, 0, 0, 2]", "[1e300, 0, 0, 0, 0, 0]", "[null, 0, 0, 0, 0, 0]", "{}"] {
            assert!(serde_json::from_str::<Pose>(bad).is_err(), "{bad}");
        }
    }
}
