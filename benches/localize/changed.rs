//! Drives through rooms that are no longer as the map has them: `cargo bench --bench localize -- changed [FRAMES]
//! [SCENE,..] [CASE,..] [SEED] [MODEL_SIGMA]`. The logs come from the test kit's own ray caster. Each row is one drive; cases and scenes
//! are chosen by a part of their name, `-` for all. `changed 60 hospital 15` takes seconds. `cargo bench --bench localize
//! -- leads [FRAMES] [SCENE,..]` counts by how much the best place of a map leads over the others, for scans of this map,
//! changed, and of another building.

use super::cases::{
    CASES, Drive, EXACT, Log, MUCH, SOME, corridor, elsewhere, from_behind, hard_views, load, malaga, person, scanner,
    wander,
};
use super::single;
use cpu_time::ProcessTime;
use presight_localize::estimate::{EstimateOptions, Estimator, nees};
use presight_localize::localize::{LocalizeOptions, Localizer, Phase, Search, SearchOptions};
use presight_model::geometry::{PoseEstimate, RobotPose};
use presight_model::world::World;
use presight_testkit::route::Driving;

const SCENES: [&str; 6] =
    ["hospital", "factory_hall", "warehouse_small", "office_clearpath", "scenes/factory.rhai", "office_willowgarage"];
/// The 99.99 % quantiles of chi squared with three and with six degrees of freedom.
const QUANTILES: [(usize, f64); 2] = [(3, 21.11), (6, 27.86)];

/// The figures of a drive.
#[derive(Default)]
struct Row {
    frames: usize,
    good: usize,
    /// Tracked within 15 cm and 2 degrees.
    near: usize,
    tracking: usize,
    certain_and_wrong: usize,
    /// Tracked, with a NEES over its 99.99 % quantile.
    beyond: usize,
    /// Largest angle that a tracked pose is off, degrees.
    most_deg: f64,
    nees: Vec<f64>,
    /// Frames from the start, or from where the robot was carried to, until it was tracked rightly.
    found: Option<usize>,
    /// Tracking at the frame at which it was carried away.
    tracked_away: bool,
    squares: [f64; 2],
    cpu_ms: Vec<f64>,
    reason: String,
}

const HEAD: &str = "| scene | case | good % | within 15 cm % | tracking % | certain and wrong | NEES a number | found at frame | RMS mm | RMS deg | CPU ms p50 | p95 |\n|---|---|---|---|---|---|---|---|---|---|---|---|";

impl Row {
    fn print(&mut self, scene: &str, case: &str) {
        self.cpu_ms.sort_by(f64::total_cmp);
        let at = |share: f64| self.cpu_ms[((self.cpu_ms.len() - 1) as f64 * share).round() as usize];
        let share = |n: usize| 100.0 * n as f64 / self.frames as f64;
        let mean = self.nees.iter().sum::<f64>() / self.nees.len().max(1) as f64;
        let rms = |sum: f64| (sum / self.nees.len().max(1) as f64).sqrt();
        println!(
            "| {scene} | {case} | {:.0} | {:.0} | {:.0} | {} | {mean:.2} | {}{} | {:.1} | {:.3} | {:.1} | {:.1} |",
            share(self.good),
            share(self.near),
            share(self.tracking),
            self.certain_and_wrong,
            self.found.map_or("never".to_owned(), |k| k.to_string()),
            if self.tracked_away { ", tracked where it was" } else { "" },
            1e3 * rms(self.squares[0]),
            rms(self.squares[1]),
            at(0.5),
            at(0.95),
        );
        if std::env::var_os("PRESIGHT_REASONS").is_some() {
            println!("{}", self.reason);
        }
    }
}

