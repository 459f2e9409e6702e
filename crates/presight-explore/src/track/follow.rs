//! Exploration without poses: each frame is localized in the model of the frames before it, and added to it. A frame
//! outside the model starts a new group, which is merged when a later frame connects the two.

use super::group::{Group, Searcher};
use crate::change::Known;
use crate::observe::Views;
use crate::surface::ExploreOptions;
use presight_model::environment::Environment;
use presight_model::error::{ErrorKind, Result};
use presight_model::geometry::{PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{sandwich, turn};
use presight_model::measured::Frame;

/// Maximum number of polygons of the intermediate models.
const POLYGONS: usize = 1000;
/// Maximum number of pairs of places that are compared after each new model, which bounds the time of the comparison.
const MAX_PAIRS: usize = 32;

/// Explores without poses. The pose of the first frame defines the world frame.
pub struct Follower {
    options: ExploreOptions,
    /// The known model, which the first frame takes.
    known: Option<(Environment, Known)>,
    start: RobotPose,
    /// The group of the first frame, and those not yet connected to it.
    groups: Vec<Group>,
    /// Index of the group that is followed.
    current: usize,
    /// The search for single frames.
    searcher: Searcher,
    /// Time stamps of frames without a flat surface, seconds.
    empty: Vec<f64>,
}

/// The estimated pose of a frame.
#[derive(Clone, Copy, Debug)]
pub struct FoundPose {
    /// Time stamp, seconds.
    pub stamp: f64,
    /// The robot's pose, with a covariance that includes the drift since the first frame.
    pub pose: PoseEstimate,
}

impl Follower {
    /// Starts with the pose of the robot at the first frame.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] without threads.
    pub fn new(robot: RobotPose, known: Environment, kind: Known, options: &ExploreOptions) -> Result<Self> {
        Ok(Self {
            options: options.clone().with_polygons(options.polygons.min(POLYGONS)),
            known: Some((known, kind)),
            start: robot,
            groups: Vec::new(),
            current: 0,
            searcher: Searcher::new(options)?,
            empty: Vec::new(),
        })
    }

    /// Localizes the next frame and adds it. `None` if the frame is not connected to the group of the first frame, at
    /// least not yet.
    ///
    /// # Errors
    /// Those of [`presight_localize::localize::Localizer::step`] and [`crate::Exploration::of`].
    pub fn add(&mut self, frame: &Frame) -> Result<Option<FoundPose>> {
        if let Some(known) = self.known.take() {
            self.groups.push(Group::new(frame, self.start, known, &self.options)?);
            return Ok(Some(FoundPose { stamp: frame.stamp, pose: PoseEstimate::exact(self.start) }));
        }
        let mut found = self.groups[self.current].add(frame, &mut self.searcher, &self.options)?;
        if found.is_none() && self.current > 0 {
            found = self.groups[0].add_again(frame, &mut self.searcher, &self.options)?;
            if found.is_some() {
                self.follow(0);
            }
        }
        if found.is_none() {
            self.begin(frame)?;
        }
        let is_first = self.current == 0 && found.is_some();
        if found.is_some() && self.groups[self.current].grow(&self.options)? {
            self.merge()?;
        }
        let group = &self.groups[0];
        let pose = found.filter(|_| is_first).map(|pose| PoseEstimate::new(pose.robot(), group.drift()));
        Ok(pose.map(|pose| FoundPose { stamp: frame.stamp, pose }))
    }

    fn follow(&mut self, group: usize) {
        if self.current > 0 {
            self.groups[self.current].rest();
        }
        self.current = group;
    }

    /// Starts another group, whose frame of reference is independent of the first group.
    fn begin(&mut self, frame: &Frame) -> Result<()> {
        let empty = (Environment::new(), Known::Explored);
        match Group::new(frame, RobotPose::IDENTITY, empty, &self.options) {
            Ok(group) => {
                self.groups.push(group);
                self.follow(self.groups.len() - 1);
                self.merge()
            }
            Err(e) if e.kind() == ErrorKind::Invalid => {
                self.empty.push(frame.stamp);
                Ok(())
            }
            Err(e) => Err(e),
        }
    }

    /// Merges the followed group with the groups that it is connected to. The first group is compared first, then the
    /// latest ones.
    fn merge(&mut self) -> Result<()> {
        let mut pairs = MAX_PAIRS;
        while let Some((other, pose)) = self.connected(&mut pairs)? {
            let (low, high) = (self.current.min(other), self.current.max(other));
            let is_followed = self.current == high;
            let pose = if is_followed { inverse(&pose) } else { pose };
            let joined = self.groups.remove(high);
            self.groups[low].join(joined, &pose, is_followed, &self.options)?;
            self.current = low;
        }
        self.groups[self.current].compared();
        Ok(())
    }

    /// A group that is connected to the followed one, with the pose of its frame of reference in that of the followed
    /// group.
    fn connected(&mut self, pairs: &mut usize) -> Result<Option<(usize, PoseEstimate)>> {
        let own = &self.groups[self.current];
        let others = std::iter::once(0).chain((1..self.groups.len()).rev()).filter(|other| *other != self.current);
        for other in others {
            if let Some(pose) = own.pose_of(&self.groups[other], &mut self.searcher, pairs)? {
                return Ok(Some((other, pose)));
            }
        }
        Ok(None)
    }

    /// Compares the groups again, with a model of all frames.
    ///
    /// # Errors
    /// Those of [`Self::add`].
    pub fn finish(&mut self) -> Result<()> {
        if self.groups.len() > 1 {
            self.groups[self.current].build(&self.options)?;
            self.merge()?;
        }
        Ok(())
    }

    /// The views of the first frame's group, at the estimated poses.
    pub fn into_views(mut self) -> Views {
        if self.groups.is_empty() { Views::default() } else { self.groups.swap_remove(0).views }
    }

    /// Time stamps of the frames of each other group, seconds. A group of one frame has no surface in common with
    /// another frame.
    pub fn apart(&self) -> Vec<Vec<f64>> {
        let stamps = |group: &Group| group.views.all().iter().map(|view| view.stamp).collect();
        let others = self.groups.iter().skip(1).map(stamps);
        others.chain(self.empty.iter().map(|stamp| vec![*stamp])).collect()
    }

    /// Standard deviations of the last pose relative to the first: x, y, z in metres, and three angles in radians.
    pub fn drift(&self) -> [f64; 6] {
        self.groups.first().map_or([0.0; 6], |group| group.drift().sigmas())
    }
}

/// The inverse of a pose, with its covariance.
fn inverse(pose: &PoseEstimate) -> PoseEstimate {
    let inverse = pose.world_from_robot.inverse();
    let at_origin = pose.covariance.moved_by(-pose.world_from_robot.translation);
    let rows = sandwich(&turn(inverse.rotation), at_origin.as_rows());
    PoseEstimate::new(RobotPose::new(inverse), PoseCovariance::from_rows(rows))
}
