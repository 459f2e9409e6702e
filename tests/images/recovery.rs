//! A predictor whose GPU disappears opens it again, or continues with the CPU, and reports that. Runs on any adapter
//! (lavapipe in CI).
#![cfg(feature = "gpu")]

use presight_testkit as common;

use common::faulty::{Faulty, Switches};
use common::scenes;
use common::skip::no_adapter;
use glam::DVec3;
use presight_model::error::ErrorKind;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::batch::BatchRequest;
use presight_predict::gpu::testing::Setup;
use presight_predict::gpu::{DeviceOptions, GpuEngine};
use presight_predict::predict::{Backend, Options, Prediction, Predictor};
use presight_predict::request::Request;
use presight_render::plan::StageName;
use presight_render::plan::{FramePlan, Images, Output, Outputs, Raster};
use presight_render::verify::Precision;
use std::time::Duration;

/// The prediction that a test repeats.
struct Task {
    world: World,
    sensor: Sensor,
    pose: Pose,
    request: Request,
}

impl Task {
    /// Returns `None` where there is no adapter and the machine may lack one.
    fn new() -> Option<Self> {
        if let Err(e) = GpuEngine::new(DeviceOptions::default()) {
            no_adapter(e);
            return None;
        }
        let sensor = scenes::camera(160, 120);
        let request = Request::of(Outputs::ALL);
        let pose = Pose::from_xyz_rpy(DVec3::new(0.2, -0.3, 1.4), 0.1, 0.2, 0.3);
        Some(Self { world: scenes::room_world(1, 40), sensor, pose, request })
    }

    fn predict(&self, predictor: &mut Predictor) -> presight_model::error::Result<Prediction> {
        predictor.predict(&self.world, &self.sensor, &SensorPose::new(self.pose), &self.request)
    }

    /// Compares images with the reference.
    fn check(&self, prediction: &Prediction) {
        let plan = FramePlan::new(&self.world, &self.sensor, &self.pose, &self.request).unwrap();
        let report = common::compare_or_show(&common::reference(&plan), &prediction.images, &plan, Precision::F32);
        assert_eq!(report.fault, 0, "{:?}", report.faults.first());
    }
}

/// Every image, bit by bit.
fn bits(images: &Images) -> Vec<u32> {
    Output::ALL.into_iter().flat_map(|output| common::bits(images, output)).collect()
}

fn options(backend: Backend) -> Options {
    Options::new(backend).with_threads(1)
}

/// A predictor on any adapter, and the switches of its device.
fn on(backend: Backend) -> (Predictor, Switches) {
    with(backend, Setup::default(), false)
}

fn with(backend: Backend, setup: Setup, wrong: bool) -> (Predictor, Switches) {
    let (engine, switches) = Faulty::new(setup, wrong).unwrap();
    (Predictor::with_engine(options(backend), Box::new(engine)), switches)
}

/// A row takes an H100 several times as long as two cores.
#[test]
fn rows_are_left_to_the_cpu_unless_a_gpu_is_named() {
    if Task::new().is_none() {
        return;
    }
    let (world, row, pose) =
        (scenes::room_world(3, 20), scenes::scanner(360, 1), Pose::from_xyz_rpy(DVec3::Z, 0.0, 0.0, 0.3));
    for (backend, engine) in [(Backend::Auto, "cpu"), (Backend::Gpu, "gpu")] {
        let mut predictor = on(backend).0;
        for (sensor, engine) in [(&row, engine), (&scenes::camera(32, 24), "gpu"), (&row, engine)] {
            let prediction = predictor.predict(&world, sensor, &SensorPose::new(pose), &Request::default()).unwrap();
            assert_eq!(prediction.stats.engine, engine, "{backend:?}, {}", sensor.spec().name);
        }
    }
}

#[test]
fn a_lost_gpu_is_opened_again_with_the_same_images() {
    let Some(task) = Task::new() else { return };
    for backend in [Backend::Gpu, Backend::Auto] {
        let (mut predictor, switches) = on(backend);
        let before = task.predict(&mut predictor).unwrap();
        assert_eq!(before.stats.notices, Vec::<String>::new());
        task.check(&before);
        for _ in 0..2 {
            switches.lose();
            let after = task.predict(&mut predictor).unwrap();
            assert_eq!(after.stats.engine, "gpu");
            assert_eq!(bits(&after.images), bits(&before.images), "{backend:?}");
            let [notice] = &after.stats.notices[..] else { panic!("{:?}", after.stats.notices) };
            assert!(notice.starts_with("the GPU was opened again after this: "), "{notice}");
            // A new device draws repeatedly until its buffers are large enough, and the number varies.
            let once = |p: &Prediction, stage| p.stats.stages_ms.iter().filter(|(name, _)| *name == stage).count();
            let counts = [StageName::Selection, StageName::Upload, StageName::Echo].map(|stage| once(&after, stage));
            assert_eq!(counts, [1; 3], "nothing of the failed attempt is counted");
        }
    }
}

