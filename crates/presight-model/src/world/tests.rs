use super::*;
use crate::environment::{
    Existence, Feature, FeatureShape, Material, Mesh, NewObject, Polygon, PolygonOrder, Properties,
};
use crate::error::ErrorKind;
use crate::geometry::{Pose, PoseCovariance};
use glam::{DMat3, DVec3, Vec3};

fn world() -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("m")).unwrap();
    let polygons = vec![Polygon::new(vec![0, 1, 2], 0)];
    let corners = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
    let mesh = Arc::new(Mesh::new("t", corners, polygons, PolygonOrder::Spatial).unwrap());
    for (name, x) in [("cart", 1.0), ("cart/wheel", 2.0), ("cartridge", 3.0)] {
        environment.insert(NewObject::new(name, at(x, 0.1), mesh.clone())).unwrap();
    }
    World::new(environment)
}

fn at(x: f64, yaw: f64) -> Pose {
    Pose::from_xyz_rpy(DVec3::new(x, 0.0, 0.0), 0.0, 0.0, yaw)
}

fn point(id: u32, object: Option<&str>) -> Feature {
    Feature {
        id,
        name: None,
        object: object.map(str::to_owned),
        shape: FeatureShape::Point { at: DVec3::splat(0.1), covariance: DMat3::IDENTITY },
        existence: Existence::default(),
        properties: Properties::default(),
    }
}

fn insert(id: u32, object: Option<&str>) -> Change {
    Change::InsertFeature { class: "video".into(), feature: point(id, object) }
}

fn hash(world: &World) -> crate::environment::ContentHash {
    world.environment().content_hash()
}

/// Applies and undoes a change; returns the world in between.
fn there_and_back(world: &mut World, change: Change) -> World {
    let before = hash(world);
    let undo = world.apply_unchecked(change).unwrap();
    let between = world.clone();
    world.index().assert_well_formed(world.environment());
    let redo = world.apply_unchecked(undo).unwrap();
    assert_eq!(hash(world), before);
    world.index().assert_well_formed(world.environment());
    let undo = world.apply_unchecked(redo).unwrap();
    assert_eq!(hash(world), hash(&between), "undoing the undo restores the change");
    world.apply_unchecked(undo).unwrap();
    assert_eq!(hash(world), before);
    between
}

#[test]
fn what_is_below_moves_along_and_back_to_the_bit() {
    let mut world = world();
    let to = Pose::from_xyz_rpy(DVec3::new(7.0, 1.0, 2.0), 0.3, 0.2, 1.1);
    let moved = there_and_back(&mut world, Change::MoveObject { name: "cart".into(), world_from_object: to });
    let pose = |world: &World, name: &str| world.environment().object(name).unwrap().world_from_object;
    let wheel_in_cart = |w: &World| pose(w, "cart").inverse() * pose(w, "cart/wheel");
    assert!((wheel_in_cart(&moved).translation - wheel_in_cart(&world).translation).length() < 1e-12);
    assert_eq!(pose(&moved, "cartridge"), pose(&world, "cartridge"));
    let alone = there_and_back(&mut world, Change::SetPose { name: "cart".into(), world_from_object: to });
    assert_eq!(pose(&alone, "cart/wheel"), pose(&world, "cart/wheel"));
}

/// A hall in which only the doors have a mesh, and one group was given a frame.
fn hall() -> World {
    let mut environment = Arc::unwrap_or_clone(world().into_environment());
    let mesh = environment.objects()[0].mesh.clone();
    for (name, x) in [("hall/door/leaf", 5.0), ("hall/door/frame/post", 6.0), ("hall/exit", 7.0), ("hall door", 8.0)] {
        environment.insert(NewObject::new(name, at(x, 0.2), mesh.clone())).unwrap();
    }
    environment.set_frame("hall", Some(at(1.0, 0.3))).unwrap();
    environment.set_frame("hall/door/frame", Some(at(6.0, 0.4))).unwrap();
    World::new(environment)
}

fn pose_of(world: &World, path: &str) -> Pose {
    world.environment().frame(path).unwrap_or_else(|| panic!("{path}"))
}

