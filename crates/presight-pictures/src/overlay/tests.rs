//! Tests which pixels of a picture show features, and which do not.

use super::super::canvas::{Canvas, Rgb};
use super::super::pen::{HIDDEN, SEEN};
use super::super::view::{FOOTER, HEADER, MARGIN};
use super::super::{Marks, preview};
use super::*;
use presight_features::{HiddenInterval, Reason, VisibleInterval};
use presight_model::environment::{Existence, Feature, Properties};
use presight_model::sensor::{Camera, Distortion, Scanner, SensorSpec};
use presight_render::plan::{Images, Output, Outputs};
use proptest::prelude::*;

fn camera(lens: bool) -> Sensor {
    let distortion = if lens { Distortion::Equidistant([0.0; 4]) } else { Distortion::None };
    let camera = Camera { distortion, ..Camera::pinhole(80, 60, 40.0, 40.0, 39.5, 29.5) };
    Sensor::new(SensorSpec::new("c", "video", Geometry::Camera(camera))).unwrap()
}

fn all_round(rows: u32) -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 1.0, count: 360 };
    let elevation = Angles::Uniform { start_deg: 10.0, step_deg: -1.0, count: rows };
    let elevation = if rows == 1 { Angles::Uniform { start_deg: 0.0, step_deg: 0.0, count: 1 } } else { elevation };
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    Sensor::new(SensorSpec::new("s", "video", Geometry::Scanner(scanner))).unwrap()
}

/// A visible feature with a shape and no properties; world axes, x forward.
fn seen(id: u32, points: &[[f64; 3]]) -> SeenFeature {
    let points: Vec<DVec3> = points.iter().map(|p| DVec3::from_array(*p)).collect();
    let covariance = DMat3::ZERO;
    let shape = match points[..] {
        [at] => FeatureShape::Point { at, covariance },
        [a, b] => FeatureShape::Segment { ends: [a, b], covariances: [covariance; 2], cross: covariance },
        _ => FeatureShape::Patch { corners: points, covariance },
    };
    let (existence, properties) = (Existence::default(), Properties::default());
    SeenFeature::whole(&Feature { id, name: None, object: None, shape, existence, properties })
}

fn hidden(feature: SeenFeature) -> SeenFeature {
    let hidden = vec![HiddenInterval { t: [0.0, 1.0], reason: Reason::Occluded, by: None }];
    SeenFeature { visible: Vec::new(), hidden, visible_fraction: 0.0, ..feature }
}

fn in_part(feature: SeenFeature) -> SeenFeature {
    let hidden = vec![HiddenInterval { t: [0.5, 1.0], reason: Reason::Occluded, by: None }];
    SeenFeature { hidden, visible_fraction: 0.5, ..feature }
}

/// The pixels of a page that features change, and the image's rectangle on it.
struct Drawn {
    page: Canvas,
    /// Changed pixels.
    at: Vec<(i64, i64)>,
    frame: PageRect,
}

fn draw(sensor: &Sensor, features: Vec<SeenFeature>, sides: &[SeenFeature], numbers: bool) -> Drawn {
    let mut images = Images::default();
    images.prepare(sensor.width(), sensor.height(), Outputs::of(&[Output::Range]));
    // A dark background, on which lines have their own colours; a scan from above needs hits.
    images.range.fill(if sensor.height() == 1 { 4.0 } else { f32::INFINITY });
    let of = |features| FeaturePrediction { features, ..FeaturePrediction::default() };
    let draw = |features: &FeaturePrediction, sides| {
        let overlay = Overlay { features, sides, sensor, pose: SensorPose::IDENTITY, numbers };
        preview(&images, sensor, Output::Range, &Marks { overlay: Some(&overlay), ..Marks::default() }).unwrap()
    };
    let (page, blank) = (draw(&of(features), sides), draw(&of(Vec::new()), &[]));
    let all = (0..i64::from(page.height())).flat_map(|y| (0..i64::from(page.width())).map(move |x| (x, y)));
    let at = all.filter(|(x, y)| page.get(*x, *y) != blank.get(*x, *y)).collect();
    let frame = PageRect {
        left: MARGIN,
        top: MARGIN + HEADER,
        width: page.width() - 2 * MARGIN,
        height: page.height() - 2 * MARGIN - HEADER - FOOTER - LEGEND,
    };
    Drawn { page, at, frame }
}

impl Drawn {
    fn is_framed(&self) -> bool {
        let PageRect { left, top, width, height } = self.frame;
        let inside = |v: i64, from: u32, size: u32| (i64::from(from)..i64::from(from + size)).contains(&v);
        self.at.iter().all(|(x, y)| inside(*x, left, width) && inside(*y, top, height))
    }

