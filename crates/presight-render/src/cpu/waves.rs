//! Draws the selected runs in waves, nearest first, so that earlier waves hide later runs before their setup.

use super::batch::{self, Batch, Winners};
use super::bounds::Bounds;
use super::cull;
use super::progress::{self, FIRST_WAVE, FrameProgress};
use super::raster_lines::{self, Buffer};
use super::{Bands, raster_rays, resolve, setup, thinning};
use crate::deadline::Watch;
use crate::plan::{CountName, FramePlan, Images, Run, StageName, Stats};
use presight_model::clock::Instant;
use presight_model::sensor::PixelGrid;
use rayon::prelude::*;
use std::ops::Range;
use std::time::Duration;

/// Number of pixels for each polygon of the first wave. Few pixels are soon covered, and another wave costs a pass over
/// them.
const PIXELS_PER_POLYGON: usize = 16;

/// Nanoseconds of a slow core between readings of the clock: for a polygon's setup, and for its drawing in a band
/// without its samples, which take 1 ns each.
const POLYGON_NS: u64 = 100;

/// Number of runs that a task tests for occlusion.
const SIFTED: usize = 64;

/// One in eight of the runs after the first wave is tested against the z-buffer to estimate the number of visible ones.
/// Up to 64 runs are all tested.
const SAMPLED: usize = 8;
const FEW_RUNS: usize = 64;

/// Result of drawing.
pub(super) enum Drawn {
    /// The images are filled.
    All,
    /// The images are empty: the image is to be thinned to every n-th column and row.
    Thinned(u32),
    /// The images are empty: too many polygons may be visible after the first wave, so tiles are faster.
    TooMany,
}

/// Draws the selected runs of a frame, on the threads of a pool or `here`.
pub(super) struct Waves<'a, 'i> {
    plan: &'a FramePlan,
    bands: &'a Bands,
    here: bool,
    batches: &'a mut Vec<Batch>,
    winners: &'a mut Winners,
    canvas: &'a mut [Buffer],
    targets: Vec<resolve::Target<'i>>,
    progress: FrameProgress<'a>,
    /// Times for culling, setup and drawing.
    times: [Duration; 3],
    /// Numbers of completed runs, completed batches, hidden runs, and waves.
    done: usize,
    used: usize,
    hidden: usize,
    waves: usize,
    /// Number of polygons that may be visible after the first wave, if they were counted.
    pub left: Option<u64>,
}

impl<'a, 'i> Waves<'a, 'i> {
    pub fn new(
        plan: &'a FramePlan,
        bands: &'a Bands,
        here: bool,
        (batches, winners): (&'a mut Vec<Batch>, &'a mut Winners),
        canvas: &'a mut [Buffer],
        images: &'i mut Images,
    ) -> Self {
        winners.clear();
        let (targets, progress) = (resolve::split(images, bands), FrameProgress::new(plan, bands.count()));
        let (times, done, used, hidden, waves) = ([Duration::ZERO; 3], 0, 0, 0, 0);
        Self {
            plan,
            bands,
            here,
            batches,
            winners,
            canvas,
            targets,
            progress,
            times,
            done,
            used,
            hidden,
            waves,
            left: None,
        }
    }

    /// Sets up and draws all runs, nearest first. If `may_turn`, it stops after the first wave if tiles are faster.
    pub fn draw_all(&mut self, may_turn: bool, stats: &mut Stats) -> Drawn {
        loop {
            let start = Instant::now();
            if self.waves == 1 && self.has_too_many() && may_turn {
                let spent = self.times.iter().sum::<Duration>() + start.elapsed();
                stats.stages_ms.push((StageName::FirstWave, spent.as_secs_f64() * 1e3));
                stats.count(CountName::PolygonsSelected, self.plan.polygon_count);
                stats.count(CountName::PolygonsLeft, self.left.unwrap_or(0) as usize);
                return Drawn::TooMany;
            }
            let wave = self.next_wave();
            let runs = self.cull(wave);
            self.times[0] += start.elapsed();
            let (start, first) = (Instant::now(), self.used);
            let left_out = self.set_up(&runs);
            self.times[1] += start.elapsed();
            let start = Instant::now();
            let last = left_out.is_some() || self.done == self.plan.runs.len();
            let beyond = left_out.unwrap_or_else(|| self.plan.nearest_after(self.done));
            let spent = self.times[0] + self.times[1];
            if self.waves == 0
                && let stride @ 2.. =
                    self.progress.begin_wave(&self.batches[first..self.used], self.done, beyond, spent)
            {
                stats.stages_ms.push((StageName::Setup, spent.as_secs_f64() * 1e3));
                return Drawn::Thinned(stride);
            }
            self.draw(first, WaveEnds { first: self.waves == 0, last, beyond });
            self.waves += 1;
            self.progress.end_wave(self.waves, last);
            if !last && self.progress.is_over() {
                self.resolve();
            }
            self.times[2] += start.elapsed();
            if last || self.progress.has_stopped {
                break;
            }
        }
        self.finish(stats);
        Drawn::All
    }

