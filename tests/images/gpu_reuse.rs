//! Geometry that the GPU engine draws first because the previous frame showed it: the images equal those of independent
//! frames bit for bit.
#![cfg(feature = "gpu")]

use presight_testkit as common;

use common::hall::{hall_poses, open_hall};
use common::skip::no_adapter;
use common::{data, plan, scenes};
use glam::DVec3;
use presight_model::change::Change;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::batch::BatchRequest;
use presight_predict::gpu::testing;
use presight_predict::gpu::testing::{Hiding, Setup};
use presight_predict::gpu::{DeviceOptions, GpuEngine};
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_read::preset;
use presight_render::plan::{CountName, Omission, StageName};
use presight_render::plan::{ImageRequest, Images, Outputs, Stats};
use std::f64::consts::PI;
use std::time::Duration;

fn engine(hiding: Hiding, without_int64: bool) -> Option<GpuEngine> {
    let options = DeviceOptions { without_int64, ..Default::default() };
    // One of the two resolves images on the device, as in `gpu`.
    let setup = Setup { hiding, all_on_device: without_int64, ..Setup::default() };
    testing::open(options, setup).map_err(no_adapter).ok()
}

/// A frame that may reuse the previous one.
fn warm(engine: &mut GpuEngine, world: &World, sensor: &Sensor, pose: &Pose) -> (Images, Stats) {
    let mut plan = plan(world, sensor, pose);
    plan.set_reuse_visible();
    let (mut images, mut stats) = (Images::default(), Stats::default());
    engine.render(&plan, &mut images, &mut stats).expect("the engine renders");
    (images, stats)
}

/// The samples that differ between a frame that may reuse the previous one and a frame that may not.
fn differing(
    engines: &mut [GpuEngine; 2],
    (world, sensor, pose): (&World, &Sensor, &Pose),
    each: &mut dyn FnMut(&Stats),
) -> usize {
    let [reusing, other] = engines;
    let (images, stats) = warm(reusing, world, sensor, pose);
    let (mut expected, mut of_other) = (Images::default(), Stats::default());
    other.render(&plan(world, sensor, pose), &mut expected, &mut of_other).expect("the engine renders");
    assert!(why_anew(&of_other).is_some_and(|why| ["not requested", "nothing is in view"].contains(&why)));
    each(&stats);
    assert_eq!(images.outputs(), expected.outputs());
    let differ = |output| {
        let pair = common::bits(&images, output).into_iter().zip(common::bits(&expected, output));
        pair.filter(|(a, b)| a != b).count()
    };
    expected.outputs().iter().map(differ).sum()
}

/// The reason why the previous frame was not reused; `None` if it was.
fn why_anew(stats: &Stats) -> Option<&str> {
    if stats.left_out.iter().any(|left| left.what == StageName::DrawingOnDevice.into()) {
        return Some("nothing is in view");
    }
    let of_reuse = |left: &&Omission| left.what == StageName::ReuseOfLastFrame.into();
    let why = stats.left_out.iter().find(of_reuse).map(|left| &*left.why);
    assert_eq!(why.is_none(), stats.taken.iter().any(|taken| taken.what == StageName::ReuseOfLastFrame));
    why
}

fn brought(stats: &Stats) -> u64 {
    stats.count_of(CountName::RunsShownBefore).unwrap_or(0)
}

/// Half a turn.
fn turned() -> Pose {
    Pose::from_xyz_rpy(DVec3::ZERO, 0.0, 0.0, PI)
}

/// 10 cm and 2 degrees a step, with a jump in the middle: the robot turns round on the spot.
fn drive(start: &Pose, steps: u32) -> Vec<Pose> {
    let step = Pose::from_xyz_rpy(DVec3::new(0.1, 0.0, 0.0), 0.0, 0.0, 2f64.to_radians());
    let move_on = |pose: &mut Pose, i: u32| {
        *pose = *pose * if i == steps / 2 { turned() } else { step };
        *pose
    };
    (0..steps).scan(*start, |pose, i| Some(move_on(pose, i))).collect()
}

/// None square; a pinhole camera, scanners, one row, and rays that lie on no lines.
fn sensors() -> Vec<Sensor> {
    let lines = [scenes::camera(161, 121), scenes::scanner(360, 61), scenes::scanner(1800, 1)];
    lines.into_iter().chain([scenes::lens(121, 91), scenes::fisheye(91, 91), scenes::all_round(72, 36)]).collect()
}

