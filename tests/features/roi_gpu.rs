//! Compares boxes from the device with those of the CPU twin: within 1/16 pixel, and with the same flag unless the
//! twin's own flag changes with all sigmas scaled by half a percent.
#![cfg(feature = "gpu")]
#![expect(clippy::print_stderr, reason = "the worst differences are worth reading")]

use presight_testkit as common;

use common::skip::no_adapter;
use common::{Random, data, scenes};
use glam::{DMat3, DQuat, DVec3};
use presight_features::roi::RoiFlag;
use presight_features::{
    BoxOptions, BoxQuery, FeaturePrediction, FeatureSettings, PlacedFeature, SeenFeature, add_boxes, place,
    predict_features,
};
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::{Pose, PoseCovariance};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::gpu::{DeviceOptions, GpuEngine, testing};
use presight_read::gltf::{ImportOptions, import};
use presight_read::preset;
use std::sync::Arc;

const TOLERANCE: f64 = 1.0 / 16.0;

fn engine() -> Option<GpuEngine> {
    match testing::open(DeviceOptions::default(), testing::Setup::ALL_ON_DEVICE) {
        Ok(engine) => Some(engine),
        Err(e) => {
            no_adapter(e);
            None
        }
    }
}

fn room() -> World {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/room.glb");
    World::new(import(path, &ImportOptions::default()).expect("the scene imports").environment)
}

/// The input of boxes.
struct Setting<'a> {
    world: &'a World,
    sensor: &'a Sensor,
    pose: Pose,
    placed: Vec<PlacedFeature>,
    prediction: FeaturePrediction,
    options: BoxOptions,
}

impl Setting<'_> {
    fn twin(&self, options: &BoxOptions, placed: &[PlacedFeature]) -> FeaturePrediction {
        let mut prediction = self.prediction.clone();
        add_boxes(
            &mut prediction,
            &BoxQuery { placed, world: self.world, sensor: self.sensor, world_from_sensor: &self.pose, options },
        )
        .unwrap();
        prediction
    }

    fn on_device(&self, engine: &mut GpuEngine, options: &BoxOptions) -> (FeaturePrediction, usize) {
        let mut prediction = self.prediction.clone();
        let made = engine
            .add_boxes(
                &mut prediction,
                &BoxQuery {
                    placed: &self.placed,
                    world: self.world,
                    sensor: self.sensor,
                    world_from_sensor: &self.pose,
                    options,
                },
            )
            .unwrap();
        (prediction, made)
    }

    /// The features whose flag changes if all sigmas change by half a percent.
    fn at_the_limit(&self) -> Vec<usize> {
        let flags = |scale: f64| {
            let square = scale * scale;
            let mut options = self.options.clone();
            options.sensor = scaled(&options.sensor, square);
            options.objects.iter_mut().for_each(|(_, own)| *own = scaled(own, square));
            let mut placed = self.placed.clone();
            placed.iter_mut().for_each(|p| scale_covariance(&mut Arc::make_mut(&mut p.feature).shape, square));
            self.twin(&options, &placed).features.iter().map(|f| f.roi_flag).collect::<Vec<_>>()
        };
        let (less, more) = (flags(0.995), flags(1.005));
        (0..less.len()).filter(|i| less[*i] != more[*i]).collect()
    }
}

fn scale_covariance(shape: &mut FeatureShape, by: f64) {
    match shape {
        FeatureShape::Segment { covariances, cross, .. } => {
            covariances.iter_mut().for_each(|c| *c *= by);
            *cross *= by;
        }
        FeatureShape::Point { covariance, .. }
        | FeatureShape::Patch { covariance, .. }
        | FeatureShape::Reflector { covariance, .. }
        | FeatureShape::Fiducial { covariance, .. }
        | FeatureShape::Contour { covariance, .. } => *covariance *= by,
    }
}

#[derive(Debug, Default)]
struct Agreement {
    boxes: usize,
    worst: f64,
    /// Boxes off by more than 1/16 pixel.
    far: usize,
    other_flags: Vec<usize>,
}