    /// The runs to draw next.
    fn next_wave(&self) -> Range<usize> {
        let pixels = self.plan.sensor.width() as usize * self.plan.sensor.height() as usize;
        let first = (pixels / PIXELS_PER_POLYGON).clamp(*FIRST_WAVE.start(), *FIRST_WAVE.end());
        progress::next_wave(&self.plan.runs, self.done, first, self.progress.max_polygons(self.done))
    }

    /// The runs of a wave that earlier waves do not hide.
    fn cull(&mut self, wave: Range<usize>) -> Vec<Run> {
        let runs = &self.plan.runs[wave.clone()];
        let kept = if self.waves == 0 { runs.to_vec() } else { self.sift(runs) };
        self.hidden += runs.len() - kept.len();
        self.done = wave.end;
        kept
    }

    /// The runs that the z-buffer does not hide.
    fn sift(&self, runs: &[Run]) -> Vec<Run> {
        let Self { plan, bands, canvas, .. } = self;
        let sift = |runs| pulp::Arch::new().dispatch(Cull { plan, runs, canvas, bands });
        if self.here { sift(runs) } else { runs.par_chunks(SIFTED).map(sift).collect::<Vec<_>>().concat() }
    }

    /// Counts the polygons that may be visible after the first wave, and returns true if tiles are faster for this
    /// number.
    fn has_too_many(&mut self) -> bool {
        let most = self.plan.chosen().max_left;
        let (rest, polygons) =
            (&self.plan.runs[self.done..], |runs: &[Run]| -> u64 { runs.iter().map(|run| u64::from(run.count)).sum() });
        let is_late =
            self.plan.limit.as_ref().is_some_and(|limit| limit.tiles.is_none_or(|most| limit.watch.left() < most));
        if is_late || polygons(rest) <= most {
            return false;
        }
        let step = if rest.len() <= FEW_RUNS { 1 } else { SAMPLED };
        let sampled: Vec<Run> = rest.iter().copied().step_by(step).collect();
        let left = step as u64 * polygons(&self.sift(&sampled));
        self.left = Some(left);
        left > most
    }

    /// Sets up runs, in batches after those in use. Returns the nearest distance of the runs that were left out because
    /// the time was up.
    fn set_up(&mut self, runs: &[Run]) -> Option<f32> {
        let Self { plan, bands, here, batches, winners, used, .. } = self;
        let first = *used;
        let left_out = set_up(plan, bands, self.waves == 0, *here, runs, batches, used);
        batches[first..*used].iter_mut().for_each(|batch| winners.number(batch));
        left_out
    }

    /// Draws the batches from `first` on into all bands, and resolves them after the last wave.
    fn draw(&mut self, first: usize, wave: WaveEnds) {
        let Self { plan, bands, here, batches, winners, canvas, targets, progress, used, .. } = self;
        let (batches, winners) = (&batches[first..*used], &**winners);
        // In step, every band draws a batch before any band draws the next: stopped bands are complete to about the
        // same distance.
        let step = if progress.in_step { 1 } else { batches.len().max(1) };
        let steps = batches.len().div_ceil(step).max(1);
        let at_once = plan.limit.is_none() || progress.has_plenty;
        for k in 0..steps {
            let (some, next) = batches.split_at(batches.len().min((k + 1) * step));
            let (some, beyond) = (&some[k * step..], next.first().map_or(wave.beyond, |batch| batch.nearest));
            let (clear, end) = (wave.first && k == 0, k + 1 == steps);
            if progress.stop_together() && !end {
                continue;
            }
            let draw = |(band, ((buffer, target), progress))| {
                let target: Option<&mut resolve::Target<'_>> = (wave.last && end).then_some(target);
                let part = WavePart { clear, end, at_once, beyond };
                let task = Draw { buffer, target, plan, batches: some, winners, bands, band, part, progress };
                pulp::Arch::new().dispatch(task);
            };
            if *here {
                canvas.iter_mut().zip(&mut *targets).zip(&mut progress.bands).enumerate().for_each(draw);
            } else {
                canvas.par_iter_mut().zip(&mut *targets).zip(&mut progress.bands).enumerate().for_each(draw);
            }
        }
    }

