//! Sorts points into bins, so that a box query need not test all points.

use glam::DVec2;

/// Maximum number of bins per axis.
const SIDE: usize = 64;

/// Items sorted by their points into bins over the bounding box.
#[derive(Debug, Default)]
pub(super) struct Bins<T> {
    low: DVec2,
    /// Bins per pixel.
    rate: DVec2,
    counts: [usize; 2],
    /// Index of each bin's first item in `items`, and the total as last entry.
    starts: Vec<u32>,
    items: Vec<T>,
}

impl<T: Copy + Default> Bins<T> {
    /// Bins of the points, which must be finite. If the points are uniform, each bin holds about four.
    pub fn new(points: &[(T, DVec2)]) -> Self {
        if points.is_empty() {
            return Self::default();
        }
        let low = points.iter().fold(DVec2::INFINITY, |low, (_, p)| low.min(*p));
        let high = points.iter().fold(DVec2::NEG_INFINITY, |high, (_, p)| high.max(*p));
        let side = ((points.len() as f64 / 4.0).sqrt().ceil() as usize).clamp(1, SIDE);
        let rate = DVec2::splat(side as f64) / (high - low).max(DVec2::splat(1e-9));
        let mut bins = Self { low, rate, counts: [side; 2], starts: vec![0; side * side + 1], items: Vec::new() };
        let of: Vec<usize> = points.iter().map(|(_, p)| bins.bin(*p)).collect();
        for bin in &of {
            bins.starts[bin + 1] += 1;
        }
        for i in 1..bins.starts.len() {
            bins.starts[i] += bins.starts[i - 1];
        }
        let mut next = bins.starts.clone();
        bins.items = vec![T::default(); points.len()];
        for (bin, (item, _)) in of.into_iter().zip(points) {
            bins.items[next[bin] as usize] = *item;
            next[bin] += 1;
        }
        bins
    }

    fn column(&self, x: f64, axis: usize) -> usize {
        // The cast saturates: negative values become 0.
        (((x - self.low[axis]) * self.rate[axis]) as usize).min(self.counts[axis] - 1)
    }

    fn bin(&self, p: DVec2) -> usize {
        self.column(p.y, 1) * self.counts[0] + self.column(p.x, 0)
    }

    /// Calls `call` with every item in the bins that the box touches.
    pub fn each_near(&self, [x0, y0, x1, y1]: [f64; 4], mut call: impl FnMut(T)) {
        if self.items.is_empty() {
            return;
        }
        let [left, right] = [x0, x1].map(|x| self.column(x, 0));
        for row in self.column(y0, 1)..=self.column(y1, 1) {
            let from = self.starts[row * self.counts[0] + left] as usize;
            let to = self.starts[row * self.counts[0] + right + 1] as usize;
            self.items[from..to.max(from)].iter().for_each(|i| call(*i));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;

    #[test]
    fn no_point_of_a_box_is_missed() {
        let mut random = SplitMix64(3);
        for count in [0, 1, 2, 50, 3000] {
            let points: Vec<(u32, DVec2)> =
                (0..count).map(|i| (i, DVec2::new(640.0 * random.unit(), 480.0 * random.unit()))).collect();
            let bins = Bins::new(&points);
            for _ in 0..200 {
                let a = DVec2::new(900.0 * random.unit() - 100.0, 700.0 * random.unit() - 100.0);
                let b = a + DVec2::new(80.0 * random.unit(), 80.0 * random.unit());
                let mut near = Vec::new();
                bins.each_near([a.x, a.y, b.x, b.y], |i| near.push(i));
                for (i, p) in &points {
                    let inside = p.x >= a.x && p.x <= b.x && p.y >= a.y && p.y <= b.y;
                    assert!(!inside || near.contains(i));
                }
            }
        }
    }

    #[test]
    fn all_in_one_place_is_one_bin() {
        let points: Vec<(u32, DVec2)> = (0..1000u32).map(|i| (i, DVec2::splat(7.0))).collect();
        let mut near = 0;
        Bins::new(&points).each_near([6.0, 6.0, 8.0, 8.0], |_| near += 1);
        assert_eq!(near, 1000);
    }
}
