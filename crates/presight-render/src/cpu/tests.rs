//! The engine against every polygon on every ray, written as plainly as can be.

use super::*;
use crate::deadline::Watch;
use crate::plan::{ImageRequest, Output, Outputs};
use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Camera, Geometry, RayTable, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use proptest::prelude::*;

fn camera() -> Sensor {
    let camera = Camera::pinhole(61, 40, 30.0, 28.0, 29.3, 19.9);
    Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera))).unwrap()
}

fn scanner(start_deg: f64, step_deg: f64, count: u32, rows: u32) -> Sensor {
    let scanner = Scanner {
        azimuth: Angles::Uniform { start_deg, step_deg, count },
        elevation: Angles::Uniform { start_deg: -31.0, step_deg: 2.0, count: rows },
        beam_height_deg: None,
    };
    Sensor::new(SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner))).unwrap()
}

fn rays() -> Sensor {
    let of = scanner(-120.0, 5.0, 47, 30);
    let directions = (0..30u32).flat_map(|r| (0..47u32).map(move |c| (c, r)));
    let directions = directions.map(|(c, r)| of.ray(c, r).unwrap()).collect();
    let table = RayTable::new(47, 30, directions).unwrap();
    Sensor::new(SensorSpec::new("rays", "laser", Geometry::Rays(table))).unwrap()
}

fn world(triangles: &[[Vec3; 3]]) -> World {
    let vertices = triangles.iter().flatten().copied().collect();
    let polygons = (0..triangles.len() as u32).map(|i| Polygon::new(vec![3 * i, 3 * i + 1, 3 * i + 2], 0)).collect();
    let mesh = Mesh::new("soup", vertices, polygons, PolygonOrder::Spatial).unwrap();
    let mut environment = Environment::new();
    environment.add_material(Material::named("grey")).unwrap();
    let pose = Pose::from_xyz_rpy(DVec3::new(1.0, -2.0, 0.5), 0.2, -0.4, 2.5);
    environment.insert(NewObject::new("soup", pose, mesh.into())).unwrap();
    World::new(environment)
}

fn render(plan: &FramePlan, threads: usize) -> Images {
    let mut images = Images::default();
    CpuEngine::new(threads).unwrap().render(plan, &mut images, &mut Stats::default()).unwrap();
    images
}

fn same_bits(a: &Images, b: &Images) -> bool {
    let floats = |x: &[f32], y: &[f32]| x.len() == y.len() && x.iter().zip(y).all(|(x, y)| x.to_bits() == y.to_bits());
    floats(&a.range, &b.range)
        && floats(&a.depth_z, &b.depth_z)
        && floats(&a.cos_incidence, &b.cos_incidence)
        && floats(&a.echo, &b.echo)
        && floats(a.normal.as_flattened(), b.normal.as_flattened())
        && (&a.polygon_id, &a.object_id) == (&b.polygon_id, &b.object_id)
}

/// Range and id of a ray; `None` where it passes an edge so closely that either answer is right.
fn cast(world: &World, origin: DVec3, ray: DVec3) -> Option<(f64, u32)> {
    let mut best = (f64::INFINITY, 0);
    for slot in 0..world.environment().slot_count() {
        let v = world.environment().polygon_in_world(slot).unwrap();
        let n = (v[1] - v[0]).cross(v[2] - v[0]);
        let range = n.dot(v[0] - origin) / n.dot(ray);
        let at = origin + ray * range;
        let sides: Vec<f64> = (0..3)
            .map(|k| n.dot((v[(k + 1) % 3] - v[k]).cross(at - v[k])) / (n.length() * (v[(k + 1) % 3] - v[k]).length()))
            .collect();
        let least = sides.iter().map(|s| s / n.length()).fold(f64::INFINITY, f64::min);
        if range > 0.0 && least.abs() < 1e-7 * range.max(1.0) {
            return None;
        }
        if range > 0.0 && least > 0.0 && range < best.0 {
            best = (range, slot + 1);
        }
    }
    Some(best)
}

