//! Decides patches that cover many pixels from the image, pixel by pixel.
//!
//! Each pixel's ray is a sample that the image already answers without the index. If the nearest surface on the ray is
//! the patch's own polygon, or is not nearer than the patch, the patch is seen; otherwise that surface hides it. In
//! pinhole cameras and scanners a line of pixels sees a line of the patch. A convex patch covers one interval of it,
//! and two planes swap depth order at most once. So the ends of a run of pixels of one surface decide the whole run.
//!
//! Two kinds of pixels are left to the index: those where the device's f32 shows a surface outside its own edge, and
//! those where the patch lies behind its own polygon, which hides anything between the two.

use super::grid;
use super::polygon::{PolygonCache, RelativeDepth};
use super::samples::space_at_samples;
use super::spans::{self, Span};
use super::strategy::{Decision, FeatureQuery, Workspace};
use super::tally::{SampleState, Tally};
use super::undecided::UndecidedSample;
use super::windows::Windows;
use crate::sample::{PatchCone, PatchOutline};
use crate::{FeatureStats, MAX_PATCH_SAMPLES, Reason, STEP};
use glam::{DVec2, DVec3};
use presight_model::sensor::{LineAxis, PixelGrid};
use std::ops::Range;

/// Patches with more pixels are sampled at the pixels; smaller ones are sampled more finely.
const MANY: usize = (MAX_PATCH_SAMPLES as f64 * STEP * STEP) as usize;

/// A patch at most this far behind its polygon, relative to the range, lies on it: about the error of f32 vertices.
const ON: f64 = 1e-6;

/// Number of undecided pixels at which the index is queried.
const WAITING: usize = 1 << 12;

/// A patch that is decided pixel by pixel, and the results.
struct PatchPixels<'p> {
    query: &'p FeatureQuery<'p>,
    workspace: &'p mut Workspace,
    /// Its product with a ray is the reciprocal of the factor that scales the ray to the patch.
    inverse: DVec3,
    /// Minimum and maximum range of the patch.
    ranges: [f64; 2],
    /// Only occlusion can hide the patch, at every pixel.
    plain: bool,
    /// Samples that need the index, and their pixels.
    waiting: Vec<UndecidedSample>,
    pixels_waiting: Vec<(Span, u32)>,
    tally: Tally,
    stats: FeatureStats,
}

