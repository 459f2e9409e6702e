//! Batches: predictions for one sensor at many poses, in bounded memory.
//!
//! [`Predictor::batch`] returns an iterator in the order of the poses. On the CPU each pose is a task. A batch can
//! deliver images, the log-likelihood of a measured image at each pose or at all headings of each place, and
//! statistics. The formula and its reasons are in `docs/batches.md`.

mod beam_model;
mod headings;
mod likelihood;
mod panoramas;
mod weigh;

pub use headings::Headings;
pub use likelihood::RangeLikelihood;
pub use panoramas::Panoramas;

use crate::engine::Engine;
use crate::predict::Predictor;
use crate::request::Request;
use headings::{HeadingWeights, Panorama};
use presight_model::clock::Instant;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::measured::{ScanMotion, ScanPoses};
use presight_model::sensor::Sensor;
use presight_model::threads::Threads;
use presight_model::world::World;
use presight_render::cpu::CpuEngine;
use presight_render::plan::{
    ChosenWay, Drawn, FramePlan, ImageRequest, Images, Output, Outputs, PlanBuffers, StageName, Stats, Weighing,
};
use presight_render::row::{Making, RowCuts, is_row};
use rayon::prelude::*;
use std::iter::Peekable;
use std::sync::{Mutex, PoisonError};

/// Spacing of the candidate poses, as widths of the cells that they represent. A hit is expected anywhere within.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseCell {
    /// Width in each direction, metres.
    pub side: f64,
    /// Width of the heading, radians.
    pub turn: f64,
}

/// The results requested for each pose.
#[derive(Clone, Debug, Default)]
pub struct BatchRequest {
    /// Images as single predictions make them.
    pub images: Option<ImageRequest>,
    /// The measured image to weigh.
    pub likelihood: Option<RangeLikelihood>,
    /// Headings at which to weigh it for each place. Poses are then places of the sensor; their headings are ignored.
    pub headings: Option<Headings>,
    /// The height, metres, at which the world is cut immediately for a level one-row scanner; `None` uses the first
    /// pose's. Results do not depend on it, unless a GPU engine weighs the poses at other heights.
    pub height: Option<f64>,
    /// Include statistics of each prediction.
    pub statistics: bool,
    /// How the robot moves during the scan at each pose: none if it stands, one for all poses, or one per pose.
    pub motions: Vec<ScanMotion>,
    /// Number of poses processed together; `None` chooses. Results do not depend on it.
    pub chunk: Option<usize>,
}

/// The results for one pose.
#[derive(Clone, Debug)]
pub struct BatchItem {
    /// Index of the pose, from 0.
    pub index: usize,
    /// The sensor's pose, body axes; with headings its heading is 0.
    pub pose: SensorPose,
    /// Empty unless requested. With headings, the panorama's images.
    pub images: Images,
    /// Log-likelihood of the measured image at this pose, see [`RangeLikelihood::log_likelihood`].
    pub log_likelihood: Option<f64>,
    /// Log-likelihoods by heading; empty unless requested.
    pub headings: Vec<f32>,
    /// Statistics, if requested.
    pub stats: Option<Stats>,
}

/// A batch in progress: an iterator over [`BatchItem`]s in the order of the poses. It ends after an error.
pub struct Batch<'p, I: Iterator> {
    predictor: &'p mut Predictor,
    poses: Peekable<I>,
    task: Task<'p>,
    /// Threads that each process one pose; `None` if the engine processes poses in sequence.
    threads: Option<Threads>,
    lanes: Vec<Mutex<Lane>>,
    chunk: usize,
    /// Memory for plans.
    buffers: Vec<PlanBuffers>,
    next: usize,
    done: std::vec::IntoIter<Result<BatchItem>>,
    ended: bool,
}

/// Looks at the images of the pose with this index.
type Show<'p> = &'p (dyn Fn(usize, &Images) + Sync);

