//! Batches and single predictions give the same images bit for bit, for any threads and chunks.

use super::{common, predictor};
use common::{Random, data, scenes};
use presight_model::error::ErrorKind;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::world::World;
use presight_predict::batch::BatchRequest;
use presight_predict::request::Request;
use presight_render::plan::{Images, Outputs};

fn poses(n: usize) -> Vec<Pose> {
    let mut random = Random(8);
    let mut pose = || {
        let at = glam::DVec3::new(random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0), random.uniform(0.5, 2.0));
        let mut angle = |most: f64| random.uniform(-most, most);
        Pose::from_xyz_rpy(at, angle(0.3), angle(0.3), angle(3.0))
    };
    (0..n).map(|_| pose()).collect()
}

/// Compares bits, because NaN is not equal to itself.
fn bits(images: &Images) -> Vec<Vec<u32>> {
    presight_render::plan::Output::ALL.map(|output| common::bits(images, output)).to_vec()
}

fn check(world: &World, poses: &[Pose]) {
    for sensor in data::presets() {
        let outputs =
            if sensor.is_camera() { Outputs::ALL } else { Outputs::ALL.without(presight_render::plan::Output::DepthZ) };
        let asked = Request::of(outputs);
        let mut one = predictor(2);
        let singles: Vec<_> =
            poses.iter().map(|p| one.predict(world, &sensor, &SensorPose::new(*p), &asked).unwrap().images).collect();
        for (threads, chunk) in [(1, None), (2, Some(1)), (3, Some(4)), (2, None)] {
            let request = BatchRequest { images: Some((&asked).into()), chunk, ..BatchRequest::default() };
            let mut predictor = predictor(threads);
            let batch = predictor.batch(world, &sensor, poses.iter().copied().map(SensorPose::new), &request).unwrap();
            let mut count = 0;
            for (i, item) in batch.enumerate() {
                let item = item.unwrap();
                assert_eq!((item.index, item.pose.world_from_sensor()), (i, poses[i]));
                assert!(bits(&item.images) == bits(&singles[i]), "{}, pose {i}", sensor.spec().name);
                count += 1;
            }
            assert_eq!(count, poses.len());
        }
        // Checks that the comparison can fail.
        assert!(bits(&singles[0]) != bits(&singles[1]), "{}", sensor.spec().name);
    }
}

#[test]
fn images_equal_those_of_single_predictions() {
    check(&World::new(scenes::room(2, 60)), &poses(4));
}

#[test]
fn images_equal_those_of_single_predictions_in_a_real_scene() {
    let Some(world) = data::scene("factory_hall", true) else { return };
    let poses = data::poses(&world, 3, 3);
    check(&world, &poses);
}

#[test]
fn statistics_are_returned_on_request() {
    let world = World::new(scenes::room(2, 10));
    let sensor = presight_read::preset("vlp-16").unwrap();
    for statistics in [false, true] {
        let request = BatchRequest { statistics, ..BatchRequest::default() };
        let mut predictor = predictor(2);
        for item in predictor.batch(&world, &sensor, poses(3).into_iter().map(SensorPose::new), &request).unwrap() {
            let item = item.unwrap();
            assert_eq!(item.stats.as_ref().map(|s| s.engine), statistics.then_some("cpu"));
            assert!(item.images.range.is_empty() && item.log_likelihood.is_none());
        }
    }
}

#[test]
fn a_wrong_pose_ends_the_batch_at_its_place() {
    let world = World::new(scenes::room(2, 10));
    let sensor = presight_read::preset("vlp-16").unwrap();
    let mut poses = poses(9);
    poses[5].translation.x = f64::NAN;
    for chunk in [None, Some(2), Some(5)] {
        let request = BatchRequest { chunk, ..BatchRequest::default() };
        let mut predictor = predictor(2);
        let items: Vec<_> =
            predictor.batch(&world, &sensor, poses.iter().copied().map(SensorPose::new), &request).unwrap().collect();
        assert_eq!(items.len(), 6);
        assert!(items[..5].iter().all(|item| item.is_ok()));
        let e = items[5].as_ref().unwrap_err();
        assert_eq!((e.kind(), e.place()), (ErrorKind::Usage, Some("pose 5")), "{e}");
    }
    let none = BatchRequest { chunk: Some(0), ..BatchRequest::default() };
    assert!(predictor(1).batch(&world, &sensor, poses.into_iter().map(SensorPose::new), &none).is_err());
    let mut predictor = predictor(1);
    assert_eq!(predictor.batch(&world, &sensor, [], &BatchRequest::default()).unwrap().count(), 0);
}

