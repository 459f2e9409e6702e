//! Versions of a world: who keeps one, and what a change copies.

use presight::{Backend, Change, Options, Pose, Predictor, Request, World};
use presight_testkit::scenes;

/// A predictor keeps no version of the world, so the next change works in place. A reader that keeps one causes a copy.
#[test]
fn a_change_after_a_prediction_copies_nothing() {
    let mut environment = presight::Environment::new();
    let mesh = std::sync::Arc::new(scenes::mesh(&[vec![glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y]]));
    environment.add_material(presight::Material::named("paint")).unwrap();
    for name in ["hall", "cart"] {
        environment.insert(presight::NewObject::new(name, Pose::IDENTITY, mesh.clone())).unwrap();
    }
    let (mut world, sensor) = (World::new(environment), presight::preset("laser-scanner").unwrap());
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let place = |world: &World| (std::ptr::from_ref(world.environment()), std::ptr::from_ref(world.index()));
    let before = place(&world);
    let at = |x| Pose::from_xyz_rpy(glam::DVec3::new(x, 0.0, 0.0), 0.0, 0.0, 0.2);
    let moved = |name: &str, x| Change::MoveObject { name: name.into(), world_from_object: at(x) };
    for change in [moved("cart", 1.5), Change::Group(vec![moved("hall", 2.0), moved("cart", 2.5)])] {
        predictor.predict(&world, &sensor, &Pose::IDENTITY, &Request::default()).unwrap();
        world.apply_unchecked(change).unwrap();
        assert_eq!(place(&world), before, "in place");
    }
    let reader = world.clone();
    world.apply_unchecked(moved("cart", 3.0)).unwrap();
    assert_ne!(place(&world).0, before.0);
    assert_eq!(place(&reader), before, "the reader keeps its version");
}
