//! Patches that cover many pixels, decided by the image, pixel by pixel.
//!
//! A pixel's ray is a sample whose answer the image has: if the nearest surface on it is the patch's own polygon, or is not
//! nearer than the patch, the patch is seen there, and else that surface hides it. No index is asked. In pinhole cameras and scanners a line
//! of pixels sees a line of the patch: a convex patch covers one interval of it, and of two planes one is nearer on one side
//! of a point, so that the ends of neighbouring pixels of one surface decide about all between them.
//!
//! Two kinds of pixels are left to the index: those at which the device's f32 shows a surface beside its own edge, and those
//! of patches that lie behind their own polygon, which hides what may be between the two.

use super::Visibility;
use super::polygon::RelativeDepth;
use super::tally::{SampleState, Tally};
use super::undecided::UndecidedSample;
use super::worker::{FeatureSurface, Worker};
use crate::features::columns;
use crate::features::sample::{PatchCone, Sample};
use crate::features::{MAX_PATCH_SAMPLES, Reason, STEP};
use crate::sensor::{LineAxis, LineGrid, PixelGrid};
use glam::{DVec2, DVec3};
use std::ops::Range;

/// Pixels from which on they are samples: fewer are sampled more finely.
const MANY: usize = (MAX_PATCH_SAMPLES as f64 * STEP * STEP) as usize;

/// What is no farther behind its polygon than by this part of the range lies on it: hardly more than f32 vertices are off a plane.
const ON: f64 = 1e-6;

/// Pixels that wait for the index, at most.
const WAITING: usize = 1 << 12;

/// Neighbouring pixels of one line that a patch covers.
#[derive(Clone, Debug)]
pub(super) struct Span {
    line: u32,
    samples: Range<u32>,
    /// Columns to be added for the place in the unwrapped image.
    turned: f64,
}

/// A patch whose pixels are looked at.
struct Area<'o, 'p> {
    own: &'o FeatureSurface<'p>,
    /// Product with a ray: one over how much longer it has to be to reach the patch.
    inverse: DVec3,
    /// Least and greatest range of the patch.
    ranges: [f64; 2],
    /// Only what is in between decides, everywhere.
    plain: bool,
}

