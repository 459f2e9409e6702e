//! Lines of features: solid where they are seen, dashed where they are hidden.

use super::canvas::{Canvas, PageRect, Rgb};

/// What is seen.
pub const SEEN: Rgb = [0xff, 0x4f, 0xd8];
/// What is hidden: none of the colours of ranges.
pub const HIDDEN: Rgb = [0xff, 0x8f, 0x2e];
/// Regions of interest.
pub const REGION: Rgb = [0xf2, 0xf4, 0xf8];
/// Dashes and the gaps between them, page pixels.
const DASH: f64 = 7.0;

/// How a part of a feature is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Seen.
    Seen,
    /// Hidden.
    Hidden,
    /// Seen in part, where that part is not known.
    InPart,
}

impl Style {
    /// Of what is seen or not.
    pub fn of(seen: bool) -> Self {
        if seen { Self::Seen } else { Self::Hidden }
    }

    pub fn color(self) -> Rgb {
        if self == Self::Hidden { HIDDEN } else { SEEN }
    }
}

/// Draws one line after another; dashes go on from each to the next.
pub struct Pen<'a> {
    pub canvas: &'a mut Canvas,
    pub frame: PageRect,
    pub style: Style,
    /// Length drawn so far, in dashes and gaps.
    walked: f64,
}

impl<'a> Pen<'a> {
    pub fn new(canvas: &'a mut Canvas, frame: PageRect, style: Style) -> Self {
        Self { canvas, frame, style, walked: 0.0 }
    }

    /// A place by itself.
    pub fn dot(&mut self, at: [f64; 2], radius: f64) {
        self.canvas.disc(at, radius, self.style.color());
    }

    /// A straight line, as far as it is in the frame: what is outside costs nothing, however long it is.
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
                // At least a step, whatever is left of a dash of a line that began far outside.
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
