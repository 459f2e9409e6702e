//! Pixel masks and their outlines.

use serde::{Serialize, Serializer};

/// A set of pixels of an image.
///
/// Files store `runs`; each holds row, first column and number of pixels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mask {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// True for marked pixels, row-major.
    pub pixels: Vec<bool>,
}

/// Pixels connected by their sides.
///
/// Outlines follow pixel sides from corner to corner. Corner (i, j) is at the pixel coordinates i - 0.5, j - 0.5.
/// Marked pixels are on the left of the path as seen in the image, so outer outlines run counter-clockwise and holes
/// clockwise. Pixels that share only a corner are not connected. Outlines may touch there, but they never cross.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MaskRegion {
    /// Number of pixels.
    pub pixels: usize,
    /// Outer outline.
    pub outer: Vec<(u32, u32)>,
    /// Outlines of the holes.
    pub holes: Vec<Vec<(u32, u32)>>,
}

impl Serialize for Mask {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut runs: Vec<[u32; 3]> = Vec::new();
        for (row, pixels) in (0..).zip(self.pixels.chunks(self.width.max(1) as usize)) {
            for (column, _) in (0..).zip(pixels).filter(|(_, on)| **on) {
                match runs.last_mut() {
                    Some([r, first, count]) if *r == row && *first + *count == column => *count += 1,
                    _ => runs.push([row, column, 1]),
                }
            }
        }
        serializer.collect_map([("runs", runs)])
    }
}

/// Direction of a step along a pixel side in the image (columns to the right, rows down).
#[derive(Clone, Copy, PartialEq, Eq)]
enum PixelSide {
    Right,
    Up,
    Left,
    Down,
}

impl PixelSide {
    fn step(self) -> (i64, i64) {
        match self {
            Self::Right => (1, 0),
            Self::Up => (0, -1),
            Self::Left => (-1, 0),
            Self::Down => (0, 1),
        }
    }

    fn turned_left(self) -> Self {
        match self {
            Self::Right => Self::Up,
            Self::Up => Self::Left,
            Self::Left => Self::Down,
            Self::Down => Self::Right,
        }
    }

    fn turned_right(self) -> Self {
        self.turned_left().turned_left().turned_left()
    }

    /// The pixels ahead of a corner, left and right of the path, relative to the corner.
    fn ahead(self) -> [(i64, i64); 2] {
        match self {
            Self::Right => [(0, -1), (0, 0)],
            Self::Up => [(-1, -1), (0, -1)],
            Self::Left => [(-1, 0), (-1, -1)],
            Self::Down => [(0, 0), (-1, 0)],
        }
    }
}

