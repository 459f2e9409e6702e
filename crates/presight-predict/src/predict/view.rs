//! Access to predictions for virtual sensors.

use super::{Prediction, Predictor};
use crate::virtual_sensors::{View, ViewIds};
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use presight_model::floor::{Mobility, height_below};
use presight_model::geometry::SensorPose;
use presight_model::index::QueryResult;
use presight_model::sensor::Sensor;
use presight_model::world::World;

impl<'a> View<'a> {
    /// The view of a prediction in an environment.
    pub fn of(prediction: &'a Prediction, environment: &'a Environment) -> Self {
        let (images, scheme) = (&prediction.images, prediction.request.ids);
        let known = !images.polygon_id.is_empty() && !images.object_id.is_empty();
        let ids = ViewIds { environment, scheme, polygon_id: &images.polygon_id, object_id: &images.object_id };
        Self {
            sensor: &prediction.sensor,
            pose: prediction.pose,
            range: &images.range,
            ids: known.then_some(ids),
            features: prediction.features.as_ref(),
            given_up: prediction.degradation(),
            moves: prediction.request.moves(&prediction.sensor),
        }
    }
}

impl Predictor {
    /// Returns the world height of the floor directly below a sensor, metres: of the highest level surface that is not
    /// marked as absent. `free-floor` needs it if the sensor's mount does not specify its height above the floor.
    ///
    /// ```
    /// # std::env::set_current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).unwrap();
    /// use presight::{Options, Predictor, Scene, SensorPose};
    /// let scene = Scene::open("scenes/room.glb")?;
    /// let mut predictor = Predictor::new(Options::default())?;
    /// let pose = SensorPose::from_xyz_rpy(glam::DVec3::new(1.0, 1.5, 0.5), 0.0, 0.0, 0.0);
    /// let floor = predictor.floor_below(&scene.world, &presight::preset("video-camera")?, &pose)?;
    /// assert!(floor.abs() < 0.05);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] if there is no floor below.
    pub fn floor_below(&mut self, world: &World, sensor: &Sensor, pose: &SensorPose) -> Result<f64> {
        let place = pose.world_from_sensor().translation;
        let bounds = world.environment().bounds();
        let reach = (place.z - bounds.min.z).max(0.0) + 1.0;
        let floor = height_below(world, place, reach, &Mobility::default(), &mut QueryResult::default());
        floor.ok_or_else(|| {
            let what = format!("sensor {:?} has no [mount], and there is no floor below it", sensor.spec().name);
            let remedy = "give `Settings::floor_z_world`, or robot_from_sensor under [mount] in the sensor's file";
            Error::usage(what, remedy).at("free-floor")
        })
    }
}
