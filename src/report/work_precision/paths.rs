//! Every path of the product from a scene to an image.

use super::views::View;
use super::{how, precision_of, request};
use crate::compare::Precision;
use crate::error::{Error, ErrorKind, Result};
use crate::geometry::Pose;
use crate::index::Scheme;
use crate::plan::{FramePlan, Images, Stats};
use crate::predict::{Backend, Options, Predictor};
use crate::reference;
use crate::sensor::Sensor;
use crate::world::World;
use std::time::Instant;

/// Who draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Which {
    /// The reference, on all cores.
    Reference,
    /// The CPU engine on one thread.
    CpuOne,
    /// The CPU engine on all cores.
    CpuAll,
    /// The GPU engine as it opens: 64-bit keys where the device has them.
    Gpu,
    /// The GPU engine with keys of 32 bits, in two passes.
    GpuNarrow,
}

/// A path as tables, charts and advice name it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Named {
    /// `reference`, `cpu` or `gpu`.
    pub engine: &'static str,
    /// What tells it from the engine's other paths.
    pub variant: String,
    /// How a user takes it.
    pub how: String,
    /// The one that a user gets who asks for nothing else.
    pub default: bool,
    /// In charts: whose mark it bears.
    pub family: String,
    /// In charts: the text beside it.
    pub label: String,
}

/// One path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Path {
    pub which: Which,
    pub view: View,
    /// An index other than the default.
    pub index: Option<Scheme>,
}

impl Path {
    /// All of them.
    pub fn all(gpu: bool) -> Vec<Self> {
        let path = |which, view| Self { which, view, index: None };
        let views = [View::Whole, View::Rays, View::Reduced(2), View::Reduced(4), View::Region];
        let mut all = vec![path(Which::Reference, View::Whole)];
        all.extend([View::Whole, View::Rays].map(|view| path(Which::CpuOne, view)));
        all.extend(views.map(|view| path(Which::CpuAll, view)));
        let others = Scheme::ALL.into_iter().filter(|s| *s != Scheme::default());
        all.extend(others.map(|s| Self { index: Some(s), ..path(Which::CpuAll, View::Whole) }));
        if gpu {
            all.extend(views.map(|view| path(Which::Gpu, view)));
            all.push(path(Which::GpuNarrow, View::Whole));
        }
        all
    }

    /// As the files name the engine.
    pub fn engine(&self) -> &'static str {
        match self.which {
            Which::Reference => "reference",
            Which::CpuOne | Which::CpuAll => "cpu",
            Which::Gpu | Which::GpuNarrow => "gpu",
        }
    }

    /// Its names for a sensor.
    pub fn named(&self, engines: &Engines, sensor: &Sensor) -> Named {
        let (engine, manner) = (self.engine(), engines.manner(self.which));
        let index = self.index.map(|s| format!(", index {}", s.name())).unwrap_or_default();
        let others = if self.index.is_some() { ", other indexes" } else { "" };
        Named {
            engine,
            variant: format!("{manner}{}{index}", self.view.name()),
            how: how::of_image(self, sensor),
            default: self.which == engines.default() && self.view == View::Whole && self.index.is_none(),
            family: format!("{engine}, {manner}{others}"),
            label: self.view.label().to_owned(),
        }
    }

    pub fn precision(&self) -> Precision {
        precision_of(self.engine() == "gpu")
    }
}

/// The engines, opened once for a study.
pub(super) struct Engines {
    reference: Drawer,
    cpu_one: Drawer,
    cpu_all: Drawer,
    gpu: Option<(Drawer, Drawer)>,
    gpu_keys: &'static str,
    /// The adapter is a real GPU.
    hardware: bool,
    adapter: String,
    threads: usize,
}

impl Engines {
    /// Opens what there is; a GPU that is not there is no error, lavapipe counts as one.
    pub fn open() -> Result<Self> {
        let cpu =
            |threads: usize| Predictor::new(Options { backend: Backend::Cpu, threads: threads.into() }).map(Box::new);
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let (gpu, gpu_keys, hardware, adapter) = match open_gpu() {
            Ok(gpu) => (Some(gpu.drawers), gpu.keys, gpu.hardware, gpu.adapter),
            Err(e) if e.kind() == ErrorKind::NoDevice => {
                (None, "", false, format!("none: {}; presight doctor says what to install", e.what()))
            }
            Err(e) => return Err(e),
        };
        Ok(Self {
            reference: Drawer::Reference,
            cpu_one: Drawer::Predictor(cpu(1)?),
            cpu_all: Drawer::Predictor(cpu(0)?),
            gpu,
            gpu_keys,
            hardware,
            adapter,
            threads,
        })
    }

