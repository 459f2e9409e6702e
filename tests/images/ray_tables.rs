//! Ray tables on the CPU engine keep their bits for ever. The stored hashes of 300 generated images date from a version
//! that tested every polygon on every ray of the tiles in its cone.
//!
//! The bits are the same on every machine. The engine multiplies, adds, divides and takes square roots in f64, which
//! IEEE 754 rounds in one way, and neither the compiler nor the vector code fuses a product and a sum into one
//! rounding. Sines differ between C libraries, so `libm` makes the poses and the rays of fisheyes, and the lens cameras
//! here are polynomial.
//!
//! `PRESIGHT_RAY_TABLES=FILE` writes the hashes to a file instead.

use presight_testkit as common;

use common::engines::{self, Renderer};
use common::{Random, plan, scenes};
use glam::{DAffine3, DVec3, Vec3};
use presight_model::environment::{Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::sensor::{Camera, Distortion, Geometry, RayTable, Sensor, SensorSpec};
use presight_model::world::World;
use presight_render::plan::Images;
use std::fmt::Write as _;
use std::sync::Arc;

const CASES: u64 = 300;

/// The kinds of rays, one case after the other.
const KINDS: [&str; 6] = ["plumb-bob", "rational", "fisheye", "wide fisheye", "table", "random rays"];

fn side(random: &mut Random) -> u32 {
    match random.below(4) {
        0 => 1 + random.below(9) as u32,
        1 => 8 + random.below(30) as u32,
        _ => 20 + random.below(90) as u32,
    }
}

fn camera(random: &mut Random, (width, height): (u32, u32), distortion: Distortion) -> Geometry {
    let f = f64::from(width.max(height)) * random.uniform(0.3, 1.2);
    let middle = |side: u32, random: &mut Random| f64::from(side - 1) * random.uniform(0.3, 0.7);
    let (cx, cy) = (middle(width, random), middle(height, random));
    Geometry::Camera(Camera { width, height, fx: f, fy: f * random.uniform(0.8, 1.2), cx, cy, distortion })
}

/// Some of them fold inside the image.
fn plumb_bob(random: &mut Random) -> Distortion {
    let p = |random: &mut Random| random.uniform(-0.01, 0.01);
    Distortion::PlumbBob([
        random.uniform(-0.5, 0.2),
        random.uniform(-0.1, 0.2),
        p(random),
        p(random),
        random.uniform(-0.02, 0.02),
    ])
}

fn rational(random: &mut Random) -> Distortion {
    let [a, b, c] = [0.6, 0.3, 0.05].map(|most| random.uniform(0.0, most));
    let tangential = [0, 1].map(|_| random.uniform(-2e-3, 2e-3));
    let near = [0, 1, 2].map(|_| random.uniform(-0.2, 0.1));
    let k = [a + near[0], b + near[1], tangential[0], tangential[1], c, a, b, c + 0.02 * near[2]];
    Distortion::from_model("rational_polynomial", &k).unwrap()
}

/// Equidistant, with `half_deg` from the axis to the centre of the image's longer sides, rotated at random; no ray
/// beyond 180 degrees.
fn fisheye(random: &mut Random, (width, height): (u32, u32), half_deg: f64) -> Vec<DVec3> {
    let turn = Pose::from_xyz_rpy(DVec3::ZERO, 0.0, random.uniform(-1.0, 1.0), random.uniform(-3.0, 3.0));
    let (cx, cy) = (0.5 * f64::from(width - 1), 0.5 * f64::from(height - 1));
    let per_pixel = half_deg.to_radians() / cx.max(cy).max(1.0);
    let ray = |c: u32, r: u32| {
        let (x, y) = (f64::from(c) - cx, f64::from(r) - cy);
        let radius = (x * x + y * y).sqrt();
        let angle = radius * per_pixel;
        if angle > std::f64::consts::PI {
            return DVec3::NAN;
        }
        let (sin, cos) = libm::sincos(angle);
        let aside = if radius > 0.0 { sin / radius } else { 0.0 };
        turn.transform_point(DVec3::new(cos, -x * aside, -y * aside))
    };
    (0..height).flat_map(|r| (0..width).map(move |c| (c, r))).map(|(c, r)| ray(c, r)).collect()
}

/// Beams all round or ahead in rows that are shifted against each other, with holes.
fn beams(random: &mut Random, (width, height): (u32, u32)) -> Vec<DVec3> {
    let turn = if random.below(2) == 0 { std::f64::consts::TAU } else { random.uniform(0.01, 1.0) };
    let (high, shift) = (random.uniform(0.01, 1.4), random.uniform(-0.05, 0.05));
    let holes = 3 + random.below(40) as u32;
    let ray = |c: u32, r: u32| {
        if (5 * c + 3 * r * r).is_multiple_of(holes) {
            return DVec3::NAN;
        }
        let azimuth = turn * f64::from(c) / f64::from(width) + shift * f64::from(r % 4);
        let (sin, cos) = libm::sincos(azimuth);
        let (up, level) = libm::sincos(high * (1.0 - 2.0 * f64::from(r) / f64::from(height)));
        DVec3::new(cos * level, sin * level, up)
    };
    (0..height).flat_map(|r| (0..width).map(move |c| (c, r))).map(|(c, r)| ray(c, r)).collect()
}

/// Rays in random order, in a few directions, or all equal.
fn random_rays(random: &mut Random, (width, height): (u32, u32)) -> Vec<DVec3> {
    let most = [1, 5, usize::MAX][random.below(3)];
    let mut made: Vec<DVec3> = Vec::new();
    for _ in 0..width * height {
        let ray = if made.len() < most {
            DVec3::new(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0) + 1e-3)
        } else {
            made[random.below(made.len().min(most))]
        };
        made.push(if random.below(50) == 0 && made.len() > most.min(9) { DVec3::NAN } else { ray });
    }
    made
}

