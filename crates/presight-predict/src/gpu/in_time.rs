//! Frames with a deadline. A submission cannot be stopped, so polygons are submitted in pieces, nearest first, and the
//! next piece only if it fits. Keys stay on the device between pieces; images are resolved once at the end.
//!
//! A piece is sized to take at most half of the time left, by the learnt costs and the slowest piece of the frame so
//! far. An estimate may thus be off by a factor of two, and a frame still has few pieces.

use super::GpuEngine;
use super::layout::Counters;
use super::part::Part;
use super::submission::Submission;
use presight_model::clock::Instant;
use presight_model::error::Result;
use presight_render::deadline::{DeadlineEngine, DeadlineOutcome, Degradation, DegradationKind, DegradationStep, Wave};
use presight_render::plan::{CountName, FramePlan, Images, Output, Pace, Run, StageName, Stats, Work};
use std::ops::Range;
use std::time::Duration;

/// Pessimistic costs before any were learnt.
const UNKNOWN: Pace = Pace { wave: 1e-3, polygon: 1e-6, sample: 1e-8, saved: [0.0; 3], drawing: 0.0 };
/// Polygons; a smaller piece is not worth a submission.
const MIN_PIECE: u64 = 256;
/// Safety margin for ranges rounded to f32: a pixel is final only if it is nearer than the nearest undrawn surface by
/// this share. Rounding moves a range less, except on polygons met at less than about 1e-4 rad.
const ROUNDING: f32 = 1.0 / 256.0;

impl GpuEngine {
    /// Describes the engine for deadlines; `None` without 64-bit atomics, where ids need another pass over everything.
    pub fn with_deadline(&self) -> Option<DeadlineEngine> {
        let threads = if self.software { self.threads.count().unwrap_or(1) } else { 0 };
        let adapter = Some(self.gpu.adapter.to_string());
        self.gpu.int64.then_some(DeadlineEngine { name: "gpu", adapter, threads, draws_parts: false })
    }

    /// Fills the images of a plan as far as time allows.
    pub(super) fn draw_in_time(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        let (start, before) = (Instant::now(), self.gpu.work());
        let mut pieces = Pieces::new(plan);
        let (mut done, mut drawn) = (0, Counters::default());
        while let Some(piece) = pieces.next(done) {
            let counters = self.draw_piece(plan, piece.clone())?;
            pieces.end();
            drawn.survivors += counters.survivors;
            drawn.items += counters.items;
            drawn.edge_on += counters.edge_on;
            drawn.records += counters.records;
            done = piece.end;
        }
        let drawn_ms = plan.elapsed().as_secs_f64() * 1e3;
        stats.stage(StageName::Device, start);
        let start = Instant::now();
        let outputs = plan.drawn().with(Output::Range);
        images.try_prepare(plan.sensor.width(), plan.sensor.height(), outputs)?;
        if done > 0 {
            drawn.lost_ids = self.resolve_pieces(plan, images)?;
            self.know(self.sensors[0].tables.kind);
            self.report_variants(&self.frames[0], stats);
        } else {
            images.show_nothing(plan.sensor.grid());
        }
        let kept = give_up(plan, done, drawn_ms, images);
        stats.deadline = Some(DeadlineOutcome { wave: pieces.first, ..kept });
        stats.count(CountName::RunsSelected, plan.runs.len());
        stats.count(CountName::PolygonsSelected, plan.polygon_count);
        stats.count(CountName::Waves, pieces.number);
        stats.count(CountName::PolygonsInView, drawn.survivors as usize);
        stats.count(CountName::PolygonsSetUp, drawn.records as usize);
        stats.count(CountName::PolygonsEdgeOn, drawn.edge_on as usize);
        stats.count(CountName::WorkItems, drawn.items as usize);
        stats.count(CountName::HitsWithoutId, drawn.lost_ids as usize);
        stats.stage(StageName::Readback, start);
        plan.finish_noting(images, stats)?;
        let image_bytes = stats.work.image_bytes;
        stats.work = Work { image_bytes, ..self.gpu.work().since(before) };
        Ok(())
    }

    /// Draws some runs into the keys and waits. The first piece clears the keys.
    fn draw_piece(&mut self, plan: &FramePlan, runs: Range<usize>) -> Result<Counters> {
        let part = Part::Piece { is_first: runs.start == 0 };
        let mut piece = plan.clone();
        piece.runs = plan.runs[runs].to_vec();
        piece.polygon_count = piece.runs.iter().map(|run| run.count as usize).sum();
        self.fill(&[&piece], &Submission::single(part))?;
        let (answer, _) = self.draw(&Submission::single(part))?;
        let counters = self.counters(&answer, part, 0);
        self.count_groups(&counters);
        Ok(counters)
    }

