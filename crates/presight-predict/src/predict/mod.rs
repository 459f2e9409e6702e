//! The predictor: from a world, a sensor and a pose to images, features and regions of interest, in one call.

mod deadline;
mod features;
mod features_in_time;
mod recovery;
mod view;

use crate::engine::{self, Engine};
use crate::probe::{DeviceCheck, SensorKind};
use crate::request::Request;
use features::FeatureTask;
use presight_features::{FeaturePrediction, Vantage};
use presight_model::clock::Instant;
use presight_model::error::Result;
use presight_model::geometry::SensorPose;
use presight_model::measured::{ScanMotion, ScanPoses};
use presight_model::plausible;
use presight_model::sensor::Sensor;
use presight_model::threads::Threads;
use presight_model::world::World;
use presight_render::cost::{Controller, DeadlineFrame, WayCosts};
use presight_render::plan::{
    ChosenWay, Drawn, FramePlan, ImageRequest, Images, Output, PlanBuffers, Raster, StageName, Stats, Way, Weighing,
};
use presight_render::row::RowCuts;
use recovery::choose_engine;
use std::sync::Arc;

/// The engine that predicts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// A hardware GPU if there is one, else the CPU engine. Single predictions of one-row scanners are left to the CPU
    /// engine.
    #[default]
    Auto,
    /// The CPU engine; never loads Vulkan.
    Cpu,
    /// The GPU engine on any adapter, including software adapters.
    Gpu,
}

/// Options of a [`Predictor`].
///
/// ```
/// use presight::{Backend, Options, Predictor};
/// let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(2))?;
/// assert_eq!(predictor.engine_name(), "cpu");
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Options {
    /// The engine to use.
    pub backend: Backend,
    /// CPU threads: a handle to share, or a number (`2.into()`), 0 for all cores.
    pub threads: Threads,
    /// The rasterizer on a GPU.
    pub raster: Raster,
    /// Lets a GPU first draw what the sensor's last frame showed, see [`Options::with_reuse_visible`].
    pub reuse_visible: bool,
    /// The CPU engine's strategy of finding what rays see; images have the same bits with each.
    pub way: Way,
}

impl Options {
    /// Creates options for this engine.
    pub fn new(backend: Backend) -> Self {
        Self { backend, ..Self::default() }
    }

    /// Sets the engine.
    #[must_use]
    pub fn with_backend(self, backend: Backend) -> Self {
        Self { backend, ..self }
    }

    /// Sets the rasterizer on a GPU.
    #[must_use]
    pub fn with_raster(self, raster: Raster) -> Self {
        Self { raster, ..self }
    }

    /// Lets a GPU first draw the polygons that the sensor's last frame showed in the same version of the world, so that
    /// hidden polygons are skipped sooner. Useful for moving robots that call [`Predictor::predict`] or
    /// [`Predictor::predict_again`] for consecutive frames. Images do not change, and [`Stats`] report whether it was
    /// used. It has no effect on the CPU engine, in batches and studies, or with a deadline.
    #[must_use]
    pub fn with_reuse_visible(self, reuse_visible: bool) -> Self {
        Self { reuse_visible, ..self }
    }

    /// Sets the CPU engine's strategy of finding what rays see, for benches and tests. [`Way::Auto`] learns the faster
    /// strategy from the times of a sensor's frames. [`Way::Counts`] decides by counts alone, equally in every run. A
    /// GPU ignores it. With a deadline, tiles are used only if they are certain to finish in time.
    #[must_use]
    pub fn with_way(self, way: Way) -> Self {
        Self { way, ..self }
    }

    /// Sets the threads: a handle to share, or a number, 0 for all cores.
    #[must_use]
    pub fn with_threads(self, threads: impl Into<Threads>) -> Self {
        Self { threads: threads.into(), ..self }
    }
}

/// The expected view of a sensor at one pose: the answer to a [`Request`].
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Prediction {
    /// The request.
    pub request: Request,
    /// The sensor.
    pub sensor: Sensor,
    /// Its pose, body axes.
    pub pose: SensorPose,
    /// The version of the world that was used.
    pub world_version: u64,
    /// The requested images, with `feature_id` if it was requested.
    pub images: Images,
    /// The requested features, with their regions of interest if these were requested.
    pub features: Option<FeaturePrediction>,
    /// Statistics of the prediction.
    pub stats: Stats,
}

