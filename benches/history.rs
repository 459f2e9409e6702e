//! Measures a history-based frame: `cargo bench --bench history`. 500 features are predicted, matched among others and
//! corrected on one thread; then the same for edges, and for features that are all in one place.

#![allow(missing_docs, reason = "criterion's macros make items without docs")]

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use glam::{DMat2, DVec2};
use presight_localize::history::{ImageExtent, Seed, Tracker, TrackerOptions};
use presight_localize::matching::{Detection, ExpectedProperties, Shape, UncertainValue};

/// SplitMix64.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn at(&mut self) -> DVec2 {
        DVec2::new(20.0 + 600.0 * self.unit(), 20.0 + 440.0 * self.unit())
    }
}

const FRAME: f64 = 0.05;

/// Returns the shape of feature `i` at a place: an edge or a point, by `is_edge`.
fn shape(at: DVec2, i: usize, is_edge: bool) -> Shape {
    let along = DVec2::from_angle(i as f64) * 30.0;
    if is_edge { Shape::Segment { ends: [at - along, at + along], corners: [false; 2] } } else { Shape::Point(at) }
}

/// Returns a tracker after ten frames, and the detections in the next frame's windows: each feature, and three false
/// ones.
fn scene(count: usize, clutter: usize, is_edge: bool, spread: f64) -> (Tracker, Vec<Detection>) {
    let mut random = Random(7);
    let places: Vec<DVec2> = (0..count).map(|_| DVec2::new(320.0, 240.0).lerp(random.at(), spread)).collect();
    let told: Vec<f64> = (0..count).map(|_| random.unit()).collect();
    let properties = |i: usize| ExpectedProperties {
        contrast: Some(UncertainValue { mean: told[i], variance: 1e-3 }),
        ..ExpectedProperties::default()
    };
    let seed = |(i, at): (usize, &DVec2)| {
        let shape = shape(*at, i, is_edge);
        let covariances = vec![DMat2::IDENTITY; shape.points().len()];
        Seed { id: i as u32, shape, covariances, properties: properties(i) }
    };
    let mut tracker = Tracker::new(TrackerOptions::new(ImageExtent::new(640, 480))).expect("valid options");
    tracker.seed(0.0, places.iter().enumerate().map(seed).collect()).expect("valid seeds");
    let mut frame = |time: f64, clutter: usize| {
        let mut found = Vec::new();
        for (i, at) in places.iter().enumerate() {
            let mut noise = || 0.5 * (random.unit() + random.unit() - 1.0);
            let at = *at + DVec2::new(30.0 * time + noise(), noise());
            let mut put = |at: DVec2, contrast: f64| {
                let mut detection = Detection::new(shape(at, i, is_edge), 0.5);
                detection.properties.contrast = Some(contrast);
                found.push(detection);
            };
            put(at, told[i]);
            for _ in 0..clutter {
                put(at + DVec2::new(4.0 * random.unit() - 2.0, 4.0 * random.unit() - 2.0), random.unit());
            }
        }
        found
    };
    for k in 0..10 {
        let time = FRAME * f64::from(k);
        tracker.correct(time, &frame(time, 0)).expect("times rise");
    }
    (tracker, frame(10.0 * FRAME, clutter))
}

fn frames(c: &mut Criterion) {
    let mut group = c.benchmark_group("history");
    for (name, count, clutter, is_edge, spread) in [
        ("500 points", 500, 0, false, 1.0),
        ("500 points, 1,500 false", 500, 3, false, 1.0),
        ("500 edges", 500, 0, true, 1.0),
        ("500 points within 64 pixels", 500, 0, false, 0.1),
    ] {
        let (tracker, found) = scene(count, clutter, is_edge, spread);
        let matched = tracker.clone().correct(10.0 * FRAME, &found).expect("times rise").matched.len();
        assert!(matched * 10 >= count * 9 || spread < 1.0, "{name}: {matched} of {count}");
        group.bench_function(name, |b| {
            b.iter_batched(
                || tracker.clone(),
                |mut tracker| {
                    let windows = tracker.predict(10.0 * FRAME).expect("times rise");
                    (tracker.correct(10.0 * FRAME, &found).expect("times rise"), windows, tracker)
                },
                BatchSize::SmallInput,
            );
        });
    }
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);
