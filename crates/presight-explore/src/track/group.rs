//! Groups of frames in one frame of reference: each frame was localized in the model of the frames before it.

use crate::change::{Exploration, Known};
use crate::observe::{View, Views};
use crate::surface::ExploreOptions;
use glam::DVec3;
use presight_localize::estimate::{Estimate, EstimateOptions, Estimator};
use presight_localize::localize::{LocalizeOptions, Localizer, Phase};
use presight_localize::verdict::Verdict;
use presight_model::environment::Environment;
use presight_model::error::Result;
use presight_model::geometry::{InWorld, Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{add_to, sandwich, turn};
use presight_model::measured::Frame;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};

/// Maximum number of views in an intermediate model.
const KEY_VIEWS: usize = 40;
/// Growth of the number of views, as a share, after which the model is built again.
const GROWTH: f64 = 0.12;
/// Standard deviation of surfaces in few views, metres.
const MODEL_SIGMA: f64 = 0.005;
/// Standard deviations of a start pose, metres and radians.
const START_SIGMA: f64 = 0.01;
/// Standard deviations of the prior of a search, metres and radians.
const REACH: (f64, f64) = (0.5, 0.4);
/// Minimum explained share of a frame's points: below it a quick search is given up, and a full search tries more
/// starts.
const PROMISING: f64 = 0.5;
/// Minimum share of confirmed pixels among the pixels that can be compared with the model.
const CONFIRMED: f64 = 0.8;

fn estimator(options: &ExploreOptions, estimates: EstimateOptions) -> Result<Estimator> {
    let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(options.threads.clone()))?;
    Ok(Estimator::new(predictor, estimates.with_model_sigma(MODEL_SIGMA)))
}

/// Searches the poses of single frames in models.
pub(crate) struct Searcher {
    /// A search without further starts, which would take seconds in unknown surroundings.
    quick: Estimator,
    /// A search with further starts.
    full: Estimator,
}

impl Searcher {
    pub fn new(options: &ExploreOptions) -> Result<Self> {
        let estimates = |min: f64| EstimateOptions::default().with_least_explained(min);
        Ok(Self { quick: estimator(options, estimates(0.0))?, full: estimator(options, estimates(PROMISING))? })
    }

    /// The pose of the robot at a frame, with another pose as the prior; `None` if it is not found.
    fn find(&mut self, world: &World, frame: &Frame, near: Pose) -> Result<Option<PoseEstimate>> {
        let prior = PoseEstimate::of_sigmas(RobotPose::new(near), REACH.0, REACH.1);
        let first = self.quick.estimate(world, &[frame], &prior)?;
        if first.explained < PROMISING {
            return Ok(None);
        }
        let prior = PoseEstimate::of_sigmas(first.pose.robot(), 0.5 * REACH.0, 0.5 * REACH.1);
        Ok(accepted(&self.full.estimate(world, &[frame], &prior)?))
    }
}

/// True if a pose is as precise as the pose of the first frame, so that its view may be added to the model. A view of a
/// floor alone does not determine such a pose.
fn is_precise(pose: &PoseEstimate) -> bool {
    (0..6).all(|i| pose.covariance.as_rows()[i][i] <= START_SIGMA * START_SIGMA)
}

/// The pose of an estimate if it is accepted: most pixels confirm the model, few of the comparable ones contradict it,
/// and the pose is precise.
fn accepted(estimate: &Estimate) -> Option<PoseEstimate> {
    let count = |verdict: Verdict| estimate.verdicts.iter().map(|v| v.counts()[verdict as usize]).sum::<usize>() as f64;
    let confirmed = count(Verdict::Confirmed);
    let compared = confirmed + count(Verdict::Nearer) + count(Verdict::Farther) + count(Verdict::NoReturn);
    let all = compared + count(Verdict::NotPredicted);
    let is_found = confirmed > CONFIRMED * compared && confirmed > 0.5 * all;
    (is_found && estimate.is_determined() && is_precise(&estimate.pose)).then_some(estimate.pose)
}

fn robot_pose(view: &View) -> Pose {
    view.pose.robot(view.sensor()).world_from_robot()
}

