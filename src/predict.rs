//! The predictor: from a world, a sensor and a pose to images and features.

use crate::cpu;
use crate::error::{Error, ErrorKind, Result};
#[cfg(feature = "gpu")]
use crate::features::Visibility;
use crate::features::{BoxOptions, FeatureOptions, FeaturePrediction, PlacedFeature, Prepared, add_boxes};
use crate::geometry::Pose;
#[cfg(feature = "gpu")]
use crate::gpu;
use crate::plan::{FramePlan, Images, Output, PlanBuffers, Request, Stats};
#[cfg(feature = "gpu")]
use crate::probe::{Probe, Task, Told};
use crate::sensor::Sensor;
use crate::threads::Threads;
use crate::world::World;
use std::time::Instant;

/// The engine that predicts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// A hardware GPU if there is one, else the CPU engine.
    #[default]
    Auto,
    /// The CPU engine; never loads Vulkan.
    Cpu,
    /// The GPU engine on any adapter, including software adapters.
    Gpu,
}

/// How a [`Predictor`] works.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// The engine to use.
    pub backend: Backend,
    /// CPU threads: a handle to share, or a number (`2.into()`), 0 for all cores.
    pub threads: Threads,
}

/// The images of one sensor at one pose, with statistics.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// The sensor.
    pub sensor: Sensor,
    /// Its pose, body axes.
    pub world_from_sensor: Pose,
    /// The version of the world that was used.
    pub world_version: u64,
    /// The requested images.
    pub images: Images,
    /// What the prediction did and cost.
    pub stats: Stats,
}

/// Predicts images with one engine, reusing its buffers from call to call.
///
/// ```
/// use presight::{Backend, Environment, Options, Pose, Predictor, Request, World};
/// let world = World::new(Environment::new());
/// let sensor = presight::preset("laser-scanner")?;
/// let mut predictor = Predictor::new(Options { backend: Backend::Cpu, threads: 1.into() })?;
/// let prediction = predictor.predict(&world, &sensor, &Pose::IDENTITY, &Request::default())?;
/// assert!(prediction.images.range.iter().all(|r| *r == f32::INFINITY));
/// # Ok::<(), presight::Error>(())
/// ```
pub struct Predictor {
    #[cfg(feature = "gpu")]
    options: Options,
    #[cfg(feature = "gpu")]
    opening: Opening,
    engine: Engine,
    /// Memory for the next plan. Not a plan: that would keep a version of the world, and its next change would copy it.
    buffers: PlanBuffers,
    #[cfg(feature = "gpu")]
    last: Option<LastFrame>,
    /// What befell the GPU, once something did.
    notice: Option<String>,
}

/// How a predictor opens the GPU; tests of its recovery open it otherwise.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Opening {
    /// [`Backend::Auto`] takes any adapter, too.
    pub any_adapter: bool,
    /// No more than so many bytes go into one buffer.
    pub largest_binding: Option<u64>,
    /// Nothing is found, as after a driver's crash.
    pub nothing: bool,
    /// Every stage runs on the device, even on a software adapter.
    pub all_on_device: bool,
    /// The device draws wrong, as with a driver at fault.
    pub wrong: bool,
}

enum Engine {
    Cpu(cpu::Engine),
    #[cfg(feature = "gpu")]
    Gpu(Box<gpu::Engine>, Proven),
}

/// What a device has shown, by kind of sensor: that its images are right, and how many of its regions.
#[cfg(feature = "gpu")]
#[derive(Default)]
struct Proven {
    images: Vec<Task>,
    regions: Vec<(Task, Told)>,
}

/// What the device drew last.
#[cfg(feature = "gpu")]
struct LastFrame {
    /// [`World::stamp`].
    world: u64,
    sensor: Sensor,
    world_from_sensor: Pose,
}

impl Predictor {
    /// Makes a predictor and opens its engine.
    ///
    /// # Errors
    /// [`ErrorKind::NoDevice`] for [`Backend::Gpu`] if no adapter is found;
    /// [`ErrorKind::System`] if the CPU engine's threads cannot be started.
    pub fn new(options: Options) -> Result<Self> {
        Self::opened(options, Opening::default())
    }

