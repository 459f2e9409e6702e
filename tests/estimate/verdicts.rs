//! Verdicts on changed rooms.

use super::*;
use presight_localize::verdict::{ExpectedImage, Surfaces, Verdict, Verdicts, of_frame};
use presight_model::geometry::PoseEstimate;

const POSE_SIGMA: f64 = 1e-3;

/// Verdicts on what a real room shows, against the model of another.
fn verdicts(real: &World, noise: f64) -> (Verdicts, ExpectedImage) {
    let sensor = camera(0.005);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.9, 1.8, 1.4), 0.0, 0.3, -0.2);
    let frame = sense(real, &sensor, &pose, &mut Random(7));
    let model = room(Vec3::ZERO);
    let expected = ExpectedImage::predict(&mut predictor(), &model, &mut Surfaces::default(), &sensor, &pose).unwrap();
    let stated = Frame::new(0.0, camera(noise), frame.sensed().clone()).unwrap();
    let known = PoseEstimate::of_sigmas(pose, POSE_SIGMA, POSE_SIGMA);
    (of_frame(&mut predictor(), &model, &stated, &known).unwrap(), expected)
}

#[test]
fn an_unchanged_room_is_confirmed() {
    let (verdicts, _) = verdicts(&room(Vec3::ZERO), 0.005);
    let share = |v| verdicts.share(v);
    assert!(share(Verdict::Confirmed) > 0.85, "{:?}", verdicts.counts());
    assert!(share(Verdict::Nearer) + share(Verdict::Farther) < 0.002, "{:?}", verdicts.counts());
    assert_eq!(verdicts.counts().iter().sum::<usize>(), 80 * 60);
}

/// The furniture stands 5 cm nearer: a tight threshold sees it, and calls nothing else changed; a loose one misses it.
#[test]
fn small_changes_show() {
    let moved = room(Vec3::new(-0.05, 0.0, 0.0));
    let (tight, expected) = verdicts(&moved, 0.005);
    let changed = |v: &Verdicts| v.pixels.iter().filter(|v| **v == Verdict::Nearer).count();
    assert!(changed(&tight) > 30, "{:?}", tight.counts());
    // The room itself stands where it stood: object 0.
    let false_ones = tight.pixels.iter().zip(expected.pixels());
    let false_ones =
        false_ones.filter(|(v, e)| e.object == 0 && matches!(v, Verdict::Nearer | Verdict::Farther)).count();
    assert!(false_ones < 60, "{false_ones}: shadows and edges of what moved are at most that");
    let (loose, _) = verdicts(&moved, 0.05);
    assert!(changed(&loose) < changed(&tight) / 4, "{} {}", changed(&loose), changed(&tight));
}

#[test]
fn what_is_missing_is_passed_through() {
    // Everything but the walls is gone.
    let mut empty = Environment::new();
    empty.add_material(Material::named("m")).unwrap();
    add_box(&mut empty, "room", Vec3::ZERO, Vec3::new(6.0, 4.0, 2.6));
    let (verdicts, expected) = verdicts(&World::new(empty), 0.005);
    let (mut missing, mut all) = (0, 0);
    for (verdict, pixel) in verdicts.pixels.iter().zip(expected.pixels()).filter(|(_, p)| p.object > 0) {
        all += 1;
        missing += usize::from(*verdict == Verdict::Farther);
        assert_ne!(*verdict, Verdict::Nearer, "{pixel:?}");
    }
    assert!(all > 300 && missing * 10 > all * 6, "{missing} of {all}");
}

#[test]
fn values_that_are_no_ranges_have_their_verdicts() {
    let sensor = camera(0.005);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.9, 1.8, 1.4), 0.0, 0.3, -0.2);
    let (world, known) = (room(Vec3::ZERO), PoseEstimate::exact(pose));
    for (value, verdict) in
        [(f32::NAN, Verdict::NoReturn), (f32::INFINITY, Verdict::Farther), (f32::NEG_INFINITY, Verdict::Nearer)]
    {
        let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(vec![value; 4800])).unwrap();
        let verdicts = of_frame(&mut predictor(), &world, &frame, &known).unwrap();
        assert_eq!(verdicts.share(verdict), 1.0, "{value}: {:?}", verdicts.counts());
    }
}
