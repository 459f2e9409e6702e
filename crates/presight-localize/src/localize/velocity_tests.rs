//! By hand: the speed of robots, and its deviation.

use super::*;
use presight_model::geometry::RobotPose;

fn noise() -> MotionNoise {
    let usual = MotionNoise::default().with_most_step(9.0).with_most_turn(9.0);
    MotionNoise { speed: 0.0, turn: 0.0, first_speed: 0.5, first_turn: 0.0, scale: 0.0, scale_drift: 0.0, ..usual }
}

fn known(metres: f64) -> PoseEstimate {
    PoseEstimate::new(RobotPose::IDENTITY, PoseCovariance::from_sigmas([metres, metres, 0.0, 0.0, 0.0, 1e-6]))
}

/// By hand: a quarter turn of radius 1 m in two seconds: pi/4 m/s and pi/4 rad/s lead to (1, 1), turned by 90 degrees.
#[test]
fn a_constant_twist_drives_a_circle() {
    let quarter = std::f64::consts::FRAC_PI_4;
    let end = along(&[quarter, 0.0, 0.0, 0.0, 0.0, quarter], 2.0);
    assert!((end.translation - DVec3::new(1.0, 1.0, 0.0)).length() < 1e-12, "{}", end.translation);
    let back = rate(&end, 2.0);
    assert!((back[0] - quarter).abs() < 1e-12 && back[1].abs() < 1e-12 && (back[5] - quarter).abs() < 1e-12);
    let small = along(&[1.0, 0.0, 0.0, 0.0, 0.0, 1e-6], 1.0);
    assert!((small.translation - DVec3::new(1.0, 5e-7, 0.0)).length() < 1e-12);
}

/// By hand, along x: speed 0 +- 0.5 m/s, position 0 +- 0.1 m. After 2 s the variance of the position is 0.01 + 4 * 0.25 = 1.01, and it
/// shares 2 * 0.25 = 0.5 with the speed. A frame says 1 m with a variance of 0.01: of the 1 m the prior follows 1.01 / 1.02, the
/// speed is then 0.5 / 1.01 * 1.01 / 1.02 = 0.4902 m/s, with a variance of 0.25 - 0.5^2 / 1.02 = 0.0049. y is measured by
/// nothing: its speed stays 0 +- 0.5.
#[test]
fn a_frame_teaches_the_speed_where_it_measures() {
    let mut velocity = Velocity::new(noise());
    let (motion, prior) = velocity.carry(&known(0.1), 2.0, None, Stamps::default(), Freedom::Planar);
    assert_eq!(motion.previous_from_current, Pose::IDENTITY);
    assert!((motion.covariance[0][0] - 1.0).abs() < 1e-12 && (prior.covariance[0][0] - 1.01).abs() < 1e-12);
    let (mut posterior, gain) = (prior, 1.01 / 1.02);
    posterior.world_from_robot.translation.x = gain;
    posterior.covariance[0][0] = 1.01 * 0.01 / 1.02;
    velocity.learn(&prior, &posterior, Freedom::Planar);
    assert!((velocity.twist()[0] - 0.5 / 1.02).abs() < 1e-9, "{:?}", velocity.twist());
    let variance = velocity.twist_covariance();
    assert!((variance[0][0] - (0.25 - 0.25 / 1.02)).abs() < 1e-9, "{}", variance[0][0]);
    assert!(velocity.twist()[1] == 0.0 && (variance[1][1] - 0.25).abs() < 1e-12);
    // One second on, x is at 0.99 + 0.49 m, and y is not known to 0.5 * 3 s.
    let (_, next) = velocity.carry(&posterior, 1.0, None, Stamps::default(), Freedom::Planar);
    assert!((next.world_from_robot.translation.x - (gain + 0.5 / 1.02)).abs() < 1e-9);
    assert!((next.covariance[1][1] - (0.01 + 9.0 * 0.25)).abs() < 1e-9, "{}", next.covariance[1][1]);
}