    /// Who draws where a user chooses nothing (`--backend auto`).
    pub fn default(&self) -> Which {
        if self.hardware { Which::Gpu } else { Which::CpuAll }
    }

    pub fn has_gpu(&self) -> bool {
        self.gpu.is_some()
    }

    /// Adapter and driver, or why there is none.
    pub fn adapter(&self) -> String {
        self.adapter.clone()
    }

    /// How an engine runs.
    fn manner(&self, which: Which) -> String {
        match which {
            Which::CpuOne => "1 thread".into(),
            Which::Reference | Which::CpuAll => format!("all {} threads", self.threads),
            Which::Gpu => self.gpu_keys.into(),
            Which::GpuNarrow => "32-bit keys".into(),
        }
    }

    pub fn drawer(&mut self, which: Which) -> Result<&mut Drawer> {
        let no_gpu = || Error::new(ErrorKind::NoDevice, "there is no GPU", "leave it out");
        Ok(match which {
            Which::Reference => &mut self.reference,
            Which::CpuOne => &mut self.cpu_one,
            Which::CpuAll => &mut self.cpu_all,
            Which::Gpu => &mut self.gpu.as_mut().ok_or_else(no_gpu)?.0,
            Which::GpuNarrow => &mut self.gpu.as_mut().ok_or_else(no_gpu)?.1,
        })
    }

    /// The predictor of an engine that a user gets: for features.
    pub fn predictor(&mut self, which: Which) -> Result<&mut Predictor> {
        match self.drawer(which)? {
            Drawer::Predictor(predictor) => Ok(predictor),
            _ => Err(Error::invalid("only predictors look at features", "take another path")),
        }
    }
}

/// A GPU, both ways to use it, and how the first keeps its nearest surfaces.
struct OpenedGpu {
    drawers: (Drawer, Drawer),
    keys: &'static str,
    hardware: bool,
    adapter: String,
}

#[cfg(feature = "gpu")]
fn open_gpu() -> Result<OpenedGpu> {
    use crate::gpu::{DeviceOptions, Engine};
    let engine = Engine::new(DeviceOptions::default())?;
    let (wide, hardware) = (engine.abilities().int64_atomics, engine.adapter().hardware);
    let adapter = engine.adapter().to_string();
    drop(engine);
    let predictor = Predictor::new(Options { backend: Backend::Gpu, ..Options::default() })?;
    let narrow = Engine::new(DeviceOptions { without_int64: true, ..DeviceOptions::default() })?;
    let keys = if wide { "64-bit keys" } else { "its 32-bit keys" };
    let drawers = (Drawer::Predictor(Box::new(predictor)), Drawer::Narrow(Box::new(narrow)));
    Ok(OpenedGpu { drawers, keys, hardware, adapter })
}

#[cfg(not(feature = "gpu"))]
fn open_gpu() -> Result<OpenedGpu> {
    let remedy = "build it with the cargo feature `gpu`";
    Err(Error::new(ErrorKind::NoDevice, "this presight was built without the GPU engine", remedy))
}

/// What draws an image.
pub(super) enum Drawer {
    Reference,
    Predictor(Box<Predictor>),
    #[cfg(feature = "gpu")]
    Narrow(Box<crate::gpu::Engine>),
}

impl Drawer {
    /// A prediction, selection included, with all images in memory at the end.
    pub fn draw(&mut self, world: &World, sensor: &Sensor, pose: &Pose, images: &mut Images) -> Result<Stats> {
        let mut stats = Stats { index: world.index().scheme().name().to_owned(), ..Stats::default() };
        let start = Instant::now();
        let plan = |stats: &mut Stats| {
            let plan = FramePlan::new(world, sensor, pose, &request())?;
            stats.stage("selection", start);
            stats.left_out = plan.left_out();
            Ok::<_, Error>(plan)
        };
        match self {
            Self::Predictor(predictor) => return predictor.predict_into(world, sensor, pose, &request(), images),
            Self::Reference => {
                let plan = plan(&mut stats)?;
                // It looks at everything, whatever was selected.
                stats.left_out.clear();
                let start = Instant::now();
                let counts = reference::render(&plan, images)?;
                stats.engine = "reference".into();
                stats.stage("reference", start);
                stats.count("polygons tested", counts.polygons);
            }
            #[cfg(feature = "gpu")]
            Self::Narrow(engine) => engine.render(&plan(&mut stats)?, images, &mut stats)?,
        }
        Ok(stats)
    }
}
