//! The image as the sensor sees it, with title and scale bar.

use super::canvas::{Canvas, FAINT, INK, PAGE, PageRect, Rgb, TEXT_HEIGHT, mix, text_width};
use super::color::{Palette, by_distance, grey};
use super::overlay::{LEGEND, Overlay, legend};
use super::scale::Scale;
use glam::DVec2;
use presight_model::sensor::{Angles, Geometry, RayTable, Sensor};
use presight_model::statistics::median;
use presight_render::plan::{Images, Output, SampleKind};

/// Free space around and between panels, pixels.
pub const MARGIN: u32 = 20;
/// Size to which a smaller image is enlarged, pixels.
const WISHED: [f64; 2] = [1280.0, 900.0];
/// Share of black that is mixed into a border.
const BORDER: f64 = 0.45;
/// Height of the scale bar, pixels.
const BAR: u32 = 16;
/// Height of everything below the image, pixels.
pub const FOOTER: u32 = MARGIN + BAR + 8 + TEXT_HEIGHT;
/// Height of the title with its gap, pixels.
pub const HEADER: u32 = TEXT_HEIGHT + 12;
/// An image is drawn at least this wide and high, pixels.
const THINNEST: f64 = 24.0;
/// Minimum page width that holds title and legend, pixels.
pub const NARROWEST: u32 = 560;

/// Draws the image pixel by pixel.
pub fn draw(
    images: &Images,
    sensor: &Sensor,
    output: Output,
    palette: &Palette,
    scale: &Scale,
    overlay: Option<&Overlay<'_>>,
) -> Canvas {
    let (width, height) = drawn_size(sensor);
    let (page_width, left) = (width.max(NARROWEST) + 2 * MARGIN, MARGIN + NARROWEST.saturating_sub(width) / 2);
    let mut canvas = page(page_width, height, overlay);
    title(&mut canvas, sensor, output);
    let top = MARGIN + HEADER;
    draw_image(&mut canvas, PageRect { left, top, width, height }, images, sensor, palette, overlay);
    footer(&mut canvas, top + height + MARGIN, output, palette, scale);
    canvas
}

/// Draws pixels, polygon borders and features into a frame.
pub fn draw_image(
    canvas: &mut Canvas,
    frame: PageRect,
    images: &Images,
    sensor: &Sensor,
    palette: &Palette,
    overlay: Option<&Overlay<'_>>,
) {
    let PageRect { left, top, width, height } = frame;
    let borders = Borders::of(images);
    let mirrored = is_mirrored(sensor);
    let column_of = |x: u32| {
        let column = (u64::from(x) * u64::from(images.width) / u64::from(width)) as u32;
        if mirrored { images.width - 1 - column } else { column }
    };
    let columns: Vec<u32> = (0..width).map(column_of).collect();
    let rows: Vec<u32> =
        (0..height).map(|y| (u64::from(y) * u64::from(images.height) / u64::from(height)) as u32).collect();
    let pixel = |x: usize, y: usize| rows[y] as usize * images.width as usize + columns[x] as usize;
    for y in 0..rows.len() {
        for x in 0..columns.len() {
            let here = pixel(x, y);
            let mut color = palette.color(here);
            let crossed = |other: usize| borders.between(here, other);
            if (x > 0 && crossed(pixel(x - 1, y))) || (y > 0 && crossed(pixel(x, y - 1))) {
                color = mix(color, [0; 3], BORDER * borders.weight(here));
            }
            canvas.set(i64::from(left) + x as i64, i64::from(top) + y as i64, color);
        }
    }
    if let Some(overlay) = overlay {
        draw_features(canvas, frame, overlay);
    }
}

/// Draws features over the image in a frame.
pub fn draw_features(canvas: &mut Canvas, frame: PageRect, overlay: &Overlay<'_>) {
    let PageRect { left, top, width, height } = frame;
    let size = DVec2::new(f64::from(overlay.sensor.width()), f64::from(overlay.sensor.height()));
    let mirrored = is_mirrored(overlay.sensor);
    overlay.draw(canvas, frame, &|pixel| {
        let share = (pixel + 0.5) / size;
        let across = if mirrored { 1.0 - share.x } else { share.x };
        [f64::from(left) + across * f64::from(width), f64::from(top) + share.y * f64::from(height)]
    });
}