/// Predicts with one engine, reusing its buffers from call to call.
///
/// ```
/// use presight::environment::Environment;
/// use presight::{Backend, Options, Predictor, Request, SensorPose, World};
/// let world = World::new(Environment::new());
/// let sensor = presight::preset("laser-scanner")?;
/// let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1))?;
/// let prediction = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &Request::default())?;
/// assert!(prediction.images.range.iter().all(|r| *r == f32::INFINITY));
/// # Ok::<(), presight::Error>(())
/// ```
pub struct Predictor {
    backend: Backend,
    reuse_visible: bool,
    way: Way,
    /// Threads for work outside of engines.
    threads: Threads,
    engine: Box<dyn Engine>,
    /// Keeps deadlines if `engine` cannot.
    stand_in: Option<Box<dyn Engine>>,
    /// Results of the checks of the engine's device.
    proven: ProbeResults,
    /// Memory for the next plan. A whole plan would keep a version of the world, and its next change would copy it.
    buffers: PlanBuffers,
    /// The world's own features, as placed last.
    own: Option<features::WorldFeatures>,
    tree: Option<Arc<features::KnownTree>>,
    /// The deadline controller.
    controller: Controller,
    /// Learnt costs of the strategies, by sensor.
    ways: WayCosts,
    /// The last event that affected the GPU.
    notice: Option<String>,
    row_cuts: RowCuts,
}

/// Checks that a device passed, by kind of sensor: images, and the results for regions.
#[derive(Default)]
struct ProbeResults {
    images: Vec<SensorKind>,
    regions: Vec<(SensorKind, DeviceCheck)>,
}

impl Predictor {
    /// Makes a predictor and opens its engine.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::NoDevice`] for [`Backend::Gpu`] if no adapter is found;
    /// [`presight_model::ErrorKind::System`] if the CPU engine's threads cannot be started.
    pub fn new(options: Options) -> Result<Self> {
        let open_gpu = |threads: &Threads, hardware_only| engine::open_gpu(threads, hardware_only, options.raster);
        let (engine, notice) = choose_engine(options.backend, &options.threads, open_gpu)?;
        Ok(Self { notice, ..Self::with_engine(options, engine) })
    }

    /// Creates a predictor with an open engine. With [`Backend::Auto`] the CPU engine takes over if the engine's device
    /// fails.
    #[doc(hidden)]
    pub fn with_engine(options: Options, engine: Box<dyn Engine>) -> Self {
        Self {
            backend: options.backend,
            reuse_visible: options.reuse_visible,
            way: options.way,
            threads: options.threads,
            engine,
            stand_in: None,
            proven: ProbeResults::default(),
            buffers: PlanBuffers::default(),
            own: None,
            tree: None,
            controller: Controller::default(),
            ways: WayCosts::default(),
            notice: None,
            row_cuts: RowCuts::default(),
        }
    }

    /// The engine.
    #[doc(hidden)]
    pub fn engine(&self) -> &dyn Engine {
        &*self.engine
    }

    /// The running threads for tasks of batches.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if they cannot be started.
    pub fn task_threads(&mut self) -> Result<Threads> {
        self.threads = self.threads.started()?;
        Ok(self.threads.clone())
    }

    pub(crate) fn row_cuts(&self) -> &RowCuts {
        &self.row_cuts
    }

    /// The engine, and the threads for the work that it leaves to the CPU.
    #[doc(hidden)]
    pub fn engine_mut(&mut self) -> (&mut dyn Engine, &Threads) {
        (&mut *self.engine, &self.threads)
    }

    /// Name of the engine: `cpu`, or `gpu` with its adapter.
    pub fn engine_name(&self) -> String {
        self.engine.name()
    }

