//! Orientation of previews, and units of depth images.

use super::*;
use glam::DVec3;
use presight_model::sensor::{Angles, Camera, RayTable, Scanner, SensorSpec};
use presight_render::plan::Outputs;

fn scanner(step_deg: f64, rows: u32) -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -step_deg * 1.5, step_deg, count: 4 };
    let elevation = Angles::Uniform { start_deg: 0.0, step_deg: 10.0, count: rows };
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    Sensor::new(SensorSpec::new("s", "laser", Geometry::Scanner(scanner))).unwrap()
}

fn camera() -> Sensor {
    let camera = Camera::pinhole(4, 2, 10.0, 10.0, 1.5, 0.5);
    Sensor::new(SensorSpec::new("c", "video", Geometry::Camera(camera))).unwrap()
}

/// One range everywhere, except for a near first pixel.
fn near_corner(sensor: &Sensor) -> Images {
    let mut images = Images::default();
    images.prepare(sensor.width(), sensor.height(), Outputs::of(&[Output::Range]));
    images.range.fill(4.0);
    images.range[0] = 1.0;
    images
}

/// The rays of a scanner, and of a scanner that turns clockwise, as a table: left is left, and pixels have their angles.
#[test]
fn tables_of_rays_are_drawn_as_scanners_are() {
    for step_deg in [5.0, -5.0] {
        let sensor = scanner(step_deg, 3);
        let pixels = (0..3).flat_map(|row| (0..4).map(move |column| (column, row)));
        let rays = pixels.map(|(c, r)| sensor.ray(c, r).unwrap()).collect();
        let table = Geometry::Rays(RayTable::new(4, 3, rays).unwrap());
        let table = Sensor::new(sensor.spec().clone().with_geometry(table)).unwrap();
        assert_eq!(view::is_mirrored(&table), step_deg > 0.0);
        assert_eq!(view::drawn_size(&table), view::drawn_size(&sensor));
    }
    // A list of rays has no layout.
    let list = RayTable::new(3, 1, vec![DVec3::X, DVec3::new(1.0, 0.1, 0.0), DVec3::new(1.0, 0.2, 0.0)]).unwrap();
    assert!(!view::is_mirrored(&Sensor::new(SensorSpec::new("l", "laser", Geometry::Rays(list))).unwrap()));
}

/// Mean position of a colour's pixels on the page, from 0 to 1 from left and top.
fn place_of(canvas: &Canvas, color: [u8; 3]) -> [f64; 2] {
    let (mut sum, mut n) = ([0.0; 2], 0.0);
    // Leaves out the legend below, which repeats the colours.
    for y in 0..canvas.height() - view::FOOTER - view::MARGIN {
        for x in 0..canvas.width() {
            if canvas.get(x.into(), y.into()) == color {
                sum = [sum[0] + f64::from(x), sum[1] + f64::from(y)];
                n += 1.0;
            }
        }
    }
    assert!(n > 0.0, "the colour is not there");
    [sum[0] / n / f64::from(canvas.width()), sum[1] / n / f64::from(canvas.height())]
}

#[test]
fn left_is_left_and_top_is_top() {
    let near = color::by_distance(0.0);
    for (sensor, left) in [(camera(), true), (scanner(10.0, 2), false), (scanner(-10.0, 2), true)] {
        let canvas = preview(&near_corner(&sensor), &sensor, Output::Range, &Marks::default()).unwrap();
        let [x, y] = place_of(&canvas, near);
        assert_eq!(x < 0.4, left, "{}: {x}", sensor.spec().name);
        assert_eq!(x > 0.6, !left, "{}: {x}", sensor.spec().name);
        assert!(y < 0.5, "row 0 is the top one");
    }
}

