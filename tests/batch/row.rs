//! Compares the readings that a level one-row scanner gets from a cut of the world with its images.

use super::{common, predictor, single};
use common::{Random, data, scenes};
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_render::row;

fn scanner(azimuth: Angles, limits: (f64, f64)) -> Sensor {
    let elevation = Angles::Uniform { start_deg: 0.0, step_deg: 0.0, count: 1 };
    let geometry = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
    let spec = SensorSpec::new("row", "laser", geometry);
    Sensor::new(spec.with_limits(limits.0, limits.1)).unwrap()
}

fn scanners() -> Vec<Sensor> {
    let uniform = |start_deg, step_deg, count| Angles::Uniform { start_deg, step_deg, count };
    vec![
        scanner(uniform(-90.0, 0.5, 361), (0.0, 30.0)),
        scanner(uniform(170.0, -0.37, 900), (0.5, 8.0)),
        scanner(uniform(0.0, 0.1, 3600), (0.0, 2.5)),
        scanner(uniform(13.0, 360.0 / 17.0, 17), (0.0, 100.0)),
        scanner(Angles::Listed(vec![-170.0, -3.0, 0.0, 0.01, 90.0, 179.0]), (1.0, f64::INFINITY)),
        scanner(uniform(45.0, 0.0, 1), (0.0, 30.0)),
        scanner(uniform(-180.0, 0.5, 721), (0.0, 30.0)),
        scanner(uniform(30.0, -360.0 / 7.0, 8), (0.0, 30.0)),
    ]
}

/// Returns the number of pixels and of differing ones. Without a shift only pixels at edges may differ: a slightly
/// rotated ray gives the same value there.
fn compare(world: &World, sensor: &Sensor, pose: &Pose, shift: f64) -> (usize, usize) {
    let mut predictor = predictor(1);
    let moved = Pose { translation: pose.translation + glam::DVec3::new(shift, 0.0, 0.0), ..*pose };
    let (range, cos) = row::see(world, sensor, &moved).expect("a level row");
    let near = |a: f32, b: f32| a == b || (a - b).abs() <= 1e-5 * b;
    let images = single(&mut predictor, world, sensor, pose);
    let same = |i: usize, images: &(Vec<f32>, Vec<f32>)| {
        let same_cos = cos[i].is_nan() && images.1[i].is_nan() || (cos[i] - images.1[i]).abs() < 1e-5;
        near(range[i], images.0[i]) && same_cos
    };
    let other: Vec<usize> = (0..range.len()).filter(|i| !same(*i, &images)).collect();
    if shift == 0.0 && !other.is_empty() {
        let turned = |by: f64| *pose * Pose::from_xyz_rpy(glam::DVec3::ZERO, 0.0, 0.0, by);
        let beside = [-1e-6, 1e-6].map(|by| single(&mut predictor, world, sensor, &turned(by)));
        for &i in &other {
            let edge = beside.iter().any(|images| same(i, images));
            let (r, c, image) = (range[i], cos[i], (images.0[i], images.1[i]));
            assert!(edge, "beam {i} at {pose:?}: {r} m, cos {c}, image {image:?}");
        }
    }
    (range.len(), other.len())
}

#[test]
fn readings_in_generated_rooms_equal_images() {
    let mut random = Random(21);
    let (mut pixels, mut edges, mut planted) = (0, 0, 0);
    for seed in 0..12 {
        let world = World::new(scenes::room(seed, 10 + 8 * seed as usize));
        for sensor in scanners() {
            let at = glam::DVec3::new(random.uniform(-0.8, 0.8), random.uniform(-0.8, 0.8), random.uniform(0.1, 2.9));
            let pose = Pose::from_xyz_rpy(at, 0.0, 0.0, random.uniform(-4.0, 4.0));
            let (n, other) = compare(&world, &sensor, &pose, 0.0);
            (pixels, edges) = (pixels + n, edges + other);
            // A fault of 1 mm must be noticed.
            planted += compare(&world, &sensor, &pose, 1e-3).1;
        }
    }
    assert!(edges * 10_000 <= pixels, "{edges} of {pixels} at edges");
    assert!(planted * 3 > pixels, "only {planted} of {pixels} show the fault");
}

#[test]
fn readings_in_real_scenes_equal_images() {
    for name in data::SCENES {
        let Some(world) = data::scene(name, true) else { return };
        let (mut pixels, mut edges) = (0, 0);
        for (i, pose) in data::poses(&world, 4, 9).iter().enumerate() {
            let at = Pose::from_xyz_rpy(pose.translation, 0.0, 0.0, i as f64);
            let (n, other) = compare(&world, &scanners()[i % 3], &at, 0.0);
            (pixels, edges) = (pixels + n, edges + other);
        }
        assert!(edges * 500 <= pixels, "{name}: {edges} of {pixels} at edges");
    }
}

#[test]
fn other_and_tilted_sensors_are_refused() {
    let world = World::new(scenes::room(1, 5));
    let one = &scanners()[0];
    assert!(row::see(&world, one, &Pose::from_xyz_rpy(glam::DVec3::Z, 0.0, 0.0, 1.0)).is_some());
    assert!(row::see(&world, one, &Pose::from_xyz_rpy(glam::DVec3::Z, 1e-6, 0.0, 1.0)).is_none());
    assert!(row::see(&world, one, &Pose::from_xyz_rpy(glam::DVec3::Z, std::f64::consts::PI, 0.0, 1.0)).is_none());
    for name in ["vlp-16", "video-camera"] {
        assert!(row::see(&world, &presight_files::preset(name).unwrap(), &Pose::IDENTITY).is_none());
    }
    // Above the whole scene there is nothing in view.
    let above = Pose::from_xyz_rpy(glam::DVec3::Z * 50.0, 0.0, 0.0, 0.0);
    assert!(row::see(&world, one, &above).unwrap().0.iter().all(|r| *r == f32::INFINITY));
}
