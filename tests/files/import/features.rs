//! The supported features of scene files.

use crate::build::*;
use glam::{DMat3, DQuat, DVec3};
use presight_model::environment::Appearance;
use presight_model::error::ErrorKind;
use presight_read::gltf::{ImportOptions, import};
use presight_read::preparation::ProblemKind;
use serde_json::json;
use std::sync::Arc;

#[test]
fn all_index_types_and_none_give_the_same_triangles() {
    let expected = square_triangles(&[[0, 1, 2], [3, 2, 1]]);
    for component in [U8, U16, U32] {
        let mut g = Gltf::new();
        let positions = g.positions(&SQUARE);
        let indices = g.indices(component, &[0, 1, 2, 3, 2, 1]);
        g.mesh(json!([{"attributes": {"POSITION": positions}, "indices": indices}]));
        g.node(json!({"mesh": 0}));
        let read = g.import().unwrap();
        assert_eq!(mesh_triangles(&read.environment.objects()[0]), expected, "{component}");
        assert_eq!(read.environment.objects()[0].name, "node0");
    }
    let mut g = Gltf::new();
    let positions = g.positions(&[SQUARE[0], SQUARE[1], SQUARE[2], SQUARE[3], SQUARE[2], SQUARE[1]]);
    g.mesh(json!([{"attributes": {"POSITION": positions}}]));
    g.node(json!({"mesh": 0}));
    let object = g.import().unwrap().environment.objects()[0].clone();
    assert_eq!(mesh_triangles(&object), expected);
    assert_eq!(object.mesh.vertices().len(), 4, "equal positions are one vertex");
}

#[test]
fn strips_fans_and_lists_follow_the_specification() {
    type Case<'a> = (u32, &'a [u32], &'a [[usize; 3]]);
    let cases: [Case<'_>; 3] = [
        (4, &[0, 1, 2, 3, 2, 1, 4], &[[0, 1, 2], [3, 2, 1]]),
        (5, &[0, 1, 2, 3, 4], &[[0, 1, 2], [1, 3, 2], [2, 3, 4]]),
        (6, &[0, 1, 3, 2], &[[1, 3, 0], [3, 2, 0]]),
    ];
    for (mode, indices, expected) in cases {
        let mut g = Gltf::new();
        let positions = g.positions(&SQUARE);
        let indices = g.indices(U8, indices);
        g.mesh(json!([{"attributes": {"POSITION": positions}, "indices": indices, "mode": mode}]));
        g.node(json!({"mesh": 0}));
        let read = g.import().unwrap();
        assert_eq!(mesh_triangles(&read.environment.objects()[0]), square_triangles(expected), "mode {mode}");
        assert_eq!(read.report.total(ProblemKind::LeftoverIndices), u64::from(mode == 4));
    }
}

#[test]
fn points_and_lines_are_left_out_and_listed() {
    let mut g = Gltf::triangle();
    let positions = g.positions(&SQUARE);
    for mode in 0..4 {
        let primitive = json!({"attributes": {"POSITION": positions}, "mode": mode});
        g.json["meshes"][0]["primitives"].as_array_mut().unwrap().insert(0, primitive);
    }
    let read = g.import().unwrap();
    assert_eq!(read.report.total(ProblemKind::IgnoredPrimitive), 4);
    assert_eq!(read.report.triangles_in_scene, 1);
    let places = &read.report.problems.iter().find(|p| p.kind == ProblemKind::IgnoredPrimitive).unwrap().places;
    assert!(places[0].contains("mesh 0 \"mesh 0\": primitive 0"), "{places:?}");
}

