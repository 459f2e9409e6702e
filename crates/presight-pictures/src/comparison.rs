//! Pictures that compare a prediction with a measurement and show the verdict of each pixel.

use super::canvas::{Canvas, FAINT, INK, PageRect, Rgb, TEXT_HEIGHT, text_width};
use super::color::{MISS, Palette, grey as gray};
use super::is_one_row_scan;
use super::overlay::{LEGEND, Overlay, legend};
use super::png::{PixelFormat, encode};
use super::polar::{self, Map};
use super::scale::Scale;
use super::top_view::draw_from_above;
use super::view::{self, FOOTER, HEADER, MARGIN};
use glam::{DVec2, DVec3};
use presight_features::FeaturePrediction;
use presight_model::error::{Error, Result};
use presight_model::measured::GreyImage;
use presight_model::sensor::Sensor;
use presight_read::atomic::write_atomically;
use presight_render::plan::{Images, Output};
use std::io::BufWriter;
use std::path::Path;

/// A measured image and the prediction it is compared with.
#[derive(Clone, Copy, Debug)]
pub struct Comparison<'a> {
    /// The sensor that measured.
    pub sensor: &'a Sensor,
    /// The predicted `range`; with `polygon_id`, borders of polygons are drawn.
    pub predicted: &'a Images,
    /// Measured ranges in metres, row by row; `-inf`, `+inf` and NaN as in REP-117.
    pub sensed: &'a [f32],
    /// The verdict of each pixel, as an index into `legend`; empty without a comparison.
    pub verdicts: &'a [u8],
    /// Names and colours (sRGB) of verdicts.
    pub legend: &'a [(&'a str, [u8; 3])],
    /// Features and their regions of interest.
    pub features: Option<&'a Overlay<'a>>,
    /// A grey image taken at the same time, with the features found in it.
    pub grey: Option<GreyPanel<'a>>,
    /// Predicted and found features in a scan of one row.
    pub plan: Option<PlanMarks<'a>>,
}

/// Points over the plan of a scan of one row.
#[derive(Clone, Copy, Debug)]
pub struct PlanMarks<'a> {
    /// Points in metres, x forward and y left of the sensor; later ones cover earlier ones.
    pub marks: &'a [GreyMark],
    /// Names and colours (sRGB) of marks.
    pub legend: &'a [(&'a str, [u8; 3])],
}

/// A grey image with predicted and found features.
#[derive(Clone, Copy, Debug)]
pub struct GreyPanel<'a> {
    /// The image.
    pub image: &'a GreyImage,
    /// Marks over the image; later ones cover earlier ones.
    pub marks: &'a [GreyMark],
    /// Names and colours (sRGB) of marks.
    pub legend: &'a [(&'a str, [u8; 3])],
}

/// A point or a line over an image or a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct GreyMark {
    /// Columns and rows in an image, metres in a plan.
    pub points: Vec<DVec2>,
    /// Index into the legend.
    pub kind: usize,
    /// Half the width on the page, pixels.
    pub radius: f64,
}

/// Widest panel of three side by side, pixels.
const PANEL: f64 = 560.0;
/// Panels at least this many times wider than high are stacked.
const FLAT: f64 = 2.0;
/// Side of a legend's squares, pixels.
const SQUARE: u32 = 16;

/// Writes a picture of a comparison: panels with predicted ranges, measured ranges and verdicts, on one scale of
/// ranges. For a scan of one row it is a plan from above, with predicted surfaces as lines and measured points as dots
/// in the colours of their verdicts.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] for an image of another size than the sensor's,
/// [`presight_model::ErrorKind::System`] for I/O errors.
pub fn write_comparison(path: &Path, comparison: &Comparison<'_>) -> Result<()> {
    let canvas = draw(comparison).map_err(|e| e.in_file(path))?;
    write_atomically(path, |file| {
        encode(BufWriter::new(file), canvas.bytes(), canvas.width(), canvas.height(), PixelFormat::Rgb8)
    })
}

