//! The CPU engine: exact spans in f64 on all cores, the default where no hardware GPU is.
//!
//! | stage | in | out | its twin on the GPU |
//! |---|---|---|---|
//! | `cull` | runs of the plan | runs that no earlier wave hides | `cull.wgsl`, for single polygons |
//! | `setup` | runs | batches: polygons that may cover a ray, with planes, edges and bounds | `setup.wgsl` |
//! | `raster_lines` | batches | a band of the z-buffer: inverse depth and winner per ray | `raster_lines.wgsl` |
//! | `raster_rays` | the same for ray tables | | `raster_rays.wgsl` |
//! | `resolve` | the band | the requested images | `resolve.wgsl` |
//!
//! `hidden`, `setup`, `rasterization` and `resolve` report the times of the stages and the polygons that each left out.
//!
//! The nearest polygon wins a ray, and among bit-equal inverse depths the polygon in the lower slot. Thus neither the
//! order of work nor the number of threads can change a bit.

mod batch;
mod bounds;
mod cull;
mod footprint;
mod instance;
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
mod waves;

pub use tiles::{Margins, Vectors};

use crate::deadline::DeadlineOutcome;
use crate::plan::{ChosenWay, CountName, FramePlan, Images, NOTHING_IN_VIEW, StageName, Stats, Way};
use batch::{Batch, Winners};
use cull::TILE;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::memory::{self, FrameMemory};
use presight_model::sensor::{ImagePart, LineAxis, PixelGrid};
use presight_model::threads::Threads;
use raster_lines::Buffer;
use row::RowDrawer;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;
use waves::{Drawn, Waves};

/// The CPU engine with its threads and buffers.
pub struct CpuEngine {
    pool: Arc<rayon::ThreadPool>,
    /// The calling thread does all work of a frame.
    alone: bool,
    batches: Vec<Batch>,
    winners: Winners,
    canvas: Vec<Buffer>,
    /// Images of a part of the image, before they are enlarged to the whole.
    part: Images,
    /// Memory of the threads that trace tiles.
    rooms: Vec<tiles::Room>,
    frame: u64,
    vectors: Vectors,
    margins: Margins,
    /// Cost of the missing trees, and what frames without them have cost so far, in polygons.
    price: u64,
    savings: u64,
    row: RowDrawer,
}

/// Pixels of a band, few enough for its z-buffer to stay in the L2 cache.
const BAND_PIXELS: usize = 8192;

/// Frames of fewer rays are drawn by the calling thread: waking another thread takes longer than it saves.
pub(crate) const FEW_RAYS: usize = 1024;

