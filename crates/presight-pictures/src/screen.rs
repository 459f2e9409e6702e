//! What a program needs that draws predictions itself: the size of the picture, its scale, and the lines of features.

use super::canvas::{Canvas, PageRect};
use super::is_one_row_scan;
use super::overlay::Overlay;
use super::pen::Stroke;
use super::polar::{Map, hits};
use super::scale::Scale;
use super::top_view::draw_from_above;
use super::view::{HEADER, MARGIN, draw_features, drawn_size, is_mirrored};
use glam::DVec2;
use presight_model::sensor::Sensor;
use presight_render::plan::{Images, Output};

/// The picture of a prediction without title and scale bar, as [`super::write_preview`] draws it.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Screen {
    /// Columns and rows of the picture, pixels.
    pub size: [u32; 2],
    /// True if columns run from right to left.
    pub mirrored: bool,
    /// For a scan of one row, drawn from above: column and row of the sensor, and pixels per metre.
    pub above: Option<([f64; 2], f64)>,
    /// The scale of the colours.
    pub scale: Scale,
}

impl Screen {
    /// The picture of an output; a scan of one row also needs the range.
    pub fn new(images: &Images, sensor: &Sensor, output: Output) -> Self {
        let scale = Scale::of(images, output);
        if is_one_row_scan(sensor) && images.range.len() == images.pixels() {
            let map = Map::around(&hits(images, sensor));
            let origin = [map.origin[0] - f64::from(MARGIN), map.origin[1] - f64::from(MARGIN + HEADER)];
            return Self { size: map.size, mirrored: false, above: Some((origin, map.pixels_per_metre)), scale };
        }
        let (width, height) = drawn_size(sensor);
        Self { size: [width, height], mirrored: is_mirrored(sensor), above: None, scale }
    }

    /// The lines of features on the picture, hidden ones first, then the visible ones, then regions of interest.
    pub fn strokes(&self, overlay: &Overlay<'_>, images: &Images) -> Vec<Stroke> {
        let [width, height] = self.size;
        let frame = PageRect { left: 0, top: 0, width, height };
        let mut canvas = Canvas::of_strokes();
        match self.above {
            Some((origin, scale)) => draw_from_above(overlay, &mut canvas, frame, &images.range, &|p: DVec2| {
                [origin[0] - p.y * scale, origin[1] - p.x * scale]
            }),
            None => draw_features(&mut canvas, frame, overlay),
        }
        canvas.strokes.unwrap_or_default()
    }
}