/// Draws the picture.
pub(super) fn draw(c: &Comparison<'_>) -> Result<Canvas> {
    let pixels = c.sensor.width() as usize * c.sensor.height() as usize;
    let images = [("predicted", c.predicted.range.len()), ("measured", c.sensed.len()), ("judged", c.verdicts.len())];
    if let Some(grey) = &c.grey
        && c.sensed.is_empty()
        && c.predicted.range.is_empty()
    {
        return Ok(grey_alone(grey));
    }
    let wrong = |(name, len): &(&str, usize)| *len != pixels && !(*name == "judged" && *len == 0);
    if let Some((name, len)) = images.into_iter().find(wrong) {
        let what = format!("{len} pixels are {name}, the sensor has {pixels}");
        return Err(Error::invalid(what, "compare a frame with a prediction for its own sensor"));
    }
    Ok(if is_one_row_scan(c.sensor) { from_above(c) } else { panels(c) })
}

fn panels(c: &Comparison<'_>) -> Canvas {
    let (width, height) = view::drawn_size(c.sensor);
    let stacked = f64::from(width) >= FLAT * f64::from(height);
    let shrink = if stacked { 1.0 } else { (PANEL / f64::from(width)).min(1.0) };
    let [width, height] = [width, height].map(|side| ((f64::from(side) * shrink).round() as u32).max(24));
    let sensed = Images { range: c.sensed.to_vec(), polygon_id: Vec::new(), ..c.predicted.clone() };
    // One scale, so that a colour means the same range in both panels.
    let both = Images { range: [&c.predicted.range[..], c.sensed].concat(), ..Images::default() };
    let scale = Scale::of(&both, Output::Range);
    let palette = |images: &Images| Palette::new(images, Output::Range, &scale);
    // Only regions of interest are drawn over the measured image: lines would cover the features in them.
    let bare = c.features.map(|overlay| without_lines(overlay.features));
    let regions = c.features.zip(bare.as_ref()).map(|(overlay, features)| Overlay { features, sides: &[], ..*overlay });
    let mut drawn = vec![
        ("predicted", c.predicted, palette(c.predicted), c.features),
        ("sensed", &sensed, palette(&sensed), regions.as_ref()),
    ];
    if !c.verdicts.is_empty() {
        drawn.push(("verdicts", &sensed, Palette::of_classes(c.verdicts, c.legend), None));
    }
    let n = drawn.len() as u32 + u32::from(c.grey.is_some());
    let (across, down) = if stacked { (1, n) } else { (n, 1) };
    let page_width = across * (width + MARGIN) + MARGIN;
    let below = MARGIN + down * (HEADER + height + MARGIN);
    let lines = legend_lines(c.legend, page_width);
    let of_features = c.grey.map_or_else(Vec::new, |grey| legend_lines(grey.legend, page_width));
    let own = legend_height(c, &lines);
    let mut canvas = Canvas::new(page_width, below + FOOTER + own + LEGEND * of_features.len() as u32 + MARGIN);
    let cell = |k: u32| {
        let (column, row) = if stacked { (0, k) } else { (k, 0) };
        (MARGIN + column * (width + MARGIN), MARGIN + row * (HEADER + height + MARGIN))
    };
    for (k, (name, images, palette, overlay)) in (0..).zip(&drawn) {
        let (left, top) = cell(k);
        canvas.text(left, top, name, INK);
        let frame = PageRect { left, top: top + HEADER, width, height };
        view::draw_image(&mut canvas, frame, images, c.sensor, palette, *overlay);
    }
    if let Some(grey) = &c.grey {
        let (left, top) = cell(n - 1);
        canvas.text(left, top, "grey", INK);
        draw_grey(&mut canvas, PageRect { left, top: top + HEADER, width, height }, grey);
        draw_names(&mut canvas, &of_features, below + FOOTER + own);
    }
    let mut colors = palette(&both);
    // In a measured image, NaN means a missing measurement rather than a missing ray.
    colors.specials.iter_mut().filter(|(_, name)| *name == "no ray").for_each(|(_, name)| *name = "no value");
    view::footer(&mut canvas, below, Output::Range, &colors, &scale);
    draw_legends(&mut canvas, c, &lines, below + FOOTER);
    canvas
}

