//! Input from a broken extractor, a jumping clock or an extreme scene.

use super::simulator::Random;
use cpu_time::ThreadTime;
use glam::{DMat2, DVec2};
use presight_localize::history::{End, ImageExtent, Seed, Tracker, TrackerOptions};
use presight_localize::matching::{Detection, ExpectedProperties, MAX_CANDIDATES, Rejection, Shape};
use presight_model::error::ErrorKind;

fn seed(id: u32, at: DVec2) -> Seed {
    Seed { id, shape: Shape::Point(at), covariances: vec![DMat2::IDENTITY], properties: ExpectedProperties::default() }
}

fn tracker(seeds: Vec<Seed>) -> Tracker {
    let mut tracker = Tracker::new(TrackerOptions::new(ImageExtent::new(640, 480))).unwrap();
    tracker.seed(0.0, seeds).unwrap();
    tracker
}

fn grid() -> Vec<Seed> {
    (0..48u32).map(|i| seed(i, DVec2::new(40.0 + f64::from(i % 8) * 80.0, 40.0 + f64::from(i / 8) * 80.0))).collect()
}

fn found(tracker: &Tracker) -> Vec<Detection> {
    tracker.tracks().iter().map(|t| Detection::point(t.shape().centre(), 0.5)).collect()
}

#[test]
fn equal_and_falling_time_stamps_are_errors_and_change_nothing() {
    let mut tracker = tracker(grid());
    tracker.correct(0.0, &found(&tracker)).unwrap();
    tracker.correct(0.1, &found(&tracker)).unwrap();
    let before = tracker.clone();
    for time in [0.1, 0.05, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
        let errors = [tracker.correct(time, &found(&before)).unwrap_err(), tracker.predict(time).unwrap_err()];
        for e in errors {
            assert_eq!(e.kind(), ErrorKind::Invalid);
            assert!(e.to_string().starts_with("the time stamp ") && !e.to_string().contains('\n'), "{e}");
        }
    }
    assert!(tracker.seed(0.05, grid()).is_err());
    assert_eq!(format!("{tracker:?}"), format!("{before:?}"));
    assert_eq!(tracker.correct(0.2, &found(&before)).unwrap().matched.len(), 48);
}

#[test]
fn non_finite_values_are_refused() {
    let mut tracker = tracker(grid());
    for k in 0..10 {
        let mut found = found(&tracker);
        let nan = f64::NAN;
        found.push(Detection::point(DVec2::new(nan, 40.0), 0.5));
        found.push(Detection::point(DVec2::new(40.0, 40.0), nan));
        found.push(Detection::point(DVec2::new(f64::INFINITY, 40.0), 0.5));
        let mut told = Detection::point(DVec2::new(40.0, 40.0), 0.5);
        told.properties.contrast = Some(nan);
        found.push(told);
        let matches = tracker.correct(0.05 * f64::from(k), &found).unwrap();
        assert_eq!(matches.matched.len(), 48);
        assert_eq!(matches.rejected.len(), 4);
        assert!(matches.rejected.iter().all(|(i, why)| *i >= 48 && *why == Rejection::NotFinite));
    }
    for track in tracker.tracks() {
        assert!(track.shape().centre().is_finite() && track.covariances().all(|c| c.is_finite()));
    }
    let bad = vec![
        seed(100, DVec2::new(f64::NAN, 0.0)),
        Seed { covariances: vec![DMat2::from_diagonal(DVec2::new(-1.0, 1.0))], ..seed(101, DVec2::ONE) },
        Seed { covariances: Vec::new(), ..seed(102, DVec2::ONE) },
    ];
    for (seed, why) in bad.into_iter().zip([
        "100 cannot be followed: NotFinite",
        "101 cannot be followed: Covariance",
        "102 cannot be followed: Degenerate",
    ]) {
        let e = tracker.seed(0.5, vec![seed]).unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && e.to_string().contains(why), "{e}");
    }
    assert_eq!(tracker.tracks().len(), 48, "a refused seed changes nothing");
    assert!(tracker.seed(0.6, vec![seed(1, DVec2::ONE), seed(1, DVec2::ONE)]).is_err(), "one number twice");
}

/// A sigma of 0 claims more accuracy than any extractor has; the track must still follow.
#[test]
fn a_detection_without_noise_does_not_freeze_a_track() {
    let mut tracker = tracker(vec![seed(1, DVec2::new(100.0, 100.0))]);
    for k in 0..60 {
        let time = 0.05 * f64::from(k);
        let at = DVec2::new(100.0 + 40.0 * time, 100.0);
        let matches = tracker.correct(time, &[Detection::point(at, 0.0)]).unwrap();
        assert_eq!(matches.matched.len(), 1, "{k}");
    }
    let off = tracker.tracks()[0].shape().centre() - DVec2::new(100.0 + 40.0 * 0.05 * 59.0, 100.0);
    assert!(off.length() < 0.1, "{off}");
}

