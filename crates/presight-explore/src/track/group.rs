//! Groups of frames whose poses are found on the way: each frame of a group was localized in the model of those before it.

use crate::change::{Exploration, Known};
use crate::observe::{View, Views};
use crate::surface::ExploreOptions;
use glam::DVec3;
use presight_localize::estimate::{Estimate, EstimateOptions, Estimator};
use presight_localize::localize::{LocalizeOptions, Localizer, Phase};
use presight_localize::verdict::Verdict;
use presight_model::environment::Environment;
use presight_model::error::Result;
use presight_model::geometry::{InWorld, Pose, PoseCovariance, PoseEstimate};
use presight_model::matrix::{add_to, sandwich, turn};
use presight_model::measured::Frame;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};

/// Views that the model is made from while the sensor moves on.
const KEY_VIEWS: usize = 40;
/// The model is made again when there are this many more views, as a share.
const GROWTH: f64 = 0.12;
/// Standard deviation of surfaces that few views show, metres.
const MODEL_SIGMA: f64 = 0.005;
/// Standard deviations of the pose at a start, metres and radians.
const START_SIGMA: f64 = 0.01;
/// A pose that is searched is at most about so far from where the search starts: metres, radians.
const REACH: (f64, f64) = (0.5, 0.4);
/// Share of its points that a frame must explain before other starts are tried, and that a frame of this place explains at least.
const PROMISING: f64 = 0.5;
/// Share of the pixels that can be compared with the model that must agree.
const JOINED: f64 = 0.8;

fn estimator(options: &ExploreOptions, estimates: EstimateOptions) -> Result<Estimator> {
    let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(options.threads.clone()))?;
    Ok(Estimator::new(predictor, estimates.with_model_sigma(MODEL_SIGMA)))
}

/// Finds single frames in models.
pub(crate) struct Searcher {
    /// Without other starts: they take seconds where nothing is known.
    quick: Estimator,
    full: Estimator,
}

impl Searcher {
    pub fn new(options: &ExploreOptions) -> Result<Self> {
        let estimates = |least: f64| EstimateOptions::default().with_least_explained(least);
        Ok(Self { quick: estimator(options, estimates(0.0))?, full: estimator(options, estimates(PROMISING))? })
    }

    /// The pose of the robot at a frame, about within reach of another pose.
    fn find(&mut self, world: &World, frame: &Frame, near: Pose) -> Result<Option<PoseEstimate>> {
        let prior = PoseEstimate::of_sigmas(near, REACH.0, REACH.1);
        let first = self.quick.estimate(world, &[frame], &prior)?;
        if first.explained < PROMISING {
            return Ok(None);
        }
        let prior = PoseEstimate::of_sigmas(first.pose.world_from_robot, 0.5 * REACH.0, 0.5 * REACH.1);
        Ok(sure(&self.full.estimate(world, &[frame], &prior)?))
    }
}

/// True if a pose is known in the model as well as the pose of the first frame, so that its view may be added. A floor alone does not suffice.
fn is_sure(pose: &PoseEstimate) -> bool {
    (0..6).all(|i| pose.covariance.as_rows()[i][i] <= START_SIGMA * START_SIGMA)
}

/// The pose if a search found it: the frame shows known surfaces in most of its pixels, and little else where something is known.
fn sure(estimate: &Estimate) -> Option<PoseEstimate> {
    let count = |verdict: Verdict| estimate.verdicts.iter().map(|v| v.counts()[verdict as usize]).sum::<usize>() as f64;
    let confirmed = count(Verdict::Confirmed);
    let compared = confirmed + count(Verdict::Nearer) + count(Verdict::Farther) + count(Verdict::NoReturn);
    let all = compared + count(Verdict::NotPredicted);
    let is_found = confirmed > JOINED * compared && confirmed > 0.5 * all;
    (is_found && estimate.is_determined() && is_sure(&estimate.pose)).then_some(estimate.pose)
}

fn robot_pose(view: &View) -> Pose {
    view.world_from_sensor * view.sensor().spec().mount.inverse()
}

/// The model of a group, with which it is followed.
struct Model {
    world: World,
    localizer: Localizer,
}

