//! The CPU engine: exact spans in f64 on all cores, the default where no hardware GPU is.
//!
//! | stage | in | out |
//! |---|---|---|
//! | `setup` | runs of the plan | batches: polygons that may cover a ray, with planes, edges and bounds |
//! | `spans` or `rays` | batches | a band of the z-buffer: inverse depth and winner per ray |
//! | `resolve` | the band | the asked images |
//!
//! Nearest wins, bit-equal inverse depths go to the lower slot: the order of work, and with it the number of
//! threads, cannot change a bit.

mod batch;
mod bounds;
mod hidden;
mod rays;
mod resolve;
mod setup;
mod spans;

use crate::error::{Error, ErrorKind, Result};
use crate::plan::{FramePlan, Images, Run, Stats};
use crate::sensor::{LineAxis, PixelGrid};
use batch::Batch;
use bounds::Bounds;
use rayon::prelude::*;
use spans::Buffer;
use std::ops::Range;
use std::time::{Duration, Instant};

/// The CPU engine with its threads and buffers.
pub struct Engine {
    pool: rayon::ThreadPool,
    batches: Vec<Batch>,
    canvas: Vec<Buffer>,
}

/// Pixels of a band: small enough for its z-buffer to stay in the L2 cache.
const BAND_PIXELS: usize = 8192;

/// Polygons of the first wave; every further one takes as many as all before it together.
const FIRST_WAVE: usize = 4096;

impl Engine {
    /// With so many threads; 0 takes all cores.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the threads cannot be started.
    pub fn new(threads: usize) -> Result<Self> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("presight-{i}"))
            .build()
            .map_err(|e| {
                Error::new(ErrorKind::System, "cannot start the threads of the CPU engine", "lower --threads")
                    .caused_by(e)
            })?;
        Ok(Self { pool, batches: Vec::new(), canvas: Vec::new() })
    }

    /// Fills the asked images.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if the plan holds more polygons than the engine can number.
    pub fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        stats.engine = "cpu".into();
        stats.threads = self.pool.current_num_threads();
        images.prepare(plan.sensor.width(), plan.sensor.height(), plan.request.outputs);
        let bands = Bands::new(plan.sensor.grid(), self.pool.current_num_threads());
        let arch = pulp::Arch::new();
        if self.canvas.len() < bands.count() {
            self.canvas.resize_with(bands.count(), Buffer::default);
        }
        let canvas = &mut self.canvas[..bands.count()];
        for (band, buffer) in canvas.iter_mut().enumerate() {
            buffer.clear(bands.lines(band).len() * bands.samples);
        }

        let mut times = [Duration::ZERO; 3];
        let (mut done, mut used, mut hidden) = (0, 0, 0);
        while done < plan.runs.len() {
            let start = Instant::now();
            let wave = next_wave(&plan.runs, done);
            let runs = if used == 0 || matches!(plan.sensor.grid(), PixelGrid::Rays(_)) {
                plan.runs[wave.clone()].to_vec()
            } else {
                arch.dispatch(Sift { plan, runs: &plan.runs[wave.clone()], canvas, bands: &bands })
            };
            hidden += wave.len() - runs.len();
            done = wave.end;
            let groups = batch::group_runs(&runs);
            let first = used;
            used += groups.len();
            if used > batch::MAX_BATCHES {
                return Err(Error::invalid(
                    format!("{} polygons in view are more than the CPU engine can number", plan.polygon_count),
                    "lower range_max or split the environment",
                ));
            }
            if self.batches.len() < used {
                self.batches.resize_with(used, Batch::default);
            }
            times[0] += start.elapsed();

            let start = Instant::now();
            let batches = &mut self.batches[first..used];
            self.pool.install(|| {
                batches.par_iter_mut().zip(&groups).for_each(|(batch, group)| {
                    arch.dispatch(SetUp { batch, plan, runs: &runs[group.clone()], bands: &bands });
                });
            });
            times[1] += start.elapsed();

            let start = Instant::now();
            let batches = &self.batches[..used];
            let more = done < plan.runs.len();
            self.pool.install(|| {
                canvas.par_iter_mut().enumerate().for_each(|(band, buffer)| {
                    arch.dispatch(Draw { buffer, plan, batches, first, bands: &bands, band, more });
                });
            });
            times[2] += start.elapsed();
        }
        for (name, time) in ["hidden", "setup", "rasterization"].iter().zip(times) {
            stats.stages_ms.push(((*name).to_owned(), time.as_secs_f64() * 1e3));
        }

        let start = Instant::now();
        let batches = &self.batches[..used];
        self.pool.install(|| {
            let targets = resolve::split(images, &bands);
            canvas.par_iter_mut().zip(targets).enumerate().for_each_init(
                resolve::Block::default,
                |block, (band, (buffer, target))| {
                    arch.dispatch(Resolve { buffer, block, plan, batches, bands: &bands, band, target });
                },
            );
        });
        stats.stage("resolve", start);
        stats.count("polygons_selected", plan.polygon_count);
        stats.count("runs_selected", plan.runs.len());
        stats.count("runs_hidden", hidden);
        stats.count("polygons_set_up", batches.iter().map(|b| b.polygons.len()).sum());
        stats.count("polygons_edge_on", batches.iter().map(|b| b.edge_on).sum());
        Ok(())
    }
}