fn sensor(random: &mut Random, kind: usize) -> Sensor {
    let size = match random.below(12) {
        0 => (1, side(random)),
        1 => (side(random), 1),
        _ => (side(random), side(random)),
    };
    let table = |rays| Geometry::Rays(RayTable::new(size.0, size.1, rays).expect("sound rays"));
    let geometry = match kind {
        0 => {
            let lens = plumb_bob(random);
            camera(random, size, lens)
        }
        1 => {
            let lens = rational(random);
            camera(random, size, lens)
        }
        2 => {
            let half_deg = random.uniform(10.0, 90.0);
            table(fisheye(random, size, half_deg))
        }
        3 => {
            let half_deg = random.uniform(90.0, 200.0);
            table(fisheye(random, size, half_deg))
        }
        4 => table(beams(random, size)),
        _ => table(random_rays(random, size)),
    };
    let mut spec = SensorSpec::new(KINDS[kind], "laser", geometry);
    if random.below(2) == 0 {
        spec.range_min = random.uniform(0.0, 1.5);
        spec.range_max = random.uniform(2.0, 8.0);
    }
    Sensor::new(spec).expect("a valid sensor")
}

/// Triangles of one size anywhere in the room, as a mesh and as a mesh with the opposite winding.
fn soup(random: &mut Random, count: usize, size: f64) -> [Arc<Mesh>; 2] {
    let (mut vertices, mut polygons) = (Vec::new(), Vec::new());
    let mut coordinate = |half: f64| random.uniform(-half, half) as f32;
    for _ in 0..count {
        let at = Vec3::new(coordinate(4.8), coordinate(3.8), 1.5 + coordinate(1.4));
        let mut corner = || Vec3::new(coordinate(size), coordinate(size), coordinate(size));
        let (a, b, c) = (corner(), corner(), corner());
        if (b - a).cross(c - a).length() > 1e-2 * (size * size) as f32 {
            let first = vertices.len() as u32;
            vertices.extend([at + a, at + b, at + c]);
            polygons.push(Polygon::new(vec![first, first + 1, first + 2], (polygons.len() % 3) as u16));
        }
    }
    let turned: Vec<Polygon> =
        polygons.iter().map(|p| Polygon::new(vec![p.corners[0], p.corners[2], p.corners[1]], p.material)).collect();
    [polygons, turned].map(|polygons| {
        let mesh = Mesh::new("soup", vertices.clone(), polygons, PolygonOrder::Spatial);
        Arc::new(mesh.expect("a valid mesh"))
    })
}

