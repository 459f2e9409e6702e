//! Regions of interest on the device: roi.wgsl handles the linear case. The CPU twin `features::roi` finishes the
//! features that the shader flags as nonlinear, and replaces the stage on software adapters.

mod plan;

#[cfg(test)]
pub(super) use plan::MAX_POINTS;
pub(super) use plan::{RoiBox, RoiFeature, RoiParams, RoiPlan, RoiPoint};

use super::GpuEngine;
use super::buffers::{Answers, Growable, Uploads};
use super::device::Gpu;
use super::layout::{GridKind, groups_for};
use super::shaders;
use super::stage::{Binding, Stage, Variant};
use presight_features::roi::{Roi, RoiFlag};
use presight_features::{BoxFrame, BoxQuery, FeaturePrediction};
use presight_model::error::Result;
use presight_model::statistics::Tails;

/// `LINEAR` in roi.wgsl: the linear box is accurate.
pub(super) const LINEAR: u32 = 1;

/// The stage with its buffers, created when boxes are first requested.
pub(super) struct RoiStage {
    stage: Stage,
    plan: RoiPlan,
    params: Growable,
    features: Growable,
    points: Growable,
    columns: Growable,
    tails: Growable,
    boxes: Growable,
    readback: Answers,
    uploads: Uploads,
    /// True if the tail table is on the device.
    placed: bool,
    rebind: bool,
}

impl RoiStage {
    pub fn new(gpu: &Gpu) -> Self {
        use Binding::{Read, Uniform, Write};
        Self {
            stage: Stage::new(gpu, "roi", &[Uniform, Read, Read, Read, Read, Write]),
            plan: RoiPlan::default(),
            params: Growable::uniform(gpu, "roi params", size_of::<RoiParams>() as u64),
            features: Growable::storage(gpu, "roi features"),
            points: Growable::storage(gpu, "roi points"),
            columns: Growable::storage(gpu, "roi columns"),
            tails: Growable::storage(gpu, "roi tails"),
            boxes: Growable::storage(gpu, "roi boxes"),
            readback: Answers::new(gpu, "the boxes"),
            uploads: Uploads::new(gpu),
            placed: false,
            rebind: true,
        }
    }

    /// Makes room for the plan, creates the pipeline and collects the uploads.
    ///
    /// # Errors
    /// Errors of the device.
    fn prepare(&mut self, gpu: &Gpu, kind: GridKind) -> Result<()> {
        self.stage.prepare(gpu, Variant { kind, bits: 0 }, shaders::ROI, &[kind.constant()])?;
        let plan = &self.plan;
        let bytes = |count: usize, size: usize| (count * size) as u64;
        let of_boxes = bytes(plan.features.len(), size_of::<RoiBox>());
        let table = Tails::get().rows().as_flattened();
        self.rebind |= self.features.reserve(gpu, bytes(plan.features.len(), size_of::<RoiFeature>()))?;
        self.rebind |= self.points.reserve(gpu, bytes(plan.points.len(), size_of::<RoiPoint>()))?;
        self.rebind |= self.columns.reserve(gpu, bytes(plan.columns.len(), 16))?;
        self.rebind |= self.tails.reserve(gpu, bytes(table.len(), 4))?;
        self.rebind |= self.boxes.reserve(gpu, of_boxes)?;
        self.readback.reserve(gpu, of_boxes)?;
        if self.rebind {
            let buffers = [&self.params, &self.features, &self.points, &self.columns, &self.tails, &self.boxes];
            self.stage.bind(gpu, &buffers.map(Growable::buffer));
            self.rebind = false;
        }
        self.uploads.clear();
        if !self.placed {
            let table: Vec<f32> = table.iter().map(|x| *x as f32).collect();
            self.uploads.put(&self.tails, 0, bytemuck::cast_slice(&table));
        }
        self.uploads.put(&self.params, 0, bytemuck::bytes_of(&plan.params));
        self.uploads.put(&self.features, 0, bytemuck::cast_slice(&plan.features));
        self.uploads.put(&self.points, 0, bytemuck::cast_slice(&plan.points));
        self.uploads.put(&self.columns, 0, bytemuck::cast_slice(&plan.columns));
        self.uploads.end_part();
        Ok(())
    }

    /// Runs the stage and reads its answer: boxes in the plan's order.
    fn run(&mut self, gpu: &Gpu, kind: GridKind) -> Result<Vec<RoiBox>> {
        let bytes = (self.plan.features.len() * size_of::<RoiBox>()) as u64;
        if bytes == 0 {
            return Ok(Vec::new());
        }
        gpu.check()?;
        self.prepare(gpu, kind)?;
        let Self { uploads, stage, plan, boxes, readback, .. } = self;
        uploads.submit(gpu, |uploads, encoder| {
            uploads.encode(encoder, 0);
            let label = Some("roi");
            let mut pass = gpu.pass(encoder, &wgpu::ComputePassDescriptor { label, timestamp_writes: None });
            if stage.set(&mut pass, Variant { kind, bits: 0 }, 0) {
                gpu.dispatch(&mut pass, groups_for(plan.features.len() as u32));
            }
            drop(pass);
            encoder.copy_buffer_to_buffer(boxes.buffer(), 0, readback.buffer(), 0, bytes);
        })?;
        self.placed = true;
        Ok(bytemuck::pod_collect_to_vec(&self.readback.wait(gpu, bytes)?[..]))
    }
}

impl GpuEngine {
    /// Same as [`presight_features::add_boxes`], on the device. The CPU finishes features whose projection is nonlinear
    /// over their errors, and all features of lenses, ray tables and uneven beams. Returns the number of boxes the
    /// device made.
    ///
    /// # Errors
    /// [`presight_model::error::ErrorKind::Usage`] for a confidence outside 0.5..1;
    /// [`presight_model::ErrorKind::DeviceLost`] and [`presight_model::ErrorKind::DeviceMemory`] as in
    /// [`GpuEngine::render`], after which the CPU can make the boxes; the errors of [`presight_model::Threads::new`].
    pub fn add_boxes(&mut self, prediction: &mut FeaturePrediction, query: &BoxQuery<'_>) -> Result<usize> {
        let frame = BoxFrame::new(query)?;
        let stage = self.roi.get_or_insert_with(|| RoiStage::new(&self.gpu));
        let kind = stage.plan.fill(&frame, prediction, query.placed);
        let boxes = match kind {
            Some(kind) => stage.run(&self.gpu, kind)?,
            None => Vec::new(),
        };
        let mut beyond = stage.plan.on_host.clone();
        for (i, found) in stage.plan.on_device.iter().zip(&boxes) {
            let good = found.flag == LINEAR && found.bounds.iter().all(|x| x.is_finite());
            if good {
                let bounds = found.bounds.map(f64::from);
                frame.set(&mut prediction.features[*i as usize], Some(Roi { bounds, flag: RoiFlag::Linear }));
            } else {
                beyond.push(*i);
            }
        }
        self.threads = self.threads.started()?;
        self.threads.run(|| frame.finish(prediction, query.placed, &beyond))?;
        let count = stage.plan.on_device.len() + stage.plan.on_host.len();
        let made = count.saturating_sub(beyond.len());
        stage.plan.on_host = beyond;
        Ok(made)
    }
}
