//! Several frames of one sensor in one submission, for batches. The frames share the device buffers, and each has its
//! own part of the answer. A submission's fixed cost is paid once, and the device can weigh a measured image.

use super::GpuEngine;
use super::layout::Counters;
use super::part::Part;
use super::submission::Submission;
use super::weigh;
use presight_model::clock::Instant;
use presight_model::error::Result;
use presight_render::plan::{Drawn, FramePlan, Images, NOTHING_IN_VIEW, StageName, Stats, Weighing, Work};

/// Maximum size of the answers of a submission, bytes.
const MAX_BYTES: u64 = 64 << 20;
/// Maximum number of frames of a submission.
const MAX_FRAMES: u64 = 64;

/// Receives a plan's result. If anything was in view, also its index in the answer and its counters.
type HandOver<'a> = dyn FnMut(Drawn<'_>, Stats, Option<(usize, Counters)>) + 'a;

/// The device's answer to a submission.
#[derive(Clone, Copy, Default)]
struct Answered<'a> {
    bytes: &'a [u8],
    weighing: Option<&'a Weighing>,
}

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
        self.fill(&[first], &Submission { frames: 1, part: Part::Whole, batched: true, weighing })?;
        let count = (MAX_BYTES / self.answer_bytes(Part::Whole).max(1)).clamp(1, MAX_FRAMES);
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
        let mut shared = Stats::default();
        if drawn.is_empty() {
            return self
                .hand_over(plans, Answered::default(), images, shared, &mut |drawn, stats, _| each(drawn, stats));
        }
        plans.iter().try_for_each(|plan| plan.world_from_sensor.check())?;
        let batch = Submission { frames: drawn.len(), part: Part::Whole, batched: true, weighing };
        self.fill(&drawn, &batch)?;
        let (bytes, reruns) = self.draw(&batch)?;
        shared.stage(StageName::Device, start);
        (0..drawn.len()).for_each(|number| self.count_groups(&self.counters(&bytes, Part::Whole, number)));
        let work = self.gpu.work().since(before);
        let answered = Answered { bytes: &bytes, weighing };
        self.hand_over(plans, answered, images, shared, &mut |drawn, mut stats, on_device| {
            if let Some((number, counters)) = on_device {
                self.report(&self.frames[number], &counters, reruns, &mut stats);
                if number == 0 {
                    stats.work = Work { image_bytes: stats.work.image_bytes, ..work };
                }
            }
            each(drawn, stats);
        })
    }

    /// Extracts each plan's images or sums from the answer; the first plan reports `shared`.
    fn hand_over(
        &self,
        plans: &[FramePlan],
        answered: Answered<'_>,
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
                let frame = &self.frames[number];
                let own = &answered.bytes[number * self.answer_bytes(Part::Whole) as usize..];
                let mut counters = self.counters(answered.bytes, Part::Whole, number);
                if let Some(weighing) = answered.weighing.filter(|_| frame.sum_words > 0) {
                    let sums = weigh::sums_of(weighing, &own[..4 * frame.sum_words as usize]);
                    stats.take(StageName::WeighOnDevice, "no image was requested");
                    each(Drawn::Sums(&sums), stats, Some((number, counters)));
                    number += 1;
                    continue;
                }
                images.try_prepare(plan.sensor.width(), plan.sensor.height(), plan.drawn())?;
                counters.lost_ids += frame.take_images(own, plan, &self.threads, images)?;
                on_device = Some((number, counters));
                number += 1;
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
}
