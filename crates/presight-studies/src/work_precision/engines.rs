//! The engines of a study, and the names of paths.

use super::how;
use super::path::{EnginePath, Path, PathName};
use super::views::ImageVariant;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::sensor::Sensor;
use presight_predict::predict::{Backend, Options, Predictor};

/// The engines, opened once for a study.
pub(super) struct Engines {
    all: Vec<(EnginePath, Predictor)>,
    gpu_keys: &'static str,
    /// True if the adapter is a hardware GPU.
    hardware: bool,
    adapter: String,
    threads: usize,
}

impl Engines {
    /// Opens all available engines. A missing GPU is not an error. Software adapters such as lavapipe are used too.
    pub fn open() -> Result<Self> {
        let (mut all, mut missing) = (Vec::new(), None);
        for which in
            [EnginePath::Reference, EnginePath::CpuOne, EnginePath::CpuAll, EnginePath::Gpu, EnginePath::GpuNarrow]
        {
            let (kind, threads) = which.engine();
            match kind.open(&threads) {
                Ok(engine) => {
                    let backend = if kind.needs_device() { Backend::Gpu } else { Backend::Cpu };
                    all.push((which, Predictor::with_engine(Options::new(backend).with_threads(threads), engine)));
                }
                Err(e) if e.kind() == ErrorKind::NoDevice => missing = Some(e),
                Err(e) => return Err(e),
            }
        }
        let (gpu_keys, hardware, adapter) = match missing {
            Some(e) => ("", false, format!("none: {}; presight doctor says what to install", e.what())),
            None => about_gpu(&all),
        };
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Ok(Self { all, gpu_keys, hardware, adapter, threads })
    }

    /// The engine that a user gets by default (`--backend auto`).
    pub fn default(&self) -> EnginePath {
        if self.hardware { EnginePath::Gpu } else { EnginePath::CpuAll }
    }

    pub fn has_gpu(&self) -> bool {
        self.all.iter().any(|(which, _)| *which == EnginePath::Gpu)
    }

    /// Adapter and driver, or why there is none.
    pub fn adapter(&self) -> String {
        self.adapter.clone()
    }

    /// The threads or keys of an engine, as part of a path's name.
    fn manner(&self, which: EnginePath) -> String {
        match which {
            EnginePath::CpuOne => "1 thread".into(),
            EnginePath::Reference | EnginePath::CpuAll => format!("all {} threads", self.threads),
            EnginePath::Gpu => self.gpu_keys.into(),
            EnginePath::GpuNarrow => "32-bit keys".into(),
        }
    }

    /// The predictor of an engine.
    pub fn predictor(&mut self, which: EnginePath) -> Result<&mut Predictor> {
        let found = self.all.iter_mut().find(|(of, _)| *of == which).map(|(_, predictor)| predictor);
        found.ok_or_else(|| Error::new(ErrorKind::NoDevice, "there is no GPU", "leave it out"))
    }
}

/// The keys of the GPU engine, whether its adapter is hardware, and the adapter's name.
#[cfg(feature = "gpu")]
fn about_gpu(all: &[(EnginePath, Predictor)]) -> (&'static str, bool, String) {
    let gpu = all.iter().find(|(which, _)| *which == EnginePath::Gpu);
    let engine =
        gpu.and_then(|(_, p)| (p.engine() as &dyn std::any::Any).downcast_ref::<presight_predict::gpu::GpuEngine>());
    engine.map_or_else(Default::default, |engine| {
        let keys = if engine.abilities().int64_atomics { "64-bit keys" } else { "its 32-bit keys" };
        (keys, engine.adapter().hardware, engine.adapter().to_string())
    })
}

#[cfg(not(feature = "gpu"))]
fn about_gpu(_: &[(EnginePath, Predictor)]) -> (&'static str, bool, String) {
    Default::default()
}

impl Path {
    /// The names of the path for a sensor.
    pub fn named(&self, engines: &Engines, sensor: &Sensor) -> PathName {
        let (engine, manner) = (self.engine(), engines.manner(self.which));
        let index = self.index.map(|s| format!(", index {}", s.name())).unwrap_or_default();
        let others = if self.index.is_some() { ", other indexes" } else { "" };
        PathName {
            engine,
            variant: format!("{manner}{}{index}", self.view.name()),
            how: how::of_image(self, sensor),
            default: self.which == engines.default() && self.view == ImageVariant::Whole && self.index.is_none(),
            family: format!("{engine}, {manner}{others}"),
            label: self.view.label().to_owned(),
        }
    }
}
