//! PNG pictures: previews for people, and 16-bit depth images for programs.

mod canvas;
mod color;
mod comparison;
mod corridor;
mod font;
mod map;
mod overlay;
mod panels;
mod pen;
mod png;
mod polar;
mod scale;
mod screen;
mod top_view;
mod view;

use canvas::Canvas;
use color::Palette;
pub use comparison::{Comparison, GreyMark, GreyPanel, PlanMarks, write_comparison};
pub use corridor::{CorridorPicture, write_corridor};
pub use map::{GridMap, write_maps};
pub use overlay::Overlay;
pub use panels::{Panel, panels_png};
pub use pen::{Stroke, Style};
use png::{PixelFormat, encode};
use presight_model::error::{Error, Result};
use presight_model::measured::GreyImage;
use presight_model::sensor::{Geometry, Sensor};
use presight_predict::virtual_sensors::Mask;
use presight_read::atomic::write_atomically;
use presight_render::plan::{Images, Output, Outputs};
pub use scale::Scale;
pub use screen::Screen;
use std::io::BufWriter;
use std::path::Path;

/// Writes a preview for people: one output in colours, with title and scale bar. If there is a `polygon_id` image, thin
/// borders separate its ids.
///
/// Range and depth_z are coloured from near (yellow) to far (violet), ids have distinct colours, cos_incidence and echo
/// are grey, and unit vectors have 127.5 (x + 1), 127.5 (y + 1) and 127.5 (z + 1) as red, green and blue.
/// The aspect ratio of pixels follows their angles. Images of scanners and tables of rays that turn counter-clockwise
/// are mirrored: left is left.
/// A scan of one row is drawn from above, with x (forward) up.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the image is missing or does not have the sensor's size,
/// [`presight_model::ErrorKind::System`] if the file cannot be written.
pub fn write_preview(path: &Path, images: &Images, sensor: &Sensor, output: Output) -> Result<()> {
    write_preview_with(path, images, sensor, output, &Marks::default())
}

/// Marks on the image of a preview.
#[derive(Clone, Copy, Debug, Default)]
pub struct Marks<'a> {
    /// Features drawn over it.
    pub overlay: Option<&'a Overlay<'a>>,
    /// Pixels to tint.
    pub mask: Option<&'a Mask>,
    /// Pixels to hatch because they were dropped for a deadline, row-major. Empty if none were.
    pub given_up: &'a [bool],
}

/// As [`write_preview`], with features drawn over it, marked pixels tinted and dropped pixels hatched. Visible parts
/// are solid and hidden parts dashed. Regions of interest are boxes (in two parts across the seam of a turn), or arcs
/// in the view from above.
///
/// # Errors
/// As [`write_preview`].
pub fn write_preview_with(
    path: &Path,
    images: &Images,
    sensor: &Sensor,
    output: Output,
    marks: &Marks<'_>,
) -> Result<()> {
    let canvas = preview(images, sensor, output, marks).map_err(|e| e.in_file(path))?;
    write_atomically(path, |file| {
        let out = BufWriter::new(file);
        encode(out, canvas.bytes(), canvas.width(), canvas.height(), PixelFormat::Rgb8)
    })
}

/// [`write_preview`] into memory: the bytes of a PNG file.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the image is missing or does not have the sensor's size.
pub fn preview_png(images: &Images, sensor: &Sensor, output: Output) -> Result<Vec<u8>> {
    let canvas = preview(images, sensor, output, &Marks::default())?;
    let mut bytes = Vec::new();
    encode(&mut bytes, canvas.bytes(), canvas.width(), canvas.height(), PixelFormat::Rgb8)
        .map_err(|e| Error::invalid(format!("the preview cannot be encoded as PNG: {e}"), ""))?;
    Ok(bytes)
}

fn preview(images: &Images, sensor: &Sensor, output: Output, marks: &Marks<'_>) -> Result<Canvas> {
    let Marks { overlay, mask, given_up } = *marks;
    let (width, height) = (sensor.width(), sensor.height());
    let len = images.samples(output).map_or(0, |samples| samples.len());
    if len != width as usize * height as usize {
        return Err(Error::invalid(
            format!("the {} image has {len} pixels, the sensor {width} x {height}", output.name()),
            "request this output",
        ));
    }
    let scale = Scale::of(images, output);
    let mut palette = Palette::new(images, output, &scale);
    if let Some(mask) = mask {
        palette.mark(&mask.pixels);
    }
    if given_up.len() == len {
        palette.hatch(given_up, width);
    }
    Ok(if is_one_row_scan(sensor) && images.range.len() == len {
        polar::draw(images, sensor, output, &palette, &scale, overlay)
    } else {
        view::draw(images, sensor, output, &palette, &scale, overlay)
    })
}

