//! Finds the edges near a predicted one to a fraction of a pixel, by searching across it.

use super::lines::{EdgeFrame, FoundEdge, LineOptions, Step, StepNoise};
use glam::{DMat2, DVec2};
use presight_features::{SeenFeature, VisibleInterval};
use presight_model::environment::FeatureShape;
use presight_model::measured::GreyImage;

/// The predicted image of an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedEdge {
    /// Its visible ends as (column, row).
    pub ends: [DVec2; 2],
    /// Search distance across the edge on either side, pixels.
    pub reach: f64,
    /// The brighter side, if known: `Some(true)` for the right side of the direction from the first end to the second
    /// (rows grow downwards).
    pub is_right_brighter: Option<bool>,
}

impl ExpectedEdge {
    /// The visible parts of a predicted segment that are long enough. The search reaches `deviations` standard
    /// deviations across, plus a pixel for rounding and blur. Empty for other features, and for predictions without
    /// regions of interest, whose covariances are needed.
    pub fn of(seen: &SeenFeature, deviations: f64) -> Vec<Self> {
        Self::of_parts(seen, deviations).into_iter().map(|(_, expected)| expected).collect()
    }

    /// [`ExpectedEdge::of`] with the visible parts.
    pub(super) fn of_parts(seen: &SeenFeature, deviations: f64) -> Vec<(&VisibleInterval, Self)> {
        let (FeatureShape::Segment { .. }, Some(covariances)) = (&seen.feature.shape, &seen.image_covariance) else {
            return Vec::new();
        };
        let expected = |part: &VisibleInterval| {
            let [a, b] = part.pixels;
            let across = DVec2::new(a.y - b.y, b.x - a.x).normalize_or_zero();
            let variance = |c: &[[f64; 2]; 2]| across.dot(DMat2::from_cols_array_2d(c) * across).max(0.0);
            let widest = covariances.iter().map(variance).fold(0.0, f64::max);
            let reach = deviations * widest.sqrt() + 1.0;
            Self { ends: [a, b], reach, is_right_brighter: None }
        };
        let long = seen.visible.iter().filter(|part| part.pixels[0].distance(part.pixels[1]) >= SHORTEST);
        long.map(|part| (part, expected(part))).collect()
    }
}

/// Minimum length of an edge to search, pixels.
const SHORTEST: f64 = 12.0;

presight_model::options! {
    /// Thresholds of the edge detector.
    ///
    /// Default: a camera of 8 bits with 1 % of noise.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct EdgeOptions {
        /// Standard deviation of a grey value.
        noise: f64 = 0.01, with_noise;
        /// Minimum grey-value difference across an edge.
        min_contrast: f64 = 0.06, with_min_contrast;
        /// Minimum fraction of the edge's length with measured steps.
        min_support: f64 = 0.5, with_min_support;
        /// Maximum number of edges returned for an expected one.
        max_edges: usize = 3, with_max_edges;
    }
}

/// Error left by sampling and interpolation at best, pixels.
const FLOOR: f64 = 0.02;

/// The edges that may correspond to an expected one, the best supported first.
///
/// # Examples
/// A white half of an image begins at column 10.3; the edge is expected at 8.
pub fn edges_near(image: &GreyImage, expected: &ExpectedEdge, options: &EdgeOptions) -> Vec<FoundEdge> {
    let longest = f64::from(image.width()).hypot(f64::from(image.height()));
    let Some(frame) = EdgeFrame::new(expected.ends, expected.reach, longest) else { return Vec::new() };
    let mut profiler = Profiler::new(image, options, expected.is_right_brighter);
    for along in frame.stations() {
        profiler.steps_across(&frame, along);
    }
    let noise = StepNoise { value: options.noise, floor: FLOOR };
    let lines = LineOptions { min_support: options.min_support, max_lines: options.max_edges, noise };
    let mut found = frame.lines_through(profiler.steps, &lines);
    found.iter_mut().for_each(|e| e.detection.properties.contrast = Some(e.contrast.abs().min(1.0)));
    found
}

/// Finds the steepest grey-value changes along lines across an edge.
struct Profiler<'a> {
    image: &'a GreyImage,
    /// Minimum change, for the mean of three adjacent lines.
    min_change: f64,
    is_right_brighter: Option<bool>,
    /// Derivative of a Gaussian.
    weights: [f64; WIDTH],
    profile: Vec<f64>,
    changes: Vec<f64>,
    steps: Vec<Step>,
}

/// Distance between samples across an edge, pixels: twice as fine as the image.
const STEP: f64 = 0.5;
/// Samples on either side of a difference: two pixels.
const WIDTH: usize = 4;

impl<'a> Profiler<'a> {
    fn new(image: &'a GreyImage, options: &EdgeOptions, is_right_brighter: Option<bool>) -> Self {
        let mut weights: [f64; WIDTH] = std::array::from_fn(|k| {
            let k = (k + 1) as f64;
            k * (-0.5 * (STEP * k / 0.9).powi(2)).exp()
        });
        // The profile is the sum of three lines.
        let total = 3.0 * weights.iter().sum::<f64>();
        weights.iter_mut().for_each(|w| *w /= total);
        let min_change = options.min_contrast.max(4.0 * options.noise / 3f64.sqrt());
        let (profile, changes, steps) = (Vec::new(), Vec::new(), Vec::new());
        Self { image, min_change, is_right_brighter, weights, profile, changes, steps }
    }

    fn steps_across(&mut self, frame: &EdgeFrame, along: f64) {
        let n = (frame.reach / STEP).ceil() as i32 + 1;
        let width = WIDTH as i32;
        // Three adjacent lines: their sum reduces the noise and keeps the edge.
        self.profile.clear();
        self.profile.resize((2 * (n + width) + 1) as usize, 0.0);
        for beside in [-0.7, 0.0, 0.7] {
            let first = frame.place(along + beside, -STEP * f64::from(n + width));
            let step = frame.place(along + beside, STEP) - frame.place(along + beside, 0.0);
            self.image.add_along(first, step, &mut self.profile);
        }
        self.changes.clear();
        let (weights, profile) = (&self.weights, &self.profile);
        self.changes.extend(
            profile
                .windows(2 * WIDTH + 1)
                .map(|w| (0..WIDTH).map(|k| weights[k] * (w[WIDTH + 1 + k] - w[WIDTH - 1 - k])).sum::<f64>()),
        );
        for (i, window) in self.changes.windows(3).enumerate() {
            let c = window[1];
            let sound = self.is_right_brighter.is_none_or(|right| right == (c > 0.0));
            let (before, after) = (window[0] * c.signum(), window[2] * c.signum());
            if !(sound && c.abs() >= self.min_change && c.abs() > before && c.abs() >= after) {
                continue;
            }
            let bend = before - 2.0 * c.abs() + after;
            let shift = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
            let across = STEP * (f64::from(i as i32 + 1 - n) + shift);
            if across.abs() <= frame.reach {
                self.steps.push(Step { along, across, contrast: c });
            }
        }
    }
}
