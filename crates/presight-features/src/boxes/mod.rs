//! Regions of interest (boxes) of predicted features: uncertainties of features, and the points that boxes must hold.

mod image;
mod outermost;
mod points;

pub(super) use image::Image;
pub use image::Kind;

use super::prediction::given_at;
use super::roi::{BodyPoint, BoxFinder, FeatureErrorModel, Level, PoseErrors, Projection as _, Roi, Viewpoint};
use super::{FeaturePrediction, PlacedFeature, SeenFeature};
use presight_model::error::{Error, Result};
use presight_model::geometry::{InObject, InWorld, Pose, PoseCovariance, PoseEstimate};
use presight_model::sensor::Sensor;
use presight_model::threads::parallel;
use presight_model::world::World;
use rayon::prelude::*;

/// How uncertainties are propagated through the projection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BoxMethod {
    /// The derivative if the projection is nearly linear over the errors, otherwise a set. The box has the stated
    /// confidence.
    #[default]
    AsNeeded,
    /// Always the derivative, unless the feature may be behind the sensor. Fast, but no bound if not linear.
    Linear,
    /// Always a set, unless the feature may be behind the sensor. Slow.
    Set,
}

/// Uncertainties of poses, and the probability with which regions of interest hold their features.
///
/// ```
/// use presight::features::BoxOptions;
/// // 5 cm along x and y, and 2 degrees of heading.
/// let heading = 2f64.to_radians();
/// let options = BoxOptions::default().with_sensor_sigmas([0.05, 0.05, 0.0, 0.0, 0.0, heading]).with_confidence(0.95);
/// assert_eq!(options.sensor[5][5], heading * heading);
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct BoxOptions {
    /// Covariance of the sensor's pose.
    pub sensor: PoseCovariance<InWorld>,
    /// Covariances of objects' poses by object index. They override those in layers.
    pub objects: Vec<(u32, PoseCovariance<InObject>)>,
    /// Probability with which a box holds its feature.
    pub confidence: f64,
    /// Method of propagation.
    pub method: BoxMethod,
}

impl Default for BoxOptions {
    fn default() -> Self {
        Self { sensor: PoseCovariance::ZERO, objects: Vec::new(), confidence: 0.99, method: BoxMethod::AsNeeded }
    }
}

impl BoxOptions {
    /// Sets the covariance of the sensor's pose; for that of the robot's, use [`BoxOptions::with_robot`].
    #[must_use]
    pub fn with_sensor(self, covariance: PoseCovariance<InWorld>) -> Self {
        Self { sensor: covariance, ..self }
    }

    /// Sets the covariance of the sensor's pose from the robot's, through the sensor's mount.
    ///
    /// ```
    /// use presight::features::BoxOptions;
    /// use presight::{PoseEstimate, RobotPose};
    /// let camera = presight::preset("realsense-d435")?;
    /// let believed = PoseEstimate::of_sigmas(RobotPose::IDENTITY, 0.02, 0.01);
    /// let options = BoxOptions::default().with_robot(&believed, &camera);
    /// assert_eq!(options.sensor, believed.sensor_covariance(&camera.spec().mount));
    /// # Ok::<(), presight::Error>(())
    /// ```
    #[must_use]
    pub fn with_robot(self, robot: &PoseEstimate, sensor: &Sensor) -> Self {
        self.with_sensor(robot.sensor_covariance(&sensor.spec().mount))
    }

    /// Sets independent standard deviations of the sensor's pose: x, y, z in metres, rotation about x, y, z in radians.
    #[must_use]
    pub fn with_sensor_sigmas(self, sigmas: [f64; 6]) -> Self {
        self.with_sensor(PoseCovariance::from_sigmas(sigmas))
    }

    /// Sets covariances of objects' poses by object index.
    #[must_use]
    pub fn with_objects(self, objects: Vec<(u32, PoseCovariance<InObject>)>) -> Self {
        Self { objects, ..self }
    }

    /// Sets the probability, 0.5 to below 1.
    #[must_use]
    pub fn with_confidence(self, confidence: f64) -> Self {
        Self { confidence, ..self }
    }

    /// Sets the method.
    #[must_use]
    pub fn with_method(self, method: BoxMethod) -> Self {
        Self { method, ..self }
    }

    /// # Errors
    /// The errors of [`add_boxes`].
    pub fn check(&self) -> Result<()> {
        if !(0.5..1.0).contains(&self.confidence) {
            let what = format!("confidence {} is not in 0.5..1", self.confidence);
            return Err(Error::usage(what, "give a probability such as 0.99"));
        }
        self.sensor.check().map_err(|e| e.at("the sensor's pose"))?;
        for (object, covariance) in &self.objects {
            covariance.check().map_err(|e| e.at(format!("the pose of object {object}")))?;
        }
        Ok(())
    }
}

/// Input for the boxes of a prediction.
#[derive(Clone, Copy, Debug)]
pub struct BoxQuery<'a> {
    /// The predicted features in order.
    pub placed: &'a [PlacedFeature],
    /// The world in which they lie.
    pub world: &'a World,
    /// The sensor.
    pub sensor: &'a Sensor,
    /// Its pose, body axes.
    pub world_from_sensor: &'a Pose,
    /// Uncertainties and confidence.
    pub options: &'a BoxOptions,
}

