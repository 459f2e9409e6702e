//! The GPU engine: computes exact spans in compute shaders, through wgpu.
//!
//! Meshes stay on the device; a frame uploads instances and runs. Stages are named like the stages of
//! [`presight_render::cpu`]:
//!
//! | stage | shader | on the CPU |
//! |---|---|---|
//! | sift | `sift.wgsl`, from the second wave on | `cpu::cull`, for whole runs |
//! | cull | `cull.wgsl` and one of `cull_camera`, `cull_scanner`, `cull_rays` | `cpu::setup` |
//! | setup | `setup.wgsl`, `items_lines` or `items_rays` | `cpu::setup`; `near` for flat polygons at the sensor |
//! | raster | `raster_lines.wgsl` or `raster_rays.wgsl`, `key32` or `key64` | `cpu::raster_lines`, `cpu::raster_rays` |
//! | draw, for [`Raster::Render`] | `shape.wgsl` in setup, `draw.wgsl`, `key32` or `key64` | `cpu::raster_lines` |
//! | farthest | `farthest.wgsl`, between waves | `cpu::cull` |
//! | resolve | `resolve.wgsl` | `cpu::resolve`; `plan::keys` from the device's keys, for software adapters |
//! | weigh, for batches that keep no image | `weigh.wgsl` | `batch::weigh` |
//! | visible | `visible.wgsl` | `features::visible` tests its hints; the tests' CPU twin is in `gpu::visible` |
//! | roi | `roi.wgsl` | `features::roi` |

mod buffers;
mod device;
mod direction_words;
mod drawing;
mod frame_buffers;
mod geometry;
mod grid;
mod in_time;
mod layout;
mod near;
mod part;
mod roi;
mod shaders;
mod shown;
mod stage;
mod stages;
mod submission;
pub mod testing;
mod together;
mod uploads;
mod variants;
mod visible;
mod weigh;

pub use device::{Abilities, Adapter, DeviceAllocations, DeviceOptions, adapters, preferred};
pub use visible::OcclusionQuery;

use buffers::Uploads;
use device::Gpu;
use frame_buffers::{FrameBuffers, Readback};
use geometry::Arena;
use grid::Tables;
use layout::{Counters, GridKind};
use part::Part;
use presight_features::OcclusionHint;
use presight_model::clock::Instant;
use presight_model::error::Result;
use presight_model::sensor::Sensor;
use presight_model::threads::Threads;
use presight_render::plan::{CountName, FramePlan, Images, NOTHING_IN_VIEW, Raster, StageName, Stats, Work};
use shown::Shown;
use stages::Stages;
use submission::Submission;
use uploads::FrameUploads;
use visible::Visible;

/// Maximum number of sensors whose tables are kept.
const MAX_SENSORS: usize = 8;

/// The GPU engine with its device and buffers.
pub struct GpuEngine {
    gpu: Gpu,
    stages: Stages,
    /// Created at the first occlusion query.
    visible: Option<Visible>,
    /// Created when a measured image is first weighed.
    weigh: Option<weigh::Weigh>,
    /// True if the buffers hold the last prediction.
    drawn: bool,
    store: FrameBuffers,
    arena: Arena,
    uploads: Uploads,
    /// The frames of a submission; a single frame is the first.
    frames: Vec<FrameUploads>,
    /// Stamp of the last frame.
    stamp: u32,
    /// Recently used sensors. Only the first one has its tables on the device.
    sensors: Vec<KnownSensor>,
    /// True if the first sensor's tables are on the device.
    placed: bool,
    /// True if a bound buffer was replaced.
    rebind: bool,
    /// True for a software adapter. Stages with a CPU twin then run directly on the CPU, which uses the same cores.
    software: bool,
    /// Created when boxes are first requested.
    roi: Option<roi::RoiStage>,
    /// Threads for the work that the engine leaves to the CPU.
    threads: Threads,
    /// Options that the device was opened with.
    opened: (DeviceOptions, testing::Setup),
    /// Grid kinds already drawn. The first frame of a kind may be a probe, so it runs all stages.
    known: Vec<GridKind>,
}

/// A sensor drawn before.
struct KnownSensor {
    /// Kept alive because its address is its identity.
    sensor: Sensor,
    tables: Tables,
    shown: Shown,
}

