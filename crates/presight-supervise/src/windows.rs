//! Free distances in windows of an image, by the second farthest ray of each window.
//!
//! A single ray is not evidence, because a pixel at an edge mixes two distances and seems to pass the nearer one.

use std::collections::HashMap;

/// Windows of 2^a x 2^b pixels over an image.
pub struct Windows<'a> {
    /// Free distance of each ray, metres; 0 if unknown.
    through: &'a [f32],
    width: usize,
    height: usize,
    is_closed: bool,
    levels: HashMap<[u32; 2], Level>,
}

/// The farthest and the second farthest ray of the window that begins at each pixel.
struct Level {
    first: Vec<f32>,
    second: Vec<f32>,
}

/// The size of windows for a number of pixels: the exponent of a power of two, and the step between windows with which
/// every interval of this number of pixels contains a complete window.
pub fn level_and_step(pixels: usize) -> (u32, usize) {
    let level = match pixels {
        0 | 1 => 0,
        2 => 1,
        _ => (pixels + 1).ilog2() - 1,
    };
    (level, pixels.max(1) + 1 - (1 << level))
}

impl<'a> Windows<'a> {
    pub fn new(through: &'a [f32], width: usize, is_closed: bool) -> Self {
        let height = through.len() / width.max(1);
        let levels = HashMap::from([([0, 0], Level { first: through.to_vec(), second: vec![0.0; through.len()] })]);
        Self { through, width, height, is_closed, levels }
    }

    /// Distance to which at least two rays of a window are free, metres. The window may begin outside of the image.
    pub fn second(&mut self, level: [u32; 2], column: i64, row: i64) -> f32 {
        let column = if self.is_closed { column.rem_euclid(self.width as i64) } else { column };
        if column >= self.width as i64 || row >= self.height as i64 {
            return 0.0;
        }
        if column < 0 || row < 0 {
            return self.second_of_part(level, column, row);
        }
        self.build(level);
        self.levels[&level].second[row as usize * self.width + column as usize]
    }

    /// [`Windows::second`] for a window that begins above the image or to its left.
    fn second_of_part(&self, [a, b]: [u32; 2], column: i64, row: i64) -> f32 {
        let mut best = [0.0f32; 2];
        for v in row.max(0)..(row + (1 << b)).min(self.height as i64) {
            for u in column..column + (1 << a) {
                let u = if self.is_closed { u.rem_euclid(self.width as i64) } else { u };
                if !(0..self.width as i64).contains(&u) {
                    continue;
                }
                best = merged(best, [self.through[v as usize * self.width + u as usize], 0.0]);
            }
        }
        best[1]
    }

    fn build(&mut self, [a, b]: [u32; 2]) {
        if self.levels.contains_key(&[a, b]) {
            return;
        }
        // The two halves along the longer side.
        let (half, by) =
            if a >= b { ([a - 1, b], [1usize << (a - 1), 0]) } else { ([a, b - 1], [0, 1usize << (b - 1)]) };
        self.build(half);
        let parts = &self.levels[&half];
        let mut level = Level { first: parts.first.clone(), second: parts.second.clone() };
        for row in 0..self.height.saturating_sub(by[1]) {
            let (to, from) = (row * self.width, (row + by[1]) * self.width);
            for column in 0..self.width {
                let mut other = column + by[0];
                if other >= self.width {
                    if !self.is_closed {
                        break;
                    }
                    other %= self.width;
                }
                let (i, j) = (to + column, from + other);
                let [first, second] = merged([parts.first[i], parts.second[i]], [parts.first[j], parts.second[j]]);
                (level.first[i], level.second[i]) = (first, second);
            }
        }
        self.levels.insert([a, b], level);
    }
}

#[inline]
fn merged(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].max(b[0]), a[0].min(b[0]).max(a[1].max(b[1]))]
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;

    #[test]
    fn windows_have_their_second_farthest_ray() {
        let (width, height) = (13, 7);
        let mut random = SplitMix64(5);
        let through: Vec<f32> = (0..width * height).map(|_| random.unit() as f32).collect();
        for is_closed in [false, true] {
            let mut windows = Windows::new(&through, width, is_closed);
            for (a, b) in (0..4).flat_map(|a| (0..3).map(move |b| (a, b))).filter(|level| *level != (0, 0)) {
                for (u, v) in (-9..16).flat_map(|u| (-5..9).map(move |v| (u, v))) {
                    let mut held = Vec::new();
                    for (x, y) in (u..u + (1 << a)).flat_map(|x| (v..v + (1 << b)).map(move |y| (x, y))) {
                        let x = if is_closed { i64::rem_euclid(x, 13) } else { x };
                        if (0..13).contains(&x) && (0..7).contains(&y) {
                            held.push(through[y as usize * width + x as usize]);
                        }
                    }
                    held.sort_by(|p, q| q.total_cmp(p));
                    let expected = held.get(1).copied().unwrap_or(0.0);
                    assert_eq!(windows.second([a, b], u, v), expected, "{a} {b} at {u} {v}");
                }
            }
        }
    }

    #[test]
    fn every_interval_contains_a_window() {
        for pixels in 1..200usize {
            let (level, step) = level_and_step(pixels);
            let window = 1usize << level;
            assert!(window <= pixels && step >= 1, "{pixels}");
            // Windows begin at multiples of the step, and the worst interval begins one pixel later.
            assert!(step - 1 + window <= pixels || step == 1, "{pixels}: {window} every {step}");
        }
    }
}
