//! Learning from a drive: which frames count, and when they are believed.

use crate::caster::Caster;
use crate::evidence::{Book, Delta, Evidence, Pixels};
use crate::features::{Known, LookBook, Looked, looks_of};
use crate::joint::Joint;
use crate::priors::Priors;
use crate::pulled::Pulled;
use crate::view::{Kept, Observer, View};
use crate::voxels::Voxels;
use glam::DVec3;
use presight_localize::localize::{Phase, Step};
use presight_model::environment::ContentHash;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::measured::Frame;
use presight_model::world::World;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// How a [`Learner`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct LearnOptions {
    /// A frame counts as another view after this way, metres,
    pub apart: f64,
    /// or after this turn, radians,
    pub apart_turn: f64,
    /// or after this time, seconds.
    pub apart_time: f64,
    /// Most that a view counts, natural logarithm of odds.
    pub most_per_view: f64,
    /// Fewest views that decide.
    pub least_views: u32,
    /// Odds that decide, natural logarithm.
    pub sure: f64,
    /// The share of an object's decided cells that have to agree.
    pub least_agreeing: f64,
    /// Metres that a robot drives on without getting lost before a view is believed.
    pub settle: f64,
    /// Edge of the voxels of new things, metres.
    pub voxel: f64,
    /// Rays of a frame that are looked at.
    pub rays: usize,
    /// Views that are kept, to fit objects to.
    pub views: usize,
    /// Deviation of the model's surfaces, metres.
    pub model_sigma: f64,
}

impl Default for LearnOptions {
    fn default() -> Self {
        Self {
            apart: 0.25,
            apart_turn: 10f64.to_radians(),
            apart_time: 60.0,
            most_per_view: 3.0,
            least_views: 3,
            sure: 9.0,
            least_agreeing: 0.8,
            settle: 2.0,
            voxel: 0.1,
            rays: 8000,
            views: 400,
            model_sigma: 0.0,
        }
    }
}

presight_model::with_options!(
    LearnOptions:
    with_apart apart: f64,
    with_apart_turn apart_turn: f64,
    with_apart_time apart_time: f64,
    with_most_per_view most_per_view: f64,
    with_least_views least_views: u32,
    with_sure sure: f64,
    with_least_agreeing least_agreeing: f64,
    with_settle settle: f64,
    with_voxel voxel: f64,
    with_rays rays: usize,
    with_views views: usize,
    with_model_sigma model_sigma: f64,
);

/// Points nearer than this to a surface of the model belong to it, metres.
const KNOWN: f64 = 0.05;

/// How many frames and views a learner saw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Frames.
    pub frames: usize,
    /// Frames that counted as views.
    pub views: usize,
    /// Views that were thrown away, because the robot turned out to be lost.
    pub discarded: usize,
    /// Pixels of believed views with a reading where something is predicted,
    pub compared: usize,
    /// and the share of them that the prediction explains, as a number.
    pub explained: usize,
}

/// Gathers evidence from the frames of drives, one drive after the other, in one world.
pub struct Learner {
    pub(crate) options: LearnOptions,
    stamp: u64,
    /// The content that frames are compared with.
    content: Option<ContentHash>,
    pub(crate) casters: BTreeMap<String, Caster>,
    pub(crate) priors: BTreeMap<String, Priors>,
    /// How objects stand, by class of sensors.
    pub(crate) joints: BTreeMap<String, Joint>,
    kept: Vec<Arc<Kept>>,
    pub(crate) book: Book,
    pub(crate) looks: LookBook,
    pub(crate) voxels: Voxels,
    /// The newest views that are believed, at most [`LearnOptions::views`].
    pub(crate) views: VecDeque<View>,
    pending: VecDeque<Pending>,
    /// Place of the robot in the last view, and its stamp.
    last: Option<(Pose, f64)>,
    /// Way since the start of the drive, metres, and the place it is counted from.
    way: (f64, Option<DVec3>),
    tally: Tally,
    /// How far the readings pulled the poses of believed views.
    pub(crate) pulled: Pulled,
    drive: usize,
}

/// A view that is not believed yet.
struct Pending {
    view: View,
    delta: Delta,
    looks: Vec<Looked>,
    way: f64,
    /// The next frame agreed.
    followed: bool,
}