impl CpuEngine {
    /// An engine on these threads, or on this number of new threads; 0 takes all cores.
    ///
    /// # Errors
    /// Errors of [`Threads::new`].
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
            margins: Margins::SOUND,
            price: 0,
            savings: 0,
        }
    }

    /// An engine that hands no work to other threads, for a task on a thread of the pool.
    pub fn on_one_thread(&self) -> Self {
        Self { vectors: self.vectors, ..Self::on_pool(self.pool.clone(), true) }
    }

    /// Sets the vectors for searches of trees and rows, for tests and benches. If the processor lacks them, narrower
    /// ones are used.
    #[must_use]
    pub fn with_vectors(self, vectors: Vectors) -> Self {
        Self { vectors, ..self }
    }

    /// Sets other margins for searches of trees, for tests that plant faults.
    #[doc(hidden)]
    #[must_use]
    pub fn with_margins(self, margins: Margins) -> Self {
        Self { margins, ..self }
    }

    /// Number of threads.
    pub fn threads(&self) -> usize {
        if self.alone { 1 } else { self.pool.current_num_threads() }
    }

    /// True if it is too early to build the trees that tiles lack, so that the raster draws.
    pub fn waits_for_trees(&self) -> bool {
        self.price > self.savings
    }

    /// Fills the requested images.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the plan holds more polygons than the engine can number;
    /// [`presight_model::ErrorKind::System`] if memory for the images is short; errors of
    /// [`presight_model::Pose::check`] if the plan's pose was changed.
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

    /// Fills the images of a part within the remaining time, which may require thinning, and leaves the rest out.
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
        progress::record_part(plan, &part, since, left_out, stats);
        Ok(())
    }

    /// Fills the requested images. Returns a stride if thinned images would have more samples by the deadline; the
    /// images are then still empty.
    fn draw(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<Option<u32>> {
        plan.world_from_sensor.check()?;
        if plan.bundles().is_some() {
            // The raster has one pose, so a lack of memory is an error.
            self.draw_tiles(plan, images, stats)?;
            return Ok(None);
        }
        if plan.way() == Way::Tiles {
            if self.try_tiles(plan, images, stats)? {
                return Ok(None);
            }
            return self.draw(&plan.selected()?, images, stats);
        }
        if plan.chosen() == ChosenWay::WITHOUT_TREES {
            self.savings += tiles::FRAME_PRICE + plan.polygon_count as u64;
        }
        let may_turn = plan.chosen().at_once || !self.waits_for_trees();
        let before = (stats.stages_ms.len(), stats.counts.len());
        match self.draw_raster(plan, may_turn, images, stats)? {
            Drawn::All => Ok(None),
            Drawn::Thinned(stride) => Ok(Some(stride)),
            Drawn::TooMany if self.try_tiles(plan, images, stats)? => Ok(None),
            Drawn::TooMany => {
                stats.stages_ms.truncate(before.0);
                stats.counts.truncate(before.1);
                self.draw_raster(plan, false, images, stats).map(|_| None)
            }
        }
    }

    /// Draws by tiles. Returns false if the raster has to draw instead, with a notice if memory is short.
    fn try_tiles(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<bool> {
        match self.draw_tiles(plan, images, stats) {
            Err(fault) if fault.kind() == ErrorKind::System => {
                stats.notices.push(format!("the raster drew in place of tiles: {fault}"));
                Ok(false)
            }
            drawn => drawn,
        }
    }

    /// Draws the selected polygons. If the engine may turn to tiles, and tiles are faster for the number of polygons
    /// left after the first wave, draws nothing.
    fn draw_raster(
        &mut self,
        plan: &FramePlan,
        may_turn: bool,
        images: &mut Images,
        stats: &mut Stats,
    ) -> Result<Drawn> {
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
        // Beyond a radius there may be further polygons.
        if plan.polygon_count == 0 && plan.radius().is_none() {
            images.show_nothing(plan.sensor.grid());
            plan.finish_noting(images, stats)?;
            stats.leave_out(StageName::SetupAndRasterization, NOTHING_IN_VIEW);
            stats.count(CountName::PolygonsSelected, 0);
            let drawn_ms = plan.watch().map(|watch| watch.elapsed().as_secs_f64() * 1e3);
            stats.deadline = drawn_ms.map(|drawn_ms| DeadlineOutcome { drawn_ms, ..DeadlineOutcome::default() });
            return Ok(Drawn::All);
        }
        self.reserve_canvas(&bands)?;
        let Self { pool, alone, batches, winners, canvas, .. } = self;
        let canvas = &mut canvas[..bands.count()];
        // Here no other task delays or interrupts the work.
        let here = *alone || few;
        let mut waves = Waves::new(plan, &bands, here, (batches, winners), canvas, images);
        // The whole frame runs on the pool: its threads stay awake between two stages.
        let mut draw = || waves.draw_all(may_turn, stats);
        let drawn = if here { draw() } else { pool.install(draw) };
        let left = waves.left.filter(|left| *left > plan.chosen().max_left);
        if let Drawn::All = drawn {
            // The time that trees would have saved.
            self.savings += left.unwrap_or(0);
            plan.finish_noting(images, stats)?;
        }
        Ok(drawn)
    }
}

/// Time that thinned images save, by the plan's pace.
fn saved(plan: &FramePlan, stride: u32) -> Duration {
    plan.pace().map_or(Duration::ZERO, |pace| Duration::from_secs_f64(pace.saved(stride)))
}

/// The engine does not check whether memory is available for images and buffers smaller than this.
const LITTLE: u64 = 64 << 20;

impl CpuEngine {
    /// Reserves the memory of the bands' buffers.
    fn reserve_canvas(&mut self, bands: &Bands) -> Result<()> {
        if self.canvas.len() < bands.count() {
            self.canvas.resize_with(bands.count(), Buffer::default);
        }
        for (band, buffer) in self.canvas[..bands.count()].iter_mut().enumerate() {
            buffer.reserve(bands.axis, bands.lines(band).len(), bands.samples)?;
        }
        Ok(())
    }

    /// Checks that memory is available for the buffers and images that are not allocated yet.
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

const _: () = assert!(resolve::TOGETHER.is_multiple_of(TILE));

/// Bands of image lines, each drawn by one task.
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
            PixelGrid::Lines(g) => (g.axis(), g.lines().len(), g.weights().len(), TILE),
            PixelGrid::Rays(g) => (LineAxis::Rows, g.height() as usize, g.width() as usize, TILE),
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
