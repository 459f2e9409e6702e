//! The predictor: from a world, a sensor and a pose to images and features.

use crate::cpu;
use crate::engine::{self, Device, Engine};
use crate::error::{Error, ErrorKind, Result};
use crate::features::{
    BoxOptions, FeatureOptions, FeaturePrediction, FeatureSamples, OcclusionHint, PlacedFeature, Prepared, Visibility,
};
use crate::geometry::Pose;
use crate::plan::{FramePlan, Images, Output, PlanBuffers, Request, Stats};
use crate::probe::{Probe, Task, Told};
use crate::row::RowCuts;
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
    backend: Backend,
    /// Work that no engine does runs here.
    threads: Threads,
    engine: Box<dyn Engine>,
    /// What the engine's device was found able to do.
    proven: Proven,
    /// Memory for the next plan. Not a plan: that would keep a version of the world, and its next change would copy it.
    buffers: PlanBuffers,
    last: Option<LastFrame>,
    /// What happened to the GPU, if something did.
    notice: Option<String>,
    row_cuts: RowCuts,
}

/// What a device has shown, by kind of sensor: that its images are right, and how many of its regions.
#[derive(Default)]
struct Proven {
    images: Vec<Task>,
    regions: Vec<(Task, Told)>,
}

/// What the engine drew last.
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
        let (engine, notice) = choose_engine(options.backend, &options.threads, engine::open_gpu)?;
        Ok(Self { notice, ..Self::with_engine(options, engine) })
    }

    /// Makes a predictor of an engine that is open already. With [`Backend::Auto`] the CPU engine takes over if that one's
    /// device fails.
    #[doc(hidden)]
    pub fn with_engine(options: Options, engine: Box<dyn Engine>) -> Self {
        Self {
            backend: options.backend,
            threads: options.threads,
            engine,
            proven: Proven::default(),
            buffers: PlanBuffers::default(),
            last: None,
            notice: None,
            row_cuts: RowCuts::default(),
        }
    }

    /// The engine.
    #[doc(hidden)]
    pub fn engine(&self) -> &dyn Engine {
        &*self.engine
    }

    /// The threads for tasks of batches, running.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if they cannot be started.
    pub(crate) fn task_threads(&mut self) -> Result<Threads> {
        self.threads = self.threads.started()?;
        Ok(self.threads.clone())
    }

    pub(crate) fn row_cuts(&self) -> &RowCuts {
        &self.row_cuts
    }

    /// Name of the engine: `cpu`, or `gpu` with its adapter.
    pub fn engine_name(&self) -> String {
        self.engine.name()
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
        self.last =
            Some(LastFrame { world: world.stamp(), sensor: sensor.clone(), world_from_sensor: *world_from_sensor });
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
        let mut start = Instant::now();
        let prepared = Prepared::new(world, sensor, world_from_sensor, images, placed, options)?;
        let hints = if placed.is_empty() || options.visibility == Visibility::Rays {
            None
        } else {
            self.query_occlusion(&prepared, world, sensor, world_from_sensor, placed, stats)?
        };
        if hints.is_some() {
            stats.stage("features on the device", start);
            start = Instant::now();
        }
        if placed.is_empty() {
            return Ok(prepared.finish(None));
        }
        self.tell_of_software("features on the device", stats);
        let prediction = self.on_threads(|| prepared.finish(hints.as_deref()))?;
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
        match self.boxes(prediction, placed, (world, sensor, world_from_sensor), options, stats)? {
            Some(made) => stats.count("regions of interest made on the device", made),
            None => self.tell_of_software("regions of interest on the device", stats),
        }
        stats.stage("regions of interest", start);
        Ok(())
    }

    /// [`engine::add_boxes`], on the CPU where a device that was ours to choose fails. Returns how many boxes the device made.
    fn boxes(
        &mut self,
        prediction: &mut FeaturePrediction,
        placed: &[PlacedFeature],
        seen_from: (&World, &Sensor, &Pose),
        options: &BoxOptions,
        stats: &mut Stats,
    ) -> Result<Option<usize>> {
        self.threads = self.threads.started()?;
        let before = self.engine.device().map(|device| device.work());
        let proven = self.prove_regions(seen_from.1);
        let engine = &mut *self.engine;
        let made =
            proven.and_then(|()| engine::add_boxes(engine, &self.threads, prediction, placed, seen_from, options));
        match (made, before) {
            (Ok(Some(made)), Some(before)) => {
                stats.work.add(self.engine.device().map(|device| device.work().since(before)).unwrap_or_default());
                Ok(Some(made))
            }
            // The CPU finds the same; the next prediction opens the device again.
            (Err(e), Some(_)) if self.backend == Backend::Auto && e.kind() != ErrorKind::Usage => {
                let (world, sensor, world_from_sensor) = seen_from;
                let add = || crate::features::add_boxes(prediction, placed, world, sensor, world_from_sensor, options);
                self.threads.run(add)??;
                Ok(None)
            }
            (made, _) => made,
        }
    }

    /// Records that a stage stays on the CPU because the adapter is software.
    fn tell_of_software(&mut self, stage: &str, stats: &mut Stats) {
        if self.engine.device().is_some_and(|device| !device.takes_features()) {
            stats.leave_out(stage, "done on the CPU: the adapter is a program on its own cores");
        }
    }

    /// Runs a function on the predictor's own threads.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if threads cannot be started.
    pub fn on_threads<R: Send>(&mut self, work: impl FnOnce() -> R + Send) -> Result<R> {
        self.threads = self.threads.started()?;
        self.threads.run(work)
    }

    /// What the images on the device say of the samples of features: slots of what may hide them; `None` if the images are
    /// not there.
    fn query_occlusion(
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
        let there = self.engine.device().is_some_and(|device| device.takes_features() && device.holds_images());
        if !there || !self.last.as_ref().is_some_and(same) {
            return Ok(None);
        }
        let samples = self.on_threads(|| prepared.asking())?;
        if samples.iter().all(Vec::is_empty) {
            stats.leave_out("features on the device", "no sample is where only what is in between decides");
            return Ok(None);
        }
        let Some(device) = self.engine.device() else { return Ok(None) };
        let before = device.work();
        let hints = match device.query_occlusion(&FeatureSamples { samples: &samples, placed, sensor }) {
            Ok(hints) => hints,
            // The images at hand say the same; the next prediction opens the device again.
            Err(_) if self.backend == Backend::Auto => return Ok(None),
            Err(e) => return Err(e),
        };
        stats.work.add(device.work().since(before));
        let doubtful = hints.iter().filter(|hint| **hint == OcclusionHint::Doubt).count();
        stats.count("feature samples in doubt on the device", doubtful);
        let mut slots = hints.iter().map(|hint| match hint {
            OcclusionHint::Hidden(slot) => Some(*slot),
            _ => None,
        });
        Ok(Some(samples.iter().map(|samples| slots.by_ref().take(samples.len()).collect()).collect()))
    }

    fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        if self.engine.device().is_none() {
            return self.engine.render(plan, images, stats);
        }
        let selection = stats.clone();
        let mut again = true;
        loop {
            let drawn = self.prove(plan).and_then(|()| self.engine.render(plan, images, stats));
            let Err(fault) = drawn else { return Ok(()) };
            self.recover(fault, again)?;
            again = false;
            // Nothing of the attempt that failed is told.
            stats.clone_from(&selection);
        }
    }

    /// Opens a lost device again, if it may, or, where the backend was ours to choose, goes on with the CPU engine.
    fn recover(&mut self, fault: Error, again: bool) -> Result<()> {
        let Some(device) = self.engine.device() else { return Err(fault) };
        if again && fault.kind() == ErrorKind::DeviceLost && device.reopen().is_ok() {
            self.proven = Proven::default();
            self.notice = Some(format!("the GPU was opened again after this: {fault}"));
            return Ok(());
        }
        if self.backend != Backend::Auto {
            return Err(fault);
        }
        self.engine = Box::new(cpu::Engine::new(self.threads.clone())?);
        self.notice = Some(format!("the CPU engine took over: {fault}"));
        Ok(())
    }

    /// Holds a device to the reference on a tiny scene before it draws for a kind of sensor for the first time. The pipelines
    /// that this makes are those of the prediction to come, so that it costs little besides.
    fn prove(&mut self, plan: &FramePlan) -> Result<()> {
        let task = Task::of(&plan.sensor);
        // Where nothing is drawn nothing has to be proven.
        if plan.polygon_count == 0 || self.engine.device().is_none() || self.proven.images.contains(&task) {
            return Ok(());
        }
        let engine = &mut *self.engine;
        let draw = |plan: &FramePlan, images: &mut Images| engine.render(plan, images, &mut Stats::default());
        let report = Probe::new()?.run(task, plan.drawn(), draw)?;
        if let (Some(first), Some(device)) = (report.faults.first(), self.engine.device()) {
            let (n, all) = (report.fault, report.pixels);
            return Err(faulty(device, format!("draws {n} of {all} pixels of a probe wrong: {}", first.why)));
        }
        self.proven.images.push(task);
        Ok(())
    }

    /// Holds a device to the CPU before it makes regions of interest for a kind of sensor for the first time. What it says of
    /// visibility needs no such proof: each answer is tested on the CPU.
    fn prove_regions(&mut self, sensor: &Sensor) -> Result<()> {
        let Some(device) = self.engine.device().filter(|device| device.takes_features()) else { return Ok(()) };
        let task = Task::of(sensor);
        let known = self.proven.regions.iter().find(|(of, _)| *of == task).map(|(_, told)| *told);
        let told = match known {
            Some(told) => told,
            None => {
                let told = Probe::new()?.regions(task, device)?;
                self.proven.regions.push((task, told));
                told
            }
        };
        match told.wrong {
            0 => Ok(()),
            wrong => Err(faulty(device, format!("makes {wrong} of {} regions of a probe wrong", told.all))),
        }
    }
}

