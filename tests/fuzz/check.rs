//! Checks that hold for everything that a reader accepts.

use crate::common::{plan, reference, scenes};
use glam::{DQuat, DVec3, Vec3};
use presight_features::{BoxOptions, BoxQuery, FeatureSettings, add_boxes, place, predict_features};
use presight_files::prediction_json;
use presight_model::environment::FeatureLayer;
use presight_model::environment::{Environment, NewObject};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Camera, Geometry, Sensor, SensorSpec};
use presight_model::world::World;
use presight_read::sensor_toml;
use presight_render::cpu;
use presight_render::plan::{Images, Output, Stats};
use presight_render::verify::{Precision, compare};
use std::cell::RefCell;
use std::sync::Arc;

/// The largest number of pixels and polygons of a prediction: larger ones are too slow.
const MOST_PIXELS: u64 = 4096;
const MOST_POLYGONS: u32 = 2000;

thread_local! {
    static ENGINE: RefCell<cpu::CpuEngine> = RefCell::new(cpu::CpuEngine::new(1).expect("a thread"));
}

/// Returns true if the length is 1 within rounding.
pub fn near_unit(q: DQuat) -> bool {
    (q.length_squared() - 1.0).abs() < 1e-9
}

/// A box at the origin of its own object and a wall, with the names used in the corpora.
pub fn stage() -> Environment {
    let mut environment = scenes::empty();
    let boxes = Arc::new(scenes::cuboid(Vec3::new(-0.5, -0.5, 0.0), Vec3::new(0.5, 0.5, 2.0)));
    let wall = Arc::new(scenes::mesh(&[[[0.0, -5.0, -1.0], [0.0, 5.0, -1.0], [0.0, 5.0, 3.0], [0.0, -5.0, 3.0]]
        .map(Vec3::from)
        .to_vec()]));
    let at = |x: f64| Pose::from_xyz_rpy(DVec3::new(x, 0.0, 0.0), 0.0, 0.0, 0.1);
    environment.insert(NewObject::new("box", at(4.0), boxes.clone())).expect("a valid object");
    environment.insert(NewObject::new("hall/door", at(6.0), boxes)).expect("a valid object");
    environment.insert(NewObject::new("wall", at(8.0), wall)).expect("a valid object");
    environment
}

/// Compares the CPU engine with the reference, and checks both against the documented use of NaN.
pub fn check_view(world: &World, sensor: &Sensor, pose: &Pose) {
    let plan = plan(world, sensor, pose);
    let shown = reference(&plan);
    let mut images = Images::default();
    ENGINE
        .with(|engine| engine.borrow_mut().render(&plan, &mut images, &mut Stats::default()))
        .expect("the engine renders");
    check_numbers(&images, sensor);
    let report = compare(&shown, &images, &plan, Precision::F64).expect("images of one shape");
    assert_eq!(report.fault, 0, "{}: first {:#?}", sensor.spec().name, report.faults.first());
}

/// NaN occurs where there is no ray, and as the angle where there is no hit; nowhere else.
fn check_numbers(images: &Images, sensor: &Sensor) {
    let width = images.width;
    for (i, id) in images.polygon_id.iter().enumerate() {
        let (column, row) = (i as u32 % width, i as u32 / width);
        let ray = sensor.ray(column, row).is_some();
        let (range, cos) = (images.range[i], images.cos_incidence[i]);
        assert_eq!(range.is_nan(), !ray, "range {range} at ({column}, {row})");
        assert_eq!(cos.is_nan(), *id == 0, "cos_incidence {cos} at ({column}, {row})");
        assert!(cos.is_nan() || (0.0..=1.0).contains(&cos), "cos_incidence {cos} at ({column}, {row})");
        let normal = Vec3::from(images.normal[i]);
        assert_eq!(normal.is_nan(), *id == 0, "normal {normal} at ({column}, {row})");
        assert!(normal.is_nan() || normal.is_normalized(), "normal {normal} at ({column}, {row})");
        assert!(*id == 0 || (range.is_finite() && range >= 0.0) || range == f32::NEG_INFINITY, "range {range}");
        if sensor.is_camera() {
            let depth = images.floats(Output::DepthZ).expect("asked for")[i];
            assert_eq!(depth.is_nan(), !ray, "depth_z {depth} at ({column}, {row})");
        }
    }
}