fn check(world: &World, sensor: &Sensor, pose: &Pose) -> Result<(), TestCaseError> {
    let request = ImageRequest { outputs: Outputs::ALL, ..ImageRequest::default() };
    let plan = FramePlan::new(world, sensor, pose, request).unwrap();
    let images = render(&plan, 1);
    prop_assert!(same_bits(&render(&plan, 3), &images));
    let world_from_image = pose.rotation_matrix() * sensor.body_from_image();
    let mut sure = 0;
    for row in 0..sensor.height() {
        for column in 0..sensor.width() {
            let ray = sensor.ray(column, row).unwrap();
            let Some((range, id)) = cast(world, pose.translation, world_from_image * ray) else {
                continue;
            };
            sure += 1;
            let i = (row * sensor.width() + column) as usize;
            prop_assert_eq!(images.polygon_id[i], id, "pixel {},{}", column, row);
            if id == 0 {
                prop_assert!(images.range[i] == f32::INFINITY && images.cos_incidence[i].is_nan());
                continue;
            }
            prop_assert!((f64::from(images.range[i]) / range - 1.0).abs() < 1e-6);
            if sensor.is_camera() {
                prop_assert!((f64::from(images.depth_z[i]) - range * ray.z).abs() < 1e-6 * range);
            }
            let v = world.environment().polygon_in_world(id - 1).unwrap();
            let normal = (v[1] - v[0]).cross(v[2] - v[0]).normalize();
            let cos = normal.dot(world_from_image * ray).abs();
            prop_assert!((f64::from(images.cos_incidence[i]) - cos).abs() < 1e-6);
            prop_assert_eq!(images.object_id[i], 1);
        }
    }
    prop_assert!(sure > images.pixels() * 9 / 10);
    Ok(())
}

fn soup() -> impl Strategy<Value = Vec<[Vec3; 3]>> {
    let point = prop::array::uniform3(-6.0..6.0f32).prop_map(Vec3::from);
    prop::collection::vec((point, prop::array::uniform3(prop::array::uniform3(-3.0..3.0f32))), 1..40).prop_map(|all| {
        let corners = |(at, offsets): (Vec3, [[f32; 3]; 3])| offsets.map(|o| at + Vec3::from(o));
        all.into_iter().map(corners).filter(|[a, b, c]| (*b - *a).cross(*c - *a).length() > 1e-2).collect()
    })
}

fn pose() -> impl Strategy<Value = Pose> {
    (prop::array::uniform3(-4.0..4.0f64), prop::array::uniform3(-3.1..3.1f64))
        .prop_map(|(t, [r, p, y])| Pose::from_xyz_rpy(t.into(), r, p / 2.0, y))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn camera_agrees(triangles in soup(), pose in pose()) {
        check(&world(&triangles), &camera(), &pose)?;
    }

    #[test]
    fn scanner_agrees(triangles in soup(), pose in pose(), start in -200.0..200.0f64, back in prop::bool::ANY) {
        let step = if back { -3.75 } else { 3.75 };
        check(&world(&triangles), &scanner(start, step, 96, 32), &pose)?;
        check(&world(&triangles), &scanner(start, step / 4.0, 96, 1), &pose)?;
    }

    /// Few rows are drawn across columns: their bits are those of the same rows among more, also where polygons lie in
    /// one place.
    #[test]
    fn few_rows_are_rows_among_more(
        triangles in soup(), pose in pose(), start in -200.0..200.0f64, step in -5.0..5.0f64, columns in 1..70u32,
    ) {
        prop_assume!(step.abs() > 0.1);
        let world = world(&[&triangles[..], &triangles[..]].concat());
        let outputs = Outputs::ALL.without(Output::DepthZ);
        let of = |rows: u32| {
            let request = ImageRequest { outputs, ..ImageRequest::default() };
            render(&FramePlan::new(&world, &scanner(start, step, columns, rows), &pose, request).unwrap(), 1)
        };
        let all = of(9);
        for rows in 1..=5 {
            let few = of(rows);
            // The lowest ones, which come last.
            let first = ((9 - rows) * columns) as usize;
            let bits = |image: &[f32]| image.iter().map(|x| x.to_bits()).collect::<Vec<u32>>();
            prop_assert_eq!(bits(&few.range), bits(&all.range[first..]), "{} rows", rows);
            prop_assert_eq!(bits(&few.cos_incidence), bits(&all.cos_incidence[first..]), "{} rows", rows);
            prop_assert_eq!(&few.polygon_id[..], &all.polygon_id[first..], "{} rows", rows);
        }
    }

    #[test]
    fn ray_table_agrees(triangles in soup(), pose in pose()) {
        check(&world(&triangles), &rays(), &pose)?;
    }
}

