//! One call from a world, a sensor and a pose to images.

use crate::cpu;
use crate::error::{Error, ErrorKind, Result};
use crate::geometry::Pose;
#[cfg(feature = "gpu")]
use crate::gpu;
use crate::plan::{FramePlan, Images, Output, Request, Stats};
use crate::sensor::Sensor;
use crate::world::World;
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
///
/// ```
/// use presight::{Backend, Environment, Options, Pose, Predictor, Request, World};
/// let world = World::new(Environment::new());
/// let sensor = presight::preset("laser-scanner")?;
/// let mut predictor = Predictor::new(Options { backend: Backend::Cpu, threads: 1 })?;
/// let prediction = predictor.predict(&world, &sensor, &Pose::IDENTITY, &Request::default())?;
/// assert!(prediction.images.range.iter().all(|r| *r == f32::INFINITY));
/// # Ok::<(), presight::Error>(())
/// ```
pub struct Predictor {
    #[cfg(feature = "gpu")]
    options: Options,
    engine: Engine,
    plan: Option<FramePlan>,
    /// Why the CPU engine took over, once it did.
    notice: Option<String>,
}

enum Engine {
    Cpu(cpu::Engine),
    #[cfg(feature = "gpu")]
    Gpu(Box<gpu::Engine>),
}

impl Predictor {
    /// Makes the engine ready.
    ///
    /// # Errors
    /// [`ErrorKind::NoDevice`] if [`Backend::Gpu`] is asked for and no adapter is found;
    /// [`ErrorKind::System`] if the CPU engine's threads cannot be started.
    pub fn new(options: Options) -> Result<Self> {
        let (engine, notice) = open(options)?;
        Ok(Self {
            #[cfg(feature = "gpu")]
            options,
            engine,
            plan: None,
            notice,
        })
    }

    /// `cpu`, or `gpu` with its adapter.
    pub fn engine_name(&self) -> String {
        match &self.engine {
            Engine::Cpu(_) => "cpu".into(),
            #[cfg(feature = "gpu")]
            Engine::Gpu(engine) => format!("gpu ({})", engine.adapter()),
        }
    }

    /// Predicts what a sensor sees; the pose is the sensor's in the world, body axes.
    ///
    /// # Errors
    /// As [`Predictor::predict_into`].
    pub fn predict(
        &mut self,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        request: &Request,
    ) -> Result<Prediction> {
        let mut images = Images::default();
        let stats = self.predict_into(world, sensor, world_from_sensor, request, &mut images)?;
        Ok(Prediction {
            sensor: sensor.clone(),
            world_from_sensor: *world_from_sensor,
            world_version: world.version(),
            images,
            stats,
        })
    }

    /// The same into the caller's images, which are reused from call to call.
    ///
    /// A lost GPU is opened again once; with [`Backend::Auto`] the CPU engine takes over where that fails, and
    /// [`Stats::notices`] says so.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] for `depth_z` of a sensor that is no camera; [`ErrorKind::DeviceLost`] and
    /// [`ErrorKind::DeviceMemory`] of a GPU that was asked for by name.
    pub fn predict_into(
        &mut self,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        request: &Request,
        images: &mut Images,
    ) -> Result<Stats> {
        if request.outputs.has(Output::DepthZ) && !sensor.is_camera() {
            return Err(Error::usage(
                format!("sensor {:?} is no camera and has no depth_z", sensor.spec().name),
                "ask for range",
            ));
        }
        let start = Instant::now();
        let plan = match self.plan.take() {
            Some(mut plan) => {
                plan.renew(world, sensor, world_from_sensor, request);
                plan
            }
            None => FramePlan::new(world, sensor, world_from_sensor, request),
        };
        let mut stats = Stats { index: world.index().scheme().name().to_owned(), ..Stats::default() };
        stats.stage("selection", start);
        let rendered = self.render(&plan, images, &mut stats);
        stats.left_out = plan.left_out();
        stats.notices.extend(self.notice.clone());
        self.plan = Some(plan);
        rendered.map(|()| stats)
    }

    fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        match &mut self.engine {
            Engine::Cpu(engine) => engine.render(plan, images, stats),
            #[cfg(feature = "gpu")]
            Engine::Gpu(engine) => {
                let selection = stats.clone();
                match engine.render(plan, images, stats) {
                    Ok(()) => Ok(()),
                    Err(lost) => {
                        *stats = selection;
                        self.recover(lost)?;
                        match &mut self.engine {
                            Engine::Cpu(engine) => engine.render(plan, images, stats),
                            Engine::Gpu(engine) => engine.render(plan, images, stats),
                        }
                    }
                }
            }
        }
    }

    /// Opens a lost device again, or, where the backend was ours to choose, goes on with the CPU engine.
    #[cfg(feature = "gpu")]
    fn recover(&mut self, error: Error) -> Result<()> {
        if error.kind() == ErrorKind::DeviceLost
            && let Ok((engine, None)) = open(self.options)
        {
            self.engine = engine;
            self.notice = Some(format!("the GPU was opened again after this: {error}"));
            return Ok(());
        }
        if self.options.backend != Backend::Auto {
            return Err(error);
        }
        self.engine = Engine::Cpu(cpu::Engine::new(self.options.threads)?);
        self.notice = Some(format!("the CPU engine took over: {error}"));
        Ok(())
    }

    /// Takes the device away, as a driver's reset would: for tests of what comes after.
    #[cfg(feature = "gpu")]
    #[doc(hidden)]
    pub fn lose_device(&self) {
        if let Engine::Gpu(engine) = &self.engine {
            engine.lose_device();
        }
    }
}

/// The engine of a backend, and what the caller should know of the choice.
fn open(options: Options) -> Result<(Engine, Option<String>)> {
    let on_cpu = || Ok(Engine::Cpu(cpu::Engine::new(options.threads)?));
    match options.backend {
        Backend::Cpu => Ok((on_cpu()?, None)),
        #[cfg(feature = "gpu")]
        Backend::Gpu => {
            let engine = gpu::Engine::new(gpu::DeviceOptions::default())?;
            Ok((Engine::Gpu(Box::new(engine)), None))
        }
        #[cfg(feature = "gpu")]
        Backend::Auto => {
            let hardware = gpu::DeviceOptions { hardware_only: true, ..Default::default() };
            match gpu::Engine::new(hardware) {
                Ok(engine) => Ok((Engine::Gpu(Box::new(engine)), None)),
                // No hardware GPU is the normal case on a robot's CI: nothing worth a notice.
                Err(e) if e.kind() == ErrorKind::NoDevice => Ok((on_cpu()?, None)),
                Err(e) => Ok((on_cpu()?, Some(format!("the CPU engine is used: {e}")))),
            }
        }
        #[cfg(not(feature = "gpu"))]
        Backend::Gpu => Err(Error::new(
            ErrorKind::NoDevice,
            "this presight was built without the GPU engine",
            "build it with the cargo feature `gpu`, or use --backend cpu",
        )),
        #[cfg(not(feature = "gpu"))]
        Backend::Auto => Ok((on_cpu()?, None)),
    }
}
