//! Where to look from at an object in doubt.

use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_read::sensor_toml;
use presight_testkit::caster::Caster;
use presight_testkit::oracle::Oracle;
use presight_update::{Finding, FindingKind, LearnOptions, Learner};

const LIDAR: &str = "format = 1\nkind = \"scanner\"\nclass = \"laser\"\nrange_max = 20\n[azimuth]\nstart_deg = -180\nstep_deg = 1\ncount = 360\n\
    [elevation]\nstart_deg = -20\nstep_deg = 2\ncount = 14\n[noise]\nrange_sigma = 0.01\n[mount]\nxyz = [0.0, 0.0, 1.0]\n";

/// A room of 8 x 6 m. A crate stands in an alcove between two blocks, which opens towards -x, and a pillar stands
/// before the opening, too near for a robot to pass.
fn room() -> Environment {
    let mut environment = Environment::new();
    let mut add = |name: &str, least: DVec3, most: DVec3| {
        let pose = Pose { translation: 0.5 * (least + most), ..Pose::IDENTITY };
        environment.add_cuboid(name, pose, most - least).unwrap();
    };
    add("room", DVec3::ZERO, DVec3::new(8.0, 6.0, 3.0));
    add("crate", DVec3::new(5.0, 2.7, 0.0), DVec3::new(5.6, 3.3, 0.9));
    add("left block", DVec3::new(4.8, 3.5, 0.0), DVec3::new(8.0, 6.0, 3.0));
    add("right block", DVec3::new(4.8, 0.0, 0.0), DVec3::new(8.0, 2.5, 3.0));
    add("pillar", DVec3::new(4.0, 2.4, 0.0), DVec3::new(4.4, 3.6, 3.0));
    environment
}

/// True if a point of the crate's front is in sight, by another library.
fn is_in_sight(oracle: &Oracle, from: DVec3) -> bool {
    let points =
        (0..=60).flat_map(|y| (1..9).map(move |z| DVec3::new(5.0, 2.7 + 0.01 * f64::from(y), 0.1 * f64::from(z))));
    points.into_iter().any(|p| (oracle.distance(from, (p - from).normalize()) - p.distance(from)).abs() < 1e-3)
}

/// By hand: straight before the pillar the nearest free places, 1.3 m from the crate's front, see nothing of it. Places
/// aside, through the gaps of 0.4 m, see it. A robot that had two looks through a gap has to look from there, and so
/// has one whose policy stops at the crate. The pose is free: the robot is 0.3 m in radius.
#[test]
fn a_crate_behind_a_pillar_is_looked_at_from_aside() {
    let world = World::new(room());
    let mut spec = sensor_toml::parse(LIDAR, "lidar", None).unwrap();
    spec.name = "lidar".into();
    let sensor = Sensor::new(spec).unwrap();
    let oracle = Oracle::new(world.environment(), DVec3::new(3.0, 3.0, 1.0)).unwrap();
    let mut caster = Caster::new(world.environment(), sensor, 1);
    let mut learner = Learner::new(LearnOptions::default().with_settle(0.0)).unwrap();
    // Two places that see the crate through the gap, and many before the pillar that do not.
    let seen = [[3.85, 1.75], [3.55, 1.55]];
    let hidden = (0..10).map(|k| [0.7 + 0.29 * f64::from(k), 3.0]);
    for (k, [x, y]) in hidden.chain(seen).enumerate() {
        let pose = Pose::from_xyz_rpy(DVec3::new(x, y, 0.0), 0.0, 0.0, 0.0);
        assert_eq!(is_in_sight(&oracle, pose.translation + DVec3::Z), k >= 10, "{x} {y}");
        let frame = caster.frame(&|_| pose, k as f64, None);
        learner
            .observe_at(
                &world,
                &[&frame],
                &PoseEstimate::new(RobotPose::new(pose), PoseCovariance::from_sigmas([1e-3; 6])),
            )
            .unwrap();
    }
    let again = Pose::from_xyz_rpy(DVec3::new(3.55, 1.55, 0.0), 0.0, 0.0, 0.0);
    let frame = caster.frame(&|_| again, 12.0, None);
    learner
        .observe_at(
            &world,
            &[&frame],
            &PoseEstimate::new(RobotPose::new(again), PoseCovariance::from_sigmas([1e-3; 6])),
        )
        .unwrap();
    learner.end_drive();
    let findings = learner.findings(&world);
    let doubt = findings.doubts.iter().find(|doubt| doubt.object == "crate").expect("two views do not decide");
    let gone = Finding {
        object: "crate".to_owned(),
        kind: FindingKind::Gone,
        l: 9.0,
        views: 3,
        best_view: None,
        growth: Vec::new(),
    };
    let policy = learner.plan_views(&world, &[&gone]).remove(0).expect("a pose to look from");
    let look = doubt.view.clone().expect("a pose to look from");
    assert_eq!(look, policy);
    let p = look.pose.world_from_sensor().translation;
    assert!(is_in_sight(&oracle, p) && (p.z - 1.0).abs() < 1e-3 && look.sensor == "lidar", "{look:?}");
    let free = |p: DVec3| p.x < 3.7 || p.x > 4.0 && p.x < 4.5 && !(2.1..3.9).contains(&p.y) || p.y < 2.1 || p.y > 3.9;
    assert!(p.min_element() >= 0.3 && p.x <= 4.5 && free(p), "{p}");
    // What no free place shows has no such pose.
    let mut shut = room();
    shut.add_cuboid(
        "shutter",
        Pose { translation: DVec3::new(4.7, 3.0, 1.5), ..Pose::IDENTITY },
        DVec3::new(0.1, 1.4, 3.0),
    )
    .unwrap();
    let shut = World::new(shut);
    let mut blind = Learner::new(LearnOptions::default()).unwrap();
    let mut caster = Caster::new(shut.environment(), frame.sensor().clone(), 1);
    for k in 0..2 {
        let frame = caster.frame(&|_| again, f64::from(k), None);
        blind
            .observe_at(
                &shut,
                &[&frame],
                &PoseEstimate::new(RobotPose::new(again), PoseCovariance::from_sigmas([1e-3; 6])),
            )
            .unwrap();
    }
    blind.end_drive();
    assert_eq!(blind.plan_views(&shut, &[&gone]), [None]);
}
