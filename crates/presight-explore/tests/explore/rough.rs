//! Rough models of another unit, of the mirrored place, and of another building.

use super::lost::room;
use super::rooms::{sensor, views_of};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use presight_explore::{Exploration, ExploreOptions, Known, Views};
use presight_model::environment::{Environment, NewObject};
use presight_model::error::ErrorKind;
use presight_model::geometry::Pose;
use presight_testkit::caster::Caster;
use presight_testkit::judge::{Placed, judge};
use presight_testkit::scenes::{cuboid, empty};

pub(crate) fn looks(count: usize, first: f64) -> impl Iterator<Item = Pose> {
    (0..count).map(move |k| {
        let turn = std::f64::consts::TAU * (k as f64 + first) / count as f64;
        Pose::from_xyz_rpy(DVec3::new(0.2 * turn.cos(), 0.2 * turn.sin(), 0.2), 0.0, 0.2, turn)
    })
}

fn views() -> Views {
    let real = room();
    views_of(&sensor(), looks(24, 0.0).map(|pose| (real.clone(), pose)))
}

/// The room with other coordinates.
fn turned(by: DMat3) -> Environment {
    let mut turned = empty();
    for object in room().objects() {
        let object_from_mesh = DAffine3::from_mat3(by) * object.object_from_mesh;
        let new = NewObject { object_from_mesh, ..NewObject::new(&object.name, Pose::IDENTITY, object.mesh.clone()) };
        turned.insert(new).unwrap();
    }
    turned
}

fn explored(rough: &Environment) -> presight_model::error::Result<Exploration> {
    Exploration::of(rough, Known::Rough, &views(), &ExploreOptions::default())
}

#[test]
fn a_rough_model_in_millimetres_is_refused() {
    let clock = std::time::Instant::now();
    let refused = explored(&turned(DMat3::from_diagonal(DVec3::splat(1e3)))).err().unwrap();
    let (kind, said) = (refused.kind(), refused.to_string());
    assert!(kind == ErrorKind::Invalid && said.contains("in metres") && said.contains("4600.0 x 3800.0"), "{said}");
    assert!(!said.contains('\n') && clock.elapsed().as_secs() < 30, "{said}");
    // The model in metres is accepted.
    assert!(explored(&turned(DMat3::IDENTITY)).unwrap().unexplained < 0.1);
}

/// Wrong surfaces are opened and real ones found: the predictions are as good as those of a model without prior
/// knowledge.
#[test]
fn a_mirrored_room_and_another_building_become_this_room() {
    let mut hall = empty();
    let walls = cuboid(Vec3::new(-1.2, -4.5, -1.0), Vec3::new(6.0, 5.5, 3.0));
    hall.insert(NewObject::new("hall", Pose::IDENTITY, walls.into())).unwrap();
    let mut caster = Caster::new(&room(), sensor(), 3);
    (caster.drop_outs, caster.mixed) = (0.0, 0.0);
    let held_out: Vec<Placed> = looks(7, 0.4).map(|pose| (caster.frame(&|_| pose, 0.0, None), pose)).collect();
    let nothing = Exploration::of(&Environment::new(), Known::Explored, &views(), &ExploreOptions::default()).unwrap();
    let best = judge(nothing.environment(), &held_out, 0.04, 0.1);
    println!("from nothing: {best:.3?}");
    for (name, rough) in [("mirrored", turned(DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0)))), ("hall", hall)] {
        let before = judge(&rough, &held_out, 0.04, 0.1);
        let found = explored(&rough).unwrap();
        let after = judge(found.environment(), &held_out, 0.04, 0.1);
        println!("{name}: {before:.3?}\n{after:.3?} unexplained {:.3} opened {:.2}", found.unexplained, found.opened);
        assert!(before.within < 70.0 && found.opened > 1.0, "planted: {before:?}");
        assert!(after.within > best.within - 2.0 && after.nearer < best.nearer + 1.0, "{name}: {after:?}");
    }
}
