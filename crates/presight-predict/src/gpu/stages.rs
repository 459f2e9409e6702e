//! The stages. Each has `prepare` (pipelines), `bind` (buffers) and `encode`; none submits or reads back.
//!
//! | stage | reads | writes | its twin in `crate::cpu` |
//! |---|---|---|---|
//! | sift, from the second wave on | instances, runs, coarse depth | units of runs that nothing hides | `cull` |
//! | cull | instances, units, meshes, coarse depth | survivors | `setup` |
//! | setup | survivors, meshes | records, items | `setup` |
//! | raster | records, items | keys | `raster_lines` or `raster_rays` |
//! | draw, with [`crate::Raster::Render`] | records, shapes | keys | `raster_lines` |
//! | farthest, before each further wave | keys | coarse depth | `cull::measure` |
//! | resolve | keys, slots | outputs, slots that are shown | `resolve` |
//!
//! On software adapters the CPU resolves images instead, from the same keys: [`crate::plan::resolve_keys`].

use super::device::Gpu;
use super::drawing::{Draw, Drawing};
use super::frame_buffers::FrameBuffers;
use super::grid::Tables;
use super::layout::{self, Counters, GROUP, GridKind, MAX_GROUPS, UNIT};
use super::shaders;
use super::stage::{Binding, Stage, Variant};
use super::testing::{self, Hiding};
use super::uploads::FrameUploads;
use presight_model::error::Result;
use presight_render::plan::{Output, Raster};
use std::mem::offset_of;

/// A planted fault for tests: depth appears nearer by this share, more than rounding allows near the axis.
const TOO_NEAR: f64 = 1e-4;

/// Offset of a draw's counts, bytes; it follows the counts of the dispatches.
const DRAW_AT: u64 = 24;

/// All stages of the engine.
pub(super) struct Stages {
    sift: Stage,
    cull: Stage,
    setup: Stage,
    raster: Stage,
    /// `None` unless the device was opened for the hardware rasterizer.
    drawing: Option<Drawing>,
    farthest: Stage,
    resolve: Stage,
}

/// The pipelines that a frame uses.
#[derive(Clone, Copy)]
pub(super) struct Variants {
    sift: Variant,
    cull: Variant,
    setup: Variant,
    raster: Variant,
    farthest: Variant,
    /// The second raster pass, for devices without 64-bit atomics.
    second: Option<Variant>,
    resolve: Variant,
}

impl Stages {
    pub fn new(gpu: &Gpu) -> Self {
        use Binding::{Params, Read, Uniform, Write};
        Self {
            sift: Stage::new(gpu, "sift", &[Params, Read, Write, Read, Read, Write, Uniform, Uniform]),
            cull: Stage::new(gpu, "cull", &[Params, Read, Read, Read, Read, Write, Write, Uniform, Uniform]),
            setup: Stage::new(gpu, "setup", &[Params, Read, Read, Write, Read, Write, Write, Write, Write, Uniform]),
            raster: Stage::new(gpu, "raster", &[Params, Read, Read, Read, Read, Write, Uniform]),
            drawing: (gpu.raster == Raster::Render).then(|| Drawing::new(gpu)),
            farthest: Stage::new(gpu, "farthest", &[Params, Read, Write, Write, Uniform]),
            resolve: Stage::new(gpu, "resolve", &[Params, Read, Read, Read, Write, Write, Write]),
        }
    }

