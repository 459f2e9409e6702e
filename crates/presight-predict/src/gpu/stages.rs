//! The stages. Each has `prepare` (pipelines), `bind` (buffers) and `encode`; none submits or reads back.
//!
//! | stage | reads | writes | its twin in `crate::cpu` |
//! |---|---|---|---|
//! | sift, from the second wave on | instances, runs, coarse depth | units of runs that nothing hides | `cull` |
//! | cull | instances, units, meshes, coarse depth | survivors | `setup` |
//! | setup | survivors, meshes | records, items | `setup` |
//! | raster | records, items | keys | `raster_lines` or `raster_rays` |
//! | draw, with [`presight_render::Raster::Render`] | records, shapes | keys | `raster_lines` |
//! | farthest, before each further wave | keys | coarse depth | `cull::measure` |
//! | resolve | keys, slots | outputs, slots that are shown | `resolve` |
//!
//! On software adapters the CPU resolves images instead, from the same keys: [`presight_render::plan::resolve_keys`].

use super::device::Gpu;
use super::drawing::{Draw, Drawing};
use super::frame_buffers::FrameBuffers;
use super::grid::Tables;
use super::layout::{self, Counters, GROUP, MAX_GROUPS, UNIT};
use super::part::Part;
use super::stage::{Binding, Stage, Variant};
use super::testing;
use super::uploads::FrameUploads;
use super::variants::Variants;
use presight_model::error::Result;
use presight_render::plan::Raster;
use std::mem::offset_of;

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
    pub fn prepare(&mut self, gpu: &Gpu, tables: &Tables, frame: &FrameUploads, test: testing::Setup) -> Result<()> {
        let needed = Variants::of(gpu, tables, frame);
        if frame.waves.len() > 1 {
            needed.prepare_sift(&mut self.sift)?;
            needed.prepare_farthest(&mut self.farthest, test)?;
        }
        needed.prepare_cull(&mut self.cull)?;
        needed.prepare_setup(&mut self.setup, test)?;
        if let Some(drawing) = self.drawing.as_mut().filter(|_| frame.rendered) {
            drawing.prepare(gpu, [frame.params.width, frame.params.height], needed.rays())?;
        }
        needed.prepare_raster(&mut self.raster)?;
        if frame.on_host { Ok(()) } else { needed.prepare_resolve(&mut self.resolve) }
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

    /// Encodes a part of a frame with at least one polygon.
    pub fn encode(&self, encoder: &mut wgpu::CommandEncoder, part: Part, r: &mut Recording<'_>) {
        debug_assert!(r.frame.polygon_count > 0, "no polygon is in view");
        if part.clears() {
            let pixels = r.frame.params.width * r.frame.params.height;
            encoder.clear_buffer(r.store.keys.buffer(), 0, Some(u64::from(pixels) * 8));
        }
        if part.draws() {
            (0..r.frame.waves.len()).for_each(|wave| self.encode_wave(encoder, wave, r));
        }
        if part.resolves() && !r.frame.on_host {
            self.encode_resolve(encoder, r);
        }
    }

    /// Encodes the resolving of images, the last pass of a frame.
    fn encode_resolve(&self, encoder: &mut wgpu::CommandEncoder, r: &Recording<'_>) {
        let Recording { gpu, variants, frame, store, .. } = *r;
        if frame.shown_words() > 0 {
            encoder.clear_buffer(store.shown.buffer(), 0, Some(4 * u64::from(frame.shown_words())));
        }
        let pixels = frame.params.width * frame.params.height;
        let mut pass = gpu.pass(encoder, &store.pass(frame.passes.len() as u32 - 1, frame));
        if self.resolve.set(&mut pass, variants.resolve(), 0) {
            gpu.dispatch(&mut pass, layout::groups_for(pixels));
        }
    }

    /// Encodes a wave: sift, cull, setup, raster, and the coarse depth for the next wave.
    fn encode_wave(&self, encoder: &mut wgpu::CommandEncoder, wave: usize, r: &mut Recording<'_>) {
        let Recording { gpu, variants: v, frame, store, .. } = *r;
        let (counters, dispatch) = (store.counters.buffer(), store.dispatch.buffer());
        if wave > 0 {
            let mut pass = gpu.pass(encoder, &r.next());
            if self.sift.set(&mut pass, v.sift(), wave) {
                gpu.dispatch(&mut pass, layout::groups_for(frame.waves[wave].len() as u32));
            }
            drop(pass);
            encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, cull_groups) as u64, dispatch, 0, 12);
        }
        let mut pass = gpu.pass(encoder, &r.next());
        if self.cull.set(&mut pass, v.cull(), wave) {
            if wave == 0 {
                gpu.dispatch(&mut pass, [(frame.first_units() * UNIT).div_ceil(GROUP).min(MAX_GROUPS), 1]);
            } else {
                pass.dispatch_workgroups_indirect(dispatch, 0);
            }
        }
        drop(pass);
        encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, setup_groups) as u64, dispatch, 0, 12);
        let mut pass = gpu.pass(encoder, &r.next());
        if self.setup.set(&mut pass, v.setup(), wave) {
            pass.dispatch_workgroups_indirect(dispatch, 0);
        }
        drop(pass);
        self.encode_raster(encoder, wave, r);
        if wave + 1 < frame.waves.len() {
            let mut pass = gpu.pass(encoder, &r.next());
            if self.farthest.set(&mut pass, v.farthest(), wave) {
                gpu.dispatch(&mut pass, frame.blocks);
            }
        }
    }

    /// Encodes spans and shapes of a wave; the last wave also gets the second pass over all waves.
    fn encode_raster(&self, encoder: &mut wgpu::CommandEncoder, wave: usize, r: &mut Recording<'_>) {
        let (counters, dispatch) = (r.store.counters.buffer(), r.store.dispatch.buffer());
        encoder.copy_buffer_to_buffer(counters, offset_of!(Counters, raster_groups) as u64, dispatch, 0, 12);
        let first = (r.variants.raster(), 0);
        let second = r.variants.second().filter(|_| wave + 1 == r.frame.waves.len()).map(|variant| (variant, 12));
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
        self.encode_shapes(encoder, wave, false, r);
        if let Some(second) = second {
            self.encode_spans(encoder, wave, &[second], r);
            self.encode_shapes(encoder, wave, true, r);
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
    fn encode_shapes(&self, encoder: &mut wgpu::CommandEncoder, wave: usize, second: bool, r: &mut Recording<'_>) {
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
pub(super) struct Recording<'a> {
    gpu: &'a Gpu,
    variants: Variants<'a>,
    frame: &'a FrameUploads,
    store: &'a FrameBuffers,
    /// Number of the next pass of the frame.
    number: u32,
}

impl<'a> Recording<'a> {
    pub fn new(gpu: &'a Gpu, tables: &Tables, frame: &'a FrameUploads, store: &'a FrameBuffers) -> Self {
        Self { gpu, variants: Variants::of(gpu, tables, frame), frame, store, number: 0 }
    }

    /// The next pass.
    fn next(&mut self) -> wgpu::ComputePassDescriptor<'a> {
        self.number += 1;
        self.store.pass(self.number - 1, self.frame)
    }
}
