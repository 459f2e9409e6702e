//! Draws the selected runs in waves, nearest first, so that what earlier waves drew hides later runs before they are set up.

use super::batch::{self, Batch, Winners};
use super::bounds::Bounds;
use super::cull::{self, Occlusion};
use super::progress::{self, FrameProgress};
use super::raster_lines::{self, Buffer};
use super::{Bands, raster_rays, resolve, setup, thinning};
use crate::ablation::Means;
use crate::deadline::Watch;
use crate::plan::{CountName, FramePlan, Images, Run, StageName, Stats};
use presight_model::clock::Instant;
use presight_model::sensor::PixelGrid;
use rayon::prelude::*;
use std::ops::{Range, RangeInclusive};
use std::time::Duration;

/// Pixels for each polygon of the first wave, and how many polygons it has at least and at most; every further wave takes as many
/// as all before it together. Few pixels are soon covered, and another wave costs a pass over them.
const PIXELS_PER_POLYGON: usize = 16;
pub(super) const FIRST_WAVE: RangeInclusive<usize> = 256..=4096;

/// Nanoseconds of a slow core between looks at the clock: a polygon's setup, and its drawing in a band without its samples, of which each
/// takes one.
const SETUP_NS: u64 = 100;
const POLYGON_NS: u64 = 100;

/// Runs that a task looks at to drop what is hidden.
const SIFTED: usize = 64;

/// What came of drawing.
pub(super) enum Drawn {
    /// Images, with so many batches.
    All(usize),
    /// Nothing yet: every so many columns and rows are to be drawn instead.
    Thinned(u32),
}

/// Sets up and draws all runs, nearest first, on the threads of a pool or `here`.
pub(super) fn draw_waves(
    plan: &FramePlan,
    bands: &Bands,
    here: bool,
    (batches, winners): (&mut Vec<Batch>, &mut Winners),
    canvas: &mut [Buffer],
    images: &mut Images,
    stats: &mut Stats,
) -> Drawn {
    let arch = pulp::Arch::new();
    let mut targets = resolve::split(images, bands);
    winners.clear();
    let mut times = [Duration::ZERO; 3];
    let (mut done, mut used, mut hidden, mut waves) = (0, 0, 0, 0);
    let mut progress = FrameProgress::new(plan, bands.count());
    let pixels = plan.sensor.width() as usize * plan.sensor.height() as usize;
    let first_wave = (pixels / PIXELS_PER_POLYGON).clamp(*FIRST_WAVE.start(), *FIRST_WAVE.end());
    loop {
        let start = Instant::now();
        let wave = progress::next_wave(&plan.runs, done, first_wave, progress.most_polygons(done));
        let runs = if waves == 0 || !Means::HiddenRuns.is_used() {
            plan.runs[wave.clone()].to_vec()
        } else {
            let sift = |runs| arch.dispatch(Cull { plan, runs, canvas, bands });
            let runs = &plan.runs[wave.clone()];
            if here { sift(runs) } else { runs.par_chunks(SIFTED).map(sift).collect::<Vec<_>>().concat() }
        };
        hidden += wave.len() - runs.len();
        done = wave.end;
        times[0] += start.elapsed();

        let start = Instant::now();
        let first = used;
        let occlusion = (waves > 0 && Means::HiddenPolygons.is_used()).then_some(Occlusion { canvas, bands });
        let left_out = set_up(plan, bands, occlusion, here, &runs, batches, &mut used);
        batches[first..used].iter_mut().for_each(|batch| winners.number(batch));
        times[1] += start.elapsed();

        let start = Instant::now();
        let batches = &batches[first..used];
        let last = left_out.is_some() || done == plan.runs.len();
        let beyond = left_out.unwrap_or_else(|| plan.nearest_after(done));
        if waves == 0
            && let stride @ 2.. = progress.begin_wave(batches, done, beyond, times[0] + times[1])
        {
            stats.stages_ms.push((StageName::Setup, (times[0] + times[1]).as_secs_f64() * 1e3));
            return Drawn::Thinned(stride);
        }
        let wave = WaveEnds { first: waves == 0, last, beyond };
        draw_wave(plan, bands, here, (batches, winners), canvas, &mut targets, &mut progress, wave);
        waves += 1;
        progress.end_wave(waves, last);
        if !last && progress.is_over() {
            let resolve = |(band, ((buffer, target), progress))| {
                arch.dispatch(Resolve { buffer, target, plan, winners, bands, band, progress });
            };
            if here {
                canvas.iter().zip(&mut targets).zip(&mut progress.bands).enumerate().for_each(resolve);
            } else {
                canvas.par_iter().zip(&mut targets).zip(&mut progress.bands).enumerate().for_each(resolve);
            }
        }
        times[2] += start.elapsed();
        if last || progress.has_stopped {
            break;
        }
    }
    progress::tell_stages(times, waves, stats);
    stats.count(CountName::PolygonsSelected, plan.polygon_count);
    stats.count(CountName::RunsSelected, plan.runs.len());
    stats.count(CountName::RunsHidden, hidden);
    stats.count(CountName::Waves, waves);
    progress.tell(stats);
    Drawn::All(used)
}

