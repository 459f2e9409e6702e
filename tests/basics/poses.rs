//! Every entry point of the library refuses an invalid sensor pose: an image of misses would read as free space.

use presight_testkit as common;

use common::scenes;
use glam::{DMat3, DQuat, DVec3, Vec3};
use presight_features::roi::{FeatureErrorModel, Viewpoint};
use presight_features::{
    BoxOptions, BoxQuery, FeatureOptions, FeaturePrediction, FeatureSettings, PlacedFeature, add_boxes, place,
    predict_features,
};
use presight_model::environment::{Environment, FeatureShape, Material, Mesh, NewObject};
use presight_model::error::{Error, ErrorKind};
use presight_model::geometry::{Pose, PoseCovariance, RobotPose, SensorPose};
use presight_model::index::Region;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::engine::EngineKind;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_predict::virtual_sensors::{Settings, View, VirtualSensor};
use presight_render::plan::region_of;
use presight_render::plan::{FramePlan, Images, Stats};
use presight_render::points::{PointCloud, PointsFrame};

/// A description of the fault, a pose with it, and the words that the message must contain.
fn bad() -> Vec<(&'static str, Pose, &'static str)> {
    let at = |translation| Pose { translation, ..Pose::IDENTITY };
    let turned = |x, y, z, w| Pose { rotation: DQuat::from_xyzw(x, y, z, w), ..Pose::IDENTITY };
    let (nan, inf) = (f64::NAN, f64::INFINITY);
    vec![
        ("x is NaN", at(DVec3::new(nan, 0.0, 1.0)), "not finite"),
        ("z is infinite", at(DVec3::new(0.0, 0.0, inf)), "not finite"),
        ("y is minus infinite", at(DVec3::new(0.0, -inf, 0.0)), "not finite"),
        ("too far", at(DVec3::new(0.0, 2e12, 0.0)), "too far away"),
        ("the rotation is NaN", turned(0.0, nan, 0.0, 1.0), "not finite"),
        ("the rotation is infinite", turned(0.0, 0.0, 0.0, inf), "not finite"),
        ("no rotation", turned(0.0, 0.0, 0.0, 0.0), "length 0,"),
        ("too long", turned(0.0, 0.0, 0.0, 2.0), "length 2,"),
        ("a little too short", turned(0.0, 0.0, 0.0, 1.0 - 1e-6), "is not a rotation"),
        ("overflows", turned(1e200, 0.0, 0.0, 0.0), "is not a rotation"),
    ]
}

fn refused<T>(door: &str, what: &str, said: &str, result: Result<T, Error>) {
    let Err(e) = result else { panic!("{door} takes a pose where {what}") };
    let text = e.to_string();
    assert_eq!(e.kind(), ErrorKind::Usage, "{door}: {text}");
    assert!(text.contains("the pose [") && text.contains(said), "{door}, {what}: {text}");
    assert!(!e.remedy().is_empty() && !text.contains('\n'), "{door}: {text}");
}

struct Scene {
    world: World,
    sensor: Sensor,
    images: Images,
    placed: Vec<PlacedFeature>,
}

fn scene() -> Scene {
    let (world, sensor) = (scenes::room_world(5, 3), scenes::camera(24, 18));
    let images = common::reference(&common::plan(&world, &sensor, &Pose::IDENTITY));
    let layer = presight_features::generate::generate(world.environment(), "video", &Default::default()).unwrap().layer;
    let placed = place(&world, &layer).unwrap();
    assert!(placed.len() > 10);
    Scene { world, sensor, images, placed }
}

/// Predictors with both engines, or only the CPU engine without an adapter.
fn predictors() -> Vec<Predictor> {
    let open = |backend| Predictor::new(Options::new(backend).with_threads(1)).ok();
    [Backend::Cpu, Backend::Gpu].into_iter().filter_map(open).collect()
}

#[test]
fn a_predictor_refuses_it_and_stays_usable() {
    let s = scene();
    let request = Request::default();
    for mut predictor in predictors() {
        for (what, pose, said) in bad() {
            refused("predict", what, said, predictor.predict(&s.world, &s.sensor, &SensorPose::new(pose), &request));
            for placed in [s.placed.clone(), Vec::new()] {
                let request = request.clone().with_features(FeatureOptions::default().with_placed(placed));
                refused(
                    "predict",
                    what,
                    said,
                    predictor.predict(&s.world, &s.sensor, &SensorPose::new(pose), &request),
                );
                let request = request.with_regions(BoxOptions::default());
                refused(
                    "predict",
                    what,
                    said,
                    predictor.predict(&s.world, &s.sensor, &SensorPose::new(pose), &request),
                );
                let mut prediction = predictor.predict(&s.world, &s.sensor, &SensorPose::IDENTITY, &request).unwrap();
                refused(
                    "predict_again",
                    what,
                    said,
                    predictor.predict_again(&s.world, &SensorPose::new(pose), &mut prediction),
                );
            }
            let again = predictor.predict(&s.world, &s.sensor, &SensorPose::IDENTITY, &request).unwrap();
            assert_eq!(again.images.polygon_id, s.images.polygon_id, "{what}: the next prediction is right");
        }
    }
}