/// Twenty walls behind each other, each over the whole image, drawn in one wave: after two samples drawn for each of a
/// band the depth is looked at again, before the fourth wall.
#[test]
fn walls_behind_what_the_same_wave_drew_are_not_drawn() {
    let mut environment = Environment::new();
    environment.add_material(Material::named("grey")).unwrap();
    for i in 1..=20 {
        let x = i as f32;
        let corners = [(-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0)].map(|(y, z)| Vec3::new(x, x * y, x * z));
        let mesh = Mesh::new("wall", corners.to_vec(), vec![Polygon::new(vec![0, 1, 2, 3], 0)], PolygonOrder::Given);
        environment.insert(NewObject::new("wall", Pose::IDENTITY, mesh.unwrap().into())).unwrap();
    }
    let sensor =
        Sensor::new(SensorSpec::new("c", "video", Geometry::Camera(Camera::pinhole(64, 64, 40.0, 40.0, 31.5, 31.5))));
    let plan =
        FramePlan::new(&World::new(environment), &sensor.unwrap(), &Pose::IDENTITY, ImageRequest::default()).unwrap();
    let (mut images, mut stats) = (Images::default(), Stats::default());
    CpuEngine::new(1).unwrap().render(&plan, &mut images, &mut stats).unwrap();
    assert!(images.polygon_id.iter().all(|id| *id == 1));
    assert_eq!((stats.count_of(CountName::Waves), stats.count_of(CountName::PolygonsSetUp)), (Some(1), Some(20)));
    assert_eq!(stats.count_of(CountName::SamplesTested), Some(3 * 64 * 64));
    assert_eq!(stats.count_of(CountName::Spans), Some(3 * 64));
}

#[test]
fn a_miss_beside_and_behind_the_image_plane_is_infinitely_deep() {
    let distortion = presight_model::sensor::Distortion::Equidistant([0.0; 4]);
    let camera = Camera { distortion, ..Camera::pinhole(41, 3, 10.0, 10.0, 20.0, 1.0) };
    let camera = Sensor::new(SensorSpec::new("fisheye", "video", Geometry::Camera(camera))).unwrap();
    assert!(camera.ray(0, 1).unwrap().z < 0.0, "it sees behind itself");
    let request = ImageRequest { outputs: Outputs::ALL, ..ImageRequest::default() };
    let images = render(&FramePlan::new(&world(&[]), &camera, &Pose::IDENTITY, request).unwrap(), 1);
    assert!(images.depth_z.iter().chain(&images.range).all(|x| *x == f32::INFINITY), "{:?}", images.depth_z);
}

