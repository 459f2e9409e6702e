//! Random sequences of changes: the store, the environment in memory and an environment built from scratch are equal,
//! and a sensor sees the same in each.

use super::{at, block, create, note, point, small};
use glam::DVec3;
use presight::environment::{Aabb, Environment, Mark, MarkKind, NewObject};
use presight::features::Existence;
use presight::store;
use presight::store::Store;
use presight::{Backend, Change, Options, Pose, PoseCovariance, Predictor, Request, SensorPose, World};
use presight_studies::index::Scheme;
use proptest::prelude::*;
use std::collections::HashMap;

/// Makes a change from small numbers, so that changes affect the same objects. Many of them are invalid on purpose.
fn change(kind: u8, which: u8, x: f64, depth: u8) -> Change {
    let names = ["a", "b", "b/lid", "c", "g", "g/h", "g/h/y", "g/x", "d"];
    let name = names[usize::from(which) % names.len()].to_owned();
    let class = ["video", "radar"][usize::from(which % 2)].to_owned();
    let id = 1 + u32::from(which % 6);
    let object = which.is_multiple_of(3).then_some("a");
    match kind {
        0 | 1 => Change::MoveObject { name, world_from_object: at(x, 1.0, x) },
        2 => Change::DeleteObject { name },
        3 | 4 => {
            let mesh = block("new", 0.25 + f32::from(which % 3), [u16::from(which % 2); 6]);
            Change::InsertObject(NewObject::new(name, at(x, -1.0, x), mesh))
        }
        5 => Change::InsertFeature { class, feature: point(id, 0.5, object) },
        6 => Change::SetFeature { class, feature: point(id, x.abs(), object) },
        7 => Change::DeleteFeature { class, id },
        8 => Change::SetPose { name, world_from_object: at(x, 0.0, -x) },
        9 => {
            let covariance = PoseCovariance::from_sigmas([x, 0.0, 0.0, 0.0, 0.0, 0.0]);
            Change::SetPoseCovariance {
                class,
                object: name,
                covariance: (!which.is_multiple_of(4)).then_some(covariance),
            }
        }
        10 => Change::SetTolerance { class, tolerance: 0.001 + x.abs() },
        11 => Change::SetFrame { name, world_from_group: (!which.is_multiple_of(3)).then(|| at(x, 2.0, -x)) },
        12 if which.is_multiple_of(3) => Change::RemoveMark { name: class },
        12 => {
            let bounds = which.is_multiple_of(5).then_some(Aabb { min: DVec3::splat(x), max: DVec3::splat(x + 1.0) });
            let kind = if which.is_multiple_of(2) { MarkKind::Absent } else { MarkKind::Uncertain };
            let mark = Mark { object: name, kind, class: object.map(|_| "laser".to_owned()), bounds };
            Change::SetMark { name: class, mark }
        }
        13 => {
            let trust = Existence { p0: x.abs() / 2.0, confirmed: x, rate: 0.0 };
            Change::SetTrust { object: name, trust: (!which.is_multiple_of(4)).then_some(trust) }
        }
        _ if depth == 0 => change(kind % 14, which, x, 0),
        _ => {
            Change::Group((0..3).map(|i| change((kind + 5 * i) % 15, which + i, x + f64::from(i), depth - 1)).collect())
        }
    }
}

/// Builds a new environment from the live objects and features in the order of their numbers.
fn from_scratch(environment: &Environment) -> Environment {
    let mut again = Environment::new();
    for material in environment.materials() {
        again.add_material(material.clone()).unwrap();
    }
    for o in environment.objects().iter().filter(|o| !o.is_deleted()) {
        let new = NewObject {
            object_from_mesh: o.object_from_mesh,
            first_source: o.first_source,
            ..NewObject::new(o.name.clone(), o.world_from_object, o.mesh.clone())
        };
        again.insert(new).unwrap();
    }
    for (path, pose) in environment.framed_groups() {
        again.set_frame(path, Some(*pose)).unwrap();
    }
    for layer in environment.layers() {
        again.add_layer(layer.clone()).unwrap();
    }
    for (name, mark) in environment.marks() {
        again.set_mark(name, mark.clone()).unwrap();
    }
    for (object, trust) in environment.trusts() {
        again.set_trust(object, Some(*trust)).unwrap();
    }
    again
}

