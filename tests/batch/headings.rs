//! Compares all headings at once with the oracle and with single predictions at rotated poses.

use super::likelihood::disturbed;
use super::{common, frame_of, noisy, oracle, predictor, single};
use common::{Random, data, scenes};
use presight_model::error::ErrorKind;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Angles, Geometry, Mixture, Noise, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::batch::{BatchRequest, Headings, PoseCell, RangeLikelihood};
use presight_read::log;

const NOISE: Noise = Noise {
    range_sigma: 0.03,
    range_sigma_quadratic: 1e-4,
    angle_sigma: 2e-3,
    pixel_sigma: 0.0,
    stamp_sigma: 0.0,
    mixture: Mixture { hit: 0.7, short: 0.12, none: 0.06, any: 0.12, beam_dependence: 2.0 },
};

fn scanner(start_deg: f64, step_deg: f64, count: u32, rows: &[f64], limits: (f64, f64)) -> Sensor {
    let azimuth = Angles::Uniform { start_deg, step_deg, count };
    let elevation = Angles::Listed(rows.to_vec());
    let spec = SensorSpec::new("s", "laser", Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None }));
    Sensor::new(spec.with_limits(limits.0, limits.1).with_noise(NOISE)).unwrap()
}

/// The scanner with its azimuths moved to the nearest multiples of the panorama's step, by no more than a quarter of
/// its own least step.
fn resampled(sensor: &Sensor, headings: &Headings) -> Sensor {
    let Geometry::Scanner(scanner) = &sensor.spec().geometry else { panic!("a scanner") };
    let azimuths: Vec<f64> = (0..sensor.width() as usize).map(|i| scanner.azimuth.degrees(i)).collect();
    let columns = f64::from(headings.panorama().width());
    // Half-way between two columns rounding decides: the same product decides alike.
    let off =
        |a: &f64| ((a - azimuths[0]).abs() * columns / 360.0).round() * (360.0 / columns).copysign(a - azimuths[0]);
    let moved: Vec<f64> = azimuths.iter().map(|a| azimuths[0] + off(a)).collect();
    let least = azimuths.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(360.0, f64::min);
    assert!(azimuths.iter().zip(&moved).all(|(a, m)| (a - m).abs() <= 0.25 * least + 1e-9));
    let geometry = Geometry::Scanner(Scanner { azimuth: Angles::Listed(moved), ..scanner.clone() });
    Sensor::new(sensor.spec().clone().with_geometry(geometry)).unwrap()
}

/// Weighs one place by the batch, and each heading by the oracle on single predictions of the panorama's beams.
fn check(world: &World, sensor: &Sensor, count: u32, place: Pose) {
    let (mut random, mut engine) = (Random(2), predictor(2));
    let headings = Headings::new(sensor, count).unwrap();
    let beams_of = resampled(sensor, &headings);
    let sensed = disturbed(
        &mut random,
        sensor.spec(),
        &single(&mut engine, world, sensor, &headings.pose(place.translation, 1).world_from_sensor()).0,
    );
    let cell = PoseCell { side: 0.05, turn: 0.01 };
    let request = BatchRequest {
        likelihood: Some(RangeLikelihood::new(&frame_of(sensor, sensed.clone()), cell).unwrap()),
        headings: Some(headings.clone()),
        ..BatchRequest::default()
    };
    let item = predictor(2).batch(world, sensor, [SensorPose::new(place)], &request).unwrap().next().unwrap().unwrap();
    assert_eq!(item.headings.len(), count as usize);
    // By the formula, a beam that comes twice counts once.
    let distinct = sensor.distinct_columns() as usize;
    let mut sensed = sensed;
    sensed.chunks_mut(sensor.width() as usize).for_each(|row| row[distinct..].fill(f32::NAN));
    let beams = sensed.iter().filter(|r| !r.is_nan()).count() as f64;
    let mut apart = 0;
    for (k, ours) in (0..count).zip(&item.headings) {
        let (range, cos) =
            single(&mut engine, world, &beams_of, &headings.pose(place.translation, k).world_from_sensor());
        let truth = oracle::log_likelihood(sensor.spec(), cell, &sensed, &range, &cos);
        // A beam at an edge may hit the surface next to it: one beam can change the sum by no more than this.
        let off = (f64::from(*ours) - truth).abs() * NOISE.mixture.beam_dependence;
        apart += usize::from(off > 1e-5 * beams);
        assert!(off < 1e-5 * beams + 3.0 * 14.0, "heading {k}: {ours}, truly {truth}");
    }
    assert!(apart * 20 <= count as usize, "{apart} of {count} headings");
    // The scan's true heading has the best weight; with a planted shift by one heading it has not.
    let best = (0..count).max_by(|a, b| item.headings[*a as usize].total_cmp(&item.headings[*b as usize])).unwrap();
    assert_eq!(best, 1);
}