/// Decides a patch: by its pixels if it covers many, otherwise by the columns of a grid where possible.
pub(super) fn decide(query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<Decision> {
    if !query.shape.is_area() || query.frame.sampler.is_one_row() {
        return None;
    }
    let outline = query.frame.sampler.patch_outline(query.points)?;
    match spans_of(query, &outline) {
        Some(spans) => Some(by_pixels(query, &outline.cone, &spans, workspace)),
        None => grid::decide(query, outline, workspace),
    }
}

fn by_pixels(query: &FeatureQuery<'_>, cone: &PatchCone, spans: &[Span], workspace: &mut Workspace) -> Decision {
    let spec = query.frame.sensor.spec();
    let ranges = [cone.distance(), query.points.iter().map(|p| p.length()).fold(0.0, f64::max)];
    let within = ranges[0] >= spec.range_min && ranges[1] <= spec.range_max && ranges[0] > 0.0;
    let mut pixels = PatchPixels {
        query,
        workspace,
        inverse: cone.inverse(),
        ranges,
        plain: query.own.is_plain() && within && spec.max_incidence.is_none(),
        waiting: Vec::new(),
        pixels_waiting: Vec::new(),
        tally: Tally::default(),
        stats: FeatureStats { features: 1, ..FeatureStats::default() },
    };
    if query.frame.options.regions {
        let ends = spans.iter().flat_map(|span| [(span, span.samples.start), (span, span.samples.end - 1)]);
        pixels.tally.windows = Some(Windows::new(ends.map(|(span, sample)| pixels.pixel_at(span, sample))).into());
    }
    for span in spans {
        pixels.decide_span(span);
        if pixels.waiting.len() >= WAITING {
            pixels.ask_index();
        }
    }
    pixels.ask_index();
    Decision { tally: pixels.tally, stats: pixels.stats }
}

/// Returns true if a patch covers many pixels, so that the image decides it.
pub(super) fn covers_many(query: &FeatureQuery<'_>) -> bool {
    let is_for_it = query.shape.is_area() && !query.frame.sampler.is_one_row();
    let outline = is_for_it.then(|| query.frame.sampler.patch_outline(query.points)).flatten();
    outline.is_some_and(|outline| spans_of(query, &outline).is_some())
}

/// The pixels that a patch covers; `None` if they are few.
fn spans_of(query: &FeatureQuery<'_>, outline: &PatchOutline) -> Option<Vec<Span>> {
    if query.frame.sampler.covers_at_most(outline, MANY) {
        return None;
    }
    let spans = spans::of_patch(query, &outline.cone);
    let pixels: usize = spans.iter().map(|span| span.samples.len()).sum();
    (pixels > MANY).then_some(spans)
}

impl PatchPixels<'_> {
    fn decide_span(&mut self, span: &Span) {
        let mut start = span.samples.start;
        while start < span.samples.end {
            let id = self.id_at(span.line, start);
            let mut end = start + 1;
            while end < span.samples.end && self.id_at(span.line, end) == id {
                end += 1;
            }
            self.decide_run(span, start..end, id);
            start = end;
        }
    }

    /// Decides neighbouring pixels that see one surface.
    fn decide_run(&mut self, span: &Span, run: Range<u32>, id: u32) {
        let frame = self.query.frame;
        let straight = matches!(frame.sensor.grid(), PixelGrid::Lines(_));
        if self.plain && straight {
            let ends = [run.start, run.end - 1].map(|sample| self.place(span.line, sample));
            let state = self.state_between(ends, id).filter(|_| id != 0 || !frame.options.is_partial);
            if let Some(state) = state {
                self.stats.samples += run.len();
                return self.take_pixels(span, run, state, false);
            }
        }
        for sample in run {
            let at = self.place(span.line, sample);
            let range = at.length();
            let reason = if self.plain { None } else { self.query.own.before_occlusion(frame, at, range) };
            let state = match reason {
                Some(reason) => Some(SampleState::Hidden(reason, None)),
                None if self.is_not_predicted(span.line, sample) => {
                    Some(SampleState::Hidden(Reason::NotPredicted, None))
                }
                None => {
                    self.stats.samples += 1;
                    self.state_between([at; 2], id)
                }
            };
            match state {
                Some(state) => self.take_pixels(span, sample..sample + 1, state, false),
                None => {
                    self.waiting.push(UndecidedSample::new(at, range));
                    self.pixels_waiting.push((span.clone(), sample));
                }
            }
        }
    }

    /// Returns true if the images hold no information for this pixel. The id alone would not tell: it is also 0 for an
    /// empty ray.
    fn is_not_predicted(&self, line: u32, sample: u32) -> bool {
        self.query.frame.options.is_partial && self.query.frame.images.is_open(self.number_at(line, sample))
    }

    /// The state of two places and of all places between them if the image shows one surface there; `None` if the image
    /// alone cannot decide.
    fn state_between(&mut self, ends: [DVec3; 2], id: u32) -> Option<SampleState> {
        let Some(number) = self.polygon_of(id) else { return Some(SampleState::Seen) };
        let polygons: &PolygonCache = &self.workspace.polygons;
        let known = polygons.get(number);
        if !ends.iter().all(|at| polygons.holds(known, *at)) {
            return None;
        }
        let rounding = self.query.own.rounding();
        let shares = ends.map(|at| known.inverse.dot(at));
        let most = shares[0].max(shares[1]);
        if self.query.own.holds(known.slot) {
            return (most <= 1.0 + ON).then_some(SampleState::Seen);
        }
        let least = self.ranges.map(|range| known.min_share(most, range, rounding));
        if shares.iter().all(|share| *share > least[0].max(least[1])) {
            return Some(SampleState::Hidden(Reason::Occluded, Some(known.slot)));
        }
        let beside =
            |(share, at): (&f64, &DVec3)| matches!(known.nearer(*share, at.length(), rounding), RelativeDepth::No);
        shares.iter().zip(&ends).all(beside).then_some(SampleState::Seen)
    }

    /// Decides the waiting pixels with the index.
    fn ask_index(&mut self) {
        space_at_samples(&mut self.waiting, self.query, self.workspace);
        let (waiting, pixels) = (std::mem::take(&mut self.waiting), std::mem::take(&mut self.pixels_waiting));
        for (sample, (span, at)) in waiting.iter().zip(pixels) {
            self.take_pixels(&span, at..at + 1, sample.state(), true);
        }
    }

    /// The cache number of the polygon with this id.
    fn polygon_of(&mut self, id: u32) -> Option<u32> {
        let slot = self.query.frame.slot_of_id(id)?;
        self.workspace.polygons.of_slot(self.query.frame, slot)
    }

    /// The intersection of a pixel's ray with the patch.
    fn place(&self, line: u32, sample: u32) -> DVec3 {
        let ray = match self.query.frame.sensor.grid() {
            PixelGrid::Lines(grid) => grid.image_from_line() * grid.line_ray(line as usize, sample as usize),
            PixelGrid::Rays(_) => self.query.frame.sensor.ray(sample, line).unwrap_or(DVec3::ZERO),
        };
        ray / self.inverse.dot(ray)
    }

    fn column_row(&self, line: u32, sample: u32) -> (u32, u32) {
        match self.query.frame.sensor.grid() {
            PixelGrid::Lines(grid) if grid.axis() == LineAxis::Columns => (line, sample),
            _ => (sample, line),
        }
    }

    fn number_at(&self, line: u32, sample: u32) -> usize {
        let (column, row) = self.column_row(line, sample);
        row as usize * self.query.frame.images.width as usize + column as usize
    }

    fn id_at(&self, line: u32, sample: u32) -> u32 {
        self.query.frame.images.polygon_id[self.number_at(line, sample)]
    }

    /// The pixel's coordinates in the unwrapped image.
    fn pixel_at(&self, span: &Span, sample: u32) -> DVec2 {
        let (column, row) = self.column_row(span.line, sample);
        DVec2::new(f64::from(column) + span.turned, f64::from(row))
    }

    /// Counts neighbouring pixels of one state, which the index decided or the image alone.
    fn take_pixels(&mut self, span: &Span, run: Range<u32>, state: SampleState, by_index: bool) {
        let count = run.len();
        self.tally.take_pixels(state, count);
        match state {
            SampleState::Hidden(Reason::Occluded, _) if by_index => self.stats.hidden_in_space += count,
            SampleState::Hidden(Reason::Occluded, _) => self.stats.hidden_by_neighbours += count,
            SampleState::Hidden(Reason::Undecided, _) => self.stats.undecided += count,
            SampleState::Hidden(..) => {}
            SampleState::Seen => {
                self.stats.visible += count;
                let [from, to] = [run.start, run.end - 1].map(|sample| self.pixel_at(span, sample));
                self.tally.reach_between(from, to);
                for sample in self.nearest_of(span.line, run.clone()) {
                    self.tally.see_at(self.place(span.line, sample));
                }
                if self.query.frame.options.feature_id {
                    let numbers: Vec<u32> = run.map(|sample| self.number_at(span.line, sample) as u32).collect();
                    self.tally.pixels.extend(numbers);
                }
            }
        }
    }

    /// Two samples of a run. The sample nearest to the sensor is among them.
    fn nearest_of(&self, line: u32, run: Range<u32>) -> [u32; 2] {
        let PixelGrid::Lines(grid) = self.query.frame.sensor.grid() else { return [run.start; 2] };
        let last = run.end - 1;
        if run.start == last {
            return [last; 2];
        }
        // The line of pixels sees this line of the patch; find the point nearest to the sensor.
        let [a, b] = [run.start, last].map(|sample| self.place(line, sample));
        let along = b - a;
        let share = -a.dot(along) / along.length_squared();
        // Places beyond the two ends may be behind the sensor.
        if !(share > 0.0 && share < 1.0) {
            return [if share >= 1.0 { last } else { run.start }; 2];
        }
        let s = grid.line_from_image() * (a + share * along);
        let [c0, c1] = grid.lines()[line as usize];
        let after = grid.samples_below(s.z * (c0 * c0 + c1 * c1) / (s.x * c0 + s.y * c1)) as u32;
        [after.saturating_sub(1), after].map(|sample| sample.clamp(run.start, last))
    }
}
