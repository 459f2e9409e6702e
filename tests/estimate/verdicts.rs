//! Verdicts on changed rooms.

use super::*;
use presight_localize::verdict::{ExpectedImage, Surfaces, Verdict, Verdicts, of_frame};
use presight_model::geometry::{PoseEstimate, RobotPose};

const POSE_SIGMA: f64 = 1e-3;

/// Verdicts on an image of one room against the model of another.
fn verdicts(real: &World, noise: f64) -> (Verdicts, ExpectedImage) {
    let sensor = camera(0.005);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.9, 1.8, 1.4), 0.0, 0.3, -0.2);
    let frame = sense(real, &sensor, &pose, &mut Random(7));
    let model = room(Vec3::ZERO);
    let expected =
        ExpectedImage::predict(&mut predictor(), &model, &mut Surfaces::default(), &sensor, &RobotPose::new(pose))
            .unwrap();
    let stated = Frame::new(0.0, camera(noise), frame.measurement().clone()).unwrap();
    let known = PoseEstimate::of_sigmas(RobotPose::new(pose), POSE_SIGMA, POSE_SIGMA);
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

/// The furniture is 5 cm nearer: a tight threshold notices that and reports nothing else as changed; a loose one misses
/// it.
#[test]
fn small_changes_are_noticed() {
    let moved = room(Vec3::new(-0.05, 0.0, 0.0));
    let (tight, expected) = verdicts(&moved, 0.005);
    let changed = |v: &Verdicts| v.pixels.iter().filter(|v| **v == Verdict::Nearer).count();
    assert!(changed(&tight) > 30, "{:?}", tight.counts());
    // The room itself, object 0, has not moved.
    let false_ones = tight.pixels.iter().zip(expected.pixels());
    let false_ones =
        false_ones.filter(|(v, e)| e.object == 0 && matches!(v, Verdict::Nearer | Verdict::Farther)).count();
    assert!(false_ones < 60, "{false_ones}: shadows and edges of what moved are at most that");
    let (loose, _) = verdicts(&moved, 0.05);
    assert!(changed(&loose) < changed(&tight) / 4, "{} {}", changed(&loose), changed(&tight));
}

#[test]
fn beams_pass_through_missing_objects() {
    // Only the walls are left.
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
fn values_without_a_range_have_their_verdicts() {
    let sensor = camera(0.005);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.9, 1.8, 1.4), 0.0, 0.3, -0.2);
    let (world, known) = (room(Vec3::ZERO), PoseEstimate::exact(RobotPose::new(pose)));
    for (value, verdict) in
        [(f32::NAN, Verdict::NoReturn), (f32::INFINITY, Verdict::Farther), (f32::NEG_INFINITY, Verdict::Nearer)]
    {
        let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(vec![value; 4800])).unwrap();
        let verdicts = of_frame(&mut predictor(), &world, &frame, &known).unwrap();
        assert_eq!(verdicts.share(verdict), 1.0, "{value}: {:?}", verdicts.counts());
    }
}

/// A scanner mounted at (0.4, 0, 0.5) on a robot at (1, 2, 0) in an empty box of 20 m x 20 m. By hand: a beam at azimuth a
/// ends at (10 - 1.4) / cos a on the wall ahead, or at (10 - 2) / sin a and (10 + 2) / -sin a on the walls beside.
#[test]
fn the_mount_leads_from_the_robot_to_the_sensor() {
    let mut environment = Environment::new();
    environment.add_cuboid("hall", Pose::IDENTITY, DVec3::new(20.0, 20.0, 4.0)).unwrap();
    let world = World::new(environment);
    let mut spec = presight_read::preset("laser-scanner").unwrap().spec().clone();
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.4, 0.0, 0.5), 0.0, 0.0, 0.0);
    let scanner = Sensor::new(spec).unwrap();
    let azimuth = |i: usize| (0.5 * i as f64 - 90.0).to_radians();
    let range = |x: f64, i: usize| {
        let (s, c) = azimuth(i).sin_cos();
        let beside = if s >= 0.0 { 8.0 / s } else { 12.0 / -s };
        ((10.0 - x) / c.max(1e-12)).min(beside)
    };
    let measured = (0..361).map(|i| range(1.4, i) as f32).collect();
    let frame = Frame::new(0.0, scanner.clone(), Measurement::Range(measured)).unwrap();
    let judged = |x: f64, y: f64| {
        let robot = PoseEstimate::exact(RobotPose::from_xyz_rpy(DVec3::new(x, y, 0.0), 0.0, 0.0, 0.0));
        of_frame(&mut predictor(), &world, &frame, &robot).unwrap()
    };
    let right = judged(1.0, 2.0);
    let other: Vec<_> = right.pixels.iter().enumerate().filter(|(_, v)| **v != Verdict::Confirmed).collect();
    assert!(other.is_empty(), "{other:?}");
    // A robot believed half a metre too far ahead: the wall ahead is measured farther than predicted, those beside are
    // confirmed. Two beams on either side of a corner may be either.
    let ahead = judged(1.5, 2.0);
    for i in 0..361usize {
        let sure = |x: f64| {
            let on_wall = |j: usize| (range(x, j) * azimuth(j).cos() - (10.0 - x)).abs() < 1e-9;
            let near: Vec<bool> = (i.saturating_sub(2)..(i + 3).min(361)).map(on_wall).collect();
            near.iter().all(|wall| *wall == near[0]).then_some(near[0])
        };
        match (sure(1.4), sure(1.9)) {
            (Some(true), Some(true)) => assert_eq!(ahead.pixels[i], Verdict::Farther, "{i}"),
            (Some(false), Some(false)) => assert_eq!(ahead.pixels[i], Verdict::Confirmed, "{i}"),
            _ => {}
        }
        let off = f64::from(ahead.difference[i]) - (range(1.4, i) - range(1.9, i));
        assert!(off.abs() < 1e-4, "{i}: {off}");
    }
    // Half a metre too far back, it is nearer.
    assert_eq!(judged(0.5, 2.0).pixels[180], Verdict::Nearer);
}