/// The model of a group, with the localizer that follows the group in it.
struct Model {
    world: World,
    localizer: Localizer,
}

/// A group of frames in one frame of reference.
pub(crate) struct Group {
    known: Environment,
    kind: Known,
    pub views: Views,
    /// Indices of views at least half a [`REACH`] apart.
    places: Vec<usize>,
    model: Option<Model>,
    /// Numbers of the views in the model, and of the places that were compared.
    used: (usize, usize),
    /// Covariance of the surfaces that were added last, relative to the first frame, for rotations about `centre`.
    covariance: PoseCovariance<InWorld>,
    /// Position of the robot when these surfaces were added, metres.
    centre: DVec3,
    /// Covariance of the last pose, relative to these surfaces.
    last: PoseCovariance<InWorld>,
    /// Pose of the robot at the last added frame.
    found: Pose,
}

impl Group {
    /// A group of one frame at the given pose of the robot.
    pub fn new(
        frame: &Frame,
        robot: RobotPose,
        (known, kind): (Environment, Known),
        options: &ExploreOptions,
    ) -> Result<Self> {
        let mut group = Self {
            known,
            kind,
            views: Views::default(),
            places: Vec::new(),
            model: None,
            used: (0, 0),
            covariance: PoseCovariance::ZERO,
            centre: robot.world_from_robot().translation,
            last: PoseCovariance::ZERO,
            found: robot.world_from_robot(),
        };
        group.push(frame, &PoseEstimate::exact(robot))?;
        group.build(options)?;
        Ok(group)
    }