#[test]
fn each_shift_is_a_heading() {
    let world = World::new(scenes::room(6, 30));
    let place = |x, y| Pose::from_xyz_rpy(glam::DVec3::new(x, y, 1.3), 0.0, 0.0, 2.0);
    check(&world, &scanner(-90.0, 0.5, 361, &[0.0], (0.0, 30.0)), 360, place(0.3, 0.2));
    check(&world, &scanner(-90.0, 0.5, 361, &[0.0], (0.7, 4.0)), 720, place(-0.3, 0.2));
    check(&world, &scanner(100.0, -1.0, 200, &[0.0], (0.5, 3.0)), 72, place(-0.3, 0.5));
    check(&world, &scanner(3.3, 2.0, 50, &[10.0, 0.0, -5.0], (0.5, 6.0)), 90, place(0.4, -0.5));
    check(&world, &scanner(0.0, 360.0 / 7.0, 7, &[0.0], (0.0, 6.0)), 7, place(0.4, -0.5));
}

/// Steps that do not divide the turn, or not into as many headings; a last beam that is the first again (TurtleBot3,
/// YDLIDAR); RPLIDAR; uneven azimuths, rising and falling.
#[test]
fn other_steps_are_resampled() {
    let world = World::new(scenes::room(6, 30));
    let place = |x, y| Pose::from_xyz_rpy(glam::DVec3::new(x, y, 1.3), 0.0, 0.0, 2.0);
    let limits = (0.0, 30.0);
    let rplidar = [-3.124_139f64, 3.141_539].map(f64::to_degrees);
    check(&world, &scanner(0.0, 0.7, 514, &[0.0], limits), 90, place(0.3, 0.2));
    check(&world, &scanner(120.0, -0.33, 800, &[0.0], limits), 72, place(-0.3, 0.2));
    check(&world, &scanner(0.0, 6.283_189_77f64.to_degrees() / 359.0, 360, &[0.0], limits), 359, place(0.3, 0.2));
    check(&world, &scanner(-180.0, 360.0 / 719.0, 720, &[5.0, 0.0], limits), 60, place(-0.3, 0.5));
    check(&world, &scanner(rplidar[0], (rplidar[1] - rplidar[0]) / 359.0, 360, &[0.0], limits), 360, place(0.3, 0.2));
    check(&world, &scanner(-90.0, 0.5, 361, &[0.0], limits), 7, place(0.3, 0.2));
    let mut random = Random(12);
    let mut listed = vec![-170.0];
    while listed.len() < 300 {
        listed.push(listed[listed.len() - 1] + random.uniform(0.6, 1.6));
    }
    for falling in [false, true] {
        let azimuth = Angles::Listed(if falling { listed.iter().rev().copied().collect() } else { listed.clone() });
        let elevation = Angles::Listed(vec![0.0]);
        let uneven = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
        let spec = scanner(0.0, 1.0, 2, &[0.0], limits).spec().clone().with_geometry(uneven);
        check(&world, &Sensor::new(spec).unwrap(), 120, place(0.4, -0.5));
    }
}

