//! Compares the GPU engine with the reference on any adapter (lavapipe in CI), with 64-bit and 32-bit atomics.
#![cfg(feature = "gpu")]
#![expect(clippy::print_stderr, reason = "the tests print the worst errors")]

use presight_testkit as common;

use common::skip::no_adapter;
use common::{plan, reference};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use presight_model::environment::{CUBOID_FACES, cuboid_corners};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::error::ErrorKind;
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Camera, Distortion, Geometry, RayTable, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::gpu::testing;
use presight_predict::gpu::testing::Setup;
use presight_predict::gpu::{DeviceOptions, GpuEngine};
use presight_predict::request::Request;
use presight_render::plan::StageName;
use presight_render::plan::{Images, Output, Outputs, Stats};
use presight_render::verify::{Precision, Report};
use std::sync::Arc;

/// Returns the engine, or `None` where there is no adapter and the machine may lack one.
fn engine(options: DeviceOptions, setup: Setup) -> Option<GpuEngine> {
    match testing::open(options, setup) {
        Ok(engine) => Some(engine),
        Err(e) => {
            no_adapter(e);
            None
        }
    }
}

/// Both kinds of depth keys; the second engine resolves images on the device even on a software adapter.
fn engines() -> Vec<(&'static str, GpuEngine)> {
    let with = |other| {
        let options = DeviceOptions { without_int64: other, ..Default::default() };
        engine(options, Setup { all_on_device: other, ..Setup::default() })
    };
    [("64-bit", with(false)), ("32-bit", with(true))].into_iter().filter_map(|(n, e)| Some((n, e?))).collect()
}

fn count(stats: &Stats, name: &str) -> u64 {
    stats.counts.iter().find(|(n, _)| n.name().contains(name)).unwrap_or_else(|| panic!("no count {name}")).1
}

/// Images filled with values that no prediction gives.
fn poisoned(sensor: &Sensor) -> Images {
    let mut images = Images::default();
    images.prepare(sensor.width(), sensor.height(), Outputs::ALL);
    for image in [&mut images.range, &mut images.depth_z, &mut images.cos_incidence, &mut images.echo] {
        image.fill(-12345.0);
    }
    images.normal.fill([-12345.0; 3]);
    images.polygon_id.fill(u32::MAX);
    images.object_id.fill(u32::MAX);
    images
}

/// Renders and compares: no fault, few edge pixels, no internal error.
fn check(name: &str, engine: &mut GpuEngine, world: &World, sensor: &Sensor, pose: &Pose) -> (Images, Stats) {
    let plan = plan(world, sensor, pose);
    let (mut images, mut stats) = (poisoned(sensor), Stats::default());
    engine.render(&plan, &mut images, &mut stats).unwrap();
    let report: Report = common::compare_or_show(&reference(&plan), &images, &plan, Precision::F32);
    let what =
        format!("{name} {}: {} of {} edge, worst {:?}", sensor.spec().name, report.edge, report.pixels, report.worst);
    eprintln!("{what}");
    if let Err(e) = report.check(5e-3) {
        panic!("{what}: {e}; {:#?}; {:?}", &report.faults[..report.faults.len().min(5)], stats.counts);
    }
    if plan.polygon_count == 0 {
        assert!(stats.left_out.iter().any(|l| l.what == StageName::DrawingOnDevice.into()), "{:?}", stats.left_out);
    } else {
        assert_eq!(count(&stats, "internal"), 0);
    }
    (images, stats)
}

fn sensor(name: &str, geometry: Geometry, range_max: f64) -> Sensor {
    Sensor::new(SensorSpec::new(name, "laser", geometry).with_limits(0.3, range_max)).unwrap()
}

fn uniform(start_deg: f64, step_deg: f64, count: u32) -> Angles {
    Angles::Uniform { start_deg, step_deg, count }
}

fn scanner(name: &str, azimuth: Angles, elevation: Angles, range_max: f64) -> Sensor {
    sensor(name, Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None }), range_max)
}