    /// Predicts everything in the request for a sensor at a pose.
    ///
    /// If the GPU is lost, it is opened again once per prediction. With [`Backend::Auto`] the CPU engine takes over if
    /// that fails, or if the device has too little memory; [`Stats::notices`] reports that from then on.
    ///
    /// ```
    /// use presight::features::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
    /// use presight::features::{FeatureOptions, PlacedFeature};
    /// use presight::features::BoxOptions;
    /// use presight::environment::Environment;
    /// use presight::{Options, Predictor, Request, SensorPose, World};
    /// use glam::{DMat3, DVec3};
    ///
    /// // An edge 3 m ahead in an empty world.
    /// let ends = [DVec3::new(3.0, -0.2, 0.0), DVec3::new(3.0, 0.2, 0.1)];
    /// let shape = FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
    /// let (existence, properties) = (Existence::default(), Properties::default());
    /// let feature = Feature { id: 7, name: None, object: None, shape, existence, properties };
    /// let placed = vec![PlacedFeature { feature: feature.into(), object: None, slots: vec![] }];
    ///
    /// let request = Request::default()
    ///     .with_features(FeatureOptions::default().with_placed(placed))
    ///     .with_regions(BoxOptions::default().with_sensor_sigmas([0.02, 0.02, 0.02, 0.0, 0.0, 0.01]));
    /// let camera = presight::preset("video-camera")?;
    /// let mut predictor = Predictor::new(Options::default())?;
    /// let seen = predictor.predict(&World::new(Environment::new()), &camera, &SensorPose::IDENTITY, &request)?;
    /// let edge = &seen.features.as_ref().expect("they were requested").features[0];
    /// assert_eq!((edge.feature.id, edge.visible_fraction), (7, 1.0));
    /// let [x0, y0, x1, y1] = edge.roi.expect("it is seen");
    /// assert!(x0 < x1 && y0 < y1);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// The errors of [`Request::check`] and [`presight_model::geometry::Pose::check`];
    /// [`presight_model::ErrorKind::Usage`] if features are requested but the world has none for the sensor's class;
    /// [`presight_model::ErrorKind::Invalid`] for features of objects or polygons that are not in the world;
    /// [`presight_model::ErrorKind::System`] if the system refuses memory or threads;
    /// [`presight_model::ErrorKind::DeviceLost`] and [`presight_model::ErrorKind::DeviceMemory`] with [`Backend::Gpu`];
    /// [`presight_model::ErrorKind::Deadline`] if no image can be made within [`Request::deadline`];
    /// [`presight_model::ErrorKind::Usage`] for a deadline of 0 or, unless the backend is [`Backend::Auto`], an engine
    /// that cannot stop early.
    pub fn predict(
        &mut self,
        world: &World,
        sensor: &Sensor,
        pose: &SensorPose,
        request: &Request,
    ) -> Result<Prediction> {
        let mut prediction = Prediction {
            request: request.clone(),
            sensor: sensor.clone(),
            pose: *pose,
            world_version: world.version(),
            images: Images::default(),
            features: None,
            stats: Stats::default(),
        };
        self.fill(world, &mut prediction)?;
        Ok(prediction)
    }

    /// Predicts into an older prediction and reuses its memory: the same sensor and request, at another pose or in
    /// another version of the world. After an error the older prediction must not be used.
    ///
    /// ```
    /// use presight::environment::Environment;
    /// use presight::{Options, Predictor, Request, SensorPose, World};
    /// let (world, sensor) = (World::new(Environment::new()), presight::preset("laser-scanner")?);
    /// let mut predictor = Predictor::new(Options::default())?;
    /// let mut prediction = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &Request::default())?;
    /// let pose = SensorPose::from_xyz_rpy(glam::DVec3::X, 0.0, 0.0, 0.1);
    /// predictor.predict_again(&world, &pose, &mut prediction)?;
    /// assert_eq!(prediction.pose, pose);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// Same as [`Predictor::predict`].
    pub fn predict_again(&mut self, world: &World, pose: &SensorPose, prediction: &mut Prediction) -> Result<()> {
        prediction.pose = *pose;
        prediction.world_version = world.version();
        self.fill(world, prediction)
    }

