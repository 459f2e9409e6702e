//! Points in the image of a robot that drives straight, turns, stops and starts.

use super::simulator::{ACCELERATIONS, Disturbance, FOCAL, Leg, Simulator, holds, leg};
use super::{FEWEST, options};
use presight_localize::history::Tracker;
use std::collections::BTreeMap;

/// A long straight, a curve, a straight, a curve the other way, a stop, a pause, and a restart.
const DRIVE: [Leg; 7] = [
    leg(5.0, 1.0, 0.0),
    leg(3.0, 1.0, 0.4),
    leg(4.0, 1.0, 0.0),
    leg(3.0, 1.0, -0.3),
    leg(2.0, 0.0, 0.0),
    leg(2.0, 0.0, 0.0),
    leg(4.0, 1.0, 0.0),
];

/// Younger tracks have only a guessed speed and therefore a large window.
const YOUNG: u32 = 5;

#[derive(Clone, Debug, Default)]
struct Tally {
    matched: f64,
    wrong: f64,
    frames: f64,
    /// Frames without a full prediction.
    history: f64,
    /// Windows of older tracks, how many held their feature, and the sum of their areas.
    windows: f64,
    held: f64,
    area: f64,
    /// The same where a curve begins.
    curve: f64,
    curve_held: f64,
}

impl Tally {
    fn print(&self, name: &str) {
        println!(
            "{name}: wrong {:.2} % of {}, coverage {:.2} % of {} windows of {:.0} pixels on average, where a curve begins \
             {:.2} % of {}, history {:.1} % of {} frames",
            100.0 * self.wrong / self.matched,
            self.matched,
            100.0 * self.held / self.windows,
            self.windows,
            self.area / self.windows,
            100.0 * self.curve_held / self.curve,
            self.curve,
            100.0 * self.history / self.frames,
            self.frames,
        );
    }
}

fn drive(disturbance: Disturbance) -> Tally {
    let mut tally = Tally::default();
    (1..=6).for_each(|seed| drive_once(seed, disturbance, &mut tally));
    tally
}

fn drive_once(seed: u64, disturbance: Disturbance, tally: &mut Tally) {
    let mut simulator = Simulator::new(seed, disturbance);
    let frames = simulator.drive(&DRIVE);
    // The robot's turn accelerates by 1.5 rad/s^2, which moves all points of the image.
    let acceleration = FOCAL * ACCELERATIONS[1];
    let mut tracker = Tracker::new(options().with_acceleration_sigma(acceleration)).unwrap();
    let (mut leg, mut in_leg) = (0, 0);
    for frame in &frames {
        (leg, in_leg) = if frame.leg == leg { (leg, in_leg + 1) } else { (frame.leg, 0) };
        tally.frames += 1.0;
        if tracker.tracks().len() < FEWEST {
            tracker.seed(frame.time, simulator.predict_fully(frame, 150)).unwrap();
        } else {
            tally.history += 1.0;
        }
        let windows = tracker.predict(frame.time).unwrap();
        let wanted: Vec<_> = windows.iter().map(|w| simulator.detected_at(frame, w.id)).collect();
        let is_old: BTreeMap<u32, bool> = tracker.tracks().iter().map(|t| (t.id(), t.seen() >= YOUNG)).collect();
        for (window, at) in windows.iter().zip(&wanted) {
            let Some(at) = at.filter(|_| is_old[&window.id]) else { continue };
            let is_held = f64::from(u8::from(holds(&window.bounds, at)));
            let [x0, y0, x1, y1] = window.bounds;
            (tally.windows, tally.held) = (tally.windows + 1.0, tally.held + is_held);
            tally.area += (x1 - x0) * (y1 - y0);
            if leg == 1 && in_leg < 5 {
                (tally.curve, tally.curve_held) = (tally.curve + 1.0, tally.curve_held + is_held);
            }
        }
        let (found, whose) = simulator.extract(&windows, &wanted);
        for m in &tracker.correct(frame.time, &found).unwrap().matched {
            tally.matched += 1.0;
            tally.wrong += f64::from(u8::from(whose[m.detection] != Some(m.id)));
        }
    }
}

#[test]
fn a_drive_with_misses_clutter_and_shaking() {
    let tally = drive(Disturbance { clutter: 1, ..Disturbance::default() });
    tally.print("drive");
    assert!(tally.wrong < 0.01 * tally.matched, "{tally:?}");
    assert!(tally.held >= 0.98 * tally.windows, "{tally:?}");
    assert!(tally.curve_held >= 0.98 * tally.curve, "{tally:?}");
    assert!(tally.history >= 0.8 * tally.frames, "{tally:?}");
}

/// Other disturbances are printed without a bound.
#[test]
fn other_disturbances_are_reported() {
    let usual = Disturbance::default();
    for (name, disturbance) in [
        ("nothing disturbs", Disturbance { jitter: 0.0, misses: 0.0, clutter: 0, ..usual }),
        ("shaking by half a pixel", Disturbance { jitter: 0.5, ..usual }),
        ("no properties", Disturbance { properties: false, ..usual }),
    ] {
        drive(disturbance).print(name);
    }
}