/// The pose of one path in the frame of another.
fn relative(world: &World, path: &str, to: &str) -> Pose {
    pose_of(world, to).inverse() * pose_of(world, path)
}

fn apart(a: &Pose, b: &Pose) -> f64 {
    let turn = a.rotation_matrix() - b.rotation_matrix();
    (a.translation - b.translation).length() + turn.to_cols_array().iter().map(|x| x.abs()).sum::<f64>()
}

#[test]
fn a_group_moves_with_all_that_is_below_and_back_to_the_bit() {
    let mut world = hall();
    let to = Pose::from_xyz_rpy(DVec3::new(-3.0, 1.0, 2.0), 0.3, 0.2, 1.1);
    let below = ["hall/door", "hall/door/frame", "hall/door/leaf", "hall/door/frame/post", "hall/exit"];
    for change in [
        Change::MoveObject { name: "hall".into(), world_from_object: to },
        Change::SetPose { name: "hall".into(), world_from_object: to },
    ] {
        let moved = there_and_back(&mut world, change);
        assert_eq!(pose_of(&moved, "hall"), to);
        for path in below {
            let (before, after) = (relative(&world, path, "hall"), relative(&moved, path, "hall"));
            assert!(apart(&before, &after) < 1e-12, "{path}: {before:?} {after:?}");
            assert!(apart(&pose_of(&world, path), &pose_of(&moved, path)) > 0.1, "{path} stands still");
        }
        assert_eq!(pose_of(&moved, "hall door"), pose_of(&world, "hall door"));
    }
    // A group without its own frame inherits the one above until it is moved.
    assert_eq!(pose_of(&world, "hall/door"), pose_of(&world, "hall"));
    let moved = there_and_back(&mut world, Change::MoveObject { name: "hall/door".into(), world_from_object: to });
    assert_eq!((pose_of(&moved, "hall/door"), pose_of(&moved, "hall")), (to, pose_of(&world, "hall")));
    assert_eq!(pose_of(&moved, "hall/exit"), pose_of(&world, "hall/exit"));
    for path in ["hall/door/leaf", "hall/door/frame", "hall/door/frame/post"] {
        let (before, after) = (relative(&world, path, "hall/door"), relative(&moved, path, "hall/door"));
        assert!(apart(&before, &after) < 1e-12, "{path}");
    }
}

#[test]
fn an_object_moves_groups_below_it() {
    let mut world = world();
    let mesh = world.environment().objects()[0].mesh.clone();
    let new = NewObject::new("cart/arm/hand", at(4.0, 0.0), mesh);
    world.apply_unchecked(Change::InsertObject(new)).unwrap();
    let frame = Change::SetFrame { name: "cart/arm".into(), world_from_group: Some(at(4.0, 1.0)) };
    there_and_back(&mut world, frame.clone());
    world.apply_unchecked(frame).unwrap();
    let to = Pose::from_xyz_rpy(DVec3::new(-3.0, 1.0, 2.0), 0.3, 0.2, 1.1);
    let moved = there_and_back(&mut world, Change::MoveObject { name: "cart".into(), world_from_object: to });
    for path in ["cart/arm", "cart/arm/hand"] {
        assert!(apart(&relative(&world, path, "cart"), &relative(&moved, path, "cart")) < 1e-12, "{path}");
    }
}

#[test]
fn a_group_is_deleted_with_all_that_is_below() {
    let mut world = hall();
    world.apply_unchecked(insert(3, Some("hall/door/leaf"))).unwrap();
    world.apply_unchecked(insert(4, Some("hall/exit"))).unwrap();
    let without = there_and_back(&mut world, Change::DeleteObject { name: "hall/door".into() });
    let ids =
        |world: &World| world.environment().layer("video").unwrap().features.iter().map(|f| f.id).collect::<Vec<_>>();
    assert_eq!((ids(&without), ids(&world)), (vec![4], vec![3, 4]));
    assert!(without.environment().frame("hall/door").is_none() && without.environment().frame("hall/exit").is_some());
    let without = there_and_back(&mut world, Change::DeleteObject { name: "hall".into() });
    assert_eq!(without.environment().groups().len(), 0);
    assert!(without.environment().frame("hall door").is_some());
    assert!(world.apply_unchecked(Change::DeleteObject { name: "hal".into() }).is_err());
}