/// A room with boxes, some of them twice in the same place, and loose triangles: few large ones, or more small ones
/// than fit in one pass.
fn world(random: &mut Random) -> World {
    let boxes = random.below(30);
    let mut environment = scenes::room(random.bits(), boxes);
    environment.add_material(Material { one_sided: true, ..Material::named("sheet") }).expect("a valid material");
    environment.add_material(Material::named("red")).expect("a valid material");
    for object in environment.objects().to_vec().into_iter().skip(1).step_by(3) {
        let again = NewObject::new("again", object.world_from_object, object.mesh.clone());
        environment.insert(again).expect("a valid object");
    }
    let (count, size) = [(20, 1.5), (300, 0.4), (3000, 0.1), (9000, 0.05)][random.below(4)];
    let [mesh, turned] = soup(random, count, size);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.1, -0.2, 0.0), 0.0, 0.0, random.uniform(-3.0, 3.0));
    // With the opposite winding, because a mirrored object keeps its front sides: the hashes date from a version that
    // reversed them.
    let mut mirrored = NewObject::new("mirrored", pose, turned);
    mirrored.object_from_mesh = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 0.9));
    environment.insert(NewObject::new("loose", pose, mesh)).expect("a valid object");
    environment.insert(mirrored).expect("a valid object");
    World::new(environment)
}

fn hash(images: &Images) -> String {
    let mut hasher = blake3::Hasher::new();
    for image in [&images.range, &images.depth_z, &images.cos_incidence, &images.echo] {
        // All NaN values count as equal.
        let bits = |x: &f32| if x.is_nan() { f32::NAN.to_bits() } else { x.to_bits() };
        for x in image {
            hasher.update(&bits(x).to_le_bytes());
        }
    }
    for image in [&images.polygon_id, &images.object_id] {
        for x in image {
            hasher.update(&x.to_le_bytes());
        }
    }
    hasher.finalize().to_hex()[..16].to_owned()
}

/// A case's description and hash, by an engine.
fn case(seed: u64, mut render: Renderer) -> (String, String) {
    let mut random = Random(seed);
    let kind = seed as usize % KINDS.len();
    let sensor = sensor(&mut random, kind);
    let world = world(&mut random);
    let at = DVec3::new(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(0.5, 2.5));
    let [roll, pitch, yaw] = [0.2, 0.5, 3.1].map(|most| random.uniform(-most, most));
    let images = render(&plan(&world, &sensor, &Pose::from_xyz_rpy(at, roll, pitch, yaw)));
    let seen = images.polygon_id.iter().filter(|id| **id != 0).count();
    let about = format!("{} {} x {}, {seen} seen", KINDS[kind], sensor.width(), sensor.height());
    (about, hash(&images))
}

#[test]
fn images_of_ray_tables_keep_their_bits() {
    let threads = |seed: u64| 1 + seed as usize % 3;
    let cases: Vec<(String, String)> = (0..CASES).map(|seed| case(seed, engines::cpu(threads(seed)))).collect();
    if let Some(path) = std::env::var_os("PRESIGHT_RAY_TABLES") {
        let mut text = String::new();
        cases.iter().for_each(|(about, hash)| writeln!(text, "{hash} {about}").expect("a string takes text"));
        std::fs::write(path, text).expect("the file can be written");
        return;
    }
    let stored: Vec<&str> = include_str!("ray_tables.txt").lines().collect();
    assert_eq!(stored.len(), cases.len());
    let differ = |(stored, (about, hash)): &(&&str, &(String, String))| **stored != format!("{hash} {about}");
    let other: Vec<_> = stored.iter().zip(&cases).filter(differ).collect();
    assert!(other.is_empty(), "{} of {CASES} images differ, first {:?}", other.len(), other[0]);
    let by_tiles = (0..CASES).map(|seed| case(seed, engines::cpu_by_tiles(threads(seed))));
    let other: Vec<_> = by_tiles.zip(&cases).filter(|(tiles, raster)| tiles != *raster).collect();
    assert!(other.is_empty(), "{} of {CASES} images by tiles differ, first {:?}", other.len(), other[0]);
}

/// The sensor at rest in a room of 9,000 small triangles.
fn in_a_full_room(geometry: Geometry) -> Images {
    let mut random = Random(7);
    let mut environment = scenes::room(7, 20);
    environment.add_material(Material::named("red")).expect("a valid material");
    environment.add_material(Material::named("green")).expect("a valid material");
    let [mesh, _] = soup(&mut random, 9000, 0.2);
    environment.insert(NewObject::new("loose", Pose::IDENTITY, mesh)).expect("a valid object");
    let sensor = Sensor::new(SensorSpec::new("odd", "laser", geometry)).expect("a valid sensor");
    let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.4), 0.0, 0.0, 0.3);
    engines::cpu(0)(&plan(&World::new(environment), &sensor, &pose))
}

