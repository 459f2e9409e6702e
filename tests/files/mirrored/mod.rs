//! One-sided polygons of mirrored objects, seen from their front. The expected numbers are calculated by hand, because
//! the engines share their conventions and a comparison of engines cannot reveal a wrong one.
//!
//! All scenes hold one cube of one-sided polygons between x = 2 and x = 3, centred on the x axis. A sensor at the
//! origin that looks along +x sees the near wall at 2 m if the front sides are outside, and the far wall at 3 m if they
//! are inside. From the cube's centre the wall ahead is 0.5 m away if its front is inside.

use presight_testkit as common;
mod doors;
mod features;

use common::engines::{self, Renderer};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use presight_model::environment::{CUBOID_FACES, cuboid_corners};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Camera, Distortion, Geometry, RayTable, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::engine::EngineKind;
use presight_render::verify::Precision;
use std::sync::Arc;

/// The sensor's positions: in front of the cube, and at its centre.
const OUTSIDE: DVec3 = DVec3::ZERO;
const INSIDE: DVec3 = DVec3::new(2.5, 0.0, 0.0);

/// The range along +x from [`OUTSIDE`] and [`INSIDE`] for a cube whose front sides are outside, metres.
const BOX: [f32; 2] = [2.0, f32::INFINITY];
/// The same for a cube whose front sides are inside.
const ROOM: [f32; 2] = [3.0, 0.5];

fn corners() -> Vec<Vec3> {
    cuboid_corners(Vec3::splat(-0.5), Vec3::splat(0.5)).to_vec()
}

/// A unit cube about the origin of its frame; its front sides are outside, or inside.
fn cube(outside: bool) -> Arc<Mesh> {
    let face = |f: &[u32; 4]| {
        let mut corners = f.to_vec();
        if !outside {
            corners.reverse();
        }
        Polygon::new(corners, 0)
    };
    Arc::new(Mesh::new("cube", corners(), CUBOID_FACES.iter().map(face).collect(), PolygonOrder::Given).unwrap())
}

fn one_sided() -> Environment {
    let mut environment = Environment::new();
    environment.add_material(Material { one_sided: true, ..Material::named("plate") }).unwrap();
    environment
}

fn world(object: NewObject) -> World {
    let mut environment = one_sided();
    environment.insert(object).unwrap();
    World::new(environment)
}

/// Transforms that place the cube between x = 2 and x = 3, mirrored or not.
fn ways() -> Vec<(&'static str, DAffine3)> {
    let at = DAffine3::from_translation(INSIDE);
    let scaled = |x, y, z| at * DAffine3::from_scale(DVec3::new(x, y, z));
    let quarter = DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_2);
    // Sheared along y and z: the walls at x = 2 and x = 3 keep their places.
    let sheared = DMat3::from_cols(DVec3::new(-1.0, 0.1, 0.2), DVec3::Y, DVec3::new(0.0, 0.3, 1.0));
    vec![
        ("unchanged", at),
        ("mirrored in x", scaled(-1.0, 1.0, 1.0)),
        ("mirrored in y", scaled(1.0, -1.0, 1.0)),
        ("mirrored in z", scaled(1.0, 1.0, -1.0)),
        ("mirrored twice", scaled(-1.0, -1.0, 1.0)),
        ("mirrored three times", scaled(-1.0, -1.0, -1.0)),
        ("stretched", scaled(1.0, 3.0, 0.6)),
        ("stretched and mirrored in x", scaled(-1.0, 3.0, 0.6)),
        ("stretched and mirrored in y", scaled(1.0, -3.0, 0.6)),
        ("turned and mirrored", at * quarter * DAffine3::from_scale(DVec3::new(2.0, -1.0, 0.7))),
        ("sheared and mirrored", at * DAffine3::from_mat3(sheared)),
    ]
}

/// One sensor for each path of the engines, and its pixel that looks along +x.
fn sensors() -> Vec<(Sensor, usize)> {
    let sensor = |name: &str, geometry| Sensor::new(SensorSpec::new(name, "laser", geometry)).unwrap();
    let angles = |step_deg: f64, count: u32| Angles::Uniform { start_deg: -2.0 * step_deg, step_deg, count };
    let scanner = |azimuth, elevation| Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
    let pinhole = Camera::pinhole(17, 13, 20.0, 22.0, 8.0, 6.0);
    let lens = Camera { distortion: Distortion::PlumbBob([-0.2, 0.05, 0.001, -0.001, 0.0]), ..pinhole.clone() };
    let rays = RayTable::new(3, 1, vec![DVec3::new(1.0, 0.1, 0.0), DVec3::X, DVec3::new(1.0, 0.0, 0.1)]).unwrap();
    vec![
        (sensor("camera", Geometry::Camera(pinhole)), 6 * 17 + 8),
        (sensor("lens", Geometry::Camera(lens)), 6 * 17 + 8),
        (sensor("scanner", scanner(angles(5.0, 9), angles(-4.0, 5))), 2 * 9 + 2),
        (sensor("row", scanner(angles(-3.0, 7), Angles::Uniform { start_deg: 0.0, step_deg: 1.0, count: 1 })), 2),
        (sensor("rays", Geometry::Rays(rays)), 1),
    ]
}

