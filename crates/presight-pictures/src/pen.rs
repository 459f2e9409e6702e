//! Lines of features: solid where visible, dashed where hidden.

use super::canvas::{Canvas, PageRect, Rgb};

/// Visible parts.
pub const SEEN: Rgb = [0xff, 0x4f, 0xd8];
/// Hidden parts; ranges never have this colour.
pub const HIDDEN: Rgb = [0xff, 0x8f, 0x2e];
/// Regions of interest.
pub const REGION: Rgb = [0xf2, 0xf4, 0xf8];
/// Length of a dash and of a gap, page pixels.
const DASH: f64 = 7.0;

/// How a part of a feature is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Seen.
    Seen,
    /// Hidden.
    Hidden,
    /// Partly visible, without knowing which part.
    InPart,
}

impl Style {
    /// The style of visible or of hidden parts.
    pub fn of(seen: bool) -> Self {
        if seen { Self::Seen } else { Self::Hidden }
    }

    pub fn color(self) -> Rgb {
        if self == Self::Hidden { HIDDEN } else { SEEN }
    }
}

/// Draws consecutive lines; the dash pattern continues from one to the next.
pub struct Pen<'a> {
    pub canvas: &'a mut Canvas,
    pub frame: PageRect,
    pub style: Style,
    /// Length drawn so far, modulo the dash pattern.
    walked: f64,
}

impl<'a> Pen<'a> {
    pub fn new(canvas: &'a mut Canvas, frame: PageRect, style: Style) -> Self {
        Self { canvas, frame, style, walked: 0.0 }
    }

    /// Draws a single point.
    pub fn dot(&mut self, at: [f64; 2], radius: f64) {
        self.canvas.disc(at, radius, self.style.color());
    }

    /// Draws the part of a straight line inside the frame. The part outside costs nothing, however long.
    pub fn line(&mut self, a: [f64; 2], b: [f64; 2]) {
        let color = self.style.color();
        if self.style == Style::Seen {
            return self.canvas.stroke(a, b, 1.0, color);
        }
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        let at = |s: f64| [0, 1].map(|i| a[i] + s / length * (b[i] - a[i]));
        if let Some((from, to)) = self.frame.part_of_line(a, b, 1.0).filter(|_| length.is_finite() && length > 0.0) {
            let (mut done, end) = (from * length, to * length);
            while done < end {
                let phase = (self.walked + done) % (2.0 * DASH);
                let left = if phase < DASH { DASH - phase } else { 2.0 * DASH - phase };
                // Always advances: on a line from far outside, rounding may leave a dash no length.
                let next = (done + left.max(1e-3)).min(end);
                if phase < DASH {
                    self.canvas.stroke(at(done), at(next), 0.6, color);
                }
                done = next;
            }
        }
        self.walked = (self.walked + length) % (2.0 * DASH);
    }
}
