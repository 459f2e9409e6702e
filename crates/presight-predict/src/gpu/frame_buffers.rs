//! The engine's buffers, reused from frame to frame.

use super::buffers::{Answers, Growable, Uploads};
use super::device::Gpu;
use super::grid::Tables;
use super::layout::{
    Counters, FEW_INSTANCES, GROUP, ITEM_WORDS, Instance, MAX_GROUPS, MAX_WAVES, Params, SHORT_GRID, SLOT_WORDS,
    Survivor, WAVE_BYTES,
};
use super::uploads::FrameUploads;
use presight_model::error::Result;
use std::mem::size_of;

/// Six passes in each wave, the second pass by spans and by shapes, and resolve.
const MAX_PASSES: u32 = 6 * MAX_WAVES as u32 + 3;

/// All buffers except the meshes.
pub(super) struct FrameBuffers {
    pub params: Growable,
    pub instances: Growable,
    pub work: Growable,
    pub grid: Growable,
    /// Uniform copy of the instances, used if they are few enough.
    pub few_instances: Growable,
    /// Uniform copy of the rays, used if they are few enough.
    pub short_grid: Growable,
    pub survivors: Growable,
    pub counters: Growable,
    pub records: Growable,
    pub items: Growable,
    pub seen_slots: Growable,
    pub keys: Growable,
    pub outputs: Growable,
    /// One bit per slot that the frame shows.
    pub shown: Growable,
    pub dispatch: Growable,
    pub readback: Answers,
    /// Begin and end time of every stage, if the device has timestamps.
    pub times: Option<(wgpu::QuerySet, Growable)>,
}

