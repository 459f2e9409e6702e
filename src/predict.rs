//! One call from a world, a sensor and a pose to images.

use crate::error::Result;
use crate::geometry::Pose;
use crate::plan::{FramePlan, Images, LeftOut, Request};
use crate::sensor::Sensor;
use crate::world::World;
use serde::Serialize;
use std::time::Instant;

/// Which engine predicts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// A hardware GPU if there is one, else the CPU engine.
    #[default]
    Auto,
    /// The CPU engine; never loads Vulkan.
    Cpu,
    /// wgpu on any adapter, a software one too.
    Gpu,
}

/// How a [`Predictor`] works.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Which engine.
    pub backend: Backend,
    /// CPU threads; 0 takes all cores.
    pub threads: usize,
}

/// What one prediction cost.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Stats {
    /// `cpu`, `gpu` or `reference`.
    pub engine: String,
    /// Adapter and driver, for the GPU engine.
    pub adapter: Option<String>,
    /// CPU threads.
    pub threads: usize,
    /// Milliseconds by stage, in order.
    pub stages_ms: Vec<(String, f64)>,
    /// Counts by name (polygons selected, set up, edge-on, ...), in order.
    pub counts: Vec<(String, u64)>,
    /// What was not needed, and why.
    pub left_out: Vec<LeftOut>,
    /// What the caller should know: a fallback taken, polygons edge-on.
    pub notices: Vec<String>,
}

impl Stats {
    /// Notes the time since `start` under a stage name.
    pub fn stage(&mut self, name: &str, start: Instant) {
        self.stages_ms.push((name.to_owned(), start.elapsed().as_secs_f64() * 1e3));
    }

    /// Notes a count.
    pub fn count(&mut self, name: &str, n: usize) {
        self.counts.push((name.to_owned(), n as u64));
    }
}

/// The images of one sensor at one pose, and what they cost.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// The sensor.
    pub sensor: Sensor,
    /// Its pose, body axes.
    pub world_from_sensor: Pose,
    /// The version of the world that was read.
    pub world_version: u64,
    /// The asked images.
    pub images: Images,
    /// What it cost.
    pub stats: Stats,
}

/// Predicts images with one engine, reusing its buffers from call to call.
pub struct Predictor {
    cpu: crate::cpu::Engine,
}

impl Predictor {
    /// Makes the engine ready.
    ///
    /// # Errors
    /// [`crate::ErrorKind::NoDevice`] if [`Backend::Gpu`] is asked for and no adapter is found.
    pub fn new(options: Options) -> Result<Self> {
        Ok(Self { cpu: crate::cpu::Engine::new(options.threads)? })
    }

    /// Predicts what a sensor sees; the pose is the sensor's in the world, body axes.
    ///
    /// # Errors
    /// The GPU engine's, typed; the CPU engine has none.
    pub fn predict(
        &mut self,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        request: &Request,
    ) -> Result<Prediction> {
        let start = Instant::now();
        let plan = FramePlan::new(world, sensor, world_from_sensor, request);
        let mut stats = Stats::default();
        stats.stage("selection", start);
        let mut images = Images::default();
        self.cpu.render(&plan, &mut images, &mut stats)?;
        stats.left_out = plan.left_out();
        Ok(Prediction {
            sensor: sensor.clone(),
            world_from_sensor: *world_from_sensor,
            world_version: world.version(),
            images,
            stats,
        })
    }
}