/// By hand: in one second odometry says 1 m with a deviation of 0.5 m; the speed was 0 +- 0.5 m/s. Both weigh the same: 0.5 m/s,
/// with a variance of 0.125.
#[test]
fn odometry_is_weighed_against_what_is_known() {
    let mut velocity = Velocity::new(noise());
    let ahead = Pose { translation: DVec3::X, ..Pose::IDENTITY };
    let odometry = Motion { previous_from_current: ahead, covariance: PoseCovariance::from_sigmas([0.5; 6]) };
    let (motion, to) = velocity.carry(&known(0.1), 1.0, Some(&odometry), Stamps::default(), Freedom::Planar);
    assert_eq!(motion, odometry);
    assert!((to.world_from_robot.translation.x - 0.5).abs() < 1e-9);
    assert!((to.covariance[0][0] - (0.01 + 0.125)).abs() < 1e-9, "{}", to.covariance[0][0]);
}

/// Wheels that seem 10 % too large: odometry says 1.1 m for every metre and frames are exact, so the scale is learnt, and then the
/// robot is predicted where it is without a frame.
#[test]
fn a_scale_of_odometry_is_learnt() {
    let noise = MotionNoise { scale: 0.1, speed: 1.0, ..noise() };
    let mut velocity = Velocity::new(noise);
    let ahead = Pose { translation: DVec3::X * 1.1, ..Pose::IDENTITY };
    let covariance = PoseCovariance::from_sigmas([0.02, 0.02, 1e-3, 1e-3, 1e-3, 1e-3]);
    let odometry = Motion { previous_from_current: ahead, covariance };
    let mut belief = known(0.001);
    for k in 1..=20 {
        let (_, prior) = velocity.carry(&belief, 1.0, Some(&odometry), Stamps::default(), Freedom::Planar);
        belief = PoseEstimate { covariance: known(0.001).covariance, ..prior };
        belief.world_from_robot.translation.x = f64::from(k);
        velocity.learn(&prior, &belief, Freedom::Planar);
    }
    let [(scale, sigma), _] = velocity.scales();
    assert!((scale - 0.1).abs() < 0.005 && sigma < 0.01, "{scale} {sigma}");
    let (_, prior) = velocity.carry(&belief, 1.0, Some(&odometry), Stamps::default(), Freedom::Planar);
    assert!((prior.world_from_robot.translation.x - 21.0).abs() < 0.005, "{}", prior.world_from_robot.translation);
}

/// A pose from elsewhere has no correlation with the twist: the next frame teaches the twist by the motion alone.
#[test]
fn a_pose_from_elsewhere_shares_nothing() {
    let mut velocity = Velocity::new(noise());
    let (_, prior) = velocity.carry(&known(0.1), 2.0, None, Stamps::default(), Freedom::Planar);
    let elsewhere = PoseEstimate { covariance: known(0.3).covariance, ..prior };
    let (_, next) = velocity.carry(&elsewhere, 1.0, None, Stamps::default(), Freedom::Planar);
    assert!((next.covariance[0][0] - (0.09 + 0.25)).abs() < 1e-12, "{}", next.covariance[0][0]);
}

/// By hand: at 1 m/s a stamp that errs by 20 ms errs by 2 cm on the way, and nothing across it; half a second before, the robot was
/// half a metre back.
#[test]
fn a_moving_robot_is_elsewhere_when_its_stamp_is_wrong() {
    let mut velocity = Velocity::new(MotionNoise { first_speed: 0.0, ..noise() });
    velocity.twist[0] = 1.0;
    let then = velocity.before(&known(0.01), 0.5, 0.02, Freedom::Planar);
    assert!((then.world_from_robot.translation + DVec3::X * 0.5).length() < 1e-12);
    let covariance = then.covariance;
    assert!((covariance[0][0] - 5e-4).abs() < 1e-9 && (covariance[1][1] - 1e-4).abs() < 1e-9, "{covariance:?}");
}

