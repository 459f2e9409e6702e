//! Depth edges and reflectors in ranges of known shapes.

use super::*;
use glam::{DVec2, DVec3};
use presight_model::measured::{Frame, GreyImage, Measurement};
use presight_model::random::SplitMix64;
use presight_model::sensor::{Angles, Camera, Geometry, Scanner, Sensor, SensorSpec};

const NOISE: f64 = 0.01;

fn sensor(geometry: Geometry) -> Sensor {
    let mut spec = SensorSpec::new("s", "laser", geometry);
    spec.noise.range_sigma = NOISE;
    Sensor::new(spec).unwrap()
}

/// A full turn of 360 beams; column 0 looks back.
fn scanner() -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 1.0, count: 360 };
    sensor(Geometry::Scanner(Scanner { azimuth, elevation: Angles::Listed(vec![0.0]), beam_height_deg: None }))
}

fn camera() -> Sensor {
    sensor(Geometry::Camera(Camera::pinhole(80, 60, 70.0, 70.0, 39.5, 29.5)))
}

/// Ranges within convex walls (outward normal and distance), with noise.
fn inside(sensor: &Sensor, walls: &[(DVec3, f64)], random: &mut SplitMix64) -> Frame {
    let (w, h) = (sensor.width(), sensor.height());
    let range = |i: u32| {
        let ray = sensor.ray(i % w, i / w).unwrap();
        walls.iter().map(|(n, d)| d / n.dot(ray)).filter(|z| *z > 0.0).fold(f64::INFINITY, f64::min)
    };
    let noisy = (0..w * h).map(|i| (range(i) + random.normal(NOISE)) as f32).collect();
    Frame::new(0.0, sensor.clone(), Measurement::Range(noisy)).unwrap()
}

/// A slanted pillar before a wall is found to a fraction of a pixel; slopes, noise and edges without a jump are not.
#[test]
fn depth_edges_are_found_between_pixels() {
    let (camera, mut random) = (camera(), SplitMix64(3));
    for k in 0..30u32 {
        let angle = 0.2 * f64::from(k);
        let on = DVec2::new(39.0 + 0.21 * f64::from(k % 5), 30.0 - 0.13 * f64::from(k % 7));
        let right = DVec2::from_angle(angle).perp();
        let depth = (0..80 * 60).map(|i| {
            let at = DVec2::new(f64::from(i % 80), f64::from(i / 80));
            let z = if right.dot(at - on) > 0.0 { 2.0 } else { 2.6 + 0.004 * at.x };
            (z + random.normal(NOISE)) as f32
        });
        let frame = Frame::new(0.0, camera.clone(), Measurement::DepthZ(depth.collect())).unwrap();
        let along = DVec2::from_angle(angle + 0.04);
        let aside = on + (f64::from(k % 7) - 3.0) * right;
        let expected =
            ExpectedEdge { ends: [aside - 18.0 * along, aside + 18.0 * along], reach: 6.0, is_right_brighter: None };
        let found = jumps_near(&frame, &expected, &JumpOptions::default());
        assert_eq!(found.len(), 1, "{k}: {found:?}");
        let off = found[0].detection.shape.points().iter().map(|p| right.dot(*p - on).abs()).fold(0.0, f64::max);
        assert!(off < 0.8 && off < 3.3 * found[0].detection.covariance.x_axis.x.sqrt(), "{k}: {off} pixels");
        assert!((-0.95..-0.45).contains(&found[0].contrast), "{}", found[0].contrast);
        let elsewhere = ExpectedEdge { ends: expected.ends.map(|e| e + 14.0 * right), ..expected };
        assert!(jumps_near(&frame, &elsewhere, &JumpOptions::default()).is_empty());
    }
    // A floor at a flat angle has steps of its own, but no edge.
    let floor = inside(&camera, &[(DVec3::Y, 1.0), (DVec3::Z, 40.0)], &mut random);
    let across =
        ExpectedEdge { ends: [DVec2::new(5.0, 40.0), DVec2::new(75.0, 40.0)], reach: 6.0, is_right_brighter: None };
    assert!(jumps_near(&floor, &across, &JumpOptions::default()).is_empty());
    for odd in [f64::NAN, -1.0] {
        assert!(jumps_near(&floor, &ExpectedEdge { reach: odd, ..across }, &JumpOptions::default()).is_empty());
    }
    let blind = Frame::new(0.0, camera, Measurement::DepthZ(vec![f32::NAN; 4800])).unwrap();
    assert!(jumps_near(&blind, &across, &JumpOptions::default()).is_empty());
}

