//! Exploration without poses: each frame is localized in the model made so far, and adds to it.

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

/// Views that the model is made from while the sensor moves on.
const KEY_VIEWS: usize = 40;
/// The model is made again when there are this many more views, as a share.
const GROWTH: f64 = 0.12;
/// Polygons of the model while the sensor moves on.
const POLYGONS: usize = 1000;
/// Standard deviation of surfaces that few views show, metres.
const MODEL_SIGMA: f64 = 0.005;

/// Standard deviations of the pose at a start, metres and radians.
const START_SIGMA: f64 = 0.01;

/// After frames of elsewhere the search covers this surrounding of the last known pose: metres, radians.
const REACH: (f64, f64) = (0.5, 0.4);
/// Share of its points that must be explained.
const JOINED: f64 = 0.8;

/// True if a pose is known in the model as well as the pose of the first frame, so that its view may be added. A floor alone does not suffice.
fn is_sure(pose: &PoseEstimate) -> bool {
    (0..6).all(|i| pose.covariance.as_rows()[i][i] <= START_SIGMA * START_SIGMA)
}

fn estimator(options: &ExploreOptions) -> Result<Estimator> {
    let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(options.threads.clone()))?;
    Ok(Estimator::new(predictor, EstimateOptions::default().with_model_sigma(MODEL_SIGMA)))
}

/// Explores without poses. The first frame fixes the frame of the world.
pub struct Follower {
    options: ExploreOptions,
    known: Environment,
    kind: Known,
    views: Views,
    localizer: Localizer,
    /// For single frames.
    estimator: Estimator,
    world: World,
    /// Number of views when the model was made.
    made_of: usize,
    covariance: Matrix,
    last: Matrix,
    /// Times of the frames that showed nothing known.
    lost: Vec<f64>,
    /// The last pose of the robot that was found.
    found: Pose,
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
        let start = PoseEstimate::of_sigmas(world_from_robot, START_SIGMA, START_SIGMA);
        let localizer = Localizer::new(estimator(options)?, start, LocalizeOptions::default());
        let world = World::new(known.clone());
        Ok(Self {
            options: options.clone().with_polygons(options.polygons.min(POLYGONS)),
            known,
            kind,
            views: Views::default(),
            localizer,
            estimator: estimator(options)?,
            world,
            made_of: 0,
            covariance: [[0.0; 6]; 6],
            last: [[0.0; 6]; 6],
            lost: Vec::new(),
            found: world_from_robot,
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
            self.found = start;
            let pose = PoseEstimate::exact(start);
            return Ok(Some(FoundPose { stamp: frame.stamp, pose }));
        }
        let step = self.localizer.step(&self.world, frame)?;
        let is_followed = matches!(step.phase, Phase::Tracking | Phase::Candidates) && step.estimate.is_determined();
        let is_known = is_followed && is_sure(&step.pose);
        let pose = if is_known { Some(step.pose) } else { self.found_again(frame)? };
        let Some(pose) = pose else {
            self.lost.push(frame.stamp);
            return Ok(None);
        };
        self.found = pose.world_from_robot;
        self.views.push(frame, pose.world_from_robot * robot_from_sensor)?;
        self.last = *pose.covariance.as_rows();
        let more = self.views.all().len() - self.made_of;
        if more as f64 >= (GROWTH * self.made_of as f64).max(2.0) {
            // Surfaces added now are as far off as this pose: errors of one model pass into the next.
            add_to(&mut self.covariance, &self.last);
            self.make()?;
        }
        let mut covariance = self.covariance;
        add_to(&mut covariance, &self.last);
        let covariance = PoseCovariance::<InWorld>::from_rows(covariance);
        Ok(Some(FoundPose { stamp: frame.stamp, pose: PoseEstimate::new(pose.world_from_robot, covariance) }))
    }

    /// The pose at a frame after frames of elsewhere, near the last known pose. The frame must show little else than known surfaces.
    fn found_again(&mut self, frame: &Frame) -> Result<Option<PoseEstimate>> {
        let prior = PoseEstimate::of_sigmas(self.found, REACH.0, REACH.1);
        let estimate = self.estimator.estimate(&self.world, &[frame], &prior)?;
        let is_found = estimate.is_determined() && is_sure(&estimate.pose) && estimate.explained > JOINED;
        let found = is_found.then_some(estimate.pose);
        if let Some(pose) = found {
            let start = PoseEstimate::of_sigmas(pose.world_from_robot, START_SIGMA, START_SIGMA);
            self.localizer = Localizer::new(estimator(&self.options)?, start, LocalizeOptions::default());
        }
        Ok(found)
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