/// Ten million poses are not collected: the batch takes at most a few chunks of poses before it returns their items.
#[test]
fn poses_are_taken_a_chunk_at_a_time() {
    let world = World::new(scenes::room(2, 10));
    let sensor = presight_read::preset("laser-scanner").unwrap();
    let taken = std::cell::Cell::new(0);
    let turned = |i: u32| {
        taken.set(taken.get() + 1);
        Pose::from_xyz_rpy(glam::DVec3::Z, 0.0, 0.0, f64::from(i))
    };
    let mut predictor = predictor(2);
    let request = BatchRequest { statistics: true, ..BatchRequest::default() };
    let items =
        predictor.batch(&world, &sensor, (0..10_000_000).map(turned).map(SensorPose::new), &request).unwrap().take(600);
    assert_eq!(items.map(|item| item.unwrap().index).max(), Some(599));
    // Two chunks, and one pose to check for the end.
    assert!((600..=2 * 512 + 1).contains(&taken.get()), "{}", taken.get());
}

/// The GPU engine renders the poses of a chunk in one submission.
#[test]
fn the_gpu_engine_equals_its_single_predictions() {
    let options = presight_predict::predict::Options::new(presight_predict::predict::Backend::Gpu).with_threads(2);
    let mut gpu = match presight_predict::predict::Predictor::new(options) {
        Ok(gpu) => gpu,
        Err(e) => return common::skip::no_adapter(e),
    };
    let world = World::new(scenes::room(2, 40));
    let noise = presight_model::sensor::Noise { range_sigma: 0.02, ..Default::default() };
    let asked = Request::default();
    // Some poses have nothing in view, and there are too many poses for one submission.
    let away = Pose::from_xyz_rpy(glam::DVec3::X * 1e4, 0.0, 0.0, 0.0);
    let mut poses = poses(70);
    (poses[0], poses[3], poses[4], poses[69]) = (away, away, away, away);
    for preset in ["laser-range-camera", "vlp-16"] {
        let sensor = super::noisy(&presight_read::preset(preset).unwrap(), noise);
        let (range, _) = super::single(&mut predictor(1), &world, &sensor, &poses[1]);
        let sensed =
            presight_predict::batch::RangeLikelihood::new(&super::frame_of(&sensor, range), Default::default())
                .unwrap();
        for chunk in [None, Some(3)] {
            let request = BatchRequest {
                images: Some((&asked).into()),
                likelihood: Some(sensed.clone()),
                chunk,
                statistics: true,
                ..BatchRequest::default()
            };
            let items: Vec<_> =
                gpu.batch(&world, &sensor, poses.iter().copied().map(SensorPose::new), &request).unwrap().collect();
            assert_eq!(items.len(), poses.len());
            for (i, (item, pose)) in items.into_iter().zip(&poses).enumerate() {
                let item = item.unwrap();
                let single = gpu.predict(&world, &sensor, &SensorPose::new(*pose), &asked).unwrap();
                assert!(bits(&item.images) == bits(&single.images), "{preset}, pose {i}");
                let truth = sensed.log_likelihood(&single.images.range, &single.images.cos_incidence);
                assert_eq!((item.index, item.log_likelihood), (i, Some(truth)));
                let stats = item.stats.unwrap();
                let without_reruns = |stats: &presight_render::plan::Stats| {
                    let counts =
                        stats.counts.iter().filter(|(name, _)| *name != presight_render::plan::CountName::Reruns);
                    counts.cloned().collect::<Vec<_>>()
                };
                assert_eq!(stats.engine, "gpu");
                assert_eq!(without_reruns(&stats), without_reruns(&single.stats), "{preset}, pose {i}");
            }
        }
    }
}

/// Frames of one submission may need one wave or several, and so have different passes. Each must find its own answer.
#[test]
fn frames_with_one_wave_and_with_several_share_a_submission() {
    let options = presight_predict::predict::Options::new(presight_predict::predict::Backend::Gpu).with_threads(2);
    let mut gpu = match presight_predict::predict::Predictor::new(options) {
        Ok(gpu) => gpu,
        Err(e) => return common::skip::no_adapter(e),
    };
    let world = World::new(scenes::room(2, 4000));
    let sensor = presight_read::preset("laser-range-camera").unwrap();
    // In the middle, a third of all boxes are in view; a hand's breadth from a wall, next to nothing is.
    let middle = Pose::from_xyz_rpy(glam::DVec3::Z, 0.0, 0.0, 0.5);
    let at_the_wall = Pose::from_xyz_rpy(glam::DVec3::new(4.9, 0.0, 1.5), 0.0, 0.0, 0.0);
    let poses = [at_the_wall, middle, at_the_wall, middle, middle, at_the_wall];
    let request = BatchRequest {
        images: Some((&Request::default()).into()),
        chunk: Some(6),
        statistics: true,
        ..BatchRequest::default()
    };
    let items: Vec<_> = gpu
        .batch(&world, &sensor, poses.into_iter().map(SensorPose::new), &request)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    // One submission: its first frame reports all of the work. After a fault each frame would be drawn alone.
    let work = |item: &presight_predict::batch::BatchItem| item.stats.as_ref().unwrap().work.gpu_workgroups > 0;
    assert_eq!(items.iter().map(work).collect::<Vec<_>>(), [true, false, false, false, false, false]);
    for (item, pose) in items.into_iter().zip(&poses) {
        let single = gpu.predict(&world, &sensor, &SensorPose::new(*pose), &Request::default()).unwrap();
        let (stats, waves) = (item.stats.unwrap(), presight_render::plan::CountName::Waves);
        assert_eq!(stats.count_of(waves).is_some_and(|waves| waves > 1), *pose == middle, "pose {}", item.index);
        assert!(bits(&item.images) == bits(&single.images), "pose {}", item.index);
        for of in [waves, presight_render::plan::CountName::PolygonsSetUp] {
            assert_eq!(stats.count_of(of), single.stats.count_of(of), "pose {}", item.index);
        }
    }
}

