//! Frames that show nothing known are named, and the next ones are found again.

use super::rooms::sensor;
use glam::{DVec3, Vec3};
use presight_explore::{ExploreOptions, Follower, Known};
use presight_localize::motion::{motion_between, nees};
use presight_localize::simulate::{Disturbances, Simulator};
use presight_model::environment::{Environment, NewObject};
use presight_model::geometry::{Pose, RobotPose};
use presight_model::measured::Frame;
use presight_model::statistics::chi_squared_quantile;
use presight_model::world::World;
use presight_predict::predict::{Options, Predictor};
use presight_testkit::scenes::{cuboid, empty};

/// A room around the origin whose sides all differ.
pub(crate) fn room() -> Environment {
    let mut environment = empty();
    let mut add = |name: &str, low: [f32; 3], high: [f32; 3]| {
        let mesh = cuboid(Vec3::from(low), Vec3::from(high));
        environment.insert(NewObject::new(name, Pose::IDENTITY, mesh.into())).unwrap();
    };
    add("room", [-2.2, -2.0, -1.0], [2.4, 1.8, 1.3]);
    add("chest", [1.5, -0.6, -1.0], [2.0, 0.1, -0.2]);
    add("pillar", [0.9, 1.1, -1.0], [1.2, 1.4, 1.0]);
    add("table", [-1.6, 0.6, -1.0], [-0.8, 1.3, -0.1]);
    add("shelf", [-2.1, -1.2, -1.0], [-1.7, -0.4, 0.6]);
    add("box", [-0.3, -1.8, -1.0], [0.4, -1.3, 0.0]);
    environment
}

fn look(yaw: f64) -> Pose {
    Pose::from_xyz_rpy(DVec3::new(0.1 * yaw, 0.05 * yaw, 0.2), 0.0, 0.2, yaw)
}

/// The frames at these yaws, one a tenth of a second.
fn frames(real: &Environment, yaws: &[f64], start: f64, seed: u64) -> Vec<(Frame, Pose)> {
    let predictor = Predictor::new(Options::default()).unwrap();
    let mut simulator = Simulator::new(predictor, sensor(), Disturbances::default(), seed).unwrap();
    let world = World::new(real.clone());
    let at = |(k, yaw): (usize, &f64)| {
        let pose = look(*yaw);
        (simulator.frame(&world, start + 0.1 * k as f64, &RobotPose::new(pose)).unwrap(), pose)
    };
    yaws.iter().enumerate().map(at).collect()
}

fn follower() -> Follower {
    Follower::new(RobotPose::new(look(0.0)), Environment::new(), Known::Explored, &ExploreOptions::default()).unwrap()
}

/// The times of the frames that are not in the first one's group, in tenths of a second.
fn apart(follower: &Follower) -> Vec<Vec<i64>> {
    let tenths = |stamps: Vec<f64>| stamps.into_iter().map(|t| (10.0 * t).round() as i64).collect();
    follower.apart().into_iter().map(tenths).collect()
}

/// A look far to the left is a group of its own until a slow turn joins it. A frame of elsewhere stays alone.
#[test]
fn frames_of_elsewhere_are_kept_until_they_are_joined() {
    let turn = (0..6).map(|k| 0.1 * f64::from(k));
    let yaws: Vec<f64> = [0.0, 0.05, 0.1, 2.2, 2.25].into_iter().chain(turn).collect();
    let drive = frames(&room(), &yaws, 0.0, 7);
    let mut elsewhere = empty();
    let hall = cuboid(Vec3::new(-7.0, -5.0, -3.0), Vec3::new(7.5, 6.0, 4.0));
    elsewhere.insert(NewObject::new("hall", Pose::IDENTITY, hall.into())).unwrap();
    let strange = frames(&elsewhere, &[0.3], 100.0, 7);
    let mut follower = follower();
    for (frame, _) in drive.iter().chain(&strange) {
        let found = follower.add(frame).unwrap();
        println!(
            "{} s: {:.5?}",
            frame.stamp,
            found.map(|f| (f.pose.world_from_robot.translation, f.pose.covariance.sigmas()))
        );
    }
    assert_eq!(apart(&follower), [vec![3, 4], vec![1000]]);
    let rest: Vec<f64> = (0..9).map(|k| 0.5 + 0.2 * f64::from(k)).collect();
    let rest = frames(&room(), &rest, 200.0, 7);
    for (frame, _) in &rest {
        follower.add(frame).unwrap();
    }
    follower.finish().unwrap();
    assert_eq!(apart(&follower), [[1000]]);
    // Each view is where it was taken.
    let views = follower.into_views();
    assert_eq!(views.all().len(), drive.len() + rest.len());
    for view in views.all() {
        let (_, truth) = drive.iter().chain(&rest).find(|(frame, _)| frame.stamp == view.stamp).unwrap();
        let off = view.pose.world_from_sensor().translation.distance(truth.translation);
        let turned = view.pose.world_from_sensor().rotation.angle_between(truth.rotation).to_degrees();
        println!("{} s: {off:.4} m, {turned:.3} deg", view.stamp);
        assert!(off < 0.03 && turned < 1.0, "{} s: {off} m, {turned} deg", view.stamp);
    }
}

/// The robot looks away, and turns back until its second group meets the first one. The error of its pose is then the
/// stated one: squared errors by their covariance (NEES), over all seeds.
#[test]
fn the_pose_after_a_join_is_off_by_what_is_stated() {
    let (mut sum, seeds) = (0.0, presight_testkit::env_number("SEEDS", 2));
    for seed in 0..seeds {
        let back = (0..13).map(|k| 2.2 - 0.2 * f64::from(k));
        let yaws: Vec<f64> = [0.0, 0.1].into_iter().chain(back).collect();
        let mut follower = follower();
        let mut last = None;
        for (frame, truth) in frames(&room(), &yaws, 0.0, seed) {
            let found = follower.add(&frame).unwrap();
            if let Some(found) = found {
                let own = nees(&found.pose, &RobotPose::new(truth)).0;
                let (off, stated) =
                    (motion_between(&truth, &found.pose.world_from_robot), found.pose.covariance.sigmas());
                println!("{seed} {}: off {off:.5?}, stated {stated:.5?}, NEES {own:.1}", frame.stamp);
                last = Some((frame.stamp, own));
            } else {
                println!("{seed} {}: apart {:?}", frame.stamp, apart(&follower));
            }
        }
        let (stamp, own) = last.unwrap();
        assert!(stamp > 0.7, "seed {seed}: the groups met at {stamp} s");
        sum += own;
    }
    let most = chi_squared_quantile(6 * seeds as u32, 3.09);
    println!("NEES {sum:.1}, at most {most:.1}");
    assert!(sum < most, "{sum}");
}
