//! An open hall without walls and roof, full of lathe-turned parts with small triangles: the worst case for setup time.

use super::Random;
use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Metres between the axes of neighbouring parts.
const SPACING: f64 = 1.6;

/// A floor with standing parts that have at least `triangles` triangles with legs of 1 to 5 cm. The same seed makes the
/// same hall.
pub fn open_hall(seed: u64, triangles: usize) -> Environment {
    let mut random = Random(seed);
    let mut environment = Environment::new();
    environment.add_material(Material::named("grey")).expect("a sound material");
    let mut parts = Vec::new();
    let mut made = 0;
    while made < triangles {
        let part = turned_part(&mut random);
        made += part.polygon_count();
        parts.push(part);
    }
    let side = side_of(parts.len());
    let half = 0.5 * SPACING * (side as f64 + 1.0);
    let tile =
        [(-half, -half), (half, -half), (half, half), (-half, half)].map(|(x, y)| Vec3::new(x as f32, y as f32, 0.0));
    let floor = Mesh::new("floor", tile.to_vec(), vec![Polygon::new(vec![0, 1, 2, 3], 0)], PolygonOrder::Given);
    let floor = NewObject::new("floor", Pose::IDENTITY, Arc::new(floor.expect("a sound floor")));
    environment.insert(floor).expect("a sound object");
    for (i, part) in parts.into_iter().enumerate() {
        let at = place(side, i % side, i / side);
        let pose = Pose::from_xyz_rpy(at, 0.0, 0.0, random.uniform(0.0, TAU));
        environment.insert(NewObject::new(format!("part {i}"), pose, Arc::new(part))).expect("a sound object");
    }
    environment
}

/// Poses in the aisles between the parts of a hall, body axes in the world.
pub fn hall_poses(hall: &Environment, seed: u64, count: usize) -> Vec<Pose> {
    let mut random = Random(seed);
    let side = side_of(hall.objects().len() - 1);
    let mut pose = || {
        let cell = [0, 1].map(|_| random.below(side.max(2) - 1));
        let corner = DVec3::new(0.5 * SPACING, 0.5 * SPACING, random.uniform(0.8, 1.8));
        let lean = [0, 1].map(|_| random.uniform(-0.1, 0.1));
        Pose::from_xyz_rpy(place(side, cell[0], cell[1]) + corner, lean[0], lean[1], random.uniform(0.0, TAU))
    };
    (0..count).map(|_| pose()).collect()
}

/// The number of parts in a row of the hall.
fn side_of(parts: usize) -> usize {
    (1..).find(|side| side * side >= parts).unwrap_or(1)
}

fn place(side: usize, column: usize, row: usize) -> DVec3 {
    let from_middle = |i: usize| SPACING * (i as f64 - 0.5 * (side as f64 - 1.0));
    DVec3::new(from_middle(column), from_middle(row), 0.0)
}

/// A standing surface of revolution, open at both ends.
fn turned_part(random: &mut Random) -> Mesh {
    let (leg, radius, height) = (random.uniform(0.012, 0.04), random.uniform(0.15, 0.4), random.uniform(0.8, 2.2));
    let (waves, phase) = (random.uniform(2.0, 12.0), random.uniform(0.0, TAU));
    let (around, rings) = ((TAU * radius / leg) as u32, (height / leg) as u32);
    let vertex = |ring: u32, i: u32| {
        let z = leg * f64::from(ring);
        let r = radius * (1.0 + 0.15 * (waves * z + phase).sin());
        let (sin, cos) = (TAU * f64::from(i) / f64::from(around)).sin_cos();
        Vec3::new((r * cos) as f32, (r * sin) as f32, z as f32)
    };
    let vertices = (0..=rings).flat_map(|ring| (0..around).map(move |i| (ring, i))).map(|(ring, i)| vertex(ring, i));
    let quad = |ring: u32, i: u32| {
        let at = |ring: u32, i: u32| ring * around + i % around;
        let [a, b, c, d] = [at(ring, i), at(ring, i + 1), at(ring + 1, i + 1), at(ring + 1, i)];
        [Polygon::new(vec![a, b, c], 0), Polygon::new(vec![a, c, d], 0)]
    };
    let polygons = (0..rings).flat_map(|ring| (0..around).flat_map(move |i| quad(ring, i))).collect();
    Mesh::new("part", vertices.collect(), polygons, PolygonOrder::Spatial).expect("a sound part")
}