    fn push(&mut self, frame: &Frame, pose: &PoseEstimate) -> Result<()> {
        self.views.push(frame, pose.robot().sensor(frame.sensor()))?;
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

    /// Adds the next frame, after tracking it or searching near the last pose. `None` if the frame does not show the
    /// model.
    pub fn add(&mut self, frame: &Frame, by: &mut Searcher, options: &ExploreOptions) -> Result<Option<PoseEstimate>> {
        let Some(Model { world, localizer }) = &mut self.model else { return Ok(None) };
        let step = localizer.step(world, frame)?;
        // The motion is unknown before the second frame, so the measurement alone must determine all directions.
        let is_constrained = self.views.all().len() > 1 || step.estimate.weak.is_empty();
        let is_followed = matches!(step.phase, Phase::Tracking | Phase::Kept) && step.estimate.is_determined();
        if is_constrained && is_followed && is_precise(&step.pose) {
            self.push(&step.moving(frame), &step.pose)?;
            return Ok(Some(step.pose));
        }
        self.add_again(frame, by, options)
    }

    /// Adds a frame after searching near the last pose. `None` if the frame does not show the model.
    pub fn add_again(
        &mut self,
        frame: &Frame,
        by: &mut Searcher,
        options: &ExploreOptions,
    ) -> Result<Option<PoseEstimate>> {
        let Some(Model { world, localizer }) = &mut self.model else { return Ok(None) };
        let moment = frame.at_one_moment()?;
        let Some(pose) = by.find(world, &moment.frame, self.found)? else { return Ok(None) };
        *localizer = started(world, &moment.frame, pose.robot(), options)?;
        let pose = moment.robot_at_stamp(&pose);
        self.push(frame, &pose)?;
        Ok(Some(pose))
    }

    /// Builds the model again if the number of views grew enough. Returns true if it did.
    pub fn grow(&mut self, options: &ExploreOptions) -> Result<bool> {
        let (more, before) = (self.views.all().len() - self.used.0, self.used.0);
        let is_due = more as f64 >= (GROWTH * before as f64).max(2.0);
        if is_due {
            // The new surfaces share the error of this pose, so errors accumulate from model to model.
            (self.covariance, self.centre) = (self.drift(), self.found.translation);
            self.build(options)?;
        }
        Ok(is_due)
    }

    /// Builds the model from some of the views, including the last one.
    pub fn build(&mut self, options: &ExploreOptions) -> Result<()> {
        let found = Exploration::of(&self.known, self.kind, &self.views.some(KEY_VIEWS), options)?;
        let world = World::new(found.environment().clone());
        let localizer = match (self.model.take(), self.views.all().last()) {
            (Some(model), _) => model.localizer,
            (None, Some(last)) => started(&world, &last.frame()?, RobotPose::new(robot_pose(last)), options)?,
            (None, None) => return Ok(()),
        };
        self.model = Some(Model { world, localizer });
        self.used.0 = self.views.all().len();
        Ok(())
    }

    /// Drops the model, which a group needs only while it is followed.
    pub fn rest(&mut self) {
        self.model = None;
    }

    /// Covariance of the last pose relative to the first.
    pub fn drift(&self) -> PoseCovariance<InWorld> {
        sum(&self.covariance.moved_by(self.found.translation - self.centre), &self.last)
    }

    /// The pose of another group's frame of reference in this one, from a frame of the other group that shows this
    /// model. The covariance is that of the other frame's origin. Frames of the other group are tried at the places
    /// since the last comparison, the newest first, until no `pairs` are left.
    pub fn pose_of(&self, other: &Self, by: &mut Searcher, pairs: &mut usize) -> Result<Option<PoseEstimate>> {
        let Some(Model { world, .. }) = &self.model else { return Ok(None) };
        for own in self.places[self.used.1..].iter().rev() {
            for place in other.places.iter().rev().take(*pairs) {
                *pairs -= 1;
                let view = &other.views.all()[*place];
                let near = robot_pose(&self.views.all()[*own]);
                if let Some(pose) = by.find(world, &view.frame()?, near)? {
                    let own_from_other = pose.world_from_robot * robot_pose(view).inverse();
                    let lever = own_from_other.translation - pose.world_from_robot.translation;
                    return Ok(Some(PoseEstimate::new(
                        RobotPose::new(own_from_other),
                        pose.covariance.moved_by(lever),
                    )));
                }
            }
        }
        Ok(None)
    }

    /// Records that all places were compared with all other groups.
    pub fn compared(&mut self) {
        self.used.1 = self.places.len();
    }

    /// Takes in another group with the pose of its frame of reference. `is_followed` is true if the other group is the
    /// followed one.
    pub fn join(
        &mut self,
        other: Self,
        pose: &PoseEstimate,
        is_followed: bool,
        options: &ExploreOptions,
    ) -> Result<()> {
        let moved = pose.world_from_robot;
        let centre = if is_followed { moved.transform_point(other.centre) } else { self.centre };
        let connection = pose.covariance.moved_by(centre - moved.translation);
        self.covariance = sum(&self.covariance.moved_by(centre - self.centre), &connection);
        self.centre = centre;
        let others = other.views.moved(&moved);
        // The last view comes from the followed group.
        let (first, second) = if is_followed {
            (std::mem::take(&mut self.views), others)
        } else {
            (others, std::mem::take(&mut self.views))
        };
        self.views = first.with(second);
        if is_followed {
            let turned =
                |c: &PoseCovariance<InWorld>| PoseCovariance::from_rows(sandwich(&turn(moved.rotation), c.as_rows()));
            self.covariance = sum(&self.covariance, &turned(&other.covariance));
            (self.last, self.found) = (turned(&other.last), moved * other.found);
            self.model = None;
        }
        self.places.clear();
        (0..self.views.all().len()).for_each(|number| self.add_place(number));
        self.used.1 = 0;
        self.build(options)
    }
}

/// The covariance of the sum of two independent errors.
fn sum(a: &PoseCovariance<InWorld>, b: &PoseCovariance<InWorld>) -> PoseCovariance<InWorld> {
    let mut rows = *a.as_rows();
    add_to(&mut rows, b.as_rows());
    PoseCovariance::from_rows(rows)
}

/// A localizer after its first frame, at the given pose. It has a time stamp from then on, and predicts the motion
/// until the next frame.
fn started(world: &World, frame: &Frame, robot: RobotPose, options: &ExploreOptions) -> Result<Localizer> {
    let start = PoseEstimate::of_sigmas(robot, START_SIGMA, START_SIGMA);
    let estimator = estimator(options, EstimateOptions::default())?;
    let mut localizer = Localizer::new(estimator, start, LocalizeOptions::default());
    localizer.step(world, frame)?;
    Ok(localizer)
}
