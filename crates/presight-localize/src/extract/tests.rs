use super::*;
use crate::verdict::Verdict;
use glam::DVec2;
use presight_model::measured::GreyImage;
use presight_model::random::SplitMix64;

/// Dark and bright halves, separated by a line through `on` at an angle, with finely sampled pixels.
fn halves(on: DVec2, angle: f64, noise: f64, seed: u64) -> GreyImage {
    const SIDE: u32 = 64;
    let across = DVec2::from_angle(angle).perp();
    let mut random = SplitMix64(seed);
    let mut values = Vec::new();
    for i in 0..SIDE * SIDE {
        let fine = (0..64).map(|k| {
            let part = DVec2::new(f64::from(k % 8) + 0.5, f64::from(k / 8) + 0.5) / 8.0 - 0.5;
            let at = DVec2::new(f64::from(i % SIDE), f64::from(i / SIDE)) + part;
            if across.dot(at - on) > 0.0 { 0.7 } else { 0.3 }
        });
        let bright = fine.sum::<f64>() / 64.0;
        // Uniform noise with the requested deviation.
        values.push((bright + noise * 3f64.sqrt() * random.uniform(-1.0, 1.0)) as f32);
    }
    GreyImage::new(SIDE, SIDE, values).unwrap()
}

fn off_line(found: &FoundEdge, on: DVec2, angle: f64) -> f64 {
    let across = DVec2::from_angle(angle).perp();
    found.detection.shape.points().iter().map(|p| across.dot(*p - on).abs()).fold(0.0, f64::max)
}

/// Edges at all angles are found to a fraction of a pixel from wrong expectations. Errors are as the covariance states.
#[test]
fn edges_are_found_to_a_fraction_of_a_pixel() {
    let (mut squares, mut count) = (0.0, 0.0);
    for k in 0..60u32 {
        let angle = 0.11 * f64::from(k);
        let on = DVec2::new(31.0 + 0.17 * f64::from(k % 7), 32.0 - 0.13 * f64::from(k % 5));
        let image = halves(on, angle, 0.02, u64::from(k));
        let along = DVec2::from_angle(angle + 0.03);
        let aside = (f64::from(k % 9) - 4.0) * DVec2::from_angle(angle).perp();
        let expected = ExpectedEdge {
            ends: [on + aside - 20.0 * along, on + aside + 20.0 * along],
            reach: 6.0,
            is_right_brighter: None,
        };
        let options = EdgeOptions { noise: 0.02, ..EdgeOptions::default() };
        let found = edges_near(&image, &expected, &options);
        assert_eq!(found.len(), 1, "{k}: {found:?}");
        let off = off_line(&found[0], on, angle);
        assert!(off < 0.2, "{k}: {off} pixels");
        // perp() of an angle points to the right of its direction (rows grow downwards): the bright side.
        assert!(found[0].contrast > 0.25 && found[0].support > 0.9);
        squares += off * off / found[0].detection.covariance.x_axis.x;
        count += 1.0;
        let wrong = ExpectedEdge { is_right_brighter: Some(false), ..expected };
        assert!(edges_near(&image, &wrong, &options).is_empty(), "an edge of the other sense is not the one");
        let right = ExpectedEdge { is_right_brighter: Some(true), ..expected };
        assert_eq!(edges_near(&image, &right, &options).len(), 1);
    }
    let mean = squares / count;
    assert!((0.1..4.0).contains(&mean), "normalized squared errors of {mean}");
}

/// Noise alone, an edge out of reach, and one across the expected edge are not detected.
#[test]
fn what_is_no_edge_is_not_found() {
    let centre = DVec2::splat(31.5);
    let expected = |along: DVec2, aside: f64| ExpectedEdge {
        ends: [centre + aside * along.perp() - 20.0 * along, centre + aside * along.perp() + 20.0 * along],
        reach: 5.0,
        is_right_brighter: None,
    };
    let options = EdgeOptions { noise: 0.02, ..EdgeOptions::default() };
    for seed in 0..20 {
        let flat = halves(DVec2::splat(1e4), 0.0, 0.02, seed);
        assert!(edges_near(&flat, &expected(DVec2::X, 0.0), &options).is_empty());
        let image = halves(centre, 0.0, 0.02, seed);
        assert!(edges_near(&image, &expected(DVec2::X, 9.0), &options).is_empty());
        assert!(edges_near(&image, &expected(DVec2::Y, 0.0), &options).is_empty());
    }
    let image = halves(centre, 0.0, 0.0, 1);
    for broken in [
        ExpectedEdge { reach: f64::NAN, ..expected(DVec2::X, 0.0) },
        ExpectedEdge { ends: [DVec2::NAN, centre], ..expected(DVec2::X, 0.0) },
        ExpectedEdge { ends: [centre, centre], ..expected(DVec2::X, 0.0) },
        ExpectedEdge { ends: [DVec2::splat(-900.0), DVec2::splat(-800.0)], ..expected(DVec2::X, 0.0) },
    ] {
        assert!(edges_near(&image, &broken, &options).is_empty());
    }
    assert!(GreyImage::new(2, 2, vec![0.0; 3]).is_err() && GreyImage::new(1, 1, vec![f32::INFINITY]).is_err());
    let blind = GreyImage::new(64, 64, vec![f32::NAN; 4096]).unwrap();
    assert!(edges_near(&blind, &expected(DVec2::X, 0.0), &options).is_empty());
}

