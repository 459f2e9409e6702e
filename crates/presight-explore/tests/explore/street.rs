//! A sensor whose points lie decimetres apart: one scan of a real street predicts the next, and unseen places stay
//! open.

use glam::DVec3;
use presight_explore::{Exploration, ExploreOptions, Known, Views};
use presight_localize::simulate::{Disturbances, Simulator};
use presight_model::environment::{Environment, NewObject};
use presight_model::geometry::{Pose, RobotPose, SensorPose};
use presight_model::sensor::{Angles, Geometry, Noise, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::predict::{Options, Predictor};
use presight_testkit::judge::{Judged, Placed, frames, is_blocked, judge};
use presight_testkit::scenes::empty;

fn explored(scan: &Placed, polygons: usize) -> Exploration {
    let mut views = Views::default();
    views.push(&scan.0, SensorPose::new(scan.1)).unwrap();
    let options = ExploreOptions::default().with_polygons(polygons);
    Exploration::of(&Environment::new(), Known::Explored, &views, &options).unwrap()
}

/// Measured: 11.1 cm and 72.3 % of scan 1 covered by scan 0; 10.2 cm and 70.7 % in the other direction. The map that
/// comes with the data, 30,563 triangles of scan 0, has 10.3 cm and 63 %. The aim of 10 cm is missed.
#[test]
fn one_scan_of_a_street_predicts_the_next() {
    let Some(log) = presight_testkit::data::file("lidar3d") else { return };
    let scans = frames(&log, 1);
    for (from, to) in [(0, 1), (1, 0)] {
        let clock = std::time::Instant::now();
        let found = explored(&scans[from], 10_000);
        let seconds = clock.elapsed().as_secs_f64();
        let judged: Judged = judge(found.environment(), &scans[to..=to], 0.1, 1.0);
        println!("{from} to {to}: {} polygons in {seconds:.1} s: {judged:.4?}, {:?}", found.polygons(), found.areas);
        assert!(found.polygons() <= 10_000 && judged.covered > 60.0, "{from} to {to}: {judged:?}");
        assert!(judged.median < 0.115, "{from} to {to}: {judged:?}");
        assert!(found.areas.unseen > 0.0 && found.environment().marks().len() > 100);
    }
}

/// By hand: a wall 10 m ahead with a window of 4 m, in steps of a degree and a half, 26 cm there. One polygon would do
/// for each side.
#[test]
fn what_lies_between_rays_far_apart_stays_open() {
    let mut walls = empty();
    let parts = [[2.0, 6.0, -6.0, 6.0], [-6.0, -2.0, -6.0, 6.0], [-2.0, 2.0, 2.0, 6.0], [-2.0, 2.0, -6.0, -2.0]];
    let wall = |[a, b, c, d]: [f32; 4]| {
        [[10.0, a, c], [10.0, a, d], [10.0, b, d], [10.0, b, c]].map(glam::Vec3::from).to_vec()
    };
    let mesh = presight_testkit::scenes::mesh(&parts.map(wall));
    walls.insert(NewObject::new("wall", Pose::IDENTITY, mesh.into())).unwrap();
    let angles = || Angles::Uniform { start_deg: -33.0, step_deg: 1.5, count: 45 };
    let scanner = Scanner { azimuth: angles(), elevation: angles(), beam_height_deg: None };
    let spec = SensorSpec::new("sparse", "laser", Geometry::Scanner(scanner)).with_limits(0.2, 50.0);
    let sensor = Sensor::new(spec.with_noise(Noise { range_sigma: 0.01, ..Noise::default() })).unwrap();
    let predictor = Predictor::new(Options::default()).unwrap();
    let mut simulator = Simulator::new(predictor, sensor, Disturbances::default(), 7).unwrap();
    let pose = Pose::IDENTITY;
    let frame = simulator.frame(&World::new(walls), 0.0, &RobotPose::new(pose)).unwrap();
    let found = explored(&(frame, pose), 200);
    let hits = |y: f64, z: f64| is_blocked(found.environment(), DVec3::ZERO, DVec3::new(10.3, 1.03 * y, 1.03 * z));
    for k in 0..20 {
        let off = -5.0 + 10.0 * f64::from(k) / 19.0;
        assert!(hits(off, 4.0) && hits(4.0, off) && hits(off, -4.0) && hits(-4.0, off), "{off}");
        let off = 0.34 * off;
        assert!(!hits(off, 0.0) && !hits(0.0, off), "{off}");
    }
    assert!(found.polygons() < 40, "{}", found.polygons());
}