/// A blank page for an image of that height, with a legend of features if there is an overlay.
pub fn page(width: u32, height: u32, overlay: Option<&Overlay<'_>>) -> Canvas {
    let below = MARGIN + HEADER + height + FOOTER;
    let mut canvas = Canvas::new(width, below + MARGIN + if overlay.is_some() { LEGEND } else { 0 });
    if overlay.is_some() {
        legend(&mut canvas, MARGIN, below + LEGEND - TEXT_HEIGHT);
    }
    canvas
}

/// The image's size on the page: pixels have the aspect ratio of their angles, or of the chip for a camera.
pub fn drawn_size(sensor: &Sensor) -> (u32, u32) {
    let (w, h) = (f64::from(sensor.width()), f64::from(sensor.height()));
    let shape = match &sensor.spec().geometry {
        Geometry::Camera(c) => c.fx / c.fy,
        Geometry::Scanner(s) => mean_step(&s.elevation) / mean_step(&s.azimuth),
        Geometry::Rays(table) => ray_steps(table).map_or(1.0, |[across, up]| up / across.abs()),
    };
    // Height over width of a pixel; a single beam has none.
    let shape = if shape.is_finite() && shape > 0.0 { shape.clamp(1.0 / 32.0, 32.0) } else { 1.0 };
    let fitting = (WISHED[0] / w).min(WISHED[1] / (h * shape));
    let across = fitting.max(1.0).max(1.0 / shape);
    // A single row or column is stretched to be visible.
    let (width, height) = ((w * across).round().max(THINNEST), (h * across * shape).round().max(THINNEST));
    if width * height > 1e8 { (w as u32, h as u32) } else { (width as u32, height as u32) }
}

fn mean_step(angles: &Angles) -> f64 {
    let n = angles.len();
    if n < 2 { f64::NAN } else { ((angles.degrees(n - 1) - angles.degrees(0)) / (n - 1) as f64).abs() }
}

/// Median steps between the rays of a table: of azimuth from column to column and of elevation, without its sign, from
/// row to row, radians. `None` for a list of rays.
fn ray_steps(table: &RayTable) -> Option<[f64; 2]> {
    let (width, height) = (table.width() as usize, table.height() as usize);
    if width < 2 || height < 2 {
        return None;
    }
    // Some hundred pairs show the median.
    let every = (width * height / 512).max(1);
    let pixels = (0..width * (height - 1)).step_by(every).filter(|at| at % width + 1 < width);
    let ray = |at: usize| Some(table.directions()[at]).filter(|d| !d.is_nan());
    let pairs = pixels.filter_map(|at| Some([ray(at)?, ray(at + 1)?, ray(at + width)?]));
    let steps = pairs.map(|[ray, right, below]| {
        let across = ray.truncate().perp_dot(right.truncate()).atan2(ray.truncate().dot(right.truncate()));
        (across, (ray.z.asin() - below.z.asin()).abs())
    });
    let (mut across, mut up): (Vec<f64>, Vec<f64>) = steps.unzip();
    Some([median(&mut across)?, median(&mut up)?])
}

/// True for sensors that turn counter-clockwise: their columns run from right to left.
pub fn is_mirrored(sensor: &Sensor) -> bool {
    match &sensor.spec().geometry {
        Geometry::Scanner(s) => s.azimuth.len() > 1 && s.azimuth.degrees(s.azimuth.len() - 1) > s.azimuth.degrees(0),
        Geometry::Rays(table) => ray_steps(table).is_some_and(|[across, _]| across > 0.0),
        Geometry::Camera(_) => false,
    }
}

/// Borders between polygons, and their local density. Where nearly every pixel is a border, darkening them all would
/// only distort the colours.
struct Borders<'a> {
    ids: &'a [u32],
    crowding: Vec<f32>,
}

