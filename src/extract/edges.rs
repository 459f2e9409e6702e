//! Edges near a predicted one: searched across it, to a fraction of a pixel.

use super::GreyImage;
use crate::environment::FeatureShape;
use crate::features::{SeenFeature, VisibleInterval};
use crate::matching::Detection;
use glam::{DMat2, DVec2};

/// Where an edge is expected in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedEdge {
    /// Its visible ends: column, row.
    pub ends: [DVec2; 2],
    /// How far across itself it may be off, pixels.
    pub reach: f64,
    /// Which side is brighter, if that is known: `Some(true)` if it is the right one, seen from the first end to the second in the
    /// image (rows grow downwards).
    pub is_right_brighter: Option<bool>,
}

impl ExpectedEdge {
    /// The visible parts of a predicted segment that are long enough, as far across as its uncertainty goes: so many standard
    /// deviations, and a pixel for what rounding and the image's own blur may add. Empty for other features, and without regions of
    /// interest (their covariances are asked for).
    pub fn of(seen: &SeenFeature, deviations: f64) -> Vec<Self> {
        let (FeatureShape::Segment { .. }, Some(covariances)) = (&seen.feature.shape, &seen.image_covariance) else {
            return Vec::new();
        };
        let expected = |part: &VisibleInterval| {
            let [a, b] = part.pixels;
            let across = DVec2::new(a.y - b.y, b.x - a.x).normalize_or_zero();
            let variance = |c: &[[f64; 2]; 2]| {
                let turned =
                    DVec2::new(c[0][0] * across.x + c[0][1] * across.y, c[1][0] * across.x + c[1][1] * across.y);
                across.dot(turned).max(0.0)
            };
            let widest = covariances.iter().map(variance).fold(0.0, f64::max);
            let reach = deviations * widest.sqrt() + 1.0;
            (a.distance(b) >= SHORTEST).then_some(Self { ends: [a, b], reach, is_right_brighter: None })
        };
        seen.visible.iter().filter_map(expected).collect()
    }
}

/// Shortest edge that is looked for, pixels.
const SHORTEST: f64 = 12.0;

/// What counts as an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeOptions {
    /// Standard deviation of a grey value.
    pub noise: f64,
    /// Least difference of grey values across an edge.
    pub least_contrast: f64,
    /// Least share of its length at which it has to be seen.
    pub least_support: f64,
    /// Most edges that are told for one that is expected.
    pub most: usize,
}

impl Default for EdgeOptions {
    /// A camera of 8 bits with 1 % of noise.
    fn default() -> Self {
        Self { noise: 0.01, least_contrast: 0.06, least_support: 0.5, most: 3 }
    }
}

/// An edge that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundEdge {
    /// A segment, as [`crate::matching`] takes it; no end is a corner.
    pub detection: Detection,
    /// Brightness of the right side less that of the left one.
    pub contrast: f64,
    /// Share of the expected length at which it was seen.
    pub support: f64,
    /// Root mean square distance of its points from the line, pixels.
    pub scatter: f64,
}

/// Half of the width over which a difference is taken, pixels.
const HALF: f64 = 2.0;
/// Most stations along an edge.
const STATIONS: usize = 96;
/// How far a point may be from the line that it supports, pixels.
const NEAR: f64 = 1.2;
/// Longest reach, pixels: searching more costs too much to be of use.
const LONGEST: f64 = 64.0;
/// What sampling and interpolation leave at best, pixels.
const FLOOR: f64 = 0.02;

/// A place across the edge at which brightness changes most.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// Along the edge and across it, from its middle, pixels.
    along: f64,
    across: f64,
    contrast: f64,
}