/// The work at each pose, the same for all.
struct Task<'p> {
    world: World,
    /// The sensor, or its panorama.
    sensor: Sensor,
    request: ImageRequest,
    /// The images that items keep.
    wanted: Outputs,
    show: Option<Show<'p>>,
    weigh: Option<HeadingModel>,
    /// The weighing for an engine that weighs images itself; `None` if images are also requested.
    weighing: Option<Weighing>,
    headings: Option<Headings>,
    statistics: bool,
    /// True if a cut can serve the sensor when it is level.
    by_cut: bool,
    /// Height of the cut.
    height: Option<f64>,
    motions: Vec<ScanMotion>,
}

enum HeadingModel {
    Pose(RangeLikelihood),
    Headings(Box<HeadingWeights>),
}

/// A thread's own memory and engine.
#[derive(Default)]
struct Lane {
    engine: Option<Box<dyn Engine>>,
    chosen: ChosenWay,
    buffers: PlanBuffers,
    images: Images,
    panorama: Panorama,
}

/// Maximum size of the images of a chunk, bytes.
const CHUNK_BYTES: usize = 64 << 20;
/// Maximum number of poses of a chunk.
const MAX_CHUNK: usize = 512;
/// Number of poses that are planned before an engine draws them together.
const TOGETHER: usize = 64;

impl Predictor {
    /// Predicts at many poses of a sensor. The iterator returns items in order and keeps
    /// a chunk in memory at most. Images are bit-equal to [`Predictor::predict`]. Results do not depend on chunks and
    /// threads.
    ///
    /// The view of a level one-row scanner comes from a cut of the world at its height ([`BatchRequest::height`]), kept
    /// for the version of the world. A GPU draws many poses in one submission.
    ///
    /// ```
    /// use presight::predict::{BatchRequest, PoseCell, RangeLikelihood};
    /// use presight::environment::Environment;
    /// use presight::measured::{Frame, Measurement};
    /// use presight::sensor::Noise;
    /// use presight::{Options, Predictor, Sensor, SensorPose, World};
    /// let mut spec = presight::preset("laser-scanner")?.spec().clone();
    /// spec.noise = Noise { range_sigma: 0.02, ..Noise::default() };
    /// let sensor = Sensor::new(spec)?;
    /// let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(vec![f32::INFINITY; 361]))?;
    /// let nothing = RangeLikelihood::new(&frame, PoseCell::default())?;
    /// let request = BatchRequest { likelihood: Some(nothing), ..BatchRequest::default() };
    /// let mut predictor = Predictor::new(Options::default())?;
    /// let world = World::new(Environment::new());
    /// let poses = vec![SensorPose::IDENTITY; 3];
    /// let all: Vec<_> = predictor.batch(&world, &sensor, poses, &request)?.collect::<Result<_, _>>()?;
    /// // No surface and no return: p_hit and p_none together, for each beam.
    /// assert!((all[2].log_likelihood.unwrap() - 361.0 * 0.8f64.ln()).abs() < 1e-9);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// The errors of [`Request::check`]; [`presight_model::ErrorKind::Usage`] for headings without a measured image,
    /// another sensor's image or headings, or a chunk of 0. For each pose, the errors of [`Predictor::predict`] and
    /// [`Headings::place`].
    pub fn batch<I: IntoIterator<Item = SensorPose>>(
        &mut self,
        world: &World,
        sensor: &Sensor,
        poses: I,
        request: &BatchRequest,
    ) -> Result<Batch<'_, I::IntoIter>> {
        let mut task = Task::new(world, sensor, request)?;
        let mut poses = poses.into_iter().peekable();
        task.height = request.height.or_else(|| poses.peek().map(|pose| pose.world_from_sensor().translation.z));
        let threads = match self.engine().for_task() {
            Some(_) => Some(self.task_threads()?),
            None => None,
        };
        let count = threads.as_ref().map_or(Ok(1), |threads| threads.run(rayon::current_num_threads))?;
        let chunk = match request.chunk {
            Some(0) => return Err(Error::usage("a chunk cannot have 0 poses", "give 1 or more, or none")),
            Some(chunk) => chunk,
            None => (CHUNK_BYTES / task.bytes().max(1)).clamp(count, MAX_CHUNK.max(count)),
        };
        let chosen = self.choose_way(&task.world, &task.sensor);
        task.by_cut &= self.may_cut();
        // What a device does not draw itself, a level scanner's weights by a cut, is left to the CPU.
        let cpu = match threads {
            None if task.by_cut && task.weighing.is_some() => Some(CpuEngine::new(self.task_threads()?)?),
            _ => None,
        };
        let engine = || cpu.as_ref().map_or_else(|| self.engine().for_task(), Engine::for_task);
        let lanes = (0..count).map(|_| Mutex::new(Lane { engine: engine(), chosen, ..Lane::default() })).collect();
        Ok(Batch {
            predictor: self,
            poses,
            task,
            threads,
            lanes,
            chunk,
            buffers: Vec::new(),
            next: 0,
            done: Vec::new().into_iter(),
            ended: false,
        })
    }
}