impl<'a> Borders<'a> {
    fn of(images: &'a Images) -> Self {
        let ids = images.polygon_id.as_slice();
        if ids.len() != images.pixels() {
            return Self { ids: &[], crowding: Vec::new() };
        }
        let (w, h) = (images.width as usize, images.height as usize);
        let is_border = |x: usize, y: usize| {
            let at = y * w + x;
            (x > 0 && ids[at] != ids[at - 1]) || (y > 0 && ids[at] != ids[at - w])
        };
        // A summed-area table gives the mean of any window.
        let mut sums = vec![0u32; (w + 1) * (h + 1)];
        for y in 0..h {
            let mut row = 0;
            for x in 0..w {
                row += u32::from(is_border(x, y));
                sums[(y + 1) * (w + 1) + x + 1] = sums[y * (w + 1) + x + 1] + row;
            }
        }
        let reach = 4;
        let mut crowding = Vec::with_capacity(w * h);
        for y in 0..h {
            let (y0, y1) = (y.saturating_sub(reach), (y + reach + 1).min(h));
            for x in 0..w {
                let (x0, x1) = (x.saturating_sub(reach), (x + reach + 1).min(w));
                let at = |x: usize, y: usize| sums[y * (w + 1) + x];
                let borders = at(x1, y1) + at(x0, y0) - at(x0, y1) - at(x1, y0);
                crowding.push(borders as f32 / ((x1 - x0) * (y1 - y0)) as f32);
            }
        }
        Self { ids, crowding }
    }

    fn between(&self, a: usize, b: usize) -> bool {
        !self.ids.is_empty() && self.ids[a] != self.ids[b]
    }

    fn weight(&self, at: usize) -> f64 {
        f64::from((1.0 - (self.crowding[at] - 0.3) / 0.4).clamp(0.15, 1.0))
    }
}

/// Draws the title line.
pub fn title(canvas: &mut Canvas, sensor: &Sensor, output: Output) {
    canvas.text(MARGIN, MARGIN, output.name(), INK);
    let about = format!("{} {} x {}", sensor.spec().name, sensor.width(), sensor.height());
    let room = canvas.width().saturating_sub(2 * MARGIN + text_width(output.name()) + MARGIN);
    if text_width(&about) <= room {
        canvas.text(canvas.width() - MARGIN - text_width(&about), MARGIN, &about, FAINT);
    }
}

/// Draws scale bar and legend.
pub fn footer(canvas: &mut Canvas, top: u32, output: Output, palette: &Palette, scale: &Scale) {
    let mut right = canvas.width() - MARGIN;
    for (color, name) in palette.specials.iter().rev() {
        right -= text_width(name);
        canvas.text(right, top + 1, name, INK);
        right -= BAR + 8;
        canvas.fill(right, top, BAR, BAR, FAINT);
        canvas.fill(right + 1, top + 1, BAR - 2, BAR - 2, *color);
        right -= MARGIN;
    }
    let width = right.saturating_sub(2 * MARGIN).min(640);
    match output.info().kind {
        SampleKind::Float if output.is_distance() => bar(canvas, top, width, scale, "m", by_distance),
        SampleKind::Float => bar(canvas, top, width, scale, "", grey),
        SampleKind::Id | SampleKind::Vector => {}
    }
}

pub fn bar(canvas: &mut Canvas, top: u32, width: u32, scale: &Scale, unit: &str, color: fn(f64) -> Rgb) {
    for x in 0..width {
        canvas.fill(MARGIN + x, top, 1, BAR, color(f64::from(x) / f64::from(width.max(2) - 1)));
    }
    let mut free_from = 0;
    for (value, label) in scale.ticks() {
        let x = MARGIN + (scale.share(value) * f64::from(width.max(1) - 1)).round() as u32;
        let label = if unit.is_empty() { label } else { format!("{label} {unit}") };
        let half = text_width(&label) / 2;
        let start = x.saturating_sub(half).max(MARGIN);
        if start < free_from {
            continue;
        }
        canvas.fill(x, top + BAR - 4, 1, 8, PAGE);
        canvas.fill(x, top + BAR, 1, 5, INK);
        canvas.text(start, top + BAR + 8, &label, INK);
        free_from = start + 2 * half + 12;
    }
}