impl FrameBuffers {
    pub fn new(gpu: &Gpu) -> Self {
        use wgpu::BufferUsages as U;
        let times = gpu.timestamps.then(|| {
            gpu.made.buffers.add();
            let queries = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("times"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MAX_PASSES,
            });
            (queries, Growable::new(gpu, "times", U::QUERY_RESOLVE | U::COPY_SRC, false))
        });
        Self {
            params: Growable::uniform(gpu, "parameters", MAX_WAVES as u64 * WAVE_BYTES),
            few_instances: Growable::uniform(
                gpu,
                "few instances",
                u64::from(FEW_INSTANCES) * size_of::<Instance>() as u64,
            ),
            short_grid: Growable::uniform(gpu, "few rays", u64::from(SHORT_GRID) * 16),
            instances: Growable::storage(gpu, "instances"),
            work: Growable::storage(gpu, "runs"),
            grid: Growable::storage(gpu, "rays"),
            survivors: Growable::storage(gpu, "polygons in view"),
            counters: Growable::storage(gpu, "counters"),
            records: Growable::storage(gpu, "polygons set up"),
            items: Growable::storage(gpu, "work items"),
            seen_slots: Growable::storage(gpu, "slots"),
            keys: Growable::storage(gpu, "nearest"),
            outputs: Growable::storage(gpu, "images"),
            shown: Growable::storage(gpu, "polygons shown"),
            dispatch: Growable::new(gpu, "dispatch", U::INDIRECT | U::COPY_DST, false),
            readback: Answers::new(gpu, "the answer"),
            times,
        }
    }

    /// Makes room for a frame. Returns true if a bound buffer was replaced.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::DeviceMemory`].
    pub fn reserve(&mut self, gpu: &Gpu, frame: &FrameUploads) -> Result<bool> {
        let pixels = u64::from(frame.params.width) * u64::from(frame.params.height);
        // Unused buffers keep their minimum size: they are bound, but neither written nor read.
        let instances = if frame.few() { 0 } else { frame.instances.len() * size_of::<Instance>() };
        let outputs = if frame.on_host { 0 } else { (frame.output_words + frame.sum_words) * 4 };
        let mut replaced = self.instances.reserve(gpu, instances as u64)?;
        replaced |= self.work.reserve(gpu, frame.work_bytes())?;
        let survivors = u64::from(frame.polygon_count) * size_of::<Survivor>() as u64;
        replaced |= self.survivors.reserve(gpu, survivors)?;
        replaced |= self.records.reserve(gpu, size_of_val(&frame.near.records[..]) as u64)?;
        replaced |= self.items.reserve(gpu, size_of_val(&frame.near.items[..]) as u64)?;
        replaced |= self.seen_slots.reserve(gpu, frame.slot_bytes())?;
        replaced |= self.keys.reserve(gpu, pixels * 8)?;
        replaced |= self.outputs.reserve(gpu, outputs)?;
        replaced |= self.shown.reserve(gpu, 4 * u64::from(frame.shown_words()))?;
        Ok(replaced)
    }

    /// Makes room for a sensor's tables. Returns true if the buffer was replaced.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::DeviceMemory`].
    pub fn reserve_grid(&mut self, gpu: &Gpu, tables: &Tables) -> Result<bool> {
        self.grid.reserve(gpu, tables.bytes())
    }

    /// Uploads a sensor's tables.
    pub fn put_grid(&self, uploads: &mut Uploads, tables: &Tables) {
        let bytes: &[u8] = bytemuck::cast_slice(&tables.words);
        if tables.short() {
            uploads.put(&self.short_grid, 0, bytes);
        }
        uploads.put(&self.grid, 0, bytes);
    }

    /// Uploads a frame, with the available room and the initial counters.
    pub fn put(&self, uploads: &mut Uploads, frame: &FrameUploads) {
        let (record_words, item_room) = (self.record_room(), self.item_room());
        for wave in 0..frame.waves.len() {
            let params = Params { record_words, item_room, ..frame.params_of(wave) };
            uploads.put(&self.params, wave as u64 * WAVE_BYTES, bytemuck::bytes_of(&params));
        }
        let instances = if frame.few() { &self.few_instances } else { &self.instances };
        uploads.put(instances, 0, bytemuck::cast_slice(&frame.instances));
        uploads.put(&self.work, 0, bytemuck::cast_slice(&frame.work));
        uploads.put(&self.records, 0, bytemuck::cast_slice(&frame.near.records));
        uploads.put(&self.items, 0, bytemuck::cast_slice(&frame.near.items));
        for (slot, content) in &frame.near.slots {
            let at = u64::from(*slot) * 4 * u64::from(SLOT_WORDS);
            uploads.put(&self.seen_slots, at, bytemuck::bytes_of(content));
        }
        let items = frame.near.items.len() as u32;
        let counters = Counters {
            record_words: frame.near.records.len() as u32,
            items,
            setup_y: 1,
            setup_z: 1,
            raster_groups: items.div_ceil(GROUP).min(MAX_GROUPS),
            raster_y: 1,
            raster_z: 1,
            cull_y: 1,
            cull_z: 1,
            units: frame.first_units(),
            all_raster_groups: items.div_ceil(GROUP).min(MAX_GROUPS),
            all_raster_y: 1,
            all_raster_z: 1,
            draw_instances: 1,
            all_draw_instances: 1,
            ..Counters::default()
        };
        uploads.put(&self.counters, 0, bytemuck::bytes_of(&counters));
    }

    fn record_room(&self) -> u32 {
        (self.records.buffer().size() / 4).min(u64::from(u32::MAX)) as u32
    }

    fn item_room(&self) -> u32 {
        (self.items.buffer().size() / (4 * u64::from(ITEM_WORDS))).min(u64::from(u32::MAX)) as u32
    }

    /// Makes the room that a frame turned out to need. Returns true if it overflowed and must run again.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::DeviceMemory`].
    pub fn grow_for(&mut self, gpu: &Gpu, counters: &Counters) -> Result<bool> {
        let mut again = self.records.reserve(gpu, u64::from(counters.record_words) * 4)?;
        again |= self.items.reserve(gpu, u64::from(counters.items) * 4 * u64::from(ITEM_WORDS))?;
        Ok(again)
    }

    /// Encodes a copy of the counters alone to the start of the readback buffer.
    pub fn encode_counters(&self, encoder: &mut wgpu::CommandEncoder) {
        let bytes = size_of::<Counters>() as u64;
        encoder.copy_buffer_to_buffer(self.counters.buffer(), 0, self.readback.buffer(), 0, bytes);
    }

    /// Descriptor of compute pass `number`. It records timestamps only if the submission holds a single frame.
    pub fn pass(&self, number: u32, frame: &FrameUploads) -> wgpu::ComputePassDescriptor<'_> {
        let times = self.render_times(number, frame).map(|times| wgpu::ComputePassTimestampWrites {
            query_set: times.query_set,
            beginning_of_pass_write_index: times.beginning_of_pass_write_index,
            end_of_pass_write_index: times.end_of_pass_write_index,
        });
        wgpu::ComputePassDescriptor { label: Some(frame.passes[number as usize].name()), timestamp_writes: times }
    }

    /// Timestamp slots of render pass `number`, if the submission holds a single frame.
    pub fn render_times(&self, number: u32, frame: &FrameUploads) -> Option<wgpu::RenderPassTimestampWrites<'_>> {
        self.times.as_ref().filter(|_| !frame.in_company).map(|(query_set, _)| wgpu::RenderPassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(2 * number),
            end_of_pass_write_index: Some(2 * number + 1),
        })
    }

    /// Encodes the copies of a frame's answer into the readback buffer, from byte `first` on.
    pub fn encode_readback(&self, encoder: &mut wgpu::CommandEncoder, frame: &FrameUploads, first: u64) {
        let at = Readback::of(frame);
        let mut copy = |(from, begin): (&Growable, u64), to: u64, bytes: u64| {
            if bytes > 0 {
                encoder.copy_buffer_to_buffer(from.buffer(), begin, self.readback.buffer(), first + to, bytes);
            }
        };
        if frame.on_host {
            copy((&self.keys, 0), 0, at.slots);
            copy((&self.seen_slots, 0), at.slots, at.counters - at.slots);
        } else {
            let begin = if frame.sum_words > 0 { frame.output_words * 4 } else { 0 };
            copy((&self.outputs, begin), 0, at.counters);
        }
        copy((&self.counters, 0), at.counters, size_of::<Counters>() as u64);
        copy((&self.shown, 0), at.shown, 4 * u64::from(frame.shown_words()));
        if let Some((queries, resolved)) = self.times.as_ref().filter(|_| !frame.in_company) {
            encoder.resolve_query_set(queries, 0..2 * frame.passes.len() as u32, resolved.buffer(), 0);
            let (to, bytes) = (first + at.times, at.bytes - at.times);
            encoder.copy_buffer_to_buffer(resolved.buffer(), 0, self.readback.buffer(), to, bytes);
        }
    }
}

/// Byte offsets in the readback buffer: images (or sums, or keys and slots), counters, shown bits, times.
#[derive(Clone, Copy)]
pub(super) struct Readback {
    pub slots: u64,
    pub counters: u64,
    pub shown: u64,
    pub times: u64,
    pub bytes: u64,
}

impl Readback {
    pub fn of(frame: &FrameUploads) -> Self {
        let slots = if frame.on_host { u64::from(frame.params.width) * u64::from(frame.params.height) * 8 } else { 0 };
        let counters = match frame.sum_words {
            _ if frame.on_host => slots + frame.slot_bytes(),
            0 => frame.output_words * 4,
            sums => sums * 4,
        };
        let shown = counters + size_of::<Counters>() as u64;
        // Query results are 8 bytes and need 8-byte alignment.
        let times = (shown + 4 * u64::from(frame.shown_words())).next_multiple_of(8);
        // Frames of a batch differ in passes, but not in the length of their answers: no times are recorded for them.
        let passes = if frame.in_company { 0 } else { frame.passes.len() as u64 };
        Self { slots, counters, shown, times, bytes: times + 16 * passes }
    }
}
