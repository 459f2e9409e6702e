//! Sensors that move while they measure, and rays with origins of their own: engines and reference against
//! parry's ray casts from each pixel's own pose, closed forms, and planted faults.

#![allow(clippy::print_stderr)] // Prints results.

use presight_testkit as common;

use common::oracle::Oracle;
use common::{Random, scenes};
use glam::{DQuat, DVec3, Vec3};
use presight_model::environment::NewObject;
use presight_model::geometry::{Pose, SensorPose, Twist};
use presight_model::measured::{ScanMotion, ScanPoses};
use presight_model::sensor::{Angles, Camera, Geometry, RayTable, RayTimes, Scanner, Sensor, SensorSpec, StampAt};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{FramePlan, Images, Output, Outputs, PlanBuffers};
use presight_render::points::{PointCloud, PointsFrame};
use presight_render::verify::{PixelValues, Precision, Report, compare, compare_values};
use std::f64::consts::TAU;
use std::sync::Arc;

/// 1.5 m/s ahead, 0.3 m/s to the left, 0.1 m/s up, 1.2 rad/s to the left.
const SPEED: [f64; 3] = [1.5, 0.3, 0.1];
const TURN: f64 = 1.2;

fn twist() -> Twist {
    Twist::new(DVec3::from(SPEED), DVec3::Z * TURN)
}

/// Where the twist has led after some seconds, from the circle that it describes.
fn on_circle(seconds: f64) -> Pose {
    let (sin, cos) = (TURN * seconds).sin_cos();
    let [x, y, z] = SPEED;
    let at = DVec3::new((x * sin - y * (1.0 - cos)) / TURN, (x * (1.0 - cos) + y * sin) / TURN, z * seconds);
    Pose::from_xyz_rpy(at, 0.0, 0.0, TURN * seconds)
}

fn start() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(0.2, -0.3, 1.1), 0.1, -0.05, 0.7)
}

fn mounted(sensor: &Sensor, times: RayTimes) -> Sensor {
    let mount = Pose::from_xyz_rpy(DVec3::new(0.3, -0.1, 0.4), 0.05, 0.1, -0.4);
    Sensor::new(sensor.spec().clone().with_mount(mount).with_times(times)).unwrap()
}

/// Rays all round whose origins lie on a circle, each at the azimuth of its ray; each column at its own time.
fn ouster(columns: u32, rows: u32, radius: f64, times: RayTimes) -> Sensor {
    let azimuth = |c: u32| TAU * f64::from(c) / f64::from(columns);
    let place = |f: &dyn Fn(u32, u32) -> DVec3| -> Vec<DVec3> {
        (0..rows).flat_map(|r| (0..columns).map(move |c| (c, r))).map(|(c, r)| f(c, r)).collect()
    };
    let direction = |c: u32, r: u32| {
        let elevation = 0.4 - 0.8 * (f64::from(r) + 0.5) / f64::from(rows);
        let beside = azimuth(c) + 0.05 * (f64::from(r % 4) - 1.5);
        DVec3::new(elevation.cos() * beside.cos(), elevation.cos() * beside.sin(), elevation.sin())
    };
    let origin = |c: u32, _| radius * DVec3::new(azimuth(c).cos(), azimuth(c).sin(), 0.2);
    let table = RayTable::new(columns, rows, place(&direction)).unwrap().with_origins(place(&origin)).unwrap();
    mounted(&Sensor::new(SensorSpec::new("ouster", "laser", Geometry::Rays(table))).unwrap(), times)
}

/// Rays in no order, each with an own origin and time.
fn petals(count: u32) -> Sensor {
    let mut random = Random(11);
    let ray = |random: &mut Random| DVec3::new(1.0, random.uniform(-0.8, 0.8), random.uniform(-0.5, 0.5));
    let rays = (0..count).map(|_| ray(&mut random)).collect();
    let origins = (0..count).map(|_| 0.05 * ray(&mut random)).collect();
    let table = RayTable::new(count, 1, rays).unwrap().with_origins(origins).unwrap();
    let times: Vec<f32> = (0..count).map(|i| 0.1 * i as f32 / count as f32 - 0.05).collect();
    let sensor = Sensor::new(SensorSpec::new("petals", "laser", Geometry::Rays(table))).unwrap();
    mounted(&sensor, RayTimes::Listed(times.into()))
}