impl<'p> Task<'p> {
    fn new(world: &World, sensor: &Sensor, request: &BatchRequest) -> Result<Self> {
        let other = |what: &str| {
            let what = format!("{what} does not belong to sensor {:?}", sensor.spec().name);
            Err(Error::usage(what, "make it from the sensor of the batch"))
        };
        let weigh = match (&request.likelihood, &request.headings) {
            (Some(sensed), _) if sensed.sensor() != sensor.spec() => return other("the measured image"),
            (Some(_), Some(headings)) if headings.sensor() != sensor.spec() => return other("the set of headings"),
            (None, Some(_)) => {
                let remedy = "give the likelihood's measured image, or a pose for each heading";
                return Err(Error::usage("all headings at once: there is no measured image to weigh", remedy));
            }
            (Some(sensed), Some(headings)) => {
                Some(HeadingModel::Headings(Box::new(HeadingWeights::new(headings, sensed))))
            }
            (Some(sensed), None) => Some(HeadingModel::Pose(sensed.clone())),
            (None, None) => None,
        };
        let sensor = request.headings.as_ref().map_or(sensor, Headings::panorama).clone();
        let asked = request.images.unwrap_or(Outputs::of(&[]).into());
        Request::of(asked.outputs).check(&sensor)?;
        if request.headings.is_some() && (!request.motions.is_empty() || sensor.has_origins()) {
            let what = "all headings at once of a sensor that moves or whose rays start at several points";
            return Err(Error::usage(what, "give a pose for each heading"));
        }
        let mut outputs = asked.outputs;
        if weigh.is_some() || request.images.is_none() {
            outputs = outputs.with(Output::Range);
        }
        if weigh.is_some() {
            outputs = outputs.with(Output::CosIncidence);
        }
        let alone = request.likelihood.as_ref().filter(|_| request.images.is_none());
        Ok(Self {
            world: world.clone(),
            weighing: alone.map(|sensed| sensed.weighing(request.headings.as_ref())),
            request: ImageRequest { outputs, ..asked },
            wanted: asked.outputs,
            show: None,
            by_cut: is_row(&sensor) && request.motions.is_empty(),
            motions: request.motions.clone(),
            sensor,
            weigh,
            headings: request.headings.clone(),
            height: None,
            statistics: request.statistics,
        })
    }

    /// Size of an item, bytes.
    fn bytes(&self) -> usize {
        let pixels = self.sensor.width() as usize * self.sensor.height() as usize;
        4 * pixels * self.wanted.numbers() + self.headings.as_ref().map_or(0, |h| 4 * h.count() as usize)
    }

    /// True if items have images.
    fn keeps(&self) -> bool {
        self.wanted.iter().next().is_some()
    }

    /// Allocates the images of an item.
    fn room(&self) -> Result<Images> {
        Images::with_room(self.sensor.width() as usize * self.sensor.height() as usize, self.wanted)
    }

    /// The pose for the prediction.
    fn pose(&self, given: &SensorPose) -> Result<SensorPose> {
        given.world_from_sensor().check()?;
        self.headings.as_ref().map_or(Ok(*given), |headings| headings.place(given))
    }