/// The features with their regions of interest, without visible and hidden parts.
fn without_lines(features: &FeaturePrediction) -> FeaturePrediction {
    let mut bare = features.clone();
    for feature in &mut bare.features {
        feature.visible.clear();
        feature.hidden.clear();
    }
    bare
}

fn from_above(c: &Comparison<'_>) -> Canvas {
    let ray = |column: u32| c.sensor.ray(column, 0).map(DVec3::truncate);
    let points = |ranges: &[f32]| -> Vec<Option<DVec2>> {
        let point = |(column, range): (u32, &f32)| Some(ray(column)? * f64::from(*range)).filter(|_| range.is_finite());
        (0..).zip(ranges).map(point).collect()
    };
    let (predicted, sensed) = (points(&c.predicted.range), points(c.sensed));
    let map = Map::around(&[&predicted[..], &sensed].concat());
    let lines = legend_lines(c.legend, map.size[0] + 2 * MARGIN);
    let (top, below) = (MARGIN + HEADER, 2 * MARGIN + HEADER + map.size[1]);
    let (own, names) = (legend_height(c, &lines), c.plan.map_or(&[][..], |plan| plan.legend));
    let of_features = if names.is_empty() { Vec::new() } else { legend_lines(names, map.size[0] + 2 * MARGIN) };
    let height = below + own + LEGEND * of_features.len() as u32 + MARGIN;
    let mut canvas = Canvas::new(map.size[0] + 2 * MARGIN, height);
    canvas.text(MARGIN, MARGIN, "predicted: lines, sensed: dots", INK);
    canvas.fill(MARGIN, top, map.size[0], map.size[1], MISS);
    polar::free_space(&mut canvas, &map, &sensed, ray);
    polar::rings(&mut canvas, &map);
    let ids = &c.predicted.polygon_id;
    for i in 1..predicted.len() {
        let same = ids.get(i).is_some_and(|id| ids.get(i - 1) == Some(id));
        if let (Some(a), Some(b), true) = (predicted[i - 1], predicted[i], same) {
            canvas.stroke(map.page(a), map.page(b), 0.7, INK);
        }
    }
    let palette = Palette::of_classes(c.verdicts, c.legend);
    for (i, (seen, expected)) in sensed.iter().zip(&predicted).enumerate() {
        let color = if c.verdicts.is_empty() { FAINT } else { palette.color(i) };
        match (seen, expected) {
            (Some(p), _) => canvas.disc(map.page(*p), 2.5, color),
            // A pixel without a measurement shows its verdict at the predicted point.
            (None, Some(p)) => canvas.disc(map.page(*p), 1.2, color),
            (None, None) => {}
        }
    }
    if let Some(overlay) = c.features {
        let frame = PageRect { left: MARGIN, top, width: map.size[0], height: map.size[1] };
        draw_from_above(overlay, &mut canvas, frame, &c.predicted.range, &|p| map.page(p));
    }
    if let Some(plan) = &c.plan {
        for mark in plan.marks {
            let color = plan.legend.get(mark.kind).map_or(FAINT, |(_, color)| *color);
            mark.points.iter().for_each(|at| canvas.disc(map.page(*at), 2.5 * mark.radius, color));
        }
    }
    polar::marker(&mut canvas, &map);
    draw_legends(&mut canvas, c, &lines, below);
    draw_names(&mut canvas, &of_features, below + own);
    canvas
}

/// Breaks the names and colours of a legend into lines that fit the page.
fn legend_lines<'a>(names: &[(&'a str, Rgb)], page_width: u32) -> Vec<Vec<(u32, &'a str, Rgb)>> {
    let (mut lines, mut x) = (vec![Vec::new()], MARGIN);
    for (name, color) in names {
        let own = SQUARE + 8 + text_width(name) + MARGIN;
        if x + own > page_width && x > MARGIN {
            lines.push(Vec::new());
            x = MARGIN;
        }
        if let Some(line) = lines.last_mut() {
            line.push((x, *name, *color));
        }
        x += own;
    }
    lines
}

