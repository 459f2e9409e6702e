//! The stages. Each is `prepare` (pipelines), `bind` (buffers), `encode`; none submits or reads back.
//!
//! | stage | reads | writes | its twin in `crate::cpu` |
//! |---|---|---|---|
//! | sift, from the second wave on | instances, runs, coarse depth | units of runs that nothing hides | `cull` |
//! | cull | instances, units, meshes, coarse depth | survivors | `setup` |
//! | setup | survivors, meshes | records, items | `setup` |
//! | raster | records, items | keys | `raster_lines` or `raster_rays` |
//! | farthest, before each further wave | keys | coarse depth | `cull::measure` |
//! | resolve | keys, slots | outputs | `resolve` |
//!
//! On software adapters [`super::resolve`] does on the CPU what `resolve.wgsl` does, from the same keys.

use super::device::Gpu;
use super::frame_buffers::FrameBuffers;
use super::grid::Tables;
use super::layout::{self, Counters, GROUP, GridKind, MAX_GROUPS, UNIT};
use super::shaders;
use super::stage::{Binding, Stage, Variant};
use super::testing::Hiding;
use super::uploads::FrameUploads;
use crate::error::Result;
use crate::plan::Output;
use std::mem::offset_of;

/// The share by which a planted fault takes depth to be too near: more than the rounding that is allowed for a polygon near the axis.
const TOO_NEAR: f64 = 1e-4;

/// All stages of the engine.
pub(super) struct Stages {
    sift: Stage,
    cull: Stage,
    setup: Stage,
    raster: Stage,
    farthest: Stage,
    resolve: Stage,
}

/// The pipelines that a frame takes.
#[derive(Clone, Copy)]
pub(super) struct Variants {
    sift: Variant,
    cull: Variant,
    setup: Variant,
    raster: Variant,
    farthest: Variant,
    /// The second pass where there are no 64-bit atomics.
    second: Option<Variant>,
    resolve: Variant,
}

impl Stages {
    pub fn new(gpu: &Gpu) -> Self {
        use Binding::{Params, Read, Uniform, Write};
        Self {
            sift: Stage::new(gpu, "sift", &[Params, Read, Write, Read, Read, Write, Uniform, Uniform]),
            cull: Stage::new(gpu, "cull", &[Params, Read, Read, Read, Read, Write, Write, Uniform, Uniform]),
            setup: Stage::new(gpu, "setup", &[Params, Read, Read, Read, Read, Write, Write, Write, Write, Uniform]),
            raster: Stage::new(gpu, "raster", &[Params, Read, Read, Read, Read, Write, Uniform]),
            farthest: Stage::new(gpu, "farthest", &[Params, Read, Write, Write, Uniform]),
            resolve: Stage::new(gpu, "resolve", &[Params, Read, Read, Read, Write, Write]),
        }
    }