fn compare(twin: &FeaturePrediction, device: &FeaturePrediction) -> Agreement {
    let mut found = Agreement::default();
    assert_eq!(twin.features.len(), device.features.len());
    for (i, (a, b)) in twin.features.iter().zip(&device.features).enumerate() {
        assert_eq!(a.roi.is_some(), b.roi.is_some(), "feature {i}");
        let (Some(x), Some(y)) = (a.roi, b.roi) else { continue };
        found.boxes += 1;
        if a.roi_flag != b.roi_flag {
            found.other_flags.push(i);
            continue;
        }
        let off = x.iter().zip(y).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
        found.worst = found.worst.max(off);
        found.far += usize::from(!(off <= TOLERANCE));
    }
    found
}

/// Compares both ways and returns the number of boxes made on the device.
fn check(name: &str, engine: &mut GpuEngine, setting: &Setting<'_>) -> usize {
    let twin = setting.twin(&setting.options, &setting.placed);
    let (device, made) = setting.on_device(engine, &setting.options);
    let found = compare(&twin, &device);
    let linear = twin.features.iter().filter(|f| f.roi_flag == Some(RoiFlag::Linear)).count();
    eprintln!(
        "{name}: {} boxes, {linear} linear, {made} made on the device; worst {:.5} px, other flags {}",
        found.boxes,
        found.worst,
        found.other_flags.len()
    );
    assert_eq!(found.far, 0, "{name}: {found:?}");
    let covariances = |p: &FeaturePrediction| p.features.iter().map(|f| f.image_covariance.clone()).collect::<Vec<_>>();
    assert_eq!(covariances(&twin), covariances(&device), "{name}");
    if !found.other_flags.is_empty() {
        let limit = setting.at_the_limit();
        assert!(found.other_flags.iter().all(|i| limit.contains(i)), "{name}: {found:?}, at the limit {limit:?}");
    }
    made
}

fn all_seen(placed: &[PlacedFeature]) -> FeaturePrediction {
    let features = placed.iter().map(|p| SeenFeature::whole(&p.feature)).collect();
    FeaturePrediction { features, ..FeaturePrediction::default() }
}

/// A random covariance with this standard deviation, sometimes singular.
fn covariance(random: &mut Random, sigma: f64) -> DMat3 {
    let turn = DMat3::from_quat(DQuat::from_euler(
        glam::EulerRot::XYZ,
        random.uniform(-3.0, 3.0),
        random.uniform(-1.5, 1.5),
        random.uniform(-3.0, 3.0),
    ));
    let axis = |random: &mut Random| if random.below(4) == 0 { 0.0 } else { random.uniform(0.2, 1.0) * sigma };
    let axes = DVec3::new(axis(random), axis(random), axis(random));
    turn * DMat3::from_diagonal(axes * axes) * turn.transpose()
}

/// Features of all kinds ahead of a pose.
fn ahead(
    random: &mut Random,
    world: &World,
    pose: &Pose,
    count: u32,
    [near, far]: [f64; 2],
    sigma: f64,
) -> Vec<PlacedFeature> {
    let objects = world.environment().objects();
    let mut one = |id: u32| {
        let distance = near * (far / near).powf(random.uniform(0.0, 1.0));
        let side = random.uniform(-0.4, 0.4);
        let at = distance * DVec3::new(1.0, side, random.uniform(-0.3, 0.3));
        let mut by = || DVec3::from_array([0; 3].map(|_| random.uniform(-0.1, 0.1))) * distance;
        let (along, across) = (by(), by());
        let object = (id.is_multiple_of(3) && !objects.is_empty()).then(|| id / 3 % objects.len() as u32);
        let world_from_frame = object.map_or(Pose::IDENTITY, |o| objects[o as usize].world_from_object);
        let place = |p: DVec3| {
            let p = pose.transform_point(p) - world_from_frame.translation;
            world_from_frame.rotation_matrix().transpose() * p
        };
        let shape = match id % 5 {
            0 => FeatureShape::Point { at: place(at), covariance: covariance(random, sigma) },
            1 => FeatureShape::Patch {
                corners: [at - along, at - across, at + along, at + across].map(place).to_vec(),
                covariance: covariance(random, sigma),
            },
            _ => {
                let covariances = [covariance(random, sigma), covariance(random, sigma)];
                FeatureShape::Segment { ends: [place(at - along), place(at + along)], covariances, cross: DMat3::ZERO }
            }
        };
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature = Feature { id, name: None, object: None, shape, existence, properties };
        PlacedFeature { feature: feature.into(), object, slots: Vec::new() }
    };
    (1..=count).map(&mut one).collect()
}

