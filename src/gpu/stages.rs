//! The four stages. Each is `prepare` (pipelines), `bind` (buffers), `encode`; none submits or reads back.
//!
//! | stage | reads | writes | its twin in `crate::cpu` |
//! |---|---|---|---|
//! | cull | instances, work, meshes | survivors | `cull` drops whole runs that earlier waves hide; single polygons fall out in `setup` |
//! | setup | survivors, meshes | records, items | `setup` |
//! | raster | records, items | keys | `raster_lines` or `raster_rays` |
//! | resolve | keys, slots | outputs | `resolve` |
//!
//! On software adapters [`super::resolve`] does on the CPU what `resolve.wgsl` does, from the same keys.

use super::device::Gpu;
use super::frame_buffers::FrameBuffers;
use super::grid::Tables;
use super::layout::{self, Counters, GridKind};
use super::shaders;
use super::stage::{Binding, Stage, Variant};
use super::uploads::FrameUploads;
use crate::error::Result;
use crate::plan::{Output, StageName};
use std::mem::offset_of;

/// Stages in order, as times are reported.
pub(super) const NAMES: [StageName; 4] = [StageName::Cull, StageName::Setup, StageName::Raster, StageName::Resolve];
/// The place of `resolve` among them.
pub(super) const RESOLVE: usize = 3;

/// All stages of the engine.
pub(super) struct Stages {
    cull: Stage,
    setup: Stage,
    raster: Stage,
    resolve: Stage,
}

/// The pipelines that a frame takes.
#[derive(Clone, Copy)]
pub(super) struct Variants {
    cull: Variant,
    setup: Variant,
    raster: Variant,
    /// The second pass where there are no 64-bit atomics.
    second: Option<Variant>,
    resolve: Variant,
}

impl Stages {
    pub fn new(gpu: &Gpu) -> Self {
        use Binding::{Read, Uniform, Write};
        Self {
            cull: Stage::new(gpu, "cull", &[Uniform, Read, Read, Read, Read, Write, Write, Uniform, Uniform]),
            setup: Stage::new(gpu, "setup", &[Uniform, Read, Read, Read, Read, Write, Write, Write, Write, Uniform]),
            raster: Stage::new(gpu, "raster", &[Uniform, Read, Read, Read, Read, Write, Uniform]),
            resolve: Stage::new(gpu, "resolve", &[Uniform, Read, Read, Read, Write, Write]),
        }
    }

