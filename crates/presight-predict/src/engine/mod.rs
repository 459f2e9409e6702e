//! The interface of engines, and the list of all engines.

mod backend;

pub use backend::open_gpu;

use presight_features::{BoxQuery, FeaturePrediction, FeatureSamples, OcclusionHint};
use presight_model::clock::Instant;
use presight_model::error::Result;
use presight_model::threads::Threads;
use presight_render::cpu;
use presight_render::deadline::DeadlineEngine;
use presight_render::plan::{CountName, Drawn, FramePlan, Images, Raster, StageName, Stats, Weighing, Work};
use presight_render::reference;
use presight_render::verify::Precision;
use std::any::Any;

/// An engine: draws the images that a plan requests.
pub trait Engine: Any + Send {
    /// Name for messages: `reference`, `cpu`, or `gpu` with its adapter.
    fn name(&self) -> String;

    /// Precision of its arithmetic, which determines its error bounds.
    fn precision(&self) -> Precision;

    /// Fills the requested images and records statistics.
    ///
    /// # Errors
    /// The errors of [`presight_model::Pose::check`]; [`presight_model::ErrorKind::System`] or
    /// [`presight_model::ErrorKind::Invalid`] for too many images or polygons;
    /// [`presight_model::ErrorKind::DeviceLost`] or [`presight_model::ErrorKind::DeviceMemory`] from a device.
    fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()>;

    /// Draws plans of one sensor and hands over their images in order. An engine may weigh images itself and hand over
    /// sums instead. Results handed over before an error are valid.
    ///
    /// # Errors
    /// Same as [`Engine::render`].
    fn render_many(
        &mut self,
        plans: &[FramePlan],
        _weighing: Option<&Weighing>,
        images: &mut Images,
        each: &mut dyn FnMut(Drawn<'_>, Stats),
    ) -> Result<()> {
        for plan in plans {
            let mut stats = Stats::default();
            self.render(plan, images, &mut stats)?;
            each(Drawn::Images(images), stats);
        }
        Ok(())
    }

    /// True if it draws plans that select nothing, by tiles of rays.
    fn has_tiles(&self) -> bool {
        false
    }

    /// True if tiles would have to wait for trees that are not worth making yet.
    fn waits_for_trees(&self) -> bool {
        false
    }

    /// Returns an engine with equal images for one of many parallel tasks; it works only on the calling thread. `None`
    /// if the engine cannot have several instances.
    fn for_task(&self) -> Option<Box<dyn Engine>> {
        None
    }

    /// True if it draws plans by a cut of the world, see [`FramePlan::by_cut`].
    fn draws_cuts(&self) -> bool {
        false
    }

    /// Describes the engine for deadlines; `None` if it cannot stop by a plan's clock.
    fn with_deadline(&self) -> Option<DeadlineEngine> {
        None
    }

    /// The device that the engine uses, if any.
    fn device(&mut self) -> Option<&mut dyn Device> {
        None
    }
}

/// A device whose driver may be faulty, which may be lost, and which may process features.
pub trait Device {
    /// Name for messages.
    fn adapter(&self) -> String;

    /// Opens the device again after it was lost.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::NoDevice`] if it is gone.
    fn reopen(&mut self) -> Result<()>;

    /// The rasterizer for images of pinhole cameras.
    fn raster(&self) -> Raster {
        Raster::Compute
    }

    /// Opens the device again without the hardware rasterizer.
    ///
    /// # Errors
    /// Same as [`Device::reopen`].
    fn take_compute(&mut self) -> Result<()> {
        self.reopen()
    }

    /// False if features are better left to the CPU: a software adapter uses the same cores, with overhead.
    fn takes_features(&self) -> bool;

    /// True if it still holds the last rendered images.
    fn holds_images(&self) -> bool;

