//! Learning from drives: selects frames as views, and believes a view once the robot has driven farther without getting
//! lost.

use crate::change::proposals;
use crate::change::refine::{self, RefinedPose};
use crate::decide::classify;
use crate::decide::findings::{Finding, PlannedView, SiteFindings};
use crate::decide::planner;
use crate::decide::policy::Policy;
use crate::decide::recognize::{self, Recognizer};
use crate::decide::shapes::Library;
use crate::evidence::drive::Drive;
use crate::evidence::features::book::{FeatureViews, KnownFeatures, features_in};
use crate::evidence::file;
use crate::evidence::knowledge::Knowledge;
use crate::evidence::objects::{Evidence, ViewSums};
use crate::observe::compare::Observer;
use crate::observe::pixels::SampledPixels;
use crate::options::LearnOptions;
use presight_localize::localize::{Phase, Step};
use presight_model::environment::{ContentHash, Environment};
use presight_model::error::{Error, Result};
use presight_model::geometry::PoseEstimate;
use presight_model::measured::Frame;
use presight_model::world::World;
use presight_store::ProposedChange;
use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

/// Sensors whose pixels are remembered: each scan of points has its own sensor.
const MAX_SENSORS: usize = 16;

/// Numbers of frames, views and pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Frames.
    pub frames: usize,
    /// Frames that counted as views.
    pub views: usize,
    /// Views that were discarded, because the robot was lost soon after.
    pub discarded: usize,
    /// Pixels of believed views with both a reading and a predicted surface.
    pub compared: usize,
    /// Compared pixels whose reading the prediction explains.
    pub explained: usize,
}

/// Gathers evidence from the frames of drives, one drive after the other, in one world.
pub struct Learner {
    knowledge: Knowledge,
    drive: Drive,
    sensors: Vec<Arc<SampledPixels>>,
    /// Stamp of the world, and the content that frames are compared with.
    stamp: u64,
    content: Option<ContentHash>,
    tally: Tally,
}

impl Learner {
    /// Makes a learner without evidence.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for an option that is not finite or not above 0.
    pub fn new(options: LearnOptions) -> Result<Self> {
        options.check()?;
        Ok(Self {
            knowledge: Knowledge::new(options),
            drive: Drive::default(),
            sensors: Vec::new(),
            stamp: u64::MAX,
            content: None,
            tally: Tally::default(),
        })
    }

    /// Numbers of frames, views and pixels so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// The evidence on each object that a believed view supports or contradicts, by name.
    pub fn evidence(&self, world: &World) -> Vec<(String, Evidence)> {
        self.knowledge.of_objects(world.environment())
    }

    /// The options.
    pub fn options(&self) -> &LearnOptions {
        &self.knowledge.options
    }

    /// Adds the frames of one stamp with the localizer's result. A frame counts only if its pose is determined and
    /// tracked, if the next frame agrees, and if the robot is not lost soon after. A scan that takes time counts in its
    /// middle ([`Frame::at_one_moment`]), by the motion of the localizer.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] if the world differs from that of earlier frames; the errors of
    /// [`Frame::deskewed`].
    pub fn observe(&mut self, world: &World, step: &Step, frames: &[&Frame]) -> Result<()> {
        match step.phase {
            Phase::Tracking if step.estimate.is_determined() => {
                let moving: Vec<Cow<'_, Frame>> = frames.iter().map(|frame| step.moving(frame)).collect();
                let frames: Vec<&Frame> = moving.iter().map(|frame| &**frame).collect();
                let features = self.features(world, step, &frames)?;
                return self.observe_with(world, &frames, &step.pose, features);
            }
            Phase::Tracking | Phase::Kept => {}
            // The robot was not where its estimate had it: views that are not believed yet are wrong.
            _ => self.tally.discarded += self.drive.reset(),
        }
        self.tally.frames += 1;
        Ok(())
    }