fn scaled<A>(covariance: &PoseCovariance<A>, by: f64) -> PoseCovariance<A> {
    PoseCovariance::from_rows(covariance.as_rows().map(|row| row.map(|x| by * x)))
}

/// Diagonal except for a correlation of heading and position.
fn pose_covariance<A>(position: f64, angle: f64) -> PoseCovariance<A> {
    let mut m = PoseCovariance::from_sigmas([position, position, position, angle, angle, angle]);
    m[1][5] = 0.6 * position * angle;
    m[5][1] = m[1][5];
    m
}

fn sensors() -> Vec<Sensor> {
    let lens = presight_model::sensor::Distortion::PlumbBob([-0.2, 0.05, 1e-3, -5e-4, 0.0]);
    let camera = presight_model::sensor::Camera {
        distortion: lens,
        ..presight_model::sensor::Camera::pinhole(320, 240, 250.0, 252.0, 158.0, 121.0)
    };
    let lens = Sensor::new(presight_model::sensor::SensorSpec::new(
        "lens",
        "video",
        presight_model::sensor::Geometry::Camera(camera),
    ))
    .unwrap();
    let named = ["video-camera", "microwave-radar-image", "laser-range-camera", "microwave-radar-scan"];
    named.iter().map(|name| preset(name).unwrap()).chain([scenes::camera(201, 150), lens]).collect()
}

#[test]
fn boxes_equal_those_of_the_twin_from_comfortable_to_extreme() {
    let Some(mut engine) = engine() else { return };
    let world = room();
    let mut random = Random(3);
    let mut made = 0;
    // Sigmas of position, angle and feature; nearest and farthest distance.
    let cases = [
        ("comfortable", [0.02, 0.01, 0.01], [2.0, 20.0]),
        ("nothing", [0.0, 0.0, 0.0], [1.0, 20.0]),
        ("a nanometre", [1e-9, 1e-9, 1e-9], [1.0, 20.0]),
        ("bent", [0.1, 0.06, 0.05], [1.0, 8.0]),
        ("near", [0.02, 0.35, 0.002], [0.3, 1.0]),
        ("a kilometre", [1e3, 0.1, 1e-9], [1.0, 20.0]),
        ("far", [0.3, 0.001, 0.5], [50.0, 900.0]),
    ];
    for (case, [position, angle, sigma], distances) in cases {
        for (i, sensor) in sensors().iter().enumerate() {
            let site = if i % 2 == 0 { DVec3::ZERO } else { DVec3::new(5e5, -3e5, 40.0) };
            let pose = Pose::from_xyz_rpy(site + DVec3::new(0.3, 0.4, 1.2), 0.05, -0.1, 2.9);
            let placed = ahead(&mut random, &world, &pose, 200, distances, sigma);
            let mut options = BoxOptions::default().with_sensor(pose_covariance(position, angle));
            options.confidence = [0.9, 0.99, 0.999][i % 3];
            options.objects = vec![(0, pose_covariance(position, 0.2 * angle)), (1, pose_covariance(0.0, 0.1 * angle))];
            let prediction = all_seen(&placed);
            let setting = Setting { world: &world, sensor, pose, placed, prediction, options };
            made += check(&format!("{case}, {}", sensor.spec().name), &mut engine, &setting);
        }
    }
    assert!(made > 2000, "the device made {made} boxes only");
}

