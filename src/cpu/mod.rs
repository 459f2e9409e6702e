//! The CPU engine: exact spans in f64 on all cores, the default where no hardware GPU is.
//!
//! | stage | in | out |
//! |---|---|---|
//! | [`setup`] | runs of the plan | batches: polygons that may cover a ray, with planes, edges and bounds |
//! | [`spans`] or [`rays`] | batches | a band of the z-buffer: inverse depth and winner per ray |
//! | [`resolve`] | the band | the asked images |
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
use crate::plan::{FramePlan, Images};
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
            batches
                .par_iter_mut()
                .zip(&groups)
                .for_each(|(batch, runs)| arch.dispatch(|| setup::fill(batch, plan, &plan.runs[runs.clone()], &bands)));
        });
        stats.stage("setup", start);

        let start = Instant::now();
        let batches = &*batches;
        self.pool.install(|| {
            resolve::split(images, &bands).into_par_iter().enumerate().for_each_init(
                spans::Buffer::default,
                |buffer, (band, mut target)| {
                    arch.dispatch(|| {
                        match plan.sensor.grid() {
                            PixelGrid::Lines(grid) => spans::rasterize(buffer, grid, batches, &bands, band),
                            PixelGrid::Rays(grid) => rays::rasterize(buffer, grid, batches, &bands, band),
                        }
                        resolve::resolve(buffer, plan, batches, bands.lines(band), &mut target);
                    });
                },
            );
        });
        stats.stage("rasterization", start);
        stats.count("polygons_selected", plan.polygon_count);
        stats.count("polygons_set_up", batches.iter().map(|b| b.polygons.len()).sum());
        stats.count("polygons_edge_on", batches.iter().map(|b| b.edge_on).sum());
        Ok(())
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