fn sensors() -> Vec<Sensor> {
    let columns = |stamp| RayTimes::Columns { turn_s: 0.1, stamp };
    let rows = RayTimes::Rows { readout_s: 0.05, stamp: StampAt::Middle };
    let back = RayTimes::Columns { turn_s: -0.1, stamp: StampAt::Middle };
    vec![
        mounted(&scenes::scanner(512, 128), columns(StampAt::First)),
        mounted(&scenes::scanner(900, 16), columns(StampAt::Last)),
        mounted(&scenes::closed(721, 1), columns(StampAt::Last)),
        mounted(&scenes::scanner(300, 5), back.clone()),
        mounted(&scenes::scanner(90, 31), rows.clone()),
        mounted(&scenes::camera(640, 480), rows.clone()),
        mounted(&scenes::camera(160, 121), back.clone()),
        mounted(&scenes::lens(320, 241), rows),
        mounted(&scenes::lens(77, 50), back),
        mounted(&scenes::all_round(200, 40), columns(StampAt::First)),
        ouster(512, 64, 0.015, columns(StampAt::First)),
        ouster(512, 32, 0.3, RayTimes::AtOnce),
        petals(3000),
        // Ranges count from behind the beams' origins.
        presight::preset("os1-128-real").unwrap(),
    ]
}

fn request(sensor: &Sensor) -> Outputs {
    if sensor.is_camera() { Outputs::ALL } else { Outputs::ALL.without(Output::DepthZ) }
}

/// The plan of a sensor on a robot at [`start`].
fn plan(world: &World, sensor: &Sensor, motion: &ScanMotion) -> FramePlan {
    let pose = start() * sensor.spec().mount;
    let poses = ScanPoses::new(sensor, &pose, Some(motion)).unwrap().expect("several poses");
    let outputs = request(sensor).into();
    FramePlan::in_bundles(PlanBuffers::default(), world, sensor, &pose, outputs, poses).unwrap()
}

fn predicted(world: &World, sensor: &Sensor, motion: &ScanMotion) -> Images {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(2)).unwrap();
    let pose = SensorPose::new(start() * sensor.spec().mount);
    let request = Request::of(request(sensor)).with_motion(motion.clone());
    predictor.predict(world, sensor, &pose, &request).unwrap().images
}

/// Images against the oracle, whose robot moves as `robot` says.
fn against_oracle(images: &Images, plan: &FramePlan, oracle: &Oracle, robot: &dyn Fn(f64) -> Pose) -> Report {
    let pixels = (0..images.height).flat_map(|r| (0..images.width).map(move |c| (c, r)));
    let values = pixels.filter_map(|p| {
        let truth = oracle.cast_moving(&plan.sensor, robot, p)?;
        Some((p, truth, PixelValues::of(images, (p.1 * images.width + p.0) as usize)))
    });
    compare_values(values, plan, Precision::F64)
}

/// Pixels whose range is not that of the oracle's ray on the same polygon, of all that have one. Comparisons hold ranges to
/// the poses of the plan; this holds the poses of the plan to the robot's.
fn off_the_oracle(images: &Images, sensor: &Sensor, oracle: &Oracle, robot: &dyn Fn(f64) -> Pose) -> [usize; 2] {
    let mut counts = [0, 0];
    for at in 0..images.pixels() {
        let (c, r) = (at as u32 % images.width, at as u32 / images.width);
        let Some(truth) = oracle.cast_moving(sensor, robot, (c, r)) else { continue };
        let image = PixelValues::of(images, at);
        if truth.polygon_id == image.polygon_id
            && let (Some(a), Some(b)) = (truth.range.filter(|x| x.is_finite()), image.range.filter(|x| x.is_finite()))
        {
            // Corners are stored in f32 to within a micrometre here, and at flat angles the range is off by more.
            counts[0] += usize::from((a - b).abs() > 1e-4);
            counts[1] += 1;
        }
    }
    counts
}