impl Mask {
    /// An empty mask.
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, pixels: vec![false; width as usize * height as usize] }
    }

    /// Returns true if that pixel is inside the image and marked.
    pub fn has(&self, column: i64, row: i64) -> bool {
        let inside = (0..i64::from(self.width)).contains(&column) && (0..i64::from(self.height)).contains(&row);
        inside && self.pixels[row as usize * self.width as usize + column as usize]
    }

    /// Number of marked pixels.
    pub fn count(&self) -> usize {
        self.pixels.iter().filter(|on| **on).count()
    }

    /// Returns the connected regions with their outlines. Corners on straight lines need `every_corner`.
    ///
    /// ```
    /// use presight::virtual_sensors::Mask;
    /// let ring = Mask { width: 3, height: 3, pixels: [1, 1, 1, 1, 0, 1, 1, 1, 1].map(|on| on == 1).to_vec() };
    /// let regions = ring.regions(false);
    /// assert_eq!(regions[0].outer, [(0, 0), (0, 3), (3, 3), (3, 0)], "counter-clockwise, rows running down");
    /// assert_eq!(regions[0].holes, [[(2, 1), (2, 2), (1, 2), (1, 1)]]);
    /// ```
    #[doc(hidden)]
    pub fn regions(&self, every_corner: bool) -> Vec<MaskRegion> {
        let (labels, mut regions) = self.labels();
        // Every outline has a downward step along the left side of a pixel, so each starts there exactly once.
        let mut done = vec![false; self.pixels.len()];
        for start in 0..self.pixels.len() {
            let (column, row) = (start % self.width as usize, start / self.width as usize);
            if !self.pixels[start] || done[start] || self.has(column as i64 - 1, row as i64) {
                continue;
            }
            let outline = self.outline((column as i64, row as i64), every_corner, &mut done);
            let region = &mut regions[labels[start] as usize];
            // Rows run downward, so a counter-clockwise outline has a negative area.
            if doubled_area(&outline) < 0 { region.outer = outline } else { region.holes.push(outline) }
        }
        regions
    }

    /// Labels every marked pixel with its region.
    fn labels(&self) -> (Vec<u32>, Vec<MaskRegion>) {
        let mut labels = vec![u32::MAX; self.pixels.len()];
        let mut regions = Vec::new();
        let mut open = Vec::new();
        let width = self.width as usize;
        for start in 0..self.pixels.len() {
            if !self.pixels[start] || labels[start] != u32::MAX {
                continue;
            }
            let label = regions.len() as u32;
            regions.push(MaskRegion::default());
            labels[start] = label;
            open.push(start);
            while let Some(at) = open.pop() {
                regions[label as usize].pixels += 1;
                let column = at % width;
                let beside = [
                    (column > 0).then(|| at - 1),
                    (column + 1 < width).then_some(at + 1),
                    at.checked_sub(width),
                    (at + width < self.pixels.len()).then_some(at + width),
                ];
                for next in beside.into_iter().flatten() {
                    if self.pixels[next] && labels[next] == u32::MAX {
                        labels[next] = label;
                        open.push(next);
                    }
                }
            }
        }
        (labels, regions)
    }

    /// Follows an outline downward from the top left corner of a pixel; `done` marks the left sides passed.
    fn outline(&self, pixel: (i64, i64), every_corner: bool, done: &mut [bool]) -> Vec<(u32, u32)> {
        let mut corners = Vec::new();
        let (mut at, mut side) = (pixel, PixelSide::Down);
        loop {
            if side == PixelSide::Down {
                done[at.1 as usize * self.width as usize + at.0 as usize] = true;
            }
            let (dx, dy) = side.step();
            at = (at.0 + dx, at.1 + dy);
            let [left, right] = side.ahead().map(|(dx, dy)| self.has(at.0 + dx, at.1 + dy));
            let next = match (left, right) {
                (false, _) => side.turned_left(),
                (true, false) => side,
                (true, true) => side.turned_right(),
            };
            if next != side || every_corner {
                corners.push((at.0 as u32, at.1 as u32));
            }
            side = next;
            if at == pixel && side == PixelSide::Down {
                // Put the starting corner first.
                corners.rotate_right(1);
                return corners;
            }
        }
    }
}

fn doubled_area(outline: &[(u32, u32)]) -> i64 {
    let n = outline.len();
    let cross = |k: usize| {
        let ((x0, y0), (x1, y1)) = (outline[k], outline[(k + 1) % n]);
        i64::from(x0) * i64::from(y1) - i64::from(x1) * i64::from(y0)
    };
    (0..n).map(cross).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mask(rows: &[&str]) -> Mask {
        let pixels = rows.iter().flat_map(|row| row.bytes().map(|b| b == b'#')).collect();
        Mask { width: rows[0].len() as u32, height: rows.len() as u32, pixels }
    }

    #[test]
    fn corners_that_touch_do_not_join() {
        let regions = mask(&["#.", ".#"]).regions(false);
        assert_eq!(regions.len(), 2);
        assert_eq!(regions[0].outer, [(0, 0), (0, 1), (1, 1), (1, 0)]);
        assert!(regions.iter().all(|r| r.pixels == 1 && r.holes.is_empty()));
    }

    #[test]
    fn nothing_has_no_outline_and_runs_are_rows() {
        assert!(Mask::new(3, 2).regions(false).is_empty());
        let runs = serde_json::to_value(mask(&["##.#", "####"])).unwrap();
        assert_eq!(runs, serde_json::json!({"runs": [[0, 0, 2], [0, 3, 1], [1, 0, 4]]}));
    }

    #[test]
    fn a_straight_side_may_keep_its_corners() {
        assert_eq!(mask(&["##"]).regions(true)[0].outer.len(), 6);
    }

    proptest! {
        /// The signed areas of the outlines sum to the number of pixels, and every region has one outer outline.
        #[test]
        fn outlines_enclose_what_is_marked(width in 1..14u32, bits in prop::collection::vec(any::<bool>(), 1..180)) {
            let height = bits.len() as u32 / width;
            prop_assume!(height > 0);
            let pixels = bits[..(width * height) as usize].to_vec();
            let mask = Mask { width, height, pixels };
            for every_corner in [false, true] {
                let regions = mask.regions(every_corner);
                prop_assert_eq!(regions.iter().map(|r| r.pixels).sum::<usize>(), mask.count());
                for region in &regions {
                    let outer = -doubled_area(&region.outer);
                    let holes: i64 = region.holes.iter().map(|h| doubled_area(h)).sum();
                    prop_assert!(outer > 0 && region.holes.iter().all(|h| doubled_area(h) > 0));
                    prop_assert_eq!(outer - holes, 2 * region.pixels as i64);
                }
            }
        }
    }
}
