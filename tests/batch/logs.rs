//! Reads the three scan logs of the shared data unchanged.

use super::common;
use common::data;
use presight_model::sensor::{Angles, Geometry};
use presight_read::log;

#[test]
fn external_scan_logs_are_read() {
    // Name, beams, first azimuth and step in degrees, largest range, height, frames, readings. Counted with jq.
    let logs = [
        ("malaga_corridor_mapping_scans", 361, -90.0, 0.5, 80.0, 0.3, 72, 25_870),
        ("malaga_corridor_run_scans", 361, -90.0, 0.5, 80.0, 0.3, 37, 13_280),
        ("willow", 360, -180.0, 1.0, 20.0, 0.35, 60, 12_455),
    ];
    for (name, beams, start_deg, step_deg, range_max, height, frames, readings) in logs {
        let Some(path) = data::file(&format!("lidar2d/{name}.json")) else { return };
        let log = log::open(&path).unwrap();
        let spec = log.sensor().spec().clone();
        let Geometry::Scanner(scanner) = &spec.geometry else { panic!("a scanner") };
        assert_eq!(scanner.azimuth, Angles::Uniform { start_deg, step_deg, count: beams });
        assert!((spec.range_max, spec.mount.translation.z as f32) == (range_max, height), "{spec:?}");
        let all: Vec<_> = log.map(|frame| frame.unwrap()).collect();
        assert_eq!(all.len(), frames);
        assert_eq!(all.iter().flat_map(|f| &f.range).filter(|r| r.is_finite()).count(), readings);
        assert!(all.iter().all(|f| f.reference.is_some()), "{name}");
        assert_eq!(all[0].odometry.is_some(), name.contains("run"));
        let (_, third) = log::read_frame(&path, 3).unwrap();
        assert_eq!(third.time, all[3].time);
    }
}