    /// [`Predictor::new`] with the GPU opened in a way of one's own.
    #[doc(hidden)]
    pub fn opened(options: Options, opening: Opening) -> Result<Self> {
        let on_cpu = || Ok(Engine::Cpu(cpu::Engine::new(options.threads.clone())?));
        let (engine, notice) = match options.backend {
            Backend::Cpu => (on_cpu()?, None),
            Backend::Gpu => (open_gpu(&options, opening)?, None),
            Backend::Auto => match open_gpu(&options, opening) {
                Ok(engine) => (engine, None),
                // No hardware GPU is the normal case on a robot's CI: nothing worth a notice.
                Err(e) if e.kind() == ErrorKind::NoDevice => (on_cpu()?, None),
                Err(e) => (on_cpu()?, Some(format!("the CPU engine is used: {e}"))),
            },
        };
        Ok(Self {
            #[cfg(feature = "gpu")]
            options,
            #[cfg(feature = "gpu")]
            opening,
            engine,
            buffers: PlanBuffers::default(),
            #[cfg(feature = "gpu")]
            last: None,
            notice,
        })
    }

    /// Name of the engine: `cpu`, or `gpu` with its adapter.
    pub fn engine_name(&self) -> String {
        match &self.engine {
            Engine::Cpu(_) => "cpu".into(),
            #[cfg(feature = "gpu")]
            Engine::Gpu(engine, _) => format!("gpu ({})", engine.adapter()),
        }
    }

    /// Predicts the images of a sensor at a pose: the sensor's pose in the world, body axes.
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

