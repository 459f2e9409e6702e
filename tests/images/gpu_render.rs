//! Compares the hardware rasterizer with compute spans: counts the pixels that differ, and checks them against the
//! bound of f32.
#![cfg(feature = "gpu")]
#![expect(clippy::print_stderr, reason = "the tests print how many pixels differ")]

use presight_testkit as common;

use common::hall::{hall_poses, open_hall};
use common::hard::{case, grazing};
use common::skip::no_adapter;
use common::{data, env_number, plan, reference, scenes};
use glam::{DVec3, Vec3};
use presight_model::environment::NewObject;
use presight_model::geometry::Pose;
use presight_model::sensor::{Camera, Geometry, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::gpu::testing;
use presight_predict::gpu::testing::{Hiding, Setup};
use presight_predict::gpu::{DeviceOptions, GpuEngine};
use presight_render::plan::{CountName, StageName};
use presight_render::plan::{FramePlan, Images, Raster, Stats};
use presight_render::verify::Precision;
use proptest::strategy::{Strategy, ValueTree};
use proptest::test_runner::{RngSeed, TestRunner};
use std::sync::Arc;

/// Returns an engine; `None` where there is no adapter, or none that can render.
fn engine(raster: Raster, without_int64: bool, setup: Setup) -> Option<GpuEngine> {
    let options = DeviceOptions { raster, without_int64, ..DeviceOptions::default() };
    let engine = testing::open(options, setup).map_err(no_adapter).ok()?;
    if !engine.abilities().render {
        common::skip::skip("the adapter cannot render");
        return None;
    }
    Some(engine)
}

/// One path after the other, with both kinds of keys. One of the engines resolves images on the device.
struct Paths {
    pairs: Vec<[GpuEngine; 2]>,
    pixels: usize,
    differ: usize,
    rendered: u64,
}

impl Paths {
    fn open(hiding: Hiding) -> Option<Self> {
        let pair = |narrow| {
            let setup = Setup { hiding, all_on_device: narrow, ..Setup::default() };
            Some([engine(Raster::Compute, narrow, setup)?, engine(Raster::Render, narrow, setup)?])
        };
        Some(Self { pairs: vec![pair(false)?, pair(true)?], pixels: 0, differ: 0, rendered: 0 })
    }

    /// Draws a plan both ways. Where the paths differ in any bit, the rendered images are compared with the reference.
    fn compare(&mut self, plan: &FramePlan) {
        for [compute, render] in &mut self.pairs {
            let (spans, _) = draw(compute, plan);
            let (rendered, stats) = draw(render, plan);
            let bits = |images: &Images| images.outputs().iter().map(|o| common::bits(images, o)).collect::<Vec<_>>();
            let (a, b) = (bits(&spans), bits(&rendered));
            let pixels = spans.pixels();
            let differ = (0..pixels).filter(|i| a.iter().zip(&b).any(|(a, b)| a[*i] != b[*i])).count();
            if differ > 0 {
                let report = common::compare_or_show(&reference(plan), &rendered, plan, Precision::F32);
                assert_eq!(report.fault, 0, "{:?}", report.faults.first());
            }
            self.pixels += pixels;
            self.differ += differ;
            self.rendered += stats.count_of(CountName::PolygonsRendered).unwrap_or(0);
        }
    }

    /// Prints the differences, which are rounding at edges: at most one pixel in a hundred thousand.
    fn tell(&self, what: &str) {
        eprintln!("{what}: {} of {} pixels differ, {} polygons rendered", self.differ, self.pixels, self.rendered);
        assert!(self.differ * 100_000 <= self.pixels, "{what}: {} of {} pixels differ", self.differ, self.pixels);
        assert!(self.rendered > 0, "{what}: nothing was rendered");
    }
}

fn draw(engine: &mut GpuEngine, plan: &FramePlan) -> (Images, Stats) {
    let (mut images, mut stats) = (Images::default(), Stats::default());
    engine.render(plan, &mut images, &mut stats).expect("the engine renders");
    assert_eq!(stats.count_of(CountName::HitsWithoutId).unwrap_or(0), 0);
    (images, stats)
}

#[test]
fn hard_scenes_equal_those_of_spans() {
    let Some(mut paths) = Paths::open(Hiding::WhereItPays) else { return };
    let cases = env_number("PROPTEST_CASES", 300);
    let rng_seed = RngSeed::Fixed(env_number("PRESIGHT_SEED", 1));
    let mut runner = TestRunner::new(proptest::test_runner::Config { rng_seed, ..Default::default() });
    for i in 0..cases {
        let one = match i % 4 {
            0 => grazing().new_tree(&mut runner).expect("a case").current(),
            _ => case().new_tree(&mut runner).expect("a case").current(),
        };
        let (world, pose, sensors) = one.build();
        for sensor in sensors.iter().filter(|sensor| sensor.is_camera()) {
            paths.compare(&plan(&world, sensor, &pose));
        }
    }
    paths.tell("hard scenes");
}

#[test]
fn rooms_and_halls_equal_those_of_spans_with_waves_too() {
    let Some(mut paths) = Paths::open(Hiding::Always) else { return };
    let hall = open_hall(3, 20_000);
    let poses = hall_poses(&hall, 5, 3);
    let hall = World::new(hall);
    for pose in &poses {
        paths.compare(&plan(&hall, &scenes::camera(211, 157), pose));
    }
    for seed in 0..4 {
        let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.3), 0.1, 0.05, 0.7 * seed as f64);
        paths.compare(&plan(&scenes::room_world(seed, 60), &scenes::camera(197, 161), &pose));
    }
    paths.tell("rooms and halls");
}