    /// Horizontal positions of changed pixels, as fractions of the frame's width.
    fn across(&self) -> impl Iterator<Item = f64> + '_ {
        self.at.iter().map(|(x, _)| (*x as f64 + 0.5 - f64::from(self.frame.left)) / f64::from(self.frame.width))
    }

    fn has(&self, color: Rgb) -> bool {
        self.count(color) > 0
    }

    fn count(&self, color: Rgb) -> usize {
        self.at.iter().filter(|at| self.is(color, **at)).count()
    }

    /// True if a pixel of an anti-aliased line is closer to this colour than to the other style's.
    fn is(&self, color: Rgb, (x, y): (i64, i64)) -> bool {
        let away = |other: Rgb| self.page.get(x, y).iter().zip(other).map(|(a, b)| a.abs_diff(b)).max().unwrap_or(0);
        away(color) < 100
            && away(color) < [SEEN, HIDDEN].into_iter().filter(|c| *c != color).map(away).min().unwrap_or(255)
    }
}

#[test]
fn regions_over_the_seam_are_on_both_sides() {
    let sensor = all_round(21);
    let with_roi = |roi: [f64; 4]| SeenFeature { roi: Some(roi), ..hidden(seen(1, &[[0.0, 0.0, 9e9]])) };
    let drawn = draw(&sensor, vec![with_roi([350.0, 5.0, 365.0, 15.0])], &[], false);
    assert!(drawn.is_framed());
    // Columns run from right to left, so the first is on the right.
    let (left, right): (Vec<f64>, Vec<f64>) = drawn.across().partition(|x| *x < 0.5);
    assert!(
        left.iter().all(|x| *x < 10.5 / 360.0) && right.iter().all(|x| *x > 1.0 - 6.0 / 360.0),
        "{left:?} {right:?}"
    );
    // Both parts have upper and lower lines and one side.
    assert!(left.len() > 50 && right.len() > 30, "{} {}", left.len(), right.len());
    let whole = draw(&sensor, vec![with_roi([-0.5, -0.5, 359.5, 20.5])], &[], false);
    assert!(whole.is_framed() && !whole.at.is_empty());
}

#[test]
fn lines_reach_the_border_of_the_image() {
    // Rounding leaves ends that were cut at the border slightly outside.
    for (y, first) in [(1.0 + 1e-13, true), (-1.0 - 1e-13, false)] {
        let edge = seen(1, &[[1.0, 0.5 * y, 0.1], [1.0, y, 0.1]]);
        let drawn = draw(&camera(false), vec![edge], &[], false);
        let edge =
            if first { i64::from(drawn.frame.left) } else { i64::from(drawn.frame.left + drawn.frame.width) - 1 };
        assert!(drawn.is_framed() && drawn.at.iter().any(|(x, _)| *x == edge), "{y}");
    }
}

#[test]
fn what_is_seen_of_a_patch_in_part_is_told_apart() {
    let patch = || seen(7, &[[2.0, -0.5, -0.5], [2.0, 0.5, -0.5], [2.0, 0.5, 0.5], [2.0, -0.5, 0.5]]);
    let of = |feature, sides: &[SeenFeature]| draw(&camera(false), vec![feature], sides, false);
    let (whole, none, part) = (of(patch(), &[]), of(hidden(patch()), &[]), of(in_part(patch()), &[]));
    assert!(whole.has(SEEN) && !whole.has(HIDDEN) && none.has(HIDDEN) && !none.has(SEEN));
    // It is unknown which part is visible: dashed, in the colour of visible features.
    assert!(part.has(SEEN) && !part.has(HIDDEN) && 3 * part.count(SEEN) < 2 * whole.count(SEEN));
    // Known: the lower side is visible up to its middle.
    let corner = |k: usize| patch().points_world[k % 4].to_array();
    let sides: Vec<SeenFeature> = (0..4)
        .map(|k| {
            let side = seen(7, &[corner(k), corner(k + 1)]);
            if k > 0 {
                return hidden(side);
            }
            let visible = vec![VisibleInterval { t: [0.0, 0.5], pixels: [DVec2::ZERO; 2] }];
            SeenFeature { visible, ..in_part(side) }
        })
        .collect();
    let known = of(in_part(patch()), &sides);
    assert!(known.has(SEEN) && known.has(HIDDEN));
    let lowest = known.at.iter().map(|(_, y)| *y).max().unwrap();
    let pink = known.at.iter().filter(|at| known.is(SEEN, **at));
    assert!(pink.clone().all(|(_, y)| lowest - y < 5), "only the lower side is seen");
    let share = pink.count() as f64 / whole.count(SEEN) as f64;
    assert!((share - 0.125).abs() < 0.03, "{share}");
}