/// Returns a sensor's image: the range bits, and the polygon with its object's name.
fn seen(world: &World) -> Vec<(u32, Option<(String, u32)>)> {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let sensor = presight::preset("laser-range-camera").unwrap();
    let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 2.0), 0.0, 0.2, 0.1);
    let images = predictor.predict(world, &sensor, &SensorPose::new(pose), &Request::default()).unwrap().images;
    let environment = world.environment();
    let polygon = |id: u32| {
        let (object, polygon) = environment.locate(id.checked_sub(1)?)?;
        Some((environment.objects()[object as usize].name.clone(), polygon))
    };
    images.range.iter().zip(&images.polygon_id).map(|(r, id)| (r.to_bits(), polygon(*id))).collect()
}

/// Applies a whole log to the environment from which a store was created.
fn replayed(path: &std::path::Path, environment: Environment, by_number: &HashMap<u64, Change>) -> World {
    let mut world = World::new(environment);
    store::log(path, |entry| world.apply_unchecked(by_number[&entry.number].clone()).map(drop)).unwrap();
    world
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

    #[test]
    fn store_memory_and_scratch_agree(steps in prop::collection::vec((0u8..15, 0u8..60, -2.0f64..2.0, 0u8..8), 1..60)) {
        let folder = tempfile::tempdir().unwrap();
        let path = create(folder.path(), &small());
        let mut store = Store::open(&path).unwrap();
        let (mut applied, mut undoable) = (HashMap::new(), Vec::new());
        for (kind, which, x, then) in steps {
            let state = |store: &Store| (store.world().environment().content_hash(), store.world().version());
            let before = state(&store);
            let change = change(kind, which, x, 2);
            let apply = |store: &mut Store, change| {
                let mut batch = store.batch()?;
                let number = batch.apply_unchecked(change, &note(x))?;
                batch.commit().map(|()| number)
            };
            match apply(&mut store, change.clone()) {
                Ok(number) => {
                    applied.insert(number, change);
                    undoable.push(number);
                }
                Err(_) => prop_assert_eq!(state(&store), before),
            }
            let world = store.world();
            world.index().assert_well_formed(world.environment());
            let hash = world.environment().content_hash();
            if then == 0 {
                drop(store);
                store = Store::open(&path).unwrap();
                prop_assert_eq!(store.world().environment().content_hash(), hash);
            }
        }
        let info = store::check(&path).unwrap();
        let world = store.world().clone();
        let hash = world.environment().content_hash();
        prop_assert_eq!(info.environment.content_hash(), hash);
        prop_assert_eq!(info.environment.groups(), world.environment().groups());
        let scratch = from_scratch(world.environment());
        prop_assert_eq!(scratch.content_hash(), hash);
        let again = replayed(&path, small(), &applied);
        prop_assert_eq!(again.environment().content_hash(), hash);
        prop_assert_eq!(again.environment().slot_count(), world.environment().slot_count());
        let expected = seen(&world);
        for scheme in [Scheme::TwoLevel, Scheme::S3d] {
            let read = store::read_world(&path, &scheme.tuned()).unwrap();
            prop_assert_eq!(read.environment().content_hash(), hash);
            read.index().assert_well_formed(read.environment());
            prop_assert!(seen(&read) == expected, "of the store, {scheme:?}");
        }
        prop_assert!(seen(&World::new(scratch)) == expected, "from scratch");
        prop_assert!(seen(&again) == expected, "replayed");
        // Undoing all changes, newest first, gives the initial environment.
        for number in undoable.into_iter().rev() {
            store.undo(number, false, &note(0.0)).unwrap();
        }
        prop_assert_eq!(store.world().environment().content_hash(), small().content_hash());
        drop(store);
        prop_assert_eq!(store::check(&path).unwrap().environment.content_hash(), small().content_hash());
    }
}