#[test]
fn sparse_and_normalized_positions_are_computed() {
    let mut g = Gltf::new();
    // Base: all zeros, no buffer view; vertices 1 and 2 are replaced.
    let at = g.view(&[1, 2]);
    let bytes: Vec<u8> = [[1.0f32, 0.0, 0.0], [0.0, 1.0, 0.0]].iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    let values = g.view(&bytes);
    let sparse = g.push(
        "accessors",
        json!({"componentType": F32, "type": "VEC3", "count": 3, "sparse": {"count": 2,
            "indices": {"bufferView": at, "componentType": U8}, "values": {"bufferView": values}}}),
    );
    // i16, stride 8, normalized: -32768 is clamped to -1.
    let rows: [[i16; 4]; 3] = [[-32768, 0, 0, 9], [32767, 0, 16384, 9], [0, -32767, 0, 9]];
    let bytes: Vec<u8> = rows.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    let normalized = g.accessor(&bytes, I16, "VEC3", 3);
    g.json["accessors"][normalized]["normalized"] = json!(true);
    let view = g.json["accessors"][normalized]["bufferView"].as_u64().unwrap() as usize;
    g.json["bufferViews"][view]["byteStride"] = json!(8);
    let whole = g.push("accessors", json!({"bufferView": view, "componentType": I16, "type": "VEC3", "count": 3}));
    g.mesh(json!([
        {"attributes": {"POSITION": sparse}},
        {"attributes": {"POSITION": normalized}},
        {"attributes": {"POSITION": whole}},
    ]));
    g.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    g.node(json!({"mesh": 0}));
    let triangles = mesh_triangles(&g.import().unwrap().environment.objects()[0]);
    assert_eq!(triangles[0], square_triangles(&[[0, 1, 2]])[0]);
    let half = f64::from(16384.0f32 / 32767.0);
    assert_eq!(triangles[1], [[-1.0, 0.0, 0.0], [1.0, 0.0, half], [0.0, -1.0, 0.0]]);
    assert_eq!(triangles[2], [[-32768.0, 0.0, 0.0], [32767.0, 0.0, 16384.0], [0.0, -32767.0, 0.0]]);
}

#[test]
fn sparse_indices_replace_too() {
    let mut g = Gltf::new();
    let positions = g.positions(&SQUARE);
    let indices = g.indices(U16, &[0, 1, 1]);
    let at = g.view(&[2]);
    let value = g.view(&3u16.to_le_bytes());
    g.json["accessors"][indices]["sparse"] = json!({"count": 1,
        "indices": {"bufferView": at, "componentType": U8}, "values": {"bufferView": value}});
    g.mesh(json!([{"attributes": {"POSITION": positions}, "indices": indices}]));
    g.node(json!({"mesh": 0}));
    let read = g.import().unwrap();
    assert_eq!(mesh_triangles(&read.environment.objects()[0]), square_triangles(&[[0, 1, 3]]));
}