    /// Plans the prediction at a pose.
    fn plan(&self, index: usize, pose: &Pose, chosen: Option<ChosenWay>, buffers: PlanBuffers) -> Result<FramePlan> {
        let (world, sensor, request) = (&self.world, &self.sensor, self.request);
        let motion = match &self.motions[..] {
            [] => None,
            [one] => Some(one),
            motions => Some(motions.get(index).ok_or_else(|| {
                let what = format!("{} motions, and more poses", motions.len());
                Error::usage(what, "give a motion for each pose, or one for all")
            })?),
        };
        match (ScanPoses::new(sensor, pose, motion)?, chosen) {
            (Some(poses), _) => FramePlan::in_bundles(buffers, world, sensor, pose, request, poses),
            (None, Some(chosen)) => FramePlan::by(chosen, buffers, world, sensor, pose, request),
            (None, None) => FramePlan::within(buffers, world, sensor, pose, request),
        }
    }

    /// Produces the item of a pose, with a thread's own memory and engine; kept images go to `room`.
    fn run(
        &self,
        index: usize,
        given: &SensorPose,
        room: Images,
        cuts: &RowCuts,
        lane: &mut Lane,
    ) -> Result<BatchItem> {
        let pose = self.pose(given)?;
        if self.keeps() {
            let scratch = std::mem::replace(&mut lane.images, room);
            self.take_scratch(scratch, &mut lane.images);
        }
        let mut stats = Stats::default();
        let world_from_sensor = pose.world_from_sensor();
        let seen = self.see_by_cut(&world_from_sensor, cuts, lane, &mut stats)?;
        let Lane { engine, chosen, buffers, images, .. } = lane;
        if let (false, Some(engine)) = (seen, engine) {
            let buffers_of_plan = std::mem::take(buffers);
            let plan = self.plan(index, &world_from_sensor, Some(*chosen), buffers_of_plan)?;
            stats.index = self.world.index().name();
            let rendered = engine.render(&plan, images, &mut stats);
            *buffers = plan.into_buffers();
            rendered?;
        }
        Ok(self.finish(index, pose, stats, Drawn::Images(&mut lane.images), &mut lane.panorama))
    }

    /// Fills a lane's images by a cut of the world. Returns false if no cut applies.
    fn see_by_cut(&self, pose: &Pose, cuts: &RowCuts, lane: &mut Lane, stats: &mut Stats) -> Result<bool> {
        let Some(engine) = lane.engine.as_mut().filter(|engine| self.by_cut && engine.draws_cuts()) else {
            return Ok(false);
        };
        let is_common = self.height == Some(pose.translation.z);
        let making = if is_common { Making::AtOnce } else { Making::IfOften };
        let Some(cut) = cuts.get(&self.world, &self.sensor, pose, making) else {
            return Ok(false);
        };
        let buffers = std::mem::take(&mut lane.buffers);
        let plan = FramePlan::by_cut(buffers, &self.world, &self.sensor, pose, self.request, cut);
        let rendered = engine.render(&plan, &mut lane.images, stats);
        lane.buffers = plan.into_buffers();
        rendered.map(|()| true)
    }

    /// Weighs images unless the engine did, and keeps the requested ones.
    fn finish(
        &self,
        index: usize,
        pose: SensorPose,
        stats: Stats,
        drawn: Drawn<'_>,
        panorama: &mut Panorama,
    ) -> BatchItem {
        if let (Some(show), Drawn::Images(images)) = (self.show, &drawn) {
            show(index, images);
        }
        let (mut log_likelihood, mut headings) = (None, Vec::new());
        match (&self.weigh, &drawn) {
            (Some(HeadingModel::Pose(sensed)), Drawn::Images(images)) => {
                log_likelihood = Some(sensed.log_likelihood(&images.range, &images.cos_incidence));
            }
            (Some(HeadingModel::Pose(sensed)), Drawn::Sums(sums)) => {
                log_likelihood = sums.first().map(|sum| sensed.tempered(*sum));
            }
            (Some(HeadingModel::Headings(weigher)), Drawn::Images(images)) => {
                headings = weigher.weigh(&images.range, &images.cos_incidence, panorama);
            }
            (Some(HeadingModel::Headings(weigher)), Drawn::Sums(sums)) => headings = weigher.tempered(sums),
            (None, _) => {}
        }
        let images = match drawn {
            Drawn::Images(images) if self.keeps() => self.keep(images),
            _ => Images::default(),
        };
        let stats = self.statistics.then_some(stats);
        BatchItem { index, pose, images, log_likelihood, headings, stats }
    }