#[test]
fn moving_and_offset_sensors_see_what_parry_sees() {
    let motion = ScanMotion::Twist(twist());
    let mut totals = [Report::default(), Report::default()];
    for seed in 0..2 {
        let world = scenes::room_world(seed + 3, 30);
        let oracle = Oracle::new(world.environment(), start().translation).expect("triangles");
        for sensor in sensors() {
            let plan = plan(&world, &sensor, &motion);
            let cpu = predicted(&world, &sensor, &motion);
            let reference = common::reference(&plan);
            let reports = [
                compare(&reference, &cpu, &plan, Precision::F64).unwrap(),
                against_oracle(&cpu, &plan, &oracle, &|t| start() * on_circle(t)),
            ];
            let [off, all] = off_the_oracle(&cpu, &sensor, &oracle, &|t| start() * on_circle(t));
            assert!(off == 0 && all > cpu.pixels() / 2, "{}: {off} of {all} ranges", sensor.spec().name);
            for (total, report) in totals.iter_mut().zip(reports) {
                assert_eq!(report.fault, 0, "{}: {:#?}", sensor.spec().name, report.faults);
                total.add(report);
            }
        }
    }
    for total in &totals {
        eprintln!("{}", common::summary(total));
        total.check(1e-4).unwrap();
    }
    assert!(totals[0].pixels > 1_000_000, "{}", totals[0].pixels);
}

/// A path of poses of the twist gives the images of the twist, up to what its straight pieces are off the circle.
#[test]
fn a_path_is_followed() {
    let world = scenes::room_world(3, 30);
    let oracle = Oracle::new(world.environment(), start().translation).expect("triangles");
    let sensor = mounted(&scenes::scanner(360, 16), RayTimes::turning(0.1, StampAt::Middle));
    let knots: Vec<(f64, Pose)> = (-6..=6).map(|i| f64::from(i) * 0.01).map(|t| (t, on_circle(t))).collect();
    let motion = ScanMotion::path(knots.clone()).unwrap();
    let straight = |t: f64| {
        let at = ((t + 0.06) / 0.01).floor().clamp(0.0, 11.0) as usize;
        let ((t0, a), (_, b)) = (knots[at], knots[at + 1]);
        let part = (t - t0) / 0.01;
        start()
            * Pose {
                translation: a.translation.lerp(b.translation, part),
                rotation: a.rotation.slerp(b.rotation, part),
            }
    };
    let report =
        against_oracle(&predicted(&world, &sensor, &motion), &plan(&world, &sensor, &motion), &oracle, &straight);
    assert_eq!(report.fault, 0, "{:#?}", report.faults);
}

#[test]
fn planted_faults_are_found() {
    let motion = ScanMotion::Twist(twist());
    let world = scenes::room_world(3, 30);
    let oracle = Oracle::new(world.environment(), start().translation).expect("triangles");
    let times = |stamp| RayTimes::Columns { turn_s: 0.1, stamp };
    let sensor = ouster(256, 16, 0.1, times(StampAt::First));
    let images = predicted(&world, &sensor, &motion);
    let faults = |robot: &dyn Fn(f64) -> Pose, sensor: &Sensor| off_the_oracle(&images, sensor, &oracle, robot)[0];
    let all = images.pixels();
    assert_eq!(faults(&|t| start() * on_circle(t), &sensor), 0);
    let along_world = |t: f64| {
        let (start, moved) = (start(), on_circle(t));
        Pose { translation: start.translation + moved.translation, rotation: moved.rotation * start.rotation }
    };
    let found = faults(&along_world, &sensor);
    assert!(found > all / 2, "a twist along the world's axes: {found} of {all}");
    let other_turn = |t: f64| {
        let moved = on_circle(t);
        start() * Pose { rotation: moved.rotation.inverse(), ..moved }
    };
    assert!(faults(&other_turn, &sensor) > all / 2, "the direction of turning");
    let last = ouster(256, 16, 0.1, times(StampAt::Last));
    assert!(faults(&|t| start() * on_circle(t), &last) > all / 2, "times from the last ray");
    let Geometry::Rays(table) = &sensor.spec().geometry else { unreachable!("a table") };
    let turned = table.origins().unwrap().iter().map(|o| DVec3::new(o.x, -o.y, o.z)).collect();
    let turned = sensor.spec().clone().with_geometry(Geometry::Rays(table.clone().with_origins(turned).unwrap()));
    assert!(
        faults(&|t| start() * on_circle(t), &Sensor::new(turned).unwrap()) > all / 3,
        "origins turned the wrong way"
    );
}