#[test]
fn a_scan_of_one_row_is_seen_from_above() {
    for (step, left) in [(10.0, false), (-10.0, true)] {
        let sensor = scanner(step, 1);
        let canvas = preview(&near_corner(&sensor), &sensor, Output::Range, &Marks::default()).unwrap();
        let [x, _] = place_of(&canvas, color::by_distance(0.0));
        let [_, far_y] = place_of(&canvas, color::by_distance(1.0));
        assert_eq!(x < 0.5, left, "beam 0 at {x}");
        assert!(far_y < 0.3, "forward is up");
    }
}

#[test]
fn every_output_of_every_shape_can_be_drawn() {
    for sensor in [camera(), scanner(10.0, 1), scanner(-90.0, 3), scanner(1e-3, 1)] {
        let mut images = Images::default();
        images.prepare(sensor.width(), sensor.height(), Outputs::ALL);
        let odd = [f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 1e30];
        images.range.iter_mut().zip(odd.iter().cycle()).for_each(|(v, o)| *v = *o);
        for output in Output::ALL {
            preview(&images, &sensor, output, &Marks::default()).unwrap();
        }
        images.range.fill(f32::INFINITY);
        preview(&images, &sensor, Output::Range, &Marks::default()).unwrap();
    }
}

#[test]
fn an_image_that_is_not_there_is_an_error() {
    assert!(preview(&near_corner(&camera()), &camera(), Output::ObjectId, &Marks::default()).is_err());
    assert!(preview(&near_corner(&camera()), &scanner(1.0, 3), Output::Range, &Marks::default()).is_err());
}

#[test]
fn millimetres_are_rounded_and_nothing_is_0() {
    let metres = [1.2344, 1.2346, 65.535, 65.536, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 0.0004, 0.0];
    assert_eq!(to_millimetres(&metres), (vec![1234, 1235, 65535, 0, 0, 0, 0, 0, 0], 1));
}

