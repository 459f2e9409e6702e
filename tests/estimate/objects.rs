//! Objects with stored pose covariances: their effect on the robot's pose and on verdicts.

use super::*;
use presight_localize::estimate::Freedom;
use presight_localize::simulate::{Disturbances, Simulator};
use presight_localize::verdict::{Verdict, of_coarse_model};
use presight_model::environment::{FeatureLayer, Polygon, PolygonOrder};
use presight_model::geometry::{InObject, PoseCovariance, PoseEstimate, RobotPose};

fn diagonal(variances: [f64; 6]) -> PoseCovariance<InObject> {
    PoseCovariance::from_sigmas(variances.map(f64::sqrt))
}

/// A wall at x = 6: an object with its origin at (6, 0, 0), its own x axis along y, and this stored pose covariance in
/// its own axes.
fn wall(stored: Option<[f64; 6]>) -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("m")).unwrap();
    let corners = [[-4.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 0.0, 3.0], [-4.0, 0.0, 3.0]].map(Vec3::from);
    let polygons = vec![Polygon::new(vec![0, 1, 2, 3], 0)];
    let mesh = Mesh::new("wall", corners.to_vec(), polygons, PolygonOrder::Given).unwrap();
    let pose = Pose::from_xyz_rpy(DVec3::new(6.0, 0.0, 0.0), 0.0, 0.0, std::f64::consts::FRAC_PI_2);
    environment.insert(NewObject::new("wall", pose, Arc::new(mesh))).unwrap();
    if let Some(stored) = stored {
        let pose_covariances = vec![("wall".to_owned(), diagonal(stored))];
        let layer =
            FeatureLayer { class: "laser".into(), tolerance: 0.01, pose_covariances, ..FeatureLayer::default() };
        environment.add_layer(layer).unwrap();
    }
    World::new(environment)
}

/// One ray along x, and a second one without a measurement.
fn ray(range: f32, sigma: f64) -> Frame {
    let table = presight_model::sensor::RayTable::new(2, 1, vec![DVec3::X, DVec3::new(1.0, 0.01, 0.0)]).unwrap();
    let mut spec = SensorSpec::new("ray", "laser", Geometry::Rays(table));
    spec.noise.range_sigma = sigma;
    Frame::new(0.0, Sensor::new(spec).unwrap(), Measurement::Range(vec![range, f32::NAN])).unwrap()
}

/// The ray meets the wall at normal incidence, 2 m from the object's origin. With 5 mm along its own y (the world's x)
/// and 0.01 rad of yaw, the wall's variance there is (5 mm)^2 + (2 m x 0.01)^2 = 4.25e-4 m^2. The information of one
/// range of 1 cm and of a prior of 20 cm is H = 1e4 + 25, and the variance of x is (1e4 + 1e4^2 x 4.25e-4 + 25) / H^2.
/// The object's own x, along the wall, has no effect.
#[test]
fn the_pose_is_no_more_certain_than_the_map() {
    let pose = Pose::from_xyz_rpy(DVec3::new(2.0, 2.0, 1.0), 0.0, 0.0, 0.0);
    let prior =
        PoseEstimate::new(RobotPose::new(pose), PoseCovariance::from_sigmas([0.2, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6]));
    let options = EstimateOptions::default().with_freedom(Freedom::Planar).with_offset_sigma(0.0);
    let variance = |world: &World| {
        let found = estimator(options).estimate(world, &[&ray(4.0, 0.01)], &prior).unwrap();
        assert!(found.is_determined(), "{:?}", found.state);
        found.pose.covariance[0][0]
    };
    let h: f64 = 1e4 + 25.0;
    let near = |got: f64, wanted: f64| assert!((got / wanted - 1.0).abs() < 1e-4, "{got} {wanted}");
    near(variance(&wall(Some([0.7, 25e-6, 0.0, 0.0, 0.0, 1e-4]))), (1e4 + 1e8 * 4.25e-4 + 25.0) / (h * h));
    // Without a stored covariance the wall's offset sigma applies, which is 0 here.
    near(variance(&wall(None)), 1.0 / h);
}