/// Every bundle at the same pose: the images of the sensor that stands, bit by bit.
#[test]
fn bundles_of_one_pose_have_the_bits_of_one_bundle() {
    let world = scenes::room_world(4, 30);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(2)).unwrap();
    for sensor in sensors().into_iter().filter(|sensor| !sensor.has_origins()) {
        let pose = start() * sensor.spec().mount;
        let request = Request::of(request(&sensor));
        let standing = predictor.predict(&world, &sensor, &SensorPose::new(pose), &request).unwrap().images;
        let still = ScanMotion::Twist(Twist::default());
        let poses = ScanPoses::in_bundles(&sensor, &pose, &still, true).unwrap();
        let plan = FramePlan::in_bundles(PlanBuffers::default(), &world, &sensor, &pose, (&request).into(), poses);
        let in_bundles = common::engines::cpu(2)(&plan.unwrap());
        for output in Output::ALL {
            let name = &sensor.spec().name;
            assert!(common::bits(&standing, output) == common::bits(&in_bundles, output), "{name} {}", output.name());
        }
    }
}

/// The room's wall ahead, at x = 5 m, and the one on the left, at y = 4 m, from a robot in its middle. By hand: a beam
/// at the azimuth a, t seconds after the stamp, starts at x = v t and sees the wall ahead at (5 - v t) / cos a, the left
/// one at 4 / sin a. On a robot that turns at w about the middle it points along a + w t.
#[test]
fn walls_while_driving_and_turning() {
    let world = scenes::room_world(1, 0);
    let scanner =
        Sensor::new(scenes::scanner(720, 1).spec().clone().with_times(RayTimes::turning(0.1, StampAt::First)));
    let scanner = scanner.unwrap();
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let pose = SensorPose::from_xyz_rpy(DVec3::Z, 0.0, 0.0, 0.0);
    for (v, w) in [(2.0, 0.0), (0.0, 1.5)] {
        let motion = ScanMotion::Twist(Twist::new(DVec3::X * v, DVec3::Z * w));
        let request = Request::of(Outputs::of(&[Output::Range, Output::CosIncidence])).with_motion(motion);
        let images = predictor.predict(&world, &scanner, &pose, &request).unwrap().images;
        for c in 0..720 {
            let t = 0.1 * c as f64 / 720.0;
            let a = (-180.0 + 0.5 * c as f64).to_radians() + w * t;
            let ahead = if a.cos() > 0.0 { 5.0 - v * t } else { 5.0 + v * t } / a.cos().abs();
            let beside = 4.0 / a.sin().abs();
            let (range, cos) = if ahead < beside { (ahead, a.cos().abs()) } else { (beside, a.sin().abs()) };
            assert!((f64::from(images.range[c]) - range).abs() < 1e-6 * range, "{c}: {} {range}", images.range[c]);
            assert!((f64::from(images.cos_incidence[c]) - cos).abs() < 1e-6, "{c}");
        }
    }
}

/// A screw in the same room. By hand: at v ahead, u up and w to the left the robot is at x = v / w sin wt, y = v / w
/// (1 - cos wt), z = 1 + u t, and a beam at the azimuth a and the elevation e points along a + w t. It meets the nearest
/// of the walls at x = +-5 m and y = +-4 m, the floor and the ceiling at 3 m.
#[test]
fn a_room_from_a_helix() {
    let world = scenes::room_world(1, 0);
    let (v, u, w, turn_s) = (2.0, 0.8, 3.0, 0.5);
    let spec = scenes::scanner(360, 8).spec().clone();
    let scanner = Sensor::new(spec.with_times(RayTimes::turning(turn_s, StampAt::First))).unwrap();
    let motion = ScanMotion::Twist(Twist::new(DVec3::new(v, 0.0, u), DVec3::Z * w));
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let request = Request::of(Outputs::of(&[Output::Range])).with_motion(motion);
    let pose = SensorPose::from_xyz_rpy(DVec3::Z, 0.0, 0.0, 0.0);
    let images = predictor.predict(&world, &scanner, &pose, &request).unwrap().images;
    let range = |(c, r): (u32, u32), w: f64| {
        let t = turn_s * f64::from(c) / 360.0;
        let at = DVec3::new(v / w * (w * t).sin(), v / w * (1.0 - (w * t).cos()), 1.0 + u * t);
        let ray = DQuat::from_rotation_z(w * t) * scanner.ray(c, r).unwrap();
        let far = DVec3::new(5.0f64.copysign(ray.x), 4.0f64.copysign(ray.y), if ray.z > 0.0 { 3.0 } else { 0.0 });
        ((far - at) / ray).abs().min_element()
    };
    let off = |w: f64| {
        let pixels = (0..8).flat_map(|r| (0..360).map(move |c| (c, r))).zip(&images.range);
        pixels.filter(|(p, measured)| (f64::from(**measured) - range(*p, w)).abs() > 1e-6 * range(*p, w)).count()
    };
    assert_eq!(off(w), 0);
    // Planted: it turns the other way. What meets the floor or the ceiling does not change.
    assert!(off(-w) > 900, "{}", off(-w));
}