/// Every kind of grid, none square.
fn sensors() -> Vec<Sensor> {
    let table = (0..90 * 70).map(|i| {
        let (x, y) = (f64::from(i % 90) / 45.0 - 1.0, f64::from(i / 90) / 35.0 - 1.0);
        if i % 41 == 7 { DVec3::NAN } else { DVec3::new(1.0 - 0.2 * x * x, x * 1.7, y * 1.2) }
    });
    let lens = Camera {
        distortion: Distortion::PlumbBob([-0.2, 0.05, 0.001, -0.001, 0.0]),
        ..Camera::pinhole(120, 90, 110.0, 115.0, 58.3, 46.1)
    };
    let listed = Angles::Listed(vec![-170.0, -3.0, 5.0, 20.0, 20.5, 90.0, 179.0, 180.0]);
    vec![
        sensor("camera", Geometry::Camera(Camera::pinhole(160, 120, 130.0, 140.0, 77.3, 61.1)), f64::INFINITY),
        scanner("image", uniform(-180.0, 1.40625, 256), uniform(-25.0, 1.5, 34), 75.0),
        scanner("backwards", uniform(60.0, -0.7, 170), uniform(-90.0, 4.0, 46), 9.0),
        scanner("row", uniform(-180.0, 0.5, 720), uniform(0.0, 1.0, 1), 75.0),
        scanner("listed", listed, uniform(-80.0, 2.5, 65), 75.0),
        sensor("table", Geometry::Rays(RayTable::new(90, 70, table.collect()).unwrap()), 75.0),
        sensor("lens", Geometry::Camera(lens), 75.0),
        // More samples than a uniform buffer can hold.
        scanner("tall", uniform(0.0, 90.0, 2), uniform(-60.0, 0.05, 2200), 75.0),
    ]
}

fn cube_vertices() -> Vec<Vec3> {
    cuboid_corners(Vec3::splat(-0.5), Vec3::splat(0.5)).to_vec()
}

fn mesh(polygons: Vec<Polygon>) -> Arc<Mesh> {
    Arc::new(Mesh::new("cube", cube_vertices(), polygons, PolygonOrder::Spatial).unwrap())
}

fn insert(environment: &mut Environment, world_from_mesh: DAffine3, mesh: &Arc<Mesh>) {
    environment.insert(NewObject::from_affine("box", world_from_mesh, mesh.clone()).unwrap()).unwrap();
}

/// A room with boxes from two meshes: rotated, scaled, mirrored, some one-sided, some deleted.
fn scene(seed: u64, boxes: usize, offset: DVec3) -> World {
    let mut random = common::Random(seed);
    let mut environment = Environment::new();
    environment.add_material(Material::named("wall")).unwrap();
    environment.add_material(Material { one_sided: true, ..Material::named("inside") }).unwrap();
    let appearance = [("laser".to_owned(), presight_model::environment::Appearance::Invisible)].into();
    environment.add_material(Material { appearance, ..Material::named("glass") }).unwrap();
    let cube = mesh(CUBOID_FACES.iter().map(|f| Polygon::new(f.to_vec(), 0)).collect());
    let halves = |(i, f): (usize, &[u32; 4])| {
        let material = if i == 4 { 2 } else { 1 };
        [[f[0], f[1], f[2]], [f[0], f[2], f[3]]].map(|c| Polygon::new(c.to_vec(), material))
    };
    let shell = mesh(CUBOID_FACES.iter().enumerate().flat_map(halves).collect());
    let middle = offset + DVec3::new(0.3, -0.2, 2.0);
    let turn = DQuat::from_rotation_z(0.3);
    insert(
        &mut environment,
        DAffine3::from_scale_rotation_translation(DVec3::new(40.0, 30.0, 6.0), turn, middle),
        &cube,
    );
    for i in 0..boxes {
        let mut axis = || random.uniform(0.02, 2.0);
        let mut scale = DVec3::new(axis(), axis(), axis());
        if i % 3 == 0 {
            scale.x = -scale.x;
        }
        let mut angle = || random.uniform(-3.0, 3.0);
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, angle(), angle(), angle());
        let at = DVec3::new(random.uniform(-15.0, 15.0), random.uniform(-12.0, 12.0), random.uniform(-0.5, 4.5));
        let pose = DAffine3::from_scale_rotation_translation(scale, turn, offset + at);
        insert(&mut environment, pose, if i % 2 == 0 { &cube } else { &shell });
    }
    World::new(environment)
}

