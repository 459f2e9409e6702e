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
mod rays;
mod resolve;
mod setup;
mod spans;

use crate::error::{Error, ErrorKind, Result};
use crate::plan::{FramePlan, Images, Run};
use crate::predict::Stats;
use crate::sensor::{LineAxis, PixelGrid};
use batch::Batch;
use rayon::prelude::*;
use std::ops::Range;
use std::time::Instant;

/// The CPU engine with its threads and buffers.
pub struct Engine {
    pool: rayon::ThreadPool,
    batches: Vec<Batch>,
}

/// Pixels of a band: small enough for its z-buffer to stay in the L2 cache.
const BAND_PIXELS: usize = 8192;

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
        Ok(Self { pool, batches: Vec::new() })
    }

    /// Fills the asked images.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if the plan holds more polygons than the engine can number.
    pub fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        stats.engine = "cpu".into();
        stats.threads = self.pool.current_num_threads();
        images.prepare(plan.sensor.width(), plan.sensor.height(), plan.request.outputs);
        let groups = batch::group_runs(plan)?;
        if self.batches.len() < groups.len() {
            self.batches.resize_with(groups.len(), Batch::default);
        }
        let batches = &mut self.batches[..groups.len()];
        let bands = Bands::new(plan.sensor.grid(), self.pool.current_num_threads());
        let arch = pulp::Arch::new();

        let start = Instant::now();
        self.pool.install(|| {
            batches.par_iter_mut().zip(&groups).for_each(|(batch, runs)| {
                arch.dispatch(SetUp { batch, plan, runs: &plan.runs[runs.clone()], bands: &bands });
            });
        });
        stats.stage("setup", start);

        let start = Instant::now();
        let batches = &*batches;
        self.pool.install(|| {
            resolve::split(images, &bands)
                .into_par_iter()
                .enumerate()
                .for_each_init(Scratch::default, |scratch, (band, target)| {
                    arch.dispatch(Draw { scratch, plan, batches, bands: &bands, band, target })
                });
        });
        stats.stage("rasterization", start);
        stats.count("polygons_selected", plan.polygon_count);
        stats.count("polygons_set_up", batches.iter().map(|b| b.polygons.len()).sum());
        stats.count("polygons_edge_on", batches.iter().map(|b| b.edge_on).sum());
        Ok(())
    }
}

/// A thread's buffers.
#[derive(Default)]
struct Scratch {
    buffer: spans::Buffer,
    block: resolve::Block,
}

/// The work of a batch. Tasks are types, not closures, so that they are compiled for each vector width.
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

/// The work of a band.
struct Draw<'a> {
    scratch: &'a mut Scratch,
    plan: &'a FramePlan,
    batches: &'a [Batch],
    bands: &'a Bands,
    band: usize,
    target: resolve::Target<'a>,
}

impl pulp::WithSimd for Draw<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, _: S) {
        let Scratch { buffer, block } = self.scratch;
        match self.plan.sensor.grid() {
            PixelGrid::Lines(grid) => spans::rasterize(buffer, grid, self.batches, self.bands, self.band),
            PixelGrid::Rays(grid) => rays::rasterize(buffer, grid, self.batches, self.bands, self.band),
        }
        resolve::resolve(buffer, block, self.plan, self.batches, self.bands, self.band, &mut self.target);
    }
}

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
            PixelGrid::Lines(g) => (g.axis(), g.lines().len(), g.weights().len(), 1),
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
