//! Submissions: every frame is uploaded, drawn and read back here, alone, in pieces for a deadline, or with others.

use super::buffers::Answer;
use super::frame_buffers::Readback;
use super::layout::{self, Counters};
use super::part::Part;
use super::stages::Recording;
use super::testing::Hiding;
use super::uploads::{DrawMode, FrameUploads};
use super::visible::Visible;
use super::weigh::{self, Weigh};
use super::{GpuEngine, KnownSensor};
use presight_model::error::Result;
use presight_model::threads::Threads;
use presight_render::plan::{FramePlan, Images, KeySurface, Keys, SamplesMut, Weighing, resolve_keys};

/// What one submission does with the engine's first frames.
#[derive(Clone, Copy)]
pub(super) struct Submission<'a> {
    pub frames: usize,
    pub part: Part,
    /// The frames belong to a batch: no timestamps, and no frame reuses what the last one showed.
    pub batched: bool,
    /// The measured image to weigh instead of returning images, if the device resolves them.
    pub weighing: Option<&'a Weighing>,
}

impl Submission<'_> {
    /// One frame that belongs to no batch.
    pub fn single(part: Part) -> Self {
        Self { frames: 1, part, batched: false, weighing: None }
    }
}

impl GpuEngine {
    /// Computes the uploads of plans of one sensor, and makes room for each frame.
    pub(super) fn fill(&mut self, plans: &[&FramePlan], submission: &Submission<'_>) -> Result<()> {
        let Some(first) = plans.first() else { return Ok(()) };
        self.uploads.clear();
        self.take_sensor(&first.sensor)?;
        let meshes = plans.iter().flat_map(|plan| {
            let objects = plan.environment().objects();
            plan.instances.iter().map(|i| &objects[i.object as usize].mesh)
        });
        self.rebind |= self.arena.admit(&self.gpu, meshes)?;
        if self.frames.len() < plans.len() {
            self.frames.resize_with(plans.len(), FrameUploads::default);
        }
        let KnownSensor { tables, shown, .. } = &self.sensors[0];
        let probes =
            !submission.batched && self.opened.1.hiding == Hiding::WhereItPays && !self.known.contains(&tables.kind);
        let mode = if probes { DrawMode { hiding: Hiding::Always, ..self.mode() } } else { self.mode() };
        for (frame, plan) in self.frames.iter_mut().zip(plans) {
            frame.in_company = submission.batched || plan.limit.is_some();
            let last = (plan.reuse_visible && !frame.in_company).then_some(shown);
            // Slots keep stamps of earlier frames, so each frame needs a new one.
            frame.near.stamp = self.stamp;
            frame.fill(plan, tables, &self.arena, mode, last);
            self.stamp = frame.near.stamp;
            frame.sum_words = submission.weighing.filter(|_| !frame.on_host).map_or(0, weigh::sum_words);
            self.rebind |= self.store.reserve(&self.gpu, frame)?;
        }
        self.store.readback.reserve(&self.gpu, plans.len() as u64 * Readback::of(&self.frames[0]).bytes)?;
        if self.frames[0].on_host {
            self.threads = self.threads.started()?;
        }
        self.fill_weighing(submission)
    }

    /// Makes room for the measured image if the device weighs.
    fn fill_weighing(&mut self, submission: &Submission<'_>) -> Result<()> {
        let Some(weighing) = submission.weighing.filter(|_| self.frames[0].sum_words > 0) else { return Ok(()) };
        if self.weigh.is_none() {
            self.weigh = Some(Weigh::new(&self.gpu)?);
            self.rebind = true;
        }
        if let Some(weigh) = &mut self.weigh {
            self.rebind |= weigh.reserve(&self.gpu, weighing)?;
        }
        Ok(())
    }

    /// Draws the filled frames, again if they overflowed the buffers. Returns the answer and the number of reruns.
    pub(super) fn draw(&mut self, submission: &Submission<'_>) -> Result<(Answer, usize)> {
        let mut reruns = 0;
        loop {
            self.submit(submission)?;
            let bytes = submission.frames as u64 * self.answer_bytes(submission.part);
            let answer = self.store.readback.wait(&self.gpu, bytes)?;
            // The counters hold the full need even where buffers overflowed.
            let mut overflowed = false;
            for number in 0..submission.frames {
                let counters = self.counters(&answer, submission.part, number);
                overflowed |= self.store.grow_for(&self.gpu, &counters)?;
            }
            if !overflowed {
                return Ok((answer, reruns));
            }
            (0..submission.frames).for_each(|number| {
                self.count_groups(&self.counters(&answer, submission.part, number));
            });
            // The room is there now. Keys of earlier pieces stay: drawing a piece again changes nothing.
            self.rebind = true;
            reruns += 1;
        }
    }