/// The runs to draw next: as many polygons as all before them, and at least [`FIRST_WAVE`].
fn next_wave(runs: &[Run], start: usize) -> Range<usize> {
    let before: usize = runs[..start].iter().map(|r| r.count as usize).sum();
    let mut polygons = 0;
    let mut end = start;
    while end < runs.len() && polygons < before.max(FIRST_WAVE) {
        polygons += runs[end].count as usize;
        end += 1;
    }
    start..end
}

/// Drops what is hidden from a wave. Tasks are types, not closures, so that they are compiled for each vector width.
struct Sift<'a> {
    plan: &'a FramePlan,
    runs: &'a [Run],
    canvas: &'a [Buffer],
    bands: &'a Bands,
}

impl pulp::WithSimd for Sift<'_> {
    type Output = Vec<Run>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<Run> {
        let bounds = Bounds::new(&self.plan.sensor);
        hidden::visible(self.plan, &bounds, self.runs, self.canvas, self.bands)
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
    fn with_simd<S: pulp::Simd>(self, _: S) {
        setup::fill(self.batch, self.plan, self.runs, self.bands);
    }
}

/// Draws a wave into a band.
struct Draw<'a> {
    buffer: &'a mut Buffer,
    plan: &'a FramePlan,
    batches: &'a [Batch],
    first: usize,
    bands: &'a Bands,
    band: usize,
    /// Another wave follows that wants to know what is hidden.
    more: bool,
}

impl pulp::WithSimd for Draw<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { buffer, batches, first, bands, band, .. } = self;
        match self.plan.sensor.grid() {
            PixelGrid::Lines(grid) => {
                spans::rasterize(buffer, grid, batches, first, bands, band);
                if self.more {
                    hidden::measure(buffer, bands.samples);
                }
            }
            PixelGrid::Rays(grid) => rays::rasterize(buffer, grid, batches, first, bands, band),
        }
    }
}

/// Resolves a band.
struct Resolve<'a> {
    buffer: &'a mut Buffer,
    block: &'a mut resolve::Block,
    plan: &'a FramePlan,
    batches: &'a [Batch],
    bands: &'a Bands,
    band: usize,
    target: resolve::Target<'a>,
}

impl pulp::WithSimd for Resolve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, _: S) {
        resolve::resolve(self.buffer, self.block, self.plan, self.batches, self.bands, self.band, &mut self.target);
    }
}

/// How the image is cut into bands of lines, each one task.
pub(crate) struct Bands {
    axis: LineAxis,
    lines: usize,
    samples: usize,
    per_band: usize,
}

const _: () = assert!(resolve::BLOCK_LINES.is_multiple_of(hidden::TILE));

impl Bands {
    fn new(grid: &PixelGrid, threads: usize) -> Self {
        let (axis, lines, samples, multiple) = match grid {
            PixelGrid::Lines(g) if g.axis() == LineAxis::Columns => {
                (g.axis(), g.lines().len(), g.weights().len(), resolve::BLOCK_LINES)
            }
            PixelGrid::Lines(g) => (g.axis(), g.lines().len(), g.weights().len(), hidden::TILE),
            PixelGrid::Rays(g) => (LineAxis::Rows, g.height() as usize, g.width() as usize, rays::BAND_MULTIPLE),
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
