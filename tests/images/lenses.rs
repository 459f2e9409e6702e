//! Compares lens cameras, fisheyes, rectified cameras and free ray tables on every engine with the reference.
//!
//! `PRESIGHT_LENS_ROOMS` (1) is the number of generated rooms, `PRESIGHT_LENS_POSES` (0) the number of poses in each
//! real scene, and `PRESIGHT_SEED` sets the seed. 92 rooms and 10 poses are 10^8 pixels.

#![expect(clippy::print_stderr, reason = "the tests print their comparisons")]

use presight_testkit as common;

use common::{Random, compare_or_show, data, engines, env_number, plan, reference, scenes, summary};
use glam::DVec3;
use presight_model::geometry::Pose;
use presight_model::sensor::{Camera, Distortion, Geometry, RayTable, Sensor, SensorSpec};
use presight_model::world::World;
use presight_render::plan::{FramePlan, Images};
use presight_render::verify::{Precision, Report};

fn camera(name: &str, f: f64, distortion: Distortion) -> Sensor {
    let camera = Camera { distortion, ..Camera::pinhole(480, 360, f, 1.05 * f, 244.0, 171.0) };
    Sensor::new(SensorSpec::new(name, "video", Geometry::Camera(camera))).expect("a valid camera")
}

/// Beams of 48 rows that do not lie on straight lines, one in 13 missing.
fn table(random: &mut Random) -> Sensor {
    let mut rays = Vec::new();
    for r in 0..48_u32 {
        let (up, shift) = (0.4 - 0.017 * f64::from(r), random.uniform(-0.1, 0.1));
        for c in 0..720_u32 {
            let azimuth = std::f64::consts::TAU * f64::from(c) / 720.0 + shift;
            let ray = DVec3::new(azimuth.cos(), azimuth.sin(), up + random.uniform(-2e-3, 2e-3));
            rays.push(if (3 * r + c).is_multiple_of(13) { DVec3::NAN } else { ray });
        }
    }
    let table = RayTable::new(720, 48, rays).expect("sound rays");
    Sensor::new(SensorSpec::new("table", "laser", Geometry::Rays(table))).expect("a valid sensor")
}

/// A camera whose image is turned against its body, as rectified ones are.
fn turned(name: &str, distortion: Distortion) -> Sensor {
    let mut spec = camera(name, 420.0, distortion).spec().clone();
    spec.optical_from_image = Pose::from_xyz_rpy(DVec3::ZERO, 0.2, -0.1, 0.3).rotation;
    Sensor::new(spec).expect("a valid camera")
}

fn sensors(random: &mut Random) -> Vec<Sensor> {
    let rational = [0.47, 0.13, 2e-4, -1e-4, 0.01, 0.55, 0.2, 0.03];
    let rational = |more: &[f64]| {
        Distortion::from_model("rational_polynomial", &[&rational[..], more].concat())
            .expect("OpenCV's numbers of coefficients")
    };
    let barrel = Distortion::PlumbBob([random.uniform(-0.35, 0.1), 0.05, 1e-3, -1e-3, 0.0]);
    vec![
        camera("plumb-bob", 400.0, barrel),
        camera("rational", 390.0, rational(&[])),
        camera("thin prism", 390.0, rational(&[4e-3, -2e-3, -3e-3, 1e-3])),
        camera("tilted", 390.0, rational(&[2e-3, 0.0, 1e-3, 0.0, 0.1, -0.15])),
        camera("fisheye", random.uniform(90.0, 250.0), Distortion::Equidistant([-0.01, 1e-3, 0.0, 0.0])),
        turned("rectified", Distortion::None),
        turned("turned lens", Distortion::PlumbBob([-0.1, 0.02, 0.0, 0.0, 0.0])),
        scenes::fisheye(480, 360),
        scenes::all_round(480, 240),
        table(random),
    ]
}

fn compare(
    world: &World,
    pose: &Pose,
    random: &mut Random,
    render: &mut dyn FnMut(&FramePlan) -> Images,
    precision: Precision,
) -> Report {
    let mut report = Report::default();
    for sensor in sensors(random) {
        let plan = plan(world, &sensor, pose);
        report.add(compare_or_show(&reference(&plan), &render(&plan), &plan, precision));
    }
    report
}

fn check(mut render: impl FnMut(&FramePlan) -> Images, precision: Precision) {
    let seed = env_number("PRESIGHT_SEED", 1);
    let mut random = Random(seed);
    let mut report = Report::default();
    for room in 0..env_number("PRESIGHT_LENS_ROOMS", 1) {
        let world = scenes::room_world(1000 * seed + room, 30);
        let at = DVec3::new(random.uniform(-0.3, 0.3), random.uniform(-0.3, 0.3), random.uniform(1.0, 1.6));
        let [roll, pitch, yaw] = [0.3, 0.3, 3.0].map(|most| random.uniform(-most, most));
        let pose = Pose::from_xyz_rpy(at, roll, pitch, yaw);
        report.add(compare(&world, &pose, &mut random, &mut render, precision));
    }
    eprintln!("lenses in rooms: {}", summary(&report));
    for scene in ["hospital", "factory_hall", "office_willowgarage"] {
        let Some(world) = data::scene(scene, true) else { break };
        for pose in data::poses(&world, env_number("PRESIGHT_LENS_POSES", 0) as usize, seed) {
            report.add(compare(&world, &pose, &mut random, &mut render, precision));
        }
    }
    eprintln!("lenses: {}", summary(&report));
    report.check(1e-4).unwrap();
}

#[test]
fn cpu() {
    check(engines::cpu(2), Precision::F64);
}

#[test]
fn cpu_by_tiles() {
    check(engines::cpu_by_tiles(2), Precision::F64);
}

#[test]
fn gpu() {
    if let Some(render) = engines::gpu() {
        check(render, Precision::F32);
    }
}