fn poses(offset: DVec3) -> [Pose; 3] {
    let pose = |x, y, z, r, p, yaw| Pose::from_xyz_rpy(offset + DVec3::new(x, y, z), r, p, yaw);
    [pose(0.0, 0.0, 1.0, 0.0, 0.0, 0.0), pose(3.1, -2.2, 1.7, 0.2, -0.3, 2.0), pose(-7.0, 5.0, 0.4, -0.4, 0.9, -1.2)]
}

#[test]
fn boxes_in_a_room_are_right_on_every_grid() {
    let world = scene(1, 60, DVec3::ZERO);
    for (name, mut engine) in engines() {
        for sensor in sensors() {
            let mut boxes = 0;
            for pose in poses(DVec3::ZERO) {
                let (images, _) = check(name, &mut engine, &world, &sensor, &pose);
                boxes += images.polygon_id.iter().filter(|id| **id > 6).count();
            }
            assert!(boxes > 0, "boxes are seen");
        }
    }
}

#[test]
fn a_site_in_utm_metres_keeps_its_millimetres() {
    let offset = DVec3::new(5_000_000.0, 500_000.0, 300.0);
    let world = scene(2, 20, offset);
    for (name, mut engine) in engines() {
        for sensor in sensors() {
            check(name, &mut engine, &world, &sensor, &poses(offset)[1]);
        }
    }
}

/// One large polygon beyond f32's resolution: its visibility depends on the sign of a tiny distance. A mirrored one is
/// visible from the same side as without the mirror.
fn floor(scale: DVec3) -> World {
    let vertices = vec![
        Vec3::new(-50.0, -50.0, 0.0),
        Vec3::new(50.0, -50.0, 0.0),
        Vec3::new(50.0, 50.0, 0.0),
        Vec3::new(-50.0, 50.0, 0.0),
    ];
    let mut environment = Environment::new();
    environment.add_material(Material { one_sided: true, ..Material::named("floor") }).unwrap();
    let mesh = Mesh::new("floor", vertices, vec![Polygon::new(vec![0, 1, 2, 3], 0)], PolygonOrder::Given).unwrap();
    let pose = Pose::from_xyz_rpy(DVec3::ZERO, 0.2, 0.1, 0.4);
    let object_from_mesh = DAffine3::from_scale(scale);
    environment.insert(NewObject { object_from_mesh, ..NewObject::new("floor", pose, Arc::new(mesh)) }).unwrap();
    World::new(environment)
}

#[test]
fn a_sensor_just_off_a_floor_knows_its_side() {
    for scale in [DVec3::ONE, DVec3::new(-1.0, 1.0, 1.0), DVec3::new(1.0, 1.0, -1.0)] {
        a_sensor_just_off_it_knows_its_side(&floor(scale), scale.z);
    }
}

