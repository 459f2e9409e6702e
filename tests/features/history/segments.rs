//! Edges whose ends slide, in the image of a robot that drives and turns.

use super::FEWEST;
use super::simulator::{Disturbance, Edges, Random, Simulator, TOLD, leg};
use glam::{DMat2, DVec2};
use presight_localize::history::{Seed, Tracker};
use presight_localize::matching::{Detection, ExpectedProperties, Shape, UncertainValue};
use std::f64::consts::PI;

const SIGMA: f64 = 0.5;

/// Decides whether a window contains the required parts of an edge at `ends`: the middle, and corners.
fn held(window: &[f64; 4], ends: &[DVec2; 2], corners: &[bool; 2], noise: DVec2) -> bool {
    let inside = |p: DVec2| super::simulator::holds(window, p + noise);
    let ends_inside = (0..2).all(|k| !corners[k] || inside(ends[k]));
    inside(0.5 * (ends[0] + ends[1])) && ends_inside
}

fn told(edges: &Edges, id: u32) -> ExpectedProperties {
    let [strength, contrast] =
        [0, 1].map(|k| Some(UncertainValue { mean: edges.told[id as usize][k], variance: TOLD[k] * TOLD[k] }));
    ExpectedProperties { strength, contrast, ..ExpectedProperties::default() }
}

/// Edges break anywhere, a fifth is missed, and three false ones cross each window.
#[test]
fn edges_are_tracked_across_their_direction() {
    let (mut matched, mut wrong, mut windows, mut inside) = (0.0, 0.0, 0.0, 0.0);
    for round in 1..=3 {
        let mut random = Random(round * 77);
        let edges = Edges::new(&mut random, 1500);
        let mut simulator = Simulator::new(round, Disturbance::default());
        let frames = simulator.drive(&[leg(4.0, 0.6, 0.0), leg(3.0, 0.6, 0.25), leg(2.0, 0.6, 0.0)]);
        let mut tracker = Tracker::new(super::options()).unwrap();
        for frame in &frames {
            if tracker.tracks().len() < FEWEST {
                let seed = |id: u32| {
                    Some(Seed {
                        id,
                        shape: Shape::Segment {
                            ends: edges.see(&frame.robot, id)?,
                            corners: edges.corners[id as usize],
                        },
                        covariances: vec![DMat2::IDENTITY; 2],
                        properties: told(&edges, id),
                    })
                };
                tracker.seed(frame.time, (0..1500).filter_map(seed).take(120).collect()).unwrap();
            }
            let predicted = tracker.predict(frame.time).unwrap();
            let (mut found, mut whose) = (Vec::new(), Vec::new());
            for window in &predicted {
                let Some(ends) = edges.see(&frame.robot, window.id) else { continue };
                let old = tracker.tracks().iter().any(|t| t.id() == window.id && t.seen() >= 5);
                if old {
                    windows += 1.0;
                    let noise = random.normal() * SIGMA;
                    inside +=
                        f64::from(u8::from(held(&window.bounds, &ends, &edges.corners[window.id as usize], noise)));
                }
                if random.unit() >= 0.2 {
                    found.push(edges.detect(&mut random, ends, window.id, SIGMA));
                    whose.push(Some(window.id));
                }
                for _ in 0..3 {
                    let [x0, y0, x1, y1] = window.bounds;
                    let at = DVec2::new(random.between(x0, x1), random.between(y0, y1));
                    let half = DVec2::from_angle(random.between(0.0, PI)) * random.between(5.0, 30.0);
                    let mut detection = Detection::segment([at - half, at + half], SIGMA);
                    detection.properties.strength = Some(random.unit());
                    detection.properties.contrast = Some(random.unit());
                    found.push(detection);
                    whose.push(None);
                }
            }
            for m in tracker.correct(frame.time, &found).unwrap().matched {
                matched += 1.0;
                wrong += f64::from(u8::from(whose[m.detection] != Some(m.id)));
            }
        }
    }
    println!(
        "edges: wrong {:.2} % of {matched}, coverage {:.2} % of {windows} windows",
        100.0 * wrong / matched,
        100.0 * inside / windows
    );
    assert!(matched > 5_000.0);
    assert!(wrong < 0.01 * matched, "{wrong} of {matched}");
    assert!(inside > 0.98 * windows, "{inside} of {windows}");
}