/// A wall 4 m ahead ends at y = 0.5 m, and another one is 8 m ahead. By hand: a camera that drives to the left at v sees
/// the end at the column c - f (0.5 - v t) / 4 of the row that it reads t seconds after the stamp: to the right of it the
/// near wall, to the left the far one.
#[test]
fn a_rolling_shutter_past_an_edge() {
    let wall = |x: f32, left: f32| {
        vec![[-50.0, -50.0], [left, -50.0], [left, 50.0], [-50.0, 50.0]]
            .into_iter()
            .map(move |[y, z]| Vec3::new(x, y, z))
    };
    let mut environment = scenes::empty();
    let mesh = scenes::mesh(&[wall(4.0, 0.5).collect(), wall(8.0, 50.0).collect()]);
    environment.insert(NewObject::new("walls", Pose::IDENTITY, Arc::new(mesh))).unwrap();
    let (f, readout_s) = (200.0, 0.1);
    let camera = Camera::pinhole(160, 100, f, f, 79.5, 49.5);
    let spec = SensorSpec::new("rolling", "video", Geometry::Camera(camera));
    let camera = Sensor::new(spec.with_times(RayTimes::Rows { readout_s, stamp: StampAt::First })).unwrap();
    let world = World::new(environment);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    for v in [3.0, -3.0] {
        let motion = ScanMotion::Twist(Twist::new(DVec3::Y * v, DVec3::ZERO));
        let request = Request::of(Outputs::of(&[Output::DepthZ])).with_motion(motion);
        let images = predictor.predict(&world, &camera, &SensorPose::IDENTITY, &request).unwrap().images;
        let off = |v: f64| {
            let pixels = (0..100).flat_map(|r| (0..160).map(move |c| (f64::from(c), f64::from(r))));
            let wrong = pixels.zip(&images.depth_z).filter(|((c, r), depth)| {
                let edge = 79.5 - f * (0.5 - v * readout_s * r / 100.0) / 4.0;
                let truth = if *c > edge { 4.0 } else { 8.0 };
                (c - edge).abs() > 1e-3 && (f64::from(**depth) - truth).abs() > 1e-5
            });
            wrong.count()
        };
        assert_eq!(off(v), 0, "{v}");
        // Planted: all rows at the stamp. The end moves by up to 15 columns, on average by 7.4 in 100 rows.
        assert!(off(0.0) > 600, "{}", off(0.0));
    }
}

/// A cylinder of 360 flat sides, 2 m from its axis to each. Rays start on a circle of 0.5 m around the axis. By hand: a
/// ray straight out from there at the middle of a side measures 1.5 m, one turned by d from it 1.5 / cos d.
#[test]
fn a_circle_of_origins_in_a_cylinder() {
    let sides = 360;
    let corner = |i: usize, z: f32| {
        let (angle, radius) = (TAU * (i as f64 - 0.5) / sides as f64, 2.0 / (0.5 * TAU / sides as f64).cos());
        Vec3::new((radius * angle.cos()) as f32, (radius * angle.sin()) as f32, z)
    };
    let side = |i: usize| vec![corner(i, -1.0), corner(i, 1.0), corner(i + 1, 1.0), corner(i + 1, -1.0)];
    let mut environment = scenes::empty();
    let mesh = scenes::mesh(&(0..sides).map(side).collect::<Vec<_>>());
    environment.insert(NewObject::new("cylinder", Pose::IDENTITY, Arc::new(mesh))).unwrap();
    let off = |i: usize| 0.002 * (i % 3) as f64;
    let out = |angle: f64| DVec3::new(angle.cos(), angle.sin(), 0.0);
    let middle = |i: usize| TAU * i as f64 / sides as f64;
    let table = RayTable::new(360, 1, (0..360).map(|i| out(middle(i) + off(i))).collect()).unwrap();
    let table = table.with_origins((0..360).map(|i| 0.5 * out(middle(i))).collect()).unwrap();
    let sensor = Sensor::new(SensorSpec::new("ring", "laser", Geometry::Rays(table))).unwrap();
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let request = Request::of(Outputs::of(&[Output::Range]));
    let world = World::new(environment);
    let images = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &request).unwrap().images;
    for (i, range) in images.range.iter().enumerate() {
        // Corners are rounded to f32.
        assert!((f64::from(*range) - 1.5 / off(i).cos()).abs() < 1e-6, "{i}: {range}");
    }
    let points = PointCloud::new(&images, &sensor, &SensorPose::IDENTITY, PointsFrame::Sensor).unwrap();
    assert!(points.positions().iter().all(|p| (p.length() - 2.0).abs() < 2e-5));
}