/// The edges in the image that may be an expected one, the best supported first.
///
/// # Examples
/// A white half of an image begins at column 10.3; the edge is expected at 8.
/// ```
/// use glam::DVec2;
/// use presight::extract::{EdgeOptions, ExpectedEdge, GreyImage, edges_near};
/// // Each pixel is as bright as the white part of it.
/// let row = (0..24).map(|c| (c as f32 + 0.5 - 10.3).clamp(0.0, 1.0));
/// let image = GreyImage::new(24, 40, row.cycle().take(24 * 40).collect())?;
/// let expected = ExpectedEdge { ends: [DVec2::new(8.0, 5.0), DVec2::new(8.0, 35.0)], reach: 4.0, is_right_brighter: None };
/// let found = edges_near(&image, &expected, &EdgeOptions::default());
/// assert_eq!(found.len(), 1);
/// // Seen from the first end downwards, the right side is the left of the image: it is the darker one.
/// assert!(found[0].contrast < -0.85);
/// assert!(found[0].detection.shape.points().iter().all(|p| (p.x - 10.3).abs() < 0.1));
/// # Ok::<(), presight::Error>(())
/// ```
pub fn edges_near(image: &GreyImage, expected: &ExpectedEdge, options: &EdgeOptions) -> Vec<FoundEdge> {
    let [a, b] = expected.ends;
    let length = a.distance(b);
    if !((3.0..1e6).contains(&length) && expected.reach >= 0.0) {
        return Vec::new();
    }
    let frame = EdgeFrame { middle: 0.5 * (a + b), along: (b - a) / length };
    let stations = ((length / 1.5).ceil() as usize).clamp(3, STATIONS);
    let reach = expected.reach.min(LONGEST);
    let mut steps = Vec::new();
    for k in 0..stations {
        let along = length * ((k as f64 + 0.5) / stations as f64 - 0.5);
        steps_across(image, &frame, along, reach, expected.is_right_brighter, options, &mut steps);
    }
    let mut found = Vec::new();
    while found.len() < options.most {
        let Some(line) = best_line(&steps, reach, length) else { break };
        let mut own = Vec::new();
        steps.retain(|s| {
            let near = line.distance(s) <= NEAR;
            own.extend(near.then_some(*s));
            !near
        });
        match fitted(&frame, &own, stations, options) {
            Some(edge) if edge.support >= options.least_support => found.push(edge),
            _ => break,
        }
    }
    found
}

/// Axes along an edge and to its right.
struct EdgeFrame {
    middle: DVec2,
    along: DVec2,
}

impl EdgeFrame {
    fn right(&self) -> DVec2 {
        DVec2::new(-self.along.y, self.along.x)
    }

    fn place(&self, along: f64, across: f64) -> DVec2 {
        self.middle + along * self.along + across * self.right()
    }
}

/// A line by its distances across the edge at both ends.
#[derive(Clone, Copy)]
struct Line {
    across: f64,
    slope: f64,
}

impl Line {
    fn distance(&self, s: &Step) -> f64 {
        (s.across - self.across - self.slope * s.along).abs()
    }
}