/// Runs the sensors in turns along each drive; returns the share of frames that took runs into their first wave.
fn compare(world: &World, sensors: &[Sensor], drives: &[Vec<Pose>], hiding: [Hiding; 2]) -> f64 {
    let (mut reused, mut all) = (0, 0);
    for without_int64 in [false, true] {
        let [Some(reusing), Some(other)] = hiding.map(|hiding| engine(hiding, without_int64)) else { continue };
        let mut engines = [reusing, other];
        for (pose, sensor) in drives.iter().flatten().flat_map(|pose| sensors.iter().map(move |s| (pose, s))) {
            let mut count = |stats: &Stats| {
                reused += u32::from(brought(stats) > 0);
                all += 1;
            };
            assert_eq!(differing(&mut engines, (world, sensor, pose), &mut count), 0, "{}", sensor.spec().name);
        }
    }
    f64::from(reused) / f64::from(all.max(1))
}

fn has_adapter() -> bool {
    engine(Hiding::Off, false).is_some()
}

#[test]
fn images_of_drives_equal_those_without_reuse() {
    let hall = open_hall(3, 30_000);
    let drives: Vec<_> = hall_poses(&hall, 5, 2).iter().map(|start| drive(start, 6)).collect();
    let reused = compare(&World::new(hall), &sensors(), &drives, [Hiding::Always, Hiding::Off]);
    // Each drive starts without a previous frame, some sensors also start again in its middle, and some have nothing in
    // view.
    assert!(!has_adapter() || reused > 0.5, "{reused} of all frames reuse the last one");
    let (world, start) = room();
    let reused = compare(&world, &sensors(), &[drive(&start, 6)], [Hiding::Always, Hiding::Off]);
    assert!(!has_adapter() || reused > 0.5, "{reused} of all frames reuse the last one");
}

#[test]
fn images_of_drives_in_real_models_equal_those_without_reuse() {
    for name in ["hospital", "factory_hall"] {
        let Some(world) = data::scene(name, true) else { continue };
        let drives: Vec<_> = data::poses(&world, 1, 22).iter().map(|start| drive(start, 4)).collect();
        let sensors = [scenes::camera(320, 240), scenes::scanner(1280, 200), scenes::lens(320, 240)];
        let reused = compare(&world, &sensors, &drives, [Hiding::WhereItPays; 2]);
        assert!(!has_adapter() || reused > 0.2, "{name}: {reused} of all frames reuse the last one");
    }
}

/// A room full of boxes, and a pose in it with many in view in every direction.
fn room() -> (World, Pose) {
    (scenes::room_world(7, 400), Pose::from_xyz_rpy(DVec3::new(0.2, -0.1, 1.4), 0.05, 0.1, 0.4))
}

#[test]
fn another_world_sensor_or_device_starts_without_reuse() {
    const ANEW: Option<&str> = Some("the sensor has no last frame in this version of the world");
    let [Some(reusing), Some(other)] = [Hiding::Always, Hiding::Off].map(|hiding| engine(hiding, false)) else {
        return;
    };
    let mut engines = [reusing, other];
    let (mut world, pose) = room();
    let camera = scenes::camera(161, 121);
    let mut check = |world: &World, sensor: &Sensor, pose: &Pose, why: Option<&str>, lost: bool| {
        if lost {
            testing::device_loss(&engines[0])();
            engines[0].reopen().expect("it opens again");
        }
        let mut told = |stats: &Stats| {
            assert_eq!(why_anew(stats), why);
            assert_eq!(brought(stats) > 0, why.is_none());
        };
        assert_eq!(differing(&mut engines, (world, sensor, pose), &mut told), 0);
    };
    check(&world, &camera, &pose, ANEW, false);
    check(&world, &camera, &pose, None, false);
    check(&world, &scenes::scanner(360, 61), &pose, ANEW, false);
    // The other sensor was used in between.
    check(&world, &camera, &pose, None, false);
    // Deletes the box with the most pixels.
    let (seen, _) = warm(&mut engine(Hiding::Off, false).expect("an adapter"), &world, &camera, &pose);
    let objects = world.environment().objects();
    let pixels = |object: &usize| seen.object_id.iter().filter(|id| **id as usize == *object + 1).count();
    let nearest = (1..objects.len()).max_by_key(pixels).expect("boxes");
    assert!(pixels(&nearest) > 100, "it is seen");
    let name = objects[nearest].name.clone();
    let before = world.clone();
    world.apply(Change::DeleteObject { name }).expect("it is there");
    check(&world, &camera, &pose, ANEW, false);
    check(&world, &camera, &pose, None, false);
    // Returning to the older version is again another version.
    check(&before, &camera, &pose, ANEW, false);
    let back = pose * turned();
    check(&before, &camera, &back, Some("most of what it showed is out of view"), false);
    check(&before, &camera, &back, None, false);
    check(&before, &camera, &back, ANEW, true);
}