impl GpuEngine {
    /// Opens the most capable adapter.
    ///
    /// # Errors
    /// [`presight_model::error::ErrorKind::NoDevice`] if no adapter is suitable.
    pub fn new(options: DeviceOptions) -> Result<Self> {
        Self::open(options, testing::Setup::default())
    }

    fn open(options: DeviceOptions, setup: testing::Setup) -> Result<Self> {
        let gpu = Gpu::open(options, setup.largest_binding)?;
        let (stages, store) = (Stages::new(&gpu), FrameBuffers::new(&gpu));
        let (arena, uploads) = (Arena::new(&gpu), Uploads::new(&gpu));
        gpu.check()?;
        let software = !gpu.adapter.hardware && !setup.all_on_device;
        Ok(Self {
            gpu,
            stages,
            visible: None,
            weigh: None,
            drawn: false,
            store,
            arena,
            uploads,
            frames: Vec::new(),
            stamp: 0,
            sensors: Vec::new(),
            placed: false,
            rebind: true,
            software,
            roi: None,
            threads: Threads::SHARED,
            opened: (options, setup),
            known: Vec::new(),
        })
    }

    /// Opens the device again with the original options, without reusing any resource of the old one.
    ///
    /// # Errors
    /// Same as [`GpuEngine::new`]; the engine is then unchanged.
    pub fn reopen(&mut self) -> Result<()> {
        let (options, setup) = self.opened;
        *self = Self::open(options, setup)?.with_threads(self.threads.clone());
        Ok(())
    }

    /// Makes the engine do its CPU work on these threads (or on that number of threads) instead of the shared pool.
    #[must_use]
    pub fn with_threads(self, threads: impl Into<Threads>) -> Self {
        Self { threads: threads.into(), ..self }
    }

    /// The adapter in use.
    pub fn adapter(&self) -> &Adapter {
        &self.gpu.adapter
    }

    /// The device's capabilities.
    pub fn abilities(&self) -> Abilities {
        Abilities {
            int64_atomics: self.gpu.int64,
            timestamps: self.gpu.timestamps,
            render: self.gpu.can_render,
            largest_binding: self.gpu.device.limits().max_storage_buffer_binding_size,
        }
    }

    /// The rasterizer for images of pinhole cameras.
    pub fn raster(&self) -> Raster {
        self.gpu.raster
    }

    /// Opens the device again without the hardware rasterizer.
    ///
    /// # Errors
    /// Same as [`GpuEngine::reopen`].
    pub(crate) fn take_compute(&mut self) -> Result<()> {
        let asked = std::mem::take(&mut self.opened.0.raster);
        self.reopen().inspect_err(|_| self.opened.0.raster = asked)
    }

    /// Everything allocated on the device so far.
    pub fn allocations(&self) -> DeviceAllocations {
        self.gpu.made.so_far()
    }

