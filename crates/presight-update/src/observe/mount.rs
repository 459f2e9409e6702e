//! Mean correction of the stated poses by the readings. A wrong mount shifts the poses of all views in the same
//! direction.

use glam::DVec3;
use presight_localize::motion::motion_between;
use presight_model::geometry::PoseEstimate;
use presight_model::matrix::quadratic;
use presight_model::statistics::NOISE_BOUND;

/// Minimum number of views for a verdict.
const MIN_VIEWS: f64 = 10.0;

/// Sums over views of the corrections of their poses.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PoseCorrections {
    views: f64,
    /// Along the robot's axes, metres and radians.
    by: [f64; 6],
    /// In stated standard deviations.
    deviations: [f64; 6],
}

impl PoseCorrections {
    /// The correction of one view, from the stated pose to the pose by its readings.
    pub fn of(stated: &PoseEstimate, found: &PoseEstimate) -> Self {
        let off = motion_between(&stated.world_from_robot, &found.world_from_robot);
        let turn = stated.world_from_robot.rotation;
        let mut correction = Self { views: 1.0, ..Self::default() };
        for (k, axis) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
            let axis = (turn * axis).to_array();
            for first in [0, 3] {
                let along: f64 = (0..3).map(|i| axis[i] * off[first + i]).sum();
                let gradient =
                    std::array::from_fn(|i| if (first..first + 3).contains(&i) { axis[i - first] } else { 0.0 });
                let variance = quadratic(stated.covariance.as_rows(), &gradient);
                correction.by[first + k] = along;
                correction.deviations[first + k] = if variance > 0.0 { along / variance.sqrt() } else { 0.0 };
            }
        }
        correction
    }

    pub fn add(&mut self, other: &Self) {
        self.views += other.views;
        (0..6).for_each(|i| {
            (self.by[i], self.deviations[i]) = (self.by[i] + other.by[i], self.deviations[i] + other.deviations[i])
        });
    }

    /// Returns why all findings are unreliable, if the mean correction exceeds the stated error. All views may share
    /// one such error.
    pub fn wrong(&self) -> Option<String> {
        let far = self.deviations.iter().any(|sum| (sum / self.views).abs() > NOISE_BOUND);
        (self.views >= MIN_VIEWS && far).then(|| {
            let [x, y, z, roll, pitch, yaw] = self.by.map(|sum| sum / self.views);
            format!(
                "{} views put the sensor {x:.3}, {y:.3}, {z:.3} m and {:.1}, {:.1}, {:.1} degrees from where its \
                 mount and the poses have it: check the mount and the map",
                self.views,
                roll.to_degrees(),
                pitch.to_degrees(),
                yaw.to_degrees()
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::geometry::{Pose, PoseCovariance, RobotPose};

    /// The stated deviations are 1 degree and 1 cm. Two robots with different headings have a sensor 4 degrees and 5 cm
    /// to the left of its stated mount: both corrections are the same in the robots' axes. Errors of the same size with
    /// alternating signs are not reported.
    #[test]
    fn a_wrong_mount_is_reported() {
        let rad = 1f64.to_radians();
        let covariance = PoseCovariance::from_sigmas([0.01, 0.01, 0.01, rad, rad, rad]);
        let view = |heading: f64, sign: f64| {
            let stated = Pose::from_xyz_rpy(DVec3::new(heading, 2.0, 0.0), 0.0, 0.0, heading);
            let found = stated * Pose::from_xyz_rpy(DVec3::new(0.0, sign * 0.05, 0.0), 0.0, 0.0, sign * 4.0 * rad);
            PoseCorrections::of(
                &PoseEstimate::new(RobotPose::new(stated), covariance),
                &PoseEstimate::new(RobotPose::new(found), covariance),
            )
        };
        let (mut same, mut changing) = (PoseCorrections::default(), PoseCorrections::default());
        for k in 0..12 {
            assert!(same.wrong().is_none() || k >= 10, "too few views");
            same.add(&view(0.5 * f64::from(k), 1.0));
            changing.add(&view(0.5 * f64::from(k), if k % 2 == 0 { 1.0 } else { -1.0 }));
        }
        let why = same.wrong().unwrap();
        assert!(why.contains("0.000, 0.050, 0.000 m and 0.0, 0.0, 4.0 degrees"), "{why}");
        assert!(changing.wrong().is_none());
    }
}
