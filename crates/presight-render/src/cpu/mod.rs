//! The CPU engine: exact spans in f64 on all cores, the default where no hardware GPU is.
//!
//! | stage | in | out | its twin on the GPU |
//! |---|---|---|---|
//! | `cull` | runs of the plan | runs that no earlier wave hides | `cull.wgsl` drops single polygons: out of view, facing away, material |
//! | `setup` | runs | batches: polygons that may cover a ray, with planes, edges and bounds | `setup.wgsl` |
//! | `raster_lines` or `raster_rays` | batches | a band of the z-buffer: inverse depth and winner per ray | `raster_lines.wgsl`, `raster_rays.wgsl` |
//! | `resolve` | the band | the requested images | `resolve.wgsl` |
//!
//! Times and what was left out are reported as `hidden`, `setup`, `rasterization` and `resolve`.
//!
//! Nearest wins, bit-equal inverse depths go to the lower slot: the order of work, and with it the number of
//! threads, cannot change a bit.

mod batch;
mod bounds;
mod cull;
mod lanes;
mod progress;
mod raster_lines;
mod raster_rays;
mod ray_bounds;
mod resolve;
mod row;
mod setup;
mod sieve;
mod thinning;
mod tiles;

pub use tiles::Vectors;

use crate::ablation::Means;
use crate::deadline::{DeadlineOutcome, Watch};
use crate::plan::{CountName, FramePlan, Images, NOTHING_IN_VIEW, Run, StageName, Stats, Way};
use batch::{Batch, Winners};
use bounds::Bounds;
use cull::Occlusion;
use presight_model::clock::Instant;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::memory::{self, FrameMemory};
use presight_model::sensor::{ImagePart, LineAxis, PixelGrid};
use presight_model::threads::Threads;
use progress::FrameProgress;
use raster_lines::Buffer;
use rayon::prelude::*;
use row::RowDrawer;
use std::ops::{Range, RangeInclusive};
use std::sync::Arc;
use std::time::Duration;

/// The CPU engine with its threads and buffers.
pub struct CpuEngine {
    pool: Arc<rayon::ThreadPool>,
    /// All work of a frame is done by the thread that asks.
    alone: bool,
    batches: Vec<Batch>,
    winners: Winners,
    canvas: Vec<Buffer>,
    /// Images of a part, before they are whole ones.
    part: Images,
    /// Memory of the threads that trace tiles, the number of the frame, and the width of the search.
    rooms: Vec<tiles::Room>,
    frame: u64,
    vectors: Vectors,
    /// What the trees that are lacking cost, and what frames without them have cost so far: in polygons.
    price: u64,
    savings: u64,
    row: RowDrawer,
}

/// Pixels of a band: small enough for its z-buffer to stay in the L2 cache.
const BAND_PIXELS: usize = 8192;

/// Pixels for each polygon of the first wave, and how many polygons it has at least and at most; every further wave takes as many
/// as all before it together. Few pixels are soon covered, and another wave costs a pass over them.
const PIXELS_PER_POLYGON: usize = 16;
const FIRST_WAVE: RangeInclusive<usize> = 256..=4096;

/// Frames of fewer rays are drawn by the calling thread: another one takes longer to wake up than it saves.
const FEW_RAYS: usize = 1024;

/// Nanoseconds of a slow core between looks at the clock: a polygon's setup, and its drawing in a band without its samples, of which each
/// takes one.
const SETUP_NS: u64 = 100;
const POLYGON_NS: u64 = 100;

/// Runs that a task looks at to drop what is hidden.
const SIFTED: usize = 64;

impl CpuEngine {
    /// On these threads, or on so many; 0 takes all cores.
    ///
    /// # Errors
    /// As [`Threads::new`].
    pub fn new(threads: impl Into<Threads>) -> Result<Self> {
        Ok(Self::on_pool(threads.into().pool()?, false))
    }

    fn on_pool(pool: Arc<rayon::ThreadPool>, alone: bool) -> Self {
        Self {
            pool,
            alone,
            batches: Vec::new(),
            winners: Winners::default(),
            canvas: Vec::new(),
            part: Images::default(),
            row: RowDrawer::default(),
            rooms: Vec::new(),
            frame: 0,
            vectors: Vectors::best(),
            price: 0,
            savings: 0,
        }
    }

    /// Another one that hands no work to other threads, for a task on one of the pool's.
    pub fn on_one_thread(&self) -> Self {
        Self { vectors: self.vectors, ..Self::on_pool(self.pool.clone(), true) }
    }