    /// Makes the pipelines of a frame unless they are there.
    ///
    /// # Errors
    /// The device's.
    pub fn prepare(&mut self, gpu: &Gpu, tables: &Tables, frame: &FrameUploads, hiding: Hiding) -> Result<Variants> {
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
        // Rasters of ray tables have no such constant, and a constant that is not there is an error.
        let constants = |own: &[(&'static str, f64)]| {
            let lines_only = lines.then_some(short_constant);
            [grid].into_iter().chain(lines_only).chain(own.iter().copied()).collect::<Vec<_>>()
        };
        let sift = (kind as u32, cull.1 & !1);
        let farthest = (kind as u32, u32::from(short));
        if frame.waves.len() > 1 {
            let sift_text = match kind {
                GridKind::Camera => shaders::SIFT_CAMERA,
                GridKind::Scanner => shaders::SIFT_SCANNER,
                GridKind::Rays => shaders::SIFT_RAYS,
            };
            self.sift.prepare(gpu, sift, sift_text, &[grid, short_constant, few])?;
            let too_near = ("TOO_NEAR", if hiding == Hiding::TooNear { TOO_NEAR } else { 0.0 });
            self.farthest.prepare(gpu, farthest, shaders::FARTHEST, &[grid, short_constant, too_near])?;
        }
        let plain = ("PLAIN", f64::from(u32::from(frame.plain)));
        if !self.cull.has(cull) {
            self.cull.prepare(gpu, cull, cull_text, &[grid, short_constant, few, plain])?;
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
        Ok(Variants { sift, cull, setup, raster, farthest, second, resolve })
    }

    /// Binds the buffers as they are now.
    pub fn bind(&mut self, gpu: &Gpu, arena: &wgpu::Buffer, s: &FrameBuffers) {
        let (params, grid, counters) = (s.params.buffer(), s.grid.buffer(), s.counters.buffer());
        let (instances, survivors) = (s.instances.buffer(), s.survivors.buffer());
        let (few, short) = (s.few_instances.buffer(), s.short_grid.buffer());
        let (records, items, slots, keys) =
            (s.records.buffer(), s.items.buffer(), s.seen_slots.buffer(), s.keys.buffer());
        self.sift.bind(gpu, &[params, instances, s.work.buffer(), arena, grid, counters, few, short]);
        self.farthest.bind(gpu, &[params, keys, grid, counters, short]);
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
        debug_assert!(frame.polygon_count > 0, "nothing is in view");
        let mut number = 0;
        for wave in 0..frame.waves.len() {
            self.encode_wave(gpu, encoder, v, wave, &mut number, frame, store);
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
        let mut pass = gpu.pass(encoder, &store.pass(frame.passes.len() as u32 - 1, frame));
        if self.resolve.set(&mut pass, v.resolve, 0) {
            gpu.dispatch(&mut pass, layout::groups_for(pixels));
        }
    }

    /// Encodes a wave, whose first pass has that number among those of the frame, and leaves the number of the next.
    #[expect(clippy::too_many_arguments, reason = "what a frame is encoded from, and where in it the wave is")]
    fn encode_wave(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        v: &Variants,
        wave: usize,
        number: &mut u32,
        frame: &FrameUploads,
        store: &FrameBuffers,
    ) {
        let (counters, dispatch) = (store.counters.buffer(), store.dispatch.buffer());
        let next = |number: &mut u32| {
            *number += 1;
            store.pass(*number - 1, frame)
        };
        let last = wave + 1 == frame.waves.len();
        if wave > 0 {
            let mut pass = gpu.pass(encoder, &next(number));
            if self.sift.set(&mut pass, v.sift, wave) {
                gpu.dispatch(&mut pass, layout::groups_for(frame.waves[wave].len() as u32));
            }
            drop(pass);
            encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, cull_groups) as u64, dispatch, 0, 12);
        }
        let mut pass = gpu.pass(encoder, &next(number));
        if self.cull.set(&mut pass, v.cull, wave) {
            if wave == 0 {
                gpu.dispatch(&mut pass, ((frame.first_units() * UNIT).div_ceil(GROUP).min(MAX_GROUPS), 1));
            } else {
                pass.dispatch_workgroups_indirect(dispatch, 0);
            }
        }
        drop(pass);
        encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, setup_groups) as u64, dispatch, 0, 12);
        let mut pass = gpu.pass(encoder, &next(number));
        if self.setup.set(&mut pass, v.setup, wave) {
            pass.dispatch_workgroups_indirect(dispatch, 0);
        }
        drop(pass);
        encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, raster_groups) as u64, dispatch, 0, 12);
        if last && v.second.is_some() {
            encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, all_raster_groups) as u64, dispatch, 12, 12);
        }
        let mut pass = gpu.pass(encoder, &next(number));
        for (variant, at) in [(Some(v.raster), 0), (v.second.filter(|_| last), 12)] {
            if let Some(variant) = variant
                && self.raster.set(&mut pass, variant, wave)
            {
                pass.dispatch_workgroups_indirect(dispatch, at);
            }
        }
        drop(pass);
        if last {
            return;
        }
        let mut pass = gpu.pass(encoder, &next(number));
        if self.farthest.set(&mut pass, v.farthest, wave) {
            gpu.dispatch(&mut pass, frame.blocks);
        }
    }
}

impl Variants {
    /// Workgroups that the device dispatched by its own count.
    pub fn indirect_groups(&self, counters: &Counters) -> u64 {
        let of_last = counters.cull_groups + counters.setup_groups + counters.raster_groups;
        let second = if self.second.is_some() { counters.all_raster_groups } else { 0 };
        u64::from(counters.groups_before) + u64::from(of_last) + u64::from(second)
    }
}
