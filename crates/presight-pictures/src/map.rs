//! Maps of values on a grid, seen from above.

use super::canvas::{Canvas, INK, PAGE};
use super::color::{MISS, TOO_NEAR, by_distance};
use super::png::{PixelFormat, encode};
use super::scale::Scale;
use super::view::{FOOTER, HEADER, MARGIN, bar};
use super::write_atomically;
use presight_model::error::{Error, Result};
use std::io::BufWriter;
use std::path::Path;

/// Approximate length of the longer side of a map, pixels.
const SIDE: u32 = 640;
/// Minimum page width that holds titles and scales, pixels.
const NARROWEST: u32 = 360;

/// Values on a grid.
#[derive(Clone, Copy, Debug)]
pub struct GridMap<'a> {
    /// The name of the quantity.
    pub title: &'a str,
    /// The unit of the values.
    pub unit: &'a str,
    /// Cells along x.
    pub columns: u32,
    /// Row by row from the least y. NaN means no value; infinite values are red.
    pub values: &'a [f64],
}

/// Writes maps below each other, x to the right and y upwards. Each has its own scale: the least values are yellow, the
/// greatest violet, and infinite ones red.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if values do not fill whole rows, or a map has more than 65,535 cells along a
/// side; [`presight_model::ErrorKind::System`] if the file cannot be written.
pub fn write_maps(path: &Path, maps: &[GridMap<'_>]) -> Result<()> {
    for map in maps {
        let rows = map.values.len().checked_div(map.columns as usize).unwrap_or(0);
        let whole = rows > 0 && rows * map.columns as usize == map.values.len();
        if !whole || rows.max(map.columns as usize) > usize::from(u16::MAX) {
            let what = format!("a map of {} values in {} columns", map.values.len(), map.columns);
            return Err(Error::invalid(what, "give whole rows, and at most 65,535 cells along a side").in_file(path));
        }
    }
    let canvas = draw(maps);
    write_atomically(path, |file| {
        encode(BufWriter::new(file), canvas.bytes(), canvas.width(), canvas.height(), PixelFormat::Rgb8)
    })
}

/// Columns, rows, and the side of a cell in pixels.
fn size(map: &GridMap<'_>) -> [u32; 3] {
    let rows = map.values.len() as u32 / map.columns;
    [map.columns, rows, (SIDE / rows.max(map.columns)).clamp(1, 32)]
}

fn draw(maps: &[GridMap<'_>]) -> Canvas {
    let height = |map: &GridMap<'_>| {
        let [_, rows, cell] = size(map);
        MARGIN + HEADER + rows * cell + FOOTER
    };
    let width = maps.iter().map(|map| size(map)[0] * size(map)[2]).fold(NARROWEST, u32::max);
    let mut canvas = Canvas::new(width + 2 * MARGIN, maps.iter().map(height).sum::<u32>() + MARGIN);
    let mut top = 0;
    for map in maps {
        let [columns, rows, cell] = size(map);
        let scale = Scale::of_values(map.values.iter().map(|v| *v as f32));
        canvas.text(MARGIN, top + MARGIN, map.title, INK);
        let first = top + MARGIN + HEADER;
        for row in 0..rows {
            for column in 0..columns {
                let value = map.values[(row * columns + column) as usize];
                let color = match value {
                    v if v.is_nan() => MISS,
                    v if v.is_infinite() => TOO_NEAR,
                    v => by_distance(scale.share(v)),
                };
                let (x, y) = (MARGIN + column * cell, first + (rows - 1 - row) * cell);
                canvas.fill(x, y, cell, cell, color);
                if cell > 4 && !value.is_nan() {
                    canvas.fill(x + cell - 1, y, 1, cell, PAGE);
                    canvas.fill(x, y + cell - 1, cell, 1, PAGE);
                }
            }
        }
        bar(&mut canvas, first + rows * cell + MARGIN, (columns * cell).max(NARROWEST), &scale, map.unit, by_distance);
        top += height(map);
    }
    canvas
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two columns and rows: the least value lower left, nothing upper right.
    #[test]
    fn maps_show_each_place_where_it_is() {
        let values = [1.0, 10.0, f64::INFINITY, f64::NAN];
        let map = GridMap { title: "position", unit: "m", columns: 2, values: &values };
        let canvas = draw(&[map, map]);
        let cell = 32;
        let at = |column: u32, row: u32| {
            let (x, y) = (MARGIN + column * cell + cell / 2, MARGIN + HEADER + row * cell + cell / 2);
            canvas.get(x.into(), y.into())
        };
        assert_eq!([at(0, 1), at(1, 1), at(0, 0), at(1, 0)], [by_distance(0.0), by_distance(1.0), TOO_NEAR, MISS]);
        assert!(canvas.height() > 2 * (MARGIN + HEADER + 2 * cell));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.png");
        write_maps(&path, &[map]).unwrap();
        assert_eq!(&std::fs::read(&path).unwrap()[1..4], b"PNG");
        let odd = GridMap { columns: 3, ..map };
        assert!(write_maps(&path, &[odd]).unwrap_err().to_string().contains("4 values in 3 columns"));
        assert!(write_maps(&path, &[GridMap { columns: 0, ..map }]).is_err());
    }
}
