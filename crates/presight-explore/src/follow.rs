//! Exploration without poses: each frame is localized in what is known so far, and adds to it.

use crate::exploration::{Exploration, Known};
use crate::surfaces::ExploreOptions;
use crate::view::Views;
use presight_localize::estimate::{EstimateOptions, Estimator};
use presight_localize::localize::{LocalizeOptions, Localizer, Phase};
use presight_model::environment::Environment;
use presight_model::error::Result;
use presight_model::geometry::{InWorld, Pose, PoseCovariance, PoseEstimate};
use presight_model::matrix::{Matrix, add_to, scaled};
use presight_model::measured::Frame;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};

/// Views of which the model is made while the sensor moves on.
const KEY_VIEWS: usize = 40;
/// The model is made again when there are this many more views, as a share.
const GROWTH: f64 = 0.12;
/// Polygons of the model while the sensor moves on.
const POLYGONS: usize = 1000;
/// Standard deviation of surfaces that few views show, metres.
const MODEL_SIGMA: f64 = 0.005;

/// Explores without poses. The first frame fixes the frame of the world.
pub struct Follower {
    options: ExploreOptions,
    known: Environment,
    kind: Known,
    views: Views,
    localizer: Localizer,
    world: World,
    /// Number of views when the model was made.
    made_of: usize,
    covariance: Matrix,
    last: Matrix,
    lost: Vec<f64>,
}

/// The pose of a frame, found on the way.
#[derive(Clone, Copy, Debug)]
pub struct FoundPose {
    /// Seconds.
    pub stamp: f64,
    /// world_from_robot, and what is left open, drift since the first frame included.
    pub pose: PoseEstimate,
}

impl Follower {
    /// Starts at the pose of the robot at the first frame.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] without threads.
    pub fn new(world_from_robot: Pose, known: Environment, kind: Known, options: &ExploreOptions) -> Result<Self> {
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(options.threads.clone()))?;
        let estimator = Estimator::new(predictor, EstimateOptions::default().with_model_sigma(MODEL_SIGMA));
        let start = PoseEstimate::of_sigmas(world_from_robot, 0.01, 0.01);
        let localizer = Localizer::new(estimator, start, LocalizeOptions::default());
        let world = World::new(known.clone());
        Ok(Self {
            options: options.clone().with_polygons(options.polygons.min(POLYGONS)),
            known,
            kind,
            views: Views::default(),
            localizer,
            world,
            made_of: 0,
            covariance: [[0.0; 6]; 6],
            last: [[0.0; 6]; 6],
            lost: Vec::new(),
        })
    }

    /// Localizes the next frame and adds it; `None` if it shows nothing that is known. The first frame is at the start.
    ///
    /// # Errors
    /// Those of [`Localizer::step`] and [`Exploration::of`].
    pub fn add(&mut self, frame: &Frame, start: Pose) -> Result<Option<FoundPose>> {
        let robot_from_sensor = frame.sensor().spec().mount;
        if self.views.all().is_empty() {
            self.views.push(frame, start * robot_from_sensor)?;
            self.make()?;
            let pose = PoseEstimate::exact(start);
            return Ok(Some(FoundPose { stamp: frame.stamp, pose }));
        }
        let step = self.localizer.step(&self.world, frame)?;
        if !matches!(step.phase, Phase::Tracking | Phase::Candidates) || !step.estimate.is_determined() {
            self.lost.push(frame.stamp);
            return Ok(None);
        }
        self.views.push(frame, step.pose.world_from_robot * robot_from_sensor)?;
        self.last = *step.pose.covariance.as_rows();
        let more = self.views.all().len() - self.made_of;
        if more as f64 >= (GROWTH * self.made_of as f64).max(2.0) {
            // What is added now is as far off as this pose: errors of one model pass into the next.
            add_to(&mut self.covariance, &self.last);
            self.make()?;
        }
        let mut covariance = self.covariance;
        add_to(&mut covariance, &self.last);
        let covariance = PoseCovariance::<InWorld>::from_rows(covariance);
        Ok(Some(FoundPose { stamp: frame.stamp, pose: PoseEstimate::new(step.pose.world_from_robot, covariance) }))
    }

    /// Makes the model of some of the views, the last one among them.
    fn make(&mut self) -> Result<()> {
        self.made_of = self.views.all().len();
        let views = self.views.some(KEY_VIEWS);
        let found = Exploration::of(&self.known, self.kind, &views, &self.options)?;
        self.world = World::new(found.environment().clone());
        Ok(())
    }

    /// The frames so far, at the poses that were found.
    pub fn into_views(self) -> Views {
        self.views
    }

    /// Times of the frames that showed nothing known.
    pub fn lost(&self) -> &[f64] {
        &self.lost
    }

    /// Standard deviations of the last pose against the first: x, y, z in metres, and three angles in radians.
    pub fn drift(&self) -> [f64; 6] {
        let mut sum = scaled(&self.covariance, 1.0);
        add_to(&mut sum, &self.last);
        std::array::from_fn(|i| sum[i][i].max(0.0).sqrt())
    }
}