impl Worker<'_> {
    /// Decides about a patch; `None` if it covers few pixels, or the image cannot.
    pub(super) fn area(&mut self, points: &[DVec3], own: &FeatureSurface<'_>) -> Option<Tally> {
        let cone = self.take_spans(points)?;
        let spec = self.frame.sensor.spec();
        let ranges = [cone.distance(), points.iter().map(|p| p.length()).fold(0.0, f64::max)];
        let within = ranges[0] >= spec.range_min && ranges[1] <= spec.range_max && ranges[0] > 0.0;
        let plain = own.is_plain() && within && spec.max_incidence.is_none();
        let area = Area { own, inverse: cone.inverse(), ranges, plain };
        let spans = std::mem::take(&mut self.spans);
        let mut tally = Tally::default();
        self.open.clear();
        for (number, span) in spans.iter().enumerate() {
            self.decide_span((number as u32, span), &area, &mut tally);
            if self.open.len() >= WAITING {
                self.ask_index(&spans, &area, &mut tally);
            }
        }
        self.ask_index(&spans, &area, &mut tally);
        self.spans = spans;
        Some(tally)
    }

    /// True if the image decides about a patch.
    pub(super) fn decides_area(&mut self, points: &[DVec3]) -> bool {
        self.take_spans(points).is_some()
    }

    /// Finds the pixels that a patch covers, if they are many.
    fn take_spans(&mut self, points: &[DVec3]) -> Option<PatchCone> {
        let frame = self.frame;
        if frame.options.visibility != Visibility::Image || frame.sampler.is_one_row() {
            return None;
        }
        let cone = PatchCone::new(points)?;
        self.spans.clear();
        match frame.sensor.grid() {
            PixelGrid::Lines(grid) => self.spans_of_lines(grid, points, &cone),
            PixelGrid::Rays(_) => self.spans_of_rays(points, &cone),
        }
        let pixels: usize = self.spans.iter().map(|span| span.samples.len()).sum();
        (pixels > MANY).then_some(cone)
    }

    fn spans_of_lines(&mut self, grid: &LineGrid, points: &[DVec3], cone: &PatchCone) {
        let line_vector = grid.image_from_line().transpose();
        let edges: Vec<DVec3> = cone.edges.iter().map(|e| line_vector * *e).collect();
        let samples = grid.weights().len();
        for (lines, turned) in self.lines_of(grid, points) {
            for line in lines {
                let [c0, c1] = grid.lines()[line];
                let (mut first, mut end) = (0, samples);
                for e in &edges {
                    // A + B t >= 0 on the line.
                    let (a, b) = (e.x * c0 + e.y * c1, e.z);
                    if b > 0.0 {
                        first = first.max(grid.samples_below(-a / b));
                    } else if b < 0.0 {
                        end = end.min(grid.samples_up_to(-a / b));
                    } else if a < 0.0 {
                        end = 0;
                    }
                }
                if first < end {
                    self.spans.push(Span { line: line as u32, samples: first as u32..end as u32, turned });
                }
            }
        }
    }

    /// Lines that may see a patch, with the columns to be added to theirs.
    fn lines_of(&self, grid: &LineGrid, points: &[DVec3]) -> Vec<(Range<usize>, f64)> {
        let sensor = self.frame.sensor;
        let count = grid.lines().len();
        let whole = 0..count;
        let between = |low: f64, high: f64| {
            // A line more on either side for rounding.
            let bound = |x: f64| x.clamp(0.0, count as f64) as usize;
            bound(low.floor())..bound(high.ceil() + 1.0)
        };
        match grid.axis() {
            LineAxis::Rows => {
                if points.iter().all(|p| p.z <= 0.0) {
                    return Vec::new();
                }
                // Corners before the camera have the extremes.
                let rows = points.iter().map(|p| if p.z > 0.0 { sensor.project(*p).map(|(_, row)| row) } else { None });
                let rows: Option<Vec<f64>> = rows.collect();
                let extremes = |rows: Vec<f64>| {
                    let low = rows.iter().copied().fold(f64::INFINITY, f64::min);
                    between(low, rows.into_iter().fold(f64::NEG_INFINITY, f64::max))
                };
                vec![(rows.map_or(whole, extremes), 0.0)]
            }
            LineAxis::Columns => {
                let (Some([low, high]), Some(turn)) = (columns::of_corners(sensor, points), columns::turn(sensor))
                else {
                    return vec![(whole, 0.0)];
                };
                // The same azimuths lie in the image as often as it goes round. Only over a seam do columns go on.
                let turns = (-1..).map(|k| turn * f64::from(k)).take_while(|by| low + by <= count as f64);
                let goes_on = self.frame.sampler.turn().is_some();
                let lines = turns.map(|by| (between(low + by, high + by), if goes_on { -by } else { 0.0 }));
                lines.filter(|(lines, _)| !lines.is_empty()).collect()
            }
        }
    }

    fn spans_of_rays(&mut self, points: &[DVec3], cone: &PatchCone) {
        let sensor = self.frame.sensor;
        let Some([low, high]) = self.frame.sampler.patch_bounds(points, cone) else { return };
        let [first, end] = [low.round().max(DVec2::ZERO), (high.round() + 1.0).max(DVec2::ZERO)];
        for row in first.y as u32..(end.y as u32).min(sensor.height()) {
            let mut begun: Option<u32> = None;
            let columns = first.x as u32..(end.x as u32).min(sensor.width());
            for column in columns.clone() {
                let inside = |ray: DVec3| cone.inverse().dot(ray) > 0.0 && cone.edges.iter().all(|e| e.dot(ray) >= 0.0);
                match (sensor.ray(column, row).is_some_and(inside), begun) {
                    (true, None) => begun = Some(column),
                    (false, Some(from)) => {
                        self.spans.push(Span { line: row, samples: from..column, turned: 0.0 });
                        begun = None;
                    }
                    _ => {}
                }
            }
            if let Some(from) = begun {
                self.spans.push(Span { line: row, samples: from..columns.end, turned: 0.0 });
            }
        }
    }

    fn decide_span(&mut self, (number, span): (u32, &Span), area: &Area<'_, '_>, tally: &mut Tally) {
        let mut start = span.samples.start;
        while start < span.samples.end {
            let id = self.id_at(span.line, start);
            let mut end = start + 1;
            while end < span.samples.end && self.id_at(span.line, end) == id {
                end += 1;
            }
            self.decide_run((number, span), start..end, id, area, tally);
            start = end;
        }
    }

    /// Neighbouring pixels that see one surface.
    fn decide_run(
        &mut self,
        (number, span): (u32, &Span),
        run: Range<u32>,
        id: u32,
        area: &Area<'_, '_>,
        tally: &mut Tally,
    ) {
        let straight = matches!(self.frame.sensor.grid(), PixelGrid::Lines(_));
        if area.plain && straight {
            let ends = [run.start, run.end - 1].map(|sample| self.place(span.line, sample, area));
            let state = self.state_between(ends, id, area).filter(|_| id != 0 || !self.frame.options.is_partial);
            if let Some(state) = state {
                self.stats.samples += run.len();
                return self.take_pixels(span, run, state, area, tally);
            }
        }
        for sample in run {
            let at = self.place(span.line, sample, area);
            let range = at.length();
            let pixel = self.pixel_at(span, sample);
            let one = Sample { t: [0.0, 1.0], at, pixel, ends: [pixel, pixel], weight: 1.0 };
            let reason = if area.plain { None } else { self.before_occlusion(&one, range, area.own) };
            let state = match reason {
                Some(reason) => Some(SampleState::Hidden(reason, None)),
                None if self.is_not_predicted(span.line, sample) => {
                    Some(SampleState::Hidden(Reason::NotPredicted, None))
                }
                None => {
                    self.stats.samples += 1;
                    self.state_between([at; 2], id, area)
                }
            };
            match state {
                Some(state) => self.take_pixels(span, sample..sample + 1, state, area, tally),
                // Its place among the spans stands where others have their piece and their place along a line.
                None => {
                    let (piece, t) = (number, f64::from(sample));
                    self.open.push(UndecidedSample { piece, at, range, t, by: None, share: 0.0, unknown: false });
                }
            }
        }
    }

    /// True of a pixel that the images say nothing of. Ids alone do not tell it from one that sees nothing.
    fn is_not_predicted(&self, line: u32, sample: u32) -> bool {
        self.frame.options.is_partial && self.frame.images.is_open(self.number_at(line, sample))
    }

    /// What is true of two places, and of all between them, of which the image shows the same surface; `None` if more than the
    /// image is needed to tell.
    fn state_between(&mut self, ends: [DVec3; 2], id: u32, area: &Area<'_, '_>) -> Option<SampleState> {
        let Some(face) = self.face_of(id) else { return Some(SampleState::Seen) };
        let (known, faces) = (&self.faces.known[face], &self.faces);
        if !ends.iter().all(|at| faces.holds(known, *at)) {
            return None;
        }
        let rounding = area.own.rounding();
        let shares = ends.map(|at| known.inverse.dot(at));
        let most = shares[0].max(shares[1]);
        if area.own.holds(known.slot) {
            return (most <= 1.0 + ON).then_some(SampleState::Seen);
        }
        let least = area.ranges.map(|range| known.least_share(most, range, rounding));
        if shares.iter().all(|share| *share > least[0].max(least[1])) {
            return Some(SampleState::Hidden(Reason::Occluded, Some(known.slot)));
        }
        let beside =
            |(share, at): (&f64, &DVec3)| matches!(known.nearer(*share, at.length(), rounding), RelativeDepth::No);
        shares.iter().zip(&ends).all(beside).then_some(SampleState::Seen)
    }

    /// Decides about the pixels that wait for it.
    fn ask_index(&mut self, spans: &[Span], area: &Area<'_, '_>, tally: &mut Tally) {
        if self.open.is_empty() {
            return;
        }
        self.space_at_samples(0..self.open.len(), area.own);
        let open = std::mem::take(&mut self.open);
        for o in &open {
            let state = match o.by {
                Some(slot) => SampleState::Hidden(Reason::Occluded, Some(slot)),
                None if o.unknown => SampleState::Hidden(Reason::Undecided, None),
                None => SampleState::Seen,
            };
            let sample = o.t as u32;
            self.take_pixels(&spans[o.piece as usize], sample..sample + 1, state, area, tally);
        }
        self.open = open;
        self.open.clear();
    }

    /// Number of the polygon of an id among the faces.
    fn face_of(&mut self, id: u32) -> Option<usize> {
        let slot = self.frame.slot_of_id(id)?;
        self.faces.of_slot(self.frame, slot)
    }

    /// Where a pixel's ray meets the patch.
    fn place(&self, line: u32, sample: u32, area: &Area<'_, '_>) -> DVec3 {
        let ray = match self.frame.sensor.grid() {
            PixelGrid::Lines(grid) => grid.image_from_line() * grid.line_ray(line as usize, sample as usize),
            PixelGrid::Rays(_) => self.frame.sensor.ray(sample, line).unwrap_or(DVec3::ZERO),
        };
        ray / area.inverse.dot(ray)
    }

    /// Column and row of a sample.
    fn column_row(&self, line: u32, sample: u32) -> (u32, u32) {
        match self.frame.sensor.grid() {
            PixelGrid::Lines(grid) if grid.axis() == LineAxis::Columns => (line, sample),
            _ => (sample, line),
        }
    }

    fn number_at(&self, line: u32, sample: u32) -> usize {
        let (column, row) = self.column_row(line, sample);
        row as usize * self.frame.images.width as usize + column as usize
    }

    fn id_at(&self, line: u32, sample: u32) -> u32 {
        self.frame.images.polygon_id[self.number_at(line, sample)]
    }

    /// Its place in the unwrapped image.
    fn pixel_at(&self, span: &Span, sample: u32) -> DVec2 {
        let (column, row) = self.column_row(span.line, sample);
        DVec2::new(f64::from(column) + span.turned, f64::from(row))
    }

    fn take_pixels(
        &mut self,
        span: &Span,
        run: Range<u32>,
        state: SampleState,
        area: &Area<'_, '_>,
        tally: &mut Tally,
    ) {
        let count = run.len();
        tally.take_pixels(state, count);
        match state {
            SampleState::Hidden(Reason::Occluded, _) => self.stats.hidden_by_neighbours += count,
            SampleState::Hidden(Reason::Undecided, _) => self.stats.undecided += count,
            SampleState::Hidden(..) => {}
            SampleState::Seen => {
                self.stats.visible += count;
                for sample in [run.start, run.end - 1] {
                    tally.reach(self.pixel_at(span, sample));
                }
                for sample in self.nearest_of(span.line, run.clone(), area) {
                    tally.see_at(self.place(span.line, sample, area));
                }
                if self.frame.options.feature_id {
                    tally.pixels.extend(run.map(|sample| self.number_at(span.line, sample) as u32));
                }
            }
        }
    }

    /// Samples of a run of which one is the nearest.
    fn nearest_of(&self, line: u32, run: Range<u32>, area: &Area<'_, '_>) -> [u32; 2] {
        let PixelGrid::Lines(grid) = self.frame.sensor.grid() else { return [run.start; 2] };
        let last = run.end - 1;
        if run.start == last {
            return [last; 2];
        }
        // The line of the patch that the line of pixels sees, and the foot of the sensor on it.
        let [a, b] = [run.start, last].map(|sample| self.place(line, sample, area));
        let along = b - a;
        let share = -a.dot(along) / along.length_squared();
        // Only what is between the two is known to be before the sensor.
        if !(share > 0.0 && share < 1.0) {
            return [if share >= 1.0 { last } else { run.start }; 2];
        }
        let s = grid.line_from_image() * (a + share * along);
        let [c0, c1] = grid.lines()[line as usize];
        let after = grid.samples_below(s.z * (c0 * c0 + c1 * c1) / (s.x * c0 + s.y * c1)) as u32;
        [after.saturating_sub(1), after].map(|sample| sample.clamp(run.start, last))
    }
}
