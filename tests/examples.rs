//! The examples run, and their results are right.

#[path = "../examples/range_image.rs"]
mod range_image;
#[path = "../examples/visible_features.rs"]
mod visible_features;
#[path = "../examples/weigh_particles.rs"]
mod weigh_particles;
#[path = "../examples/what_changed.rs"]
mod what_changed;
#[path = "../examples/where_am_i.rs"]
mod where_am_i;

use glam::DVec3;
use presight::SensorPose;
use presight::localize::Phase;
use presight::verdict::Verdict;

/// The room is 6.25 m by 6 m, so no surface is farther than its diagonal. Beams through its open window see nothing.
#[test]
fn the_range_image_shows_the_room() {
    range_image::main().unwrap();
    let images = range_image::range_image().unwrap();
    assert_eq!((images.range.len(), images.polygon_id.len()), (361, 361));
    let hits: Vec<f32> = images.range.iter().copied().filter(|range| *range != f32::INFINITY).collect();
    assert!(hits.len() > 300 && hits.iter().all(|range| (0.1..8.7).contains(range)), "{hits:?}");
}

/// Many features are visible, and each visible one has a box that holds the middle of its visible part.
#[test]
fn visible_features_have_regions() {
    visible_features::main().unwrap();
    let pose = SensorPose::from_xyz_rpy(DVec3::new(0.3, 0.35, 1.65), 0.0, 0.2, 0.66);
    let seen = visible_features::visible_features(&pose).unwrap().features.unwrap();
    let visible: Vec<_> = seen.features.iter().filter(|f| !f.visible.is_empty()).collect();
    assert!(visible.len() > 10);
    for feature in visible {
        let [x0, y0, x1, y1] = feature.roi.expect("a box");
        let middle = 0.5 * (feature.visible[0].pixels[0] + feature.visible[0].pixels[1]);
        assert!((x0..=x1).contains(&middle.x) && (y0..=y1).contains(&middle.y), "{middle} in {:?}", feature.roi);
    }
}

/// The box is 0.4 m wide and 0.7 m before the scanner: 2 atan(0.2 / 0.7) is 31.9 degrees, 63 beams around the middle one.
#[test]
fn an_added_box_is_nearer() {
    what_changed::main().unwrap();
    let verdicts = what_changed::what_changed(&what_changed::measure().unwrap()).unwrap();
    let nearer = verdicts.counts()[Verdict::Nearer as usize];
    assert!((55..70).contains(&nearer) && verdicts.share(Verdict::Confirmed) > 0.7, "{:?}", verdicts.counts());
    assert_eq!(verdicts.counts()[Verdict::Farther as usize], 0);
}

#[test]
fn the_robot_is_found() {
    where_am_i::main().unwrap();
    let step = where_am_i::where_am_i(&where_am_i::drive().unwrap()).unwrap().expect("a step");
    assert_eq!(step.phase, Phase::Tracking, "{}", step.reason);
    let off = step.pose.world_from_robot.translation.distance(where_am_i::truth(7).world_from_robot().translation);
    assert!(off < 0.05, "{off} m");
}

#[test]
fn the_true_particle_is_the_likeliest() {
    weigh_particles::main().unwrap();
    let particles = weigh_particles::particles();
    let logs = weigh_particles::weigh(&weigh_particles::measure(&particles[515]).unwrap(), &particles).unwrap();
    assert_eq!(logs.len(), 1000);
    assert!((0..1000).all(|i| i == 515 || logs[i] < logs[515]));
}