#[test]
fn a_depth_image_reads_back() {
    let sensor = scanner(10.0, 2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("d.png");
    write_depth(&path, &near_corner(&sensor), &sensor).unwrap();
    let read = image::open(&path).unwrap().into_luma16();
    assert_eq!((read.width(), read.height(), read.get_pixel(0, 0).0, read.get_pixel(1, 1).0), (4, 2, [1000], [4000]));
}

const CONFIRMED: [u8; 3] = [1, 2, 3];
const NEARER: [u8; 3] = [4, 5, 6];
const LEGEND: [(&str, [u8; 3]); 2] = [("confirmed", CONFIRMED), ("nearer", NEARER)];

/// A comparison of ranges alone.
fn compared<'a>(sensor: &'a Sensor, predicted: &'a Images, sensed: &'a [f32], verdicts: &'a [u8]) -> Comparison<'a> {
    Comparison { sensor, predicted, sensed, verdicts, legend: &LEGEND, features: None, grey: None, plan: None }
}

/// The panels are predicted, measured and verdicts, side by side or stacked, with one scale of ranges.
#[test]
fn comparisons_have_three_panels() {
    let verdicts = [1, 0, 0, 0, 0, 0, 0, 0];
    for (sensor, wide) in [(camera(), true), (scanner(-10.0, 2), false)] {
        let sensed = near_corner(&sensor);
        let mut predicted = sensed.clone();
        predicted.range[0] = 2.0;
        let canvas = comparison::draw(&compared(&sensor, &predicted, &sensed.range, &verdicts)).unwrap();
        let stacked = canvas.height() > canvas.width();
        assert_eq!(stacked, !wide || sensor.width() == 2 * sensor.height());
        // The nearest range is measured, not predicted, so the nearest colour is in the second panel.
        let at = place_of(&canvas, color::by_distance(0.0));
        let along = usize::from(stacked);
        assert!((0.3..0.6).contains(&at[along]), "{}: {at:?}", sensor.spec().name);
        let nearer = place_of(&canvas, NEARER);
        let confirmed = place_of(&canvas, CONFIRMED);
        assert!(
            nearer[along] > 0.6 && nearer[0] < confirmed[0] && nearer[1] < confirmed[1],
            "{nearer:?} {confirmed:?}"
        );
    }
}

/// Each measured point is a dot in the colour of its verdict, here to the left or right ahead of a wall 4 m away.
#[test]
fn scans_are_compared_from_above() {
    for (step, left) in [(10.0, false), (-10.0, true)] {
        let sensor = scanner(step, 1);
        let sensed = near_corner(&sensor);
        let mut predicted = sensed.clone();
        predicted.range[0] = 4.0;
        let canvas = comparison::draw(&compared(&sensor, &predicted, &sensed.range, &[1, 0, 0, 0])).unwrap();
        let (nearer, confirmed) = (place_of(&canvas, NEARER), place_of(&canvas, CONFIRMED));
        assert!(nearer[1] > confirmed[1] + 0.2, "{nearer:?} {confirmed:?}");
        assert_eq!(nearer[0] < 0.5, left, "{nearer:?}");
    }
}

#[test]
fn comparisons_of_another_size_are_refused() {
    let sensor = camera();
    let images = near_corner(&sensor);
    let refused = |sensed: &[f32], verdicts: &[u8]| {
        comparison::draw(&compared(&sensor, &images, sensed, verdicts)).err().map(|e| e.to_string())
    };
    assert!(refused(&images.range[1..], &[]).is_some_and(|e| e.contains("7 pixels are measured")));
    assert!(refused(&images.range, &[0; 9]).is_some_and(|e| e.contains("9 pixels are judged")));
    assert!(refused(&images.range, &[]).is_none());
    // Classes without a name are not drawn.
    assert!(refused(&images.range, &[9; 8]).is_none());
}

/// Three images side by side in one scale: the near pixel of the second one is in the second third, on its side of the
/// panel. A frame is around it, and what lies far from it is not shown.
#[test]
fn panels_share_a_scale_and_show_a_place() {
    let near = color::by_distance(0.0);
    for (sensor, left) in [(camera(), true), (scanner(10.0, 2), false), (scanner(-10.0, 2), true)] {
        let images = near_corner(&sensor);
        let far = vec![4.0f32; images.range.len()];
        let of = |range| Panel { name: "range", range };
        let canvas = panels::drawn(&[of(&far), of(&images.range), of(&far)], &sensor, &[]).unwrap();
        let [x, y] = place_of(&canvas, near);
        assert!(
            if left { x < 0.5 } else { x > 0.5 } && x > 0.34 && x < 0.66 && y < 0.5,
            "{}: {x} {y}",
            sensor.spec().name
        );
        let wrong = panels_png(&[of(&far[1..])], &sensor, &[]).unwrap_err();
        assert!(wrong.to_string().contains("has 7 ranges, the sensor 8 pixels"), "{wrong}");
    }
    // 120 columns of 3 degrees: a place at 90 degrees, to the left, and a near wall at -90 degrees, which is not shown.
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 3.0, count: 120 };
    let elevation = Angles::Uniform { start_deg: -30.0, step_deg: 3.0, count: 21 };
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    let sensor = Sensor::new(SensorSpec::new("s", "laser", Geometry::Scanner(scanner))).unwrap();
    let at = |column: usize| {
        if column == 90 {
            2.0
        } else if column == 30 {
            1.0
        } else {
            4.0f32
        }
    };
    let range: Vec<f32> = (0..120 * 21).map(|pixel| at(pixel % 120)).collect();
    let around = [DVec3::new(-0.2, 2.0, -0.2), DVec3::new(0.2, 2.0, 0.2)];
    let canvas = panels::drawn(&[Panel { name: "range", range: &range }], &sensor, &around).unwrap();
    let [x, _] = place_of(&canvas, near);
    assert!((x - 0.5).abs() < 0.1, "2 m is the nearest that is shown, in the middle: {x}");
    assert!(place_of(&canvas, [0xff, 0x5a, 0x36])[1] < 0.6, "a frame");
}