    /// The features that the frames of a step show.
    fn features(&mut self, world: &World, step: &Step, frames: &[&Frame]) -> Result<Vec<FeatureViews>> {
        let searched = || frames.iter().filter(|frame| frame.grey().is_some() || frame.intensities().is_some());
        searched().for_each(|frame| self.knowledge.prepare(world, &frame.sensor().spec().class));
        let found = &step.estimate.findings;
        if searched().count() != found.len() {
            // It is unknown which frame belongs to which findings.
            return Ok(Vec::new());
        }
        let environment = &**world.environment();
        let of_frame = |(frame, found): (&&Frame, _)| {
            let known = KnownFeatures { environment, caster: &self.knowledge.casters[&frame.sensor().spec().class] };
            let moment = frame.at_one_moment()?;
            Ok(features_in(&moment.frame, found, &moment.robot(&step.pose), &known))
        };
        searched().zip(found).map(of_frame).collect()
    }

    /// As [`Learner::observe`], at a pose with a known covariance at the stamp, and with the motion of each frame's own
    /// scan ([`Frame::scan_motion`]).
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] if the world differs from that of earlier frames; the errors of
    /// [`Frame::deskewed`].
    pub fn observe_at(&mut self, world: &World, frames: &[&Frame], pose: &PoseEstimate) -> Result<()> {
        self.observe_with(world, frames, pose, Vec::new())
    }

    fn observe_with(
        &mut self,
        world: &World,
        frames: &[&Frame],
        pose: &PoseEstimate,
        features: Vec<FeatureViews>,
    ) -> Result<()> {
        self.check_world(world)?;
        self.tally.frames += 1;
        self.drive.advance(pose.world_from_robot.translation);
        self.believe(self.knowledge.options.settle);
        let Some(stamp) = frames.first().map(|frame| frame.stamp) else { return Ok(()) };
        if self.drive.is_new_view(&pose.world_from_robot, stamp, &self.knowledge.options) {
            for frame in frames.iter().filter(|frame| frame.grey().is_none()) {
                self.add_view(world, frame, pose)?;
            }
            self.drive.end_views(pose.world_from_robot, stamp, features);
        }
        Ok(())
    }

    fn add_view(&mut self, world: &World, frame: &Frame, pose: &PoseEstimate) -> Result<()> {
        let (stamp, moment) = (frame.stamp, frame.at_one_moment()?);
        let (frame, pose) = (&*moment.frame, &moment.robot(pose));
        let class = &frame.sensor().spec().class;
        self.knowledge.prepare(world, class);
        let options = self.knowledge.options;
        let known = self.sensors.iter().find(|pixels| pixels.sensor.spec() == frame.sensor().spec()).cloned();
        let pixels = known.unwrap_or_else(|| {
            let new = Arc::new(SampledPixels::new(frame.sensor(), options.rays));
            self.sensors.truncate(MAX_SENSORS - 1);
            self.sensors.insert(0, new.clone());
            new
        });
        let (caster, priors) = (&self.knowledge.casters[class], &self.knowledge.priors[class]);
        let observer = Observer { caster, priors, views: options.views };
        let (mut view, hits) = observer.view(frame, &pixels, pose);
        (view.drive, view.stamp) = (self.drive.number, stamp);
        let sums = ViewSums::of(&view, &hits, world.environment());
        self.tally.views += 1;
        self.tally.discarded += usize::from(self.drive.add(view, sums, options.views));
        Ok(())
    }

    /// Believes the views since which the robot has driven at least `settle` metres.
    fn believe(&mut self, settle: f64) {
        while let Some(pending) = self.drive.next_believed(settle) {
            self.tally.compared += pending.view.compared.0;
            self.tally.explained += pending.view.compared.1;
            self.knowledge.add(pending);
        }
    }

    /// Ends a drive, and believes its last views if a later frame confirmed them. Another drive may follow.
    pub fn end_drive(&mut self) {
        self.end_log();
        self.drive.number += 1;
    }

    /// Ends the log of one sensor of a drive. The log of another sensor of the same drive may follow.
    pub fn end_log(&mut self) {
        self.believe(0.0);
        self.drive.reset();
    }

    fn check_world(&mut self, world: &World) -> Result<()> {
        if self.stamp == world.stamp() {
            return Ok(());
        }
        let content = world.environment().content_hash();
        self.stamp = world.stamp();
        if *self.content.get_or_insert(content) != content {
            let remedy = "make another learner, or apply changes between drives";
            return Err(Error::usage("the world differs from that of earlier frames", remedy));
        }
        Ok(())
    }

    /// The findings of all drives so far on the world that their frames were compared with. More drives may follow.
    pub fn findings(&mut self, world: &World) -> SiteFindings {
        self.knowledge.prepare(world, &self.knowledge.newest_class());
        classify::findings(&self.knowledge, world)
    }

    /// For each finding the free pose from which predictions with and without it differ most; `None` if no pose shows
    /// it.
    pub fn plan_views(&mut self, world: &World, findings: &[&Finding]) -> Vec<Option<PlannedView>> {
        self.knowledge.prepare(world, &self.knowledge.newest_class());
        planner::plan_views(&self.knowledge, world, findings)
    }

    /// Replaces the boxes of new objects by shapes that explain their points better. Shapes of the library start from
    /// several yaws, shapes that the recognizer names start from its poses. A shape is accepted if the points fix its
    /// pose, if at least 80 % of its visible surface is confirmed and no part of it is decidedly seen through, and if
    /// its odds against boxes are at least [`LearnOptions::decisive`].
    ///
    /// # Errors
    /// Errors of the recognizer, and [`presight_model::ErrorKind::Invalid`] if it names an unknown object. The findings
    /// then lack its further answers.
    pub fn recognize(
        &mut self,
        world: &World,
        findings: &mut SiteFindings,
        library: &Library,
        recognizer: Option<&mut dyn Recognizer>,
    ) -> Result<()> {
        self.knowledge.prepare(world, &self.knowledge.newest_class());
        recognize::recognize(&self.knowledge, world, findings, library, recognizer)
    }

    /// The poses of confirmed objects, by Bayes from what the model states: the covariances of the sensor's layer, or
    /// the deviation of surfaces. Empty for a model that states neither, because it is exact. An object that sensors of
    /// several classes saw follows the class with the most views of it.
    #[doc(hidden)]
    pub fn refined(&self, environment: &Environment, findings: &SiteFindings) -> Vec<RefinedPose> {
        refine::refined(&self.knowledge, environment, findings)
    }

    /// The changes that follow from findings, each with its id, its cause and its evidence.
    ///
    /// `base` names the version of the model that the findings refer to. It is part of the ids, so that no change is
    /// applied twice. `utc` is added to the stamps of frames, seconds. The policy selects the findings that change the
    /// model, and the findings that only mark it. Marks that the model has already are left out.
    ///
    /// # Errors
    /// Errors of [`ProposedChange::new`].
    pub fn changes(
        &self,
        findings: &SiteFindings,
        world: &World,
        (base, utc): (&str, f64),
        policy: &Policy,
    ) -> Result<Vec<ProposedChange>> {
        proposals::changes(&self.knowledge, findings, world, (base, utc), policy)
    }

    /// The share of the measured points of the kept views that lie within some metres of the predicted surface.
    pub fn share_explained(&self, world: &World, within: f64) -> f64 {
        self.knowledge.share_explained(world, within)
    }

    /// Writes all evidence to a file, completely or not at all. `map` names the map that the evidence belongs to.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the file cannot be written.
    pub fn save(&self, path: &Path, environment: &Environment, map: &str) -> Result<()> {
        file::save(&self.knowledge, path, environment, map)
    }

    /// Adds the evidence of a file. Evidence on objects that were removed or moved since is left out; returns their
    /// number.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if it is not a file of evidence, or belongs to another map;
    /// [`presight_model::ErrorKind::Unsupported`] for a newer format; [`presight_model::ErrorKind::System`] if it
    /// cannot be read.
    pub fn load(&mut self, path: &Path, environment: &Environment, map: &str) -> Result<usize> {
        file::load(&mut self.knowledge, path, environment, map)
    }

    /// Forgets the evidence that a new model has used: on the changed objects, and on new objects near its surfaces.
    pub fn forget(&mut self, world: &World, changed: &[String]) {
        self.knowledge.forget(world, changed);
    }
}