#[test]
fn boxes_equal_those_of_the_twin_in_real_scenes() {
    let Some(mut engine) = engine() else { return };
    for name in ["factory_hall", "hospital"] {
        let Some(world) = data::scene(name, true) else { continue };
        let generated =
            presight_features::generate::generate(world.environment(), "video", &Default::default()).unwrap();
        let placed = place(&world, &generated.layer).unwrap();
        let mut made = 0;
        for pose in data::poses(&world, 1, 5) {
            for name in ["video-camera", "microwave-radar-image"] {
                let sensor = preset(name).unwrap();
                let mut images = presight_render::plan::Images::default();
                let mut cpu = presight_render::cpu::CpuEngine::new(1).unwrap();
                cpu.render(
                    &common::plan(&world, &sensor, &pose),
                    &mut images,
                    &mut presight_render::plan::Stats::default(),
                )
                .unwrap();
                let options = FeatureSettings::default();
                let prediction = predict_features(&world, &sensor, &pose, &images, &placed, &options).unwrap();
                let options = BoxOptions::default().with_sensor(pose_covariance(0.03, 0.01));
                let setting =
                    Setting { world: &world, sensor: &sensor, pose, placed: placed.clone(), prediction, options };
                made += check(name, &mut engine, &setting);
            }
        }
        assert!(made > 500, "{name}: the device made {made} boxes only");
    }
}

/// Planted faults: each side moved inwards by a fifth, and two axes of the covariance swapped.
#[test]
fn faults_are_noticed() {
    let Some(mut engine) = engine() else { return };
    let (world, sensor) = (room(), preset("video-camera").unwrap());
    let pose = Pose::from_xyz_rpy(DVec3::new(0.3, 0.4, 1.2), 0.0, 0.0, 1.0);
    let placed = ahead(&mut Random(9), &world, &pose, 50, [2.0, 10.0], 0.02);
    let options = BoxOptions::default().with_sensor(pose_covariance(0.03, 0.01));
    let prediction = all_seen(&placed);
    let setting = Setting { world: &world, sensor: &sensor, pose, placed, prediction, options };
    let twin = setting.twin(&setting.options, &setting.placed);
    let (device, _) = setting.on_device(&mut engine, &setting.options);
    assert_eq!(compare(&twin, &device).far, 0);
    for side in 0..4 {
        let mut bad = device.clone();
        for b in bad.features.iter_mut().filter_map(|f| f.roi.as_mut()) {
            let size = b[2 + side % 2] - b[side % 2];
            b[side] += size * if side < 2 { 0.2 } else { -0.2 };
        }
        assert_eq!(compare(&twin, &bad).far, 50, "side {side}");
    }
    let mut swapped = setting.options.clone();
    (swapped.sensor[0][0], swapped.sensor[2][2]) = (4.0 * swapped.sensor[2][2], 0.25 * swapped.sensor[0][0]);
    let (bad, _) = setting.on_device(&mut engine, &swapped);
    assert!(compare(&twin, &bad).far > 25);
}

/// A second round over the same features allocates nothing on the device.
#[test]
fn boxes_of_the_second_frame_allocate_nothing() {
    let Some(mut engine) = engine() else { return };
    let (world, sensor) = (room(), preset("video-camera").unwrap());
    let pose = Pose::IDENTITY;
    let placed = ahead(&mut Random(9), &world, &pose, 300, [2.0, 10.0], 0.02);
    let options = BoxOptions::default().with_sensor(pose_covariance(0.03, 0.01));
    let prediction = all_seen(&placed);
    let setting = Setting { world: &world, sensor: &sensor, pose, placed, prediction, options };
    let first = setting.on_device(&mut engine, &setting.options);
    let made = engine.allocations();
    assert_eq!(setting.on_device(&mut engine, &setting.options), first);
    assert_eq!(engine.allocations(), made);
}