#[test]
fn real_models_equal_those_of_spans() {
    let Some(mut paths) = Paths::open(Hiding::WhereItPays) else { return };
    let mut found = false;
    for name in ["hospital", "factory_hall"] {
        let Some(world) = data::scene(name, true) else { continue };
        found = true;
        for pose in data::poses(&world, env_number("PRESIGHT_POSES", 2) as usize, 31) {
            paths.compare(&plan(&world, &scenes::camera(320, 240), &pose));
        }
    }
    if found {
        paths.tell("real models");
    }
}

/// One metre of the wall is four pixels, and its centre is the centre of pixel (15, 11).
fn camera() -> Sensor {
    let geometry = Geometry::Camera(Camera::pinhole(32, 24, 16.0, 16.0, 15.0, 11.0));
    Sensor::new(SensorSpec::new("camera", "laser", geometry).with_limits(0.1, 100.0)).expect("a camera")
}

/// Squares 4 m ahead, and a polygon that extends behind the camera.
fn world(polygons: &[Vec<Vec3>]) -> World {
    let mut environment = scenes::empty();
    for (i, polygon) in polygons.iter().enumerate() {
        let mesh = Arc::new(scenes::mesh(std::slice::from_ref(polygon)));
        environment.insert(NewObject::new(format!("plate {i}"), Pose::IDENTITY, mesh)).expect("a valid object");
    }
    World::new(environment)
}

fn square() -> Vec<Vec3> {
    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(y, z)| Vec3::new(4.0, y, z)).to_vec()
}

/// The square's edges run through the centres of columns 11 and 19 and of rows 7 and 15, which belong to it: 9 x 9
/// pixels. A rasterizer that gets the square itself omits two sides.
#[test]
fn edges_through_centres_are_drawn_and_a_shape_that_is_not_grown_is_found() {
    for (shapes_not_grown, pixels) in [(false, 81), (true, 64)] {
        for narrow in [false, true] {
            let setup = Setup { shapes_not_grown, ..Setup::default() };
            let Some(mut engine) = engine(Raster::Render, narrow, setup) else { return };
            let (world, sensor) = (world(&[square()]), camera());
            let plan = plan(&world, &sensor, &Pose::IDENTITY);
            let (images, stats) = draw(&mut engine, &plan);
            assert_eq!(images.polygon_id.iter().filter(|id| **id == 1).count(), pixels, "{shapes_not_grown}");
            assert_eq!(stats.count_of(CountName::PolygonsRendered), Some(1));
            assert_eq!(stats.count_of(CountName::WorkItems), Some(0));
        }
    }
}

