//! The engine against a brute-force f64 check, on whatever adapter there is.

use super::*;
use crate::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use crate::geometry::Pose;
use crate::plan::{Outputs, Request};
use crate::sensor::{Angles, Camera, Geometry, RayTable, Scanner, SensorSpec};
use crate::world::World;
use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use std::sync::Arc;

/// The engine, or `None` with a loud line where there is no adapter and the machine may lack one.
fn engine(options: DeviceOptions) -> Option<Engine> {
    match Engine::new(options) {
        Ok(engine) => Some(engine),
        Err(e) => {
            assert!(std::env::var_os("CI").is_none(), "CI needs an adapter: {e}");
            eprintln!("SKIPPED: no adapter: {e}");
            None
        }
    }
}

fn engines() -> Vec<(&'static str, Engine)> {
    let with = |without_int64| engine(DeviceOptions { without_int64, ..Default::default() });
    [("64-bit", with(false)), ("32-bit", with(true))].into_iter().filter_map(|(n, e)| Some((n, e?))).collect()
}

/// Boxes and floor, some mirrored, scaled, one-sided; every polygon a convex quadrilateral or a triangle.
fn scene(seed: u64, boxes: usize, offset: DVec3) -> World {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut environment = Environment::new();
    environment.add_material(Material::named("wall")).unwrap();
    let one_sided = Material { one_sided: true, ..Material::named("inside") };
    environment.add_material(one_sided).unwrap();
    let cube = Arc::new(cube(0));
    let shell = Arc::new(cube_triangles(1));
    let room = DAffine3::from_scale_rotation_translation(
        DVec3::new(40.0, 30.0, 6.0),
        DQuat::from_rotation_z(0.3),
        offset + DVec3::new(0.3, -0.2, 2.0),
    );
    environment.insert(NewObject::from_affine("room", room, cube.clone()).unwrap()).unwrap();
    for i in 0..boxes {
        let mut scale = DVec3::new(random(), random(), random()) * 2.0 + 0.02;
        if i % 3 == 0 {
            scale.x = -scale.x;
        }
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, random() * 6.0, random() * 6.0, random() * 6.0);
        let at = DVec3::new(random() * 30.0 - 15.0, random() * 24.0 - 12.0, random() * 5.0 - 0.5);
        let pose = DAffine3::from_scale_rotation_translation(scale, turn, offset + at);
        let mesh = if i % 2 == 0 { &cube } else { &shell };
        environment.insert(NewObject::from_affine(format!("box {i}"), pose, mesh.clone()).unwrap()).unwrap();
    }
    World::new(environment)
}

fn cube_vertices() -> Vec<Vec3> {
    (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) - 0.5).collect()
}