fn legend_height<T>(c: &Comparison<'_>, lines: &[T]) -> u32 {
    let of_verdicts = if c.verdicts.is_empty() { 0 } else { lines.len() as u32 };
    LEGEND * (of_verdicts + u32::from(c.features.is_some()))
}

fn draw_legends(canvas: &mut Canvas, c: &Comparison<'_>, lines: &[Vec<(u32, &str, Rgb)>], top: u32) {
    let shown = if c.verdicts.is_empty() { &[][..] } else { lines };
    draw_names(canvas, shown, top);
    if c.features.is_some() {
        legend(canvas, MARGIN, top + LEGEND * (shown.len() as u32 + 1) - TEXT_HEIGHT);
    }
}

fn draw_names(canvas: &mut Canvas, lines: &[Vec<(u32, &str, Rgb)>], top: u32) {
    let mut y = top + LEGEND - TEXT_HEIGHT;
    for line in lines {
        for (x, name, color) in line {
            canvas.fill(*x, y, SQUARE, SQUARE, FAINT);
            canvas.fill(x + 1, y + 1, SQUARE - 2, SQUARE - 2, *color);
            canvas.text(x + SQUARE + 8, y, name, INK);
        }
        y += LEGEND;
    }
}

/// Draws a grey image without ranges.
fn grey_alone(grey: &GreyPanel<'_>) -> Canvas {
    let enlarged = (2.0 * PANEL / f64::from(grey.image.width())).clamp(1.0, 4.0);
    let [width, height] =
        [grey.image.width(), grey.image.height()].map(|side| ((f64::from(side) * enlarged) as u32).max(24));
    let page_width = width + 2 * MARGIN;
    let lines = legend_lines(grey.legend, page_width);
    let below = MARGIN + HEADER + height + MARGIN;
    let mut canvas = Canvas::new(page_width, below + LEGEND * lines.len() as u32 + MARGIN);
    canvas.text(MARGIN, MARGIN, "grey", INK);
    draw_grey(&mut canvas, PageRect { left: MARGIN, top: MARGIN + HEADER, width, height }, grey);
    draw_names(&mut canvas, &lines, below);
    canvas
}

/// Draws a grey image as large as fits into a frame.
fn draw_grey(canvas: &mut Canvas, cell: PageRect, grey: &GreyPanel<'_>) {
    let (w, h) = (grey.image.width(), grey.image.height());
    let scale = (f64::from(cell.width) / f64::from(w)).min(f64::from(cell.height) / f64::from(h));
    let [width, height] = [w, h].map(|side| ((f64::from(side) * scale).round() as u32).max(1));
    let frame = PageRect { width, height, ..cell };
    for y in 0..height {
        for x in 0..width {
            let at = |i: u32, drawn: u32, side: u32| (u64::from(i) * u64::from(side) / u64::from(drawn)) as u32;
            let value = grey.image.pixel(at(x, width, w), at(y, height, h));
            let color = if value.is_nan() { MISS } else { gray(f64::from(value)) };
            canvas.set(i64::from(frame.left + x), i64::from(frame.top + y), color);
        }
    }
    let page = |p: DVec2| {
        let at = (p + 0.5) * scale;
        [f64::from(frame.left) + at.x, f64::from(frame.top) + at.y]
    };
    canvas.inside(frame, |canvas| {
        for mark in grey.marks {
            let color = grey.legend.get(mark.kind).map_or(FAINT, |(_, color)| *color);
            match &mark.points[..] {
                [at] => canvas.disc(page(*at), 2.5 * mark.radius, color),
                points => points.windows(2).for_each(|p| canvas.stroke(page(p[0]), page(p[1]), mark.radius, color)),
            }
        }
    });
}
