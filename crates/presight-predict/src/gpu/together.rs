//! Several frames of one sensor in one submission, for batches. The frames share the device buffers, and each has its
//! own part of the answer. A submission's fixed cost is paid once, and the device can weigh a measured image.

use super::frame_buffers::Readback;
use super::layout::Counters;
use super::stages::Variants;
use super::uploads::FrameUploads;
use super::weigh::{self, Weigh};
use super::{GpuEngine, counters_of};
use presight_model::clock::Instant;
use presight_model::error::{ErrorKind, Result};
use presight_render::plan::{Drawn, FramePlan, Images, NOTHING_IN_VIEW, StageName, Stats, Weighing, Work};

/// Maximum size of the answers of a submission, bytes.
const MOST_BYTES: u64 = 64 << 20;
/// Maximum number of frames of a submission.
const MOST_FRAMES: u64 = 64;

/// Receives a plan's result. If anything was in view, also its index in the answer and its counters.
type HandOver<'a> = dyn FnMut(Drawn<'_>, Stats, Option<(usize, Counters)>) + 'a;

impl GpuEngine {
    /// Draws plans of one sensor and hands over their results in order: sums if the device weighed the frame (on
    /// hardware, with polygons in view), else images. Results handed over before an error are valid. Times and work of
    /// a submission are reported with its first frame.
    ///
    /// # Errors
    /// Same as [`GpuEngine::render`].
    pub fn render_many(
        &mut self,
        plans: &[FramePlan],
        weighing: Option<&Weighing>,
        images: &mut Images,
        each: &mut dyn FnMut(Drawn<'_>, Stats),
    ) -> Result<()> {
        let Some(first) = plans.first() else { return Ok(()) };
        self.drawn = false;
        self.gpu.check()?;
        // The length of an answer depends on sensor and world only.
        self.fill_frames(&[first], weighing)?;
        let count = (MOST_BYTES / Readback::of(&self.frames[0]).bytes.max(1)).clamp(1, MOST_FRAMES);
        plans.chunks(count as usize).try_for_each(|plans| self.render_some(plans, weighing, images, each))
    }

    fn render_some(
        &mut self,
        plans: &[FramePlan],
        weighing: Option<&Weighing>,
        images: &mut Images,
        each: &mut dyn FnMut(Drawn<'_>, Stats),
    ) -> Result<()> {
        let start = Instant::now();
        let before = self.gpu.work();
        let drawn: Vec<&FramePlan> = plans.iter().filter(|plan| plan.polygon_count > 0).collect();
        if !drawn.is_empty() {
            plans.iter().try_for_each(|plan| plan.world_from_sensor.check())?;
            self.store.uploads.clear();
            self.fill_frames(&drawn, weighing)?;
        }
        let bytes = drawn.len() as u64 * self.answer_bytes();
        let mut shared = Stats::default();
        if drawn.is_empty() {
            return self.hand_over(plans, (&[], None), images, shared, &mut |drawn, stats, _| each(drawn, stats));
        }
        let (variants, reruns) = self.draw(drawn.len(), weighing, bytes)?;
        shared.stage(StageName::Device, start);
        let buffer = self.store.readback.buffer().clone();
        let view = buffer.get_mapped_range(0..bytes);
        let view = view.map_err(|e| self.gpu.error(ErrorKind::DeviceLost, &e.to_string()))?;
        let handed = self.hand_over(plans, (&view, weighing), images, shared, &mut |drawn, mut stats, on_device| {
            if let Some((number, counters)) = on_device {
                self.gpu.done.workgroups.add_many(variants[number].indirect_groups(&counters));
                self.report(&self.frames[number], &counters, reruns, &mut stats);
                if number == 0 {
                    stats.work = Work { image_bytes: stats.work.image_bytes, ..self.gpu.work().since(before) };
                }
            }
            each(drawn, stats);
        });
        drop(view);
        buffer.unmap();
        handed
    }

    /// Extracts each plan's images or sums from the answer; the first plan reports `shared`.
    fn hand_over(
        &self,
        plans: &[FramePlan],
        (answer, weighing): (&[u8], Option<&Weighing>),
        images: &mut Images,
        mut shared: Stats,
        each: &mut HandOver<'_>,
    ) -> Result<()> {
        let mut number = 0;
        for plan in plans {
            let mut stats = std::mem::take(&mut shared);
            stats.engine = "gpu";
            stats.adapter = Some(self.gpu.adapter.to_string());
            let mut on_device = None;
            if plan.polygon_count > 0 {
                let (own, frame) = (&answer[number * self.answer_bytes() as usize..], &self.frames[number]);
                number += 1;
                if let Some(weighing) = weighing.filter(|_| frame.sum_words > 0) {
                    let sums = weigh::sums_of(weighing, &own[..4 * frame.sum_words as usize]);
                    stats.take(StageName::WeighOnDevice, "no image was requested");
                    each(Drawn::Sums(&sums), stats, Some((number - 1, counters_of(own, Readback::of(frame)))));
                    continue;
                }
                images.try_prepare(plan.sensor.width(), plan.sensor.height(), plan.drawn())?;
                on_device = Some((number - 1, self.take_answer(frame, own, plan, images)?));
            } else {
                images.try_prepare(plan.sensor.width(), plan.sensor.height(), plan.drawn())?;
                images.show_nothing(plan.sensor.grid());
                stats.leave_out(StageName::DrawingOnDevice, NOTHING_IN_VIEW);
            }
            plan.finish_noting(images, &mut stats)?;
            each(Drawn::Images(images), stats, on_device);
        }
        Ok(())
    }

    /// Size of one frame's answer, which is the same for all frames of a sensor and a world.
    fn answer_bytes(&self) -> u64 {
        self.frames.first().map_or(0, |frame| Readback::of(frame).bytes)
    }

    /// Prepares the uploads of plans, and makes room for each frame.
    fn fill_frames(&mut self, plans: &[&FramePlan], weighing: Option<&Weighing>) -> Result<()> {
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
            // Slots keep stamps of earlier frames, so each frame needs a new one.
            frame.near.stamp = self.frame.near.stamp;
            frame.fill(plan, &self.sensors[0].tables, &self.arena, way, None);
            frame.in_company = true;
            frame.sum_words = weighing.filter(|_| !frame.on_host).map_or(0, weigh::sum_words);
            self.frame.near.stamp = frame.near.stamp;
            self.rebind |= self.store.reserve(&self.gpu, frame)?;
        }
        if self.frames[0].on_host {
            self.threads = self.threads.started()?;
        }
        self.store.readback.reserve(&self.gpu, plans.len() as u64 * self.answer_bytes())?;
        if let Some(weighing) = weighing.filter(|_| self.frames[0].sum_words > 0) {
            if self.weigh.is_none() {
                self.weigh = Some(Weigh::new(&self.gpu)?);
                self.rebind = true;
            }
            if let Some(weigh) = &mut self.weigh {
                self.rebind |= weigh.reserve(&self.gpu, weighing)?;
            }
        }
        Ok(())
    }

    /// Draws the first `count` frames and maps their answers; repeats if one overflowed its buffers.
    fn draw(&mut self, count: usize, weighing: Option<&Weighing>, bytes: u64) -> Result<(Vec<Variants>, usize)> {
        let mut reruns = 0;
        loop {
            let variants = self.submit_many(count, weighing)?;
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

    fn submit_many(&mut self, count: usize, weighing: Option<&Weighing>) -> Result<Vec<Variants>> {
        let tables = &self.sensors[0].tables;
        let frames = &self.frames[..count];
        let prepare = |frame| self.stages.prepare(&self.gpu, tables, frame, self.opened.1);
        let variants: Vec<Variants> = frames.iter().map(prepare).collect::<Result<_>>()?;
        self.bind();
        let frames = &self.frames[..count];
        let weigh = self.weigh.as_ref().zip(weighing).filter(|_| frames[0].sum_words > 0);
        if let Some((weigh, weighing)) = weigh {
            weigh.put(&mut self.store.uploads, weighing, &frames[0]);
        }
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
            weigh.iter().for_each(|(weigh, weighing)| weigh.encode(&self.gpu, &mut encoder, weighing));
            self.store.encode_readback(&mut encoder, frame, k as u64 * self.answer_bytes());
        }
        self.gpu.queue.submit([encoder.finish()]);
        self.placed = true;
        self.store.uploads.recall();
        Ok(variants)
    }
}