/// A path stays movable when its object is deleted, and owns everything below when an object is inserted.
#[test]
fn paths_change_between_object_and_group() {
    let mut world = hall();
    let mesh = world.environment().objects()[0].mesh.clone();
    let without = there_and_back(&mut world, Change::DeleteObject { name: "cart".into() });
    assert_eq!(
        (without.environment().object("cart").is_none(), pose_of(&without, "cart")),
        (true, pose_of(&world, "cart"))
    );
    for name in ["hall", "hall/door", "elsewhere"] {
        let new = NewObject::new(name, at(9.0, 0.5), mesh.clone());
        let with = there_and_back(&mut world, Change::InsertObject(new));
        assert_eq!(pose_of(&with, name), at(9.0, 0.5));
        assert!(!with.environment().groups().contains_key(name));
    }
    // Other changes in between do not interfere.
    let all = Change::Group(vec![
        Change::DeleteObject { name: "cart".into() },
        Change::MoveObject { name: "cart".into(), world_from_object: at(2.0, 2.0) },
        Change::InsertObject(NewObject::new("cart", at(3.0, 3.0), mesh.clone())),
        Change::InsertObject(NewObject::new("cart/arm/hand", at(3.0, 3.0), mesh)),
        Change::DeleteObject { name: "cart/arm".into() },
        Change::DeleteObject { name: "cart".into() },
        Change::DeleteObject { name: "cart".into() },
    ]);
    let gone = there_and_back(&mut world, all);
    assert!(gone.environment().frame("cart").is_none() && gone.environment().frame("cartridge").is_some());
}

