//! Access to predictions for virtual sensors.

use super::{Prediction, Predictor};
use crate::request::Request;
use crate::virtual_sensors::{View, ViewIds};
use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Geometry, RayTable, Sensor, SensorSpec};
use presight_model::world::World;
use presight_render::plan::{Output, Outputs};

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
    /// Returns the world height of the surface directly below a sensor, metres. This is the floor for `free-floor` if
    /// the sensor's mount does not specify its height above the floor.
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
    /// [`presight_model::ErrorKind::Usage`] if there is no surface below; the errors of [`Predictor::predict`].
    pub fn floor_below(&mut self, world: &World, sensor: &Sensor, pose: &SensorPose) -> Result<f64> {
        let down = RayTable::new(1, 1, vec![DVec3::NEG_Z])?;
        let probe = Sensor::new(SensorSpec::new("straight down", &sensor.spec().class, Geometry::Rays(down)))?;
        let place = pose.world_from_sensor().translation;
        let at = SensorPose::new(Pose { translation: place, ..Pose::IDENTITY });
        let request = Request::of(Outputs::of(&[Output::Range]));
        let range = f64::from(self.predict(world, &probe, &at, &request)?.images.range[0]);
        if !range.is_finite() {
            let what = format!("sensor {:?} has no [mount], and there is no surface below it", sensor.spec().name);
            let remedy = "give `Settings::floor_z_world`, or robot_from_sensor under [mount] in the sensor's file";
            return Err(Error::usage(what, remedy).at("free-floor"));
        }
        Ok(place.z - range)
    }
}