/// A wall that exists with a probability of 1/4 says as much as a quarter of the readings: the information of one range of 1 cm is
/// 2500 / m^2, that of the prior 25.
#[test]
fn an_object_counts_by_its_existence() {
    let pose = Pose::from_xyz_rpy(DVec3::new(2.0, 2.0, 1.0), 0.0, 0.0, 0.0);
    let prior =
        PoseEstimate::new(RobotPose::new(pose), PoseCovariance::from_sigmas([0.2, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6]));
    let options = EstimateOptions::default().with_freedom(Freedom::Planar).with_offset_sigma(0.0);
    let mut world = wall(None);
    for (existence, information) in [(1.0, 10_025.0), (0.25, 2525.0)] {
        let trust = Some(presight_model::environment::Existence { p0: existence, confirmed: 0.0, rate: 0.0 });
        world.apply(presight_model::change::Change::SetTrust { object: "wall".to_owned(), trust }).unwrap();
        let found = estimator(options).estimate(&world, &[&ray(4.01, 0.01)], &prior).unwrap();
        let variance = found.pose.covariance[0][0];
        assert!((variance * information - 1.0).abs() < 1e-3, "{existence}: {variance}");
        // The reading says 1 cm, the prior 0.
        let off = found.pose.world_from_robot.translation.x - pose.translation.x;
        assert!((off + 0.01 * (information - 25.0) / information).abs() < 1e-5, "{existence}: {off}");
    }
}

/// A range is 5 cm short, measured to 5 mm. In front of a known wall that means an object; in front of a wall that may
/// be off by 2 cm it may mean nothing.
#[test]
fn uncertain_walls_are_not_contradicted() {
    let pose = Pose::from_xyz_rpy(DVec3::new(2.0, 2.0, 1.0), 0.0, 0.0, 0.0);
    let verdict = |stored: Option<[f64; 6]>| {
        let (world, frame) = (wall(stored), ray(3.95, 0.005));
        let known = PoseEstimate::exact(RobotPose::new(pose));
        of_coarse_model(&mut predictor(), &world, &frame, &known, 0.001).unwrap().pixels[0]
    };
    assert_eq!(verdict(None), Verdict::Nearer);
    assert_eq!(verdict(Some([0.0, 4e-4, 0.0, 0.0, 0.0, 0.0])), Verdict::Confirmed);
    // Uncertainty along the wall itself has no effect.
    assert_eq!(verdict(Some([0.04, 0.0, 0.04, 0.0, 0.0, 0.0])), Verdict::Nearer);
}

/// The shelf is 4 cm from its place in the map. If only the shelf counts, the robot's pose relative to it is found to
/// millimetres. Where walls fill most of the image, they determine the robot's pose, and the pose relative to the shelf
/// is as wrong as the map.
#[test]
fn docking_is_relative() {
    let map = room(Vec3::ZERO);
    let moved_by = DVec3::new(-0.04, 0.0, 0.0);
    let mut real = map.clone();
    let shelf = Pose { translation: moved_by, ..Pose::IDENTITY };
    real.apply(presight_model::change::Change::SetPose { name: "shelf".into(), world_from_object: shelf }).unwrap();
    let truth = Pose::from_xyz_rpy(DVec3::new(2.0, 3.0, 1.8), 0.0, 0.2, 0.3);
    let none = Disturbances::default().with_drop_outs(0.0).with_mixed_pixels(0.0).with_slip(0.0).with_turn_slip(0.0);
    let frame =
        Simulator::new(predictor(), camera(0.003), none, 4).unwrap().frame(&real, 0.0, &RobotPose::new(truth)).unwrap();
    let prior =
        PoseEstimate::of_sigmas(RobotPose::new(moved(&truth, &[0.01, -0.01, 0.0, 0.0, 0.005, 0.0])), 0.024, 0.01);
    let index = map.environment().index_of("shelf").unwrap();
    let off = |only: Option<u32>| {
        let options = EstimateOptions::default().with_only(only);
        let found = estimator(options).estimate(&map, &[&frame], &prior).unwrap();
        assert!(found.is_determined(), "{only:?}: {:?}", found.state);
        let (relative, covariance) = found.relative_to(&map.environment().objects()[index as usize].world_from_object);
        let error = presight_localize::estimate::motion_between(&relative, &(shelf.inverse() * truth));
        (error[0].abs(), covariance[0][0].sqrt())
    };
    let (by_shelf, sigma) = off(Some(index));
    assert!(by_shelf < 0.005 && by_shelf < 4.0 * sigma && sigma < 0.01, "{by_shelf} {sigma}");
    let (by_room, _) = off(None);
    assert!((by_room - 0.04).abs() < 0.002, "{by_room}");
}
