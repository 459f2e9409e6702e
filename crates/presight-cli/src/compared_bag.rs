//! A ROS 2 bag of measurements, their predictions, and the verdict on each point.

use super::drive::Sensed;
use super::output_bag::OutputBag;
use super::print;
use glam::DVec3;
use presight::localize::{FeatureFindings, Step};
use presight::ros::{MessageOrigin, Record, SceneMarker, comparison, measured, model, sensed};
use presight::verdict::Verdicts;
use presight::{Backend, Options, PoseEstimate, Predictor, Result, Scene, Threads};

/// A bag of measurements with their predictions.
pub struct ComparedBag {
    pub bag: OutputBag,
    predictor: Predictor,
    /// The last frame, for messages about the whole drive.
    last: Option<MessageOrigin>,
}

impl ComparedBag {
    /// Compares on this number of threads; 0 means all cores.
    ///
    /// # Errors
    /// [`presight::ErrorKind::System`] if threads cannot be started.
    pub fn new(bag: OutputBag, threads: usize) -> Result<Self> {
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(Threads::from(threads).started()?))?;
        Ok(Self { bag, predictor, last: None })
    }

    /// Adds a step of a localizer: its answers, and if the pose is known, the comparison with the prediction.
    ///
    /// # Errors
    /// Those of the prediction and of writing.
    pub fn step(&mut self, scene: &Scene, sensed: &Sensed<'_>, step: &Step) -> Result<()> {
        let origin = self.begin(scene, sensed)?;
        self.bag.add(presight::ros::answers(step, &origin))?;
        if let Some(verdicts) = step.estimate.verdicts.first().filter(|_| step.is_known()) {
            self.compare(scene, sensed, (&step.estimate.pose, verdicts), &origin)?;
        }
        self.bag.add(step.estimate.findings.first().map(|found| features(found, &origin)))
    }

    /// Adds a frame at a pose that is given.
    ///
    /// # Errors
    /// Those of the prediction and of writing.
    pub fn given(&mut self, scene: &Scene, sensed: &Sensed<'_>, robot: &PoseEstimate, model_sigma: f64) -> Result<()> {
        let origin = self.begin(scene, sensed)?;
        self.bag.add([origin.localization(&robot.world_from_robot), origin.pose(robot)])?;
        if sensed.frame.grey().is_some() {
            return Ok(());
        }
        let (predictor, world) = (&mut self.predictor, &scene.world);
        let verdicts = presight::verdict::of_coarse_model(predictor, world, sensed.frame, robot, model_sigma)?;
        // The verdicts are of one moment of the scan.
        let then = sensed.frame.at_one_moment()?.robot(robot);
        self.compare(scene, sensed, (&then, &verdicts), &origin)
    }

    /// Adds the measurement, and before the first one the model and the mount.
    fn begin(&mut self, scene: &Scene, sensed: &Sensed<'_>) -> Result<MessageOrigin> {
        let (frame, recorded) = (sensed.frame, sensed.recorded);
        let origin = MessageOrigin::of_frame(frame, recorded);
        if self.bag.is_empty() {
            match model(scene.world.environment(), &origin.map, origin.stamp_ns) {
                Ok(model) => self.bag.add([model])?,
                Err(e) => print::notices(&[format!("the bag is without the model: {e}")]),
            }
            self.bag.add([origin.mount(frame.sensor())])?;
        }
        self.bag.add(origin.odometry())?;
        self.bag.add(match recorded {
            Some(recorded) => measured(recorded),
            None => self::sensed(frame, &origin)?,
        })?;
        self.last = Some(origin.clone());
        Ok(origin)
    }

    fn compare(
        &mut self,
        scene: &Scene,
        sensed: &Sensed<'_>,
        (robot, verdicts): (&PoseEstimate, &Verdicts),
        origin: &MessageOrigin,
    ) -> Result<()> {
        let compared = (sensed.frame, verdicts);
        self.bag.add(comparison(&mut self.predictor, &scene.world, compared, robot, origin)?)
    }

    /// Writes the index, as [`OutputBag::finish`].
    ///
    /// # Errors
    /// Those of writing.
    pub fn finish(&mut self) -> Result<()> {
        self.bag.finish()
    }

    /// Adds messages at the time of the last frame; none without a frame.
    ///
    /// # Errors
    /// Those of writing.
    pub fn conclude(&mut self, records: impl FnOnce(&MessageOrigin) -> Vec<Record>) -> Result<()> {
        let last = self.last.take();
        self.bag.add(last.as_ref().map(records).into_iter().flatten())?;
        self.last = last;
        Ok(())
    }
}

/// The features that were sought, on `/presight/features`: matched green, occluded orange, missing blue, others grey.
fn features(found: &FeatureFindings, origin: &MessageOrigin) -> Record {
    const COLORS: [(&str, [f32; 4]); 4] = [
        ("matched", [0.0, 0.8, 0.6, 1.0]),
        ("occluded", [1.0, 0.55, 0.26, 1.0]),
        ("missing", [0.34, 0.7, 0.91, 1.0]),
        ("undecidable", [0.54, 0.56, 0.61, 1.0]),
    ];
    let markers = COLORS.map(|(class, color)| {
        let of_class = found.features.iter().filter(|feature| feature.class.name() == class);
        let lines = of_class.flat_map(|feature| outline(&feature.points_world));
        SceneMarker::lines(format!("features: {class}"), color, lines.map(|p| p.to_array()))
    });
    origin.markers("/presight/features", &origin.map, markers.into_iter().filter(|marker| !marker.points.is_empty()))
}

/// Lines along points, closed if there are more than two; a point alone becomes a short upright line.
fn outline(points: &[DVec3]) -> Vec<DVec3> {
    match points {
        [] => Vec::new(),
        [only] => [-1.0, 1.0].map(|side| *only + DVec3::Z * side * SceneMarker::LINE_M).to_vec(),
        [a, b] => vec![*a, *b],
        [first, ..] => points.windows(2).flatten().copied().chain([points[points.len() - 1], *first]).collect(),
    }
}