/// Points deskewed to any moment lie on the model within the rounding of ranges; as sensed they do not.
#[test]
fn deskewed_points_lie_on_the_model() {
    let world = scenes::room_world(3, 30);
    let oracle = Oracle::new(world.environment(), start().translation).expect("triangles");
    let motion = ScanMotion::Twist(twist());
    let times = RayTimes::turning(0.1, StampAt::First);
    for sensor in [ouster(256, 16, 0.1, times.clone()), mounted(&scenes::scanner(256, 16), times)] {
        let images = predicted(&world, &sensor, &motion);
        let pose = SensorPose::new(start() * sensor.spec().mount);
        let seen = |frame, moment: Option<f64>, at: &Pose| {
            let points = PointCloud::of_scan(&images, &sensor, &pose, frame, Some(&motion), moment).unwrap();
            let off = points.seen().map(|(_, p)| oracle.nearest(at.transform_point(p)));
            off.fold(0.0, f64::max)
        };
        for moment in [0.0, 0.03, 0.1] {
            let then = start() * on_circle(moment) * sensor.spec().mount;
            // Ranges of up to 12 m, rounded to f32.
            assert!(seen(PointsFrame::Sensor, Some(moment), &then) < 5e-7);
        }
        assert!(seen(PointsFrame::World, None, &Pose::IDENTITY) < 5e-7);
        assert!(seen(PointsFrame::Sensor, None, &(start() * sensor.spec().mount)) > 0.1);
    }
}

#[test]
fn what_needs_one_pose_is_refused() {
    let world = scenes::room_world(3, 2);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let scanner = mounted(&scenes::scanner(64, 4), RayTimes::turning(0.1, StampAt::First));
    let short = ScanMotion::path(vec![(0.0, Pose::IDENTITY), (0.05, Pose::from_xyz_rpy(DVec3::X, 0.0, 0.0, 0.0))]);
    let request = Request::default().with_motion(short.unwrap());
    let e = predictor.predict(&world, &scanner, &SensorPose::IDENTITY, &request).unwrap_err();
    assert!(e.to_string().contains("does not reach"), "{e}");
    let deadline = std::time::Duration::from_millis(5);
    let moving = Request::default().with_motion(ScanMotion::Twist(twist()));
    let e = predictor.predict(&world, &scanner, &SensorPose::IDENTITY, &moving.with_deadline(deadline)).unwrap_err();
    assert!(e.to_string().contains("a deadline"), "{e}");
    let offset = ouster(16, 4, 0.1, RayTimes::AtOnce);
    let features = Request::default().with_features(presight_features::FeatureOptions::default());
    let e = predictor.predict(&world, &offset, &SensorPose::IDENTITY, &features).unwrap_err();
    assert!(e.to_string().contains("several points"), "{e}");
    let angles = Angles::Listed(vec![0.0]);
    let scanner = Scanner { azimuth: angles.clone(), elevation: angles, beam_height_deg: None };
    let still = Sensor::new(SensorSpec::new("still", "laser", Geometry::Scanner(scanner))).unwrap();
    let at_once = Request::default().with_motion(ScanMotion::Twist(twist())).with_deadline(deadline);
    assert!(at_once.check(&still).is_ok(), "one time, one pose");
}
