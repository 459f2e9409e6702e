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

/// The style of a part of a feature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Style {
    /// Seen.
    Seen,
    /// Hidden.
    Hidden,
    /// Partly visible, without knowing which part.
    InPart,
    /// A region of interest.
    Region,
}

impl Style {
    /// The style of visible or of hidden parts.
    pub fn of(seen: bool) -> Self {
        if seen { Self::Seen } else { Self::Hidden }
    }

    pub(crate) fn color(self) -> Rgb {
        match self {
            Self::Hidden => HIDDEN,
            Self::Region => REGION,
            Self::Seen | Self::InPart => SEEN,
        }
    }

    /// The name for programs that draw.
    pub fn name(self) -> &'static str {
        match self {
            Self::Seen => "seen",
            Self::Hidden => "hidden",
            Self::InPart => "in_part",
            Self::Region => "region",
        }
    }
}

/// A line of a feature, for programs that draw over a picture themselves.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Stroke {
    /// The feature's id.
    pub feature: u32,
    /// The state of the feature there.
    pub style: Style,
    /// Its corners on the picture, pixels from the top left. A single one is a dot.
    pub points: Vec<[f32; 2]>,
}

/// Draws consecutive lines; the dash pattern continues from one to the next.
pub struct Pen<'a> {
    pub canvas: &'a mut Canvas,
    pub frame: PageRect,
    pub style: Style,
    /// Id of the feature.
    feature: u32,
    /// Length drawn so far, modulo the dash pattern.
    walked: f64,
}

impl<'a> Pen<'a> {
    pub fn new(canvas: &'a mut Canvas, frame: PageRect, style: Style) -> Self {
        Self { canvas, frame, style, feature: 0, walked: 0.0 }
    }

    /// A pen for the lines of a feature.
    pub fn of(canvas: &'a mut Canvas, frame: PageRect, style: Style, feature: u32) -> Self {
        Self { feature, ..Self::new(canvas, frame, style) }
    }

    /// Draws a single point.
    pub fn dot(&mut self, at: [f64; 2], radius: f64) {
        if let Some(strokes) = &mut self.canvas.strokes {
            let points = vec![at.map(|c| c as f32)];
            return strokes.push(Stroke { feature: self.feature, style: self.style, points });
        }
        self.canvas.disc(at, radius, self.style.color());
    }

    /// Draws the part of a straight line inside the frame. The part outside costs nothing, however long.
    pub fn line(&mut self, a: [f64; 2], b: [f64; 2]) {
        let color = self.style.color();
        if self.canvas.strokes.is_some() {
            return self.trace(a, b);
        }
        match self.style {
            Style::Seen => return self.canvas.stroke(a, b, 1.0, color),
            Style::Region => return self.canvas.stroke(a, b, 0.4, color),
            Style::Hidden | Style::InPart => {}
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

    /// Keeps the part of a line inside the frame; it continues the stroke before it if that ends here.
    fn trace(&mut self, a: [f64; 2], b: [f64; 2]) {
        let Some((from, to)) = self.frame.part_of_line(a, b, 1.0) else { return };
        let Some(strokes) = &mut self.canvas.strokes else { return };
        let at = |s: f64| [0, 1].map(|i| (a[i] + s * (b[i] - a[i])) as f32);
        let (start, end) = (at(from), at(to));
        match strokes.last_mut() {
            Some(last)
                if (last.feature, last.style) == (self.feature, self.style) && last.points.last() == Some(&start) =>
            {
                last.points.push(end);
            }
            _ => strokes.push(Stroke { feature: self.feature, style: self.style, points: vec![start, end] }),
        }
    }
}