impl Learner {
    /// Makes a learner without evidence.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for an option that is not finite or not above 0.
    pub fn new(options: LearnOptions) -> Result<Self> {
        let o = &options;
        for (name, value) in [
            ("apart", o.apart),
            ("apart_turn", o.apart_turn),
            ("apart_time", o.apart_time),
            ("most_per_view", o.most_per_view),
            ("sure", o.sure),
            ("least_agreeing", o.least_agreeing),
            ("voxel", o.voxel),
            ("rays", o.rays as f64),
            ("views", o.views as f64),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::usage(format!("{name} of {value}"), "give a finite number above 0"));
            }
        }
        if !(o.model_sigma >= 0.0 && o.model_sigma.is_finite() && o.settle >= 0.0) {
            let what = format!("model_sigma of {} and settle of {}", o.model_sigma, o.settle);
            return Err(Error::usage(what, "give finite metres of at least 0"));
        }
        Ok(Self {
            options,
            stamp: u64::MAX,
            content: None,
            casters: BTreeMap::new(),
            priors: BTreeMap::new(),
            joints: BTreeMap::new(),
            kept: Vec::new(),
            book: Book::default(),
            looks: LookBook::default(),
            voxels: Voxels::new(options.voxel),
            views: VecDeque::new(),
            pending: VecDeque::new(),
            last: None,
            way: (0.0, None),
            tally: Tally::default(),
            pulled: Pulled::default(),
            drive: 0,
        })
    }

    /// Frames and views so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// The evidence on each object that a believed view said something of, by name.
    pub fn evidence(&self, world: &World) -> Vec<(String, Evidence)> {
        let objects = world.environment().objects();
        self.book.objects.iter().map(|(object, e)| (objects[*object as usize].name.clone(), *e)).collect()
    }

    /// What pixels of believed views say of an object: why it is decided, or not. `None` if no ray met it.
    #[doc(hidden)]
    pub fn pixels(&self, world: &World, object: &str) -> Option<Pixels> {
        self.book.pixels.get(&world.environment().index_of(object).ok()?).copied()
    }

    /// The options.
    pub fn options(&self) -> &LearnOptions {
        &self.options
    }

    /// Takes in the frames of one time with what a localizer made of them. A frame teaches only if its pose is
    /// determined and tracked, if the next frame agrees, and if the robot does not turn out to be lost soon after.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a world other than that of the frames before.
    pub fn observe(&mut self, world: &World, step: &Step, frames: &[&Frame]) -> Result<()> {
        match step.phase {
            Phase::Tracking if step.estimate.is_determined() => {
                let looked = || frames.iter().filter(|frame| frame.grey().is_some() || frame.intensities().is_some());
                for frame in looked() {
                    self.caster(world, &frame.sensor().spec().class);
                }
                let found = &step.estimate.findings;
                // Otherwise nobody knows which frame shows what.
                let is_paired = looked().count() == found.len();
                let looks = looked().zip(found).filter(|_| is_paired);
                let environment = &**world.environment();
                let looks = looks.map(|(frame, found)| {
                    let known = Known { environment, caster: &self.casters[&frame.sensor().spec().class] };
                    looks_of(frame, found, &step.pose, &known)
                });
                let looks = looks.collect();
                self.observe_with(world, frames, &step.pose, looks)
            }
            Phase::Tracking | Phase::Candidates if !self.is_searching(step) => {
                self.tally.frames += 1;
                Ok(())
            }
            _ => {
                self.tally.frames += 1;
                self.discard();
                Ok(())
            }
        }
    }

    fn is_searching(&self, step: &Step) -> bool {
        step.phase == Phase::Candidates && !step.candidates.is_empty()
    }

    /// As [`Learner::observe`], at a pose that is known as well as its covariance says.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a world other than that of the frames before.
    pub fn observe_at(&mut self, world: &World, frames: &[&Frame], pose: &PoseEstimate) -> Result<()> {
        self.observe_with(world, frames, pose, Vec::new())
    }

    fn observe_with(
        &mut self,
        world: &World,
        frames: &[&Frame],
        pose: &PoseEstimate,
        looks: Vec<Looked>,
    ) -> Result<()> {
        self.follow(world)?;
        self.tally.frames += 1;
        self.pending.iter_mut().for_each(|pending| pending.followed = true);
        let place = pose.world_from_robot.translation;
        self.way.0 += self.way.1.replace(place).map_or(0.0, |before| before.distance(place));
        self.believe(false);
        let Some(stamp) = frames.first().map(|frame| frame.stamp) else { return Ok(()) };
        if self.is_view(&pose.world_from_robot, stamp) {
            frames.iter().filter(|frame| frame.grey().is_none()).for_each(|frame| self.take(world, frame, pose));
            // With the last of the views of this time, which are believed or thrown away together.
            if let Some(last) = self.pending.back_mut() {
                last.looks = looks;
            }
            self.last = Some((pose.world_from_robot, stamp));
        }
        Ok(())
    }

    fn is_view(&self, pose: &Pose, stamp: f64) -> bool {
        let o = &self.options;
        self.last.is_none_or(|(last, then)| {
            last.translation.distance(pose.translation) >= o.apart
                || last.rotation.angle_between(pose.rotation) >= o.apart_turn
                || stamp - then >= o.apart_time
        })
    }

    fn take(&mut self, world: &World, frame: &Frame, pose: &PoseEstimate) {
        let class = &frame.sensor().spec().class;
        if !self.casters.contains_key(class) {
            self.casters.insert(class.clone(), Caster::new(world, class));
        }
        if !self.priors.contains_key(class) {
            let priors = Priors::of(world.environment(), class, self.options.model_sigma);
            self.priors.insert(class.clone(), priors);
        }
        let kept = self.kept.iter().find(|kept| kept.sensor.spec() == frame.sensor().spec()).cloned();
        let kept = kept.unwrap_or_else(|| {
            let new = Arc::new(Kept::new(frame.sensor(), self.options.rays));
            // Each scan of points has a sensor of its own.
            self.kept.truncate(15);
            self.kept.insert(0, new.clone());
            new
        });
        let (caster, priors) = (&self.casters[class], &self.priors[class]);
        let observer = Observer { caster, priors, views: self.options.views, known: KNOWN };
        let (mut view, met) = observer.view(frame, &kept, pose);
        view.drive = self.drive;
        let delta = Delta::of(&view, &met, world.environment());
        self.tally.views += 1;
        // A robot that turns about for hours in one place never drives on.
        if self.pending.len() >= self.options.views {
            self.pending.pop_front();
            self.tally.discarded += 1;
        }
        self.pending.push_back(Pending { view, delta, looks: Vec::new(), way: self.way.0, followed: false });
    }

    /// Believes views of long enough ago, or all that the next frame agreed with.
    fn believe(&mut self, all: bool) {
        while let Some(first) = self.pending.front() {
            if !(first.followed && (all || self.way.0 - first.way >= self.options.settle)) {
                break;
            }
            let Some(Pending { view, delta, looks, .. }) = self.pending.pop_front() else { break };
            self.pulled.add(&view.pulled);
            self.tally.compared += view.compared.0;
            self.tally.explained += view.compared.1;
            self.book.add(&delta, (view.stamp, &view.kept.sensor.spec().class), &self.options);
            looks.iter().for_each(|looked| self.looks.add(looked, view.stamp));
            if let Some(terms) = &view.terms {
                self.joints.entry(view.kept.sensor.spec().class.clone()).or_default().add(terms);
            }
            let size = self.voxels.size();
            for key in self.voxels.add_view(&view.news, |voxel| view.passed(&voxel.spot(size), size)) {
                let Some(spot) = self.voxels.spot(key) else { continue };
                let before = self.views.iter().filter(|earlier| earlier.passed(&spot, size)).count();
                self.voxels.add_passes(key, before as u32);
            }
            if self.views.len() >= self.options.views {
                self.views.pop_front();
            }
            self.views.push_back(view);
        }
    }

    /// Throws away views that are not believed yet: the robot was not where it thought to be.
    fn discard(&mut self) {
        self.tally.discarded += self.pending.len();
        self.pending.clear();
        (self.last, self.way) = (None, (0.0, None));
    }

    /// Ends a drive: what the next frame agreed with is believed. Another drive may follow.
    pub fn end_drive(&mut self) {
        self.end_way();
        self.drive += 1;
    }

    /// Ends the log of one sensor of a drive. The log of another sensor of the same drive may follow.
    pub fn end_way(&mut self) {
        self.believe(true);
        self.pending.clear();
        (self.last, self.way) = (None, (0.0, None));
    }

    fn follow(&mut self, world: &World) -> Result<()> {
        if self.stamp == world.stamp() {
            return Ok(());
        }
        let content = world.environment().content_hash();
        self.stamp = world.stamp();
        if *self.content.get_or_insert(content) != content {
            let remedy = "make another learner, or apply changes between drives";
            return Err(Error::usage("frames of another world than those before", remedy));
        }
        Ok(())
    }

    pub(crate) fn caster(&mut self, world: &World, class: &str) -> &Caster {
        self.casters.entry(class.to_owned()).or_insert_with(|| Caster::new(world, class))
    }
}
