//! A drive along two machines of the factory, which are boxes in a rough model. The bench includes this drive.

use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::geometry::Pose;
use presight_model::sensor::{Camera, Geometry, Noise, Sensor, SensorSpec};
use presight_read::script::load;
use presight_testkit::caster::Caster;
use presight_testkit::judge::Placed;

/// The factory and its rough model.
pub fn scenes() -> [Environment; 2] {
    let open = |name: &str| {
        let path = presight_testkit::data::root().join("scenes").join(name);
        load(path, &Default::default(), &mut |_| {}).unwrap().environment
    };
    ["factory.rhai", "factory_rough.rhai"].map(open)
}

/// Frames of a depth camera from left to right before the machines, this far from the wall. Another library casts them.
pub fn drive(real: &Environment, count: usize, aside: f64) -> Vec<Placed> {
    let camera = Geometry::Camera(Camera::pinhole(160, 120, 80.0, 80.0, 79.5, 59.5));
    let spec = SensorSpec::new("camera", "laser", camera).with_limits(0.3, 8.0);
    let sensor = Sensor::new(spec.with_noise(Noise { range_sigma: 0.005, ..Noise::default() })).unwrap();
    let mut caster = Caster::new(real, sensor, 7);
    let pose = |k: usize| {
        let share = (k as f64 + 0.5) / count as f64;
        let at = DVec3::new(2.8 + 9.2 * share, 28.4 + aside, 1.5);
        Pose::from_xyz_rpy(at, 0.0, 0.25, 1.57 + 0.5 * (9.0 * share).sin())
    };
    (0..count).map(|k| (caster.frame(&|_| pose(k), 0.1 * k as f64, None), pose(k))).collect()
}
