//! Faulty engines, which wrap the GPU engine on any available adapter.

use presight_features::{BoxQuery, FeaturePrediction, FeatureSamples, OcclusionHint};
use presight_model::error::{Error, ErrorKind, Result};
use presight_predict::engine::{Device, Engine};
use presight_predict::gpu;
use presight_predict::gpu::DeviceOptions;
use presight_predict::gpu::testing;
use presight_predict::gpu::testing::Setup;
use presight_render::plan::{FramePlan, Images, Raster, Stats, Work};
use presight_render::verify::Precision;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// Switches by which a test controls a faulty engine inside a predictor.
#[derive(Clone)]
pub struct Switches {
    /// True if no adapter is found, as after a driver crash.
    pub gone: Arc<AtomicBool>,
    loss: Arc<Mutex<Box<dyn Fn() + Send>>>,
}

impl Switches {
    /// Loses the current device.
    pub fn lose(&self) {
        self.loss.lock().unwrap()();
    }

    /// Sets whether no adapter is found.
    pub fn set_gone(&self, gone: bool) {
        self.gone.store(gone, Ordering::Relaxed);
    }
}

/// The GPU engine with optional faults: wrong images, and a device that can be lost permanently.
pub struct Faulty {
    engine: gpu::GpuEngine,
    wrong: bool,
    /// True if only images of the hardware rasterizer are wrong.
    of_render: bool,
    switches: Switches,
}

impl Faulty {
    /// An engine that draws correctly, or with `wrong` makes every range 1 % too long.
    pub fn new(setup: Setup, wrong: bool) -> Result<(Self, Switches)> {
        Self::open(Raster::Compute, setup, wrong)
    }

    /// As [`Faulty::new`] with the hardware rasterizer. Images of compute spans are always correct.
    pub fn with_render(wrong: bool) -> Result<(Self, Switches)> {
        Self::open(Raster::Render, Setup::default(), wrong)
    }

    fn open(raster: Raster, setup: Setup, wrong: bool) -> Result<(Self, Switches)> {
        let engine = testing::open(DeviceOptions { raster, ..DeviceOptions::default() }, setup)?.with_threads(1);
        let of_render = raster == Raster::Render;
        let loss: Box<dyn Fn() + Send> = Box::new(testing::device_loss(&engine));
        let switches = Switches { gone: Arc::default(), loss: Arc::new(Mutex::new(loss)) };
        Ok((Self { engine, wrong, of_render, switches: switches.clone() }, switches))
    }
}

impl Engine for Faulty {
    fn name(&self) -> String {
        Engine::name(&self.engine)
    }

    fn precision(&self) -> Precision {
        self.engine.precision()
    }

    fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        self.engine.render(plan, images, stats)?;
        if self.wrong && (!self.of_render || self.engine.raster() == Raster::Render) {
            images.range.iter_mut().for_each(|range| *range *= 1.01);
        }
        Ok(())
    }

    fn device(&mut self) -> Option<&mut dyn Device> {
        Some(self)
    }
}

impl Device for Faulty {
    fn adapter(&self) -> String {
        self.engine.adapter().to_string()
    }

    fn reopen(&mut self) -> Result<()> {
        if self.switches.gone.load(Ordering::Relaxed) {
            return Err(Error::new(ErrorKind::NoDevice, "no adapter was found", "use --backend cpu"));
        }
        self.engine.reopen()?;
        *self.switches.loss.lock().unwrap() = Box::new(testing::device_loss(&self.engine));
        Ok(())
    }

    fn raster(&self) -> Raster {
        self.engine.raster()
    }

    fn take_compute(&mut self) -> Result<()> {
        if self.switches.gone.load(Ordering::Relaxed) {
            return self.reopen();
        }
        Device::take_compute(&mut self.engine)?;
        *self.switches.loss.lock().unwrap() = Box::new(testing::device_loss(&self.engine));
        Ok(())
    }

    fn takes_features(&self) -> bool {
        self.engine.takes_features()
    }

    fn holds_images(&self) -> bool {
        self.engine.holds_images()
    }

    fn query_occlusion(&mut self, samples: &FeatureSamples<'_>) -> Result<Vec<OcclusionHint>> {
        Device::query_occlusion(&mut self.engine, samples)
    }

    fn add_boxes(&mut self, prediction: &mut FeaturePrediction, query: &BoxQuery<'_>) -> Result<usize> {
        self.engine.add_boxes(prediction, query)
    }

    fn work(&self) -> Work {
        Device::work(&self.engine)
    }
}
