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
/// Distance around the robot that is drawn at least, metres.
const ARROW: f64 = 0.3;
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
    /// Side of a cell, metres.
    pub side: f64,
    /// Minimum corner of the first cell, metres in the corridor's frame.
    pub origin: [f64; 2],
    /// Position and yaw of the robot in the corridor's frame, metres and radians, if they are known.
    pub robot: Option<[f64; 3]>,
    /// Row by row from the least y: shares of the height of the cells there that are free, known, intruded and unseen;
    /// `None` outside of the corridor. They are drawn side by side.
    pub cells: &'a [Option<[f64; 4]>],
}

/// Writes a corridor from above, x to the right and y upwards, with a legend, a scale, and the robot with its heading. A
/// robot that is farther from the corridor than this is long is left out.
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
    let (robot, [left, right, below, above]) = room_for_robot(picture, rows);
    let (all_columns, all_rows) = (left + picture.columns + right, below + rows + above);
    let side = (SIDE / all_rows.max(all_columns)).clamp(1, 32);
    let (width, height) = (all_columns * side, all_rows * side);
    let mut canvas = Canvas::new(width.max(NARROWEST) + 2 * MARGIN, 2 * MARGIN + 3 * HEADER + height + TEXT_HEIGHT);
    canvas.text(MARGIN, MARGIN, picture.title, INK);
    let top = MARGIN + HEADER;
    for (i, shares) in picture.cells.iter().enumerate() {
        let Some(shares) = shares else { continue };
        let (column, row) = (i as u32 % picture.columns, i as u32 / picture.columns);
        let (x, y) = (MARGIN + (left + column) * side, top + (above + rows - 1 - row) * side);
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
    draw_scale(&mut canvas, f64::from(side) / picture.side, [MARGIN, y + HEADER], width.max(NARROWEST));
    if let Some([column, row, yaw]) = robot {
        let page = |column: f64, row: f64| {
            let (x, y) = (f64::from(left) + column, f64::from(above + rows) - row);
            [f64::from(MARGIN) + x * f64::from(side), f64::from(top) + y * f64::from(side)]
        };
        draw_robot(&mut canvas, page(column, row), yaw);
    }
    canvas
}

/// Column, row and yaw of the robot, and the cells that are added to the left, right, bottom and top to show it.
fn room_for_robot(picture: &CorridorPicture<'_>, rows: u32) -> (Option<[f64; 3]>, [u32; 4]) {
    let Some([x, y, yaw]) = picture.robot else { return (None, [0; 4]) };
    let [column, row] = [(x - picture.origin[0]) / picture.side, (y - picture.origin[1]) / picture.side];
    let (columns, rows) = (f64::from(picture.columns), f64::from(rows));
    let around = ARROW / picture.side;
    let added = [around - column, column + around - columns, around - row, row + around - rows];
    if !added.iter().all(|cells| *cells <= columns.max(rows) + around) {
        return (None, [0; 4]);
    }
    (Some([column, row, yaw]), added.map(|cells| cells.max(0.0).ceil() as u32))
}

/// A bar of a round length, and the length.
fn draw_scale(canvas: &mut Canvas, pixels_per_metre: f64, [x, y]: [u32; 2], width: u32) {
    let lengths = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0];
    let fits = |length: &&f64| *length * pixels_per_metre <= f64::from(width) / 3.0;
    let length = lengths.iter().rev().find(fits).unwrap_or(&lengths[0]);
    let long = (length * pixels_per_metre).round().max(1.0) as u32;
    canvas.fill(x, y + TEXT_HEIGHT / 2, long, 2, INK);
    canvas.text(x + long + 6, y, &format!("{length} m"), FAINT);
}

/// A disc at the robot's position, and an arrow along its heading.
fn draw_robot(canvas: &mut Canvas, [x, y]: [f64; 2], yaw: f64) {
    let at = |along: f64, left: f64| {
        let (sin, cos) = yaw.sin_cos();
        [x + along * cos - left * sin, y - along * sin - left * cos]
    };
    canvas.disc([x, y], 4.0, INK);
    canvas.stroke([x, y], at(22.0, 0.0), 1.5, INK);
    for left in [-5.0, 5.0] {
        canvas.stroke(at(22.0, 0.0), at(15.0, left), 1.5, INK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_have_the_colours_of_their_states() {
        let pure = |k: usize| Some(std::array::from_fn(|i| f64::from(u8::from(i == k))));
        let cells = [pure(0), pure(1), pure(2), pure(3), Some([0.5, 0.0, 0.0, 0.5]), None];
        let picture =
            CorridorPicture { title: "corridor", columns: 3, side: 0.1, origin: [0.0; 2], robot: None, cells: &cells };
        let canvas = draw(&picture, 2);
        let at = |column: u32, row: u32, part: u32| {
            canvas.get((MARGIN + column * 32 + part).into(), (MARGIN + HEADER + row * 32 + 16).into())
        };
        for (k, (column, row)) in [(0, 1), (1, 1), (2, 1), (0, 0)].into_iter().enumerate() {
            assert_eq!(at(column, row, 16), STATES[k].1, "{k}");
        }
        assert_eq!((at(1, 0, 4), at(1, 0, 28)), (STATES[0].1, STATES[3].1));
        assert_eq!(at(2, 0, 16), super::super::canvas::PAGE);
        // A robot 0.1 m before the corridor, which looks along y: three cells and one more are added to the left, and
        // one below and above.
        let shown = CorridorPicture { robot: Some([-0.1, 0.1, std::f64::consts::FRAC_PI_2]), ..picture };
        let (robot, added) = room_for_robot(&shown, 2);
        assert_eq!(
            (robot.map(|[column, row, _]| [column.round(), row.round()]), added),
            (Some([-1.0, 1.0]), [4, 0, 2, 2])
        );
        let canvas = draw(&shown, 2);
        let (x, y) = (i64::from(MARGIN) + 3 * 32, i64::from(MARGIN + HEADER) + 3 * 32);
        assert_eq!([canvas.get(x, y), canvas.get(x, y - 18)], [INK; 2], "the robot looks up");
        assert_ne!(canvas.get(x + 18, y), INK);
        let far = CorridorPicture { robot: Some([-9.0, 0.0, 0.0]), ..picture };
        assert_eq!(room_for_robot(&far, 2), (None, [0; 4]));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("corridor.png");
        write_corridor(&path, &picture).unwrap();
        assert_eq!(&std::fs::read(&path).unwrap()[1..4], b"PNG");
        assert!(write_corridor(&path, &CorridorPicture { columns: 4, ..picture }).is_err());
    }
}
