//! How well explored models predict held-out measurements: `cargo bench --bench explore` prints the table of
//! benches/RESULTS.md (`-- living` the rows whose names begin so), and `-- 500 1000` memory and rate for these numbers of frames. Truth are
//! dense rays of the testkit's caster.

#![expect(clippy::print_stdout, reason = "a bench prints a table")]

use presight::environment::Environment;
use presight::explore::{Exploration, ExploreOptions, Known, Views};
use presight_model::geometry::SensorPose;
use presight_testkit::data;
#[path = "../crates/presight-explore/tests/explore/factory_drive.rs"]
mod factory_drive;
use cpu_time::ProcessTime;
use presight_testkit::judge::{Judged, Placed, frames, judge};
use std::time::Instant;

/// Seconds by the clock, and of CPU in all threads of this process.
#[derive(Clone, Copy)]
struct Seconds {
    clock: f64,
    cpu: f64,
}

/// The result of a job, and its time.
fn timed<T>(job: impl FnOnce() -> T) -> (T, Seconds) {
    let (start, cpu) = (Instant::now(), ProcessTime::now());
    let made = job();
    (made, Seconds { clock: start.elapsed().as_secs_f64(), cpu: cpu.elapsed().as_secs_f64() })
}

/// One row of the table.
struct Row {
    name: &'static str,
    polygons: usize,
    seconds: Seconds,
    views: usize,
    judged: Judged,
}

fn explored(views: &[Placed], options: &ExploreOptions) -> (Exploration, Seconds) {
    let mut all = Views::default();
    views.iter().for_each(|(frame, pose)| all.push(frame, SensorPose::new(*pose)).expect("a sound view"));
    timed(|| Exploration::of(&Environment::new(), Known::Explored, &all, options).expect("surfaces"))
}

fn row(
    name: &'static str,
    build: &[Placed],
    held_out: &[Placed],
    options: &ExploreOptions,
    near: f64,
    far: f64,
) -> Row {
    let (found, seconds) = explored(build, options);
    let judged = judge(found.environment(), held_out, near, far);
    Row { name, polygons: found.polygons(), seconds, views: build.len(), judged }
}

/// The rows whose place begins so.
fn rows(place: &str) -> Vec<Row> {
    let (mut rows, is_asked) = (Vec::new(), |name: &str| name.starts_with(place));
    if let Some(log) = data::file("rgbd/livingroom").filter(|_| is_asked("living room")) {
        let all = frames(&log, 4);
        let even: Vec<Placed> = all.iter().step_by(2).cloned().collect();
        let odd: Vec<Placed> = all.iter().skip(1).step_by(8).cloned().collect();
        for (name, polygons) in [("living room", 2000), ("living room, 500 polygons", 500)] {
            rows.push(row(name, &even, &odd, &ExploreOptions::default().with_polygons(polygons), 0.02, 0.05));
        }
    }
    if let (Some(log), Some(run)) =
        (data::file("lidar2d/malaga_corridor_mapping_scans.json"), data::file("lidar2d/malaga_corridor_run_scans.json"))
        && is_asked("corridor")
    {
        let options = ExploreOptions::default().with_polygons(200).with_floor(-1.0);
        rows.push(row("corridor", &frames(&log, 1), &frames(&run, 1), &options, 0.05, 0.2));
    }
    if let Some(log) = data::file("lidar3d").filter(|_| is_asked("street")) {
        let scans = frames(&log, 1);
        let options = ExploreOptions::default().with_polygons(10_000);
        rows.push(row("street", &scans[..1], &scans[1..2], &options, 0.1, 1.0));
    }
    if is_asked("factory") {
        rows.push(factory());
    }
    rows
}

/// Machines that a rough model has as boxes; right is within 5 cm.
fn factory() -> Row {
    let [real, rough] = factory_drive::scenes();
    let (drive, other) = (factory_drive::drive(&real, 36, 0.0), factory_drive::drive(&real, 10, 0.15));
    let mut views = Views::default();
    drive.iter().for_each(|(frame, pose)| views.push(frame, SensorPose::new(*pose)).expect("a sound view"));
    let (found, seconds) =
        timed(|| Exploration::of(&rough, Known::Rough, &views, &ExploreOptions::default()).expect("surfaces"));
    let judged = judge(found.environment(), &other, 0.05, 0.05);
    Row { name: "factory, machines as boxes", polygons: found.polygons(), seconds, views: drive.len(), judged }
}

/// Peak memory of this process, and the rate, for numbers of frames. The frames of the living room come again and again.
fn memory(counts: &[usize]) {
    let Some(log) = data::file("rgbd/livingroom") else { return };
    let all = frames(&log, 4);
    println!("| frames | MB | frames/s | frames per second of CPU |\n|---|---|---|---|");
    for count in counts {
        let mut views = Views::default();
        all.iter()
            .cycle()
            .take(*count)
            .for_each(|(frame, pose)| views.push(frame, SensorPose::new(*pose)).expect("a sound view"));
        let options = ExploreOptions::default();
        let explore = || Exploration::of(&Environment::new(), Known::Explored, &views, &options).expect("surfaces");
        let (_, seconds) = timed(explore);
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kilobytes = peak.and_then(|words| words.split_whitespace().next()?.parse::<f64>().ok()).unwrap_or(f64::NAN);
        let count = *count as f64;
        println!("| {count} | {:.0} | {:.1} | {:.1} |", kilobytes / 1e3, count / seconds.clock, count / seconds.cpu);
    }
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let counts: Vec<usize> = words.iter().filter_map(|word| word.parse().ok()).collect();
    if !counts.is_empty() {
        return memory(&counts);
    }
    println!(
        "| case | polygons | median, mm | right of all, % | right of covered, % | covered, % | too near, % | frames/s \
         | frames per second of CPU |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let rows = rows(words.first().map_or("", String::as_str));
    for Row { name, polygons, seconds, views, judged: j } in rows {
        let [rate, by_cpu] = [seconds.clock, seconds.cpu].map(|seconds| views as f64 / seconds);
        println!(
            "| {name} | {polygons} | {:.2} | {:.1} | {:.1} | {:.1} | {:.2} | {rate:.1} | {by_cpu:.1} |",
            1e3 * j.median,
            j.within,
            j.within_of_hits,
            j.covered,
            j.nearer
        );
    }
}