/// A device does something wrong.
fn faulty(device: &dyn Device, what: String) -> Error {
    let remedy = "update its driver, or use --backend cpu; see presight doctor";
    Error::new(ErrorKind::NoDevice, format!("{} {what}", device.adapter()), remedy)
}

/// The engine of a backend, and what is to be said of it. `open_gpu` opens a GPU, on hardware or none if its second argument
/// says so.
fn choose_engine(
    backend: Backend,
    threads: &Threads,
    open_gpu: impl Fn(&Threads, bool) -> Result<Box<dyn Engine>>,
) -> Result<(Box<dyn Engine>, Option<String>)> {
    let on_cpu = || Ok::<_, Error>(Box::new(cpu::Engine::new(threads.clone())?));
    match backend {
        Backend::Cpu => Ok((on_cpu()?, None)),
        Backend::Gpu => Ok((open_gpu(threads, false)?, None)),
        Backend::Auto => match open_gpu(threads, true) {
            Ok(engine) => Ok((engine, None)),
            // No hardware GPU is the normal case on a robot's CI: nothing worth a notice.
            Err(e) if e.kind() == ErrorKind::NoDevice => Ok((on_cpu()?, None)),
            Err(e) => Ok((on_cpu()?, Some(format!("the CPU engine is used: {e}")))),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_an_adapter_auto_takes_the_cpu_and_gpu_is_an_error() {
        let fails =
            |kind: ErrorKind| move |_: &Threads, _: bool| Err(Error::new(kind, "no adapter", "use --backend cpu"));
        let threads = Threads::from(1);
        let (engine, notice) = choose_engine(Backend::Auto, &threads, fails(ErrorKind::NoDevice)).unwrap();
        assert_eq!((engine.name().as_str(), notice), ("cpu", None));
        let (engine, notice) = choose_engine(Backend::Auto, &threads, fails(ErrorKind::System)).unwrap();
        assert_eq!(engine.name(), "cpu");
        assert!(notice.is_some_and(|n| n.starts_with("the CPU engine is used: no adapter")));
        let refused = choose_engine(Backend::Gpu, &threads, fails(ErrorKind::NoDevice)).err();
        assert_eq!(refused.map(|e| e.kind()), Some(ErrorKind::NoDevice));
        assert!(choose_engine(Backend::Cpu, &threads, fails(ErrorKind::System)).is_ok());
    }
}