#[test]
fn impossible_headings_are_refused() {
    let refused = |sensor: &Sensor, count: u32, what: &str| {
        let e = Headings::new(sensor, count).unwrap_err();
        assert!(e.kind() == ErrorKind::Usage && e.to_string().contains(what) && !e.remedy().is_empty(), "{e}");
    };
    let good = scanner(-90.0, 0.5, 361, &[0.0], (0.0, 30.0));
    refused(&good, 0, "0 headings");
    refused(&good, 100_000, "100000 headings");
    refused(&presight_read::preset("video-camera").unwrap(), 10, "not a scanner");

    let sensed = RangeLikelihood::new(&frame_of(&good, vec![1.0; 361]), PoseCell::default()).unwrap();
    let headings = Some(Headings::new(&good, 360).unwrap());
    let world = World::new(scenes::room(1, 3));
    let request = BatchRequest { likelihood: Some(sensed), headings, ..BatchRequest::default() };
    let leaning = Pose::from_xyz_rpy(glam::DVec3::Z, 0.0, 1e-3, 0.0);
    let e =
        predictor(1).batch(&world, &good, [SensorPose::new(leaning)], &request).unwrap().next().unwrap().unwrap_err();
    assert!(e.kind() == ErrorKind::Usage && e.to_string().contains("tilted") && e.place() == Some("pose 0"), "{e}");
    let without = BatchRequest { likelihood: None, ..request };
    assert!(predictor(1).batch(&world, &good, [SensorPose::IDENTITY], &without).is_err());
}

/// Real scans in a real map. With places 0.25 m apart and headings of 1 degree the best pose is the scan's own; for
/// scans in ambiguous corridors the scan's pose is among the best distinct places.
#[test]
fn real_scans_are_found_in_their_map() {
    let Some(log) = data::file("lidar2d/malaga_corridor_run_scans.json") else { return };
    let Some(map) = data::file("lidar2d/malaga_corridor_map.glb") else { return };
    let options = presight_read::gltf::ImportOptions::default();
    let world = World::new(presight_read::gltf::import(map, &options).unwrap().environment);
    let log = log::open(&log).unwrap();
    let noise = Noise {
        range_sigma: 0.05,
        mixture: Mixture { beam_dependence: 5.0, ..Mixture::default() },
        ..Noise::default()
    };
    let sensor = noisy(log.sensor(), noise);
    let headings = Headings::new(&sensor, 360).unwrap();
    let cell = PoseCell { side: 0.25, turn: 1f64.to_radians() };
    let (mut found, mut scans) = (0, 0);
    for frame in log.step_by(6).map(|frame| frame.unwrap()) {
        let truth = frame.reference.unwrap().sensor(&sensor).world_from_sensor();
        let at = |i: i32, k: i32| truth.translation + 0.25 * glam::DVec3::new(f64::from(i), f64::from(k), 0.0);
        // A window of the map that does not contain the true pose itself.
        let off = glam::DVec3::new(0.11, -0.07, 0.0);
        let places = (-8..=8).flat_map(|i| (-8..=8).map(move |k| (i, k))).map(|(i, k)| at(i, k) + off);
        let places = places.map(|translation| Pose { translation, ..Pose::IDENTITY });
        let sensed = RangeLikelihood::new(&frame_of(&sensor, frame.range.clone()), cell).unwrap();
        let request =
            BatchRequest { likelihood: Some(sensed), headings: Some(headings.clone()), ..BatchRequest::default() };
        let mut best = (f32::NEG_INFINITY, Pose::IDENTITY);
        for item in
            predictor(2).batch(&world, &sensor, places.map(SensorPose::new).collect::<Vec<_>>(), &request).unwrap()
        {
            let item = item.unwrap();
            for (k, log_likelihood) in (0..).zip(&item.headings) {
                if *log_likelihood > best.0 {
                    best = (
                        *log_likelihood,
                        headings.pose(item.pose.world_from_sensor().translation, k).world_from_sensor(),
                    );
                }
            }
        }
        let apart = best.1.translation.distance(truth.translation);
        let turned = best.1.rotation.angle_between(truth.rotation).to_degrees();
        scans += 1;
        found += usize::from(apart < 0.36 && turned < 2.0);
        println!("{apart:.2} m, {turned:.1} deg");
    }
    assert!(found == scans, "{found} of {scans} scans");
}