/// The work of a submission is reported with its first frame: for one pose twice, twice that of the pose alone.
#[test]
fn the_work_of_all_frames_of_a_submission_is_reported() {
    let options = presight_predict::predict::Options::new(presight_predict::predict::Backend::Gpu).with_threads(2);
    let mut gpu = match presight_predict::predict::Predictor::new(options) {
        Ok(gpu) => gpu,
        Err(e) => return common::skip::no_adapter(e),
    };
    let world = World::new(scenes::room(2, 40));
    let sensor = presight_read::preset("laser-range-camera").unwrap();
    let pose = poses(2)[1];
    let request = BatchRequest { statistics: true, ..BatchRequest::default() };
    let mut workgroups = |count: usize| -> Vec<u64> {
        let items = gpu.batch(&world, &sensor, vec![SensorPose::new(pose); count], &request).unwrap();
        items.map(|item| item.unwrap().stats.unwrap().work.gpu_workgroups).collect()
    };
    // The first run makes room in the buffers.
    workgroups(2);
    let one = workgroups(1)[0];
    assert_eq!((one > 0, workgroups(2)), (true, vec![2 * one, 0]));
}

/// Explains the differences between log-likelihoods of the GPU and of the CPU. GPU ranges round differently, so a
/// reading at a predicted range falls before or behind the step of the density; at an edge a beam may hit the adjacent
/// surface. Without these beams the results agree.
#[test]
fn gpu_likelihoods_differ_by_beams_on_a_step() {
    let options = presight_predict::predict::Options::new(presight_predict::predict::Backend::Gpu).with_threads(2);
    let mut gpu = match presight_predict::predict::Predictor::new(options) {
        Ok(gpu) => gpu,
        Err(e) => return common::skip::no_adapter(e),
    };
    let world = World::new(scenes::room(2, 40));
    let noise = presight_model::sensor::Noise { range_sigma: 0.02, ..Default::default() };
    let sensor = super::noisy(&presight_read::preset("laser-range-camera").unwrap(), noise);
    let mut cpu = predictor(2);
    let exact = super::single(&mut cpu, &world, &sensor, &poses(1)[0]).0;
    let noisy = super::likelihood::disturbed(&mut Random(3), sensor.spec(), &exact);
    let weigh = |sensed: &[f32], (range, cos): &(Vec<f32>, Vec<f32>)| {
        let sensed = presight_predict::batch::RangeLikelihood::new(
            &super::frame_of(&sensor, sensed.to_vec()),
            Default::default(),
        )
        .unwrap();
        sensed.log_likelihood(range, cos)
    };
    for (name, sensed) in [("exact", &exact), ("noisy", &noisy)] {
        for (i, pose) in poses(6).iter().enumerate() {
            let [ours, theirs] = [&mut cpu, &mut gpu].map(|engine| super::single(engine, &world, &sensor, pose));
            let (mut steps, mut edges, mut kept) = (0, 0, sensed.clone());
            for (k, z) in kept.iter_mut().enumerate() {
                let (a, b) = (ours.0[k], theirs.0[k]);
                let edge = a != b && !((a - b).abs() <= 1e-5 * a);
                let step = (*z < a) != (*z < b);
                (steps, edges) = (steps + usize::from(step && !edge), edges + usize::from(edge));
                *z = if edge || step { f32::NAN } else { *z };
            }
            let apart = |sensed: &[f32]| (weigh(sensed, &ours) / weigh(sensed, &theirs) - 1.0).abs();
            let (whole, rest) = (apart(sensed), apart(&kept));
            println!("{name}, pose {i}: {whole:.1e} apart, {rest:.1e} without {steps} on a step and {edges} at edges");
            assert!(rest < 1e-6, "{name}, pose {i}: {rest} apart");
        }
    }
}
