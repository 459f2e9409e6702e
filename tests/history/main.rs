//! The tracker against a simulator of its own and a filter that is told the motion.

mod simulator;
mod told;

use glam::DVec2;
use presight::history::{Alternating, ImageExtent, Source, Tracker, TrackerOptions};
use simulator::{Disturbance, HEIGHT, Leg, Simulator, WIDTH, holds, leg};
use std::collections::BTreeMap;
use told::Told;

#[derive(Default, Debug, Clone)]
struct Tally {
    matched: u64,
    wrong: u64,
    windows: u64,
    held: u64,
    area: f64,
    told_area: f64,
    told_held: u64,
    frames: u64,
    history: u64,
    lost: u64,
    full: u64,
    /// held, windows, area, told area by frame since a leg's start
    by_frame: BTreeMap<(usize, usize), [f64; 4]>,
}

impl Tally {
    fn coverage(&self) -> f64 {
        self.held as f64 / self.windows as f64
    }
    fn print(&self, name: &str) {
        println!(
            "{name}: wrong {:.3} % of {}, coverage {:.2} % of {}, area ratio {:.2} (told coverage {:.2} %), frames {} history {:.1} %, full {}, lost {}",
            100.0 * self.wrong as f64 / self.matched.max(1) as f64,
            self.matched,
            100.0 * self.coverage(),
            self.windows,
            self.area / self.told_area,
            100.0 * self.told_held as f64 / self.windows as f64,
            self.frames,
            100.0 * self.history as f64 / self.frames as f64,
            self.full,
            self.lost
        );
    }
}

fn options() -> TrackerOptions {
    TrackerOptions { detection_probability: 0.8, ..TrackerOptions::new(ImageExtent::new(WIDTH, HEIGHT)) }
}

const YOUNG: u32 = 5;

fn run(seed: u64, legs: &[Leg], disturbance: Disturbance, options: TrackerOptions, with_view: bool, tally: &mut Tally) {
    let mut simulator = Simulator::new(seed, disturbance);
    let frames = simulator.drive(legs);
    let mut alternating = Alternating::new(Tracker::new(options.clone()).unwrap(), None);
    let mut told: BTreeMap<u32, Told> = BTreeMap::new();
    let mut before = None;
    for (k, frame) in frames.iter().enumerate() {
        if with_view {
            alternating.set_view(|p| frame.robot.project(p));
        }
        let step = alternating.predict(frame.time, || Ok(simulator.predict_fully(frame, 150))).unwrap();
        tally.frames += 1;
        match &step.source {
            Source::History => tally.history += 1,
            Source::Full { seeded, .. } => {
                tally.full += 1;
                for id in &seeded.begun {
                    told.insert(*id, Told::new(&disturbance));
                }
            }
        }
        let wanted: Vec<Option<DVec2>> = step.windows.iter().map(|w| simulator.detected_at(frame, w.id)).collect();
        for (window, at) in step.windows.iter().zip(&wanted) {
            let Some(at) = at else { continue };
            let track = alternating.tracker().tracks().iter().find(|t| t.id() == window.id).unwrap();
            let filter = told.get_mut(&window.id).unwrap();
            let truth = frame.robot.project(simulator.points[window.id as usize].at).unwrap();
            let bounds = filter.window(
                before.and_then(|b: &simulator::Frame| b.robot.project(simulator.points[window.id as usize].at)),
                truth,
            );
            if track.seen() < YOUNG {
                continue;
            }
            let area = |b: &[f64; 4]| (b[2] - b[0]) * (b[3] - b[1]);
            let own = presight_unclipped(window);
            tally.windows += 1;
            tally.held += u64::from(holds(&window.bounds, *at));
            tally.told_held += u64::from(holds(&bounds, *at));
            tally.area += area(&own);
            tally.told_area += area(&bounds);
            let since = frames[..=k].iter().rev().take_while(|f| f.leg == frame.leg).count();
            let e = tally.by_frame.entry((frame.leg, since)).or_default();
            e[0] += f64::from(u8::from(holds(&window.bounds, *at)));
            e[1] += 1.0;
            e[2] += area(&own);
            e[3] += area(&bounds);
        }
        let (found, whose) = simulator.extract(&step.windows, &wanted);
        let matches = alternating.correct(frame.time, &found).unwrap();
        for m in &matches.matched {
            tally.matched += 1;
            tally.wrong += u64::from(whose[m.detection] != Some(m.id));
            if whose[m.detection] == Some(m.id) {
                let p = found[m.detection].shape.centre();
                told.get_mut(&m.id).unwrap().correct(p);
            }
        }
        tally.lost += matches.ended.iter().filter(|e| e.1 == presight::history::End::Lost).count() as u64;
        before = Some(frame);
    }
}

fn presight_unclipped(window: &presight::history::Window) -> [f64; 4] {
    window.bounds
}

const DRIVE: &[Leg] = &[
    leg(5.0, 1.0, 0.0),
    leg(3.0, 1.0, 0.4),
    leg(4.0, 1.0, 0.0),
    leg(3.0, 1.0, -0.3),
    leg(2.0, 0.0, 0.0),
    leg(2.0, 0.0, 0.0),
    leg(4.0, 1.0, 0.0),
];

#[test]
fn explore() {
    for (name, d) in [
        ("all", Disturbance::default()),
        ("no jitter", Disturbance { jitter: 0.0, ..Disturbance::default() }),
        ("jitter 0.5", Disturbance { jitter: 0.5, ..Disturbance::default() }),
        ("clean", Disturbance { jitter: 0.0, misses: 0.0, clutter: 0, ..Disturbance::default() }),
        ("no properties", Disturbance { properties: false, ..Disturbance::default() }),
    ] {
        for memory in std::env::var("MEM").unwrap_or("5".into()).split(',').map(|m| m.parse().unwrap()) {
            let mut tally = Tally::default();
            for seed in 1..5 {
                run(seed, DRIVE, d, TrackerOptions { memory, ..options() }, false, &mut tally);
            }
            tally.print(&format!("{name} {memory}"));
            if name == "all" && std::env::var("V").is_ok() {
                for ((l, f), e) in &tally.by_frame {
                    if *f < 16 || *f % 10 == 0 {
                        println!(
                            "{l} {f}: held {:.3} of {} ratio {:.2} area {:.0}",
                            e[0] / e[1],
                            e[1],
                            e[2] / e[3],
                            e[2] / e[1]
                        );
                    }
                }
            }
        }
    }
    let mut tally = Tally::default();
    for seed in 1..5 {
        run(seed, DRIVE, Disturbance::default(), options(), true, &mut tally);
    }
    tally.print("with view");
}