/// By hand: half of a motion of 0.1 s differs from its mean as half of the difference of its halves, with a variance of
/// 0.6^2 x 0.1 / 12 = 0.003 (m/s)^2: 5 cm before, the robot is unsure by sqrt(0.003) x 0.05 s = 2.7 mm more. A speed of 0.9 m/s
/// in the motion before and 1 m/s in this one goes on as 1.025 m/s in the second half of this one, and 1.05 m/s at its end.
#[test]
fn the_speed_goes_on_as_it_has_changed() {
    let mut velocity = Velocity::new(MotionNoise { first_speed: 0.0, speed: 0.6, ..noise() });
    (velocity.twist[0], velocity.seconds) = (1.0, 0.1);
    let then = velocity.before(&known(0.01), 0.05, 0.0, Freedom::Planar);
    let more = 0.36 * 0.1 / 12.0 * 0.05 * 0.05;
    assert!((then.covariance[0][0] - (1e-4 + more)).abs() < 1e-12, "{}", then.covariance[0][0]);
    velocity.earlier = Some(([0.9, 0.0, 0.0, 0.0, 0.0, 0.0], 0.1));
    let (half, end) = (velocity.within(-0.05, 0.0).0[0], velocity.within(-0.05, 0.05).0[0]);
    assert!((half - 1.025).abs() < 1e-12 && (end - 1.05).abs() < 1e-12, "{half} {end}");
}

/// Robots whose speed is a random walk of (0.6 m/s)^2 a second, as stated, of a hundredth of that, and one that drives evenly. All
/// frames are exact. The least density is a hundredth of the stated one. By hand: the mean of 33 motions errs by a quarter (one standard deviation).
#[test]
fn the_change_of_the_speed_is_learnt() {
    for (density, least, most) in [(0.36, 0.18, 0.72), (0.0036, 0.002, 0.009), (0.0, 0.0, 0.0037)] {
        let mut velocity = Velocity::new(MotionNoise { speed: 0.6, ..noise() });
        let (mut random, mut belief) = (presight_model::random::SplitMix64(9), known(1e-4));
        let (mut x, mut speed, mut sum) = (0.0, 0.5, 0.0);
        for k in 0..300 {
            for _ in 0..20 {
                speed += random.normal((density * 0.005f64).sqrt());
                x += 0.005 * speed;
            }
            let (_, prior) = velocity.carry(&belief, 0.1, None, Stamps::default(), Freedom::Planar);
            belief = PoseEstimate { covariance: known(1e-4).covariance, ..prior };
            belief.world_from_robot.translation.x = x;
            velocity.learn(&prior, &belief, Freedom::Planar);
            sum += if k < 100 { 0.0 } else { velocity.density(0) / 200.0 };
        }
        assert!((least..=most).contains(&sum), "{sum} instead of {density}");
    }
}

/// A robot that drives on at 1 m/s while its odometry has frozen. With what the odometry states it would be predicted 8 cm off, nine
/// deviations. Its mistrust ends where the prediction is as far off as its covariance says, by hand at 1.7 deviations along the way
/// (the mean over three axes is 1): 2.8 cm. That the odometry contradicts the frames is known.
#[test]
fn frozen_odometry_is_not_believed() {
    let mut velocity = Velocity::new(MotionNoise { speed: 0.6, scale: 0.05, ..noise() });
    let covariance = PoseCovariance::from_sigmas([0.01, 0.01, 0.01, 0.005, 0.005, 0.005]);
    let mut belief = known(0.002);
    let (mut off, mut sigma) = (f64::NAN, f64::NAN);
    for k in 1..=30 {
        let step = if k <= 15 { 0.1 } else { 0.0 };
        let ahead = Pose { translation: DVec3::X * step, ..Pose::IDENTITY };
        let odometry = Motion { previous_from_current: ahead, covariance };
        let (_, prior) = velocity.carry(&belief, 0.1, Some(&odometry), Stamps::default(), Freedom::Planar);
        off = prior.world_from_robot.translation.x - 0.1 * f64::from(k);
        sigma = prior.covariance[0][0].sqrt();
        belief = PoseEstimate { covariance: known(0.002).covariance, ..prior };
        belief.world_from_robot.translation.x = 0.1 * f64::from(k);
        velocity.learn(&prior, &belief, Freedom::Planar);
        assert!(k > 15 || off.abs() < 0.06 && velocity.contradicted().0 == 0, "{k}: {off}");
    }
    assert!(off.abs() < 0.035 && off.abs() < 2.0 * sigma, "{off} +- {sigma}");
    assert!(velocity.contradicted().0 > 0, "{:?}", velocity.contradicted());
}