#[test]
fn reflectors_are_small_and_bright() {
    let scanner = scanner();
    let whole = PixelBox::whole_of(&scanner);
    let frame = |far: usize| {
        let ranges = (0..360).map(|i| if i == far { 5.0 } else { 3.0 }).collect();
        Frame::new(0.0, scanner.clone(), Measurement::Range(ranges)).unwrap()
    };
    let bright = |columns: &[usize]| {
        GreyImage::new(360, 1, (0..360).map(|i| if columns.contains(&i) { 0.95 } else { 0.4 }).collect()).unwrap()
    };
    let options = ReflectorOptions::default();
    let find = |f: &Frame, columns: &[usize], region: PixelBox| {
        let found = reflectors_in(f, &bright(columns), region, &options).unwrap();
        found.iter().map(|r| (r.detection.shape.centre().x, r.range.mean)).collect::<Vec<_>>()
    };
    assert_eq!(find(&frame(400), &[10, 11, 12, 50], whole), [(11.0, 3.0), (50.0, 3.0)]);
    // Two reflectors, one behind the other, are both found; in a box only those inside it.
    assert_eq!(find(&frame(11), &[10, 11], whole), [(10.0, 3.0), (11.0, 5.0)]);
    assert_eq!(find(&frame(400), &[10, 50], PixelBox([40.0, -0.5, 60.0, 0.5])), [(50.0, 3.0)]);
    // Spots as wide as a wall, or without measurements, are rejected. Nine beams of 1 degree at 3 m are 0.47 m.
    assert!(find(&frame(400), &[1, 2, 3, 4, 5, 6, 7, 8, 9], whole).is_empty());
    let all: Vec<usize> = (0..360).collect();
    assert!(find(&frame(400), &all, whole).is_empty(), "a blinded receiver");
    let nothing = Frame::new(0.0, scanner.clone(), Measurement::Range(vec![f32::INFINITY; 360])).unwrap();
    assert!(find(&nothing, &[10], whole).is_empty());
    // Each end of three beams is uniform within a beam's pitch: the middle has an error of 1 / sqrt(24) of a column.
    // With 1 cm of range noise, the slope's error is 1 / sqrt(2) cm per column. It moves the middle by 1.5^2 / 3 m
    // times that.
    let one = reflectors_in(&frame(400), &bright(&[10, 11, 12]), whole, &options).unwrap().remove(0);
    assert!((one.detection.covariance.x_axis.x - (1.0 / 24.0 + 0.0075f64.powi(2) / 2.0)).abs() < 1e-12);
    // The error of a median of three is sqrt(pi / 2) times that of a mean.
    assert!((one.range.variance - std::f64::consts::FRAC_PI_2 * NOISE * NOISE / 3.0).abs() < 1e-12);
    let other = GreyImage::new(359, 1, vec![1.0; 359]).unwrap();
    assert_eq!(
        reflectors_in(&frame(400), &other, whole, &options).unwrap_err().kind(),
        presight_model::ErrorKind::Invalid
    );
    assert!(
        reflectors_in(&frame(400), &GreyImage::new(360, 1, vec![f32::NAN; 360]).unwrap(), whole, &options)
            .unwrap()
            .is_empty()
    );
}

