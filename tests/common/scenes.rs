//! Small scenes made by hand.

use super::Random;
use glam::{DVec3, Vec3};
use presight::{
    Angles, Camera, Environment, Geometry, Material, Mesh, NewObject, Polygon, PolygonOrder, Pose, Scanner, Sensor,
    SensorSpec, World,
};
use std::sync::Arc;

/// A mesh of loose polygons, each with corners of its own.
pub fn mesh(polygons: &[Vec<Vec3>]) -> Mesh {
    let mut vertices = Vec::new();
    let mut list = Vec::new();
    for polygon in polygons {
        let first = vertices.len() as u32;
        vertices.extend_from_slice(polygon);
        list.push(Polygon::new((first..vertices.len() as u32).collect(), 0));
    }
    Mesh::new("test", vertices, list, PolygonOrder::Given).expect("a sound mesh")
}

/// The six faces of a box, sharing corners.
pub fn cuboid(least: Vec3, most: Vec3) -> Mesh {
    let corner = |i: u32| {
        let pick = |bit: u32, a: f32, b: f32| if i & bit == 0 { a } else { b };
        Vec3::new(pick(1, least.x, most.x), pick(2, least.y, most.y), pick(4, least.z, most.z))
    };
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let polygons = faces.map(|f| Polygon::new(f.to_vec(), 0));
    Mesh::new("box", (0..8).map(corner).collect(), polygons.to_vec(), PolygonOrder::Given).expect("a sound box")
}

/// An environment of one opaque material.
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

/// A camera, not square.
pub fn camera(width: u32, height: u32) -> Sensor {
    let f = f64::from(width);
    let (cx, cy) = (f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0);
    let camera = Camera::pinhole(width, height, f, 1.1 * f, cx, cy);
    Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera))).expect("a sound camera")
}

/// A scanner all the way round, `rows` from -45 to 45 degrees.
pub fn scanner(columns: u32, rows: u32) -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 360.0 / f64::from(columns), count: columns };
    let step_deg = 90.0 / f64::from(rows.max(2) - 1);
    let elevation = Angles::Uniform { start_deg: if rows == 1 { 0.0 } else { -45.0 }, step_deg, count: rows };
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    Sensor::new(SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner))).expect("a sound scanner")
}