    /// Creates the pipelines of a frame unless they exist.
    ///
    /// # Errors
    /// Errors of the device.
    pub fn prepare(
        &mut self,
        gpu: &Gpu,
        tables: &Tables,
        frame: &FrameUploads,
        test: testing::Setup,
    ) -> Result<Variants> {
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
        // The ray rasterizer does not declare SHORT, and wgpu rejects unknown constants.
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
            let too_near = ("TOO_NEAR", if test.hiding == Hiding::TooNear { TOO_NEAR } else { 0.0 });
            self.farthest.prepare(gpu, farthest, shaders::FARTHEST, &[grid, short_constant, too_near])?;
        }
        let plain = ("PLAIN", f64::from(u32::from(frame.plain)));
        if !self.cull.has(cull) {
            self.cull.prepare(gpu, cull, cull_text, &[grid, short_constant, few, plain])?;
        }
        let setup = (kind as u32, u32::from(frame.few()) | u32::from(frame.rendered) << 1);
        let rendered = ("RENDER", f64::from(u32::from(frame.rendered)));
        let growth = ("GROWTH", if test.shapes_not_grown { 0.0 } else { 1.0 });
        if lines {
            self.setup.prepare(gpu, setup, shaders::SETUP_LINES, &[grid, few, rendered, growth])?;
        } else {
            self.setup.prepare(gpu, setup, shaders::SETUP_RAYS, &[grid, few, rendered])?;
        }
        if let Some(drawing) = self.drawing.as_mut().filter(|_| frame.rendered) {
            drawing.prepare(gpu, [frame.params.width, frame.params.height], short_constant)?;
        }
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
            ("SHOWN", f64::from(u32::from(frame.shown_words() > 0))),
        ];
        let resolve = (kind as u32, bits | u32::from(frame.shown_words() > 0) << 31);
        if !frame.on_host {
            self.resolve.prepare(gpu, resolve, shaders::RESOLVE, &constants)?;
        }
        Ok(Variants { sift, cull, setup, raster, farthest, second, resolve })
    }

    /// Binds the current buffers.
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
        self.drawing.iter_mut().for_each(|drawing| drawing.bind(gpu, s));
        self.resolve.bind(gpu, &[params, keys, slots, grid, s.outputs.buffer(), counters, s.shown.buffer()]);
    }

    /// Encodes a frame with at least one polygon, from cleared keys to outputs.
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

    /// Encodes the clearing of the keys.
    pub fn clear(encoder: &mut wgpu::CommandEncoder, frame: &FrameUploads, store: &FrameBuffers) {
        let pixels = frame.params.width * frame.params.height;
        encoder.clear_buffer(store.keys.buffer(), 0, Some(u64::from(pixels) * 8));
    }

    /// Encodes drawing at least one polygon, on top of the present keys.
    pub fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        v: &Variants,
        frame: &FrameUploads,
        store: &FrameBuffers,
    ) {
        debug_assert!(frame.polygon_count > 0, "nothing is in view");
        let mut recording = Recording { gpu, variants: v, frame, store, number: 0 };
        for wave in 0..frame.waves.len() {
            self.encode_wave(encoder, wave, &mut recording);
        }
    }

    /// Encodes the resolving of images, unless the CPU resolves them.
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
        if frame.shown_words() > 0 {
            encoder.clear_buffer(store.shown.buffer(), 0, Some(4 * u64::from(frame.shown_words())));
        }
        let pixels = frame.params.width * frame.params.height;
        let mut pass = gpu.pass(encoder, &store.pass(frame.passes.len() as u32 - 1, frame));
        if self.resolve.set(&mut pass, v.resolve, 0) {
            gpu.dispatch(&mut pass, layout::groups_for(pixels));
        }
    }

    /// Encodes a wave: sift, cull, setup, raster, and the coarse depth for the next wave.
    fn encode_wave(&self, encoder: &mut wgpu::CommandEncoder, wave: usize, r: &mut Recording<'_>) {
        let Recording { gpu, variants: v, frame, store, .. } = *r;
        let (counters, dispatch) = (store.counters.buffer(), store.dispatch.buffer());
        if wave > 0 {
            let mut pass = gpu.pass(encoder, &r.next());
            if self.sift.set(&mut pass, v.sift, wave) {
                gpu.dispatch(&mut pass, layout::groups_for(frame.waves[wave].len() as u32));
            }
            drop(pass);
            encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, cull_groups) as u64, dispatch, 0, 12);
        }
        let mut pass = gpu.pass(encoder, &r.next());
        if self.cull.set(&mut pass, v.cull, wave) {
            if wave == 0 {
                gpu.dispatch(&mut pass, ((frame.first_units() * UNIT).div_ceil(GROUP).min(MAX_GROUPS), 1));
            } else {
                pass.dispatch_workgroups_indirect(dispatch, 0);
            }
        }
        drop(pass);
        encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, setup_groups) as u64, dispatch, 0, 12);
        let mut pass = gpu.pass(encoder, &r.next());
        if self.setup.set(&mut pass, v.setup, wave) {
            pass.dispatch_workgroups_indirect(dispatch, 0);
        }
        drop(pass);
        self.encode_raster(encoder, wave, r);
        if wave + 1 < frame.waves.len() {
            let mut pass = gpu.pass(encoder, &r.next());
            if self.farthest.set(&mut pass, v.farthest, wave) {
                gpu.dispatch(&mut pass, frame.blocks);
            }
        }
    }

    /// Encodes spans and shapes of a wave; the last wave also gets the second pass over all waves.
    fn encode_raster(&self, encoder: &mut wgpu::CommandEncoder, wave: usize, r: &mut Recording<'_>) {
        let (counters, dispatch) = (r.store.counters.buffer(), r.store.dispatch.buffer());
        encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, raster_groups) as u64, dispatch, 0, 12);
        let first = (r.variants.raster, 0);
        let second = r.variants.second.filter(|_| wave + 1 == r.frame.waves.len()).map(|variant| (variant, 12));
        if second.is_some() {
            encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, all_raster_groups) as u64, dispatch, 12, 12);
        }
        if !r.frame.rendered {
            let both: Vec<_> = [first].into_iter().chain(second).collect();
            self.encode_spans(encoder, wave, &both, r);
            return;
        }
        // The second pass starts after both spans and shapes have finished the first.
        self.encode_spans(encoder, wave, &[first], r);
        self.encode_shapes(encoder, (wave, false), r);
        if let Some(second) = second {
            self.encode_spans(encoder, wave, &[second], r);
            self.encode_shapes(encoder, (wave, true), r);
        }
    }

    /// Encodes span passes; each variant comes with the byte offset of its count among the dispatches.
    fn encode_spans(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        wave: usize,
        passes: &[(Variant, u64)],
        r: &mut Recording<'_>,
    ) {
        let mut pass = r.gpu.pass(encoder, &r.next());
        for (variant, at) in passes {
            if self.raster.set(&mut pass, *variant, wave) {
                pass.dispatch_workgroups_indirect(r.store.dispatch.buffer(), *at);
            }
        }
    }

    /// Encodes the hardware rasterizer's pass over a wave, or in the second pass over all waves.
    fn encode_shapes(&self, encoder: &mut wgpu::CommandEncoder, (wave, second): (usize, bool), r: &mut Recording<'_>) {
        let Some(drawing) = &self.drawing else { return };
        let from = if second { offset_of!(Counters, all_draw_vertices) } else { offset_of!(Counters, draw_vertices) };
        let (counts, at) = (r.store.dispatch.buffer(), DRAW_AT);
        encoder.copy_buffer_to_buffer(r.store.counters.buffer(), from as u64, counts, at, 16);
        let size = [r.frame.params.width, r.frame.params.height];
        let times = r.store.render_times(r.number, r.frame);
        r.number += 1;
        drawing.encode(r.gpu, encoder, times, &Draw { wave, second, size, counts, at });
    }
}

/// State while a frame is encoded.
struct Recording<'a> {
    gpu: &'a Gpu,
    variants: &'a Variants,
    frame: &'a FrameUploads,
    store: &'a FrameBuffers,
    /// Number of the next pass of the frame.
    number: u32,
}

impl<'a> Recording<'a> {
    /// The next pass.
    fn next(&mut self) -> wgpu::ComputePassDescriptor<'a> {
        self.number += 1;
        self.store.pass(self.number - 1, self.frame)
    }
}

impl Variants {
    /// Number of workgroups that the device dispatched indirectly.
    pub fn indirect_groups(&self, counters: &Counters) -> u64 {
        let of_last = counters.cull_groups + counters.setup_groups + counters.raster_groups;
        let second = if self.second.is_some() { counters.all_raster_groups } else { 0 };
        u64::from(counters.groups_before) + u64::from(of_last) + u64::from(second)
    }
}