    /// As [`Predictor::predict`], into the caller's images, whose memory is reused.
    ///
    /// If the GPU is lost, it is opened again once per prediction. With [`Backend::Auto`] the CPU engine takes over if
    /// that fails, or if the device has too little memory. [`Stats::notices`] says so from then on.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] for `depth_z` of a sensor that is not a camera, and those of [`Pose::check`];
    /// [`ErrorKind::DeviceLost`] and [`ErrorKind::DeviceMemory`] with [`Backend::Gpu`].
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
        world_from_sensor.check()?;
        let start = Instant::now();
        let buffers = std::mem::take(&mut self.buffers);
        let plan = FramePlan::within(buffers, world, sensor, world_from_sensor, request)?;
        let mut stats = Stats { index: world.index().scheme().name().to_owned(), ..Stats::default() };
        stats.stage("selection", start);
        let rendered = self.render(&plan, images, &mut stats);
        let by_engine = std::mem::replace(&mut stats.left_out, plan.left_out());
        stats.left_out.extend(by_engine);
        plan.variants().iter().filter(|(_, taken, _)| *taken).for_each(|(what, _, why)| stats.take(*what, *why));
        stats.notices.extend(self.notice.clone());
        #[cfg(feature = "gpu")]
        {
            self.last =
                Some(LastFrame { world: world.stamp(), sensor: sensor.clone(), world_from_sensor: *world_from_sensor });
        }
        self.buffers = plan.into_buffers();
        rendered.map(|()| stats)
    }

    /// Predicts how much the sensor sees of features, from the images of a prediction of the same world, sensor and pose. It does
    /// the same as [`crate::features::predict_features`], on the predictor's own threads.
    ///
    /// If these images are from the predictor's last prediction and from a hardware GPU, part of the work runs on the device.
    ///
    /// # Errors
    /// As [`crate::features::predict_features`]; [`ErrorKind::DeviceLost`] and [`ErrorKind::DeviceMemory`] with
    /// [`Backend::Gpu`]; [`ErrorKind::System`] if threads cannot be started.
    #[expect(clippy::too_many_arguments, reason = "those of a prediction, its images, and where its cost is told")]
    pub fn predict_features(
        &mut self,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        images: &Images,
        placed: &[PlacedFeature],
        options: &FeatureOptions,
        stats: &mut Stats,
    ) -> Result<FeaturePrediction> {
        if placed.is_empty() {
            stats.leave_out("features", "there is none for this class");
        }
        #[cfg_attr(not(feature = "gpu"), expect(unused_mut, reason = "the device's part is told apart"))]
        let mut start = Instant::now();
        let prepared = Prepared::new(world, sensor, world_from_sensor, images, placed, options)?;
        #[cfg(feature = "gpu")]
        let told = if placed.is_empty() || options.visibility == Visibility::Rays {
            None
        } else {
            self.told(&prepared, world, sensor, world_from_sensor, placed, stats)?
        };
        #[cfg(feature = "gpu")]
        if told.is_some() {
            stats.stage("features on the device", start);
            start = Instant::now();
        }
        #[cfg(not(feature = "gpu"))]
        let told: Option<Vec<Vec<Option<u32>>>> = None;
        if placed.is_empty() {
            return Ok(prepared.finish(None));
        }
        self.tell_of_software("features on the device", stats);
        let prediction = self.on_threads(|| prepared.finish(told.as_deref()))?;
        stats.stage("features", start);
        for (name, n) in prediction.stats.counts() {
            stats.count(name, n);
        }
        Ok(prediction)
    }

    /// Adds regions of interest to predicted features. It does the same as [`crate::features::add_boxes`], on the predictor's own
    /// threads, or on the device if that is hardware.
    ///
    /// # Errors
    /// As [`crate::features::add_boxes`]; [`ErrorKind::DeviceLost`] and [`ErrorKind::DeviceMemory`] with [`Backend::Gpu`];
    /// [`ErrorKind::System`] if threads cannot be started.
    #[expect(clippy::too_many_arguments, reason = "those of a prediction, its features, and where its cost is told")]
    pub fn add_boxes(
        &mut self,
        prediction: &mut FeaturePrediction,
        placed: &[PlacedFeature],
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        options: &BoxOptions,
        stats: &mut Stats,
    ) -> Result<()> {
        if prediction.features.is_empty() {
            world_from_sensor.check()?;
            stats.leave_out("regions of interest", "there is no feature");
            return options.check();
        }
        let start = Instant::now();
        #[cfg(feature = "gpu")]
        if let Engine::Gpu(engine, proven) = &mut self.engine
            && engine.proposes()
        {
            let sound = prove_regions(engine, proven, sensor);
            let before = engine.work();
            let made =
                sound.and_then(|()| engine.add_boxes(prediction, placed, world, sensor, world_from_sensor, options));
            match made {
                Ok(made) => {
                    stats.work.add(engine.work().since(before));
                    stats.count("regions of interest made on the device", made);
                    stats.stage("regions of interest", start);
                    return Ok(());
                }
                // The CPU finds the same; the next prediction opens the device again.
                Err(e) if self.options.backend == Backend::Auto && e.kind() != ErrorKind::Usage => {}
                Err(e) => return Err(e),
            }
        }
        self.tell_of_software("regions of interest on the device", stats);
        self.on_threads(|| add_boxes(prediction, placed, world, sensor, world_from_sensor, options))??;
        stats.stage("regions of interest", start);
        Ok(())
    }

    /// Records that a stage stays on the CPU because the adapter is software.
    fn tell_of_software(&self, stage: &str, stats: &mut Stats) {
        #[cfg(not(feature = "gpu"))]
        let _ = (stage, stats);
        #[cfg(feature = "gpu")]
        if matches!(&self.engine, Engine::Gpu(engine, _) if !engine.proposes()) {
            stats.leave_out(stage, "done on the CPU: the adapter is a program on its own cores");
        }
    }

    /// Runs a function on the predictor's own threads.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if threads cannot be started.
    pub fn on_threads<R: Send>(&mut self, work: impl FnOnce() -> R + Send) -> Result<R> {
        match &mut self.engine {
            Engine::Cpu(engine) => Ok(engine.on_threads(work)),
            #[cfg(feature = "gpu")]
            Engine::Gpu(engine, _) => engine.on_threads(work),
        }
    }

    /// What the images on the device say of the samples of features; `None` if they are not there.
    #[cfg(feature = "gpu")]
    fn told(
        &mut self,
        prepared: &Prepared<'_>,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        placed: &[PlacedFeature],
        stats: &mut Stats,
    ) -> Result<Option<Vec<Vec<Option<u32>>>>> {
        let same = |last: &LastFrame| {
            last.world == world.stamp()
                && std::ptr::eq(last.sensor.grid(), sensor.grid())
                && last.world_from_sensor == *world_from_sensor
        };
        let there = matches!(&self.engine, Engine::Gpu(engine, _) if engine.proposes() && engine.holds_prediction());
        if !there || !self.last.as_ref().is_some_and(same) {
            return Ok(None);
        }
        let asking = self.on_threads(|| prepared.asking())?;
        if asking.iter().all(Vec::is_empty) {
            stats.leave_out("features on the device", "no sample is where only what is in between decides");
            return Ok(None);
        }
        let mut asked = gpu::Asked::new(asking.iter().map(Vec::len).sum(), sensor);
        for (samples, placed) in asking.iter().zip(placed) {
            asked.begin(&placed.slots);
            samples.iter().for_each(|(at, pixel)| asked.push(*at, *pixel));
        }
        let Engine::Gpu(engine, _) = &mut self.engine else { return Ok(None) };
        let before = engine.work();
        let proposals = match engine.propose(&asked) {
            Ok(proposals) => proposals,
            // The images at hand say the same; the next prediction opens the device again.
            Err(_) if self.options.backend == Backend::Auto => return Ok(None),
            Err(e) => return Err(e),
        };
        stats.work.add(engine.work().since(before));
        let seen = proposals.iter().filter(|p| **p == gpu::Proposal::Seen).count();
        let mut slots = proposals.iter().map(|p| match p {
            gpu::Proposal::Hidden(slot) => Some(*slot),
            _ => None,
        });
        let told: Vec<Vec<Option<u32>>> =
            asking.iter().map(|samples| slots.by_ref().take(samples.len()).collect()).collect();
        stats.count(
            "feature samples in doubt on the device",
            told.iter().flatten().filter(|t| t.is_none()).count() - seen,
        );
        Ok(Some(told))
    }

    fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        match &mut self.engine {
            Engine::Cpu(engine) => engine.render(plan, images, stats),
            #[cfg(feature = "gpu")]
            Engine::Gpu(..) => self.render_on_gpu(plan, images, stats),
        }
    }

    #[cfg(feature = "gpu")]
    fn render_on_gpu(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        let selection = stats.clone();
        let mut again = true;
        while let Engine::Gpu(engine, proven) = &mut self.engine {
            // Where nothing is drawn nothing has to be proven.
            let drawn = if plan.polygon_count == 0 { Ok(()) } else { prove(engine, proven, plan, self.opening.wrong) };
            let Err(fault) = drawn.and_then(|()| engine.render(plan, images, stats)) else { return Ok(()) };
            self.recover(fault, again)?;
            again = false;
            // Nothing of the attempt that failed is told.
            stats.clone_from(&selection);
        }
        self.render(plan, images, stats)
    }

    /// Opens a lost device again, if it may, or, where the backend was ours to choose, goes on with the CPU engine.
    #[cfg(feature = "gpu")]
    fn recover(&mut self, fault: Error, again: bool) -> Result<()> {
        if again
            && fault.kind() == ErrorKind::DeviceLost
            && let Ok(engine) = open_gpu(&self.options, self.opening)
        {
            self.engine = engine;
            self.notice = Some(format!("the GPU was opened again after this: {fault}"));
            return Ok(());
        }
        if self.options.backend != Backend::Auto {
            return Err(fault);
        }
        self.engine = Engine::Cpu(cpu::Engine::new(self.options.threads.clone())?);
        self.notice = Some(format!("the CPU engine took over: {fault}"));
        Ok(())
    }

    /// What the GPU engine has made on its device so far; `None` of the CPU engine.
    #[cfg(feature = "gpu")]
    pub fn made(&self) -> Option<gpu::Made> {
        match &self.engine {
            Engine::Cpu(_) => None,
            Engine::Gpu(engine, _) => Some(engine.made()),
        }
    }

    /// Changes how the GPU is opened when it has to be again.
    #[cfg(feature = "gpu")]
    #[doc(hidden)]
    pub fn set_opening(&mut self, opening: Opening) {
        self.opening = opening;
    }

    /// Takes the present device away when it is called, as a driver's reset would, from any thread and in the midst of a
    /// prediction, too: for tests of what comes after. Does nothing to the CPU engine.
    #[cfg(feature = "gpu")]
    #[doc(hidden)]
    pub fn device_loss(&self) -> impl Fn() + Send + use<> {
        let device = match &self.engine {
            Engine::Cpu(_) => None,
            Engine::Gpu(engine, _) => Some(engine.device_loss()),
        };
        move || device.iter().for_each(|lose| lose())
    }
}

