//! Versions of a world: their owners, and what a change copies.

use presight_model::change::Change;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_testkit::scenes;

/// A predictor keeps no version of the world, so the next change works in place. A reader that holds a version makes
/// the change copy.
#[test]
fn a_change_after_a_prediction_copies_nothing() {
    let mut environment = presight_model::environment::Environment::new();
    let mesh = std::sync::Arc::new(scenes::mesh(&[vec![glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y]]));
    environment.add_material(presight_model::environment::Material::named("paint")).unwrap();
    for name in ["hall", "cart"] {
        environment.insert(presight_model::environment::NewObject::new(name, Pose::IDENTITY, mesh.clone())).unwrap();
    }
    let (mut world, sensor) = (World::new(environment), presight_read::preset("laser-scanner").unwrap());
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let place = |world: &World| (std::sync::Arc::as_ptr(world.environment()), std::ptr::from_ref(world.index()));
    let before = place(&world);
    let at = |x| Pose::from_xyz_rpy(glam::DVec3::new(x, 0.0, 0.0), 0.0, 0.0, 0.2);
    let moved = |name: &str, x| Change::MoveObject { name: name.into(), world_from_object: at(x) };
    for change in [moved("cart", 1.5), Change::Group(vec![moved("hall", 2.0), moved("cart", 2.5)])] {
        predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &Request::default()).unwrap();
        world.apply_unchecked(change).unwrap();
        assert_eq!(place(&world), before, "in place");
    }
    let reader = world.clone();
    world.apply_unchecked(moved("cart", 3.0)).unwrap();
    assert_ne!(place(&world).0, before.0);
    assert_eq!(place(&reader), before, "the reader keeps its version");
}
