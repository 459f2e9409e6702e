//! The GPU engine, if this build has it. Outside of `gpu` only this file depends on that.

use super::Engine;
use presight_model::error::Result;
use presight_model::threads::Threads;
use presight_render::plan::Raster;

#[cfg(feature = "gpu")]
pub use with_gpu::{open_gpu, open_narrow_gpu};
#[cfg(not(feature = "gpu"))]
pub use without_gpu::{open_gpu, open_narrow_gpu};

#[cfg(not(feature = "gpu"))]
mod without_gpu {
    use super::*;
    use presight_model::error::{Error, ErrorKind};

    /// Says that this build has no GPU engine.
    ///
    /// # Errors
    /// Always [`ErrorKind::NoDevice`].
    pub fn open_gpu(_: &Threads, _hardware_only: bool, _: Raster) -> Result<Box<dyn Engine>> {
        Err(Error::new(
            ErrorKind::NoDevice,
            "this presight was built without the GPU engine",
            "build it with the cargo feature `gpu`, or use `Backend::Cpu`",
        ))
    }

    /// As `open_gpu`.
    ///
    /// # Errors
    /// Always [`ErrorKind::NoDevice`].
    pub fn open_narrow_gpu(threads: &Threads) -> Result<Box<dyn Engine>> {
        open_gpu(threads, false, Raster::Compute)
    }
}

#[cfg(feature = "gpu")]
mod with_gpu {
    use super::*;
    use crate::engine::Device;
    use crate::gpu::{self, DeviceOptions, testing};
    use presight_features::{BoxQuery, FeaturePrediction, FeatureSamples, OcclusionHint};
    use presight_render::deadline::DeadlineEngine;
    use presight_render::plan::{Drawn, FramePlan, Images, Stats, Weighing, Work};
    use presight_render::verify::Precision;

    /// Opens the most capable adapter, or only a hardware adapter on request.
    pub fn open_gpu(threads: &Threads, hardware_only: bool, raster: Raster) -> Result<Box<dyn Engine>> {
        let options = DeviceOptions { hardware_only, raster, ..DeviceOptions::default() };
        let engine = gpu::GpuEngine::new(options)?;
        Ok(Box::new(engine.with_threads(threads.clone())))
    }

    /// Opens it with 32-bit keys and every stage on the device.
    pub fn open_narrow_gpu(threads: &Threads) -> Result<Box<dyn Engine>> {
        let setup = testing::Setup { all_on_device: true, ..testing::Setup::default() };
        let engine = testing::open(DeviceOptions { without_int64: true, ..DeviceOptions::default() }, setup)?;
        Ok(Box::new(engine.with_threads(threads.clone())))
    }

    impl Engine for gpu::GpuEngine {
        fn name(&self) -> String {
            format!("gpu ({})", self.adapter())
        }

        fn precision(&self) -> Precision {
            Precision::F32
        }

        fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
            Self::render(self, plan, images, stats)
        }

        fn render_many(
            &mut self,
            plans: &[FramePlan],
            weighing: Option<&Weighing>,
            images: &mut Images,
            each: &mut dyn FnMut(Drawn<'_>, Stats),
        ) -> Result<()> {
            Self::render_many(self, plans, weighing, images, each)
        }

        fn with_deadline(&self) -> Option<DeadlineEngine> {
            Self::with_deadline(self)
        }

        fn device(&mut self) -> Option<&mut dyn Device> {
            Some(self)
        }
    }

    impl Device for gpu::GpuEngine {
        fn adapter(&self) -> String {
            Self::adapter(self).to_string()
        }

        fn raster(&self) -> Raster {
            Self::raster(self)
        }

        fn reopen(&mut self) -> Result<()> {
            Self::reopen(self)
        }

        fn take_compute(&mut self) -> Result<()> {
            Self::take_compute(self)
        }

        fn takes_features(&self) -> bool {
            Self::takes_features(self)
        }

        fn holds_images(&self) -> bool {
            self.holds_prediction()
        }

        fn query_occlusion(&mut self, samples: &FeatureSamples<'_>) -> Result<Vec<OcclusionHint>> {
            Self::query_occlusion(self, &gpu::OcclusionQuery::new(samples))
        }

        fn add_boxes(&mut self, prediction: &mut FeaturePrediction, query: &BoxQuery<'_>) -> Result<usize> {
            Self::add_boxes(self, prediction, query)
        }

        fn work(&self) -> Work {
            Self::work(self)
        }
    }
}