type Engine = (EngineKind, Precision, Renderer);

/// Checks that every engine and every sensor gives these ranges from outside and from inside.
fn check(what: &str, world: &World, expected: [f32; 2], engines: &mut [Engine]) {
    for (sensor, pixel) in sensors() {
        for (from, range) in [OUTSIDE, INSIDE].into_iter().zip(expected) {
            let pose = Pose { translation: from, ..Pose::IDENTITY };
            let plan = common::plan(world, &sensor, &pose);
            for (kind, _, engine) in engines.iter_mut() {
                let seen = engine(&plan).range[pixel];
                let same = seen == range || (seen - range).abs() <= 1e-5;
                assert!(same, "{what}, {kind:?}, {}, from {from}: {seen} m is not {range} m", sensor.spec().name);
            }
        }
    }
}

/// [`check`] with the CPU engine only, for inputs that differ before the engines.
fn check_on_cpu(what: &str, environment: &Environment, expected: [f32; 2]) {
    check(what, &World::new(environment.clone()), expected, &mut [(EngineKind::Cpu, Precision::F64, engines::cpu(1))]);
}

#[test]
fn the_front_of_a_mirrored_polygon_is_its_front_in_every_engine() {
    let mut engines = engines::all();
    for (what, world_from_mesh) in ways() {
        for (outside, expected) in [(true, BOX), (false, ROOM)] {
            let object = NewObject::from_affine("cube", world_from_mesh, cube(outside)).unwrap();
            check(what, &world(object), expected, &mut engines);
        }
    }
}

/// A wall so near that the GPU engine leaves it to the CPU, in f64.
#[test]
fn a_mirrored_wall_a_micrometre_ahead_is_seen_from_its_front() {
    const AHEAD: f64 = 1e-6;
    let mut engines = engines::all();
    for (what, world_from_mesh) in ways() {
        // The near wall from outside, the far wall from inside.
        for (outside, wall) in [(true, 2.0), (false, 3.0)] {
            let world = world(NewObject::from_affine("cube", world_from_mesh, cube(outside)).unwrap());
            let pose = Pose { translation: DVec3::new(wall - AHEAD, 0.0, 0.0), ..Pose::IDENTITY };
            for (sensor, pixel) in sensors() {
                let plan = common::plan(&world, &sensor, &pose);
                for (name, _, engine) in &mut engines {
                    let seen = f64::from(engine(&plan).range[pixel]);
                    let sensor = &sensor.spec().name;
                    assert!((seen / AHEAD - 1.0).abs() < 1e-3, "{what}, {name:?}, {sensor}, wall {wall}: {seen} m");
                }
            }
        }
    }
}

/// The pixel's other outputs agree: the near wall has normal incidence.
#[test]
fn a_mirrored_wall_has_the_incidence_and_depth_of_the_wall() {
    for (what, world_from_mesh) in ways() {
        let world = world(NewObject::from_affine("cube", world_from_mesh, cube(true)).unwrap());
        let (camera, pixel) = sensors().swap_remove(0);
        for (name, _, engine) in &mut engines::all() {
            let images = engine(&common::plan(&world, &camera, &Pose::IDENTITY));
            assert!((images.depth_z[pixel] - 2.0).abs() < 1e-5, "{what}, {name:?}");
            assert!((images.cos_incidence[pixel] - 1.0).abs() < 1e-5, "{what}, {name:?}");
        }
    }
}

/// Corners of polygons in the world turn counter-clockwise as seen from the front.
#[test]
fn corners_in_the_world_are_counter_clockwise_from_the_front() {
    for (what, world_from_mesh) in ways() {
        let world = world(NewObject::from_affine("cube", world_from_mesh, cube(true)).unwrap());
        for slot in 0..6 {
            let corners = world.environment().polygon_in_world(slot).unwrap();
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            assert!(normal.dot(corners[0] - INSIDE) > 0.0, "{what}, polygon {slot}");
            let first = world.environment().objects()[0].mesh.corners_of(slot).next().unwrap();
            let apart = corners[0].distance(world_from_mesh.transform_point3(first));
            assert!(apart < 1e-12, "{what}: the first corner stays the first");
        }
    }
}