#[test]
fn plans_and_regions_refuse_it() {
    let s = scene();
    let request = Request::default();
    let shape = FeatureShape::Point { at: DVec3::X, covariance: DMat3::ZERO };
    let covariance = PoseCovariance::ZERO;
    for (what, pose, said) in bad() {
        refused("FramePlan::new", what, said, FramePlan::new(&s.world, &s.sensor, &pose, &request));
        let mut plan = common::plan(&s.world, &s.sensor, &Pose::IDENTITY);
        let before = plan.runs.clone();
        refused("FramePlan::renew", what, said, plan.renew(&s.world, &s.sensor, &pose, &request));
        assert_eq!((plan.world_from_sensor, &plan.runs), (Pose::IDENTITY, &before), "{what}: it is as it was");
        for sensor in [&s.sensor, &scenes::scanner(36, 5), &scenes::all_round(12, 7)] {
            refused("region_of", what, said, region_of(sensor, &pose));
        }
        refused("Region::segment", what, said, Region::segment(&pose, 0.0, 1.0, (-0.1, 0.1), 5.0));
        refused("Viewpoint::new", what, said, Viewpoint::new(&pose, &covariance));
        let good = Pose::IDENTITY;
        refused("Uncertain::new", what, said, FeatureErrorModel::new(&pose, &covariance, &good, None, &shape));
        refused("Uncertain::new", what, said, FeatureErrorModel::new(&good, &covariance, &pose, None, &shape));
    }
}

#[test]
fn functions_of_images_refuse_it() {
    let s = scene();
    for (what, pose, said) in bad() {
        let options = FeatureSettings::default();
        for placed in [&s.placed[..], &[]] {
            let seen = predict_features(&s.world, &s.sensor, &pose, &s.images, placed, &options);
            refused("predict_features", what, said, seen);
        }
        let mut none = FeaturePrediction::default();
        refused(
            "add_boxes",
            what,
            said,
            add_boxes(
                &mut none,
                &BoxQuery {
                    placed: &[],
                    world: &s.world,
                    sensor: &s.sensor,
                    world_from_sensor: &pose,
                    options: &BoxOptions::default(),
                },
            ),
        );
        for frame in [PointsFrame::Sensor, PointsFrame::World] {
            refused(
                "PointCloud::new",
                what,
                said,
                PointCloud::new(&s.images, &s.sensor, &SensorPose::new(pose), frame),
            );
        }
    }
}

/// Engines and virtual sensors check the pose of a plan or prediction again, because callers may change it.
#[test]
fn engines_and_virtual_sensors_check_again() {
    let s = scene();
    let mut engines: Vec<_> = EngineKind::ALL.iter().filter_map(|kind| kind.open(&1.into()).ok()).collect();
    assert!(engines.len() >= 2);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    for (what, pose, said) in bad() {
        let mut plan = common::plan(&s.world, &s.sensor, &Pose::IDENTITY);
        plan.world_from_sensor = pose;
        let mut images = Images::default();
        for engine in &mut engines {
            refused(&engine.name(), what, said, engine.render(&plan, &mut images, &mut Stats::default()));
        }
        for task in VirtualSensor::ALL {
            let name = match task.class() {
                "video" => "video-camera",
                "radar" => "microwave-radar-scan",
                _ if task == VirtualSensor::Docking => "laser-scanner",
                _ => "laser-range-camera",
            };
            let sensor = presight_read::preset(name).unwrap();
            let request = Request::of(task.outputs());
            let mut prediction = predictor.predict(&s.world, &sensor, &SensorPose::IDENTITY, &request).unwrap();
            prediction.pose = SensorPose::new(pose);
            let features = FeaturePrediction::default();
            let view = View::of(&prediction, s.world.environment()).with_features(&features);
            refused(task.name(), what, said, task.reduce(&view, &Settings::default()));
        }
    }
}

#[test]
fn a_mount_is_a_pose_too() {
    for (what, mount, _) in bad() {
        let spec = scenes::camera(4, 3).spec().clone().with_mount(mount);
        let e = Sensor::new(spec).unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && e.to_string().contains("mount: the pose ["), "{what}: {e}");
    }
}

/// Every beam of a scanner that is mounted ahead of and above the robot's origin is right if the prediction is made for
/// the sensor's pose, which follows from the robot's by the mount.
#[test]
fn the_mount_leads_from_the_robots_pose_to_the_sensors() {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    let (low, high) = (Vec3::new(-2.0, -3.0, 0.0), Vec3::new(4.0, 3.0, 2.5));
    let room = Mesh::cuboid("room", low, high, 0).unwrap();
    environment.insert(NewObject::new("room", Pose::IDENTITY, room.into())).unwrap();
    let world = World::new(environment);
    let mut spec = presight_read::preset("laser-scanner").unwrap().spec().clone();
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.2, 0.0, 1.2), 0.0, 0.0, 0.0);
    let scanner = Sensor::new(spec).unwrap();

    let heading = 0.7;
    let robot = RobotPose::from_xyz_rpy(DVec3::new(1.0, 0.5, 0.0), 0.0, 0.0, heading);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu)).unwrap();
    let seen = predictor.predict(&world, &scanner, &robot.sensor(&scanner), &Request::default()).unwrap();
    // By hand: from 0.2 m ahead of the robot, beams half a degree apart from 90 degrees on the right to the left.
    let place = [1.0 + 0.2 * f64::cos(heading), 0.5 + 0.2 * f64::sin(heading)];
    let is_right = |k: &usize| {
        let (sin, cos) = (heading + (0.5 * *k as f64 - 90.0).to_radians()).sin_cos();
        let to_wall =
            |along: f64, at: f64, low: f32, high: f32| (f64::from(if along > 0.0 { high } else { low }) - at) / along;
        let range = to_wall(cos, place[0], low.x, high.x).min(to_wall(sin, place[1], low.y, high.y));
        (f64::from(seen.images.range[*k]) - range).abs() < 1e-5
    };
    assert_eq!((0..361).filter(is_right).count(), 361);
    let back = robot.sensor(&scanner).robot(&scanner).world_from_robot();
    assert!(back.translation.distance(robot.world_from_robot().translation) < 1e-12);
}