fn is_one_row_scan(sensor: &Sensor) -> bool {
    sensor.height() == 1 && matches!(sensor.spec().geometry, Geometry::Scanner(_))
}

/// Approximate columns and rows of the image in a preview, without the text and scale around it.
pub fn preview_size(sensor: &Sensor) -> (u32, u32) {
    view::drawn_size(sensor)
}

/// The images that the preview of an output needs.
pub fn preview_needs(sensor: &Sensor, output: Output) -> Outputs {
    let places = if is_one_row_scan(sensor) { Output::Range } else { output };
    Outputs::of(&[output, Output::PolygonId, places])
}

/// The output that a depth image of a sensor shows: depth_z for a camera (REP-118), otherwise range.
pub fn depth_output(sensor: &Sensor) -> Output {
    if sensor.is_camera() { Output::DepthZ } else { Output::Range }
}

/// Writes a 16-bit grey image in millimetres, 0 where there is no value (REP-118): nothing hit, too near, no ray,
/// or beyond the 65.535 m that 16 bits can hold. Returns a notice if the last case occurs.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the image of [`depth_output`] is missing,
/// [`presight_model::ErrorKind::System`] if the file cannot be written.
pub fn write_depth(path: &Path, images: &Images, sensor: &Sensor) -> Result<Vec<String>> {
    let output = depth_output(sensor);
    let Some(metres) = images.floats(output).filter(|image| image.len() == images.pixels()) else {
        return Err(Error::invalid(format!("there is no {} image", output.name()), "request it").in_file(path));
    };
    let (millimetres, beyond) = to_millimetres(metres);
    let bytes: Vec<u8> = millimetres.iter().flat_map(|mm| mm.to_be_bytes()).collect();
    write_atomically(path, |file| {
        encode(BufWriter::new(file), &bytes, images.width, images.height, PixelFormat::Grey16)
    })?;
    let notice = || "16-bit depth images: pixels beyond 65.535 m are written as 0".to_owned();
    Ok((beyond > 0).then(notice).into_iter().collect())
}

/// Writes a 16-bit grey image: 0 is black and 1 white, values outside are clamped, and NaN is black.
///
/// # Errors
/// [`presight_model::ErrorKind::System`] if the file cannot be written.
pub fn write_grey(path: &Path, image: &GreyImage) -> Result<()> {
    // The cast turns NaN into 0.
    let values = image.values().iter().map(|v| (v.clamp(0.0, 1.0) * f32::from(u16::MAX)).round() as u16);
    let bytes: Vec<u8> = values.flat_map(u16::to_be_bytes).collect();
    write_atomically(path, |file| {
        encode(BufWriter::new(file), &bytes, image.width(), image.height(), PixelFormat::Grey16)
    })
}

/// Writes a mask with marked pixels white and the others black, in the pixel order of the images.
///
/// # Errors
/// [`presight_model::ErrorKind::System`] if the file cannot be written.
pub fn write_mask(path: &Path, mask: &Mask) -> Result<()> {
    let bytes: Vec<u8> = mask.pixels.iter().map(|on| if *on { u8::MAX } else { 0 }).collect();
    write_atomically(path, |file| encode(BufWriter::new(file), &bytes, mask.width, mask.height, PixelFormat::Grey8))
}

/// Rounded millimetres, and the number of finite values that did not fit.
fn to_millimetres(metres: &[f32]) -> (Vec<u16>, usize) {
    let mut beyond = 0;
    let convert = |m: &f32| {
        let mm = (f64::from(*m) * 1e3).round();
        if mm > f64::from(u16::MAX) && mm.is_finite() {
            beyond += 1;
        }
        if (1.0..=f64::from(u16::MAX)).contains(&mm) { mm as u16 } else { 0 }
    };
    (metres.iter().map(convert).collect(), beyond)
}

#[cfg(test)]
mod tests;
