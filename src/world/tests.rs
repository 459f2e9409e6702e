use super::*;
use crate::environment::{Existence, Feature, FeatureShape, Material, Mesh, Polygon, PolygonOrder, Properties};
use crate::error::ErrorKind;
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

/// Applies and undoes; the answer is the world in between.
fn there_and_back(world: &mut World, change: Change) -> World {
    let before = hash(world);
    let undo = world.apply(change).unwrap();
    let between = world.clone();
    world.index().assert_well_formed(world.environment());
    let redo = world.apply(undo).unwrap();
    assert_eq!(hash(world), before);
    world.index().assert_well_formed(world.environment());
    let undo = world.apply(redo).unwrap();
    assert_eq!(hash(world), hash(&between), "what undoes the undoing is the change");
    world.apply(undo).unwrap();
    assert_eq!(hash(world), before);
    between
}

#[test]
fn what_is_below_moves_along_and_back_to_the_bit() {
    let mut world = world();
    let to = Pose::from_xyz_rpy(DVec3::new(7.0, 1.0, 2.0), 0.3, 0.2, 1.1);
    let moved = there_and_back(&mut world, Change::MoveObject { name: "cart".into(), world_from_object: to });
    let pose = |world: &World, name: &str| world.environment().object(name).unwrap().world_from_object;
    let wheel_in_cart = |w: &World| pose(w, "cart").inverse().then(&pose(w, "cart/wheel"));
    assert!((wheel_in_cart(&moved).translation - wheel_in_cart(&world).translation).length() < 1e-12);
    assert_eq!(pose(&moved, "cartridge"), pose(&world, "cartridge"));
    let alone = there_and_back(&mut world, Change::SetPose { name: "cart".into(), world_from_object: to });
    assert_eq!(pose(&alone, "cart/wheel"), pose(&world, "cart/wheel"));
}

#[test]
fn a_deleted_object_takes_its_features_along_and_brings_them_back() {
    let mut world = world();
    world.apply(insert(3, Some("cart"))).unwrap();
    world.apply(insert(4, None)).unwrap();
    let mut covariance = [[0.0; 6]; 6];
    covariance[0][0] = 0.25;
    let (class, object) = ("video".to_owned(), "cart".to_owned());
    world.apply(Change::SetPoseCovariance { class, object, covariance: Some(covariance) }).unwrap();
    let without = there_and_back(&mut world, Change::DeleteObject { name: "cart".into() });
    let layer = without.environment().layer("video").unwrap();
    assert_eq!(layer.features.iter().map(|f| f.id).collect::<Vec<_>>(), [4]);
    assert!(layer.pose_covariances.is_empty());
}

#[test]
fn ids_are_never_used_again() {
    let mut world = world();
    world.apply(insert(3, None)).unwrap();
    world.apply(Change::DeleteFeature { class: "video".into(), id: 3 }).unwrap();
    let before = hash(&world);
    assert!(world.apply(insert(3, None)).unwrap_err().to_string().contains("deleted"));
    assert!(world.apply(Change::DeleteFeature { class: "video".into(), id: 3 }).is_err());
    assert_eq!(hash(&world), before);
    world.apply(insert(4, None)).unwrap();
    there_and_back(&mut world, Change::SetFeature { class: "video".into(), feature: point(4, Some("cart")) });
    there_and_back(&mut world, Change::SetTolerance { class: "video".into(), tolerance: 0.5 });
    there_and_back(&mut world, insert(5, Some("cartridge")));
}

#[test]
fn a_group_is_all_or_nothing_and_readers_keep_their_version() {
    let mut world = world();
    let (reader, before) = (world.clone(), hash(&world));
    let delete = |name: &str| Change::DeleteObject { name: name.into() };
    let wrong = Change::Group(vec![insert(1, None), delete("cart"), delete("cart")]);
    let e = world.apply(wrong).unwrap_err();
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
    let mut world = world();
    let before = hash(&world);
    let far = Pose { translation: DVec3::splat(1e13), ..Pose::IDENTITY };
    let nan = Pose { translation: DVec3::splat(f64::NAN), ..Pose::IDENTITY };
    let wrong = [
        Change::MoveObject { name: "door".into(), world_from_object: Pose::IDENTITY },
        Change::MoveObject { name: "cart".into(), world_from_object: nan },
        Change::SetPose { name: "cart".into(), world_from_object: far },
        insert(0, None),
        insert(1, Some("door")),
        Change::SetFeature { class: "video".into(), feature: point(1, None) },
        Change::SetTolerance { class: "video".into(), tolerance: -1.0 },
        Change::SetTolerance { class: String::new(), tolerance: 1.0 },
        Change::InsertFeature { class: String::new(), feature: point(1, None) },
    ];
    for change in wrong {
        let e = world.apply(change.clone()).unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && !e.remedy().is_empty(), "{change:?}: {e}");
        assert_eq!(hash(&world), before, "{change:?}");
    }
    assert_eq!(world.version(), 1);
}