    /// Resolves the keys into images. Returns the number of hits without an id.
    fn resolve_pieces(&mut self, plan: &FramePlan, images: &mut Images) -> Result<u32> {
        let (answer, _) = self.draw(&Submission::single(Part::Images))?;
        let lost = self.counters(&answer, Part::Images, 0).lost_ids;
        Ok(lost + self.frames[0].take_images(&answer, plan, &self.threads, images)?)
    }
}

/// Marks as unknown the pixels that the nearest polygon after the first `done` runs may hide, if there is one.
fn give_up(plan: &FramePlan, done: usize, drawn_ms: f64, images: &mut Images) -> DeadlineOutcome {
    let (stopped, beyond) = (done < plan.runs.len(), plan.nearest_after(done));
    let mut kept = DeadlineOutcome { drawn_ms, ..DeadlineOutcome::default() };
    let complete_to = f64::from(beyond - beyond * ROUNDING);
    if complete_to < f64::INFINITY {
        let samples = images.leave_open(complete_to, plan.sensor.spec().range_min);
        let clock = DegradationStep { means: DegradationKind::Clock, at_ms: drawn_ms, metres: Some(complete_to) };
        let means = stopped.then_some(clock).into_iter().collect();
        kept.given_up = (samples > 0).then_some(Degradation { complete_to, samples, means, ..Degradation::default() });
    }
    if !plan.drawn().has(Output::Range) {
        images.range.clear();
    }
    kept
}

/// Divides the runs of a frame into pieces.
struct Pieces<'a> {
    plan: &'a FramePlan,
    pace: Pace,
    /// Maximum ratio of measured to estimated time among the pieces so far.
    slowest: Option<f64>,
    /// The current piece: its estimated duration and start time.
    estimate: f64,
    began: Duration,
    number: usize,
    /// The first piece, from which the cost model learns.
    first: Option<Wave>,
}

impl<'a> Pieces<'a> {
    fn new(plan: &'a FramePlan) -> Self {
        let (pace, began) = (plan.pace().copied().unwrap_or(UNKNOWN), Duration::ZERO);
        Self { plan, pace, slowest: None, estimate: 0.0, began, number: 0, first: None }
    }

    /// Returns the runs of the next piece, which follow the first `done` runs; `None` if none is left or none fits.
    fn next(&mut self, done: usize) -> Option<Range<usize>> {
        let left = self.plan.watch().map_or(f64::INFINITY, |watch| watch.left().as_secs_f64());
        let most = left / 2.0 / self.slowest.unwrap_or(1.0);
        let (mut end, mut polygons, mut samples) = (done, 0, 0);
        self.estimate = self.pace.wave;
        while let Some(run) = self.plan.runs.get(end) {
            let (more, covered) = (u64::from(run.count), covered(self.plan, run));
            let estimate = self.estimate + self.pace.polygon * more as f64 + self.pace.sample * covered as f64;
            if estimate > most {
                break;
            }
            (end, polygons, samples, self.estimate) = (end + 1, polygons + more, samples + covered, estimate);
        }
        let is_worth_it = end > done && (polygons >= MIN_PIECE || end == self.plan.runs.len());
        if !is_worth_it {
            return None;
        }
        if self.number == 0 {
            self.first = Some(Wave { polygons, samples, estimate_ms: 1e3 * self.estimate, time_ms: 0.0 });
        }
        self.began = self.plan.elapsed();
        Some(done..end)
    }

    /// Records the time of the finished piece.
    fn end(&mut self) {
        let took = self.plan.elapsed().saturating_sub(self.began).as_secs_f64();
        let share = (took / self.estimate).clamp(1e-3, 1e6);
        self.slowest = Some(self.slowest.map_or(share, |slowest| slowest.max(share)));
        if self.number == 0
            && let Some(first) = &mut self.first
        {
            first.time_ms = 1e3 * took;
        }
        self.number += 1;
    }
}

/// Estimates the pixels that a run covers, from the size and distance of its clusters.
fn covered(plan: &FramePlan, run: &Run) -> u64 {
    let instance = &plan.instances[run.instance as usize];
    let clusters = plan.environment().objects()[instance.object as usize].mesh.clusters();
    let first = clusters.partition_point(|c| c.first + c.count <= run.first);
    let of_run = clusters[first..].iter().take_while(|c| c.first < run.first + run.count);
    let shares = of_run.map(|c| {
        let (size, distance) = (c.bounds.size(), c.bounds.distance_squared(instance.center_in_mesh));
        (0.25 * size * size / distance).min(1.0)
    });
    let pixels = f64::from(plan.sensor.width()) * f64::from(plan.sensor.height());
    (pixels * shares.sum::<f64>()) as u64
}
