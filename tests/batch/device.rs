//! Weighs images on the device without reading them back, and compares the weights with those of images that are read
//! back, and with a calculation by hand.

use super::{common, frame_of, likelihood::disturbed, noisy, predictor, single};
use common::{Random, data, scenes, skip};
use glam::{DVec3, Vec3};
use presight_model::environment::NewObject;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Camera, Geometry, Noise, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::batch::{BatchRequest, Headings, PoseCell, RangeLikelihood};
use presight_predict::gpu::testing;
use presight_predict::gpu::testing::Setup;
use presight_predict::gpu::{DeviceOptions, GpuEngine};
use presight_predict::predict::{Backend, Options, Predictor};
use presight_render::plan::StageName;
use presight_render::plan::{Output, Outputs};
use std::sync::Arc;

/// A predictor with every stage on the device, on software adapters too.
fn on_device() -> Option<Predictor> {
    let made = testing::open(DeviceOptions::default(), Setup::ALL_ON_DEVICE);
    let engine: GpuEngine = made.inspect_err(|e| skip::no_adapter(e)).ok()?;
    Some(Predictor::with_engine(Options::new(Backend::Gpu).with_threads(2), Box::new(engine)))
}

/// The log-likelihoods of all headings of all poses, or of the poses, and the number of bytes read back.
fn weighed(
    engine: &mut Predictor,
    world: &World,
    sensor: &Sensor,
    request: &BatchRequest,
    on_device: bool,
) -> (Vec<f64>, u64) {
    let poses = (0..5).map(|i| {
        let lean = if request.headings.is_some() { 0.0 } else { 0.1 };
        Pose::from_xyz_rpy(DVec3::new(0.2 * f64::from(i) - 0.4, 0.1, 1.4), lean, 0.0, f64::from(i))
    });
    let request = BatchRequest { statistics: true, ..request.clone() };
    let (mut all, mut bytes) = (Vec::new(), 0);
    for item in engine.batch(world, sensor, poses.into_iter().map(SensorPose::new), &request).unwrap() {
        let item = item.unwrap();
        let stats = item.stats.unwrap();
        let taken = stats.taken.iter().any(|v| v.what == StageName::WeighOnDevice);
        assert_eq!(taken, on_device, "{}", sensor.spec().name);
        bytes += stats.work.gpu_bytes_read;
        all.extend(item.log_likelihood);
        all.extend(item.headings.iter().map(|l| f64::from(*l)));
    }
    (all, bytes)
}

/// Compares the sums and describes the differences and the bytes read back.
fn check(engine: &mut Predictor, sensor: &Sensor, headings: Option<Headings>) -> String {
    let (world, mut random) = (World::new(scenes::room(3, 40)), Random(7));
    let exact =
        single(&mut predictor(2), &world, sensor, &Pose::from_xyz_rpy(DVec3::new(0.1, 0.1, 1.4), 0.0, 0.0, 0.3)).0;
    let sensed = disturbed(&mut random, sensor.spec(), &exact);
    let cell = PoseCell { side: 0.05, turn: 0.01 };
    let of = |sensed: &[f32]| Some(RangeLikelihood::new(&frame_of(sensor, sensed.to_vec()), cell).unwrap());
    let sums = BatchRequest { likelihood: of(&sensed), headings, ..BatchRequest::default() };
    let images = BatchRequest { images: Some(Outputs::of(&[Output::Range]).into()), ..sums.clone() };
    let (ours, bytes) = weighed(engine, &world, sensor, &sums, true);
    let (theirs, image_bytes) = weighed(engine, &world, sensor, &images, false);
    let name = &sensor.spec().name;
    assert!(ours.len() == theirs.len() && ours.len() >= 5, "{name}");
    let beams = sensed.iter().filter(|z| !z.is_nan()).count() as f64;
    let apart = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs() / beams).fold(0.0, f64::max);
    assert!(apart(&ours, &theirs) < 2e-6, "{name}: {:?} {:?}", &ours[..5], &theirs[..5]);
    // Planted fault: the measured image shifted by one column.
    let mut turned = sensed.clone();
    turned.rotate_right(1);
    let (faulty, _) = weighed(engine, &world, sensor, &BatchRequest { likelihood: of(&turned), ..sums }, true);
    assert!(apart(&faulty, &theirs) > 1e-3, "{name}: the fault must be noticed");
    format!("{name}: {:.1e} a beam apart, {bytes} bytes in place of {image_bytes}", apart(&ours, &theirs))
}