fn localized(log: &Log) -> Row {
    let sensor = log.frames[0].sensor();
    // As in the command: the deviation of the map is learnt unless it is stated.
    let estimate = EstimateOptions::of(sensor).with_learns_sigma(true).with_stated_sigma(log.model_sigma);
    let mut estimator = Estimator::new(single(), estimate);
    let (options, search) = (LocalizeOptions::default(), SearchOptions::default());
    let mut robot = match log.start {
        Some(start) => {
            let prior = PoseEstimate::of_sigmas(RobotPose::new(start), 0.05, 2f64.to_radians());
            Localizer::new(estimator, prior, options)
        }
        None => {
            let search = Search::new(&mut estimator, &log.map, sensor, search).expect("a search");
            Localizer::unknown(estimator, search, options)
        }
    };
    let planar = !sensor.is_camera() && sensor.height() == 1;
    let mut may_search = log.start.is_some() && planar;
    let mut row = Row::default();
    for (k, (frame, truth)) in log.frames.iter().zip(&log.truth).enumerate() {
        let before = ProcessTime::now();
        let step = robot.step(&log.map, frame).expect("a step");
        if may_search && matches!(step.phase, Phase::Lost | Phase::Unknown) {
            may_search = false;
            // As in the command: without this search only the surroundings of the last pose are searched.
            robot.search_everywhere(&log.map, sensor, search).ok();
        }
        row.cpu_ms.push(1e3 * before.elapsed().as_secs_f64());
        row.frames += 1;
        let is_tracking = step.phase == Phase::Tracking;
        row.tracking += usize::from(is_tracking);
        let mut line = format!("  {k}: {}: {}", step.phase.name(), step.reason);
        if let Some(truth) = truth {
            let found = &step.pose.world_from_robot;
            let off = (
                (found.translation - truth.translation).length(),
                found.rotation.angle_between(truth.rotation).to_degrees(),
            );
            let (squared, axes) = nees(&step.pose, &RobotPose::new(*truth));
            let is_near = off.0 < 0.05 && off.1 < 1.0;
            line += &format!("; {:.3} m {:.2} deg, NEES {:.1}", off.0, off.1, squared / axes.max(1) as f64);
            if is_tracking {
                row.nees.push(squared / axes.max(1) as f64);
                row.squares[0] += off.0 * off.0;
                row.squares[1] += off.1 * off.1;
                let quantile = QUANTILES.iter().find(|q| q.0 == axes).map_or(0.0, |q| q.1);
                row.beyond += usize::from(squared > quantile);
                row.most_deg = row.most_deg.max(off.1);
                row.good += usize::from(is_near);
                row.near += usize::from(off.0 < 0.15 && off.1 < 2.0);
                row.certain_and_wrong += usize::from(!is_near && squared > quantile);
                row.tracked_away |= log.looked_for == k && k > 0 && !is_near;
            }
            if is_tracking && is_near && k >= log.looked_for && row.found.is_none() {
                row.found = Some(k - log.looked_for);
            }
        } else {
            row.certain_and_wrong += usize::from(is_tracking);
        }
        row.reason += &format!("{line}; {:.0} ms\n", row.cpu_ms[k]);
    }
    row
}

/// True if a name contains one of the requested parts, or if none are given.
fn is_asked(asked: Option<&String>, name: &str) -> bool {
    asked.is_none_or(|a| a == "-" || a.split(',').any(|part| name.contains(part)))
}

/// Prints a row for each requested drive.
pub fn all(words: &[String]) {
    let frames = words.first().map_or(300, |n| n.parse().expect("a number of frames"));
    let (scenes, cases) = (words.get(1), words.get(2));
    let seed = words.get(3).map_or(1, |n| n.parse().expect("a seed"));
    let stated = words.get(4).map(|n| n.parse().expect("a deviation of the map, metres"));
    println!("{frames} frames a drive, seed {seed}\n{HEAD}");
    let asked: Vec<&str> = SCENES.into_iter().filter(|name| is_asked(scenes, name)).collect();
    for name in asked {
        let Some(world) = load(name) else { continue };
        let is_needed = CASES.iter().any(|(case, _)| case.contains("other") && is_asked(cases, case));
        let next = SCENES[(SCENES.iter().position(|s| *s == name).unwrap_or(0) + 1) % SCENES.len()];
        let other = if is_needed { load(next) } else { None };
        for (case, make) in CASES.iter().filter(|(case, _)| is_asked(cases, case)) {
            let log = make(&world, other.as_ref().unwrap_or(&world), frames, seed);
            localized(&Log { model_sigma: stated, ..log }).print(name, case);
        }
        for sigma in [None, Some(0.0), Some(0.01), Some(0.03)] {
            let case = format!(
                "person before a depth camera, model sigma {}",
                sigma.map_or("unset".into(), |s| s.to_string())
            );
            if is_asked(cases, &case) {
                localized(&person(&world, frames, sigma, seed)).print(name, &case);
            }
        }
        let (mut views, mut beyond, mut most_deg) = (0, 0, 0.0f64);
        for (seed, (shares, walkers)) in (1..=5).flat_map(|seed| [(seed, (EXACT, 0)), (seed, (SOME, 5))]) {
            let case = format!("hard views, {} {seed}", if shares == EXACT { "unchanged" } else { "changed" });
            if name == "factory_hall" && is_asked(cases, &case) {
                let mut row = localized(&hard_views(&world, shares, walkers, seed));
                row.print(name, &case);
                (views, beyond) = (views + row.tracking, beyond + row.beyond);
                most_deg = most_deg.max(row.most_deg);
            }
        }
        if views > 0 {
            println!(
                "{views} hard views are tracked, {beyond} with a NEES over the 99.99 % quantile, the worst {most_deg:.2} deg off"
            );
        }
    }
    if is_asked(scenes, "corridor") && is_asked(cases, "corridor without odometry") {
        localized(&corridor(frames)).print("corridor", "corridor without odometry");
    }
    for (case, given, shares) in [
        ("real scans, start given", true, EXACT),
        ("real scans, unknown start", false, EXACT),
        ("real scans, 15/15 of the walls, start given", true, SOME),
        ("real scans, 15/15 of the walls, unknown start", false, SOME),
    ] {
        if is_asked(scenes, "malaga") && is_asked(cases, case) {
            malaga(given, shares, seed).iter().for_each(|log| localized(log).print("malaga corridor", case));
        }
    }
}