/// In one frame, spans draw a floor that begins behind the camera, and shapes draw the square.
#[test]
fn polygons_behind_the_camera_are_left_to_spans_in_the_same_frame() {
    let floor = [(-5.0, -6.0), (9.0, -6.0), (9.0, 6.0), (-5.0, 6.0)].map(|(x, y)| Vec3::new(x, y, -0.5)).to_vec();
    let world = world(&[square(), floor]);
    for narrow in [false, true] {
        let setup = Setup::default();
        let Some(mut render) = engine(Raster::Render, narrow, setup) else { return };
        let Some(mut compute) = engine(Raster::Compute, narrow, setup) else { return };
        let plan = plan(&world, &camera(), &Pose::IDENTITY);
        let (images, stats) = draw(&mut render, &plan);
        assert_eq!(stats.count_of(CountName::PolygonsSetUp), Some(2));
        assert_eq!(stats.count_of(CountName::PolygonsRendered), Some(1));
        assert!(stats.count_of(CountName::WorkItems) > Some(0));
        assert_eq!(images.polygon_id, draw(&mut compute, &plan).0.polygon_id);
        assert!([1, 2].iter().all(|id| images.polygon_id.contains(id)));
    }
}

#[test]
fn the_rasterizer_is_reported_with_the_reason() {
    let Some(mut render) = engine(Raster::Render, false, Setup::default()) else { return };
    let Some(mut compute) = engine(Raster::Compute, false, Setup::default()) else { return };
    assert_eq!((render.raster(), compute.raster()), (Raster::Render, Raster::Compute));
    let world = world(&[square()]);
    let (camera, scanner) = (camera(), scenes::scanner(360, 61));
    let why = |stats: &Stats| {
        let rows = stats.stages();
        let row = rows.iter().find(|row| row.name == StageName::HardwareRaster.name() && row.ms.is_none());
        row.map(|row| (row.ran, row.why.clone())).expect("the row is reported")
    };
    let (_, stats) = draw(&mut render, &plan(&world, &camera, &Pose::IDENTITY));
    assert_eq!((stats.raster, why(&stats).0), (Some(Raster::Render), true));
    let (_, stats) = draw(&mut render, &plan(&world, &scanner, &Pose::IDENTITY));
    assert_eq!(stats.raster, Some(Raster::Compute));
    assert_eq!(why(&stats), (false, "the sensor is not a pinhole camera".into()));
    let (_, stats) = draw(&mut compute, &plan(&world, &camera, &Pose::IDENTITY));
    assert_eq!(stats.raster, Some(Raster::Compute));
    assert_eq!(why(&stats), (false, "compute spans are the default".into()));
}

#[test]
fn in_steady_state_rendering_allocates_nothing() {
    for narrow in [false, true] {
        let setup = Setup { hiding: Hiding::Always, ..Setup::default() };
        let Some(mut engine) = engine(Raster::Render, narrow, setup) else { return };
        let world = scenes::room_world(2, 60);
        let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.3), 0.1, 0.05, 0.4);
        // Sensors in turns.
        let sensors = [scenes::camera(64, 48), scenes::camera(48, 64), scenes::scanner(90, 11)];
        let mut round = || {
            sensors.iter().for_each(|sensor| drop(draw(&mut engine, &plan(&world, sensor, &pose))));
            engine.allocations()
        };
        let first = round();
        assert_eq!(first, round());
    }
}
