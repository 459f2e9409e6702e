//! Parts of a file that shape the scene and are not followed: each has one line with the number of objects.

use crate::build::*;
use presight_model::environment::Appearance;
use presight_read::gltf::import_bytes;
use presight_read::preparation::ProblemKind;
use serde_json::json;

fn notices(g: &Gltf) -> Vec<String> {
    g.import().unwrap().report.notices
}

#[test]
fn unknown_extensions_are_counted_by_objects() {
    let mut g = Gltf::triangle();
    let mesh = g.json["meshes"][0].clone();
    let other = g.push("meshes", mesh);
    g.json["meshes"][other]["primitives"][0]["extensions"] =
        json!({"ACME_bend": {"by": 3}, "KHR_materials_variants": {}});
    g.json["nodes"] = json!([
        {"name": "moved", "extensions": {"ACME_move": {}, "EXT_lights_ies": {}}, "children": [1, 2]},
        {"name": "a", "mesh": 0, "extensions": {"ACME_move": {}}},
        {"name": "b", "mesh": 0},
        {"name": "c", "mesh": other},
        {"name": "d", "mesh": 0, "extensions": {"MSFT_lod": {"ids": [5]}}},
        {"name": "coarse", "mesh": 0},
    ]);
    g.json["scenes"][0]["nodes"] = json!([0, 3, 4]);
    let harmless = ["KHR_materials_unlit", "KHR_mesh_quantization", "KHR_animation_pointer", "EXT_mesh_features"];
    g.json["extensionsUsed"] = harmless.iter().copied().chain(["ACME_none", "MSFT_lod"]).collect();
    let line = |name: &str, count: &str| {
        format!("extension \"{name}\" is not followed: the data without it is used ({count})")
    };
    let expected =
        [("ACME_bend", "1 object"), ("ACME_move", "2 objects"), ("ACME_none", "0 objects"), ("MSFT_lod", "1 object")];
    assert_eq!(notices(&g), expected.map(|(name, count)| line(name, count)));
    assert_eq!(g.import().unwrap().report.total(ProblemKind::IgnoredFeature), 4);
    // Many names stay few lines.
    g.json["extensionsUsed"] = (0..1000).map(|i| format!("ACME_{i}")).collect();
    assert_eq!(notices(&g).len(), 21);
}

#[test]
fn morph_targets_are_counted_by_objects() {
    let mut g = Gltf::triangle();
    let moved = g.positions(&SQUARE[..3]);
    g.json["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": moved}]);
    g.json["nodes"] = json!([{"mesh": 0}, {"mesh": 0}]);
    g.json["scenes"][0]["nodes"] = json!([0, 1]);
    assert_eq!(notices(&g), ["morph targets are not followed: the base shape is used (2 objects)"]);
}

/// The line that the notice gives ends the notice, and changes what the sensor sees.
#[test]
fn see_through_materials_are_named_with_the_line_that_changes_them() {
    let mut g = Gltf::triangle();
    g.json["materials"] = json!([
        {"name": "Glass \"A\"", "alphaMode": "BLEND"},
        {"name": "Water", "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.5}}},
        {"name": "wall", "alphaMode": "MASK", "extensions": {"KHR_materials_transmission": {}}},
        {"name": "unused", "alphaMode": "BLEND"},
    ]);
    let primitive = g.json["meshes"][0]["primitives"][0].clone();
    g.json["meshes"] = (0..3)
        .map(|i| {
            let mut primitive = primitive.clone();
            primitive["material"] = json!(i);
            json!({"primitives": [primitive]})
        })
        .collect();
    g.json["nodes"] = json!([{"mesh": 0}, {"mesh": 1}, {"mesh": 1}, {"mesh": 2}]);
    g.json["scenes"][0]["nodes"] = json!([0, 1, 2, 3]);
    let said = notices(&g);
    let [notice] = &said[..] else { panic!("{said:?}") };
    let (what, remedy) = notice.split_once("; to change that, write ").unwrap();
    assert_eq!(what, "see-through materials are opaque here: \"Glass \\\"A\\\"\", \"Water\" (3 objects)");
    let line = remedy.strip_suffix(" below format = 1 in s.materials.toml").unwrap();
    let sidecar = format!("format = 1\n{line}\n");
    let read = g.import_with(&SOURCE, Some(&sidecar)).unwrap();
    assert_eq!(read.environment.materials()[0].appearance("laser"), Appearance::Transparent);
    assert!(read.report.notices[0].starts_with("see-through materials are opaque here: \"Water\" (2 objects)"));
    // To keep a material opaque is a decision, too; so are the properties in the file itself.
    g.json["materials"][1]["extras"] = json!({"presight": {"classes": {"video": "opaque"}}});
    assert_eq!(g.import_with(&SOURCE, Some(&sidecar)).unwrap().report.notices, Vec::<String>::new());
}

#[test]
fn a_center_that_is_not_followed_is_named_with_its_distance() {
    let mut g = Gltf::triangle();
    g.json["extensionsUsed"] = json!(["CESIUM_RTC"]);
    g.json["extensions"] = json!({"CESIUM_RTC": {"center": [3000000, 4000000, 0.5]}});
    let said = notices(&g);
    let [notice] = &said[..] else { panic!("{said:?}") };
    for words in ["5000.0 km", "[3000000.0, 4000000.0, 0.5]", "1 object", "world_from_scene in s.materials.toml"] {
        assert!(notice.contains(words), "{notice}");
    }
}

/// A warning only where another origin helps: not for a wide mesh around its own.
#[test]
fn digits_are_lost_far_from_the_origin_of_the_mesh() {
    let triangle = |corners: [[f32; 3]; 3]| {
        let mut g = Gltf::new();
        let positions = g.positions(&corners);
        g.mesh(json!([{"attributes": {"POSITION": positions}}]));
        g.node(json!({"mesh": 0}));
        g
    };
    let at = |x: f32| triangle([[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 1.0, 0.0]]);
    let apart = |g: &Gltf| g.import().unwrap().report.notices.first().map(|line| line[..49].to_owned());
    assert_eq!(apart(&at(8000.0)), None);
    assert_eq!(apart(&at(9000.0)).as_deref(), Some("mesh 0 \"mesh 0\": its vertices are 0.001 m apart a"));
    assert_eq!(apart(&triangle([[-9e4, 0.0, 0.0], [9e4, 0.0, 0.0], [0.0, 9e4, 0.0]])), None);
    // A million units of a millimetre are a kilometre, which 32 bits hold to 0.06 mm.
    let mut small = at(1e6);
    small.json["nodes"][0]["scale"] = json!([0.001, 0.001, 0.001]);
    assert_eq!(apart(&small), None);
    let mut large = at(8000.0);
    large.json["nodes"][0]["scale"] = json!([10, 10, 10]);
    assert_eq!(apart(&large).as_deref(), Some("mesh 0 \"mesh 0\": its vertices are 0.005 m apart a"));
}

#[test]
fn scenes_in_memory_have_the_same_notices() {
    let mut g = Gltf::triangle();
    g.json["extensionsUsed"] = json!(["ACME_none"]);
    assert_eq!(import_bytes("s.glb", &g.glb(), &SOURCE).unwrap().report.notices, notices(&g));
}