    /// Fulfils the request of a prediction whose sensor and pose are set.
    fn fill(&mut self, world: &World, prediction: &mut Prediction) -> Result<()> {
        let Prediction { request, sensor, pose, images, features, stats, .. } = prediction;
        request.check(sensor)?;
        let world_from_sensor = &pose.world_from_sensor();
        world_from_sensor.check()?;
        if self.backend == Backend::Auto && request.deadline.is_some() && self.engine.with_deadline().is_none() {
            let why = format!("the CPU engine kept the deadline: {} cannot stop", self.engine.name());
            self.fill_on_stand_in(world, prediction)?;
            prediction.stats.notices.push(why);
            return Ok(());
        }
        // A frame costs an H100 0.6 ms, several times what a row costs two cores.
        if self.backend == Backend::Auto && self.engine.device().is_some() && SensorKind::of(sensor) == SensorKind::Row
        {
            return self.fill_on_stand_in(world, prediction);
        }
        if request.deadline.is_some() {
            self.get_ready(sensor, request.drawn().outputs)?;
        }
        let deadline = request.deadline.map(|limit| (limit, &request.priority));
        let outputs = request.drawn().outputs;
        let mut timed = self.controller.begin(deadline, self.engine.with_deadline(), sensor, outputs)?;
        let placed = request.features.as_ref().map(|options| self.place(world, sensor, options)).transpose()?;
        if let (Some(timed), Some(placed)) = (&mut timed, &placed) {
            timed.expect_features(placed.features.len(), request.regions.is_some());
        }
        let vantage = Vantage { world, sensor, world_from_sensor };
        let reuse = self.reuse_visible;
        let motion = request.motion.as_ref();
        *stats = self.predict_within(&vantage, motion, request.drawn(), reuse, images, timed.as_mut())?;
        *features = match &placed {
            Some(placed) => {
                let task = FeatureTask::new(vantage, request, placed);
                Some(self.features(&task, images, stats, timed.as_mut())?)
            }
            None => None,
        };
        if !request.outputs.has(Output::PolygonId) {
            images.polygon_id.clear();
        }
        if let Some(timed) = &timed {
            self.controller.end(timed, stats);
        }
        Ok(())
    }

    /// Predicts only images, into the caller's memory, for studies that draw many sensors into the same images.
    pub fn predict_images(
        &mut self,
        world: &World,
        sensor: &Sensor,
        pose: &SensorPose,
        request: impl Into<ImageRequest>,
        images: &mut Images,
    ) -> Result<Stats> {
        let vantage = Vantage { world, sensor, world_from_sensor: &pose.world_from_sensor() };
        self.predict_within(&vantage, None, request.into(), false, images, None)
    }

    /// Predicts images, with a deadline if there is one; an engine may reuse its last frame if the request allows it.
    fn predict_within(
        &mut self,
        vantage: &Vantage<'_>,
        motion: Option<&ScanMotion>,
        request: ImageRequest,
        reuse_visible: bool,
        images: &mut Images,
        mut timed: Option<&mut DeadlineFrame>,
    ) -> Result<Stats> {
        let start = Instant::now();
        let Vantage { world, sensor, world_from_sensor } = *vantage;
        let bundles = ScanPoses::new(sensor, world_from_sensor, motion)?;
        let cut = if bundles.is_some() { None } else { self.find_cut(vantage, timed.as_deref()) };
        let buffers = std::mem::take(&mut self.buffers);
        let mut plan = match (bundles, cut) {
            (Some(poses), _) => FramePlan::in_bundles(buffers, world, sensor, world_from_sensor, request, poses)?,
            (None, Some(cut)) => FramePlan::by_cut(buffers, world, sensor, world_from_sensor, request, cut),
            (None, None) => {
                let mut chosen = self.choose_way(world, sensor);
                if self.way == Way::Auto {
                    chosen = self.ways.adjust(sensor, request.outputs, chosen);
                }
                if let Some(timed) = &timed {
                    chosen = self.way_in_time(timed, chosen);
                }
                FramePlan::by(chosen, buffers, world, sensor, world_from_sensor, request)?
            }
        };
        plan.reuse_visible = reuse_visible;
        let mut stats = Stats { index: world.index().name(), ..Stats::default() };
        if plan.way() == Way::Raster {
            stats.stage(StageName::Selection, start);
        }
        if let Some(timed) = &mut timed {
            self.controller.plan(timed, &mut plan)?;
        }
        let rendered = self.render(&plan, images, &mut stats);
        if self.way == Way::Auto && plan.bundles().is_none() {
            self.ways.learn(&plan, &stats, start.elapsed());
        }
        plan.record_way(stats.way);
        add_notes(&plan, self.notice.as_ref(), &mut stats);
        self.buffers = plan.into_buffers();
        rendered?;
        if let Some(timed) = &mut timed {
            timed.images_are_made();
        }
        Ok(stats)
    }

