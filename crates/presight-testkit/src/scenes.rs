//! Small synthetic scenes and sensors.

use super::Random;
use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Camera, Distortion, Geometry, RayTable, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use std::sync::Arc;

/// A mesh of polygons, in which equal corners share one vertex. `None` if the mesh refuses a polygon.
pub fn try_mesh(polygons: &[Vec<Vec3>]) -> Option<Mesh> {
    let mut vertices: Vec<Vec3> = Vec::new();
    let mut known = std::collections::HashMap::new();
    let mut list = Vec::new();
    for polygon in polygons {
        let corners = polygon.iter().map(|p| {
            *known.entry(p.to_array().map(f32::to_bits)).or_insert_with(|| {
                vertices.push(*p);
                vertices.len() as u32 - 1
            })
        });
        list.push(Polygon::new(corners.collect(), 0));
    }
    Mesh::new("test", vertices, list, PolygonOrder::Given).ok()
}

/// As [`try_mesh`], for valid polygons.
pub fn mesh(polygons: &[Vec<Vec3>]) -> Mesh {
    try_mesh(polygons).expect("a sound mesh")
}

/// The six faces of a box, with shared corners.
pub fn cuboid(least: Vec3, most: Vec3) -> Mesh {
    Mesh::cuboid("box", least, most, 0).expect("a sound box")
}

/// An empty environment with one opaque material.
pub fn empty() -> Environment {
    let mut environment = Environment::new();
    environment.add_material(Material::named("grey")).expect("a sound material");
    environment
}

/// A room of 10 x 8 x 3 m with boxes at random poses.
pub fn room(seed: u64, boxes: usize) -> Environment {
    let mut random = Random(seed);
    let mut environment = empty();
    let shell = cuboid(Vec3::new(-5.0, -4.0, 0.0), Vec3::new(5.0, 4.0, 3.0));
    environment.insert(NewObject::new("shell", Pose::IDENTITY, Arc::new(shell))).expect("a sound object");
    let unit = Arc::new(cuboid(Vec3::new(-0.3, -0.2, -0.5), Vec3::new(0.3, 0.2, 0.5)));
    for _ in 0..boxes {
        let mut at = DVec3::new(random.uniform(-4.5, 4.5), random.uniform(-3.5, 3.5), random.uniform(0.2, 2.5));
        if at.truncate().length() < 1.2 {
            at.x += 2.5;
        }
        let turn = |random: &mut Random| random.uniform(-3.0, 3.0);
        let pose = Pose::from_xyz_rpy(at, turn(&mut random), turn(&mut random), turn(&mut random));
        environment.insert(NewObject::new("box", pose, unit.clone())).expect("a sound object");
    }
    environment
}

/// [`room`] as a world.
pub fn room_world(seed: u64, boxes: usize) -> World {
    World::new(room(seed, boxes))
}

/// A camera with different focal lengths in x and y.
pub fn camera(width: u32, height: u32) -> Sensor {
    let f = f64::from(width);
    let (cx, cy) = (f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0);
    let camera = Camera::pinhole(width, height, f, 1.1 * f, cx, cy);
    Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera))).expect("a sound camera")
}

/// A scanner of the full turn, with `rows` from -45 to 45 degrees.
pub fn scanner(columns: u32, rows: u32) -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 360.0 / f64::from(columns), count: columns };
    let step_deg = 90.0 / f64::from(rows.max(2) - 1);
    let elevation = Angles::Uniform { start_deg: if rows == 1 { 0.0 } else { -45.0 }, step_deg, count: rows };
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    Sensor::new(SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner))).expect("a sound scanner")
}

/// A scanner of the full turn whose last column has the direction of its first.
pub fn closed(columns: u32, rows: u32) -> Sensor {
    let spec = scanner(columns, rows).spec().clone();
    let Geometry::Scanner(mut scanner) = spec.geometry.clone() else { unreachable!("a scanner") };
    let step_deg = 360.0 / f64::from(columns - 1);
    scanner.azimuth = Angles::Uniform { start_deg: -180.0, step_deg, count: columns };
    Sensor::new(spec.with_geometry(Geometry::Scanner(scanner))).expect("a sound scanner")
}

