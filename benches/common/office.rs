//! Offices of any size that look the same from inside: closed pairs of rooms. The first pair has the same seed in all.

use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_testkit::Random;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Triangles of a pair of rooms.
const TRIANGLES: usize = 1000;
/// The sides of a room, in metres.
const ROOM: [f64; 3] = [6.0, 5.0, 3.0];
/// Balls in a room, and the number of quads of each around it and from pole to pole.
const BALLS: usize = 4;
const AROUND: u32 = 10;
const RINGS: u32 = 6;

/// An office of about this many triangles: adjacent pairs of rooms, with the first pair at the origin in the middle.
pub fn office(triangles: usize) -> Environment {
    let pairs = triangles.div_ceil(TRIANGLES).max(1);
    let side = (1..).find(|side| side * side >= pairs).unwrap_or(1) as i64;
    let middle = side / 2;
    let mut cells: Vec<[i64; 2]> = (0..side * side).map(|i| [i % side - middle, i / side - middle]).collect();
    cells.sort_by_key(|[x, y]| (x.abs().max(y.abs()), *y, *x));
    let mut environment = Environment::new();
    environment.add_material(Material::named("grey")).expect("a valid material");
    for (i, [x, y]) in cells.into_iter().take(pairs).enumerate() {
        let mesh = Arc::new(pair(&mut Random(i as u64)));
        let at = Pose::from_xyz_rpy(DVec3::new(2.0 * ROOM[0] * x as f64, ROOM[1] * y as f64, 0.0), 0.0, 0.0, 0.0);
        environment.insert(NewObject::new(format!("rooms {i}"), at, mesh)).expect("a valid object");
    }
    environment
}

/// Level poses in the middle of the first room, which is empty there.
pub fn office_poses(count: usize) -> Vec<Pose> {
    let mut random = Random(7);
    let mut pose = || {
        let aside = [0, 1].map(|_| random.uniform(-0.4, 0.4));
        let at = DVec3::new(0.5 * ROOM[0] + aside[0], 0.5 * ROOM[1] + aside[1], random.uniform(0.9, 1.7));
        Pose::from_xyz_rpy(at, 0.0, 0.0, random.uniform(-PI, PI))
    };
    (0..count).map(|_| pose()).collect()
}

#[derive(Default)]
struct Triangles {
    vertices: Vec<Vec3>,
    polygons: Vec<Polygon>,
}

impl Triangles {
    fn quad(&mut self, corners: [DVec3; 4]) {
        let first = self.vertices.len() as u32;
        self.vertices.extend(corners.map(|p| p.as_vec3()));
        self.polygons.extend([[0, 1, 2], [0, 2, 3]].map(|k| Polygon::new(k.map(|k| first + k).to_vec(), 0)));
    }

    /// A vertical rectangle from one place on the floor to another.
    fn wall(&mut self, from: [f64; 2], to: [f64; 2], [low, high]: [f64; 2]) {
        let at = |[x, y]: [f64; 2], z: f64| DVec3::new(x, y, z);
        self.quad([at(from, low), at(to, low), at(to, high), at(from, high)]);
    }

    fn ball(&mut self, center: DVec3, radius: f64) {
        let first = self.vertices.len() as u32;
        let vertex = |ring: u32, i: u32| {
            let (polar, azimuth) =
                (PI * f64::from(ring + 1) / f64::from(RINGS + 2), TAU * f64::from(i) / f64::from(AROUND));
            let (sin, cos) = polar.sin_cos();
            (center + radius * DVec3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos)).as_vec3()
        };
        self.vertices.extend((0..=RINGS).flat_map(|ring| (0..AROUND).map(move |i| vertex(ring, i))));
        for (ring, i) in (0..RINGS).flat_map(|ring| (0..AROUND).map(move |i| (ring, i))) {
            let at = |ring: u32, i: u32| first + ring * AROUND + i % AROUND;
            let [a, b, c, d] = [at(ring, i), at(ring + 1, i), at(ring + 1, i + 1), at(ring, i + 1)];
            self.polygons.extend([[a, b, c], [a, c, d]].map(|corners| Polygon::new(corners.to_vec(), 0)));
        }
    }
}

/// Two rooms with a door between them and no other door, with balls along their walls.
fn pair(random: &mut Random) -> Mesh {
    let [dx, dy, h] = ROOM;
    let mut made = Triangles::default();
    for x in [0.0, dx] {
        for z in [0.0, h] {
            let at = |x: f64, y: f64| DVec3::new(x, y, z);
            made.quad([at(x, 0.0), at(x + dx, 0.0), at(x + dx, dy), at(x, dy)]);
        }
        made.wall([x, 0.0], [x + dx, 0.0], [0.0, h]);
        made.wall([x, dy], [x + dx, dy], [0.0, h]);
        for i in 0..BALLS {
            // In the corners, clear of the poses.
            let corner = |side: f64, far: bool, by: f64| if far { side - by } else { by };
            let [by_x, by_y] = [0, 1].map(|_| random.uniform(0.5, 1.2));
            let at =
                DVec3::new(x + corner(dx, i % 2 == 1, by_x), corner(dy, i / 2 == 1, by_y), random.uniform(0.5, 2.3));
            made.ball(at, random.uniform(0.25, 0.45));
        }
    }
    made.wall([0.0, 0.0], [0.0, dy], [0.0, h]);
    made.wall([2.0 * dx, 0.0], [2.0 * dx, dy], [0.0, h]);
    let door = [0.4 * dy, 0.6 * dy];
    made.wall([dx, 0.0], [dx, door[0]], [0.0, h]);
    made.wall([dx, door[1]], [dx, dy], [0.0, h]);
    made.wall([dx, door[0]], [dx, door[1]], [0.7 * h, h]);
    Mesh::new("rooms", made.vertices, made.polygons, PolygonOrder::Spatial).expect("sound rooms")
}
