//! Finds the parts of the image where a patch is seen: one box per cell of a grid over the patch's image.
//!
//! One box around all visible parts would include other surfaces that hide the patch between them. These may be much
//! nearer and move much faster in the image.

use glam::DVec2;

const CELLS: usize = 4;

/// Boxes around the visible parts, by cell.
pub(super) struct Windows {
    low: DVec2,
    /// Cells per pixel.
    scale: DVec2,
    found: [Option<[DVec2; 2]>; CELLS * CELLS],
}

impl Windows {
    /// A grid over these places in the unwrapped image. Places outside it belong to the cells at its border.
    pub fn new(places: impl Iterator<Item = DVec2>) -> Self {
        let (low, high) =
            places.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        let scale = CELLS as f64 / (high - low).max(DVec2::splat(1e-9));
        Self { low, scale, found: [None; CELLS * CELLS] }
    }

    /// The middle of the grid.
    pub fn middle(&self) -> DVec2 {
        self.low + 0.5 * CELLS as f64 / self.scale
    }

    /// Records that everything between two places is seen.
    pub fn reach(&mut self, from: DVec2, to: DVec2) {
        let [a, b] = [from, to].map(|p| (p - self.low) * self.scale);
        let mut cuts = [0.0; 2 * CELLS];
        let mut count = 1;
        for axis in 0..2 {
            for line in 1..CELLS {
                let share = (line as f64 - a[axis]) / (b[axis] - a[axis]);
                if share > 0.0 && share < 1.0 {
                    cuts[count] = share;
                    count += 1;
                }
            }
        }
        cuts[count] = 1.0;
        let cuts = &mut cuts[..=count];
        cuts.sort_unstable_by(f64::total_cmp);
        for pair in cuts.windows(2) {
            let number = |x: f64| (x.max(0.0) as usize).min(CELLS - 1);
            let middle = a.lerp(b, 0.5 * (pair[0] + pair[1]));
            let cell = &mut self.found[number(middle.y) * CELLS + number(middle.x)];
            let ends = [pair[0], pair[1]].map(|share| from.lerp(to, share));
            let [low, high] = cell.unwrap_or([ends[0]; 2]);
            *cell = Some([low.min(ends[0]).min(ends[1]), high.max(ends[0]).max(ends[1])]);
        }
    }

    /// The boxes of the cells with visible parts.
    pub fn into_seen(self) -> Vec<[DVec2; 2]> {
        self.found.into_iter().flatten().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A diagonal over 8 x 8 pixels is seen in four cells of 2 x 2 pixels, and in no others.
    #[test]
    fn windows_follow_what_is_seen() {
        let at = |x: f64, y: f64| DVec2::new(x, y);
        let mut windows = Windows::new([at(1.0, 2.0), at(9.0, 10.0)].into_iter());
        assert_eq!(windows.middle(), at(5.0, 6.0));
        windows.reach(at(1.0, 2.0), at(9.0, 10.0));
        let cells = [0.0, 2.0, 4.0, 6.0].map(|k| [at(1.0 + k, 2.0 + k), at(3.0 + k, 4.0 + k)]);
        assert_eq!(windows.into_seen(), cells);
        // A point, and a line that leaves the grid.
        let mut windows = Windows::new([at(1.0, 2.0), at(9.0, 10.0)].into_iter());
        windows.reach(at(8.5, 2.5), at(8.5, 2.5));
        windows.reach(at(8.0, 3.0), at(11.0, 3.0));
        assert_eq!(windows.into_seen(), [[at(8.0, 2.5), at(11.0, 3.0)]]);
    }
}
