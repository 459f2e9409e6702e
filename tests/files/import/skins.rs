//! Skins at rest, with places worked out by hand.

use crate::build::*;
use glam::DVec3;
use presight_model::error::ErrorKind;
use presight_read::preparation::ImportedScene;
use serde_json::{Value, json};
use std::sync::Arc;

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// The joint matrix that moves by this vector, column by column.
fn moved(by: [f32; 3]) -> [f32; 16] {
    let [x, y, z] = by;
    [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, y, z, 1.0]
}

/// A triangle in centimetres whose mesh node lies elsewhere. An armature of scale 0.01 holds the hips and, 100 cm
/// higher, the head, which rests 50 cm further along z than where it was bound. The first vertex follows both, the
/// second the hips, the third the head.
fn person() -> Gltf {
    let mut g = Gltf::new();
    let positions = g.positions(&[[200.0, 100.0, 0.0], [0.0, 0.0, 0.0], [0.0, 100.0, 0.0]]);
    let joints = g.accessor(&[0, 1, 9, 9, 0, 0, 0, 0, 1, 0, 0, 0], U8, "VEC4", 3);
    let weights = g.accessor(&[[128, 128, 0, 0], [255, 0, 0, 0], [255, 0, 0, 0]].concat(), U8, "VEC4", 3);
    g.json["accessors"][weights]["normalized"] = json!(true);
    let bind = g.accessor(&floats(&[moved([0.0; 3]), moved([0.0, -100.0, 0.0])].concat()), F32, "MAT4", 2);
    g.mesh(json!([{"attributes": {"POSITION": positions, "JOINTS_0": joints, "WEIGHTS_0": weights}}]));
    g.json["nodes"] = json!([
        {"name": "person", "mesh": 0, "skin": 0, "translation": [70, 80, 90], "scale": [3, 3, 3]},
        {"name": "armature", "scale": [0.01, 0.01, 0.01], "children": [2]},
        {"name": "hips", "children": [3]},
        {"name": "head", "translation": [0, 100, 50]},
    ]);
    g.json["scenes"][0]["nodes"] = json!([0, 1]);
    g.json["skins"] = json!([{"joints": [2, 3], "inverseBindMatrices": bind}]);
    g
}

/// In the world (x, -z, y), metres: the head rests 0.5 m along z, which moves the first vertex by half of that.
const PLACES: [DVec3; 3] = [DVec3::new(2.0, -0.25, 1.0), DVec3::ZERO, DVec3::new(0.0, -0.5, 1.0)];

fn check(read: &ImportedScene, places: [DVec3; 3], within: f64) {
    let found = read.environment.objects()[0].polygon_in_world(0);
    for (found, place) in found.iter().zip(places) {
        assert!((*found - place).length() <= within, "{found} {place}");
    }
}

#[test]
fn joints_place_the_vertices_and_the_node_does_not() {
    let g = person();
    let read = g.import().unwrap();
    check(&read, PLACES, 1e-6);
    assert_eq!(read.report.notices, Vec::<String>::new());
    assert_eq!(read.environment.objects()[0].name, "person");
    // Without inverse bind matrices the head moves its vertices from where they are: by (0, 100, 50) more.
    let mut unbound = g.clone();
    unbound.json["skins"][0].as_object_mut().unwrap().remove("inverseBindMatrices");
    check(&unbound.import().unwrap(), [PLACES[0] + DVec3::new(0.0, 0.0, 0.5), PLACES[1], PLACES[2] + DVec3::Z], 1e-6);
    // A vertex without weights follows the first joint.
    let mut loose = g;
    let at = loose.json["bufferViews"][2]["byteOffset"].as_u64().unwrap() as usize;
    loose.bin[at..at + 4].fill(0);
    check(&loose.import().unwrap(), [DVec3::new(2.0, 0.0, 1.0), PLACES[1], PLACES[2]], 1e-6);
}

#[test]
fn a_person_on_a_map_keeps_the_millimetres() {
    let mut g = person();
    let site = g.node(json!({"name": "site", "translation": [4469320.2512, 0, -5333710.5021], "children": [1]}));
    g.json["scenes"][0]["nodes"] = json!([0, site]);
    let at = DVec3::new(4469320.2512, 5333710.5021, 0.0);
    let read = g.import().unwrap();
    check(&read, PLACES.map(|p| p + at), 1e-6);
    assert!((read.environment.objects()[0].world_from_object.translation - at).length() < 1e-8);
}

#[test]
fn a_posed_mesh_is_shared_and_its_unposed_one_is_another() {
    let mut g = person();
    let again = g.node(json!({"name": "twin", "mesh": 0, "skin": 0}));
    let plain = g.node(json!({"name": "statue", "mesh": 0}));
    g.json["scenes"][0]["nodes"] = json!([0, 1, again, plain]);
    let read = g.import().unwrap();
    let objects = read.environment.objects();
    assert!(Arc::ptr_eq(&objects[0].mesh, &objects[1].mesh));
    // The turn from y-up rounds in f64.
    let off = objects[2].polygon_in_world(0)[0] - DVec3::new(200.0, 0.0, 100.0);
    assert!(off.length() < 1e-12 * 200.0, "{off}");
}

#[test]
fn a_skin_without_joints_and_weights_is_not_followed() {
    let mut g = Gltf::triangle();
    g.json["nodes"][0]["skin"] = json!(0);
    let read = g.import().unwrap();
    let expected = "skins of meshes without joints or weights are not followed: their nodes place them (1 object)";
    assert_eq!(read.report.notices, [expected]);
}

#[test]
fn broken_skins_are_refused_with_their_place() {
    let set =
        |pointer: &'static str, value: Value| move |g: &mut Gltf| *g.json.pointer_mut(pointer).unwrap() = value.clone();
    type Break<'a> = Box<dyn Fn(&mut Gltf) + 'a>;
    let cases: [(&[&str], Break<'_>); 9] = [
        (&["skin 7", "there are 1"], Box::new(set("/nodes/0/skin", json!(7)))),
        (&["skin 0", "no joints"], Box::new(set("/skins/0/joints", json!([])))),
        (&["skin 0", "node 9, a joint"], Box::new(set("/skins/0/joints/1", json!(9)))),
        (&["skin 0", "3 joints have only 2"], Box::new(set("/skins/0/joints", json!([1, 2, 3])))),
        (&["skin 0", "accessor 0", "must be MAT4"], Box::new(set("/skins/0/inverseBindMatrices", json!(0)))),
        (&["primitive 0", "vertex 0 names joint 9"], Box::new(|g| g.bin[37] = 9)),
        (
            &["accessor 1", "joints must be u8"],
            Box::new(|g| {
                let values = floats(&[0.0; 12]);
                let view = g.view(&values);
                g.json["accessors"][1] = json!({"bufferView": view, "componentType": F32, "type": "VEC4", "count": 3});
            }),
        ),
        (&["3 vertices have only 2"], Box::new(set("/accessors/2/count", json!(2)))),
        (&["accessor 2", "claimed"], Box::new(set("/accessors/2/count", json!(3_000_000)))),
    ];
    for (words, change) in cases {
        let mut g = person();
        change(&mut g);
        let e = g.import().unwrap_err();
        let text = e.to_string();
        assert!(e.kind() == ErrorKind::Invalid && !e.remedy().is_empty() && !text.contains('\n'), "{words:?}: {text}");
        assert!(words.iter().all(|word| text.contains(word)), "{words:?}: {text}");
    }
}