#[test]
fn primitives_are_one_mesh_with_a_material_each() {
    let mut g = Gltf::triangle();
    let positions = g.positions(&SQUARE);
    let other = g.indices(U8, &[3, 2, 1, 1, 1, 2, 4, 2, 1]);
    g.json["materials"] = json!([{"name": "red", "pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0, 1]}}, {}]);
    g.json["meshes"][0]["primitives"]
        .as_array_mut()
        .unwrap()
        .push(json!({"attributes": {"POSITION": positions}, "indices": other, "material": 0}));
    let read = g.import().unwrap();
    let names: Vec<_> = read.environment.materials().iter().map(|m| m.name.as_str()).collect();
    assert_eq!(names, ["red", "material1", "default"]);
    assert_eq!(read.environment.materials()[0].color, [1.0, 0.5, 0.0]);
    let mesh = &read.environment.objects()[0].mesh;
    assert_eq!((0..3).map(|i| mesh.material(i)).collect::<Vec<_>>(), [2, 0, 0]);
    // Source numbers continue through primitives and count the degenerate triangle in between.
    assert_eq!((0..3).map(|i| mesh.source(i)).collect::<Vec<_>>(), [0, 1, 3]);
    assert_eq!(mesh.vertices().len(), 5, "welded across primitives");
    let degenerate = &read.report.problems.iter().find(|p| p.kind == ProblemKind::DegenerateTriangle).unwrap();
    assert_eq!(degenerate.places, ["mesh 0 \"mesh 0\": primitive 1, triangle 1"]);
}

#[test]
fn the_hierarchy_is_walked_depth_first_with_full_paths() {
    let mut g = Gltf::triangle();
    g.json["nodes"] = json!([
        {"name": "x", "children": [3, 1]},
        {"name": "y", "mesh": 0, "children": [2], "translation": [1, 0, 0]},
        {"mesh": 0, "translation": [0, 2, 0]},
        {"name": "y", "mesh": 0},
        {"name": "elsewhere", "mesh": 0},
        {"name": "second root", "mesh": 0},
    ]);
    g.json["scenes"] = json!([{"nodes": [4]}, {"nodes": [0, 5]}]);
    g.json["scene"] = json!(1);
    let read = g.import().unwrap();
    let objects = read.environment.objects();
    let names: Vec<_> = objects.iter().map(|o| o.name.as_str()).collect();
    assert_eq!(names, ["x/y", "x/y#2", "x/y#2/node2", "second root"]);
    assert_eq!(objects.iter().map(|o| o.first_source).collect::<Vec<_>>(), [0, 1, 2, 3]);
    // From y up to z up: glTF's (1, 2, 0) is (1, 0, 2) here.
    assert_eq!(objects[2].world_from_object.translation, DVec3::new(1.0, 0.0, 2.0));
    assert!(objects.iter().all(|o| Arc::ptr_eq(&o.mesh, &objects[0].mesh)), "one mesh for all instances");
}

/// The number is added to the repeated name itself, so that each path contains the children of its node.
#[test]
fn repeated_names_are_numbered_where_they_are_repeated() {
    let mut g = Gltf::triangle();
    let hand = |g: &mut Gltf| g.node(json!({"name": "hand", "mesh": 0}));
    g.json["nodes"] = json!([]);
    let hands: Vec<usize> = (0..5).map(|_| hand(&mut g)).collect();
    let roots = [
        json!({"name": "arm", "children": [hands[0]]}),
        json!({"name": "arm", "children": [hands[1], hands[2]], "translation": [0, 2, 0]}),
        json!({"name": "arm", "mesh": 0, "children": [hands[3]]}),
        json!({"name": "arm#2", "mesh": 0}),
        // Nodes without objects, such as lights and cameras, get no number.
        json!({"name": "hand"}),
        json!({"name": "hand", "children": []}),
    ];
    let mut all: Vec<usize> = roots.into_iter().map(|node| g.node(node)).collect();
    all.push(hands[4]);
    g.json["scenes"] = json!([{"nodes": all}]);
    let read = g.import().unwrap();
    let names: Vec<_> = read.environment.objects().iter().map(|o| o.name.as_str()).collect();
    assert_eq!(names, ["arm/hand", "arm#2/hand", "arm#2/hand#2", "arm#3", "arm#3/hand", "arm#2#2", "hand"]);
    assert_eq!(read.environment.groups().into_keys().collect::<Vec<_>>(), ["arm", "arm#2"]);
    // Moving the second one moves its children, and nothing else.
    let at = |w: &presight_model::world::World, path: &str| w.environment().frame(path).unwrap().translation;
    let mut world = presight_model::world::World::new(read.environment);
    let before = world.clone();
    let to = presight_model::geometry::Pose {
        translation: DVec3::new(5.0, 0.0, 2.0),
        ..before.environment().frame("arm#2").unwrap()
    };
    world.apply(presight_model::change::Change::MoveObject { name: "arm#2".into(), world_from_object: to }).unwrap();
    for path in ["arm/hand", "arm#2/hand", "arm#2/hand#2", "arm#3", "arm#3/hand", "hand"] {
        let moved = if path.starts_with("arm#2/") { DVec3::X * 5.0 } else { DVec3::ZERO };
        assert!((at(&world, path) - at(&before, path) - moved).length() < 1e-12, "{path}");
    }
}

/// Nodes without a mesh are groups if a descendant has a mesh. A group's frame is the rigid part of the file's composed
/// transform.
#[test]
fn nodes_above_objects_are_groups_with_frames() {
    let mut g = Gltf::triangle();
    let empty = g.positions(&[[0.0; 3]; 3]);
    g.mesh(json!([{"attributes": {"POSITION": empty}}]));
    let turn = DQuat::from_rotation_y(0.4);
    g.json["nodes"] = json!([
        {"name": "site", "children": [1, 5], "translation": [4469320.2512, 1, -5333710.5021], "scale": [2, 2, 2]},
        {"name": "hall", "children": [2, 3], "rotation": turn.to_array(), "translation": [1, 0, 0], "scale": [1, 3, -1]},
        {"name": "door", "mesh": 0, "translation": [0, 1, 0]},
        {"name": "flat", "mesh": 1, "children": [4], "translation": [0, 0, 1]},
        {"name": "sign", "mesh": 0},
        {"name": "lamp", "children": [6]},
        {"name": "bulb"},
    ]);
    let read = g.import().unwrap();
    let groups = read.environment.groups();
    assert_eq!(groups.keys().copied().collect::<Vec<_>>(), ["site", "site/hall", "site/hall/flat"]);
    assert_eq!(read.environment.framed_groups().count(), 3);
    let near =
        |path: &str, p: DVec3| assert!((groups[path].translation - p).length() < 1e-8, "{path} {:?}", groups[path]);
    let site = DVec3::new(4469320.2512, 5333710.5021, 1.0);
    near("site", site);
    near("site/hall", site + DVec3::new(2.0, 0.0, 0.0));
    // The axes are converted as for objects: an object at the node would have the same pose.
    g.json["nodes"][1]["mesh"] = json!(0);
    let object = g.import().unwrap().environment.object("site/hall").unwrap().world_from_object;
    assert_eq!(groups["site/hall"], object);
    // A frame has neither mirror nor scale.
    let turned = groups["site/hall"].rotation_matrix();
    assert!((turned.determinant() - 1.0).abs() < 1e-12);
    // The sidecar also moves groups.
    let sidecar = "format = 1\nworld_from_scene = [10, 0, 0, 0, 0, 90]";
    g.json["nodes"][1].as_object_mut().unwrap().remove("mesh");
    let moved = g.import_with(&SOURCE, Some(sidecar)).unwrap().environment;
    let p = moved.frame("site").unwrap().translation;
    assert!((p - DVec3::new(10.0 - site.y, site.x, 1.0)).length() < 1e-8, "{p}");
}

#[test]
fn a_matrix_and_its_trs_are_the_same_place() {
    let (t, r) = (DVec3::new(1.5, -2.0, 3.0), DQuat::from_rotation_y(0.3) * DQuat::from_rotation_x(-1.1));
    for scale in [DVec3::ONE, DVec3::new(2.0, 0.5, 3.0), DVec3::new(-1.0, 1.0, 1.0), DVec3::splat(-2.0)] {
        let m = DMat3::from_quat(r) * DMat3::from_diagonal(scale);
        let columns = [m.x_axis.extend(0.0), m.y_axis.extend(0.0), m.z_axis.extend(0.0), t.extend(1.0)];
        let matrix: Vec<f64> = columns.iter().flat_map(|c| c.to_array()).collect();
        let mut g = Gltf::triangle();
        g.json["nodes"] = json!([
            {"children": [1, 2]},
            {"mesh": 0, "matrix": matrix},
            {"mesh": 0, "translation": t.to_array(), "rotation": r.to_array(), "scale": scale.to_array()},
        ]);
        let read = g.import().unwrap();
        for slot in 0..2 {
            let found = read.environment.polygon_in_world(slot).unwrap();
            // A mirror reverses the winding; the first corner stays the first.
            let mirrored = scale.x * scale.y * scale.z < 0.0;
            let mut corners = SQUARE[..found.len()].to_vec();
            if mirrored {
                corners[1..].reverse();
            }
            for (p, local) in found.iter().zip(&corners) {
                let q = m * DVec3::from_array(local.map(f64::from)) + t;
                let expected = DVec3::new(q.x, -q.z, q.y);
                assert!((*p - expected).length() < 1e-14, "{scale}: {p} {expected}");
            }
        }
    }
}

#[test]
fn a_site_in_utm_metres_keeps_its_millimetres() {
    // 0.1 mm apart at 5,000 km: f32 would round to half a metre.
    let mut g = Gltf::triangle();
    g.json["nodes"] = json!([
        {"children": [1, 2], "translation": [4469320.2512, 0, -5333710.5021]},
        {"mesh": 0},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.0001, 0, 0, 1]},
    ]);
    let check = |read: presight_read::preparation::ImportedScene| {
        let [a, b] = [0, 1].map(|i| read.environment.objects()[i].world_from_object.translation);
        assert!((a - DVec3::new(4469320.2512, 5333710.5021, 0.0)).length() < 1e-9, "{a}");
        assert!(((b - a).x - 1e-4).abs() < 2e-9);
    };
    check(g.import().unwrap());
    // The same translation from the sidecar.
    g.json["nodes"][0] = json!({"children": [1, 2]});
    let sidecar = "format = 1\nworld_from_scene = [4469320.2512, 5333710.5021, 0, 0, 0, 0]";
    check(g.import_with(&SOURCE, Some(sidecar)).unwrap());
}

#[test]
fn extras_set_the_material_and_the_sidecar_wins() {
    let mut g = Gltf::triangle();
    g.json["materials"] = json!([
        {"name": "glass", "extras": {"note": 3, "presight":
            {"reflection": 0.5, "one_sided": true, "classes": {"radar": "invisible", "laser": "transparent"}}}},
    ]);
    g.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let glass = g.import().unwrap().environment.materials()[0].clone();
    assert_eq!((glass.reflection, glass.one_sided), (0.5, true));
    assert_eq!(glass.appearance("radar"), Appearance::Invisible);
    let sidecar = "format = 1\n[material.glass]\nreflection = 0.25\n[material.glass.classes]\nradar = \"opaque\"";
    let glass = g.import_with(&SOURCE, Some(sidecar)).unwrap().environment.materials()[0].clone();
    assert_eq!((glass.reflection, glass.one_sided), (0.25, true));
    assert_eq!((glass.appearance("radar"), glass.appearance("laser")), (Appearance::Opaque, Appearance::Transparent));
    let e = g.import_with(&SOURCE, Some("format = 1\n[material.gloss]\nreflection = 0.25")).unwrap_err();
    assert!(e.file().unwrap().ends_with("s.materials.toml") && e.to_string().contains("gloss"), "{e}");
}

#[test]
fn buffers_may_be_embedded_or_lie_in_the_folder_or_below() {
    let g = Gltf::triangle();
    let folder = Folder::new();
    let with_uri = |uri: &str| {
        let mut json = g.json.clone();
        json["buffers"][0]["uri"] = json!(uri);
        json.to_string()
    };
    folder.write("below/some data.bin", &g.bin);
    let expected = mesh_triangles(&g.import().unwrap().environment.objects()[0]);
    for uri in ["below/some%20data.bin".to_owned(), format!("data:application/octet-stream;base64,{}", base64(&g.bin))]
    {
        let read = import(folder.write("s.gltf", with_uri(&uri).as_bytes()), &SOURCE).unwrap();
        assert_eq!(mesh_triangles(&read.environment.objects()[0]), expected);
    }
    let outside = folder.write("other/s.gltf", with_uri("../below/some%20data.bin").as_bytes());
    let e = import(outside, &SOURCE).unwrap_err();
    assert!(e.to_string().contains("leaves the folder"), "{e}");
    let missing = folder.write("s.gltf", with_uri("gone.bin").as_bytes());
    let e = import(missing, &SOURCE).unwrap_err();
    assert!(e.kind() == ErrorKind::Invalid && e.file().unwrap().ends_with("gone.bin"), "{e}");
}

#[test]
fn objects_without_polygons_are_left_out_but_counted() {
    let mut g = Gltf::triangle();
    let positions = g.positions(&[[0.0; 3]; 3]);
    g.mesh(json!([{"attributes": {"POSITION": positions}}]));
    g.json["nodes"] = json!([{"children": [1, 2]}, {"name": "flat", "mesh": 1}, {"mesh": 0, "skin": 0}]);
    let read = g.import().unwrap();
    assert_eq!(read.environment.objects().len(), 1);
    assert_eq!(read.environment.objects()[0].first_source, 1);
    assert_eq!(read.report.total(ProblemKind::EmptyMesh), 1);
    assert_eq!(read.report.total(ProblemKind::IgnoredFeature), 1);
}

#[test]
fn merging_is_per_mesh_and_keeps_materials_apart() {
    let mut g = Gltf::new();
    let positions = g.positions(&SQUARE);
    let first = g.indices(U8, &[0, 1, 2]);
    let second = g.indices(U8, &[3, 2, 1]);
    g.json["materials"] = json!([{"name": "m"}, {"name": "n"}]);
    let primitive = |indices: usize, material: u32| json!({"attributes": {"POSITION": positions}, "indices": indices, "material": material});
    g.mesh(json!([primitive(first, 0), primitive(second, 0)]));
    g.mesh(json!([primitive(first, 0), primitive(second, 1)]));
    g.json["nodes"] = json!([{"children": [1, 2, 3]}, {"mesh": 0}, {"mesh": 0, "scale": [2, 2, -2]}, {"mesh": 1}]);
    let read = g.import_with(&ImportOptions::default(), None).unwrap();
    let counts: Vec<_> = read.environment.objects().iter().map(|o| o.mesh.polygon_count()).collect();
    assert_eq!(counts, [1, 1, 2]);
    let report = &read.report;
    assert_eq!((report.merges, report.polygons_stored, report.polygons_in_scene), (1, 3, 4));
    assert_eq!(read.environment.objects()[0].mesh.corner_indices(0).len(), 4);
    let flat = ImportOptions { merge_tolerance: f64::NAN, ..ImportOptions::default() };
    assert_eq!(g.import_with(&flat, None).unwrap_err().kind(), ErrorKind::Usage);
}
