//! The GPU engine: computes exact spans in compute shaders, through wgpu.
//!
//! Meshes stay on the device; a frame uploads instances and runs. Stages are named like the stages of [`crate::cpu`]:
//!
//! | stage | shader | on the CPU |
//! |---|---|---|
//! | sift | `sift.wgsl`, from the second wave on | `cpu::cull`, for whole runs |
//! | cull | `cull.wgsl` and one of `cull_camera`, `cull_scanner`, `cull_rays` | `cpu::setup` |
//! | setup | `setup.wgsl`, `items_lines` or `items_rays` | `cpu::setup`; `near` for flat polygons around the sensor, in f64 |
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
mod roi;
mod shaders;
mod shown;
mod stage;
mod stages;
pub mod testing;
mod together;
mod uploads;
mod visible;
mod weigh;

pub use device::{Abilities, Adapter, DeviceAllocations, DeviceOptions, adapters, preferred};
pub use visible::OcclusionQuery;

use device::Gpu;
use frame_buffers::{FrameBuffers, Readback};
use geometry::Arena;
use grid::Tables;
use layout::{Counters, GridKind};
use presight_features::OcclusionHint;
use presight_model::error::{ErrorKind, Result};
use presight_model::sensor::Sensor;
use presight_model::threads::Threads;
use presight_render::plan::{
    CountName, FramePlan, Images, KeySurface, Keys, NOTHING_IN_VIEW, Raster, SamplesMut, StageName, Stats, Work,
    resolve_keys,
};
use shown::Shown;
use stages::{Stages, Variants};
use std::time::Instant;
use testing::Hiding;
use uploads::{FrameUploads, Way};
use visible::Visible;