#[test]
fn thousands_of_detections_in_one_window_are_answered_in_time() {
    let mut tracker = tracker(grid());
    let mut random = Random(9);
    let start = ThreadTime::now();
    for k in 0..5 {
        let mut found = found(&tracker);
        let [x0, y0, x1, y1] = tracker.predict(0.05 * f64::from(k)).unwrap()[20].bounds;
        found.extend(
            (0..5000).map(|_| Detection::point(DVec2::new(random.between(x0, x1), random.between(y0, y1)), 0.5)),
        );
        let matches = tracker.correct(0.05 * f64::from(k), &found).unwrap();
        assert!(matches.matched.len() >= 47);
        assert_eq!(matches.matched.len() + matches.unmatched.len(), found.len());
    }
    assert!(start.elapsed().as_secs_f64() < 5.0, "{:?}", start.elapsed());
}

#[test]
fn thousands_of_features_in_one_place_are_answered_in_time() {
    let place = DVec2::new(300.0, 200.0);
    let mut tracker = tracker((0..2000).map(|i| seed(i, place)).collect());
    let mut random = Random(4);
    let start = ThreadTime::now();
    for k in 0..2 {
        let found: Vec<Detection> = (0..2000).map(|_| Detection::point(place + random.normal(), 0.5)).collect();
        let matches = tracker.correct(0.05 * f64::from(k), &found).unwrap();
        // All features have the same candidates at first.
        assert!(matches.matched.len() >= MAX_CANDIDATES, "{k}: {}", matches.matched.len());
    }
    assert!(start.elapsed().as_secs_f64() < 20.0, "{:?}", start.elapsed());
}

/// Three misses in a row drop a track; a detection between them resets the count. Dissimilar clutter keeps no track
/// alive.
#[test]
fn three_misses_in_a_row_drop() {
    let mut tracker = tracker(grid());
    tracker.correct(0.0, &found(&tracker)).unwrap();
    for k in 1..=3 {
        let mut seen = found(&tracker);
        seen.retain(|d| d.shape.centre().x > 100.0);
        let matches = tracker.correct(0.05 * f64::from(k), &seen).unwrap();
        let lost = matches.ended.iter().filter(|e| e.1 == End::Lost).count();
        assert_eq!((matches.missed.len(), lost), (6, if k == 3 { 6 } else { 0 }));
    }
    assert_eq!(tracker.tracks().len(), 42);
}

#[test]
fn features_leave_at_the_border() {
    let mut tracker = tracker(vec![seed(1, DVec2::new(600.0, 200.0)), seed(2, DVec2::new(100.0, 200.0))]);
    let mut left = None;
    for k in 0..40 {
        let time = 0.05 * f64::from(k);
        let shift = DVec2::new(60.0 * time, 0.0);
        let found: Vec<Detection> = [600.0, 100.0]
            .map(|x| DVec2::new(x, 200.0) + shift)
            .into_iter()
            .filter(|p| p.x < 639.5)
            .map(|p| Detection::point(p, 0.3))
            .collect();
        let matches = tracker.correct(time, &found).unwrap();
        assert!(matches.ended.iter().all(|e| *e == (1, End::Left)), "{:?}", matches.ended);
        left = left.or((!matches.ended.is_empty()).then_some(k));
    }
    // 39.5 pixels at 3 pixels a frame.
    assert!(left.is_some_and(|k| (13..=15).contains(&k)), "{left:?}");
    assert_eq!(tracker.tracks().len(), 1);
}

/// A sensor with a full circle: a feature that crosses the seam stays one track.
#[test]
fn the_seam_is_no_border() {
    let image = ImageExtent { width: 720, height: 16, turn: Some(720.0) };
    let mut tracker = Tracker::new(TrackerOptions::new(image)).unwrap();
    tracker.seed(0.0, vec![seed(1, DVec2::new(700.0, 8.0))]).unwrap();
    for k in 0..40 {
        let time = 0.05 * f64::from(k);
        let column = (700.0 + 40.0 * time + 0.5) % 720.0 - 0.5;
        let window = tracker.predict(time).unwrap()[0].bounds;
        assert!(window[0] >= -0.5 && window[0] < 719.5);
        let inside = |x: f64| x >= window[0] && x <= window[2];
        assert!(inside(column) || inside(column + 720.0), "{k}: {column} {window:?}");
        let matches = tracker.correct(time, &[Detection::point(DVec2::new(column, 8.0), 0.5)]).unwrap();
        assert_eq!(matches.matched.len(), 1, "{k}");
    }
}