/// Frames in one frame of reference.
pub(crate) struct Group {
    known: Environment,
    kind: Known,
    pub views: Views,
    /// Numbers of views from places half a reach apart.
    places: Vec<usize>,
    model: Option<Model>,
    /// Number of views when the model was made, and of places.
    made_of: (usize, usize),
    /// Covariance of the surfaces added last, against the first frame, for a rotation about `centre`.
    covariance: PoseCovariance<InWorld>,
    /// Where the robot was when these surfaces were added.
    centre: DVec3,
    /// Covariance of the last pose, against these surfaces.
    last: PoseCovariance<InWorld>,
    /// The last pose of the robot that was found.
    found: Pose,
}

impl Group {
    /// Starts with a frame at this pose of the robot.
    pub fn new(
        frame: &Frame,
        world_from_robot: Pose,
        (known, kind): (Environment, Known),
        options: &ExploreOptions,
    ) -> Result<Self> {
        let mut group = Self {
            known,
            kind,
            views: Views::default(),
            places: Vec::new(),
            model: None,
            made_of: (0, 0),
            covariance: PoseCovariance::ZERO,
            centre: world_from_robot.translation,
            last: PoseCovariance::ZERO,
            found: world_from_robot,
        };
        group.push(frame, &PoseEstimate::exact(world_from_robot))?;
        group.make(options)?;
        Ok(group)
    }

    fn push(&mut self, frame: &Frame, pose: &PoseEstimate) -> Result<()> {
        self.views.push(frame, pose.world_from_robot * frame.sensor().spec().mount)?;
        (self.found, self.last) = (pose.world_from_robot, pose.covariance);
        self.add_place(self.views.all().len() - 1);
        Ok(())
    }

    fn add_place(&mut self, number: usize) {
        let pose = |number: &usize| robot_pose(&self.views.all()[*number]);
        let own = pose(&number);
        let is_near = |other: Pose| {
            own.translation.distance(other.translation) < 0.5 * REACH.0
                && own.rotation.angle_between(other.rotation) < 0.5 * REACH.1
        };
        if !self.places.iter().any(|place| is_near(pose(place))) {
            self.places.push(number);
        }
    }

    /// Localizes a frame after the one before, or near the last pose that was found, and adds it. `None` if it shows nothing known.
    pub fn add(&mut self, frame: &Frame, by: &mut Searcher, options: &ExploreOptions) -> Result<Option<PoseEstimate>> {
        let Some(Model { world, localizer }) = &mut self.model else { return Ok(None) };
        let step = localizer.step(world, frame)?;
        // Nothing is known of the motion before the second frame, so that it must hold its pose by itself.
        let is_held = self.views.all().len() > 1 || step.estimate.weak.is_empty();
        let is_followed = matches!(step.phase, Phase::Tracking | Phase::Candidates) && step.estimate.is_determined();
        if is_held && is_followed && is_sure(&step.pose) {
            self.push(frame, &step.pose)?;
            return Ok(Some(step.pose));
        }
        self.add_again(frame, by, options)
    }

    /// Localizes a frame near the last pose that was found, and adds it. `None` if it shows nothing known.
    pub fn add_again(
        &mut self,
        frame: &Frame,
        by: &mut Searcher,
        options: &ExploreOptions,
    ) -> Result<Option<PoseEstimate>> {
        let Some(Model { world, localizer }) = &mut self.model else { return Ok(None) };
        let Some(pose) = by.find(world, frame, self.found)? else { return Ok(None) };
        *localizer = followed(world, frame, pose.world_from_robot, options)?;
        self.push(frame, &pose)?;
        Ok(Some(pose))
    }

    /// The model is made again if there are many more views than before. Returns true then.
    pub fn grow(&mut self, options: &ExploreOptions) -> Result<bool> {
        let (more, before) = (self.views.all().len() - self.made_of.0, self.made_of.0);
        let is_due = more as f64 >= (GROWTH * before as f64).max(2.0);
        if is_due {
            // Surfaces added now are as far off as this pose: errors of one model pass into the next.
            (self.covariance, self.centre) = (self.drift(), self.found.translation);
            self.make(options)?;
        }
        Ok(is_due)
    }

