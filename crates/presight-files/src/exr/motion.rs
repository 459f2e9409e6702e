//! The motion of a scan as text: `twist` and six numbers, or `path` and eight numbers for each pose.

use glam::{DQuat, DVec3};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::{Pose, Twist};
use presight_model::measured::ScanMotion;

/// The text of a motion; every bit of its numbers is kept.
pub(super) fn to_text(motion: &ScanMotion) -> String {
    let words = |numbers: &[f64]| numbers.iter().map(|x| format!(" {x}")).collect::<String>();
    match motion {
        ScanMotion::Twist(twist) => {
            format!("twist{}", words(&[twist.linear.to_array(), twist.angular.to_array()].concat()))
        }
        ScanMotion::Path(poses) => {
            let numbers = |(t, pose): &(f64, Pose)| {
                words(&[&[*t][..], &pose.translation.to_array(), &pose.rotation.to_array()].concat())
            };
            format!("path{}", poses.iter().map(numbers).collect::<String>())
        }
    }
}

/// Reads [`to_text`].
pub(super) fn from_text(text: &str) -> Result<ScanMotion> {
    let wrong = |what: String| {
        Error::invalid(what, "write twist vx vy vz wx wy wz, or path and t x y z qx qy qz qw for each pose")
    };
    let mut words = text.split_whitespace();
    let kind = words.next().unwrap_or_default();
    let numbers: Vec<f64> = words
        .map(|word| {
            word.parse::<f64>().ok().filter(|x| x.is_finite()).ok_or_else(|| wrong(format!("{word:?} is not a number")))
        })
        .collect::<Result<_>>()?;
    match (kind, numbers.len()) {
        ("twist", 6) => {
            Ok(ScanMotion::Twist(Twist::new(DVec3::from_slice(&numbers), DVec3::from_slice(&numbers[3..]))))
        }
        ("path", count) if count > 0 && count.is_multiple_of(8) => {
            let pose = |n: &[f64]| {
                let pose = Pose { translation: DVec3::from_slice(&n[1..]), rotation: DQuat::from_slice(&n[4..]) };
                pose.check_as(ErrorKind::Invalid).map(|()| (n[0], pose))
            };
            ScanMotion::path(numbers.chunks(8).map(pose).collect::<Result<_>>()?)
        }
        (_, count) => Err(wrong(format!("is {kind:?} with {count} numbers"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motions_keep_every_bit_and_bad_text_is_refused() {
        let twist = ScanMotion::Twist(Twist::new(DVec3::new(1.5, -0.1, 1.0 / 3.0), DVec3::new(0.0, 1e-17, 1.2)));
        let pose = |x: f64| Pose::from_xyz_rpy(DVec3::new(x, 0.1, 1.0 / 7.0), 0.1, 0.2, x);
        let path = ScanMotion::path(vec![(-0.05, pose(0.0)), (0.05, pose(0.3))]).unwrap();
        for motion in [twist, path] {
            assert_eq!(from_text(&to_text(&motion)).unwrap(), motion);
        }
        for bad in ["", "twist 1 2 3", "turn 1 2 3 4 5 6", "twist 1 2 3 4 5 nan", "path 0 0 0 0 0 0 0 1", "path 0 0"] {
            assert!(from_text(bad).is_err(), "{bad}");
        }
    }
}