/// Predicts an imported scene.
pub fn check_world(environment: Environment) {
    let bounds = environment.bounds();
    if environment.slot_count() > MOST_POLYGONS || environment.slot_count() == 0 || !bounds.min.is_finite() {
        return;
    }
    let world = World::new(environment);
    let at = bounds.min.lerp(bounds.max, 0.3);
    let pose = Pose::from_xyz_rpy(at, 0.1, 0.2, 0.3);
    for sensor in [scenes::camera(17, 13), scenes::scanner(24, 5)] {
        check_view(&world, &sensor, &pose);
    }
}

/// An imported sensor: checks its rays and its text, and predicts. Returns false if it is refused later.
pub fn sound_sensor(spec: &SensorSpec) -> bool {
    assert!(near_unit(spec.mount.rotation) && spec.mount.translation.is_finite(), "{:?}", spec.mount);
    let (width, height) = spec.geometry.size();
    let pixels = u64::from(width) * u64::from(height);
    if (MOST_PIXELS..=presight_model::limits::MAX_PIXELS).contains(&pixels) {
        return false;
    }
    let Ok(sensor) = Sensor::new(spec.clone()) else { return false };
    let written = sensor_toml::to_string(spec);
    let again = sensor_toml::parse(&written, "other", None).unwrap_or_else(|e| panic!("{e}: {written}"));
    assert_eq!(again, *spec, "{written}");
    let rays = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
    for ray in rays.filter_map(|(column, row)| sensor.ray(column, row)) {
        assert!((ray.length() - 1.0).abs() < 1e-9, "{ray} of {written}");
    }
    check_view(&World::new(stage()), &sensor, &Pose::IDENTITY);
    true
}

/// An imported layer: predicts its features in a scene with their boxes. Returns false if the scene refuses it.
pub fn check_layer(layer: &FeatureLayer) -> bool {
    let mut environment = stage();
    let layer = FeatureLayer { class: "video".into(), ..layer.clone() };
    if layer.features.len() > 50 || environment.add_layer(layer.clone()).is_err() {
        return false;
    }
    let world = World::new(environment);
    let Ok(placed) = place(&world, &layer) else { return false };
    let camera = Camera::pinhole(33, 25, 20.0, 20.0, 16.0, 12.0);
    let sensor = Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera))).expect("a valid camera");
    let pose = Pose::from_xyz_rpy(DVec3::new(0.0, 0.3, 1.0), 0.0, 0.0, 0.0);
    let images = reference(&plan(&world, &sensor, &pose));
    let options = FeatureSettings { feature_id: true, ..FeatureSettings::default() };
    let Ok(mut seen) = predict_features(&world, &sensor, &pose, &images, &placed, &options) else { return false };
    let boxes = BoxOptions::default().with_sensor_sigmas([0.01; 6]);
    if add_boxes(
        &mut seen,
        &BoxQuery { placed: &placed, world: &world, sensor: &sensor, world_from_sensor: &pose, options: &boxes },
    )
    .is_err()
    {
        return false;
    }
    for f in &seen.features {
        assert!((0.0..=1.0).contains(&f.visible_fraction), "{f:?}");
        assert!((0.0..=1.0).contains(&f.existence), "{f:?}");
        assert!(f.points_world.iter().all(|p| p.is_finite()), "{f:?}");
        assert!(f.range.is_none_or(|r| r.is_finite() && r >= 0.0), "{f:?}");
        assert!(f.cos_incidence.is_none_or(|c| (0.0..=1.0).contains(&c)), "{f:?}");
        let inside =
            |b: &[f64; 4]| b[0] >= -0.5 && b[1] >= -0.5 && b[2] <= 32.5 && b[3] <= 24.5 && b[0] < b[2] && b[1] < b[3];
        assert!(f.roi.as_ref().is_none_or(inside), "{f:?}");
    }
    let header = prediction_json::Header::new(&sensor, SensorPose::new(pose));
    prediction_json::to_string(&header, &seen, world.environment(), None).expect("a prediction is JSON");
    true
}