/// Short drives in maps of other buildings, for this number of seconds: how many have a frame that is tracked.
pub fn wrong(words: &[String]) {
    let seconds = words.first().map_or(300.0, |n| n.parse().expect("a number of seconds"));
    let began = std::time::Instant::now();
    let worlds: Vec<(&str, World)> = SCENES.into_iter().filter_map(|name| Some((name, load(name)?))).collect();
    let (mut drives, mut frames, mut tracked) = (0, 0, Vec::new());
    'drives: for seed in 1.. {
        for (k, (name, world)) in worlds.iter().enumerate() {
            // Each other building in turn.
            let (other, building) = &worlds[(k + 1 + seed as usize % (worlds.len() - 1)) % worlds.len()];
            for given in [true, false] {
                if began.elapsed().as_secs_f64() > seconds {
                    break 'drives;
                }
                let row = localized(&elsewhere(world, building, 20, given, seed));
                (drives, frames) = (drives + 1, frames + row.frames);
                if row.tracking > 0 {
                    tracked.push(format!("{other} in the map of {name}, given {given}, seed {seed}: {}", row.tracking));
                }
            }
        }
    }
    println!("{drives} drives of {frames} frames in other buildings, {} with a tracked frame", tracked.len());
    tracked.iter().for_each(|line| println!("{line}"));
}

/// For single scans: the odds by which the best place of the map leads over all others, as the localizer counts them.
pub fn leads(words: &[String]) {
    let frames = words.first().map_or(100, |n| n.parse().expect("a number of frames"));
    println!(
        "| map | scans | number | lead p5 | p50 | p95 | over 3 | over 4.6 | over 6.9 | right |\n|---|---|---|---|---|---|---|---|---|---|"
    );
    for (k, name) in SCENES.into_iter().enumerate().filter(|(_, name)| is_asked(words.get(1), name)) {
        let (Some(world), Some(other)) = (load(name), load(SCENES[(k + 1) % SCENES.len()])) else { continue };
        let sensor = scanner(true);
        let mut estimator = Estimator::new(single(), EstimateOptions::of(&sensor));
        let search = Search::new(&mut estimator, &world, &sensor, SearchOptions::default()).expect("a search");
        // Three seconds apart: other views.
        let driving = Driving { seconds: frames as f64 / 0.3 + 1.0, speed: 0.7, turn: 0.7 };
        let scans = |w: &World, shares| {
            Drive { hertz: 0.3, shares, route: wander(w, &driving, 1), ..Drive::new(w, frames, 1) }.usual()
        };
        for (kind, log) in [
            ("of another building", scans(&other, EXACT)),
            ("mirrored", from_behind(scans(&world, EXACT))),
            ("15/15", scans(&world, SOME)),
            ("40/40", scans(&world, MUCH)),
        ] {
            let (mut leads, mut right) = (Vec::new(), 0);
            for (frame, truth) in log.frames.iter().zip(&log.truth) {
                let estimator = Estimator::new(single(), EstimateOptions::of(&sensor));
                let mut robot = Localizer::unknown(estimator, search.clone(), LocalizeOptions::default());
                let step = robot.step(&world, frame).expect("a step");
                let Some(best) = step.candidates.first() else { continue };
                let off = truth.map(|truth| best.pose.world_from_robot.translation.distance(truth.translation));
                right += usize::from(kind.contains('/') && off.is_some_and(|off| off < 0.3));
                leads.push(best.log_likelihood);
            }
            leads.sort_by(f64::total_cmp);
            let at = |share: f64| leads[((leads.len() - 1) as f64 * share).round() as usize];
            let over = |x: f64| leads.iter().filter(|lead| **lead > x).count();
            println!(
                "| {name} | {kind} | {} | {:.1} | {:.1} | {:.1} | {} | {} | {} | {right} |",
                leads.len(),
                at(0.05),
                at(0.5),
                at(0.95),
                over(3.0),
                over(4.6),
                over(6.9)
            );
        }
    }
}
