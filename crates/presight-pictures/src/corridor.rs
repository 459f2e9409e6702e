//! A supervised corridor, seen from above.

use super::canvas::{Canvas, FAINT, INK, Rgb, TEXT_HEIGHT, text_width};
use super::png::{PixelFormat, encode};
use super::view::{HEADER, MARGIN, NARROWEST};
use super::write_atomically;
use presight_model::error::{Error, Result};
use std::io::BufWriter;
use std::path::Path;

/// Approximate length of the longer side of the corridor, pixels.
const SIDE: u32 = 800;
/// Names and colours of the states, in the order of the shares.
const STATES: [(&str, Rgb); 4] = [
    ("free", [0x3f, 0xa7, 0x5c]),
    ("known", [0x4a, 0x86, 0xd8]),
    ("intruded", [0xe0, 0x3b, 0x3b]),
    ("unseen", [0x58, 0x5e, 0x6a]),
];

/// A corridor from above.
#[derive(Clone, Copy, Debug)]
pub struct CorridorPicture<'a> {
    /// A line above it.
    pub title: &'a str,
    /// Cells along x.
    pub columns: u32,
    /// Row by row from the least y: shares of the height of the cells there that are free, known, intruded and unseen;
    /// `None` outside of the corridor. They are drawn side by side.
    pub cells: &'a [Option<[f64; 4]>],
}

/// Writes a corridor from above, x to the right and y upwards, with a legend.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if cells do not fill whole rows, or there are more than 65,535 along a side;
/// [`presight_model::ErrorKind::System`] if the file cannot be written.
pub fn write_corridor(path: &Path, picture: &CorridorPicture<'_>) -> Result<()> {
    let rows = picture.cells.len().checked_div(picture.columns as usize).unwrap_or(0);
    let whole = rows > 0 && rows * picture.columns as usize == picture.cells.len();
    if !whole || rows.max(picture.columns as usize) > usize::from(u16::MAX) {
        let what = format!("a corridor of {} cells in {} columns", picture.cells.len(), picture.columns);
        return Err(Error::invalid(what, "give whole rows, and at most 65,535 cells along a side").in_file(path));
    }
    let canvas = draw(picture, rows as u32);
    write_atomically(path, |file| {
        encode(BufWriter::new(file), canvas.bytes(), canvas.width(), canvas.height(), PixelFormat::Rgb8)
    })
}

fn draw(picture: &CorridorPicture<'_>, rows: u32) -> Canvas {
    let side = (SIDE / rows.max(picture.columns)).clamp(1, 32);
    let (width, height) = (picture.columns * side, rows * side);
    let mut canvas = Canvas::new(width.max(NARROWEST) + 2 * MARGIN, 2 * MARGIN + 2 * HEADER + height + TEXT_HEIGHT);
    canvas.text(MARGIN, MARGIN, picture.title, INK);
    let top = MARGIN + HEADER;
    for (i, shares) in picture.cells.iter().enumerate() {
        let Some(shares) = shares else { continue };
        let (column, row) = (i as u32 % picture.columns, i as u32 / picture.columns);
        let (x, y) = (MARGIN + column * side, top + (rows - 1 - row) * side);
        let inner = if side > 4 { side - 1 } else { side };
        let (mut from, mut sum) = (0, 0.0);
        for (share, (_, color)) in shares.iter().zip(STATES) {
            sum += share;
            let to = (sum * f64::from(inner)).round().clamp(0.0, f64::from(inner)) as u32;
            canvas.fill(x + from, y, to.saturating_sub(from), inner, color);
            from = to.max(from);
        }
    }
    let (mut x, y) = (MARGIN, top + height + HEADER - TEXT_HEIGHT);
    for (name, color) in STATES {
        canvas.fill(x, y, TEXT_HEIGHT, TEXT_HEIGHT, color);
        canvas.text(x + TEXT_HEIGHT + 6, y, name, FAINT);
        x += TEXT_HEIGHT + 30 + text_width(name);
    }
    canvas
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_have_the_colours_of_their_states() {
        let pure = |k: usize| Some(std::array::from_fn(|i| f64::from(u8::from(i == k))));
        let cells = [pure(0), pure(1), pure(2), pure(3), Some([0.5, 0.0, 0.0, 0.5]), None];
        let picture = CorridorPicture { title: "corridor", columns: 3, cells: &cells };
        let canvas = draw(&picture, 2);
        let at = |column: u32, row: u32, part: u32| {
            canvas.get((MARGIN + column * 32 + part).into(), (MARGIN + HEADER + row * 32 + 16).into())
        };
        for (k, (column, row)) in [(0, 1), (1, 1), (2, 1), (0, 0)].into_iter().enumerate() {
            assert_eq!(at(column, row, 16), STATES[k].1, "{k}");
        }
        assert_eq!((at(1, 0, 4), at(1, 0, 28)), (STATES[0].1, STATES[3].1));
        assert_eq!(at(2, 0, 16), super::super::canvas::PAGE);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("corridor.png");
        write_corridor(&path, &picture).unwrap();
        assert_eq!(&std::fs::read(&path).unwrap()[1..4], b"PNG");
        assert!(write_corridor(&path, &CorridorPicture { columns: 4, ..picture }).is_err());
    }
}
