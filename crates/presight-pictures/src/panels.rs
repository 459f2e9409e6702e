//! A part of several range images of one sensor, side by side in one scale of colours.

use super::canvas::{Canvas, FAINT, INK, PageRect, Rgb, text_width};
use super::color::{Palette, by_distance};
use super::is_one_row_scan;
use super::png::{PixelFormat, encode};
use super::polar::hits;
use super::scale::Scale;
use super::view::{FOOTER, HEADER, MARGIN, bar, drawn_size, is_mirrored};
use glam::{DVec2, DVec3};
use presight_model::error::{Error, Result};
use presight_model::sensor::Sensor;
use presight_render::plan::{Images, Output};

/// Maximum side of a panel, pixels.
const SIDE: f64 = 360.0;
/// The frame around the place shown.
const FRAME: Rgb = [0xff, 0x5a, 0x36];
/// Share of the frame that is shown around it on each side.
const AROUND: f64 = 0.6;
/// Minimum number of sensor pixels that a panel shows along each side.
const MIN_PIXELS: f64 = 24.0;
/// Minimum distance around the place that the panel of a one-row scan shows, metres.
const MIN_AROUND: f64 = 1.0;

/// A range image under a name.
#[derive(Clone, Copy, Debug)]
pub struct Panel<'a> {
    /// The name above it.
    pub name: &'a str,
    /// Ranges of all pixels of the sensor, row-major, metres.
    pub range: &'a [f32],
}