    /// Makes the pipelines of a frame unless they are there.
    ///
    /// # Errors
    /// The device's.
    pub fn prepare(&mut self, gpu: &Gpu, tables: &Tables, frame: &FrameUploads) -> Result<Variants> {
        let kind = tables.kind;
        let grid = ("GRID", f64::from(kind as u32));
        let few = ("FEW", f64::from(u32::from(frame.few())));
        let lines = kind != GridKind::Rays;
        let short = tables.short();
        let cull = (kind as u32, u32::from(frame.plain) | u32::from(frame.few()) << 1 | u32::from(short) << 2);
        let cull_text = match kind {
            GridKind::Camera => shaders::CULL_CAMERA,
            GridKind::Scanner => shaders::CULL_SCANNER,
            GridKind::Rays => shaders::CULL_RAYS,
        };
        let short_constant = ("SHORT", f64::from(u32::from(short)));
        // Ray tables have no such constant, and a constant that is not there is an error.
        let constants = |own: &[(&'static str, f64)]| {
            let lines_only = lines.then_some(short_constant);
            [grid].into_iter().chain(lines_only).chain(own.iter().copied()).collect::<Vec<_>>()
        };
        let plain = ("PLAIN", f64::from(u32::from(frame.plain)));
        if !self.cull.has(cull) {
            self.cull.prepare(gpu, cull, cull_text, &constants(&[few, plain]))?;
        }
        let setup = (kind as u32, u32::from(frame.few()));
        self.setup.prepare(gpu, setup, if lines { shaders::SETUP_LINES } else { shaders::SETUP_RAYS }, &[grid, few])?;
        let raster = (kind as u32, u32::from(short) << 1);
        let mut second = None;
        if gpu.int64 {
            let text = if lines { shaders::RASTER_LINES_64 } else { shaders::RASTER_RAYS_64 };
            if !self.raster.has(raster) {
                self.raster.prepare(gpu, raster, text, &constants(&[]))?;
            }
        } else {
            let text = if lines { shaders::RASTER_LINES_32 } else { shaders::RASTER_RAYS_32 };
            let other = (raster.0, raster.1 | 1);
            if !self.raster.has(other) {
                self.raster.prepare(gpu, raster, text, &constants(&[("SECOND", 0.0)]))?;
                self.raster.prepare(gpu, other, text, &constants(&[("SECOND", 1.0)]))?;
            }
            second = Some(other);
        }
        let bits = frame.outputs.iter().fold(0, |bits, o| bits | 1 << o as u32);
        let asked = |o: Output| f64::from(u32::from(frame.outputs.has(o)));
        let constants = [
            grid,
            ("RANGE", asked(Output::Range)),
            ("DEPTH", asked(Output::DepthZ)),
            ("POLYGON", asked(Output::PolygonId)),
            ("OBJECT", asked(Output::ObjectId)),
            ("COSINE", asked(Output::CosIncidence)),
        ];
        let resolve = (kind as u32, bits);
        if !frame.on_host {
            self.resolve.prepare(gpu, resolve, shaders::RESOLVE, &constants)?;
        }
        Ok(Variants { cull, setup, raster, second, resolve })
    }

    /// Binds the buffers as they are now.
    pub fn bind(&mut self, gpu: &Gpu, arena: &wgpu::Buffer, s: &FrameBuffers) {
        let (params, grid, counters) = (s.params.buffer(), s.grid.buffer(), s.counters.buffer());
        let (instances, survivors) = (s.instances.buffer(), s.survivors.buffer());
        let (few, short) = (s.few_instances.buffer(), s.short_grid.buffer());
        let (records, items, slots, keys) =
            (s.records.buffer(), s.items.buffer(), s.seen_slots.buffer(), s.keys.buffer());
        self.cull.bind(gpu, &[params, instances, s.work.buffer(), arena, grid, survivors, counters, few, short]);
        self.setup.bind(gpu, &[params, instances, arena, survivors, grid, counters, records, items, slots, few]);
        self.raster.bind(gpu, &[params, records, items, grid, counters, keys, short]);
        self.resolve.bind(gpu, &[params, keys, slots, grid, s.outputs.buffer(), counters]);
    }

    /// Encodes a frame of at least one polygon, from cleared keys to outputs.
    pub fn encode(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        v: &Variants,
        frame: &FrameUploads,
        store: &FrameBuffers,
    ) {
        Self::clear(encoder, frame, store);
        self.draw(gpu, encoder, v, frame, store);
        self.resolve(gpu, encoder, v, frame, store);
    }

    /// Encodes that nothing is seen yet.
    pub fn clear(encoder: &mut wgpu::CommandEncoder, frame: &FrameUploads, store: &FrameBuffers) {
        let pixels = frame.params.width * frame.params.height;
        encoder.clear_buffer(store.keys.buffer(), 0, Some(u64::from(pixels) * 8));
    }

    /// Encodes the drawing of at least one polygon, over what the keys hold already.
    pub fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        v: &Variants,
        frame: &FrameUploads,
        store: &FrameBuffers,
    ) {
        debug_assert!(frame.params.polygon_count > 0, "nothing is in view");
        let counters = store.counters.buffer();
        let mut pass = gpu.pass(encoder, &store.pass(0, frame));
        if self.cull.set(&mut pass, v.cull) {
            gpu.dispatch(&mut pass, layout::groups_for(frame.params.polygon_count));
        }
        drop(pass);
        let groups = offset_of!(Counters, setup_groups) as u64;
        encoder.copy_buffer_to_buffer(counters, groups, store.dispatch.buffer(), 0, 12);
        let mut pass = gpu.pass(encoder, &store.pass(1, frame));
        if self.setup.set(&mut pass, v.setup) {
            pass.dispatch_workgroups_indirect(store.dispatch.buffer(), 0);
        }
        drop(pass);
        let groups = offset_of!(Counters, raster_groups) as u64;
        encoder.copy_buffer_to_buffer(counters, groups, store.dispatch.buffer(), 0, 12);
        let mut pass = gpu.pass(encoder, &store.pass(2, frame));
        for variant in [Some(v.raster), v.second].into_iter().flatten() {
            if self.raster.set(&mut pass, variant) {
                pass.dispatch_workgroups_indirect(store.dispatch.buffer(), 0);
            }
        }
    }

    /// Encodes the making of images, unless the CPU makes them.
    pub fn resolve(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        v: &Variants,
        frame: &FrameUploads,
        store: &FrameBuffers,
    ) {
        if frame.on_host {
            return;
        }
        let pixels = frame.params.width * frame.params.height;
        let mut pass = gpu.pass(encoder, &store.pass(RESOLVE as u32, frame));
        if self.resolve.set(&mut pass, v.resolve) {
            gpu.dispatch(&mut pass, layout::groups_for(pixels));
        }
    }
}

impl Variants {
    /// Workgroups that the device dispatched by its own count.
    pub fn indirect_groups(&self, counters: &Counters) -> u64 {
        let rasters = 1 + u64::from(self.second.is_some());
        u64::from(counters.setup_groups) + rasters * u64::from(counters.raster_groups)
    }
}
