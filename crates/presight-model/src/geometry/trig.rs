//! Sine and cosine with the same bits on every machine: computed by `libm`, exact at quarter turns.

use glam::{DMat3, DQuat};
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

/// Sine and cosine of `numerator / denominator` of a quarter turn, both >= 0 and the first at most the second.
fn in_quarter(numerator: f64, denominator: f64) -> (f64, f64) {
    // Measured from the nearer axis, so that mirrored angles get mirrored values.
    if 2.0 * numerator > denominator {
        let (s, c) = libm::sincos((denominator - numerator) / denominator * FRAC_PI_2);
        (c, s)
    } else if 2.0 * numerator == denominator {
        (FRAC_1_SQRT_2, FRAC_1_SQRT_2)
    } else {
        libm::sincos(numerator / denominator * FRAC_PI_2)
    }
}

fn in_quadrant(quadrant: u8, (s, c): (f64, f64)) -> (f64, f64) {
    let (s, c) = match quadrant {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    };
    // No negative zeros.
    (s + 0.0, c + 0.0)
}

/// Sine and cosine of `k / n` of a full turn. The corners of a regular polygon: symmetric to the last bit.
pub fn sin_cos_of_turn(k: u32, n: u32) -> (f64, f64) {
    let quarters = 4 * (u64::from(k) % u64::from(n.max(1)));
    let n = u64::from(n.max(1));
    in_quadrant((quarters / n) as u8, in_quarter((quarters % n) as f64, n as f64))
}

/// Sine and cosine of degrees: exact at multiples of 90, equal at 45. NaN for non-finite angles.
pub fn sin_cos_deg(deg: f64) -> (f64, f64) {
    // The remainder is exact.
    let rest = deg % 360.0;
    let rest = if rest < 0.0 { rest + 360.0 } else { rest };
    let quadrant = (rest / 90.0).floor();
    in_quadrant((quadrant as i64).rem_euclid(4) as u8, in_quarter(rest - 90.0 * quadrant, 90.0))
}

/// Rz(yaw) Ry(pitch) Rx(roll) as a matrix, from degrees; exact at multiples of 90.
pub fn rotation_deg(roll: f64, pitch: f64, yaw: f64) -> DMat3 {
    let ((sr, cr), (sp, cp), (sy, cy)) = (sin_cos_deg(roll), sin_cos_deg(pitch), sin_cos_deg(yaw));
    let x = DMat3::from_cols_array(&[1.0, 0.0, 0.0, 0.0, cr, sr, 0.0, -sr, cr]);
    let y = DMat3::from_cols_array(&[cp, 0.0, -sp, 0.0, 1.0, 0.0, sp, 0.0, cp]);
    let z = DMat3::from_cols_array(&[cy, sy, 0.0, -sy, cy, 0.0, 0.0, 0.0, 1.0]);
    z * y * x
}

/// Rz(yaw) Ry(pitch) Rx(roll) as a unit quaternion, from degrees.
pub fn quat_deg(roll: f64, pitch: f64, yaw: f64) -> DQuat {
    let half = |deg: f64| sin_cos_deg(0.5 * deg);
    quat_of_halves(half(roll), half(pitch), half(yaw))
}

/// Rz(yaw) Ry(pitch) Rx(roll), from sine and cosine of the half angles.
pub(super) fn quat_of_halves(roll: (f64, f64), pitch: (f64, f64), yaw: (f64, f64)) -> DQuat {
    let x = DQuat::from_xyzw(roll.0, 0.0, 0.0, roll.1);
    let y = DQuat::from_xyzw(0.0, pitch.0, 0.0, pitch.1);
    let z = DQuat::from_xyzw(0.0, 0.0, yaw.0, yaw.1);
    z * y * x
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn quarter_turns_are_exact_and_what_is_not_finite_stays_so() {
        for k in -8i32..=8 {
            let (s, c) = sin_cos_deg(90.0 * f64::from(k));
            let expected = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][k.rem_euclid(4) as usize];
            assert_eq!((s, c), expected, "{k}");
        }
        assert!(sin_cos_deg(f64::NAN).0.is_nan() && sin_cos_deg(f64::INFINITY).1.is_nan());
        assert_eq!(rotation_deg(0.0, 0.0, 90.0) * glam::DVec3::X, glam::DVec3::Y);
        assert_eq!(rotation_deg(90.0, 0.0, 0.0) * glam::DVec3::Y, glam::DVec3::Z);
        assert_eq!(rotation_deg(0.0, 90.0, 0.0) * glam::DVec3::X, glam::DVec3::NEG_Z);
    }

    proptest! {
        #[test]
        fn degrees_and_turns_agree_with_the_standard_library(
            deg in -2000.0..2000.0f64,
            k in 0..5000u32,
            n in 1..5000u32,
        ) {
            let (s, c) = sin_cos_deg(deg);
            let (s2, c2) = deg.to_radians().sin_cos();
            prop_assert!((s - s2).abs() < 1e-14 * deg.abs().max(1.0) && (c - c2).abs() < 1e-14 * deg.abs().max(1.0));
            let (s, c) = sin_cos_of_turn(k, n);
            let (s2, c2) = (std::f64::consts::TAU * f64::from(k % n) / f64::from(n)).sin_cos();
            prop_assert!((s - s2).abs() < 1e-14 && (c - c2).abs() < 1e-14);
        }

        #[test]
        fn matrix_and_quaternion_agree(r in -400.0..400.0f64, p in -400.0..400.0f64, y in -400.0..400.0f64) {
            let apart = DMat3::from_quat(quat_deg(r, p, y)) - rotation_deg(r, p, y);
            prop_assert!(apart.to_cols_array().iter().all(|d| d.abs() < 1e-14));
        }
    }
}