    fn submit(&mut self, submission: &Submission<'_>) -> Result<()> {
        let frames = &self.frames[..submission.frames];
        let tables = &self.sensors[0].tables;
        frames.iter().try_for_each(|frame| self.stages.prepare(&self.gpu, tables, frame, self.opened.1))?;
        if self.rebind {
            self.stages.bind(&self.gpu, self.arena.buffer(), &self.store);
            self.visible.iter_mut().for_each(Visible::rebind);
            self.weigh.iter_mut().for_each(|weigh| weigh.bind(&self.gpu, self.store.outputs.buffer()));
            self.rebind = false;
        }
        if !self.placed {
            self.store.put_grid(&mut self.uploads, tables);
        }
        let weigh = self.weigh.as_ref().zip(submission.weighing).filter(|_| frames[0].sum_words > 0);
        if let Some((weigh, weighing)) = weigh {
            weigh.put(&mut self.uploads, weighing, &frames[0]);
        }
        self.uploads.end_part();
        for frame in frames {
            if submission.part.draws() {
                self.store.put(&mut self.uploads, frame);
            }
            self.uploads.end_part();
        }
        let bytes = self.answer_bytes(submission.part);
        let (gpu, stages, store) = (&self.gpu, &self.stages, &self.store);
        self.uploads.submit(gpu, |uploads, encoder| {
            uploads.encode(encoder, 0);
            for (number, frame) in frames.iter().enumerate() {
                uploads.encode(encoder, number + 1);
                stages.encode(encoder, submission.part, &mut Recording::new(gpu, tables, frame, store));
                weigh.iter().for_each(|(weigh, weighing)| weigh.encode(gpu, encoder, weighing));
                if submission.part.resolves() {
                    store.encode_readback(encoder, frame, number as u64 * bytes);
                } else {
                    store.encode_counters(encoder);
                }
            }
        })?;
        self.placed = true;
        Ok(())
    }

    /// Size of one frame's answer, bytes. It is the same for all frames of a sensor and a world.
    pub(super) fn answer_bytes(&self, part: Part) -> u64 {
        part.counters_and_end(&self.frames[0])[1]
    }

    /// The counters of a frame in a submission's answer.
    pub(super) fn counters(&self, answer: &[u8], part: Part, number: usize) -> Counters {
        let [at, bytes] = part.counters_and_end(&self.frames[number]);
        bytemuck::pod_read_unaligned(&answer[number * bytes as usize + at as usize..][..size_of::<Counters>()])
    }

    /// Adds the workgroups that the device dispatched indirectly.
    pub(super) fn count_groups(&self, counters: &Counters) {
        let of_last = counters.cull_groups + counters.setup_groups + counters.raster_groups;
        let second = if self.gpu.int64 { 0 } else { counters.all_raster_groups };
        let all = u64::from(counters.groups_before) + u64::from(of_last) + u64::from(second);
        self.gpu.done.workgroups.add_many(all);
    }

    fn mode(&self) -> DrawMode {
        DrawMode {
            software: self.software,
            in_two_passes: !self.gpu.int64,
            max_rendered: self.max_rendered(),
            hiding: self.opened.1.hiding,
        }
    }
}

impl FrameUploads {
    /// Converts the frame's own answer into images. Returns the number of hits without an id.
    pub fn take_images(&self, answer: &[u8], plan: &FramePlan, threads: &Threads, images: &mut Images) -> Result<u32> {
        let at = Readback::of(self);
        if !self.on_host {
            self.copy_images(answer, images);
            return Ok(0);
        }
        let (keys, slots) = answer[..at.counters as usize].split_at(at.slots as usize);
        let (p, slots): (_, &[layout::Slot]) = (&self.params, bytemuck::cast_slice(slots));
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
        threads.run(|| resolve_keys(&keys, &surface_of, images))
    }

    /// Copies the images that the device resolved.
    fn copy_images(&self, answer: &[u8], images: &mut Images) {
        let pixels = images.pixels() * 4;
        for (i, output) in self.outputs.iter().enumerate() {
            let from = &answer[i * pixels..][..pixels];
            match images.samples_mut(output) {
                SamplesMut::Floats(to) => bytemuck::cast_slice_mut(to).copy_from_slice(from),
                SamplesMut::Ids(to) => bytemuck::cast_slice_mut(to).copy_from_slice(from),
                // The plan computes normals on the CPU.
                SamplesMut::Vectors(_) => {}
            }
        }
    }
}