    /// Returns true if no way was requested. Level rows may then be searched in the world's cut.
    pub(crate) fn may_cut(&self) -> bool {
        matches!(self.way, Way::Auto | Way::Counts)
    }

    /// The way of a prediction; engines that select all polygons have a single one.
    pub(crate) fn choose_way(&self, world: &World, sensor: &Sensor) -> ChosenWay {
        if self.engine.has_tiles() { self.way.choose(world, sensor) } else { ChosenWay::RASTER }
    }

    /// Makes the trees of a whole world that the CPU engine searches for sensors of few rays; otherwise they are made
    /// after several predictions. It takes about 0.6 us a triangle and thread. A tree stays with its mesh when other
    /// parts of the world change.
    ///
    /// ```
    /// use presight::{Options, Predictor, World, environment::Environment};
    /// let world = World::new(Environment::new());
    /// Predictor::new(Options::default())?.make_trees(&world)?;
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if there is no memory for them, or threads cannot be started.
    pub fn make_trees(&mut self, world: &World) -> Result<()> {
        self.on_threads(|| world.make_ray_trees(0..world.environment().objects().len() as u32))?
    }

    /// Runs a function on the predictor's own threads.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if threads cannot be started.
    pub fn on_threads<R: Send>(&mut self, work: impl FnOnce() -> R + Send) -> Result<R> {
        self.threads = self.threads.started()?;
        self.threads.run(work)
    }

    /// Draws plans of one sensor together if the engine can, and hands over their results in order: images, or sums
    /// that the engine weighed. After a fault the remaining plans are drawn individually, like single predictions.
    pub(crate) fn render_many(
        &mut self,
        plans: &[FramePlan],
        weighing: Option<&Weighing>,
        images: &mut Images,
        mut each: impl FnMut(Drawn<'_>, Stats),
    ) -> Result<()> {
        let mut done = 0;
        let first = plans.iter().find(|plan| plan.polygon_count > 0);
        // A device draws all rays from one pose.
        let alike = self.engine.device().is_none() || plans.iter().all(|plan| plan.bundles().is_none());
        if alike && first.is_none_or(|plan| self.prove_for(plan).is_ok()) {
            // A fault occurs again with the first remaining plan, which handles it.
            let _ = self.engine.render_many(plans, weighing, images, &mut |drawn, mut stats| {
                add_notes(&plans[done], self.notice.as_ref(), &mut stats);
                done += 1;
                each(drawn, stats);
            });
        }
        for plan in &plans[done..] {
            let mut stats = Stats::default();
            self.render(plan, images, &mut stats)?;
            add_notes(plan, self.notice.as_ref(), &mut stats);
            each(Drawn::Images(images), stats);
        }
        Ok(())
    }

    fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        if self.engine.device().is_none() {
            return self.engine.render(plan, images, stats);
        }
        if plan.bundles().is_some() {
            let mut engine = self.stand_in()?;
            let rendered = engine.render(plan, images, stats);
            self.stand_in = Some(engine);
            let name = self.engine.name();
            stats.notices.push(format!("the CPU engine drew rays with own origins or times: {name} has one pose"));
            return rendered;
        }
        let selection = stats.clone();
        let mut again = true;
        loop {
            let drawn = self.prove_for(plan).and_then(|()| self.engine.render(plan, images, stats));
            let Err(fault) = drawn else { return Ok(()) };
            self.recover(fault, again)?;
            again = false;
            // Drop the statistics of the failed attempt.
            stats.clone_from(&selection);
        }
    }
}

/// Adds the plan's and the predictor's notes to an engine's statistics.
fn add_notes(plan: &FramePlan, notice: Option<&String>, stats: &mut Stats) {
    let by_engine = std::mem::replace(&mut stats.left_out, plan.left_out());
    stats.left_out.extend(by_engine);
    plan.variants().iter().filter(|(_, taken, _)| *taken).for_each(|(what, _, why)| stats.take(*what, why));
    stats.notices.extend(notice.cloned());
    if plan.polygon_count == 0 && plan.radius().is_none() {
        let bounds = plan.world.environment().bounds();
        stats.notices.extend(plausible::far_outside(&bounds, plan.world_from_sensor.translation));
    }
}