/// Geometry that comes into view is drawn, because everything that is not hidden is drawn.
#[test]
fn an_engine_that_draws_only_the_previous_geometry_is_found() {
    let (world, pose) = room();
    for without_int64 in [false, true] {
        let hiding = [Hiding::LastFrameOnly, Hiding::Off];
        let [Some(faulty), Some(other)] = hiding.map(|hiding| engine(hiding, without_int64)) else { return };
        let mut engines = [faulty, other];
        for sensor in sensors() {
            // Most of it stays in view from step to step, and little in the end.
            let step = Pose::from_xyz_rpy(DVec3::new(0.05, 0.05, 0.0), 0.0, 0.0, 5f64.to_radians());
            let drive: Vec<Pose> = std::iter::successors(Some(pose), |pose| Some(*pose * step)).take(12).collect();
            let mut frame = |pose| differing(&mut engines, (&world, &sensor, pose), &mut |_| {});
            assert_eq!(frame(&drive[0]), 0, "the first frame draws everything");
            let differ: usize = drive[1..].iter().map(frame).sum();
            assert!(differ > 0, "the fault must be found by {}", sensor.spec().name);
        }
    }
}

fn predictor(reuse: bool) -> Option<Predictor> {
    let options = Options::new(Backend::Gpu).with_threads(1).with_reuse_visible(reuse);
    Predictor::new(options).map_err(no_adapter).ok()
}

#[test]
fn only_predictions_that_request_it_reuse_a_frame() {
    let Some(mut predictor) = predictor(true) else { return };
    // With more in view than one wave can hold.
    let hall = open_hall(3, 30_000);
    let (pose, world) = (hall_poses(&hall, 5, 1)[0], World::new(hall));
    let sensor = preset("vlp-16").expect("a preset");
    let request = Request::default();
    let mut seen = predictor.predict(&world, &sensor, &SensorPose::new(pose), &request).expect("it predicts");
    assert!(why_anew(&seen.stats).is_some());
    predictor.predict_again(&world, &SensorPose::new(pose), &mut seen).expect("it predicts");
    assert_eq!((why_anew(&seen.stats), brought(&seen.stats) > 0), (None, true));
    // A batch of neighbours, a study, and a deadline.
    let images = BatchRequest { images: Some(ImageRequest::default()), statistics: true, ..BatchRequest::default() };
    let batch = predictor.batch(&world, &sensor, vec![SensorPose::new(pose); 3], &images).expect("a valid batch");
    for item in batch {
        let stats = item.expect("it predicts").stats.expect("they were drawn");
        assert_eq!((why_anew(&stats), brought(&stats)), (Some("not requested"), 0));
    }
    let mut images = Images::default();
    let stats = predictor
        .predict_images(&world, &sensor, &SensorPose::new(pose), Outputs::default(), &mut images)
        .expect("it predicts");
    assert_eq!(why_anew(&stats), Some("not requested"));
    let in_time = request.clone().with_deadline(Duration::from_secs(5));
    if let Ok(seen) = predictor.predict(&world, &sensor, &SensorPose::new(pose), &in_time) {
        assert_eq!(brought(&seen.stats), 0);
        assert!(why_anew(&seen.stats).is_some());
    }
    let mut plain = self::predictor(false).expect("an adapter");
    for _ in 0..2 {
        let seen = plain.predict(&world, &sensor, &SensorPose::new(pose), &request).expect("it predicts");
        assert_eq!((why_anew(&seen.stats), brought(&seen.stats)), (Some("not requested"), 0));
    }
}