const FACES: [[u32; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];

fn cube(material: u16) -> Mesh {
    let polygons = FACES.iter().map(|f| Polygon::new(f.to_vec(), material)).collect();
    Mesh::new("cube", cube_vertices(), polygons, PolygonOrder::Spatial).unwrap()
}

fn cube_triangles(material: u16) -> Mesh {
    let halves = |f: &[u32; 4]| [vec![f[0], f[1], f[2]], vec![f[0], f[2], f[3]]];
    let polygons = FACES.iter().flat_map(halves).map(|c| Polygon::new(c, material)).collect();
    Mesh::new("shell", cube_vertices(), polygons, PolygonOrder::Spatial).unwrap()
}

fn sensors() -> Vec<Sensor> {
    let sensor = |name: &str, geometry, max| {
        Sensor::new(SensorSpec { range_min: 0.3, range_max: max, ..SensorSpec::new(name, "laser", geometry) }).unwrap()
    };
    let uniform = |start_deg, step_deg, count| Angles::Uniform { start_deg, step_deg, count };
    let scan = |azimuth, elevation| Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
    let table: Vec<DVec3> = (0..40 * 30)
        .map(|i| {
            let (x, y) = (f64::from(i % 40) / 20.0 - 1.0, f64::from(i / 40) / 15.0 - 1.0);
            if i % 41 == 7 { DVec3::NAN } else { DVec3::new(1.0 - 0.2 * x * x, x * 1.7, y * 1.2) }
        })
        .collect();
    vec![
        sensor("camera", Geometry::Camera(Camera::pinhole(160, 120, 130.0, 140.0, 77.3, 61.1)), f64::INFINITY),
        sensor("image", scan(uniform(-180.0, 1.40625, 256), uniform(-25.0, 1.5, 34)), 75.0),
        sensor("backwards", scan(uniform(60.0, -0.7, 170), uniform(-90.0, 4.0, 46)), 9.0),
        sensor("row", scan(uniform(-180.0, 0.5, 720), uniform(0.0, 1.0, 1)), 75.0),
        sensor(
            "listed",
            scan(Angles::Listed(vec![5.0, -170.0, 179.0, 20.0, 20.0, -3.0]), uniform(-80.0, 2.5, 65)),
            75.0,
        ),
        sensor("table", Geometry::Rays(RayTable::new(40, 30, table).unwrap()), 75.0),
    ]
}

/// A hit of the check: model id, range, |cos|, how far inside the outline (angle, radians; negative is outside).
struct Hit {
    slot: u32,
    range: f64,
    cos: f64,
    inside: f64,
    range_bound: f64,
}

/// All polygons whose cone, grown by `epsilon` radians, holds a ray; f64, nothing culled.
fn hits(plan: &FramePlan, ray: DVec3, epsilon: f64) -> Vec<Hit> {
    let mut all = Vec::new();
    for (index, object) in plan.environment().objects().iter().enumerate() {
        let instance = plan.instance_of(index as u32);
        for polygon in 0..object.mesh.polygon_count() as u32 {
            let facing = plan.facings[usize::from(object.mesh.material(polygon))];
            let v: Vec<DVec3> = object
                .mesh
                .corners_of(polygon)
                .map(|p| instance.image_from_mesh * (p - instance.center_in_mesh))
                .collect();
            let normal = (v[1] - v[0]).cross(v[2] - v[0]).normalize();
            let d = normal.dot(v[0]);
            if facing.one_sided && d > 0.0 {
                continue;
            }
            let edges = (0..v.len()).map(|k| {
                let e = d.signum() * v[k].cross(v[(k + 1) % v.len()] - v[k]);
                e.dot(ray) / e.length()
            });
            let inside = edges.fold(f64::INFINITY, f64::min);
            let range = d / normal.dot(ray);
            if inside < -epsilon || range <= 0.0 {
                continue;
            }
            let nearest = v.iter().map(|v| v.length()).fold(f64::INFINITY, f64::min);
            let cos = normal.dot(ray).abs();
            let range_bound = (16.0 / cos + 16.0 * nearest / d.abs()) * 2f64.powi(-24);
            all.push(Hit { slot: object.first_slot + polygon, range, cos, inside, range_bound });
        }
    }
    all
}

/// Counts faults, and edge pixels beside them.
fn compare(plan: &FramePlan, images: &Images) -> (usize, usize, usize) {
    let (mut faults, mut edges, mut seen) = (0, 0, 0);
    let sensor = &plan.sensor;
    let pixel = match &sensor.spec().geometry {
        Geometry::Camera(c) => 1.0 / c.fx,
        _ => 0.01,
    };
    let epsilon = pixel * 2f64.powi(-12);
    for row in 0..sensor.height() {
        for column in 0..sensor.width() {
            let i = (row * sensor.width() + column) as usize;
            let Some(ray) = sensor.ray(column, row) else {
                faults += usize::from(!images.range[i].is_nan() || images.polygon_id[i] != 0);
                continue;
            };
            let all = hits(plan, ray, epsilon);
            let near = |a: &&Hit, b: &&Hit| a.range.total_cmp(&b.range);
            let best = all.iter().min_by(near);
            let sure = all.iter().filter(|h| h.inside > epsilon).min_by(near);
            let ok = accept(plan, images, i, ray, &all, sure);
            let id = images.polygon_id[i];
            faults += usize::from(!ok);
            seen += usize::from(id != 0);
            edges += usize::from(ok && best.map_or(0, |h| h.slot + 1) != id && id != 0);
            if !ok && faults <= 5 {
                let listed: Vec<_> = all.iter().map(|h| (h.slot + 1, h.range, h.inside / epsilon)).collect();
                eprintln!(
                    "fault at {column}, {row} of {}: id {id} range {} cos {}; {listed:?}",
                    sensor.spec().name,
                    images.range[i],
                    images.cos_incidence[i]
                );
            }
        }
    }
    (faults, edges, seen)
}

fn accept(plan: &FramePlan, images: &Images, i: usize, ray: DVec3, all: &[Hit], sure: Option<&Hit>) -> bool {
    let spec = plan.sensor.spec();
    let (id, range, cos) = (images.polygon_id[i], f64::from(images.range[i]), f64::from(images.cos_incidence[i]));
    // Nothing may be seen behind what surely covers the ray.
    let limit = sure.map_or(f64::INFINITY, |h| h.range * (1.0 + h.range_bound));
    if id == 0 {
        return range == f64::INFINITY && cos.is_nan() && limit * (1.0 + 1e-6) >= spec.range_max;
    }
    all.iter().any(|h| {
        let near = h.range * (1.0 - h.range_bound) <= limit;
        let bound = h.range * (h.range_bound + 2e-7);
        let range_fits = if range == f64::NEG_INFINITY {
            h.range - bound <= spec.range_min
        } else {
            (range - h.range).abs() <= bound && h.range + bound >= spec.range_min && h.range - bound <= spec.range_max
        };
        let depth_fits = !plan.sensor.is_camera()
            || range == f64::NEG_INFINITY
            || (f64::from(images.depth_z[i]) - h.range * ray.z).abs() <= bound;
        h.slot + 1 == id && near && range_fits && depth_fits && (cos - h.cos).abs() < 4e-6
    })
}

fn poses(offset: DVec3) -> Vec<Pose> {
    let pose = |x, y, z, r, p, yaw| Pose::from_xyz_rpy(offset + DVec3::new(x, y, z), r, p, yaw);
    vec![
        pose(0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
        pose(3.1, -2.2, 1.7, 0.2, -0.3, 2.0),
        pose(-7.0, 5.0, 0.4, -0.4, 0.9, -1.2),
    ]
}

fn check_all(world: &World, poses: &[Pose]) {
    let request = Request { outputs: Outputs::ALL, ..Request::default() };
    for (name, mut engine) in engines() {
        for sensor in sensors() {
            for pose in poses {
                let plan = FramePlan::new(world, &sensor, pose, &request);
                let mut stats = Stats::default();
                let mut images = poisoned(&sensor);
                engine.render(&plan, &mut images, &mut stats).unwrap();
                let (faults, edges, seen) = compare(&plan, &images);
                let pixels = images.pixels();
                let what = format!("{name} {}: {faults} faults, {edges} edges, {seen} of {pixels}", sensor.spec().name);
                eprintln!("{what} {:?}", stats.counts);
                assert_eq!(faults, 0, "{what}");
                assert!(edges * 200 <= pixels && seen > 0, "{what}");
                engine.gpu.check().unwrap();
                assert!(stats.counts.iter().all(|(n, v)| !n.contains("internal") || *v == 0));
            }
        }
    }
}

/// Images of a value that no prediction gives.
fn poisoned(sensor: &Sensor) -> Images {
    let mut images = Images::default();
    images.prepare(sensor.width(), sensor.height(), Outputs::ALL);
    images.range.fill(-12345.0);
    images.polygon_id.fill(u32::MAX);
    images
}

#[test]
fn boxes_in_a_room_are_right_on_every_grid() {
    check_all(&scene(1, 40, DVec3::ZERO), &poses(DVec3::ZERO));
}

#[test]
fn a_site_in_utm_metres_keeps_its_millimetres() {
    let offset = DVec3::new(5_000_000.0, 500_000.0, 300.0);
    check_all(&scene(2, 10, offset), &poses(offset)[..2]);
}
