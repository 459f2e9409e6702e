//! Contours in layer files and worlds, and the surfaces that they refer to.

use super::bodies::prism;
use super::{contour, layer, pinhole, see, side_of, world};
use glam::{DVec3, Vec3};
use presight_features::place;
use presight_model::change::Change;
use presight_model::environment::FeatureShape;
use presight_model::environment::{Mesh, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::placement::place_layer;
use presight_model::world::World;
use presight_read::layer::{parse, to_string};

fn post() -> World {
    world(vec![("post", DVec3::new(4.0, 0.0, -1.0), prism(24, 0.3, 2.0, true))])
}

#[test]
fn files_with_contours_have_format_2() {
    let given = layer(vec![contour(7, "post", side_of(0.3))]);
    let text = to_string(&given).unwrap();
    assert!(
        text.contains("\"format\": 2") && text.contains("\"crease_deg\":30.0") && !text.contains("points"),
        "{text}"
    );
    assert_eq!(parse(&text).unwrap().layer, given);
    assert!(to_string(&layer(Vec::new())).unwrap().contains("\"format\": 1"));
    let refused = |text: &str, said: &str| {
        let e = parse(text).unwrap_err().to_string();
        assert!(e.contains(said), "{e}");
    };
    refused(&text.replace("\"format\": 2", "\"format\": 1"), "contours need format 2, but the file has format 1");
    refused(&text.replace("\"format\": 2", "\"format\": 3"), "formats up to 2");
    refused(&text.replace("30.0", "0"), "crease angle of 0 degrees is out of its range");
    refused(&text.replace("30.0", "90.5"), "out of its range");
    refused(&text.replace("\"crease_deg\":30.0", "\"points\":[[0,0,0]]"), "anchor and crease_deg alone");
    refused(&text.replace("\"contour\"", "\"point\""), "anchor and crease_deg are for contours");
    refused(&text.replace("\"contour\"", "\"contours\""), "unknown variant");
}

#[test]
fn contours_change_with_the_world() {
    let mut world = post();
    let insert =
        |id: u32, anchor: DVec3| Change::InsertFeature { class: "video".into(), feature: contour(id, "post", anchor) };
    let e = world.apply(insert(1, DVec3::ZERO.with_z(1.0))).unwrap_err().to_string();
    assert!(e.contains("the contour is 0.29") && e.contains("off its polygons"), "{e}");
    let before = world.environment().content_hash();
    let undo = world.apply(insert(1, side_of(0.3))).unwrap();
    let with = world.environment().content_hash();
    assert_ne!(before, with);
    let mut other = contour(1, "post", side_of(0.3));
    if let FeatureShape::Contour { crease_deg, .. } = &mut other.shape {
        *crease_deg = 29.0;
    }
    world.apply(Change::SetFeature { class: "video".into(), feature: other }).unwrap();
    assert_ne!(world.environment().content_hash(), with);
    world.apply(Change::SetFeature { class: "video".into(), feature: contour(1, "post", side_of(0.3)) }).unwrap();
    assert_eq!(world.environment().content_hash(), with);
    // It moves with its object.
    let to = Pose { translation: DVec3::new(7.0, 1.0, -1.0), ..Pose::IDENTITY };
    world.apply(Change::MoveObject { name: "post".into(), world_from_object: to }).unwrap();
    let of = |world: &World| place_layer(world, world.environment().layer("video").unwrap()).unwrap();
    assert_eq!((of(&world).features.len(), of(&world).lost.len()), (1, 0));
    world.apply_unchecked(undo).unwrap();
    assert!(world.environment().layer("video").is_none_or(|l| l.features.is_empty()));
}

/// Facets split at different heights than their neighbours, reversed, or stored twice give the same surface and the
/// same curves.
#[test]
fn surfaces_do_not_depend_on_how_they_are_stored() {
    let plain = prism(24, 0.3, 2.0, true);
    let corners = |polygon: u32| plain.corners_of(polygon).map(DVec3::as_vec3).collect::<Vec<Vec3>>();
    let all: Vec<Vec<Vec3>> = (0..26).map(corners).collect();
    let cut = |(i, quad): (usize, &Vec<Vec3>)| {
        if i >= 24 {
            return vec![quad.clone()];
        }
        let z = 0.3 + 0.05 * i as f32;
        let [a, b, c, d] = quad[..] else { panic!() };
        let (m, n) = (b.with_z(z), a.with_z(z));
        vec![vec![a, b, m, n], vec![n, m, c, d]]
    };
    let reversed = |(i, p): (usize, &Vec<Vec3>)| if i % 3 == 0 { p.iter().rev().copied().collect() } else { p.clone() };
    let doubled = |p: &Vec<Vec3>| [p.clone(), p.iter().rev().copied().collect()];
    let variants: [(&str, Vec<Vec<Vec3>>); 4] = [
        ("plain", all.clone()),
        ("cut", all.iter().enumerate().flat_map(cut).collect()),
        ("reversed", all.iter().enumerate().map(reversed).collect()),
        ("doubled", all.iter().flat_map(doubled).collect()),
    ];
    for (name, loops) in variants {
        let world = world(vec![("post", DVec3::new(4.0, 0.0, -1.0), mesh(&loops))]);
        let placed = place(&world, &layer(vec![contour(7, "post", side_of(0.3))])).unwrap();
        assert_eq!(placed[0].slots.len(), if name == "cut" || name == "doubled" { 48 } else { 24 }, "{name}");
        let seen = see(&world, &pinhole(), &Pose::IDENTITY, vec![contour(7, "post", side_of(0.3))]);
        let upright = seen.features.iter().filter(|f| {
            let (a, b) = (f.points_world[0], *f.points_world.last().unwrap());
            a.truncate().distance(b.truncate()) < 1e-6 && a.distance(b) > 1.9 && f.visible_fraction == 1.0
        });
        assert_eq!(upright.count(), 2, "{name}");
        assert_eq!(seen.features.len(), 6, "{name}");
    }
}

fn mesh(loops: &[Vec<Vec3>]) -> Mesh {
    let vertices: Vec<Vec3> = loops.iter().flatten().copied().collect();
    let mut next = 0;
    let polygon = |l: &Vec<Vec3>| {
        next += l.len() as u32;
        Polygon::new((next - l.len() as u32..next).collect(), 0)
    };
    // Every corner is a separate vertex.
    let polygons = loops.iter().map(polygon).collect();
    Mesh::new("m", vertices, polygons, PolygonOrder::Given).unwrap()
}

/// A border where another object's surface continues smoothly is not an edge; a border without a continuation is.
#[test]
fn surfaces_continue_in_other_objects() {
    let at = |z: f64| DVec3::new(4.0, 0.0, z);
    let both =
        world(vec![("low", at(-1.0), prism(24, 0.3, 1.0, false)), ("high", at(0.0), prism(24, 0.3, 1.0, false))]);
    let anchor = side_of(0.3).with_z(0.5);
    let seen = see(&both, &pinhole(), &Pose::IDENTITY, vec![contour(1, "low", anchor), contour(2, "high", anchor)]);
    let level = |f: &&presight_features::SeenFeature| {
        let z = f.points_world[0].z;
        f.points_world.iter().all(|p| (p.z - z).abs() < 1e-6)
    };
    let heights: Vec<f64> = seen.features.iter().filter(level).map(|f| f.points_world[0].z).collect();
    assert!(heights.len() == 4 && heights.iter().all(|z| z.abs() > 0.9), "{heights:?}");
    let alone = world(vec![("low", at(-1.0), prism(24, 0.3, 1.0, false))]);
    let seen = see(&alone, &pinhole(), &Pose::IDENTITY, vec![contour(1, "low", anchor)]);
    let heights: Vec<f64> = seen.features.iter().filter(level).map(|f| f.points_world[0].z).collect();
    assert_eq!(heights.iter().filter(|z| z.abs() < 1e-6).count(), 2, "{heights:?}");
}

/// A store keeps a contour, undoes it, and reports its state.
#[cfg(feature = "store")]
#[test]
fn stores_keep_contours() {
    use presight_store as store;
    use presight_store::{Note, Store};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("post.presight");
    let note = Note::new("", 0.0);
    store::create(&path, post().environment(), &note).unwrap();
    let mut kept = Store::open(&path).unwrap();
    let feature = contour(7, "post", side_of(0.3));
    let number = kept.apply(Change::InsertFeature { class: "video".into(), feature: feature.clone() }, &note).unwrap();
    let off = contour(8, "post", DVec3::Z);
    assert!(kept.apply(Change::InsertFeature { class: "video".into(), feature: off }, &note).is_err());
    drop(kept);
    let read = store::read(&path).unwrap();
    assert_eq!(read.layer("video").unwrap().features, [feature.into()]);
    let mut kept = Store::open(&path).unwrap();
    kept.undo(number, false, &note).unwrap();
    drop(kept);
    assert!(store::read(&path).unwrap().layer("video").is_none_or(|l| l.features.is_empty()));
}
