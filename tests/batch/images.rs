//! Images of batches are those of single predictions, bit for bit, whatever the threads and chunks.

use super::{common, predictor};
use common::{Random, data, scenes};
use presight::batch::BatchRequest;
use presight::{ErrorKind, Images, Outputs, Pose, Request, World};

fn poses(n: usize) -> Vec<Pose> {
    let mut random = Random(8);
    let mut pose = || {
        let at = glam::DVec3::new(random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0), random.uniform(0.5, 2.0));
        let mut angle = |most: f64| random.uniform(-most, most);
        Pose::from_xyz_rpy(at, angle(0.3), angle(0.3), angle(3.0))
    };
    (0..n).map(|_| pose()).collect()
}

/// Bits, for NaN is unlike itself.
fn bits(images: &Images) -> Vec<Vec<u32>> {
    presight::Output::ALL.map(|output| common::bits(images, output)).to_vec()
}

fn check(world: &World, poses: &[Pose]) {
    for sensor in data::presets() {
        let outputs = if sensor.is_camera() { Outputs::ALL } else { Outputs::ALL.without(presight::Output::DepthZ) };
        let asked = Request::of(outputs);
        let mut one = predictor(2);
        let singles: Vec<_> = poses.iter().map(|p| one.predict(world, &sensor, p, &asked).unwrap().images).collect();
        for (threads, chunk) in [(1, None), (2, Some(1)), (3, Some(4)), (2, None)] {
            let request = BatchRequest { images: Some((&asked).into()), chunk, ..BatchRequest::default() };
            let mut predictor = predictor(threads);
            let batch = predictor.batch(world, &sensor, poses.to_vec(), &request).unwrap();
            let mut count = 0;
            for (i, item) in batch.enumerate() {
                let item = item.unwrap();
                assert_eq!((item.index, item.world_from_sensor), (i, poses[i]));
                assert!(bits(&item.images) == bits(&singles[i]), "{}, pose {i}", sensor.spec().name);
                count += 1;
            }
            assert_eq!(count, poses.len());
        }
        // The comparison can fail.
        assert!(bits(&singles[0]) != bits(&singles[1]), "{}", sensor.spec().name);
    }
}

#[test]
fn images_are_those_of_single_predictions() {
    check(&World::new(scenes::room(2, 60)), &poses(4));
}

#[test]
fn images_are_those_of_single_predictions_in_a_real_scene() {
    let Some(world) = data::scene("factory_hall", true) else { return };
    let poses = data::poses(&world, 3, 3);
    check(&world, &poses);
}

#[test]
fn statistics_are_there_if_asked_for() {
    let world = World::new(scenes::room(2, 10));
    let sensor = presight::preset("vlp-16").unwrap();
    for statistics in [false, true] {
        let request = BatchRequest { statistics, ..BatchRequest::default() };
        let mut predictor = predictor(2);
        for item in predictor.batch(&world, &sensor, poses(3), &request).unwrap() {
            let item = item.unwrap();
            assert_eq!(item.stats.as_ref().map(|s| s.engine), statistics.then_some("cpu"));
            assert!(item.images.range.is_empty() && item.log_likelihood.is_none());
        }
    }
}

#[test]
fn a_wrong_pose_ends_the_batch_at_its_place() {
    let world = World::new(scenes::room(2, 10));
    let sensor = presight::preset("vlp-16").unwrap();
    let mut poses = poses(9);
    poses[5].translation.x = f64::NAN;
    for chunk in [None, Some(2), Some(5)] {
        let request = BatchRequest { chunk, ..BatchRequest::default() };
        let mut predictor = predictor(2);
        let items: Vec<_> = predictor.batch(&world, &sensor, poses.clone(), &request).unwrap().collect();
        assert_eq!(items.len(), 6);
        assert!(items[..5].iter().all(|item| item.is_ok()));
        let e = items[5].as_ref().unwrap_err();
        assert_eq!((e.kind(), e.place()), (ErrorKind::Usage, Some("pose 5")), "{e}");
    }
    let none = BatchRequest { chunk: Some(0), ..BatchRequest::default() };
    assert!(predictor(1).batch(&world, &sensor, poses, &none).is_err());
    let mut predictor = predictor(1);
    assert_eq!(predictor.batch(&world, &sensor, [], &BatchRequest::default()).unwrap().count(), 0);
}

/// The GPU engine goes from pose to pose.
#[test]
fn the_gpu_engine_makes_its_single_predictions() {
    let options = presight::Options::new(presight::Backend::Gpu).with_threads(2);
    let mut gpu = match presight::Predictor::new(options) {
        Ok(gpu) => gpu,
        Err(e) => return common::skip::no_adapter(e),
    };
    let world = World::new(scenes::room(2, 40));
    let sensor = super::noisy(
        &presight::preset("laser-range-camera").unwrap(),
        presight::Noise { range_sigma: 0.02, ..Default::default() },
    );
    let asked = Request::default();
    let (range, _) = super::single(&mut predictor(1), &world, &sensor, &poses(1)[0]);
    let sensed = presight::batch::RangeLikelihood::new(&sensor, range, Default::default()).unwrap();
    let request =
        BatchRequest { images: Some((&asked).into()), likelihood: Some(sensed.clone()), ..BatchRequest::default() };
    let items: Vec<_> = gpu.batch(&world, &sensor, poses(5), &request).unwrap().map(|item| item.unwrap()).collect();
    for (item, pose) in items.iter().zip(poses(5)) {
        let single = gpu.predict(&world, &sensor, &pose, &asked).unwrap();
        assert!(bits(&item.images) == bits(&single.images));
        let truth = sensed.log_likelihood(&single.images.range, &single.images.cos_incidence);
        assert_eq!(item.log_likelihood, Some(truth));
    }
}