    /// Takes the requested images out; the others stay.
    fn keep(&self, images: &mut Images) -> Images {
        let kept = std::mem::take(images);
        self.take_scratch(kept, images)
    }

    /// Moves images that are only needed for weighing to `to`, and returns the rest.
    fn take_scratch(&self, mut from: Images, to: &mut Images) -> Images {
        if !self.wanted.has(Output::Range) {
            to.range = std::mem::take(&mut from.range);
        }
        if !self.wanted.has(Output::CosIncidence) {
            to.cos_incidence = std::mem::take(&mut from.cos_incidence);
        }
        from
    }
}

impl<'p, I: Iterator<Item = SensorPose>> Batch<'p, I> {
    /// Shows the requested images of each pose to `show`, with the pose's index, on the thread that drew them and in
    /// any order. Items then have no images, and memory for images is used from pose to pose.
    ///
    /// ```
    /// use presight::predict::BatchRequest;
    /// use presight::environment::Environment;
    /// use presight::{Options, Output, Outputs, Predictor, SensorPose, World};
    /// use std::sync::atomic::{AtomicUsize, Ordering};
    /// let request = BatchRequest { images: Some(Outputs::of(&[Output::Range]).into()), ..BatchRequest::default() };
    /// let mut predictor = Predictor::new(Options::default())?;
    /// let world = World::new(Environment::new());
    /// let empty = AtomicUsize::new(0);
    /// let count = |_: usize, images: &presight::Images| {
    ///     empty.fetch_add(images.range.iter().filter(|r| r.is_infinite()).count(), Ordering::Relaxed);
    /// };
    /// let (scanner, poses) = (presight::preset("laser-scanner")?, vec![SensorPose::IDENTITY; 3]);
    /// let batch = predictor.batch(&world, &scanner, poses, &request)?;
    /// for item in batch.shown_to(&count) {
    ///     assert!(item?.images.range.is_empty());
    /// }
    /// assert_eq!(empty.into_inner(), 3 * 361);
    /// # Ok::<(), presight::Error>(())
    /// ```
    pub fn shown_to(mut self, show: &'p (dyn Fn(usize, &Images) + Sync)) -> Self {
        (self.task.wanted, self.task.show) = (Outputs::of(&[]), Some(show));
        self
    }

    /// Number of poses that the next chunk processes.
    pub fn chunk(&self) -> usize {
        self.chunk
    }

    /// Number of poses that each later chunk processes, at least 1: a caller that must not wait long between two items
    /// asks for few.
    pub fn set_chunk(&mut self, poses: usize) {
        self.chunk = poses.max(1);
    }

    /// Processes the next chunk. Returns false after the last pose.
    fn advance(&mut self) -> bool {
        let poses: Vec<(usize, SensorPose)> = (self.next..).zip(self.poses.by_ref().take(self.chunk)).collect();
        if poses.is_empty() {
            return false;
        }
        self.next += poses.len();
        let placed = |(index, _): &(usize, SensorPose), e: Error| e.at(format!("pose {index}"));
        let done: Result<Vec<Result<BatchItem>>> = match &self.threads {
            Some(threads) => {
                let (task, lanes, cuts) = (&self.task, &self.lanes, self.predictor.row_cuts());
                // Allocated by the thread that frees it, like the list, because allocators keep memory per thread.
                let rooms: Result<Vec<Images>> = poses.iter().map(|_| task.room()).collect();
                let work = |(given, room): (&(usize, SensorPose), Images)| {
                    // The work never yields to another task, so a thread's lane is used once at a time.
                    let lane = &lanes[rayon::current_thread_index().unwrap_or(0) % lanes.len()];
                    let mut lane = lane.lock().unwrap_or_else(PoisonError::into_inner);
                    task.run(given.0, &given.1, room, cuts, &mut lane).map_err(|e| placed(given, e))
                };
                let mut done = Vec::with_capacity(poses.len());
                rooms.and_then(|rooms| {
                    threads.run(|| poses.par_iter().zip(rooms).map(work).collect_into_vec(&mut done))?;
                    Ok(done)
                })
            }
            None => Ok(self.by_engine(&poses)),
        };
        self.done = done.unwrap_or_else(|e| vec![Err(e)]).into_iter();
        true
    }

