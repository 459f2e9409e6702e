//! A picture to draw on: 8-bit sRGB.

use super::font;
use super::pen::Stroke;

/// sRGB.
pub type Rgb = [u8; 3];

/// Background of the page.
pub const PAGE: Rgb = [0x15, 0x17, 0x1c];
/// Text and ticks.
pub const INK: Rgb = [0xc8, 0xcd, 0xd6];
/// Secondary text and lines.
pub const FAINT: Rgb = [0x6a, 0x72, 0x80];
/// Side of a font dot, pixels.
const TEXT_SCALE: u32 = 2;
/// Height of a line of text, pixels.
pub const TEXT_HEIGHT: u32 = font::HEIGHT * TEXT_SCALE;

/// A rectangle of pixels on the page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageRect {
    pub left: u32,
    pub top: u32,
    pub width: u32,
    pub height: u32,
}

impl PageRect {
    /// Left, top, right and bottom border.
    fn borders(self) -> [f64; 4] {
        [self.left, self.top, self.left + self.width, self.top + self.height].map(f64::from)
    }

    /// True for a point inside the rectangle, or at most `by` outside.
    pub fn holds(self, [x, y]: [f64; 2], by: f64) -> bool {
        let [left, top, right, bottom] = self.borders();
        (left - by..=right + by).contains(&x) && (top - by..=bottom + by).contains(&y)
    }

    /// The part of a straight line inside the rectangle or at most `by` outside, as fractions of the line.
    pub fn part_of_line(self, a: [f64; 2], b: [f64; 2], by: f64) -> Option<(f64, f64)> {
        let [left, top, right, bottom] = self.borders();
        let (mut from, mut to) = (0.0f64, 1.0f64);
        for (start, along, low, high) in
            [(a[0], b[0] - a[0], left - by, right + by), (a[1], b[1] - a[1], top - by, bottom + by)]
        {
            if along == 0.0 {
                if !(low..=high).contains(&start) {
                    return None;
                }
                continue;
            }
            let (t, u) = ((low - start) / along, (high - start) / along);
            (from, to) = (from.max(t.min(u)), to.min(t.max(u)));
        }
        // False for NaN.
        (from <= to).then_some((from, to))
    }
}

/// An RGB picture; drawing is clipped to it.
pub struct Canvas {
    width: u32,
    height: u32,
    bytes: Vec<u8>,
    /// The current clipping rectangle.
    frame: PageRect,
    /// Lines of features that are kept in place of being drawn.
    pub strokes: Option<Vec<Stroke>>,
}

impl Canvas {
    /// A blank page.
    pub fn new(width: u32, height: u32) -> Self {
        let bytes = PAGE.repeat(width as usize * height as usize);
        Self { width, height, bytes, frame: PageRect { left: 0, top: 0, width, height }, strokes: None }
    }

    /// A page that keeps the lines of features and draws nothing.
    pub fn of_strokes() -> Self {
        Self { strokes: Some(Vec::new()), ..Self::new(0, 0) }
    }

    /// Clips drawing to a frame.
    pub fn inside(&mut self, frame: PageRect, draw: impl FnOnce(&mut Self)) {
        let before = std::mem::replace(&mut self.frame, frame);
        draw(self);
        self.frame = before;
    }

    pub fn width(&self) -> u32 {
        self.width
    }

    pub fn height(&self) -> u32 {
        self.height
    }

    /// Row-major RGB.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    pub fn set(&mut self, x: i64, y: i64, color: Rgb) {
        let PageRect { left, top, width, height } = self.frame;
        let framed = |v: i64, from: u32, size: u32| (i64::from(from)..i64::from(from + size)).contains(&v);
        if framed(x, left, width)
            && framed(y, top, height)
            && let Some(at) = self.index(x, y)
        {
            self.bytes[at..at + 3].copy_from_slice(&color);
        }
    }

    /// The colour of a pixel; outside the picture, that of the page.
    pub fn get(&self, x: i64, y: i64) -> Rgb {
        self.index(x, y).map_or(PAGE, |at| [self.bytes[at], self.bytes[at + 1], self.bytes[at + 2]])
    }

    fn index(&self, x: i64, y: i64) -> Option<usize> {
        let inside = (0..i64::from(self.width)).contains(&x) && (0..i64::from(self.height)).contains(&y);
        inside.then(|| (y as usize * self.width as usize + x as usize) * 3)
    }

    pub fn fill(&mut self, x: u32, y: u32, width: u32, height: u32, color: Rgb) {
        for row in y..y + height {
            for column in x..x + width {
                self.set(column.into(), row.into(), color);
            }
        }
    }

    /// Draws a disc with an anti-aliased edge.
    pub fn disc(&mut self, center: [f64; 2], radius: f64, color: Rgb) {
        let reach = radius.ceil() as i64 + 1;
        if !self.frame.holds(center, reach as f64) {
            return;
        }
        let (cx, cy) = (center[0].round() as i64, center[1].round() as i64);
        for y in cy - reach..=cy + reach {
            for x in cx - reach..=cx + reach {
                let away = (x as f64 - center[0]).hypot(y as f64 - center[1]);
                let cover = (radius + 0.5 - away).clamp(0.0, 1.0);
                if cover > 0.0 {
                    self.set(x, y, mix(self.get(x, y), color, cover));
                }
            }
        }
    }

    /// Draws a line as a row of discs.
    pub fn stroke(&mut self, from: [f64; 2], to: [f64; 2], radius: f64, color: Rgb) {
        let Some((start, end)) = self.frame.part_of_line(from, to, radius + 1.0) else { return };
        let at = |t: f64| [0, 1].map(|i| from[i] + t * (to[i] - from[i]));
        let (from, to) = (at(start), at(end));
        let steps = (to[0] - from[0]).hypot(to[1] - from[1]).ceil().max(1.0);
        for i in 0..=steps as u32 {
            let t = f64::from(i) / steps;
            let point = [from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])];
            self.disc(point, radius, color);
        }
    }

    /// Draws a line of text with its top left corner at `x`, `y`.
    pub fn text(&mut self, x: u32, y: u32, text: &str, color: Rgb) {
        for (i, c) in text.chars().enumerate() {
            let left = x + i as u32 * font::ADVANCE * TEXT_SCALE;
            for (column, row) in font::dots(c) {
                self.fill(left + column * TEXT_SCALE, y + row * TEXT_SCALE, TEXT_SCALE, TEXT_SCALE, color);
            }
        }
    }
}

/// Width of a line of text, pixels.
pub fn text_width(text: &str) -> u32 {
    (text.chars().count() as u32 * font::ADVANCE).saturating_sub(1) * TEXT_SCALE
}

/// Blends from `a` (share 0) to `b` (share 1).
pub fn mix(a: Rgb, b: Rgb, share: f64) -> Rgb {
    std::array::from_fn(|i| (f64::from(a[i]) + share * (f64::from(b[i]) - f64::from(a[i]))).round() as u8)
}