/// Places of steepest change along one line across the edge.
fn steps_across(
    image: &GreyImage,
    frame: &EdgeFrame,
    along: f64,
    reach: f64,
    is_right_brighter: Option<bool>,
    options: &EdgeOptions,
    steps: &mut Vec<Step>,
) {
    const STEP: f64 = 0.5;
    let n = (reach / STEP).ceil() as i32 + 1;
    // The mean of three lines side by side: noise falls, the edge stays.
    let value = |x: f64| [-0.7, 0.0, 0.7].iter().map(|d| image.at(frame.place(along + d, x))).sum::<f64>() / 3.0;
    let width = (HALF / STEP) as i32;
    let profile: Vec<f64> = (-n - width..=n + width).map(|i| value(STEP * f64::from(i))).collect();
    // Weighted as a Gaussian's derivative: far from the edge as blind as beside it.
    let weights: Vec<f64> =
        (1..=width).map(|k| f64::from(k) * (-0.5 * (STEP * f64::from(k) / 0.9).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let change = |i: usize| -> f64 {
        let sides = |k: usize| profile[i + k] - profile[i - k];
        weights.iter().enumerate().map(|(k, w)| w * sides(k + 1)).sum::<f64>() / total
    };
    let width = width as usize;
    let changes: Vec<f64> = (width..profile.len() - width).map(change).collect();
    // Of three lines' mean.
    let least = options.least_contrast.max(4.0 * options.noise / 3f64.sqrt());
    for i in 1..changes.len().saturating_sub(1) {
        let c = changes[i];
        let sound = match is_right_brighter {
            Some(true) => c > 0.0,
            Some(false) => c < 0.0,
            None => true,
        };
        let (before, after) = (changes[i - 1] * c.signum(), changes[i + 1] * c.signum());
        if !(sound && c.abs() >= least && c.abs() > before && c.abs() >= after) {
            continue;
        }
        let bend = before - 2.0 * c.abs() + after;
        let shift = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        let across = STEP * (f64::from(i as i32 - n) + shift);
        if across.abs() <= reach {
            steps.push(Step { along, across, contrast: c });
        }
    }
}

/// The line that most steps support, each by one at a station. Lines through pairs of far steps are tried.
fn best_line(steps: &[Step], reach: f64, length: f64) -> Option<Line> {
    let third = length / 6.0;
    let (left, right): (Vec<&Step>, Vec<&Step>) =
        (steps.iter().filter(|s| s.along < -third).collect(), steps.iter().filter(|s| s.along > third).collect());
    // A turn is limited by the reach, too.
    let steepest = 2.0 * (reach + NEAR) / length;
    let some = |all: &[&Step]| all.len().div_ceil(24).max(1);
    let mut best: Option<(usize, Line)> = None;
    for a in left.iter().step_by(some(&left)) {
        for b in right.iter().step_by(some(&right)) {
            let slope = (b.across - a.across) / (b.along - a.along);
            let line = Line { across: a.across - slope * a.along, slope };
            // Of the same sense of contrast, too: an edge does not change it.
            if slope.abs() > steepest || a.contrast.signum() != b.contrast.signum() {
                continue;
            }
            let votes = steps.iter().filter(|s| line.distance(s) <= NEAR && s.contrast * a.contrast > 0.0).count();
            if best.is_none_or(|(most, _)| votes > most) {
                best = Some((votes, line));
            }
        }
    }
    best.filter(|(votes, _)| *votes >= 3).map(|(_, line)| line)
}

/// Least squares through the steps of one line.
fn fitted(frame: &EdgeFrame, own: &[Step], stations: usize, options: &EdgeOptions) -> Option<FoundEdge> {
    let n = own.len() as f64;
    if own.len() < 3 {
        return None;
    }
    let mean = |f: fn(&Step) -> f64| own.iter().map(f).sum::<f64>() / n;
    let (t, x, contrast) = (mean(|s| s.along), mean(|s| s.across), mean(|s| s.contrast));
    let spread = own.iter().map(|s| (s.along - t).powi(2)).sum::<f64>();
    if !(spread > 1e-9) {
        return None;
    }
    let slope = own.iter().map(|s| (s.along - t) * (s.across - x)).sum::<f64>() / spread;
    let line = Line { across: x - slope * t, slope };
    let scatter = (own.iter().map(|s| line.distance(s).powi(2)).sum::<f64>() / (n - 2.0).max(1.0)).sqrt();
    let (first, last) = own.iter().fold((f64::MAX, f64::MIN), |(a, b), s| (a.min(s.along), b.max(s.along)));
    let end = |along: f64| frame.place(along, line.across + line.slope * along);
    // One step's own error: the slope of the blurred edge turns noise of grey values into pixels.
    let own_sigma = scatter.max(1.5 * options.noise / contrast.abs().max(1e-6)).max(FLOOR);
    // At the ends the line is known least: a quarter of the points' variance each, and the turn's part.
    let variance = own_sigma * own_sigma * (1.0 / n + (0.5 * (last - first)).powi(2) / spread) + FLOOR * FLOOR;
    let mut detection = Detection::segment([end(first), end(last)], variance.sqrt());
    detection.covariance = DMat2::from_diagonal(DVec2::splat(variance));
    detection.properties.contrast = Some(contrast.abs().min(1.0));
    // Two steps at one station are no more than one.
    let mut seen: Vec<i64> = own.iter().map(|s| (s.along * 1e3) as i64).collect();
    seen.sort_unstable();
    seen.dedup();
    Some(FoundEdge { detection, contrast, support: seen.len() as f64 / stations as f64, scatter })
}