/// The surroundings of a place in several range images of one sensor, as the bytes of a PNG file. All have the colours
/// of one scale, near yellow and far violet; left is left. A frame marks the place. A scan of one row is drawn from
/// above, x (forward) up.
///
/// `around` are points in the sensor's body frame, metres, such as the corners of a box around the place.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if an image does not have the sensor's size.
pub fn panels_png(panels: &[Panel<'_>], sensor: &Sensor, around: &[DVec3]) -> Result<Vec<u8>> {
    let canvas = drawn(panels, sensor, around)?;
    let mut bytes = Vec::new();
    encode(&mut bytes, canvas.bytes(), canvas.width(), canvas.height(), PixelFormat::Rgb8)
        .map_err(|e| Error::invalid(format!("the picture cannot be encoded as PNG: {e}"), ""))?;
    Ok(bytes)
}

pub(super) fn drawn(panels: &[Panel<'_>], sensor: &Sensor, around: &[DVec3]) -> Result<Canvas> {
    let pixels = sensor.width() as usize * sensor.height() as usize;
    if let Some(wrong) = panels.iter().find(|panel| panel.range.len() != pixels) {
        let what = format!("{:?} has {} ranges, the sensor {pixels} pixels", wrong.name, wrong.range.len());
        return Err(Error::invalid(what, "give a range for each pixel"));
    }
    Ok(if is_one_row_scan(sensor) { from_above(panels, sensor, around) } else { views(panels, sensor, around) })
}

fn images(panel: &Panel<'_>, sensor: &Sensor) -> Images {
    Images { width: sensor.width(), height: sensor.height(), range: panel.range.to_vec(), ..Images::default() }
}

/// A page with room for panels of a size, their names and the scale; and the left side of each panel.
fn page(panels: &[Panel<'_>], (width, height): (u32, u32), scale: &Scale) -> (Canvas, Vec<u32>) {
    let widest = panels.iter().map(|panel| text_width(panel.name)).max().unwrap_or(0).max(width);
    let lefts: Vec<u32> = (0..panels.len() as u32).map(|k| MARGIN + k * (widest + MARGIN)).collect();
    let wide = MARGIN + panels.len() as u32 * (widest + MARGIN);
    let mut canvas = Canvas::new(wide, MARGIN + HEADER + height + FOOTER + MARGIN);
    for (panel, left) in panels.iter().zip(&lefts) {
        canvas.text(*left, MARGIN, panel.name, INK);
    }
    bar(&mut canvas, MARGIN + HEADER + height + MARGIN, (wide - 2 * MARGIN).min(480), scale, "m", by_distance);
    (canvas, lefts)
}

fn frame(canvas: &mut Canvas, [left, top]: [f64; 2], [right, bottom]: [f64; 2]) {
    let corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
    (0..4).for_each(|k| canvas.stroke(corners[k], corners[(k + 1) % 4], 1.2, FRAME));
}

/// From `low` to `high` along one side of the image, in pixels: the window around a place, inside the image.
fn window(low: f64, high: f64, size: f64) -> (f64, f64) {
    let half = (0.5 * (high - low) * (1.0 + 2.0 * AROUND)).max(0.5 * MIN_PIXELS).min(0.5 * size);
    let middle = (0.5 * (low + high)).clamp(half, (size - half).max(half));
    (middle - half, middle + half)
}

/// The extent of a place in the image, in drawn pixels from the left and the top; the whole image if it is not seen, or
/// crosses the seam of a turn.
fn place(sensor: &Sensor, around: &[DVec3], mirrored: bool) -> (DVec2, DVec2) {
    let size = DVec2::new(f64::from(sensor.width()), f64::from(sensor.height()));
    let back = sensor.body_from_image().inverse();
    let at = |p: &DVec3| {
        let (u, v) = sensor.project(back * *p)?;
        Some(DVec2::new(if mirrored { size.x - 0.5 - u } else { u + 0.5 }, v + 0.5))
    };
    let seen: Vec<DVec2> = around.iter().filter_map(at).collect();
    let (low, high) = seen.iter().fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
    let (low, high) = (low.clamp(DVec2::ZERO, size), high.clamp(DVec2::ZERO, size));
    let is_whole = seen.is_empty() || high.x - low.x > 0.5 * size.x || high.cmple(low).any();
    if is_whole { (DVec2::ZERO, size) } else { (low, high) }
}

fn views(panels: &[Panel<'_>], sensor: &Sensor, around: &[DVec3]) -> Canvas {
    let mirrored = is_mirrored(sensor);
    let (wide, high) = (sensor.width(), sensor.height());
    let (least, most) = place(sensor, around, mirrored);
    let x = window(least.x, most.x, f64::from(wide));
    let y = window(least.y, most.y, f64::from(high));
    let drawn = drawn_size(sensor);
    // Height over width of a pixel.
    let shape = f64::from(drawn.1) / f64::from(high) / (f64::from(drawn.0) / f64::from(wide));
    let per_pixel = (SIDE / (x.1 - x.0)).min(SIDE / ((y.1 - y.0) * shape)).max(1.0);
    let per = DVec2::new(per_pixel, per_pixel * shape);
    let size = (((x.1 - x.0) * per.x).ceil().max(1.0) as u32, ((y.1 - y.0) * per.y).ceil().max(1.0) as u32);
    let pixel = |across: u32, down: u32| {
        let column = ((x.0 + f64::from(across) / per.x) as u32).min(wide - 1);
        let row = ((y.0 + f64::from(down) / per.y) as u32).min(high - 1);
        row as usize * wide as usize + if mirrored { wide - 1 - column } else { column } as usize
    };
    let shown = panels.iter().flat_map(|panel| {
        let at = (0..size.1).flat_map(move |down| (0..size.0).map(move |across| (across, down)));
        at.map(|(across, down)| panel.range[pixel(across, down)])
    });
    let scale = Scale::of_values(shown);
    let (mut canvas, lefts) = page(panels, size, &scale);
    for (panel, left) in panels.iter().zip(lefts) {
        let palette = Palette::new(&images(panel, sensor), Output::Range, &scale);
        let top = MARGIN + HEADER;
        for down in 0..size.1 {
            for across in 0..size.0 {
                let (x, y) = (i64::from(left + across), i64::from(top + down));
                canvas.set(x, y, palette.color(pixel(across, down)));
            }
        }
        let corner =
            |p: DVec2| (DVec2::new(f64::from(left), f64::from(top)) + (p - DVec2::new(x.0, y.0)) * per).to_array();
        let inside = PageRect { left, top, width: size.0, height: size.1 };
        canvas.inside(inside, |canvas| frame(canvas, corner(least), corner(most)));
    }
    canvas
}

/// The hits of a row around a place, from above.
fn from_above(panels: &[Panel<'_>], sensor: &Sensor, around: &[DVec3]) -> Canvas {
    let bounds = |points: &mut dyn Iterator<Item = DVec2>| {
        points.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)))
    };
    let (least, most) = bounds(&mut around.iter().map(|p| p.truncate()));
    let (least, most) = if least.is_finite() { (least, most) } else { (DVec2::ZERO, DVec2::ZERO) };
    let half = (0.5 * (most - least).max_element() * (1.0 + 2.0 * AROUND)).max(MIN_AROUND);
    let (middle, per_metre) = (0.5 * (least + most), 0.5 * SIDE / half);
    let size = (SIDE as u32, SIDE as u32);
    let scale = Scale::of_values(panels.iter().flat_map(|panel| panel.range.iter().copied()));
    let (mut canvas, lefts) = page(panels, size, &scale);
    for (panel, left) in panels.iter().zip(lefts) {
        let image = images(panel, sensor);
        let palette = Palette::new(&image, Output::Range, &scale);
        let inside = PageRect { left, top: MARGIN + HEADER, width: size.0, height: size.1 };
        let corner = DVec2::new(f64::from(inside.left), f64::from(inside.top)) + 0.5 * SIDE;
        let at = |p: DVec2| [corner.x - (p.y - middle.y) * per_metre, corner.y - (p.x - middle.x) * per_metre];
        canvas.inside(inside, |canvas| {
            for (number, hit) in hits(&image, sensor).iter().enumerate() {
                hit.iter().for_each(|p| canvas.disc(at(*p), 2.5, palette.color(number)));
            }
            // The view from above turns the axes: the corners change their order.
            let (a, b) = (at(most), at(least));
            frame(canvas, a, b);
        });
        let (from, to) =
            ([f64::from(left), f64::from(inside.top)], [f64::from(left + size.0), f64::from(inside.top + size.1)]);
        let corners = [from, [to[0], from[1]], to, [from[0], to[1]]];
        (0..4).for_each(|k| canvas.stroke(corners[k], corners[(k + 1) % 4], 0.5, FAINT));
    }
    canvas
}