#[test]
fn sums_on_the_device_equal_those_of_its_images() {
    let Some(mut engine) = on_device() else { return };
    let noise = Noise { range_sigma: 0.02, range_sigma_quadratic: 1e-3, angle_sigma: 2e-3, ..Noise::default() };
    for preset in data::presets().iter().filter(|sensor| sensor.width() * sensor.height() < 1 << 18) {
        // Level one-row scanners use a cut on the CPU, so the poses here are tilted.
        println!("{}", check(&mut engine, &noisy(preset, noise), None));
    }
    let near = presight_read::preset("laser-range-camera").unwrap().spec().clone().with_limits(1.5, 3.0);
    println!("{}", check(&mut engine, &noisy(&Sensor::new(near).unwrap(), noise), None));
    println!("{}", check(&mut engine, &noisy(&scenes::lens(80, 60), noise), None));
    let rows = noisy(&presight_read::preset("vlp-16").unwrap(), noise);
    let headings = Headings::new(&rows, 90).unwrap();
    println!("{}", check(&mut engine, &rows, Some(headings)));
    // One direction twice: in the image, and resampled to the headings of a panorama with other steps.
    let closed = noisy(&scenes::closed(144, 7), noise);
    for headings in [None, Some(Headings::new(&closed, 143).unwrap()), Some(Headings::new(&closed, 36).unwrap())] {
        println!("{}", check(&mut engine, &closed, headings));
    }
}

/// Calculated by hand: a wall 2 m ahead at normal incidence; the numbers are in docs/batches.md.
#[test]
fn one_beam_by_hand() {
    let Some(mut engine) = on_device() else { return };
    let camera = Geometry::Camera(Camera::pinhole(1, 1, 100.0, 100.0, 0.0, 0.0));
    let spec = SensorSpec::new("one", "laser", camera).with_limits(0.5, 10.0);
    let sensor = Sensor::new(spec.with_noise(Noise { range_sigma: 0.1, ..Noise::default() })).unwrap();
    let mut environment = scenes::empty();
    let wall = scenes::cuboid(Vec3::new(2.0, -1.0, -1.0), Vec3::new(3.0, 1.0, 1.0));
    environment.insert(NewObject::new("wall", Pose::IDENTITY, Arc::new(wall))).unwrap();
    let world = World::new(environment);
    let mut weigh = |sensed: f32| {
        let likelihood = Some(RangeLikelihood::new(&frame_of(&sensor, vec![sensed]), PoseCell::default()).unwrap());
        let request = BatchRequest { likelihood, statistics: true, ..BatchRequest::default() };
        let item = engine.batch(&world, &sensor, [SensorPose::IDENTITY], &request).unwrap().next().unwrap().unwrap();
        assert!(item.stats.unwrap().taken.iter().any(|v| v.what == StageName::WeighOnDevice));
        item.log_likelihood.unwrap().exp()
    };
    for (sensed, by_hand) in [
        (2.125, 1.369_868_1 + 0.01),
        (1.875, 1.369_868_1 + 0.05 + 0.01),
        (1.0, 0.05 + 0.01),
        (9.0, 0.01),
        (f32::INFINITY, 0.05),
        (f32::NEG_INFINITY, 0.005 + 0.025),
    ] {
        let ours = weigh(sensed);
        assert!((ours / by_hand - 1.0).abs() < 1e-5, "{sensed}: {ours}, by hand {by_hand}");
    }
}