#[test]
fn a_deleted_object_takes_its_features_along_and_brings_them_back() {
    let mut world = world();
    world.apply_unchecked(insert(3, Some("cart"))).unwrap();
    world.apply_unchecked(insert(4, None)).unwrap();
    let covariance = PoseCovariance::from_sigmas([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let (class, object) = ("video".to_owned(), "cart".to_owned());
    world.apply_unchecked(Change::SetPoseCovariance { class, object, covariance: Some(covariance) }).unwrap();
    let without = there_and_back(&mut world, Change::DeleteObject { name: "cart".into() });
    let layer = without.environment().layer("video").unwrap();
    assert_eq!(layer.features.iter().map(|f| f.id).collect::<Vec<_>>(), [4]);
    assert!(layer.pose_covariances.is_empty());
}

#[test]
fn ids_are_never_used_again() {
    let mut world = world();
    world.apply_unchecked(insert(3, None)).unwrap();
    world.apply_unchecked(Change::DeleteFeature { class: "video".into(), id: 3 }).unwrap();
    let before = hash(&world);
    assert!(world.apply_unchecked(insert(3, None)).unwrap_err().to_string().contains("deleted"));
    assert!(world.apply_unchecked(Change::DeleteFeature { class: "video".into(), id: 3 }).is_err());
    assert_eq!(hash(&world), before);
    world.apply_unchecked(insert(4, None)).unwrap();
    there_and_back(&mut world, Change::SetFeature { class: "video".into(), feature: point(4, Some("cart")) });
    there_and_back(&mut world, Change::SetTolerance { class: "video".into(), tolerance: 0.5 });
    there_and_back(&mut world, insert(5, Some("cartridge")));
}

#[test]
fn a_group_is_all_or_nothing_and_readers_keep_their_version() {
    let mut world = world();
    let (reader, before) = (world.clone(), hash(&world));
    let delete = |name: &str| Change::DeleteObject { name: name.into() };
    let wrong = Change::Group(vec![insert(1, None), delete("cartridge"), delete("cartridge")]);
    let e = world.apply_unchecked(wrong).unwrap_err();
    assert!(e.kind() == ErrorKind::Invalid && e.to_string().contains("change 3 of the group"), "{e}");
    assert_eq!((hash(&world), world.version()), (before, reader.version()));
    assert!(world.environment().retired("video").next().is_none());
    let right = Change::Group(vec![delete("cart"), insert(1, None), Change::Group(vec![delete("cartridge")])]);
    there_and_back(&mut world, right);
    assert_eq!(hash(&reader), before);
    assert_eq!(world.version(), reader.version() + 4);
}

#[test]
fn impossible_changes_are_refused() {
    let mut world = hall();
    let before = hash(&world);
    let far = Pose { translation: DVec3::splat(1e13), ..Pose::IDENTITY };
    let nan = Pose { translation: DVec3::splat(f64::NAN), ..Pose::IDENTITY };
    let wrong = [
        Change::MoveObject { name: "door".into(), world_from_object: Pose::IDENTITY },
        Change::MoveObject { name: "cart".into(), world_from_object: nan },
        Change::SetPose { name: "cart".into(), world_from_object: far },
        Change::MoveObject { name: "hall".into(), world_from_object: far },
        Change::DeleteObject { name: "hall/do".into() },
        Change::SetFrame { name: "cart".into(), world_from_group: Some(Pose::IDENTITY) },
        Change::SetFrame { name: "hall".into(), world_from_group: Some(nan) },
        Change::SetFrame { name: String::new(), world_from_group: Some(Pose::IDENTITY) },
        insert(0, None),
        insert(1, Some("door")),
        Change::SetFeature { class: "video".into(), feature: point(1, None) },
        Change::SetTolerance { class: "video".into(), tolerance: -1.0 },
        Change::SetTolerance { class: String::new(), tolerance: 1.0 },
        Change::InsertFeature { class: String::new(), feature: point(1, None) },
    ];
    // Objects below a moved path must not go too far away either.
    let near_the_end = Pose { translation: DVec3::new(9.999_999_999_99e11, 0.0, 0.0), ..Pose::IDENTITY };
    let e =
        world.apply_unchecked(Change::MoveObject { name: "hall".into(), world_from_object: near_the_end }).unwrap_err();
    assert!(e.to_string().contains("object \"hall/") && e.to_string().contains("too far"), "{e}");
    assert_eq!(hash(&world), before);
    for change in wrong {
        let e = world.apply_unchecked(change.clone()).unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && !e.remedy().is_empty(), "{change:?}: {e}");
        assert_eq!(hash(&world), before, "{change:?}");
    }
    assert_eq!(world.version(), 1);
}

/// The whole environment, including numbers, slots and retired ids.
fn everything(world: &World) -> String {
    format!("{:?} {}", world.environment(), world.version())
}

/// A group that fails leaves no trace, whatever it did before, and copies nothing.
#[test]
fn a_group_that_fails_leaves_no_trace() {
    let mut world = hall();
    world.apply_unchecked(insert(1, Some("hall/exit"))).unwrap();
    world.apply_unchecked(insert(2, None)).unwrap();
    world.apply_unchecked(Change::DeleteFeature { class: "video".into(), id: 2 }).unwrap();
    let covariance = Some(PoseCovariance::ZERO);
    for object in ["cart", "hall/exit", "cartridge"] {
        let (class, object) = ("video".to_owned(), object.to_owned());
        world.apply_unchecked(Change::SetPoseCovariance { class, object, covariance }).unwrap();
    }
    let mesh = world.environment().objects()[0].mesh.clone();
    let new = |name: &str| Change::InsertObject(NewObject::new(name, at(9.0, 0.0), mesh.clone()));
    let class = || "video".to_owned();
    let steps = || {
        vec![
            new("cart"),
            new("hall/door/frame"),
            Change::AddMaterial(Material::named("late")),
            Change::MoveObject { name: "hall".into(), world_from_object: at(4.0, 0.5) },
            Change::SetFeature { class: class(), feature: point(1, None) },
            Change::RestoreFeature { class: class(), feature: point(2, None) },
            insert(3, Some("cart")),
            Change::InsertFeature { class: "radar".into(), feature: point(1, None) },
            Change::SetTolerance { class: class(), tolerance: 0.5 },
            Change::SetPoseCovariance { class: class(), object: "hall/exit".into(), covariance: None },
            Change::SetPoseCovariance { class: "laser".into(), object: "cart".into(), covariance },
            Change::SetFrame { name: "hall/door".into(), world_from_group: Some(at(2.0, 0.0)) },
            Change::DeleteFeature { class: class(), id: 3 },
            Change::DeleteObject { name: "hall".into() },
            Change::DeleteObject { name: "cart".into() },
            Change::SetPose { name: "cartridge".into(), world_from_object: at(-1.0, 0.0) },
        ]
    };
    let before = everything(&world);
    for done in 0..=steps().len() {
        let mut changes = steps();
        changes.truncate(done);
        world.step_and_back(changes.clone());
        changes.push(Change::DeleteObject { name: "nothing here".into() });
        let (environment, index) = (Arc::as_ptr(&world.environment), Arc::as_ptr(&world.index));
        let e = world.apply_unchecked(Change::Group(changes)).unwrap_err();
        assert!(e.to_string().contains(&format!("change {}", done + 1)), "{e}");
        assert_eq!(everything(&world), before, "after {done} changes");
        world.index().assert_well_formed(world.environment());
        assert_eq!((environment, index), (Arc::as_ptr(&world.environment), Arc::as_ptr(&world.index)), "copied");
    }
}

impl World {
    /// Checks that the steps of the test above change something, so that there is something to revert.
    fn step_and_back(&self, changes: Vec<Change>) {
        let mut other = World::new(self.environment().as_ref().clone());
        let empty = changes.is_empty();
        other.apply_unchecked(Change::Group(changes)).unwrap();
        assert_eq!(format!("{:?}", other.environment()) == format!("{:?}", self.environment()), empty);
    }
}

/// For a class: ids and objects of its features, and the objects with covariances.
type Listed = (String, Vec<(u32, Option<String>)>, Vec<String>);

/// The content of all layers, in order.
fn listed(world: &World) -> Vec<Listed> {
    let of = |layer: &crate::environment::FeatureLayer| {
        let features = layer.features.iter().map(|f| (f.id, f.object.clone())).collect();
        (layer.class.clone(), features, layer.pose_covariances.iter().map(|(object, _)| object.clone()).collect())
    };
    world.environment().layers().iter().map(of).collect()
}

/// Some 120 changes of features, covariances and objects, in random order; some are refused.
fn many_changes(seed: u64) -> Vec<Change> {
    let mut random = crate::random::SplitMix64(seed);
    let mesh = world().environment().objects()[0].mesh.clone();
    let mut below = |n: u32| (random.unit() * f64::from(n)) as u32;
    let mut change = || {
        let object = ["cart", "cart/wheel", "cartridge"][below(3) as usize].to_owned();
        let class = ["video", "laser"][below(2) as usize].to_owned();
        let (id, on) = (1 + below(40), [None, Some(object.as_str())][below(2) as usize]);
        match below(9) {
            0 => Change::DeleteObject { name: object },
            1 => Change::InsertObject(NewObject::new(object, at(7.0, 0.3), mesh.clone())),
            2 => Change::SetPoseCovariance { class, object, covariance: Some(PoseCovariance::ZERO) },
            3 => Change::SetPoseCovariance { class, object, covariance: None },
            4 => Change::DeleteFeature { class, id },
            5 => Change::SetFeature { class, feature: point(id, on) },
            6 => Change::RestoreFeature { class, feature: point(id, on) },
            7 => Change::SetTolerance { class, tolerance: 1e-3 * f64::from(1 + id) },
            _ => Change::InsertFeature { class, feature: point(id, on) },
        }
    };
    (0..120).map(|_| change()).collect()
}

/// Changes of many features, or in a series, use other code than single ones. Environment and undo must be equal.
#[test]
fn many_features_at_once_are_as_one_by_one() {
    for seed in 0..40 {
        let (mut one_by_one, mut taken, mut undo) = (world(), Vec::new(), Vec::new());
        for change in many_changes(seed) {
            if let Ok(inverse) = one_by_one.apply_unchecked(change.clone()) {
                taken.push(change);
                undo.push(inverse);
            }
        }
        assert!(taken.len() > FEW_FEATURES, "{seed}: {}", taken.len());
        let mut in_a_row = world();
        in_a_row.row = Some(FEW_FEATURES);
        let done: Vec<Change> =
            many_changes(seed).into_iter().filter_map(|c| in_a_row.apply_unchecked(c).ok()).collect();
        assert!(in_a_row.environment.has_open_layers() && format!("{done:?}") == format!("{undo:?}"), "{seed}");
        Arc::make_mut(&mut in_a_row.environment).close_layers();
        assert_eq!((listed(&in_a_row), hash(&in_a_row)), (listed(&one_by_one), hash(&one_by_one)), "{seed}");
        let mut together = world();
        let inverse = together.apply_unchecked(Change::Group(taken.clone())).unwrap();
        assert_eq!(listed(&together), listed(&one_by_one), "{seed}");
        assert_eq!(hash(&together), hash(&one_by_one), "{seed}");
        undo.reverse();
        assert_eq!(format!("{inverse:?}"), format!("{:?}", Change::Group(undo)), "{seed}");
        together.index().assert_well_formed(together.environment());
        together.apply_unchecked(inverse).unwrap();
        assert_eq!(hash(&together), hash(&world()), "{seed}");
        // A refused change at the end leaves no trace of the others.
        let refused = Change::DeleteFeature { class: "video".into(), id: 41 };
        let mut together = world();
        let before = everything(&together);
        let e = together.apply_unchecked(Change::Group(taken.into_iter().chain([refused]).collect())).unwrap_err();
        assert!(e.to_string().contains("there is no feature 41 for class \"video\""), "{e}");
        assert_eq!(everything(&together), before, "{seed}");
        there_and_back(&mut together, insert(90, Some("cart")));
    }
}

/// CPU seconds of this thread if the system reports them, so that other load does not count.
fn own_seconds() -> f64 {
    static START: std::sync::LazyLock<std::time::Instant> = std::sync::LazyLock::new(std::time::Instant::now);
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let worked = told.and_then(|text| text.split_whitespace().next()?.parse::<u64>().ok());
    worked.map_or_else(|| START.elapsed().as_secs_f64(), |ns| ns as f64 * 1e-9)
}

/// Deleting a group takes time linear in its features, not quadratic. The limit is far from both on any machine.
#[test]
fn a_group_with_many_features_is_deleted_and_brought_back_soon() {
    const SOON: f64 = 30.0;
    let seconds = |objects: u32, each: u32| {
        let mut environment = world().environment().as_ref().clone();
        let mesh = environment.objects()[0].mesh.clone();
        let mut features = Vec::new();
        for o in 0..objects {
            let name = format!("hall/{o}");
            environment.insert(NewObject::new(name.clone(), at(0.0, 0.0), mesh.clone())).unwrap();
            features.extend((1..=each).map(|k| point(o * each + k, Some(&name))));
        }
        let layer = crate::environment::FeatureLayer {
            class: "video".into(),
            tolerance: 1e-3,
            features: features.into_iter().map(Into::into).collect(),
            pose_covariances: (0..objects).map(|o| (format!("hall/{o}"), PoseCovariance::ZERO)).collect(),
        };
        environment.add_layer(layer).unwrap();
        let mut world = World::new(environment);
        let before = hash(&world);
        let start = own_seconds();
        let undo = world.apply_unchecked(Change::DeleteObject { name: "hall".into() }).unwrap();
        assert_eq!(world.environment().layer("video").unwrap().features.len(), 0);
        world.apply_unchecked(undo).unwrap();
        let seconds = own_seconds() - start;
        assert_eq!(hash(&world), before);
        seconds
    };
    for (objects, each) in [(1, 100_000), (100_000, 1)] {
        let took = seconds(objects, each);
        assert!(took < SOON, "{objects} objects with {each} features each took {took} s");
    }
}