    /// Searches trees with these vectors, for tests and benches; with narrower ones if the processor lacks them.
    #[must_use]
    pub fn with_vectors(self, vectors: Vectors) -> Self {
        Self { vectors, ..self }
    }

    /// How many threads it has.
    pub fn threads(&self) -> usize {
        if self.alone { 1 } else { self.pool.current_num_threads() }
    }

    /// Fills the asked images.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the plan holds more polygons than the engine can number;
    /// [`presight_model::ErrorKind::System`] if there is no memory for the images; those of
    /// [`presight_model::Pose::check`], if the plan's pose was changed.
    pub fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        if let Some(cut) = &plan.cut {
            return self.draw_row(plan, cut, images, stats);
        }
        match plan.part() {
            Some(part) => self.draw_part(plan, Duration::ZERO, part, images, stats),
            None => match self.draw(plan, images, stats)? {
                Some(stride) => {
                    let part = ImagePart { stride, ..plan.sensor.whole() };
                    self.draw_part(plan, saved(plan, stride), part, images, stats)
                }
                None => Ok(()),
            },
        }
    }

    /// Fills the images of a part, which has so much more time and may have to be thinned, and leaves the rest out.
    fn draw_part(
        &mut self,
        plan: &FramePlan,
        more: Duration,
        part: ImagePart,
        images: &mut Images,
        stats: &mut Stats,
    ) -> Result<()> {
        let (mut of_part, mut since) = (std::mem::take(&mut self.part), plan.elapsed());
        let stride = self.draw(&plan.of_part(part, more)?, &mut of_part, stats)?;
        let part = ImagePart { stride: stride.unwrap_or(part.stride), ..part };
        if let Some(stride) = stride {
            since = plan.elapsed();
            self.draw(&plan.of_part(part, more + saved(plan, stride))?, &mut of_part, stats)?;
        }
        let left_out = images.spread(&of_part, &part, &plan.sensor)?;
        self.part = of_part;
        stats.work.image_bytes = images.bytes();
        progress::tell_part(plan, &part, since, left_out, stats);
        Ok(())
    }

    /// Fills the asked images. The answer is a stride where thinned images, for which nothing is done yet, would have more samples by
    /// the deadline.
    fn draw(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<Option<u32>> {
        plan.world_from_sensor.check()?;
        if plan.way() == Way::Tiles {
            match self.draw_tiles(plan, images, stats) {
                Ok(true) => return Ok(None),
                Ok(false) => {}
                Err(fault) if fault.kind() == ErrorKind::System => {
                    stats.notices.push(format!("the raster drew in place of tiles: {fault}"));
                }
                Err(fault) => return Err(fault),
            }
            let selected = plan.selected()?;
            self.savings += tiles::FRAME_PRICE + selected.polygon_count as u64;
            return self.draw(&selected, images, stats);
        }
        stats.way = Some(Way::Raster);
        stats.engine = "cpu";
        let few = plan.limit.is_none() && plan.sensor.width() as usize * (plan.sensor.height() as usize) < FEW_RAYS;
        stats.threads = if few { 1 } else { self.threads() };
        let bands = Bands::new(plan.sensor.grid(), stats.threads);
        self.require_memory(plan, &bands, images)?;
        images.try_prepare(plan.sensor.width(), plan.sensor.height(), plan.drawn())?;
        // Winners are numbered in 32 bits, and a polygon over the azimuth seam is set up twice.
        if plan.polygon_count >= (u32::MAX / 2) as usize {
            return Err(Error::invalid(
                format!("{} polygons in view are more than the CPU engine can number", plan.polygon_count),
                "lower range_max or split the environment",
            ));
        }
        // Beyond a radius there may be something.
        if plan.polygon_count == 0 && plan.radius().is_none() {
            images.show_nothing(plan.sensor.grid());
            plan.finish_noting(images, stats)?;
            stats.leave_out(StageName::SetupAndRasterization, NOTHING_IN_VIEW);
            stats.count(CountName::PolygonsSelected, 0);
            let drawn_ms = plan.watch().map(|watch| watch.elapsed().as_secs_f64() * 1e3);
            stats.deadline = drawn_ms.map(|drawn_ms| DeadlineOutcome { drawn_ms, ..DeadlineOutcome::default() });
            return Ok(None);
        }
        self.reserve_canvas(&bands)?;
        let Self { pool, alone, batches, winners, canvas, .. } = self;
        let canvas = &mut canvas[..bands.count()];
        // Here nothing waits for another task, and no other one comes between.
        let here = *alone || few;
        let mut draw = || {
            let used = match draw_waves(plan, &bands, here, (batches, winners), canvas, images, stats) {
                Drawn::All(used) => used,
                Drawn::Thinned(stride) => return Some(stride),
            };
            stats.count(CountName::PolygonsPlaced, batches[..used].iter().map(|b| b.placed).sum());
            stats.count(CountName::PolygonsPassed, batches[..used].iter().map(|b| b.passed).sum());
            stats.count(CountName::PolygonsBounded, batches[..used].iter().map(|b| b.bounded).sum());
            stats.count(CountName::PolygonsSetUp, batches[..used].iter().map(|b| b.polygons.len()).sum());
            stats.count(CountName::PolygonsHidden, batches[..used].iter().map(|b| b.hidden).sum());
            stats.count(CountName::PolygonsBetweenSamples, batches[..used].iter().map(|b| b.between).sum());
            stats.count(CountName::PolygonsEdgeOn, batches[..used].iter().map(|b| b.edge_on).sum());
            None
        };
        // The whole frame on the pool: between two stages its threads stay awake.
        let stride = if here { draw() } else { pool.install(draw) };
        if stride.is_none() {
            plan.finish_noting(images, stats)?;
        }
        Ok(stride)
    }
}