    /// Makes the model of some of the views, the last one among them.
    pub fn make(&mut self, options: &ExploreOptions) -> Result<()> {
        let found = Exploration::of(&self.known, self.kind, &self.views.some(KEY_VIEWS), options)?;
        let world = World::new(found.environment().clone());
        let localizer = match (self.model.take(), self.views.all().last()) {
            (Some(model), _) => model.localizer,
            (None, Some(last)) => followed(&world, &last.frame()?, self.found, options)?,
            (None, None) => return Ok(()),
        };
        self.model = Some(Model { world, localizer });
        self.made_of.0 = self.views.all().len();
        Ok(())
    }

    /// Forgets the model: a group that is not followed needs its views alone.
    pub fn rest(&mut self) {
        self.model = None;
    }

    /// Covariance of the last pose against the first.
    pub fn drift(&self) -> PoseCovariance<InWorld> {
        sum(&self.covariance.moved_by(self.found.translation - self.centre), &self.last)
    }

    /// The pose of another group's frame of reference in this one, with the covariance of its origin, from a frame of the other that shows
    /// this model. Frames of the other are tried at the places that came in since the last comparison, the newest first, while `pairs` are
    /// left.
    pub fn pose_of(&self, other: &Self, by: &mut Searcher, pairs: &mut usize) -> Result<Option<PoseEstimate>> {
        let Some(Model { world, .. }) = &self.model else { return Ok(None) };
        for own in self.places[self.made_of.1..].iter().rev() {
            for place in other.places.iter().rev().take(*pairs) {
                *pairs -= 1;
                let view = &other.views.all()[*place];
                let near = robot_pose(&self.views.all()[*own]);
                if let Some(pose) = by.find(world, &view.frame()?, near)? {
                    let own_from_other = pose.world_from_robot * robot_pose(view).inverse();
                    let lever = own_from_other.translation - pose.world_from_robot.translation;
                    return Ok(Some(PoseEstimate::new(own_from_other, pose.covariance.moved_by(lever))));
                }
            }
        }
        Ok(None)
    }

    /// Places that were compared with all other groups need no other comparison.
    pub fn compared(&mut self) {
        self.made_of.1 = self.places.len();
    }

    /// Takes in another group, at this pose of its frame of reference. `goes_on` says that the other is followed.
    pub fn join(&mut self, other: Self, pose: &PoseEstimate, goes_on: bool, options: &ExploreOptions) -> Result<()> {
        let moved = pose.world_from_robot;
        let centre = if goes_on { moved.transform_point(other.centre) } else { self.centre };
        let met = pose.covariance.moved_by(centre - moved.translation);
        self.covariance = sum(&self.covariance.moved_by(centre - self.centre), &met);
        self.centre = centre;
        let others = other.views.moved(&moved);
        // The followed group has the last view.
        let (first, second) =
            if goes_on { (std::mem::take(&mut self.views), others) } else { (others, std::mem::take(&mut self.views)) };
        self.views = first.with(second);
        if goes_on {
            let turned =
                |c: &PoseCovariance<InWorld>| PoseCovariance::from_rows(sandwich(&turn(moved.rotation), c.as_rows()));
            self.covariance = sum(&self.covariance, &turned(&other.covariance));
            (self.last, self.found) = (turned(&other.last), moved * other.found);
            self.model = None;
        }
        self.places.clear();
        (0..self.views.all().len()).for_each(|number| self.add_place(number));
        self.made_of.1 = 0;
        self.make(options)
    }
}

/// Covariance of a pose with two independent errors.
fn sum(a: &PoseCovariance<InWorld>, b: &PoseCovariance<InWorld>) -> PoseCovariance<InWorld> {
    let mut rows = *a.as_rows();
    add_to(&mut rows, b.as_rows());
    PoseCovariance::from_rows(rows)
}

/// A localizer that has seen this frame at this pose. It knows then when that was, and that the robot moves until the next frame.
fn followed(world: &World, frame: &Frame, world_from_robot: Pose, options: &ExploreOptions) -> Result<Localizer> {
    let start = PoseEstimate::of_sigmas(world_from_robot, START_SIGMA, START_SIGMA);
    let estimator = estimator(options, EstimateOptions::default())?;
    let mut localizer = Localizer::new(estimator, start, LocalizeOptions::default());
    localizer.step(world, frame)?;
    Ok(localizer)
}