/// A region with a part of a bright spot finds the whole spot: a narrow region does not make a reflector of a wall that
/// blinds the receiver. A reflector on the seam is found once, and so is one with a beam without a reading. If the
/// reading at its end is missing, its end is uncertain.
#[test]
fn reflectors_are_found_as_a_whole() {
    let scanner = scanner();
    let options = ReflectorOptions::default();
    let find = |lost: &[usize], columns: &[usize], region: [f64; 2]| {
        let ranges = (0..360).map(|i| if lost.contains(&i) { f32::NAN } else { 3.0 }).collect();
        let frame = Frame::new(0.0, scanner.clone(), Measurement::Range(ranges)).unwrap();
        let values = (0..360).map(|i| if columns.contains(&i) { 0.95 } else { 0.4 }).collect();
        let image = GreyImage::new(360, 1, values).unwrap();
        let region = PixelBox([region[0], -0.2, region[1], 0.2]);
        let found = reflectors_in(&frame, &image, region, &options).unwrap();
        found.iter().map(|r| (r.detection.shape.centre().x, r.detection.covariance.x_axis.x)).collect::<Vec<_>>()
    };
    let wide: Vec<usize> = (100..130).collect();
    assert!(find(&[], &wide, [110.0, 114.0]).is_empty() && find(&[], &wide, [99.0, 101.0]).is_empty());
    // The spot is found once from regions at both of its ends and in its middle.
    let six: Vec<usize> = (100..106).collect();
    for region in [[99.0, 100.4], [102.0, 103.0], [105.0, 108.0], [90.0, 110.0]] {
        let found = find(&[], &six, region);
        assert!(found.len() == 1 && (found[0].0 - 102.5).abs() < 1e-12, "{region:?}: {found:?}");
    }
    // Over the seam: columns 358 to 1 have their middle at 359.5, from either side, and in a region beyond the width.
    for region in [[357.0, 363.0], [-1.0, 2.0], [356.0, 358.0], [1.0, 3.0], [-0.5, 359.5]] {
        let found = find(&[], &[358, 359, 0, 1], region);
        assert!(found.len() == 1 && (found[0].0 - 359.5).rem_euclid(360.0) < 1e-9, "{region:?}: {found:?}");
    }
    // By hand: the slope's error is 1 cm over the root of the columns' squared deviations. The middle has 3^2 / 3 m of
    // it.
    let of_slope = |squares: f64| 0.03f64.powi(2) / squares;
    let is_at = |found: &[(f64, f64)], (x, variance): (f64, f64)| {
        found.len() == 1 && (found[0].0 - x).abs() < 1e-12 && (found[0].1 - variance).abs() < 1e-12
    };
    let lost = find(&[102], &six, [90.0, 110.0]);
    assert!(is_at(&lost, (102.5, 1.0 / 24.0 + of_slope(17.2))), "{lost:?}");
    // An end within two pitches is half a pitch further out, with a variance of 4 / 12. The middle gets a quarter.
    let open = find(&[106], &six, [90.0, 110.0]);
    assert!(is_at(&open, (102.75, 5.0 / 48.0 + of_slope(17.5))), "{open:?}");
}

/// By hand: a plate of 20 cm on a wall 0.8 m to the left, 2 m ahead, spans 20.854 to 22.834 degrees. Its middle is at
/// 21.801, that of its columns at 21.844: more than two columns of 0.02 degrees apart.
#[test]
fn the_middle_of_a_reflector_that_is_seen_aslant() {
    const STEP: f64 = 0.02;
    let azimuth = Angles::Uniform { start_deg: 0.0, step_deg: STEP, count: 2000 };
    let geometry = Scanner { azimuth, elevation: Angles::Listed(vec![0.0]), beam_height_deg: None };
    let scanner = sensor(Geometry::Scanner(geometry));
    let angle = |i: usize| (STEP * i as f64).to_radians();
    let ranges = (0..2000).map(|i| (0.8 / angle(i.max(1)).sin()) as f32).collect();
    let is_on = |i: usize| (1.9..=2.1).contains(&(0.8 / angle(i.max(1)).tan()));
    let image = GreyImage::new(2000, 1, (0..2000).map(|i| if is_on(i) { 0.95 } else { 0.3 }).collect()).unwrap();
    let frame = Frame::new(0.0, scanner.clone(), Measurement::Range(ranges)).unwrap();
    let found = reflectors_in(&frame, &image, PixelBox::whole_of(&scanner), &ReflectorOptions::default()).unwrap();
    assert_eq!(found.len(), 1);
    let (column, range) = (found[0].detection.shape.centre().x, found[0].range.mean);
    assert!((STEP * column - 21.8014).abs() < 0.5 * STEP && (range - 2.15407).abs() < 1e-3, "{column} {range}");
}
