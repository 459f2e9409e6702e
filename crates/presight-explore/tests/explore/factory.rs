//! Machines known as boxes get their real surfaces, and keep their paths.

use super::factory_drive::{drive, scenes};
use presight_explore::{Exploration, ExploreOptions, Known, Views};
use presight_model::environment::Environment;
use presight_model::geometry::SensorPose;
use presight_testkit::judge::{Placed, judge, sights};
use presight_testkit::oracle::Oracle;

/// Share of the pixels of frames at which a model is off by over 5 cm, by rays without noise. A pixel is excused if its
/// eight neighbours and itself span what the model shows, to 5 cm: an edge within a pixel. Places that fewer than three
/// frames of `built` saw do not count.
fn off(real: &Environment, model: &Environment, frames: &[Placed], built: &[Placed]) -> f64 {
    let origin = frames[0].1.translation;
    let (truth, model) = (Oracle::seen_by(real, origin, "laser").unwrap(), Oracle::new(model, origin).unwrap());
    let (mut all, mut off) = (0, 0);
    for (frame, pose) in frames {
        let (sensor, width) = (frame.sensor(), frame.sensor().width() as i64);
        let pixel = |i: i64| ((i % width) as u32, (i / width) as u32);
        let cast = |oracle: &Oracle, i: i64| oracle.cast(sensor, pose, pixel(i)).and_then(|v| v.range).unwrap();
        let real: Vec<f32> = (0..frame.ranges().len() as i64).map(|i| cast(&truth, i)).collect();
        for (i, range) in (0..).zip(&real).filter(|(_, range)| range.is_finite()) {
            all += 1;
            let shown = cast(&model, i);
            if !shown.is_finite() || (shown - range).abs() < 0.05 {
                continue;
            }
            let around = (-1..=1).flat_map(|y| (-1..=1).map(move |x| (i % width + x, i + y * width + x)));
            let around = around.filter(|(column, _)| (0..width).contains(column));
            let near: Vec<f32> = around.filter_map(|(_, i)| real.get(usize::try_from(i).ok()?).copied()).collect();
            let least = near.iter().copied().fold(f32::INFINITY, f32::min);
            let most = near.iter().copied().fold(0.0, f32::max);
            let is_edge = shown > least - 0.05 && shown < most + 0.05;
            let (column, row) = pixel(i);
            let direction = pose.rotation * (sensor.body_from_image() * sensor.ray(column, row).unwrap());
            off += usize::from(!is_edge && sights(built, pose.translation + direction * f64::from(*range), 0.03) >= 3);
        }
    }
    off as f64 / f64::from(all)
}

/// Measured: 0.27 % of the pixels show a surface that is off by over 5 cm: narrow sides of panels and covers that few
/// pixels of the drive show, behind which the model shows the machine's box. The aim of 0 is missed.
#[test]
fn machines_known_as_boxes_are_corrected_and_keep_their_paths() {
    let [real, rough] = scenes();
    let mut views = Views::default();
    let built = drive(&real, 36, 0.0);
    built.iter().for_each(|(frame, pose)| views.push(frame, SensorPose::new(*pose)).unwrap());
    let clock = std::time::Instant::now();
    let found = Exploration::of(&rough, Known::Rough, &views, &ExploreOptions::default()).unwrap();
    println!("{} polygons in {:.1} s, {:.2} m2 opened", found.polygons(), clock.elapsed().as_secs_f64(), found.opened);
    let other = drive(&real, 10, 0.15);
    let (before, after) = (judge(&rough, &other, 0.05, 0.05), judge(found.environment(), &other, 0.05, 0.05));
    println!("before {before:.4?}\nafter {after:.4?}, gone {:?}", found.gone);
    assert!(found.gone.is_empty(), "{:?}", found.gone);
    let [boxes, share] = [&rough, found.environment()].map(|model| off(&real, model, &other, &built));
    println!("off by over 5 cm: {boxes:.4} before, {share:.4} after");
    assert!(boxes > 0.1, "planted: {boxes}");
    assert!(share < 0.004, "{share}");
    for path in ["hall/floor", "line/machine1", "line/machine2"] {
        assert!(found.environment().object(path).is_some(), "{path}");
    }
    assert!(before.within_of_hits < 60.0, "planted: {before:?}");
    assert!(after.within_of_hits > 97.0 && after.nearer < 1.0 && after.covered > 90.0, "{after:?}");
}