    /// Processes poses with the predictor's own engine, up to the first error.
    fn by_engine(&mut self, poses: &[(usize, SensorPose)]) -> Vec<Result<BatchItem>> {
        let mut done = Vec::with_capacity(poses.len());
        for some in poses.chunks(TOGETHER) {
            let before = done.len();
            if let Err(e) = self.some_by_engine(some, &mut done) {
                let (index, _) = some[done.len() - before];
                done.push(Err(e.at(format!("pose {index}"))));
                break;
            }
        }
        done
    }

    /// Adds the items of some poses; on an error, only the items before it.
    fn some_by_engine(&mut self, poses: &[(usize, SensorPose)], done: &mut Vec<Result<BatchItem>>) -> Result<()> {
        let Self { predictor, task, lanes, buffers, .. } = self;
        let lane = lanes[0].get_mut().unwrap_or_else(PoisonError::into_inner);
        let (mut items, mut plans, mut planned) = (Vec::new(), Vec::new(), Vec::new());
        let mut fault = Ok(());
        for (index, given) in poses {
            let start = Instant::now();
            let mut stats = Stats::default();
            let pose = match task.pose(given) {
                Ok(pose) => pose,
                Err(e) => {
                    fault = Err(e);
                    break;
                }
            };
            let world_from_sensor = pose.world_from_sensor();
            let seen = match task.see_by_cut(&world_from_sensor, predictor.row_cuts(), lane, &mut stats) {
                Ok(seen) => seen,
                Err(e) => {
                    fault = Err(e);
                    break;
                }
            };
            if seen {
                let drawn = Drawn::Images(&mut lane.images);
                items.push(Some(task.finish(*index, pose, stats, drawn, &mut lane.panorama)));
                continue;
            }
            let buffers = buffers.pop().unwrap_or_default();
            match task.plan(*index, &world_from_sensor, None, buffers) {
                Ok(plan) => plans.push(plan),
                Err(e) => {
                    fault = Err(e);
                    break;
                }
            }
            stats.index = task.world.index().name();
            stats.stage(StageName::Selection, start);
            planned.push((items.len(), *index, pose, stats));
            items.push(None);
        }
        let mut planned = planned.into_iter();
        let Lane { images, panorama, .. } = lane;
        let drawn = predictor.render_many(&plans, task.weighing.as_ref(), images, |drawn, stats| {
            if let Some((at, index, pose, planned)) = planned.next() {
                let stages_ms = [planned.stages_ms, stats.stages_ms].concat();
                let stats = Stats { index: planned.index, stages_ms, ..stats };
                items[at] = Some(task.finish(index, pose, stats, drawn, panorama));
            }
        });
        buffers.extend(plans.into_iter().map(FramePlan::into_buffers));
        done.extend(items.into_iter().map_while(|item| item.map(Ok)));
        drawn.and(fault)
    }
}

impl<I: Iterator<Item = SensorPose>> Iterator for Batch<'_, I> {
    type Item = Result<BatchItem>;

    fn next(&mut self) -> Option<Result<BatchItem>> {
        loop {
            if self.ended {
                return None;
            }
            if let Some(item) = self.done.next() {
                self.ended = item.is_err();
                return Some(item);
            }
            self.ended = !self.advance();
        }
    }
}