/// Maximum number of sensors whose tables are kept.
const MOST_SENSORS: usize = 8;

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
    frame: FrameUploads,
    /// Uploads of a submission that holds several frames.
    frames: Vec<FrameUploads>,
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
    /// [`ErrorKind::NoDevice`] if no adapter is suitable.
    pub fn new(options: DeviceOptions) -> Result<Self> {
        Self::open(options, testing::Setup::default())
    }

    fn open(options: DeviceOptions, setup: testing::Setup) -> Result<Self> {
        let gpu = Gpu::open(options, setup.largest_binding)?;
        let (stages, store, arena) = (Stages::new(&gpu), FrameBuffers::new(&gpu), Arena::new(&gpu));
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
            frame: FrameUploads::default(),
            frames: Vec::new(),
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

    /// Opens the device again with the original options. Nothing of the old device is reused.
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
    /// [`ErrorKind::DeviceLost`]: the engine must be built again. [`ErrorKind::DeviceMemory`]: smaller tasks may still
    /// succeed. The errors of [`crate::Pose::check`] if the plan's pose was changed. On a software adapter, which
    /// leaves work to the CPU, also the errors of [`Threads::new`].
    pub fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        plan.world_from_sensor.check()?;
        stats.engine = "gpu";
        stats.adapter = Some(self.gpu.adapter.to_string());
        let start = Instant::now();
        self.gpu.check()?;
        self.drawn = false;
        if plan.watch.is_some() {
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
        self.upload(plan)?;
        stats.stage(StageName::Upload, start);
        let mut reruns = 0;
        loop {
            let start = Instant::now();
            let variants = self.submit()?;
            let counters = self.read(plan, images, stats, start)?;
            self.gpu.done.workgroups.add_many(variants.indirect_groups(&counters));
            // The counters hold the full need even where buffers overflowed: make that room and run again.
            if !self.store.grow_for(&self.gpu, &counters)? {
                self.drawn = true;
                self.know(self.sensors[0].tables.kind);
                plan.finish_noting(images, stats)?;
                self.report(&self.frame, &counters, reruns, stats);
                let image_bytes = stats.work.image_bytes;
                stats.work = Work { image_bytes, ..self.gpu.work().since(before) };
                return Ok(());
            }
            self.rebind = true;
            reruns += 1;
        }
    }

    fn way(&self) -> Way {
        let most_rendered = match self.gpu.raster {
            Raster::Compute => 0,
            Raster::Render => self.gpu.device.limits().max_texture_dimension_2d,
        };
        Way { software: self.software, in_two_passes: !self.gpu.int64, most_rendered, hiding: self.opened.1.hiding }
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
        self.store.uploads.clear();
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        visible.encode(&self.gpu, &mut encoder, &mut self.store, known.tables.kind, query)?;
        self.gpu.queue.submit([encoder.finish()]);
        self.store.uploads.recall();
        visible.read(&self.gpu, query.count())
    }

    fn upload(&mut self, plan: &FramePlan) -> Result<()> {
        self.store.uploads.clear();
        self.take_sensor(&plan.sensor)?;
        let objects = plan.environment().objects();
        let meshes = plan.instances.iter().map(|i| &objects[i.object as usize].mesh);
        self.rebind |= self.arena.admit(&self.gpu, meshes)?;
        if let Some(KnownSensor { tables, shown, .. }) = self.sensors.first() {
            let first = self.opened.1.hiding == Hiding::WhereItPays && !self.known.contains(&tables.kind);
            let hiding = if first { Hiding::Always } else { self.opened.1.hiding };
            let last = (plan.reuse_visible && plan.watch.is_none()).then_some(shown);
            self.frame.fill(plan, tables, &self.arena, Way { hiding, ..self.way() }, last);
        }
        self.rebind |= self.store.reserve(&self.gpu, &self.frame)?;
        if self.frame.on_host {
            self.threads = self.threads.started()?;
        }
        Ok(())
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
                self.sensors.truncate(MOST_SENSORS - 1);
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

    fn submit(&mut self) -> Result<Variants> {
        let variants = self.stages.prepare(&self.gpu, &self.sensors[0].tables, &self.frame, self.opened.1)?;
        self.bind();
        self.store.put(&self.frame);
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.store.uploads.encode(&self.gpu, &mut encoder)?;
        self.stages.encode(&self.gpu, &mut encoder, &variants, &self.frame, &self.store);
        self.store.encode_readback(&mut encoder, &self.frame, 0);
        self.gpu.queue.submit([encoder.finish()]);
        self.placed = true;
        self.store.uploads.recall();
        Ok(variants)
    }

    /// Binds replaced buffers, and schedules the upload of the sensor's tables if they are not on the device.
    fn bind(&mut self) {
        if self.rebind {
            self.stages.bind(&self.gpu, self.arena.buffer(), &self.store);
            self.visible.iter_mut().for_each(Visible::rebind);
            self.weigh.iter_mut().for_each(|weigh| weigh.bind(&self.gpu, self.store.outputs.buffer()));
            self.rebind = false;
        }
        if !self.placed {
            self.store.put_grid(&self.sensors[0].tables);
        }
    }

    fn read(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats, start: Instant) -> Result<Counters> {
        let bytes = Readback::of(&self.frame).bytes;
        // Before the answer is mapped: an error would leave it mapped.
        images.try_prepare(self.frame.params.width, self.frame.params.height, self.frame.outputs)?;
        self.map_answer(bytes)?;
        stats.stage(StageName::Device, start);
        let start = Instant::now();
        let buffer = self.store.readback.buffer().clone();
        let view = buffer.get_mapped_range(0..bytes);
        let view = view.map_err(|e| self.gpu.error(ErrorKind::DeviceLost, &e.to_string()))?;
        self.stage_times(&view[Readback::of(&self.frame).times as usize..], stats);
        let counters = self.take_answer(&self.frame, &view, plan, images)?;
        if self.frame.remembered {
            self.sensors[0].shown.note(plan, &self.frame, &view);
        }
        drop(view);
        buffer.unmap();
        stats.stage(if self.frame.on_host { StageName::ResolveOnCpu } else { StageName::Readback }, start);
        Ok(counters)
    }

    /// Waits for the device until this many bytes of its answer are mapped.
    fn map_answer(&self, bytes: u64) -> Result<()> {
        let mapping = &self.store.readback_mapping;
        mapping.ask(self.store.readback.buffer(), wgpu::MapMode::Read, bytes);
        self.gpu.wait()?;
        mapping.check(&self.gpu, "the answer")?;
        self.gpu.done.bytes_read.add_many(bytes);
        Ok(())
    }

    /// Converts the device's answer into a frame's images.
    fn take_answer(
        &self,
        frame: &FrameUploads,
        view: &[u8],
        plan: &FramePlan,
        images: &mut Images,
    ) -> Result<Counters> {
        let at = Readback::of(frame);
        let mut counters = counters_of(view, at);
        if frame.on_host {
            let (keys, slots) = view[..at.counters as usize].split_at(at.slots as usize);
            let (p, slots): (_, &[layout::Slot]) = (&frame.params, bytemuck::cast_slice(slots));
            let keys = Keys {
                plan,
                first: [p.first_sample, p.first_line],
                focal: [p.fx, p.fy],
                range: [p.range_min, p.range_max],
                keys: bytemuck::cast_slice(keys),
            };
            let surface_of = |slot: u32| {
                let layout::Slot { distance, object, source, .. } = slots[slot as usize];
                KeySurface { distance, object, source }
            };
            counters.lost_ids += self.threads.run(|| resolve_keys(&keys, &surface_of, images))?;
        } else {
            copy_images(frame, &view[..at.counters as usize], images);
        }
        Ok(counters)
    }

    fn stage_times(&self, bytes: &[u8], stats: &mut Stats) {
        if self.store.times.is_none() {
            return;
        }
        let period = f64::from(self.gpu.queue.get_timestamp_period());
        for (name, pair) in self.frame.passes.iter().zip(bytes.chunks_exact(16)) {
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
            _ if side > self.way().most_rendered => "the image exceeds the adapter's largest render target",
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

fn counters_of(view: &[u8], at: Readback) -> Counters {
    bytemuck::pod_read_unaligned(&view[at.counters as usize..][..size_of::<Counters>()])
}

/// Copies the images that the device resolved.
fn copy_images(frame: &FrameUploads, bytes: &[u8], images: &mut Images) {
    let pixels = images.pixels() * 4;
    for (i, output) in frame.outputs.iter().enumerate() {
        let from = &bytes[i * pixels..][..pixels];
        match images.samples_mut(output) {
            SamplesMut::Floats(to) => bytemuck::cast_slice_mut(to).copy_from_slice(from),
            SamplesMut::Ids(to) => bytemuck::cast_slice_mut(to).copy_from_slice(from),
            // The plan computes normals on the CPU.
            SamplesMut::Vectors(_) => {}
        }
    }
}
