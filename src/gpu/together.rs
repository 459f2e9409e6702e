//! Several frames of one sensor in one submission: they share buffers on the device, one after the other, and each has its own
//! place in the answer. For batches: what a submission costs besides is paid once.

use super::frame_buffers::Readback;
use super::layout::Counters;
use super::stages::Variants;
use super::uploads::FrameUploads;
use super::{GpuEngine, counters_of};
use crate::error::{ErrorKind, Result};
use crate::plan::{FramePlan, Images, NOTHING_IN_VIEW, StageName, Stats, Work};
use std::time::Instant;

/// Bytes of answers of a submission.
const MOST_BYTES: u64 = 64 << 20;
/// Most frames of a submission.
const MOST_FRAMES: u64 = 64;

/// Takes a plan's images, with its place in the answer and its counters if it was drawn.
type HandOver<'a> = dyn FnMut(&mut Images, Stats, Option<(usize, Counters)>) + 'a;

impl GpuEngine {
    /// Draws plans of one sensor, and hands over each one's images in their order. After an error those that were handed over are
    /// right. The times and the work of a submission are told of its first frame.
    ///
    /// # Errors
    /// As [`GpuEngine::render`].
    pub fn render_many(
        &mut self,
        plans: &[FramePlan],
        images: &mut Images,
        each: &mut dyn FnMut(&mut Images, Stats),
    ) -> Result<()> {
        let Some(first) = plans.first() else { return Ok(()) };
        self.drawn = false;
        self.gpu.check()?;
        // Sensor and world decide how long an answer is.
        self.fill_frames(&[first])?;
        let count = (MOST_BYTES / Readback::of(&self.frames[0]).bytes.max(1)).clamp(1, MOST_FRAMES);
        plans.chunks(count as usize).try_for_each(|plans| self.render_some(plans, images, each))
    }

    fn render_some(
        &mut self,
        plans: &[FramePlan],
        images: &mut Images,
        each: &mut dyn FnMut(&mut Images, Stats),
    ) -> Result<()> {
        let start = Instant::now();
        let before = self.gpu.work();
        let drawn: Vec<&FramePlan> = plans.iter().filter(|plan| plan.polygon_count > 0).collect();
        if !drawn.is_empty() {
            plans.iter().try_for_each(|plan| plan.world_from_sensor.check())?;
            self.store.uploads.clear();
            self.fill_frames(&drawn)?;
        }
        let bytes = drawn.len() as u64 * self.answer_bytes();
        let mut shared = Stats::default();
        if drawn.is_empty() {
            return self.hand_over(plans, &[], images, shared, &mut |images, stats, _| each(images, stats));
        }
        let (variants, reruns) = self.draw(drawn.len(), bytes)?;
        shared.stage(StageName::Device, start);
        let buffer = self.store.readback.buffer().clone();
        let view = buffer.get_mapped_range(0..bytes);
        let view = view.map_err(|e| self.gpu.error(ErrorKind::DeviceLost, &e.to_string()))?;
        let handed = self.hand_over(plans, &view, images, shared, &mut |images, mut stats, drawn| {
            if let Some((number, counters)) = drawn {
                self.gpu.done.workgroups.add_many(variants[number].indirect_groups(&counters));
                self.report(&self.frames[number], &counters, reruns, &mut stats);
                if number == 0 {
                    stats.work = Work { image_bytes: stats.work.image_bytes, ..self.gpu.work().since(before) };
                }
            }
            each(images, stats);
        });
        drop(view);
        buffer.unmap();
        handed
    }

    /// Makes each plan's images of the answer; `shared` goes to the first.
    fn hand_over(
        &self,
        plans: &[FramePlan],
        answer: &[u8],
        images: &mut Images,
        mut shared: Stats,
        each: &mut HandOver<'_>,
    ) -> Result<()> {
        let mut number = 0;
        for plan in plans {
            let mut stats = std::mem::take(&mut shared);
            stats.engine = "gpu";
            stats.adapter = Some(self.gpu.adapter.to_string());
            images.try_prepare(plan.sensor.width(), plan.sensor.height(), plan.drawn())?;
            let mut drawn = None;
            if plan.polygon_count > 0 {
                let own = &answer[number * self.answer_bytes() as usize..];
                drawn = Some((number, self.take_answer(&self.frames[number], own, plan, images)?));
                number += 1;
            } else {
                images.show_nothing(plan.sensor.grid());
                stats.leave_out(StageName::DrawingOnDevice, NOTHING_IN_VIEW);
            }
            plan.finish_noting(images, &mut stats)?;
            each(images, stats, drawn);
        }
        Ok(())
    }