    /// Makes the images from the z-buffer.
    fn resolve(&mut self) {
        let Self { plan, bands, here, winners, canvas, targets, progress, .. } = self;
        let winners = &**winners;
        let resolve = |(band, ((buffer, target), progress))| {
            pulp::Arch::new().dispatch(Resolve { buffer, target, plan, winners, bands, band, progress });
        };
        if *here {
            canvas.iter().zip(targets).zip(&mut progress.bands).enumerate().for_each(resolve);
        } else {
            canvas.par_iter().zip(targets).zip(&mut progress.bands).enumerate().for_each(resolve);
        }
    }

    /// Records times and counts.
    fn finish(&self, stats: &mut Stats) {
        progress::record_stages(self.times, self.waves, stats);
        stats.count(CountName::PolygonsSelected, self.plan.polygon_count);
        stats.count(CountName::RunsSelected, self.plan.runs.len());
        stats.count(CountName::RunsHidden, self.hidden);
        stats.count(CountName::Waves, self.waves);
        if let Some(left) = self.left {
            stats.count(CountName::PolygonsLeft, left as usize);
        }
        self.progress.record(stats);
        let batches = &self.batches[..self.used];
        let sum = |of: fn(&Batch) -> usize| batches.iter().map(of).sum();
        stats.count(CountName::PolygonsPlaced, sum(|b| b.placed));
        stats.count(CountName::PolygonsPassed, sum(|b| b.passed));
        stats.count(CountName::PolygonsBounded, sum(|b| b.bounded));
        stats.count(CountName::PolygonsSetUp, sum(|b| b.polygons.len()));
        stats.count(CountName::PolygonsBetweenSamples, sum(|b| b.between));
        stats.count(CountName::PolygonsEdgeOn, sum(|b| b.edge_on));
    }
}

/// Position of a wave in its frame.
#[derive(Clone, Copy)]
struct WaveEnds {
    first: bool,
    last: bool,
    /// Lower bound of the distance of the polygons that follow, metres.
    beyond: f32,
}

/// Sets up the runs of a wave, in batches after those in use. Returns the nearest distance of the runs that were left
/// out because the time was up.
fn set_up(
    plan: &FramePlan,
    bands: &Bands,
    is_first: bool,
    here: bool,
    runs: &[Run],
    batches: &mut Vec<Batch>,
    used: &mut usize,
) -> Option<f32> {
    let arch = pulp::Arch::new();
    let groups = batch::group_runs(runs);
    let first = *used;
    if batches.len() < first + groups.len() {
        batches.resize_with(first + groups.len(), Batch::default);
    }
    let new = &mut batches[first..first + groups.len()];
    let set_up = |(batch, group): (&mut Batch, &Range<usize>)| {
        batch.nearest = runs[group.start].nearest_below();
        let polygons: u64 = runs[group.clone()].iter().map(|run| u64::from(run.count)).sum();
        batch.is_set_up = !plan.watch().is_some_and(|watch| watch.is_over_after(POLYGON_NS * polygons));
        if batch.is_set_up {
            arch.dispatch(SetUp { batch: &mut *batch, plan, runs: &runs[group.clone()], bands });
            if plan.limit.is_some() && is_first {
                batch.pixels = batch.polygons.iter().map(thinning::pixels).sum();
            }
        }
    };
    if here {
        new.iter_mut().zip(&groups).for_each(set_up);
    } else {
        new.par_iter_mut().zip(&groups).for_each(set_up);
    }
    let left_out = new.iter().position(|batch| !batch.is_set_up);
    *used += left_out.unwrap_or(new.len());
    left_out.map(|i| new[i].nearest)
}

/// Drops the hidden runs of a wave. Tasks are types instead of closures, so that they are compiled for each vector
/// width.
struct Cull<'a> {
    plan: &'a FramePlan,
    runs: &'a [Run],
    canvas: &'a [Buffer],
    bands: &'a Bands,
}