#[test]
fn scans_seen_from_above_show_walls_once_and_regions() {
    let sensor = all_round(1);
    let wall = || seen(1, &[[3.0, -1.0, -1.0], [3.0, 1.0, -1.0], [3.0, 1.0, 1.0], [3.0, -1.0, 1.0]]);
    let whole = draw(&sensor, vec![wall()], &[], false);
    // All hits are 4 m away, so 3 m ahead is at about an eighth of the height.
    assert!(whole.is_framed() && whole.has(SEEN) && !whole.has(HIDDEN));
    let rows: Vec<i64> = whole.at.iter().map(|(_, y)| *y).collect();
    assert!(rows.iter().max().unwrap() - rows.iter().min().unwrap() < 6, "one straight line across");
    // Hidden: drawn out and back, the dashes would fill their own gaps.
    let none = draw(&sensor, vec![hidden(wall())], &[], false);
    assert!(none.has(HIDDEN) && 10 * none.at.len() < 7 * whole.at.len(), "{} {}", none.at.len(), whole.at.len());
    // Behind the hits.
    let far = |x: f64| seen(1, &[[x, -1.0, -1.0], [x, 1.0, -1.0], [x, 1.0, 1.0], [x, -1.0, 1.0]]);
    assert!(draw(&sensor, vec![in_part(far(4.2))], &[], false).has(HIDDEN));
    // A region is an arc behind its feature.
    let roi = |feature| SeenFeature { roi: Some([170.0, -0.5, 190.0, 0.5]), range: Some(3.0), ..feature };
    let with_roi = draw(&sensor, vec![roi(wall())], &[], false);
    assert!(with_roi.is_framed() && with_roi.at.len() > whole.at.len() + 100);
    let top = |d: &Drawn| d.at.iter().map(|(_, y)| *y).min().unwrap();
    assert!(top(&with_roi) < top(&whole) - 5, "the arc is beyond");
}

#[test]
fn numbers_stay_in_the_picture() {
    for sensor in [camera(false), all_round(21), all_round(1)] {
        let cases = [[4.0, 3.99, 2.9], [4.0, -3.99, -2.9], [3.0, 0.0, 0.0], [-4.0, 1e-6, 0.0], [-4.0, -1e-6, 0.0]];
        for at in cases {
            let pixel = sensor.project(sensor.body_from_image().transpose() * DVec3::from_array(at));
            let Some(pixel) = pixel.map(DVec2::from) else { continue };
            let visible = vec![VisibleInterval { t: [0.0, 1.0], pixels: [pixel; 2] }];
            let feature = SeenFeature { visible, ..seen(4_294_967_295, &[at]) };
            let drawn = draw(&sensor, vec![feature.clone()], &[], true);
            let without = draw(&sensor, vec![feature], &[], false);
            assert!(drawn.is_framed(), "{at:?}");
            let inside = drawn.frame.holds([f64::from(drawn.frame.left), f64::from(drawn.frame.top)], 0.0);
            assert!(inside && drawn.at.len() >= without.at.len());
            if !without.at.is_empty() {
                assert!(drawn.at.len() > without.at.len() + 100, "all of the number is there: {at:?}");
            }
        }
    }
}

/// The cost of a line depends on its part on the page, not on its length.
#[test]
fn what_is_far_away_takes_no_time() {
    let start = std::time::Instant::now();
    let far = [1e3, 1e6, 1e12];
    for sensor in [camera(false), camera(true), all_round(21), all_round(1)] {
        let features = far.iter().flat_map(|r| {
            let patch = [[-r, 2e-3, -0.1 * r], [*r, 1e-3, -0.1 * r], [*r, *r, 0.1 * r], [-r, *r, 0.1 * r]];
            [
                hidden(seen(1, &patch)),
                hidden(seen(2, &[[1e-9, *r, 1e-12], [1e-9, -r, 1e-12]])),
                in_part(seen(3, &patch)),
            ]
        });
        assert!(draw(&sensor, features.collect(), &[], true).is_framed());
    }
    assert!(start.elapsed().as_secs_f64() < 20.0, "{:?}", start.elapsed());
}

prop_compose! {
    fn feature()(
        points in prop::collection::vec([-6.0..6.0f64, -6.0..6.0f64, -6.0..6.0f64], 1..5),
        scale in prop_oneof![Just(1.0), Just(1e3), Just(1e-3)],
        state in 0..3u32,
        roi in prop::option::of([-400.0..400.0f64, -50.0..50.0f64, 0.0..500.0f64, 0.0..100.0f64]),
        id in any::<u32>(),
    ) -> SeenFeature {
        let points: Vec<[f64; 3]> = points.iter().map(|p| p.map(|c| c * scale)).collect();
        let feature = seen(id, &points);
        let roi = roi.map(|[x, y, w, h]| [x, y, x + w, y + h]);
        let feature = SeenFeature { roi, range: Some(3.0), ..feature };
        match state {
            0 => feature,
            1 => hidden(feature),
            _ => in_part(feature),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn nothing_is_drawn_outside_of_the_image(features in prop::collection::vec(feature(), 1..12), which in 0..4usize) {
        let sensor = match which {
            0 => camera(false),
            1 => camera(true),
            2 => all_round(21),
            _ => all_round(1),
        };
        let sides: Vec<SeenFeature> = features.iter().filter(|f| f.points_world.len() == 2).cloned().collect();
        prop_assert!(draw(&sensor, features, &sides, true).is_framed());
    }
}