/// Adds the box, and the covariance of the defining points in the image, to every visible feature.
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for a confidence outside 0.5..1, and the errors of [`Pose::check`];
/// [`presight_model::ErrorKind::Invalid`] for a covariance that is not finite, not symmetric, or has an eigenvalue
/// below 0 beyond the rounding of six digits; the errors of [`presight_model::Threads::new`].
pub fn add_boxes(prediction: &mut FeaturePrediction, query: &BoxQuery<'_>) -> Result<()> {
    let frame = BoxFrame::new(query)?;
    let FeaturePrediction { features, given, .. } = prediction;
    let add = |room: &mut BoxScratch, (i, seen): (usize, &mut SeenFeature)| {
        // A hidden feature will not be searched for, so it needs no box.
        if seen.visible.is_empty() {
            return;
        }
        let uncertain = frame.uncertain(&query.placed[given_at(given, i)]);
        let found = frame
            .prepare(seen, &uncertain, room)
            .then(|| room.finder.find(&frame.image, &uncertain, &room.points, &frame.level, frame.method));
        frame.set(seen, found.flatten());
    };
    parallel(|| {
        let features = features.par_iter_mut().enumerate().with_min_len(64);
        features.for_each_init(BoxScratch::default, add);
    })
}

/// Memory that one worker reuses.
#[derive(Default)]
pub struct BoxScratch {
    /// The points that a box must hold.
    pub points: Vec<BodyPoint>,
    finder: BoxFinder,
}

/// Data shared by the boxes of one prediction.
pub struct BoxFrame<'a> {
    /// The image.
    pub image: Image<'a>,
    /// The sensor with its pose errors.
    pub viewpoint: Viewpoint,
    /// The probability of a box.
    pub level: Level,
    /// How boxes are found.
    pub method: BoxMethod,
    world: &'a World,
    objects: Vec<(u32, PoseErrors)>,
}

impl<'a> BoxFrame<'a> {
    /// # Errors
    /// The errors of [`add_boxes`].
    pub fn new(query: &BoxQuery<'a>) -> Result<Self> {
        let BoxQuery { world, sensor, world_from_sensor, options, .. } = *query;
        options.check()?;
        let mut objects: Vec<_> = options.objects.iter().map(|(o, c)| (*o, PoseErrors::new(c))).collect();
        // The sort is stable, so the first entry of a repeated object counts.
        objects.sort_by_key(|(object, _)| *object);
        Ok(Self {
            image: Image::of(sensor),
            viewpoint: Viewpoint::new(world_from_sensor, &options.sensor)?,
            level: Level::new(options.confidence),
            method: options.method,
            world,
            objects,
        })
    }

    /// The errors of a feature.
    pub fn uncertain(&self, placed: &PlacedFeature) -> FeatureErrorModel {
        let object = placed.object.and_then(|o| self.world.environment().objects().get(o as usize));
        let world_from_frame = object.map_or(Pose::IDENTITY, |o| o.world_from_object);
        let first = |object: u32| self.objects.partition_point(|(o, _)| *o < object);
        let known = |object: u32| self.objects.get(first(object)).filter(|(o, _)| *o == object).map(|(_, e)| e);
        let errors = placed.object.and_then(known);
        FeatureErrorModel::seen_from(&self.viewpoint, &world_from_frame, errors, &placed.feature.shape)
    }

    /// Returns true if the visible part of a curve spans more than half a turn.
    fn turns(&self, seen: &SeenFeature, turn: f64) -> bool {
        let mut columns: Option<[f64; 3]> = None;
        for p in seen.visible.iter().flat_map(|v| seen.along(v.t)).flatten() {
            let Some([column, _]) = self.image.project(self.viewpoint.in_body(p)) else { continue };
            let [last, low, high] = columns.unwrap_or([column; 3]);
            let column = column + turn * ((last - column) / turn).round();
            columns = Some([column, low.min(column), high.max(column)]);
        }
        columns.is_some_and(|[_, low, high]| high - low > 0.5 * turn)
    }

    /// Stores a box. A patch or curve over more than half a turn surrounds the axis, so it gets all columns.
    pub fn set(&self, seen: &mut SeenFeature, found: Option<Roi>) {
        seen.windows = Vec::new();
        let Some(found) = found else { return };
        let [_, y0, _, y1] = found.bounds;
        let wide = |turn: f64| seen.visible.iter().any(|v| v.pixels[1].x - v.pixels[0].x > 0.5 * turn);
        let is_around = seen.feature.shape.is_area() && self.image.turn().is_some_and(wide)
            || seen.feature.shape.is_contour() && self.image.turn().is_some_and(|turn| self.turns(seen, turn));
        let width = f64::from(self.image.size().0);
        seen.roi = Some(if is_around { [-0.5, y0, width - 0.5, y1] } else { found.bounds });
        seen.roi_flag = Some(found.flag);
    }

    /// Finds the boxes of some features of a prediction.
    pub fn finish(&self, prediction: &mut FeaturePrediction, placed: &[PlacedFeature], which: &[u32]) {
        let features = &prediction.features;
        let find = |room: &mut BoxScratch, i: &u32| {
            let (seen, placed) = (&features[*i as usize], &placed[prediction.given_at(*i as usize)]);
            let uncertain = self.uncertain(placed);
            points::seen(&self.image, &self.viewpoint, &uncertain, seen, &mut room.points);
            room.finder.find(&self.image, &uncertain, &room.points, &self.level, self.method)
        };
        let found: Vec<Option<Roi>> = which.par_iter().with_min_len(4).map_init(BoxScratch::default, find).collect();
        for (i, found) in which.iter().zip(found) {
            self.set(&mut prediction.features[*i as usize], found);
        }
    }

    /// Sets the covariances of a visible feature, and lists the points that its box must hold. False if none.
    pub fn prepare(&self, seen: &mut SeenFeature, uncertain: &FeatureErrorModel, room: &mut BoxScratch) -> bool {
        let BoxScratch { points, finder } = room;
        points::defining(&seen.feature.shape, points);
        seen.image_covariance = finder.covariances(&self.image, uncertain, points).filter(|all| !all.is_empty());
        points::seen(&self.image, &self.viewpoint, uncertain, seen, points);
        !points.is_empty()
    }
}