/// Where a wave lies in its frame.
#[derive(Clone, Copy)]
struct WaveEnds {
    first: bool,
    last: bool,
    /// Metres: nothing that follows is nearer.
    beyond: f32,
}

/// Draws the batches of a wave into all bands, and resolves them after the last wave.
#[expect(clippy::too_many_arguments, reason = "they are parts of one frame that are borrowed apart")]
fn draw_wave(
    plan: &FramePlan,
    bands: &Bands,
    here: bool,
    (batches, winners): (&[Batch], &Winners),
    canvas: &mut [Buffer],
    targets: &mut [resolve::Target<'_>],
    progress: &mut FrameProgress<'_>,
    wave: WaveEnds,
) {
    let arch = pulp::Arch::new();
    // In step every band draws a batch before any draws the next one: stopped, they are complete to about the same distance.
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
            arch.dispatch(Draw { buffer, target, plan, batches: some, winners, bands, band, part, progress });
        };
        if here {
            canvas.iter_mut().zip(&mut *targets).zip(&mut progress.bands).enumerate().for_each(draw);
        } else {
            canvas.par_iter_mut().zip(&mut *targets).zip(&mut progress.bands).enumerate().for_each(draw);
        }
    }
}

/// Sets up the runs of a wave, in batches after those in use. Returns the nearest distance of what was left out because the time
/// was up.
fn set_up(
    plan: &FramePlan,
    bands: &Bands,
    occlusion: Option<Occlusion<'_>>,
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
        batch.is_set_up = !plan.watch().is_some_and(|watch| watch.is_over_after(SETUP_NS * polygons));
        if batch.is_set_up {
            arch.dispatch(SetUp { batch: &mut *batch, plan, runs: &runs[group.clone()], bands, occlusion });
            if plan.limit.is_some() && occlusion.is_none() {
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

/// Drops what is hidden from a wave. Tasks are types, not closures, so that they are compiled for each vector width.
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
    /// After the first wave.
    occlusion: Option<Occlusion<'a>>,
}

impl pulp::WithSimd for SetUp<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        setup::fill(simd, self.batch, self.plan, self.runs, self.bands, self.occlusion);
    }
}

/// Where the batches of a task lie in their wave.
#[derive(Clone, Copy)]
struct WavePart {
    /// Nothing was drawn before.
    clear: bool,
    /// They are the last ones of the wave.
    end: bool,
    /// They are drawn without a look at the clock between them.
    at_once: bool,
    /// Metres: nothing that follows them is nearer.
    beyond: f32,
}

/// Draws a wave into a band and, after the last one, resolves it.
struct Draw<'a, 't> {
    buffer: &'a mut Buffer,
    /// After the last wave.
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
        // What has stopped stays as it is.
        let batches = if progress.has_stopped { &[] } else { batches };
        if !progress.has_stopped {
            progress.complete_to = beyond;
        }
        // One by one where the time may run out.
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

/// Makes a band's images of what is drawn.
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