/// What time thinned images save, by the plan's pace.
fn saved(plan: &FramePlan, stride: u32) -> Duration {
    plan.pace().map_or(Duration::ZERO, |pace| Duration::from_secs_f64(pace.saved(stride)))
}

/// Images and buffers that take less are not asked for beforehand.
const LITTLE: u64 = 64 << 20;

impl CpuEngine {
    /// Takes the memory of the bands' buffers.
    fn reserve_canvas(&mut self, bands: &Bands) -> Result<()> {
        if self.canvas.len() < bands.count() {
            self.canvas.resize_with(bands.count(), Buffer::default);
        }
        for (band, buffer) in self.canvas[..bands.count()].iter_mut().enumerate() {
            buffer.reserve(bands.axis, bands.lines(band).len(), bands.samples)?;
        }
        Ok(())
    }

    /// That there is room for what buffers and images do not hold yet.
    fn require_memory(&self, plan: &FramePlan, bands: &Bands, images: &Images) -> Result<()> {
        let frame = FrameMemory {
            pixels: (bands.lines * bands.samples) as u64,
            scanner: bands.axis == LineAxis::Columns,
            images: plan.drawn().iter().count() as u64,
            ..FrameMemory::default()
        };
        let held = self.canvas.iter().map(Buffer::bytes).sum::<u64>() + images.bytes();
        let missing = frame.bytes().saturating_sub(held);
        if missing > LITTLE { memory::require(missing) } else { Ok(()) }
    }
}

/// What came of drawing.
enum Drawn {
    /// Images, with so many batches.
    All(usize),
    /// Nothing yet: every so many columns and rows are to be drawn instead.
    Thinned(u32),
}

/// Sets up and draws all runs, nearest first, on the threads of a pool or `here`.
fn draw_waves(
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

const _: () = assert!(resolve::TOGETHER.is_multiple_of(cull::TILE));

/// How the image is cut into bands of lines, each one task.
pub(crate) struct Bands {
    axis: LineAxis,
    lines: usize,
    samples: usize,
    per_band: usize,
}

impl Bands {
    fn new(grid: &PixelGrid, threads: usize) -> Self {
        let (axis, lines, samples, multiple) = match grid {
            PixelGrid::Lines(g) if g.axis() == LineAxis::Columns => {
                (g.axis(), g.lines().len(), g.weights().len(), resolve::TOGETHER)
            }
            PixelGrid::Lines(g) => (g.axis(), g.lines().len(), g.weights().len(), cull::TILE),
            PixelGrid::Rays(g) => (LineAxis::Rows, g.height() as usize, g.width() as usize, raster_rays::BAND_MULTIPLE),
        };
        let fair = lines.div_ceil(4 * threads);
        let per_band = (BAND_PIXELS / samples).max(1).min(fair).max(8).div_ceil(multiple) * multiple;
        Self { axis, lines, samples, per_band }
    }

    fn count(&self) -> usize {
        self.lines.div_ceil(self.per_band)
    }

    fn lines(&self, band: usize) -> Range<usize> {
        let first = band * self.per_band;
        first..(first + self.per_band).min(self.lines)
    }

    /// The bands that a range of lines touches.
    fn touched(&self, lines: Range<usize>) -> Range<usize> {
        lines.start / self.per_band..lines.end.div_ceil(self.per_band)
    }
}

#[cfg(test)]
mod tests;
