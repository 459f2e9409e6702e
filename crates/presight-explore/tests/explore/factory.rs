//! Machines known as boxes get their real surfaces, and keep their paths.

use super::factory_drive::{drive, scenes};
use presight_explore::{Exploration, ExploreOptions, Known, Views};
use presight_testkit::judge::judge;

#[test]
fn machines_known_as_boxes_are_corrected_and_keep_their_paths() {
    let [real, rough] = scenes();
    let mut views = Views::default();
    drive(&real, 36, 0.0).iter().for_each(|(frame, pose)| views.push(frame, *pose).unwrap());
    let clock = std::time::Instant::now();
    let found = Exploration::of(&rough, Known::Rough, &views, &ExploreOptions::default()).unwrap();
    println!("{} polygons in {:.1} s, {:.2} m2 opened", found.polygons(), clock.elapsed().as_secs_f64(), found.opened);
    let other = drive(&real, 10, 0.15);
    let (before, after) = (judge(&rough, &other, 0.05, 0.05), judge(found.environment(), &other, 0.05, 0.05));
    println!("before {before:.4?}\nafter {after:.4?}, gone {:?}", found.gone);
    assert!(found.gone.is_empty(), "{:?}", found.gone);
    for path in ["hall/floor", "line/machine1", "line/machine2"] {
        assert!(found.environment().object(path).is_some(), "{path}");
    }
    assert!(before.within_of_hits < 60.0, "planted: {before:?}");
    assert!(after.within_of_hits > 97.0 && after.nearer < 1.0 && after.covered > 90.0, "{after:?}");
}
