//! Fits lines to steps measured across an expected edge: selects the best supported line, then solves least squares.

use crate::matching::Detection;
use glam::{DMat2, DVec2};

/// A detected edge.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundEdge {
    /// A segment for [`crate::matching`]; its ends are not corners.
    pub detection: Detection,
    /// Brightness of the right side minus that of the left.
    pub contrast: f64,
    /// Fraction of the expected length with measured steps.
    pub support: f64,
    /// Root mean square distance of its points from the line, pixels.
    pub scatter: f64,
}

/// Maximum number of stations along an edge.
const STATIONS: usize = 96;
/// Maximum distance of a step from the line that it supports, pixels.
const NEAR: f64 = 1.2;
/// Maximum number of steps at either end that are tried as pairs: at most 24 x 24 lines.
const TRIED: usize = 24;

/// A line supported by this fraction of the stations is accepted without trying more.
const PLENTY: f64 = 0.9;

/// A position across the edge where the image changes most.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Position along and across the edge, from its middle, pixels.
    pub along: f64,
    pub across: f64,
    /// Value on the right minus value on the left.
    pub contrast: f64,
}

/// Axes along an edge and to its right.
pub(super) struct EdgeFrame {
    middle: DVec2,
    along: DVec2,
    length: f64,
    /// Search distance across the edge, pixels.
    pub reach: f64,
}

/// Errors of steps.
pub(super) struct StepNoise {
    /// Standard deviation of a grey value, or of another unit of contrast.
    pub value: f64,
    /// Error that does not average out over steps, pixels.
    pub floor: f64,
}

/// Selects the lines to return.
pub(super) struct LineOptions {
    /// Minimum fraction of stations that support a line.
    pub min_support: f64,
    /// Maximum number of lines.
    pub max_lines: usize,
    pub noise: StepNoise,
}

impl EdgeFrame {
    /// Returns `None` for edges that are too short, too long or not finite. `longest` bounds the reach.
    pub fn new(ends: [DVec2; 2], reach: f64, longest: f64) -> Option<Self> {
        let [a, b] = ends;
        let length = a.distance(b);
        let sound = (3.0..1e6).contains(&length) && reach >= 0.0;
        let reach = reach.min(longest);
        sound.then(|| Self { middle: 0.5 * (a + b), along: (b - a) / length, length, reach })
    }

    fn right(&self) -> DVec2 {
        DVec2::new(-self.along.y, self.along.x)
    }

    pub fn place(&self, along: f64, across: f64) -> DVec2 {
        self.middle + along * self.along + across * self.right()
    }

    /// Positions along the edge at which steps are searched.
    pub fn stations(&self) -> impl ExactSizeIterator<Item = f64> + use<> {
        let (count, length) = (((self.length / 1.5).ceil() as usize).clamp(3, STATIONS), self.length);
        (0..count).map(move |k| length * ((k as f64 + 0.5) / count as f64 - 0.5))
    }

    /// The lines through the steps, the best supported first.
    pub fn lines_through(&self, mut steps: Vec<Step>, options: &LineOptions) -> Vec<FoundEdge> {
        let mut found = Vec::new();
        while found.len() < options.max_lines {
            let Some(line) = self.best_line(&steps) else { break };
            let mut own = Vec::new();
            steps.retain(|s| {
                let near = line.distance(s) <= NEAR;
                own.extend(near.then_some(*s));
                !near
            });
            match self.fitted(&own, &options.noise) {
                Some(edge) if edge.support >= options.min_support => found.push(edge),
                _ => break,
            }
        }
        found
    }

    /// The line with most supporting steps. Tries lines through pairs of steps near opposite ends.
    fn best_line(&self, steps: &[Step]) -> Option<Line> {
        let third = self.length / 6.0;
        let (left, right): (Vec<&Step>, Vec<&Step>) =
            (steps.iter().filter(|s| s.along < -third).collect(), steps.iter().filter(|s| s.along > third).collect());
        // The reach also limits the slope.
        let steepest = 2.0 * (self.reach + NEAR) / self.length;
        let enough = (PLENTY * self.stations().len() as f64).ceil() as usize;
        let some = |all: &[&Step]| all.len().div_ceil(TRIED).max(1);
        let mut best: Option<(usize, Line)> = None;
        for a in left.iter().step_by(some(&left)) {
            for b in right.iter().step_by(some(&right)) {
                let slope = (b.across - a.across) / (b.along - a.along);
                let line = Line { across: a.across - slope * a.along, slope };
                // Both steps need the same sign of contrast, which does not change along an edge.
                if slope.abs() > steepest || a.contrast.signum() != b.contrast.signum() {
                    continue;
                }
                let votes = steps.iter().filter(|s| line.distance(s) <= NEAR && s.contrast * a.contrast > 0.0).count();
                if best.is_none_or(|(most, _)| votes > most) {
                    best = Some((votes, line));
                }
                // No other line could have much more support.
                if votes >= enough {
                    return Some(line);
                }
            }
        }
        best.filter(|(votes, _)| *votes >= 3).map(|(_, line)| line)
    }

    /// The line fitted to its steps by least squares.
    fn fitted(&self, own: &[Step], noise: &StepNoise) -> Option<FoundEdge> {
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
        let end = |along: f64| self.place(along, line.across + line.slope * along);
        // Error of a single step: the slope of the blurred edge converts value noise into pixels.
        let own_sigma = scatter.max(1.5 * noise.value / contrast.abs().max(1e-6)).max(noise.floor);
        // The line is least certain at its ends: variance of the mean plus the contribution of the slope.
        let variance =
            own_sigma * own_sigma * (1.0 / n + (0.5 * (last - first)).powi(2) / spread) + noise.floor * noise.floor;
        let mut detection = Detection::segment([end(first), end(last)], variance.sqrt());
        detection.covariance = DMat2::from_diagonal(DVec2::splat(variance));
        // Two steps at one station count once.
        let mut seen: Vec<i64> = own.iter().map(|s| (s.along * 1e3) as i64).collect();
        seen.sort_unstable();
        seen.dedup();
        let support = seen.len() as f64 / self.stations().len() as f64;
        Some(FoundEdge { detection, contrast, support, scatter })
    }
}

/// A line by its offset across the edge at the middle, and its slope.
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