/// A ray table over all directions, with poles and holes in it.
pub fn all_round(columns: u32, rows: u32) -> Sensor {
    let ray = |c: u32, r: u32| {
        let azimuth = std::f64::consts::TAU * f64::from(c) / f64::from(columns);
        let elevation = std::f64::consts::PI * (0.5 - f64::from(r) / f64::from(rows - 1));
        let ray = DVec3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
        if (c + 7 * r).is_multiple_of(11) { DVec3::NAN } else { ray }
    };
    let rays = (0..rows).flat_map(|r| (0..columns).map(move |c| ray(c, r))).collect();
    let table = RayTable::new(columns, rows, rays).expect("sound rays");
    Sensor::new(SensorSpec::new("all round", "laser", Geometry::Rays(table))).expect("a sound sensor")
}

/// A camera with a distorting lens. Its corners have no rays, because the lens model folds there.
pub fn lens(width: u32, height: u32) -> Sensor {
    let f = 0.55 * f64::from(width);
    let (cx, cy) = (f64::from(width) / 2.1, f64::from(height) / 1.9);
    let distortion = Distortion::PlumbBob([-0.28, 0.02, 2e-3, -1e-3, 0.0]);
    let camera = Camera { distortion, ..Camera::pinhole(width, height, f, 1.1 * f, cx, cy) };
    Sensor::new(SensorSpec::new("lens", "video", Geometry::Camera(camera))).expect("a sound camera")
}

/// An equidistant fisheye that sees up to 110 degrees from its axis, and farther in its corners.
pub fn fisheye(width: u32, height: u32) -> Sensor {
    let f = 0.5 * f64::from(width) / 110f64.to_radians();
    let (cx, cy) = (f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0);
    let distortion = Distortion::Equidistant([-0.01, 1e-3, 0.0, 0.0]);
    let camera = Camera { distortion, ..Camera::pinhole(width, height, f, f, cx, cy) };
    Sensor::new(SensorSpec::new("fisheye", "video", Geometry::Camera(camera))).expect("a sound camera")
}

/// A scanner with listed elevations from pole to pole, turning clockwise.
pub fn fan() -> Sensor {
    let azimuth = Angles::Uniform { start_deg: 90.0, step_deg: -7.5, count: 40 };
    let elevation = Angles::Listed(vec![-90.0, -89.9, -45.0, -10.0, -0.1, 0.0, 0.2, 15.0, 60.0, 89.0, 90.0]);
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    Sensor::new(SensorSpec::new("fan", "laser", Geometry::Scanner(scanner))).expect("a sound scanner")
}

/// A camera, a scanner and a ray table that look ahead with pixels of 1 to 2 mrad.
pub fn fine() -> [Sensor; 3] {
    let camera = Camera::pinhole(65, 49, 600.0, 650.0, 32.0, 24.0);
    let beams = |count: u32| Angles::Uniform { start_deg: -0.05 * f64::from(count - 1), step_deg: 0.1, count };
    let scanner = Scanner { azimuth: beams(61), elevation: beams(41), beam_height_deg: None };
    let ray = |i: i32| DVec3::new(1.0, 1.3e-3 * f64::from(30 - i % 61), 1.1e-3 * f64::from(20 - i / 61));
    let table = RayTable::new(61, 41, (0..61 * 41).map(ray).collect()).expect("sound rays");
    [
        ("fine camera", Geometry::Camera(camera)),
        ("fine scanner", Geometry::Scanner(scanner)),
        ("fine table", Geometry::Rays(table)),
    ]
    .map(|(name, geometry)| Sensor::new(SensorSpec::new(name, "laser", geometry)).expect("a sound sensor"))
}