    /// Finds occluders of feature samples in the last rendered images, in the order of the samples.
    ///
    /// # Errors
    /// Same as [`Engine::render`].
    fn query_occlusion(&mut self, samples: &FeatureSamples<'_>) -> Result<Vec<OcclusionHint>>;

    /// `features::add_boxes` on the device. Returns how many boxes the device made; the CPU makes the others.
    ///
    /// # Errors
    /// Same as [`Engine::render`], and [`presight_model::ErrorKind::Usage`] for a confidence outside 0.5..1.
    fn add_boxes(&mut self, prediction: &mut FeaturePrediction, query: &BoxQuery<'_>) -> Result<usize>;

    /// Work done since it was opened.
    fn work(&self) -> Work;
}

presight_model::words! {
    /// The engines of presight, in the order of studies' tables.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub enum EngineKind {
        /// The simple f64 rasterizer that verifies the others.
        Reference = "reference",
        /// The CPU engine.
        Cpu = "cpu",
        /// The GPU engine on the most capable adapter, including software adapters.
        Gpu = "gpu",
        /// The GPU engine with the hardware rasterizer for pinhole cameras.
        GpuRender = "gpu-render",
        /// The GPU engine with 32-bit keys in two passes, every stage on the device.
        GpuNarrow = "gpu-32-bit",
    }
}

impl EngineKind {
    /// True if it needs a GPU adapter.
    pub fn needs_device(self) -> bool {
        matches!(self, Self::Gpu | Self::GpuRender | Self::GpuNarrow)
    }

    /// Opens the engine; these threads do its CPU work.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::NoDevice`] without an adapter, or in a build without the GPU engine;
    /// [`presight_model::ErrorKind::System`] if threads cannot be started.
    pub fn open(self, threads: &Threads) -> Result<Box<dyn Engine>> {
        match self {
            Self::Reference => Ok(Box::new(Reference { threads: threads.clone() })),
            Self::Cpu => Ok(Box::new(cpu::CpuEngine::new(threads.clone())?)),
            Self::Gpu => open_gpu(threads, false, Raster::Compute),
            Self::GpuRender => open_gpu(threads, false, Raster::Render),
            Self::GpuNarrow => backend::open_narrow_gpu(threads),
        }
    }
}

/// The reference as an engine. It tests every polygon and ignores the plan's selection.
struct Reference {
    threads: Threads,
}

impl Engine for Reference {
    fn name(&self) -> String {
        "reference".into()
    }

    fn precision(&self) -> Precision {
        Precision::F64
    }

    fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        let start = Instant::now();
        let counts = self.threads.run(|| reference::render(plan, images))??;
        stats.engine = "reference";
        stats.stage(StageName::Reference, start);
        stats.count(CountName::PolygonsTested, counts.polygons);
        stats.count(CountName::PolygonsEdgeOn, counts.edge_on);
        Ok(())
    }
}

impl Engine for cpu::CpuEngine {
    fn name(&self) -> String {
        "cpu".into()
    }

    fn precision(&self) -> Precision {
        Precision::F64
    }

    fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        Self::render(self, plan, images, stats)
    }

    fn has_tiles(&self) -> bool {
        true
    }

    fn waits_for_trees(&self) -> bool {
        Self::waits_for_trees(self)
    }

    fn for_task(&self) -> Option<Box<dyn Engine>> {
        Some(Box::new(self.on_one_thread()))
    }

    fn draws_cuts(&self) -> bool {
        true
    }

    fn with_deadline(&self) -> Option<DeadlineEngine> {
        Some(DeadlineEngine { name: "cpu", adapter: None, threads: self.threads(), draws_parts: true })
    }
}

/// Adds regions of interest on the engine's device or, without one, on these threads. Returns how many boxes the device
/// made; `None` if no device was used.
///
/// # Errors
/// Same as [`Device::add_boxes`].
pub fn add_boxes(
    engine: &mut dyn Engine,
    threads: &Threads,
    prediction: &mut FeaturePrediction,
    query: &BoxQuery<'_>,
) -> Result<Option<usize>> {
    match engine.device().filter(|device| device.takes_features()) {
        Some(device) => device.add_boxes(prediction, query).map(Some),
        None => {
            let add = || presight_features::add_boxes(prediction, query);
            threads.run(add)??;
            Ok(None)
        }
    }
}
