//! The GPU engine: exact spans in compute shaders, by wgpu.
//!
//! Meshes stay on the device; a frame uploads instances and runs. Cull, setup, raster, resolve: see `stages`.

mod buffers;
mod device;
mod frame;
mod geometry;
mod grid;
mod layout;
mod near;
mod resolve;
mod shaders;
mod stage;
mod stages;
mod store;

pub use device::{Adapter, DeviceOptions, adapters};

use crate::error::{ErrorKind, Result};
use crate::plan::{FramePlan, Images, Output, Stats};
use crate::sensor::Sensor;
use device::Gpu;
use frame::Frame;
use geometry::Arena;
use grid::Tables;
use layout::Counters;
use stages::Stages;
use std::time::Instant;
use store::{Readback, Store};

/// The GPU engine with its device and buffers.
///
/// ```no_run
/// use presight::gpu::{DeviceOptions, Engine};
/// let engine = Engine::new(DeviceOptions { hardware_only: true, ..Default::default() })?;
/// println!("predicting on {}", engine.adapter());
/// # Ok::<(), presight::Error>(())
/// ```
pub struct Engine {
    gpu: Gpu,
    stages: Stages,
    store: Store,
    arena: Arena,
    frame: Frame,
    /// The sensor whose tables are on the device; held, so that its address is its identity.
    sensor: Option<(Sensor, Tables)>,
    /// A bound buffer is another one now.
    rebind: bool,
    /// Stages that have a CPU twin run there: the same cores, without the detour.
    software: bool,
}

impl Engine {
    /// Opens the most capable adapter.
    ///
    /// # Errors
    /// [`ErrorKind::NoDevice`] if there is none that will do.
    pub fn new(options: DeviceOptions) -> Result<Self> {
        let gpu = Gpu::open(options)?;
        let (stages, store, arena) = (Stages::new(&gpu), Store::new(&gpu), Arena::new(&gpu));
        gpu.check()?;
        let software = !gpu.adapter.hardware && !options.all_on_device;
        Ok(Self { gpu, stages, store, arena, frame: Frame::default(), sensor: None, rebind: true, software })
    }

    /// The adapter it works on.
    pub fn adapter(&self) -> &Adapter {
        &self.gpu.adapter
    }

    /// Destroys the device, as a driver's reset would: for tests of what comes after.
    #[doc(hidden)]
    pub fn lose_device(&self) {
        self.gpu.device.destroy();
    }