/// `up` is 1 or -1: the side of the floor's front in its frame.
fn a_sensor_just_off_it_knows_its_side(world: &World, up: f64) {
    let normal = world.environment().objects()[0].world_from_object.rotation * (up * DVec3::Z);
    for (name, mut engine) in engines() {
        for sensor in sensors() {
            for height in [1e-9, 1e-6, 1e-4, 1e-3, 1e-2, 0.0, -1e-6] {
                // The sensor looks at the floor from either side.
                let pose = Pose::from_xyz_rpy(height * normal, 0.1, up * 0.8, 0.3);
                let (images, stats) = check(name, &mut engine, world, &sensor, &pose);
                let hits = images.polygon_id.iter().filter(|id| **id > 0).count();
                if height >= 1e-9 {
                    assert!(hits > 0, "{} at {height} m sees the floor", sensor.spec().name);
                } else {
                    assert_eq!(hits, 0, "{} at {height} m does not", sensor.spec().name);
                }
                if height.abs() <= 1e-4 && height > 0.0 {
                    assert_eq!(count(&stats, "f64"), 1, "{height}");
                }
            }
        }
    }
}

#[test]
fn ties_go_to_the_lower_id() {
    let mut environment = Environment::new();
    environment.add_material(Material::named("wall")).unwrap();
    let cube = mesh(CUBOID_FACES.iter().map(|f| Polygon::new(f.to_vec(), 0)).collect());
    for _ in 0..3 {
        insert(&mut environment, DAffine3::from_scale(DVec3::splat(8.0)), &cube);
    }
    let world = World::new(environment);
    for (name, mut engine) in engines() {
        for sensor in sensors() {
            let (images, _) =
                check(name, &mut engine, &world, &sensor, &Pose::from_xyz_rpy(DVec3::ZERO, 0.1, 0.2, 0.3));
            assert!(images.polygon_id.iter().all(|id| *id <= 6), "{name} {}", sensor.spec().name);
        }
    }
}

#[test]
fn only_requested_outputs_are_delivered_and_they_are_the_same() {
    let world = scene(3, 10, DVec3::ZERO);
    let pose = poses(DVec3::ZERO)[1];
    for ((name, mut engine), sensor) in engines().into_iter().zip([&sensors()[0], &sensors()[1]]) {
        let (all, _) = check(name, &mut engine, &world, sensor, &pose);
        for output in Output::ALL {
            if output == Output::DepthZ && !sensor.is_camera() {
                continue;
            }
            let request = Request::of(Outputs::of(&[output]));
            let plan = presight_render::plan::FramePlan::new(&world, sensor, &pose, &request).unwrap();
            let mut images = poisoned(sensor);
            engine.render(&plan, &mut images, &mut Stats::default()).unwrap();
            assert_eq!(images.outputs(), request.outputs);
            assert_eq!(common::bits(&images, output), common::bits(&all, output), "{output:?}");
        }
    }
}

#[test]
fn overflows_are_counted_and_run_again() {
    // More instances than a uniform buffer can hold.
    let world = scene(4, 1500, DVec3::ZERO);
    let sensor = scanner("image", uniform(-180.0, 0.5, 720), uniform(-25.0, 1.5, 34), 75.0);
    for (name, mut engine) in engines() {
        let (first, stats) = check(name, &mut engine, &world, &sensor, &poses(DVec3::ZERO)[0]);
        assert!(count(&stats, "reruns") > 0, "buffers begin small");
        let (second, stats) = check(name, &mut engine, &world, &sensor, &poses(DVec3::ZERO)[0]);
        assert_eq!(count(&stats, "reruns"), 0, "and stay large");
        assert_eq!(first.polygon_id, second.polygon_id);
        let bits = |i: &Images| i.range.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&first), bits(&second));
    }
}