    /// Fills the requested images; `depth_z` only for cameras.
    ///
    /// # Errors
    /// [`presight_model::error::ErrorKind::DeviceLost`]: the engine must be built again.
    /// [`presight_model::ErrorKind::DeviceMemory`]: smaller tasks may still succeed. The errors of
    /// [`presight_model::Pose::check`] if the plan's pose was changed. On a software adapter, which leaves work to the
    /// CPU, also the errors of [`Threads::new`].
    pub fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        plan.world_from_sensor.check()?;
        stats.engine = "gpu";
        stats.adapter = Some(self.gpu.adapter.to_string());
        let start = Instant::now();
        self.gpu.check()?;
        self.drawn = false;
        if plan.limit.is_some() {
            return self.draw_in_time(plan, images, stats);
        }
        if plan.polygon_count == 0 {
            images.try_prepare(plan.sensor.width(), plan.sensor.height(), plan.drawn())?;
            images.show_nothing(plan.sensor.grid());
            plan.finish_noting(images, stats)?;
            stats.leave_out(StageName::DrawingOnDevice, NOTHING_IN_VIEW);
            return Ok(());
        }
        let before = self.gpu.work();
        let whole = Submission::single(Part::Whole);
        self.fill(&[plan], &whole)?;
        stats.stage(StageName::Upload, start);
        let start = Instant::now();
        let (answer, reruns) = self.draw(&whole)?;
        stats.stage(StageName::Device, start);
        let start = Instant::now();
        let frame = &self.frames[0];
        images.try_prepare(frame.params.width, frame.params.height, frame.outputs)?;
        self.stage_times(&answer[Readback::of(frame).times as usize..], stats);
        let mut counters = self.counters(&answer, Part::Whole, 0);
        self.count_groups(&counters);
        counters.lost_ids += frame.take_images(&answer, plan, &self.threads, images)?;
        if frame.remembered {
            self.sensors[0].shown.note(plan, frame, &answer);
        }
        drop(answer);
        stats.stage(if frame.on_host { StageName::ResolveOnCpu } else { StageName::Readback }, start);
        self.drawn = true;
        self.know(self.sensors[0].tables.kind);
        plan.finish_noting(images, stats)?;
        self.report(&self.frames[0], &counters, reruns, stats);
        let image_bytes = stats.work.image_bytes;
        stats.work = Work { image_bytes, ..self.gpu.work().since(before) };
        Ok(())
    }

    /// Maximum image side that the hardware rasterizer draws; 0 if it is not used.
    fn max_rendered(&self) -> u32 {
        match self.gpu.raster {
            Raster::Compute => 0,
            Raster::Render => self.gpu.device.limits().max_texture_dimension_2d,
        }
    }

    fn know(&mut self, kind: GridKind) {
        if !self.known.contains(&kind) {
            self.known.push(kind);
        }
    }

    /// Work done and memory allocated on the device since it was opened.
    pub fn work(&self) -> Work {
        self.gpu.work()
    }

    /// True if the last prediction was drawn on the device, so that occlusion queries can read its pixels.
    pub(crate) fn holds_prediction(&self) -> bool {
        self.drawn
    }

    /// True if features are to be tested on the device. With a software adapter the CPU tests them faster itself.
    pub fn takes_features(&self) -> bool {
        !self.software
    }

    /// Tests feature samples against the last rendered frame. Returns a hint for each sample, in the order pushed.
    ///
    /// # Errors
    /// Same as [`GpuEngine::render`].
    pub fn query_occlusion(&mut self, query: &OcclusionQuery) -> Result<Vec<OcclusionHint>> {
        let Some(known) = self.sensors.first().filter(|_| query.count() > 0) else { return Ok(Vec::new()) };
        self.gpu.check()?;
        let visible = self.visible.get_or_insert_with(|| Visible::new(&self.gpu));
        visible.run(&self.gpu, &mut self.uploads, &self.store, known.tables.kind, query)
    }

    /// Moves a sensor to the front, with its tables. A robot that alternates between sensors has each table built once.
    fn take_sensor(&mut self, sensor: &Sensor) -> Result<()> {
        match self.sensors.iter().position(|known| std::ptr::eq(known.sensor.grid(), sensor.grid())) {
            Some(0) => {}
            Some(at) => {
                self.sensors[..=at].rotate_right(1);
                self.placed = false;
            }
            None => {
                let tables = Tables::new(sensor)?;
                self.sensors.truncate(MAX_SENSORS - 1);
                self.sensors.insert(0, KnownSensor { sensor: sensor.clone(), tables, shown: Shown::default() });
                self.placed = false;
            }
        }
        if let Some(KnownSensor { tables, .. }) = self.sensors.first()
            && !self.placed
        {
            self.rebind |= self.store.reserve_grid(&self.gpu, tables)?;
        }
        Ok(())
    }

    /// Reports the time of each pass of a single frame, if the device has timestamps.
    fn stage_times(&self, bytes: &[u8], stats: &mut Stats) {
        if self.store.times.is_none() {
            return;
        }
        let period = f64::from(self.gpu.queue.get_timestamp_period());
        for (name, pair) in self.frames[0].passes.iter().zip(bytes.chunks_exact(16)) {
            let [begin, end]: [u64; 2] = bytemuck::pod_read_unaligned(pair);
            let ms = end.saturating_sub(begin) as f64 * period * 1e-6;
            stats.stages_ms.push((*name, ms));
        }
    }

    fn report(&self, frame: &FrameUploads, counters: &Counters, reruns: usize, stats: &mut Stats) {
        self.report_variants(frame, stats);
        let near = &frame.near;
        stats.count(CountName::RunsSelected, frame.waves.last().map_or(0, |wave| wave.end as usize));
        stats.count(CountName::PolygonsSelected, frame.polygon_count as usize);
        if frame.remembered {
            stats.count(CountName::RunsShownBefore, frame.shown_before as usize);
        }
        stats.count(CountName::RunsHidden, counters.runs_hidden as usize);
        stats.count(CountName::PolygonsHidden, counters.polygons_hidden as usize);
        stats.count(CountName::Waves, frame.waves.len());
        stats.count(CountName::PolygonsInView, counters.survivors as usize);
        stats.count(CountName::PolygonsSetUp, counters.records as usize);
        if frame.rendered {
            stats.count(CountName::PolygonsRendered, counters.shapes as usize);
        }
        stats.count(CountName::PolygonsSetUpInF64, near.slots.len());
        stats.count(CountName::PolygonsEdgeOn, (counters.edge_on + near.edge_on) as usize);
        stats.count(CountName::WorkItems, counters.items as usize);
        stats.count(CountName::Reruns, reruns);
        stats.count(CountName::HitsWithoutId, counters.lost_ids as usize);
        if counters.lost_ids > 0 {
            stats.notices.push(format!("{} hits without an id: please report this", counters.lost_ids));
        }
    }

    /// Explains why the hardware rasterizer does not draw this frame.
    fn why_compute(&self, frame: &FrameUploads) -> &'static str {
        let is_camera = self.sensors.first().is_some_and(|known| known.tables.kind == GridKind::Camera);
        let side = frame.params.width.max(frame.params.height);
        match (self.opened.0.raster, self.gpu.raster) {
            (Raster::Compute, _) => "compute spans are the default",
            (Raster::Render, Raster::Compute) => "its fragments cannot write storage on this adapter",
            _ if !is_camera => "the sensor is not a pinhole camera",
            _ if side > self.max_rendered() => "the image exceeds the adapter's largest render target",
            _ => "compute spans keep the deadline",
        }
    }

    /// Reports which variants of the stages ran, and why the others did not.
    fn report_variants(&self, frame: &FrameUploads, stats: &mut Stats) {
        stats.raster = Some(if frame.rendered { Raster::Render } else { Raster::Compute });
        if self.store.times.is_none() {
            let passes: std::collections::BTreeSet<_> = frame.passes.iter().collect();
            passes.iter().for_each(|name| stats.take(**name, "within device: the adapter has no stage timestamps"));
        }
        if frame.on_host {
            stats.leave_out(StageName::ResolveOnDevice, "the adapter is software that runs on the CPU's own cores");
        }
        if frame.waves.len() == 1 {
            stats.leave_out(StageName::Hidden, "too few polygons are in view");
        }
        let short = self.sensors.first().is_some_and(|known| known.tables.short());
        let mut choose = |what: StageName, needed: bool, why: [&'static str; 2]| {
            if needed { stats.take(what, why[1]) } else { stats.leave_out(what, why[0]) }
        };
        choose(
            StageName::SecondRasterPass,
            !self.gpu.int64,
            ["the device has 64-bit atomics", "the device has no 64-bit atomics: nearest first, then the lowest id"],
        );
        choose(StageName::HardwareRaster, frame.rendered, [self.why_compute(frame), WHY_RENDER]);
        choose(StageName::ReuseOfLastFrame, frame.shown_before > 0, [frame.why_anew, WHY_REUSED]);
        choose(
            StageName::InstancesFromStorage,
            !frame.few(),
            ["a uniform buffer holds them", "a uniform buffer cannot hold that many"],
        );
        choose(
            StageName::RaysFromStorage,
            !short,
            ["a uniform buffer holds them", "a uniform buffer cannot hold that many, or the rays do not lie on lines"],
        );
        choose(
            StageName::SetupInF64,
            !frame.near.slots.is_empty(),
            ["no polygon near the sensor is seen edge-on", "polygons near the sensor are seen almost edge-on"],
        );
    }
}

const WHY_REUSED: &str = "requested: the runs visible in the last frame are the first wave";

const WHY_RENDER: &str = "requested; compute spans draw the polygons that it cannot draw exactly";