#[test]
fn where_it_cannot_be_opened_auto_continues_with_the_cpu() {
    let Some(task) = Task::new() else { return };
    let (mut predictor, switches) = on(Backend::Auto);
    assert!(predictor.engine_name().starts_with("gpu"), "{}", predictor.engine_name());
    let before = task.predict(&mut predictor).unwrap();
    switches.set_gone(true);
    switches.lose();
    let expected = task.predict(&mut Predictor::new(options(Backend::Cpu)).unwrap()).unwrap();
    // It stays there: the device would not come back between two predictions.
    for gone in [true, false] {
        switches.set_gone(gone);
        let after = task.predict(&mut predictor).unwrap();
        assert_eq!((after.stats.engine, predictor.engine_name().as_str()), ("cpu", "cpu"));
        assert!(after.stats.adapter.is_none());
        assert_eq!(bits(&after.images), bits(&expected.images));
        let [notice] = &after.stats.notices[..] else { panic!("{:?}", after.stats.notices) };
        assert!(notice.starts_with("the CPU engine took over: ") && notice.contains("lost"), "{notice}");
        task.check(&after);
        // The planted fault: continuing with the GPU's partial images would show here.
        assert_ne!(bits(&after.images), bits(&before.images), "the engines' last bits differ");
    }
}

#[test]
fn by_name_a_lost_gpu_is_an_error_until_it_can_be_opened() {
    let Some(task) = Task::new() else { return };
    let (mut predictor, switches) = on(Backend::Gpu);
    let before = task.predict(&mut predictor).unwrap();
    switches.set_gone(true);
    switches.lose();
    for _ in 0..2 {
        let lost = task.predict(&mut predictor).unwrap_err();
        assert_eq!((lost.kind(), lost.kind().exit_status()), (ErrorKind::DeviceLost, 3), "{lost}");
        assert!(predictor.engine_name().starts_with("gpu"));
    }
    switches.set_gone(false);
    let after = task.predict(&mut predictor).unwrap();
    assert_eq!(bits(&after.images), bits(&before.images));
    assert_eq!(after.stats.notices.len(), 1);
}

#[test]
fn too_little_memory_is_an_error_by_name_and_the_cpu_with_auto() {
    let Some(mut task) = Task::new() else { return };
    let small = Setup { largest_binding: Some(1 << 19), ..Setup::default() };
    let [mut named, mut auto] = [Backend::Gpu, Backend::Auto].map(|backend| with(backend, small, false).0);
    let fits = task.predict(&mut named).unwrap();
    let smaller = std::mem::replace(&mut task.sensor, scenes::camera(400, 300));
    let full = task.predict(&mut named).unwrap_err();
    assert_eq!((full.kind(), full.kind().exit_status()), (ErrorKind::DeviceMemory, 3), "{full}");
    let instead = task.predict(&mut auto).unwrap();
    assert_eq!(instead.stats.engine, "cpu");
    assert!(instead.stats.notices[0].starts_with("the CPU engine took over: "), "{:?}", instead.stats.notices);
    task.check(&instead);
    // The device is not lost: a smaller request works.
    task.sensor = smaller;
    let again = task.predict(&mut named).unwrap();
    assert_eq!(bits(&again.images), bits(&fits.images));
    assert!(again.stats.notices.is_empty(), "{:?}", again.stats.notices);
}

#[test]
fn a_driver_that_draws_wrong_is_an_error_by_name_and_the_cpu_with_auto() {
    let Some(task) = Task::new() else { return };
    let wrong = |backend| with(backend, Setup::default(), true).0;
    let refused = task.predict(&mut wrong(Backend::Gpu)).unwrap_err();
    assert_eq!((refused.kind(), refused.kind().exit_status()), (ErrorKind::NoDevice, 3), "{refused}");
    assert!(refused.to_string().contains("pixels of a probe wrong"), "{refused}");
    let instead = task.predict(&mut wrong(Backend::Auto)).unwrap();
    assert_eq!(instead.stats.engine, "cpu");
    let [notice] = &instead.stats.notices[..] else { panic!("{:?}", instead.stats.notices) };
    assert!(notice.starts_with("the CPU engine took over: ") && notice.contains("wrong"), "{notice}");
    task.check(&instead);
}

