//! Exploration without poses: each frame is localized in the model made so far, and adds to it. Frames that show nothing known begin a
//! group of their own, which is joined when the two meet.

use super::group::{Group, Searcher};
use crate::change::Known;
use crate::observe::Views;
use crate::surface::ExploreOptions;
use presight_model::environment::Environment;
use presight_model::error::{ErrorKind, Result};
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate};
use presight_model::matrix::{sandwich, turn};
use presight_model::measured::Frame;

/// Polygons of the model while the sensor moves on.
const POLYGONS: usize = 1000;
/// Pairs of places at which groups are compared whenever a model is made: what that costs at most.
const MOST_PAIRS: usize = 32;

/// Explores without poses. The first frame fixes the frame of the world.
pub struct Follower {
    options: ExploreOptions,
    /// The known model, until the first frame.
    known: Option<(Environment, Known)>,
    start: Pose,
    /// The group of the first frame, and others that never met it.
    groups: Vec<Group>,
    /// The group that is followed.
    current: usize,
    /// For single frames.
    searcher: Searcher,
    /// Times of frames that show nothing flat.
    empty: Vec<f64>,
}

/// The pose of a frame, found on the way.
#[derive(Clone, Copy, Debug)]
pub struct FoundPose {
    /// Seconds.
    pub stamp: f64,
    /// world_from_robot with its covariance, which includes the drift since the first frame.
    pub pose: PoseEstimate,
}

impl Follower {
    /// Starts at the pose of the robot at the first frame.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] without threads.
    pub fn new(world_from_robot: Pose, known: Environment, kind: Known, options: &ExploreOptions) -> Result<Self> {
        Ok(Self {
            options: options.clone().with_polygons(options.polygons.min(POLYGONS)),
            known: Some((known, kind)),
            start: world_from_robot,
            groups: Vec::new(),
            current: 0,
            searcher: Searcher::new(options)?,
            empty: Vec::new(),
        })
    }

    /// Localizes the next frame and adds it; `None` if it is not in the group of the first frame, at least not yet.
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
            self.meet()?;
        }
        let group = &self.groups[0];
        let pose = found.filter(|_| is_first).map(|pose| PoseEstimate::new(pose.world_from_robot, group.drift()));
        Ok(pose.map(|pose| FoundPose { stamp: frame.stamp, pose }))
    }

    fn follow(&mut self, group: usize) {
        if self.current > 0 {
            self.groups[self.current].rest();
        }
        self.current = group;
    }

    /// Begins another group. Its frame of reference has nothing to do with the first one's.
    fn begin(&mut self, frame: &Frame) -> Result<()> {
        let nothing = (Environment::new(), Known::Explored);
        match Group::new(frame, Pose::IDENTITY, nothing, &self.options) {
            Ok(group) => {
                self.groups.push(group);
                self.follow(self.groups.len() - 1);
                self.meet()
            }
            Err(e) if e.kind() == ErrorKind::Invalid => {
                self.empty.push(frame.stamp);
                Ok(())
            }
            Err(e) => Err(e),
        }
    }

    /// Joins the followed group with the groups that it meets. The first group is compared first, then the latest.
    fn meet(&mut self) -> Result<()> {
        let mut pairs = MOST_PAIRS;
        while let Some((other, pose)) = self.met(&mut pairs)? {
            let (low, high) = (self.current.min(other), self.current.max(other));
            let goes_on = self.current == high;
            let pose = if goes_on { inverse(&pose) } else { pose };
            let joined = self.groups.remove(high);
            self.groups[low].join(joined, &pose, goes_on, &self.options)?;
            self.current = low;
        }
        self.groups[self.current].compared();
        Ok(())
    }

    /// A group that the one which is followed meets, and its frame of reference in that of the one which is followed.
    fn met(&mut self, pairs: &mut usize) -> Result<Option<(usize, PoseEstimate)>> {
        let own = &self.groups[self.current];
        let others = std::iter::once(0).chain((1..self.groups.len()).rev()).filter(|other| *other != self.current);
        for other in others {
            if let Some(pose) = own.pose_of(&self.groups[other], &mut self.searcher, pairs)? {
                return Ok(Some((other, pose)));
            }
        }
        Ok(None)
    }

    /// Compares the groups once more with all frames.
    ///
    /// # Errors
    /// Those of [`Self::add`].
    pub fn finish(&mut self) -> Result<()> {
        if self.groups.len() > 1 {
            self.groups[self.current].make(&self.options)?;
            self.meet()?;
        }
        Ok(())
    }

    /// The frames of the first one's group, at the poses that were found.
    pub fn into_views(mut self) -> Views {
        if self.groups.is_empty() { Views::default() } else { self.groups.swap_remove(0).views }
    }

    /// Times of the frames of each other group, seconds. A group of one frame showed nothing that another frame shows.
    pub fn apart(&self) -> Vec<Vec<f64>> {
        let stamps = |group: &Group| group.views.all().iter().map(|view| view.stamp).collect();
        let others = self.groups.iter().skip(1).map(stamps);
        others.chain(self.empty.iter().map(|stamp| vec![*stamp])).collect()
    }

    /// Standard deviations of the last pose against the first: x, y, z in metres, and three angles in radians.
    pub fn drift(&self) -> [f64; 6] {
        self.groups.first().map_or([0.0; 6], |group| group.drift().sigmas())
    }
}

/// The other frame's pose in this one, for this frame's pose in the other.
fn inverse(pose: &PoseEstimate) -> PoseEstimate {
    let inverse = pose.world_from_robot.inverse();
    let at_own_origin = pose.covariance.moved_by(-pose.world_from_robot.translation);
    let rows = sandwich(&turn(inverse.rotation), at_own_origin.as_rows());
    PoseEstimate::new(inverse, PoseCovariance::from_rows(rows))
}