    /// Of one frame; all frames of a sensor and a world have as many.
    fn answer_bytes(&self) -> u64 {
        self.frames.first().map_or(0, |frame| Readback::of(frame).bytes)
    }

    /// Works out the frames of plans, and makes room for each.
    fn fill_frames(&mut self, plans: &[&FramePlan]) -> Result<()> {
        self.take_sensor(&plans[0].sensor)?;
        let meshes = plans.iter().flat_map(|plan| {
            let objects = plan.environment().objects();
            plan.instances.iter().map(|i| &objects[i.object as usize].mesh)
        });
        self.rebind |= self.arena.admit(&self.gpu, meshes)?;
        if self.frames.len() < plans.len() {
            self.frames.resize_with(plans.len(), FrameUploads::default);
        }
        let way = self.way();
        for (frame, plan) in self.frames.iter_mut().zip(plans) {
            // What earlier frames left in the slots must not carry this frame's stamp.
            frame.near.stamp = self.frame.near.stamp;
            frame.fill(plan, &self.sensors[0].1, &self.arena, way);
            frame.in_company = true;
            self.frame.near.stamp = frame.near.stamp;
            self.rebind |= self.store.reserve(&self.gpu, frame)?;
        }
        if self.frames[0].on_host {
            self.threads = self.threads.started()?;
        }
        self.store.readback.reserve(&self.gpu, plans.len() as u64 * self.answer_bytes())?;
        Ok(())
    }

    /// Draws the first frames and maps their answers; again, if one of them had too little room.
    fn draw(&mut self, count: usize, bytes: u64) -> Result<(Vec<Variants>, usize)> {
        let mut reruns = 0;
        loop {
            let variants = self.submit_many(count)?;
            self.map_answer(bytes)?;
            let all = self.counters(count, bytes)?;
            let mut again = false;
            for counters in all {
                again |= self.store.grow_for(&self.gpu, &counters)?;
            }
            if !again {
                return Ok((variants, reruns));
            }
            self.store.readback.buffer().unmap();
            self.rebind = true;
            reruns += 1;
        }
    }

    fn counters(&self, count: usize, bytes: u64) -> Result<Vec<Counters>> {
        let view = self.store.readback.buffer().get_mapped_range(0..bytes);
        let view = view.map_err(|e| self.gpu.error(ErrorKind::DeviceLost, &e.to_string()))?;
        let answers = view.chunks(self.answer_bytes() as usize);
        Ok(self.frames[..count].iter().zip(answers).map(|(f, answer)| counters_of(answer, Readback::of(f))).collect())
    }

    fn submit_many(&mut self, count: usize) -> Result<Vec<Variants>> {
        let tables = &self.sensors[0].1;
        let frames = &self.frames[..count];
        let prepare = |frame| self.stages.prepare(&self.gpu, tables, frame, self.opened.1);
        let variants: Vec<Variants> = frames.iter().map(prepare).collect::<Result<_>>()?;
        self.bind();
        let frames = &self.frames[..count];
        let mut copies = vec![self.store.uploads.waiting()];
        for frame in frames {
            self.store.put(frame);
            copies.push(self.store.uploads.waiting() - copies.iter().sum::<usize>());
        }
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.store.uploads.write(&self.gpu)?;
        self.store.uploads.encode_some(&mut encoder, copies[0]);
        for (k, (frame, variants)) in frames.iter().zip(&variants).enumerate() {
            self.store.uploads.encode_some(&mut encoder, copies[k + 1]);
            self.stages.encode(&self.gpu, &mut encoder, variants, frame, &self.store);
            self.store.encode_readback(&mut encoder, frame, k as u64 * self.answer_bytes());
        }
        self.gpu.queue.submit([encoder.finish()]);
        self.placed = true;
        self.store.uploads.recall();
        Ok(variants)
    }
}