fn table(width: u32, height: u32, rays: Vec<DVec3>) -> Geometry {
    Geometry::Rays(RayTable::new(width, height, rays).expect("sound rays"))
}

/// Every pixel equals that of a single ray. A million rays finish in time, because hidden geometry is skipped.
#[test]
fn a_million_equal_rays_show_what_one_shows() {
    let ray = DVec3::new(0.7, 0.6, 0.05);
    let one = in_a_full_room(table(1, 1, vec![ray]));
    assert!(one.polygon_id[0] > 0);
    let many = in_a_full_room(table(1024, 1024, vec![ray; 1 << 20]));
    assert!(many.polygon_id.iter().all(|id| *id == one.polygon_id[0]));
    assert!(many.range.iter().all(|range| range.to_bits() == one.range[0].to_bits()));
    // So close together that no cone separates them.
    let near = |i: u32| ray + DVec3::new(0.0, f64::from(i % 1024), f64::from(i / 1024)) * 1e-14;
    let many = in_a_full_room(table(1024, 1024, (0..1 << 20).map(near).collect()));
    assert!(many.polygon_id.iter().all(|id| *id == one.polygon_id[0]));
}

/// A table with only one ray left, and one with none.
#[test]
fn tables_may_be_all_holes() {
    let ray = DVec3::new(0.7, 0.6, 0.05);
    let one = in_a_full_room(table(1, 1, vec![ray]));
    let mut rays = vec![DVec3::NAN; 300 * 90];
    rays[17 * 300 + 211] = ray;
    let images = in_a_full_room(table(300, 90, rays));
    assert_eq!((images.polygon_id[17 * 300 + 211], images.range[17 * 300 + 211]), (one.polygon_id[0], one.range[0]));
    assert_eq!(images.range.iter().filter(|range| range.is_nan()).count(), 300 * 90 - 1);
    let nothing = in_a_full_room(table(300, 90, vec![DVec3::NAN; 300 * 90]));
    assert!(nothing.range.iter().all(|range| range.is_nan()) && nothing.polygon_id.iter().all(|id| *id == 0));
}

/// r (1 - 0.3 r^2) has its maximum at r = 1 / sqrt(0.9), which is imaged at 0.7027. No pixel beyond has a ray, and all
/// others see the surrounding room.
#[test]
fn a_lens_that_folds_inside_the_image_has_no_ray_beyond() {
    let distortion = Distortion::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]);
    let images =
        in_a_full_room(Geometry::Camera(Camera { distortion, ..Camera::pinhole(203, 151, 60.0, 60.0, 101.0, 75.0) }));
    for (i, range) in images.range.iter().enumerate() {
        let (x, y) = ((i % 203) as f64 - 101.0, (i / 203) as f64 - 75.0);
        let radius = (x * x + y * y).sqrt() / 60.0;
        if (radius - 0.7027).abs() > 1e-3 {
            assert_eq!(range.is_nan(), radius > 0.7027, "{x}, {y}");
            assert_eq!(images.polygon_id[i] > 0, radius < 0.7027, "{x}, {y}");
        }
    }
}

/// Equidistant with f = 50 / pi: the model ends 180 degrees from the axis, 50 pixels from the centre, and the direction
/// straight behind appears all round at that radius.
#[test]
fn a_fisheye_past_180_degrees_sees_behind_itself() {
    let f = 50.0 / std::f64::consts::PI;
    let distortion = Distortion::Equidistant([0.0; 4]);
    let images = in_a_full_room(Geometry::Camera(Camera { distortion, ..Camera::pinhole(131, 117, f, f, 65.0, 58.0) }));
    for (i, range) in images.range.iter().enumerate() {
        let (x, y) = ((i % 131) as f64 - 65.0, (i / 131) as f64 - 58.0);
        let radius = x.hypot(y);
        if (radius - 50.0).abs() > 1e-6 {
            assert_eq!(range.is_finite(), radius < 50.0, "{x}, {y}: {range}");
        }
    }
}
