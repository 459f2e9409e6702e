//! The corridor of Malaga: walls from the mapping run, judged by the localization run.

use presight_explore::{Exploration, ExploreOptions, Known, Views};
use presight_model::environment::{Environment, MarkKind};
use presight_model::geometry::SensorPose;
use presight_testkit::judge::{frames, judge};

#[test]
fn two_hundred_walls_predict_the_other_run() {
    let Some(log) = presight_testkit::data::file("lidar2d/malaga_corridor_mapping_scans.json") else { return };
    let run = presight_testkit::data::file("lidar2d/malaga_corridor_run_scans.json").unwrap();
    let mut views = Views::default();
    for (frame, pose) in frames(&log, 1) {
        views.push(&frame, SensorPose::new(pose)).unwrap();
    }
    let options = ExploreOptions::default().with_polygons(200).with_floor(-1.0);
    let found = Exploration::of(&Environment::new(), Known::Explored, &views, &options).unwrap();
    let judged = judge(found.environment(), &frames(&run, 1), 0.05, 0.2);
    println!("{} walls: {judged:.4?}", found.polygons());
    assert!(found.polygons() <= 200);
    assert!(judged.median < 0.0205 && judged.within_of_hits > 77.0, "{judged:?}");
    assert!(judged.within > 72.0 && judged.covered > 92.5, "{judged:?}");
    // Each wall is assumed below and above the scan plane.
    let marks: Vec<_> = found.environment().marks().collect();
    assert_eq!(marks.len(), 2 * found.polygons());
    assert!(marks.iter().all(|(_, mark)| mark.kind == MarkKind::Uncertain));
}
