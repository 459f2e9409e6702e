//! Verdicts on changed rooms.

use super::*;
use presight_localize::verdict::{ExpectedImage, Surfaces, Uncertainty, Verdict, Verdicts, judge};
use presight_model::measured::RangeNoise;

const POSE_SIGMA: f64 = 1e-3;

/// Verdicts on an image of one room against the model of another.
fn verdicts(real: &World, noise: f64, polygons: f64) -> (Verdicts, ExpectedImage) {
    let sensor = camera(0.005);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.9, 1.8, 1.4), 0.0, 0.3, -0.2);
    let frame = sense(real, &sensor, &pose, &mut Random(7));
    let model = room(Vec3::ZERO);
    let expected = ExpectedImage::predict(&mut predictor(), &model, &mut Surfaces::default(), &sensor, &pose).unwrap();
    let covariance = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { POSE_SIGMA.powi(2) } else { 0.0 }));
    let noise = RangeNoise { sigma: noise, ..RangeNoise::of(&sensor) };
    let known = Uncertainty { noise, pose: covariance, polygons };
    (judge(&frame, &expected, &pose, &known).unwrap(), expected)
}

#[test]
fn an_unchanged_room_is_confirmed() {
    let (verdicts, _) = verdicts(&room(Vec3::ZERO), 0.005, 0.0);
    let share = |v| verdicts.share(v);
    assert!(share(Verdict::Confirmed) > 0.85, "{:?}", verdicts.counts());
    assert!(share(Verdict::Nearer) + share(Verdict::Farther) < 0.002, "{:?}", verdicts.counts());
    assert_eq!(verdicts.counts().iter().sum::<usize>(), 80 * 60);
}

/// The furniture is 5 cm nearer: a tight threshold notices that and reports nothing else as changed; a loose one misses
/// it.
#[test]
fn small_changes_are_noticed() {
    let moved = room(Vec3::new(-0.05, 0.0, 0.0));
    let (tight, expected) = verdicts(&moved, 0.005, 0.0);
    let changed = |v: &Verdicts| v.pixels.iter().filter(|v| **v == Verdict::Nearer).count();
    assert!(changed(&tight) > 30, "{:?}", tight.counts());
    // The room itself, object 0, has not moved.
    let false_ones = tight.pixels.iter().zip(expected.pixels());
    let false_ones =
        false_ones.filter(|(v, e)| e.object == 0 && matches!(v, Verdict::Nearer | Verdict::Farther)).count();
    assert!(false_ones < 60, "{false_ones}: shadows and edges of what moved are at most that");
    let (loose, _) = verdicts(&moved, 0.05, 0.0);
    assert!(changed(&loose) < changed(&tight) / 4, "{} {}", changed(&loose), changed(&tight));
}

#[test]
fn beams_pass_through_missing_objects() {
    // Only the walls are left.
    let mut empty = Environment::new();
    empty.add_material(Material::named("m")).unwrap();
    add_box(&mut empty, "room", Vec3::ZERO, Vec3::new(6.0, 4.0, 2.6));
    let (verdicts, expected) = verdicts(&World::new(empty), 0.005, 0.0);
    let (mut missing, mut all) = (0, 0);
    for (verdict, pixel) in verdicts.pixels.iter().zip(expected.pixels()).filter(|(_, p)| p.object > 0) {
        all += 1;
        missing += usize::from(*verdict == Verdict::Farther);
        assert_ne!(*verdict, Verdict::Nearer, "{pixel:?}");
    }
    assert!(all > 300 && missing * 10 > all * 6, "{missing} of {all}");
}

#[test]
fn values_without_a_range_have_their_verdicts() {
    let sensor = camera(0.005);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.9, 1.8, 1.4), 0.0, 0.3, -0.2);
    let expected =
        ExpectedImage::predict(&mut predictor(), &room(Vec3::ZERO), &mut Surfaces::default(), &sensor, &pose).unwrap();
    let known = Uncertainty { noise: RangeNoise::of(&sensor), pose: [[0.0; 6]; 6], polygons: 0.0 };
    for (value, verdict) in
        [(f32::NAN, Verdict::NoReturn), (f32::INFINITY, Verdict::Farther), (f32::NEG_INFINITY, Verdict::Nearer)]
    {
        let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(vec![value; 4800])).unwrap();
        let verdicts = judge(&frame, &expected, &pose, &known).unwrap();
        assert_eq!(verdicts.share(verdict), 1.0, "{value}: {:?}", verdicts.counts());
    }
    let small = Frame::new(0.0, sensor.clone(), Measurement::Range(vec![1.0; 4800])).unwrap().thinned(2).unwrap();
    assert!(judge(&small, &expected, &pose, &known).is_err());
}