impl pulp::WithSimd for Cull<'_> {
    type Output = Vec<Run>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) -> Vec<Run> {
        let bounds = Bounds::new(&self.plan.sensor);
        cull::visible(simd, self.plan, &bounds, self.runs, self.canvas, self.bands)
    }
}

/// Sets up a batch.
struct SetUp<'a> {
    batch: &'a mut Batch,
    plan: &'a FramePlan,
    runs: &'a [Run],
    bands: &'a Bands,
}

impl pulp::WithSimd for SetUp<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        setup::fill(simd, self.batch, self.plan, self.runs, self.bands);
    }
}

/// Position of a task's batches in their wave.
#[derive(Clone, Copy)]
struct WavePart {
    /// True if the buffer is empty so far.
    clear: bool,
    /// True for the last batches of the wave.
    end: bool,
    /// True if they are drawn without reading the clock between them.
    at_once: bool,
    /// Lower bound of the distance of the polygons that follow them, metres.
    beyond: f32,
}

/// Draws a wave into a band and, after the last one, resolves it.
struct Draw<'a, 't> {
    buffer: &'a mut Buffer,
    /// Target of the images, after the last wave.
    target: Option<&'a mut resolve::Target<'t>>,
    plan: &'a FramePlan,
    batches: &'a [Batch],
    winners: &'a Winners,
    bands: &'a Bands,
    band: usize,
    part: WavePart,
    progress: &'a mut progress::Band,
}

impl pulp::WithSimd for Draw<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Self { buffer, target, plan, batches, winners, bands, band, part, progress } = self;
        let WavePart { clear, end, at_once, beyond } = part;
        let (slots, grid) = (&winners.slots, plan.sensor.grid());
        match grid {
            PixelGrid::Lines(_) if clear => {
                buffer.clear(bands.axis, bands.lines(band).len(), bands.samples);
                buffer.clear_farthest(bands.lines(band).len(), bands.samples, 0.0);
            }
            PixelGrid::Rays(grid) if clear => raster_rays::clear(buffer, grid, bands, band),
            _ => {}
        }
        // A stopped band is not drawn any further.
        let batches = if progress.has_stopped { &[] } else { batches };
        if !progress.has_stopped {
            progress.complete_to = beyond;
        }
        // One by one if the time may run out.
        let together = if at_once { batches.len().max(1) } else { 1 };
        for some in batches.chunks(together) {
            let over = plan.watch().is_some_and(|watch| {
                let polygons: u64 = some.iter().map(|batch| batch.in_band(band).len() as u64).sum();
                watch.is_over_after(POLYGON_NS * polygons + std::mem::take(&mut progress.unwatched))
            });
            if over {
                (progress.complete_to, progress.has_stopped) = (some[0].nearest, true);
                break;
            }
            let [tested, spans] = match grid {
                PixelGrid::Lines(grid) => raster_lines::rasterize(simd, buffer, grid, some, slots, bands, band),
                PixelGrid::Rays(grid) => raster_rays::rasterize(simd, buffer, grid, some, slots, bands, band),
            };
            progress.stale |= tested > 0;
            progress.tested += tested;
            progress.unwatched += tested;
            progress.spans += spans;
        }
        if let Some(target) = target {
            Resolve { buffer, target, plan, winners, bands, band, progress }.with_simd(simd);
        } else if end && progress.stale && !progress.has_stopped && matches!(grid, PixelGrid::Lines(_)) {
            progress.stale = false;
            cull::measure(buffer, bands.lines(band).len(), bands.samples);
        }
    }
}

/// Fills a band's images from its z-buffer.
struct Resolve<'a, 't> {
    buffer: &'a Buffer,
    target: &'a mut resolve::Target<'t>,
    plan: &'a FramePlan,
    winners: &'a Winners,
    bands: &'a Bands,
    band: usize,
    progress: &'a mut progress::Band,
}

impl pulp::WithSimd for Resolve<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { buffer, target, plan, winners, bands, band, progress } = self;
        let start = plan.watch().map(Watch::elapsed);
        (progress.given_up, progress.written) =
            resolve::resolve(target, buffer, plan, &winners.shades, bands, band, progress.complete_to);
        if let (Some(watch), Some(start)) = (plan.watch(), start) {
            progress.resolving = watch.elapsed().saturating_sub(start);
        }
    }
}
