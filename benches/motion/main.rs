//! Verdicts, supervision, exploration and updates by the scans of a driving robot, with and without its motion, and by
//! the scans of a robot that stands at each stamp; all with drop-outs and mixed pixels. The row of other noise shows what
//! these alone change. `cargo bench --bench motion -- [SCANS [SCENE ..]]`
#![allow(clippy::print_stdout, reason = "benches print")]

mod drive;
mod figures;

use drive::Told;
use figures::{confirmed, differing, errors, explored, found, frames, supervised};
use presight_model::world::World;
use presight_testkit::data;
use std::time::Instant;

fn main() {
    let given: Vec<String> = std::env::args().skip(1).filter(|arg| arg != "--bench").collect();
    let count = given.first().and_then(|n| n.parse().ok()).unwrap_or(25);
    let scenes: Vec<&str> = given.iter().skip(1).map(String::as_str).collect();
    let scenes = if scenes.is_empty() { vec!["factory_hall", "hospital"] } else { scenes };
    println!(
        "| scene, scans | confirmed | cells that differ | explored: median, over 2 cm, over 10 cm | findings, beams |"
    );
    println!("|---|---|---|---|---|");
    for name in scenes {
        let Some(world) = data::scene(name, true) else { continue };
        scene(name, &world, count);
    }
}

fn scene(name: &str, world: &World, count: usize) {
    let (sensor, real) = (drive::lidar(512, 64), world.environment());
    let (scans, between) = drive::drive(real, &sensor, count, (1, true));
    let standing = frames(&scans, |scan| scan.standing.clone());
    let letters = supervised(world, &scans.iter().map(|scan| scan.in_the_middle.clone()).collect::<Vec<_>>());
    let row = |what: &str, of: &[figures::At]| {
        let clock = Instant::now();
        let (share, cells) = (confirmed(world, of), differing(&letters, &supervised(world, of)));
        let compared = clock.elapsed();
        let made = explored(of);
        let explored = clock.elapsed() - compared;
        let e = errors(real, &made, &sensor, &between);
        let learning = Instant::now();
        let (findings, beams) = found(world, of);
        println!(
            "| {name}, {what} | {:.2} % | {:.2} % | {:.2} mm, {:.1} %, {:.1} % | {findings}, {:.1} % |",
            100.0 * share,
            100.0 * cells,
            1e3 * e.median,
            100.0 * e.over_2_cm,
            100.0 * e.over_10_cm,
            100.0 * beams
        );
        let seconds = [compared, explored, learning.elapsed()].map(|t| t.as_secs_f64());
        println!(
            "<!-- seconds: verdicts and cells {:.1}, exploration {:.1}, update {:.1} -->",
            seconds[0], seconds[1], seconds[2]
        );
    };
    row("standing", &standing);
    row(
        "standing in the middle, other noise",
        &scans.iter().map(|s| s.in_the_middle_again.clone()).collect::<Vec<_>>(),
    );
    for told in [Told::Truth, Told::Slipping].into_iter().chain(Told::PLANTED) {
        row(&format!("driving, {told:?}"), &frames(&scans, |scan| scan.told(told)));
    }
}