#[test]
fn in_steady_state_nothing_is_allocated() {
    let (world, sensors, poses) = (scene(7, 200, DVec3::ZERO), sensors(), poses(DVec3::ZERO));
    for (name, mut engine) in engines() {
        // Sensors in turns, as on a robot.
        let round = |engine: &mut GpuEngine, sensors: &[Sensor]| {
            let images = poses.iter().flat_map(|pose| sensors.iter().map(move |s| (pose, s)));
            images.map(|(pose, s)| check(name, engine, &world, s, pose).0.polygon_id).collect::<Vec<_>>()
        };
        let opened = engine.allocations();
        let first = round(&mut engine, &sensors);
        let made = engine.allocations();
        assert!(made.buffers > opened.buffers && made.pipelines > 0 && made.bind_groups > 0, "{name}: {made:?}");
        for _ in 0..2 {
            assert_eq!(first, round(&mut engine, &sensors), "{name}");
            assert_eq!(made, engine.allocations(), "{name}: the same poses again need nothing more");
        }
        // The counts change when they should: another world needs meshes, a larger image needs buffers.
        check(name, &mut engine, &scene(8, 5, DVec3::ZERO), &sensors[0], &poses[0]);
        assert!(engine.allocations().staged > made.staged, "{name}");
        let large = sensor("large", Geometry::Camera(Camera::pinhole(700, 500, 600.0, 600.0, 350.0, 250.0)), 75.0);
        check(name, &mut engine, &world, &large, &poses[0]);
        assert!(
            engine.allocations().buffers > made.buffers && engine.allocations().bind_groups > made.bind_groups,
            "{name}"
        );
    }
}

#[test]
fn an_empty_world_and_changing_worlds_are_right() {
    let Some(mut engine) = engine(DeviceOptions::default(), Setup::default()) else { return };
    let empty = World::new(Environment::new());
    for sensor in sensors() {
        let (images, _) = check("empty", &mut engine, &empty, &sensor, &Pose::IDENTITY);
        assert!(images.polygon_id.iter().all(|id| *id == 0));
        for seed in 0..3 {
            // Each world has its own meshes, at addresses that may have been used before.
            check("changing", &mut engine, &scene(seed, 5, DVec3::ZERO), &sensor, &poses(DVec3::ZERO)[1]);
        }
    }
}

#[test]
fn a_lost_device_is_a_typed_error_and_a_new_engine_works() {
    let Some(mut engine) = engine(DeviceOptions::default(), Setup::default()) else { return };
    let (world, sensor) = (scene(5, 5, DVec3::ZERO), &sensors()[0]);
    let pose = poses(DVec3::ZERO)[0];
    check("before", &mut engine, &world, sensor, &pose);
    testing::device_loss(&engine)();
    let mut images = Images::default();
    for _ in 0..2 {
        let lost = engine.render(&plan(&world, sensor, &pose), &mut images, &mut Stats::default()).unwrap_err();
        assert_eq!(lost.kind(), ErrorKind::DeviceLost, "{lost}");
    }
    drop(engine);
    let mut again = GpuEngine::new(DeviceOptions::default()).unwrap();
    check("after", &mut again, &world, sensor, &pose);
}

#[test]
fn too_much_for_the_device_is_a_typed_error_and_the_engine_stays_usable() {
    let Some(mut engine) =
        engine(DeviceOptions::default(), Setup { largest_binding: Some(1 << 20), ..Setup::default() })
    else {
        return;
    };
    let (world, pose) = (scene(6, 5, DVec3::ZERO), poses(DVec3::ZERO)[0]);
    let wide = sensor("wide", Geometry::Camera(Camera::pinhole(1024, 512, 500.0, 500.0, 511.5, 255.5)), 75.0);
    let mut images = Images::default();
    let full = engine.render(&plan(&world, &wide, &pose), &mut images, &mut Stats::default()).unwrap_err();
    assert_eq!(full.kind(), ErrorKind::DeviceMemory, "{full}");
    check("after", &mut engine, &world, &sensors()[0], &pose);
}

#[test]
fn a_software_adapter_does_not_count_as_hardware() {
    let adapters = presight_predict::gpu::adapters();
    let found = GpuEngine::new(DeviceOptions { hardware_only: true, ..Default::default() });
    if adapters.iter().any(|a| a.hardware) {
        assert!(found.unwrap().adapter().hardware);
    } else {
        assert_eq!(found.err().map(|e| e.kind()), Some(ErrorKind::NoDevice));
    }
    assert!(adapters.iter().all(|a| !(a.hardware && a.name.contains("llvmpipe"))));
}