#[test]
fn ties_go_to_the_lower_slot_and_neighbours_leave_no_crack() {
    // Each quad of a wall twice, the second time wound the other way: 2 coincident triangles everywhere.
    let mut triangles = Vec::new();
    for i in 0..10 {
        let y = -5.0 + i as f32;
        let q = [(y, -3.0), (y + 1.0, -3.0), (y + 1.0, 3.0), (y, 3.0)].map(|(y, z)| Vec3::new(4.0, y, z));
        triangles.extend([[q[0], q[1], q[2]], [q[0], q[2], q[3]], [q[2], q[1], q[0]], [q[3], q[2], q[0]]]);
    }
    let mut environment = Environment::new();
    environment.add_material(Material::named("grey")).unwrap();
    let vertices: Vec<Vec3> = triangles.iter().flatten().copied().collect();
    let index = |v: &Vec3| vertices.iter().position(|w| w == v).unwrap() as u32;
    let polygons = triangles.iter().map(|t| Polygon::new(t.iter().map(index).collect(), 0)).collect();
    let mesh = Mesh::new("wall", vertices.clone(), polygons, PolygonOrder::Given).unwrap();
    environment.insert(NewObject::new("wall", Pose::IDENTITY, mesh.into())).unwrap();
    let world = World::new(environment);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.05, 0.3), 0.3, 0.1, -0.05);
    let plan = FramePlan::new(&world, &camera(), &pose, ImageRequest::default()).unwrap();
    let images = render(&plan, 0);
    let interior = images.polygon_id.iter().filter(|&&id| id != 0).count();
    assert!(interior > 1000);
    assert!(images.polygon_id.iter().all(|&id| id == 0 || (id - 1) % 4 < 2), "an upper twin won");
    // Every pixel between two hits of a row is a hit.
    for row in images.polygon_id.chunks(images.width as usize) {
        let first = row.iter().position(|&id| id != 0);
        let last = row.iter().rposition(|&id| id != 0);
        if let (Some(first), Some(last)) = (first, last) {
            assert!(row[first..=last].iter().all(|&id| id != 0));
        }
    }
}

/// By hand: a square of 2 m, 2 m ahead, is 40 pixels wide at a focal length of 40 pixels, and a ray (x, y, z) meets it
/// if neither |y| nor |z| is more than half of x.
#[test]
fn with_a_deadline_samples_with_a_polygon_are_counted() {
    let square = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(y, z)| Vec3::new(2.0, y, z));
    let mut environment = Environment::new();
    environment.add_material(Material::named("grey")).unwrap();
    let mesh = Mesh::new("square", square.to_vec(), vec![Polygon::new(vec![0, 1, 2, 3], 0)], PolygonOrder::Given);
    environment.insert(NewObject::new("square", Pose::IDENTITY, mesh.unwrap().into())).unwrap();
    let world = World::new(environment);
    let pinhole = Geometry::Camera(Camera::pinhole(64, 64, 40.0, 40.0, 31.5, 31.5));
    let camera = Sensor::new(SensorSpec::new("c", "video", pinhole)).unwrap();
    let met = |sensor: &Sensor| {
        let (w, h) = (sensor.width(), sensor.height());
        let rays = (0..h)
            .flat_map(|v| (0..w).map(move |u| (u, v)))
            .filter_map(|(u, v)| sensor.ray(u, v).map(|r| sensor.body_from_image() * r));
        rays.filter(|r| r.x > 0.0 && r.y.abs() < r.x / 2.0 && r.z.abs() < r.x / 2.0).count()
    };
    assert_eq!(met(&camera), 40 * 40);
    for sensor in [&camera, &rays(), &scanner(-60.0, 1.0, 121, 32)] {
        let count = met(sensor);
        let mut plan = FramePlan::new(&world, sensor, &Pose::IDENTITY, ImageRequest::default()).unwrap();
        plan.set_watch(Watch::start(Arc::new(crate::deadline::SystemClock::default()), Duration::from_secs(1000)));
        let (mut images, mut stats) = (Images::default(), Stats::default());
        CpuEngine::new(2).unwrap().render(&plan, &mut images, &mut stats).unwrap();
        assert_eq!(images.polygon_id.iter().filter(|id| **id != 0).count(), count);
        assert_eq!(stats.count_of(CountName::SamplesWritten), Some(count as u64));
    }
}