/// No GPU engine was built.
#[cfg(not(feature = "gpu"))]
fn open_gpu(_: &Options, _: Opening) -> Result<Engine> {
    Err(Error::new(
        ErrorKind::NoDevice,
        "this presight was built without the GPU engine",
        "build it with the cargo feature `gpu`, or use --backend cpu",
    ))
}

/// The GPU engine: on hardware only, unless it was asked for by name.
#[cfg(feature = "gpu")]
fn open_gpu(options: &Options, opening: Opening) -> Result<Engine> {
    if opening.nothing {
        return Err(Error::new(ErrorKind::NoDevice, "no adapter was found", "use --backend cpu"));
    }
    let engine = gpu::Engine::new(gpu::DeviceOptions {
        hardware_only: options.backend == Backend::Auto && !opening.any_adapter,
        largest_binding: opening.largest_binding,
        all_on_device: opening.all_on_device,
        ..Default::default()
    })?;
    Ok(Engine::Gpu(Box::new(engine.with_threads(options.threads.clone())), Proven::default()))
}

/// Holds a device to the CPU before it makes regions of interest for a kind of sensor for the first time. What it says of
/// visibility needs no such proof: each answer is tested on the CPU.
#[cfg(feature = "gpu")]
fn prove_regions(engine: &mut gpu::Engine, proven: &mut Proven, sensor: &Sensor) -> Result<()> {
    let task = Task::of(sensor);
    let known = proven.regions.iter().find(|(of, _)| *of == task).map(|(_, told)| *told);
    let told = match known {
        Some(told) => told,
        None => {
            let told = Probe::new()?.regions(task, engine)?;
            proven.regions.push((task, told));
            told
        }
    };
    if told.wrong > 0 {
        let what = format!("{} makes {} of {} regions of a probe wrong", engine.adapter(), told.wrong, told.all);
        let remedy = "update its driver, or use --backend cpu; see presight doctor";
        return Err(Error::new(ErrorKind::NoDevice, what, remedy));
    }
    Ok(())
}

/// Holds a device to the reference on a tiny scene before it draws for a kind of sensor for the first time. The pipelines
/// that this makes are those of the prediction to come, so that it costs little besides.
#[cfg(feature = "gpu")]
fn prove(engine: &mut gpu::Engine, proven: &mut Proven, plan: &FramePlan, wrong: bool) -> Result<()> {
    let task = Task::of(&plan.sensor);
    if proven.images.contains(&task) {
        return Ok(());
    }
    let report = Probe::new()?.run(task, plan.drawn(), |plan, images| {
        engine.render(plan, images, &mut Stats::default())?;
        if wrong {
            images.range.iter_mut().for_each(|range| *range *= 1.01);
        }
        Ok(())
    })?;
    if let Some(first) = report.faults.first() {
        let (n, all) = (report.fault, report.pixels);
        let what = format!("{} draws {n} of {all} pixels of a probe wrong: {}", engine.adapter(), first.why);
        return Err(Error::new(
            ErrorKind::NoDevice,
            what,
            "update its driver, or use --backend cpu; see presight doctor",
        ));
    }
    proven.images.push(task);
    Ok(())
}