    /// Fills the asked images; `depth_z` only for cameras.
    ///
    /// # Errors
    /// [`ErrorKind::DeviceLost`], after which the engine must be built anew; [`ErrorKind::DeviceMemory`], after which
    /// it can go on with smaller tasks.
    pub fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        stats.engine = "gpu".into();
        stats.adapter = Some(self.gpu.adapter.to_string());
        let start = Instant::now();
        self.gpu.check()?;
        self.upload(plan)?;
        stats.stage("upload", start);
        let mut reruns = 0;
        loop {
            let start = Instant::now();
            self.submit()?;
            let counters = self.read(plan, images, stats, start)?;
            // Nothing that did not fit is lost: make room for all of it and run again.
            if !self.store.grow_for(&self.gpu, &counters)? {
                self.report(&counters, reruns, stats);
                return Ok(());
            }
            self.rebind = true;
            reruns += 1;
        }
    }

    fn upload(&mut self, plan: &FramePlan) -> Result<()> {
        let same = |s: &Sensor| std::ptr::eq(s.grid(), plan.sensor.grid());
        if !self.sensor.as_ref().is_some_and(|(s, _)| same(s)) {
            let tables = Tables::new(&plan.sensor);
            self.rebind |= self.store.put_grid(&self.gpu, &tables)?;
            self.sensor = Some((plan.sensor.clone(), tables));
        }
        let objects = plan.environment().objects();
        let meshes = plan.instances.iter().map(|i| &objects[i.object as usize].mesh);
        self.rebind |= self.arena.admit(&self.gpu, meshes)?;
        if let Some((_, tables)) = &self.sensor {
            self.frame.fill(plan, tables, &self.arena, self.software);
        }
        self.rebind |= self.store.reserve(&self.gpu, &self.frame)?;
        Ok(())
    }

    fn submit(&mut self) -> Result<()> {
        let Some((_, tables)) = &self.sensor else { return Ok(()) };
        let variants = self.stages.prepare(&self.gpu, tables, &self.frame)?;
        if self.rebind {
            self.stages.bind(&self.gpu, self.arena.buffer(), &self.store);
            self.rebind = false;
        }
        self.store.put(&self.gpu, &self.frame);
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.stages.encode(&mut encoder, &variants, &self.frame, &self.store);
        self.store.encode_readback(&mut encoder, &self.frame);
        self.gpu.queue.submit([encoder.finish()]);
        Ok(())
    }

    fn read(&self, plan: &FramePlan, images: &mut Images, stats: &mut Stats, start: Instant) -> Result<Counters> {
        let at = Readback::of(&self.frame);
        let buffer = self.store.readback.buffer();
        let (sender, receiver) = std::sync::mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, 0..at.bytes, move |mapped| {
            // The receiver only goes away after an error that is reported already.
            let _ = sender.send(mapped);
        });
        self.gpu.wait()?;
        let lost = |what: &str| self.gpu.error(ErrorKind::DeviceLost, what);
        receiver.recv().map_err(|e| lost(&e.to_string()))?.map_err(|e| lost(&e.to_string()))?;
        stats.stage("device", start);
        let start = Instant::now();
        let view = buffer.get_mapped_range(0..at.bytes).map_err(|e| lost(&e.to_string()))?;
        let mut counters: Counters =
            bytemuck::pod_read_unaligned(&view[at.counters as usize..][..size_of::<Counters>()]);
        self.stage_times(&view[at.times as usize..], stats);
        let params = &self.frame.params;
        images.prepare(params.width, params.height, self.frame.outputs);
        if self.frame.on_host {
            let (keys, slots) = view[..at.counters as usize].split_at(at.slots as usize);
            let (keys, slots) = (bytemuck::cast_slice(keys), bytemuck::cast_slice(slots));
            counters.lost_ids += resolve::resolve(plan, params, keys, slots, images);
        } else {
            self.copy_images(&view[..at.counters as usize], images);
        }
        drop(view);
        buffer.unmap();
        stats.stage(if self.frame.on_host { "resolve on the CPU" } else { "readback" }, start);
        Ok(counters)
    }

    fn stage_times(&self, bytes: &[u8], stats: &mut Stats) {
        if self.store.times.is_none() {
            return;
        }
        let period = f64::from(self.gpu.queue.get_timestamp_period());
        let ticks: Vec<u64> = bytes.chunks_exact(8).map(bytemuck::pod_read_unaligned).collect();
        for (name, pair) in stages::NAMES.iter().zip(ticks.chunks_exact(2)) {
            let ms = pair[1].saturating_sub(pair[0]) as f64 * period * 1e-6;
            stats.stages_ms.push(((*name).to_owned(), ms));
        }
    }

    fn copy_images(&self, bytes: &[u8], images: &mut Images) {
        let pixels = images.pixels() * 4;
        for (i, output) in self.frame.outputs.iter().enumerate() {
            let from = &bytes[i * pixels..][..pixels];
            let to: &mut [u8] = match output {
                Output::Range => bytemuck::cast_slice_mut(&mut images.range),
                Output::DepthZ => bytemuck::cast_slice_mut(&mut images.depth_z),
                Output::PolygonId => bytemuck::cast_slice_mut(&mut images.polygon_id),
                Output::ObjectId => bytemuck::cast_slice_mut(&mut images.object_id),
                Output::CosIncidence => bytemuck::cast_slice_mut(&mut images.cos_incidence),
            };
            to.copy_from_slice(from);
        }
    }

    fn report(&self, counters: &Counters, reruns: usize, stats: &mut Stats) {
        let near = &self.frame.near;
        stats.count("polygons selected", self.frame.params.polygon_count as usize);
        stats.count("polygons in view", counters.survivors as usize);
        stats.count("polygons set up in f64", near.slots.len());
        stats.count("polygons edge-on", (counters.edge_on + near.edge_on) as usize);
        stats.count("work items", counters.items as usize);
        stats.count("reruns for room", reruns);
        stats.count("internal errors: hits without id", counters.lost_ids as usize);
        if counters.lost_ids > 0 {
            stats.notices.push(format!("{} hits without an id: please report this", counters.lost_ids));
        }
    }
}
