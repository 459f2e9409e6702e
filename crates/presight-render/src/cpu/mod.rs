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
mod waves;

pub use tiles::{Margins, Vectors};

use crate::deadline::DeadlineOutcome;
use crate::plan::{ChosenWay, CountName, FramePlan, Images, NOTHING_IN_VIEW, StageName, Stats, Way};
use batch::{Batch, Winners};
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
    margins: Margins,
    /// What the trees that are lacking cost, and what frames without them have cost so far: in polygons.
    price: u64,
    savings: u64,
    row: RowDrawer,
}

/// Pixels of a band: small enough for its z-buffer to stay in the L2 cache.
const BAND_PIXELS: usize = 8192;

/// Frames of fewer rays are drawn by the calling thread: another one takes longer to wake up than it saves.
const FEW_RAYS: usize = 1024;

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
            margins: Margins::SOUND,
            price: 0,
            savings: 0,
        }
    }

    /// Another one that hands no work to other threads, for a task on one of the pool's.
    pub fn on_one_thread(&self) -> Self {
        Self { vectors: self.vectors, ..Self::on_pool(self.pool.clone(), true) }
    }

    /// Searches trees and rows with these vectors, for tests and benches; with narrower ones if the processor lacks them.
    #[must_use]
    pub fn with_vectors(self, vectors: Vectors) -> Self {
        Self { vectors, ..self }
    }

    /// Searches trees with other margins, for tests that plant faults.
    #[doc(hidden)]
    #[must_use]
    pub fn with_margins(self, margins: Margins) -> Self {
        Self { margins, ..self }
    }

    /// How many threads it has.
    pub fn threads(&self) -> usize {
        if self.alone { 1 } else { self.pool.current_num_threads() }
    }

    /// True if it is too early to make the trees that tiles lack, so that the raster draws.
    pub fn waits_for_trees(&self) -> bool {
        self.price > self.savings
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

    /// Draws by tiles. Returns false, with a notice if memory does not suffice, where the raster has to.
    fn try_tiles(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<bool> {
        match self.draw_tiles(plan, images, stats) {
            Err(fault) if fault.kind() == ErrorKind::System => {
                stats.notices.push(format!("the raster drew in place of tiles: {fault}"));
                Ok(false)
            }
            drawn => drawn,
        }
    }

    /// Draws the selected polygons. If it may turn to tiles, nothing is drawn where these are faster by the polygons left after the first
    /// wave.
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
        // Beyond a radius there may be something.
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
        // Here nothing waits for another task, and no other one comes between.
        let here = *alone || few;
        let mut waves = Waves::new(plan, &bands, here, (batches, winners), canvas, images);
        // The whole frame on the pool: between two stages its threads stay awake.
        let mut draw = || waves.draw_all(may_turn, stats);
        let drawn = if here { draw() } else { pool.install(draw) };
        let left = waves.left.filter(|left| *left > plan.chosen().most_left);
        if let Drawn::All = drawn {
            // What trees would have saved.
            self.savings += left.unwrap_or(0);
            plan.finish_noting(images, stats)?;
        }
        Ok(drawn)
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