/// A bright wedge between two directions from a point, with finely sampled pixels.
fn wedge(tip: DVec2, from: f64, opening: f64, noise: f64, seed: u64) -> GreyImage {
    const SIDE: u32 = 48;
    let mut random = SplitMix64(seed);
    let bright = |i: u32| {
        let fine = (0..64).map(|k| {
            let part = DVec2::new(f64::from(k % 8) + 0.5, f64::from(k / 8) + 0.5) / 8.0 - 0.5;
            let at = DVec2::new(f64::from(i % SIDE), f64::from(i / SIDE)) + part - tip;
            if (at.to_angle() - from).rem_euclid(std::f64::consts::TAU) < opening { 0.8 } else { 0.3 }
        });
        fine.sum::<f64>() / 64.0
    };
    let values = (0..SIDE * SIDE).map(|i| (bright(i) + noise * 3f64.sqrt() * random.uniform(-1.0, 1.0)) as f32);
    GreyImage::new(SIDE, SIDE, values.collect()).unwrap()
}

/// Corners of 52 to 132 degrees in all directions are found to a fraction of a pixel, in the whole image and in a box,
/// with errors as their covariance states. An edge, noise and a blind image have no corners.
#[test]
fn corners_are_found_to_a_fraction_of_a_pixel() {
    let options = CornerOptions { noise: 0.01, ..CornerOptions::default() };
    let (mut squares, mut count) = (0.0, 0.0);
    for k in 0..96u32 {
        let tip = DVec2::new(23.0 + 0.13 * f64::from(k % 7), 24.0 - 0.17 * f64::from(k % 5));
        let image = wedge(tip, 0.31 * f64::from(k), 0.9 + 0.2 * f64::from(k % 8), 0.01, u64::from(k));
        let found = corners_in(&image, PixelBox::whole(&image), &options);
        assert_eq!(found.len(), 1, "{k}: {found:?}");
        let off = found[0].shape.centre() - tip;
        assert!(off.length() < 0.45, "{k}: {off} of {tip}");
        squares += off.dot(found[0].covariance.inverse() * off) / 2.0;
        count += 1.0;
        let near = corners_in(&image, PixelBox([tip.x - 4.0, tip.y - 4.0, tip.x + 4.0, tip.y + 4.0]), &options);
        assert_eq!(near.len(), 1);
        assert!(near[0].shape.centre().distance(found[0].shape.centre()) < 1e-9, "the same in a box");
        assert!(corners_in(&image, PixelBox([2.0, 2.0, 12.0, 12.0]), &options).is_empty());
    }
    let mean = squares / count;
    assert!((0.1..4.0).contains(&mean), "normalized squared errors of {mean}");
    for seed in 0..20 {
        for none in [halves(DVec2::splat(1e4), 0.0, 0.02, seed), halves(DVec2::splat(31.0), 0.4, 0.02, seed)] {
            let options = CornerOptions { noise: 0.02, ..options };
            assert!(corners_in(&none, PixelBox::whole(&none), &options).is_empty(), "{seed}");
        }
    }
    for value in [0.0, 0.5, 1.0, f32::NAN] {
        let flat = GreyImage::new(64, 64, vec![value; 4096]).unwrap();
        assert!(corners_in(&flat, PixelBox::whole(&flat), &options).is_empty());
        let expected =
            ExpectedEdge { ends: [DVec2::splat(5.0), DVec2::splat(50.0)], reach: 5.0, is_right_brighter: None };
        assert!(edges_near(&flat, &expected, &EdgeOptions::default()).is_empty());
    }
    let image = halves(DVec2::splat(31.0), 0.0, 0.0, 1);
    for odd in [[f64::NAN; 4], [5.0, 5.0, 1.0, 1.0], [-90.0, -90.0, -80.0, -80.0], [900.0, 0.0, 1e300, 9.0]] {
        assert!(corners_in(&image, PixelBox(odd), &options).is_empty());
    }
}

#[test]
fn what_ranges_say_of_a_feature_that_was_not_found() {
    let counts = |confirmed: usize, nearer: usize, farther: usize| {
        let mut counts = [0; 7];
        counts[Verdict::Confirmed as usize] = confirmed;
        counts[Verdict::Nearer as usize] = nearer;
        counts[Verdict::Farther as usize] = farther;
        counts[Verdict::Undecidable as usize] = 50;
        counts
    };
    let expected = |x: f64| crate::matching::ExpectedFeature {
        shape: crate::matching::Shape::Point(DVec2::new(x, 5.0)),
        covariances: vec![glam::DMat2::IDENTITY],
        window: [x - 2.0, 3.0, x + 2.0, 7.0],
        properties: Default::default(),
    };
    let all: Vec<_> = (0..5).map(|k| expected(10.0 * f64::from(k))).collect();
    let told = [counts(1, 9, 0), counts(1, 0, 9), counts(9, 1, 1), counts(0, 0, 0)];
    let classes = classify(&all, &[], &Default::default(), &told).unwrap();
    use FeatureClass::{Missing, Occluded, Undecidable};
    assert_eq!(classes.features, [Occluded, Missing, Undecidable, Undecidable, Undecidable]);
    // The left half of a row of pixels is nearer, the right half farther. Counts verdicts along a segment in either
    // half.
    let pixels: Vec<Verdict> = (0..200).map(|i| if i % 20 < 10 { Verdict::Nearer } else { Verdict::Farther }).collect();
    let verdicts = crate::verdict::Verdicts { width: 20, height: 10, pixels, difference: vec![0.0; 200] };
    let at = |x: f64| verdicts_along(&verdicts, [DVec2::new(x, 1.0), DVec2::new(x, 8.0)], 2.0);
    assert_eq!((at(4.0)[Verdict::Nearer as usize], at(4.0)[Verdict::Farther as usize]), (16, 0));
    assert_eq!((at(14.0)[Verdict::Nearer as usize], at(14.0)[Verdict::Farther as usize]), (0, 16));
}