/// Compute spans take over from a faulty hardware rasterizer with every backend, and the prediction reports it.
#[test]
fn compute_spans_take_over_from_a_hardware_rasterizer_that_draws_wrong_or_is_lost() {
    let Some(task) = Task::new() else { return };
    let by_compute = task.predict(&mut on(Backend::Gpu).0).unwrap();
    for backend in [Backend::Gpu, Backend::Auto] {
        let rendering = |wrong| {
            let (engine, switches) = Faulty::with_render(wrong).unwrap();
            (Predictor::with_engine(options(backend), Box::new(engine)), switches)
        };
        let told = |after: &Prediction, why: &str| {
            assert_eq!((after.stats.engine, after.stats.raster), ("gpu", Some(Raster::Compute)));
            assert_eq!(bits(&after.images), bits(&by_compute.images), "{backend:?}");
            let [notice] = &after.stats.notices[..] else { panic!("{:?}", after.stats.notices) };
            let start = "compute spans took over from the hardware rasterizer: ";
            assert!(notice.starts_with(start) && notice.contains(why), "{notice}");
        };
        told(&task.predict(&mut rendering(true).0).unwrap(), "pixels of a probe wrong");
        let (mut predictor, switches) = rendering(false);
        let right = task.predict(&mut predictor).unwrap();
        assert_eq!((right.stats.raster, right.stats.notices.len()), (Some(Raster::Render), 0));
        task.check(&right);
        switches.lose();
        told(&task.predict(&mut predictor).unwrap(), "lost");
        // And they stay in use.
        told(&task.predict(&mut predictor).unwrap(), "lost");
    }
}

/// Repeats predictions, as `predict --repeat N` does, while another thread removes the device at any point of a
/// prediction.
#[test]
fn when_lost_during_predictions_every_result_is_right_or_an_error() {
    let Some(task) = Task::new() else { return };
    let (mut predictor, switches) = on(Backend::Gpu);
    let before = task.predict(&mut predictor).unwrap();
    let (mut random, mut recovered) = (common::Random(1), 0);
    for n in 0..40 {
        let thiefs = switches.clone();
        let wait = Duration::from_micros(random.below(4000) as u64);
        let thief = std::thread::spawn(move || {
            std::thread::sleep(wait);
            thiefs.lose();
        });
        let answer = task.predict(&mut predictor);
        thief.join().unwrap();
        match answer {
            Ok(after) => {
                assert_eq!(bits(&after.images), bits(&before.images), "prediction {n}, lost after {wait:?}");
                recovered += usize::from(!after.stats.notices.is_empty());
            }
            Err(e) => assert_eq!(e.kind(), ErrorKind::DeviceLost, "prediction {n}, lost after {wait:?}: {e}"),
        }
    }
    eprintln!("{recovered} of 40 answers came after a recovery");
    assert!(recovered > 0);
    assert_eq!(bits(&task.predict(&mut predictor).unwrap().images), bits(&before.images));
}

#[test]
fn a_gpu_lost_during_a_batch_loses_no_pose() {
    let Some(task) = Task::new() else { return };
    let pose = |i: usize| task.pose * Pose::from_xyz_rpy(DVec3::X * 0.01 * i as f64, 0.0, 0.0, 0.02 * i as f64);
    let images = Some((&task.request).into());
    let request = BatchRequest { images, chunk: Some(3), statistics: true, ..BatchRequest::default() };
    let (mut whole, _) = on(Backend::Gpu);
    let mut single =
        |i| bits(&whole.predict(&task.world, &task.sensor, &SensorPose::new(pose(i)), &task.request).unwrap().images);
    let singles: Vec<_> = (0..10).map(&mut single).collect();
    // Checks that the comparison can fail.
    assert!(singles[0] != singles[1]);
    for (backend, gone) in [(Backend::Gpu, false), (Backend::Gpu, true), (Backend::Auto, true)] {
        let (mut predictor, switches) = on(backend);
        switches.set_gone(gone);
        let lossy = (0..10).map(|i| {
            if i == 4 {
                switches.lose();
            }
            pose(i)
        });
        let batch =
            predictor.batch(&task.world, &task.sensor, lossy.into_iter().map(SensorPose::new), &request).unwrap();
        let mut items: Vec<_> = batch.collect();
        if backend == Backend::Gpu && gone {
            // The second chunk begins with pose 3.
            let e = items.pop().unwrap().unwrap_err();
            assert_eq!((items.len(), e.kind(), e.place()), (3, ErrorKind::DeviceLost, Some("pose 3")), "{e}");
        } else {
            assert_eq!(items.len(), 10);
        }
        for (i, item) in items.into_iter().enumerate() {
            let item = item.unwrap();
            let by_cpu = item.stats.is_some_and(|stats| stats.engine == "cpu");
            assert_eq!(by_cpu, backend == Backend::Auto && i >= 3);
            assert!(by_cpu || bits(&item.images) == singles[i], "pose {i}");
        }
    }
}
