//! Depth edges in range images, where neighbouring pixels measure surfaces one behind the other.

use super::edges::ExpectedEdge;
use super::lines::{EdgeFrame, FoundEdge, LineOptions, Step, StepNoise};
use glam::DVec2;
use presight_model::measured::{Frame, RangeNoise};

presight_model::options! {
    /// Thresholds of the depth edge detector.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct JumpOptions {
        /// Minimum jump as a fraction of the nearer range. A jump must also exceed the noise and the slopes of the
        /// surfaces.
        min_jump: f64 = 0.03, with_min_jump;
        /// Minimum fraction of the edge's length with measured jumps.
        min_support: f64 = 0.5, with_min_support;
        /// Maximum number of edges returned for an expected one.
        max_edges: usize = 3, with_max_edges;
    }
}

/// Jumps must exceed this many standard deviations of one reading, which are 3.5 of a difference: 1 in 2,500 pairs of
/// readings does by chance.
const FAR: f64 = 5.0;
/// Factor by which a slope may continue to grow without being a jump.
const BEND: f64 = 3.0;
/// A pixel measures one of the two surfaces, so the edge may be anywhere between two pixel centres, even along its
/// whole length if it follows a row or a column. One standard deviation, pixels: 1 / sqrt(12).
const HALF_OPEN: f64 = 0.2887;

/// The depth edges that may correspond to an expected one, the best supported first. `contrast` is the range on the
/// right side minus that on the left, metres.
///
/// # Examples
/// A pillar 2 m away stands before a wall 5 m away, from column 20 on.
pub fn jumps_near(frame: &Frame, expected: &ExpectedEdge, options: &JumpOptions) -> Vec<FoundEdge> {
    let (width, height) = (frame.sensor().width(), frame.sensor().height());
    let longest = f64::from(width).hypot(f64::from(height));
    let Some(edge) = EdgeFrame::new(expected.ends, expected.reach, longest) else { return Vec::new() };
    let noise = RangeNoise::of(frame.sensor());
    let mut steps = Vec::new();
    let mut across = Vec::new();
    for along in edge.stations() {
        across.clear();
        profile(frame, &edge, along, &mut across);
        steps_across(&across, along, edge.reach, &noise, options, &mut steps);
    }
    let lines = LineOptions {
        min_support: options.min_support,
        max_lines: options.max_edges,
        noise: StepNoise { value: 0.0, floor: HALF_OPEN },
    };
    edge.lines_through(steps, &lines)
}

/// The pixels along a line across an edge: their ranges, and where the line enters each.
fn profile(frame: &Frame, edge: &EdgeFrame, along: f64, to: &mut Vec<(f64, f64)>) {
    const STEP: f64 = 0.125;
    let (width, height) = (frame.sensor().width() as usize, frame.sensor().height() as usize);
    let n = (edge.reach / STEP).ceil() as i32 + (3.0 / STEP) as i32;
    let mut last = None;
    for i in -n..=n {
        let at = STEP * f64::from(i);
        let DVec2 { x, y } = edge.place(along, at).round();
        if !(x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64) {
            continue;
        }
        let pixel = y as usize * width + x as usize;
        if last.replace(pixel) != Some(pixel) {
            to.push((at - 0.5 * STEP, f64::from(frame.ranges()[pixel])));
        }
    }
}

/// Finds jumps between the pixels of a profile. Adjacent jumps, due to mixed pixels, give one at their weighted middle.
fn steps_across(
    profile: &[(f64, f64)],
    along: f64,
    reach: f64,
    noise: &RangeNoise,
    options: &JumpOptions,
    steps: &mut Vec<Step>,
) {
    let jump = |i: usize| -> f64 {
        let (a, b) = (profile[i - 1].1, profile[i].1);
        // A ray without an echo gets a range far behind all others; NaN is not compared.
        let far = |r: f64| if r == f64::INFINITY { 1e3 } else { r };
        let (a, b) = (far(a), far(b));
        let near = a.min(b);
        if !near.is_finite() || near >= 1e3 {
            return 0.0;
        }
        let slope = |k: Option<usize>| {
            let pair = k.filter(|k| *k >= 1 && *k < profile.len()).map(|k| (profile[k].1 - profile[k - 1].1).abs());
            pair.filter(|s| s.is_finite()).unwrap_or(0.0)
        };
        // The smaller slope of both sides, because next to a mixed pixel one of them is itself a jump.
        let goes_on = BEND * slope(i.checked_sub(1)).min(slope(Some(i + 1)));
        let least = (options.min_jump * near).max(FAR * noise.range_sigma(near) + goes_on);
        if (b - a).abs() >= least { b - a } else { 0.0 }
    };
    let mut i = 1;
    while i < profile.len() {
        let first = jump(i);
        if first == 0.0 {
            i += 1;
            continue;
        }
        let (mut weight, mut sum, mut end) = (0.0, 0.0, i);
        while end < profile.len() && jump(end) * first > 0.0 {
            weight += jump(end).abs();
            sum += jump(end).abs() * profile[end].0;
            end += 1;
        }
        if (sum / weight).abs() <= reach {
            steps.push(Step { along, across: sum / weight, contrast: first.signum() * weight });
        }
        i = end;
    }
}
