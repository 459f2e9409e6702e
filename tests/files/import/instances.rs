//! Instances of nodes, hidden nodes and flat ones, with places worked out by hand.

use crate::build::*;
use glam::DVec3;
use presight_model::error::ErrorKind;
use presight_read::gltf::import_bytes;
use presight_read::preparation::{ImportedScene, ProblemKind};
use serde_json::{Value, json};

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn names(read: &ImportedScene) -> Vec<&str> {
    read.environment.objects().iter().map(|o| o.name.as_str()).collect()
}

/// A node at (1, 0, 0) with two instances of the triangle, and this child.
fn instanced(child: Option<Value>) -> Gltf {
    let mut g = Gltf::triangle();
    let translations = g.accessor(&bytes(&[0.0, 0.0, 0.0, 0.0, 2.0, 0.0]), F32, "VEC3", 2);
    // None, and half a turn about y, in 16 bits.
    let turns: Vec<u8> = [0i16, 0, 0, 32767, 0, 32767, 0, 0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let rotations = g.accessor(&turns, I16, "VEC4", 2);
    g.json["accessors"][rotations]["normalized"] = json!(true);
    let scales = g.accessor(&bytes(&[1.0, 1.0, 1.0, 2.0, 1.0, 1.0]), F32, "VEC3", 2);
    let attributes = json!({"TRANSLATION": translations, "ROTATION": rotations, "SCALE": scales, "_ID": 3});
    let extensions = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
    g.json["nodes"][0] = json!({"name": "tree", "mesh": 0, "translation": [1, 0, 0], "extensions": extensions});
    g.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    g.json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
    if let Some(child) = child {
        let child = g.node(child);
        g.json["nodes"][0]["children"] = json!([child]);
    }
    g
}

#[test]
fn every_instance_is_an_object() {
    let read = instanced(None).import().unwrap();
    assert_eq!((names(&read), read.report.notices.len()), (vec!["tree", "tree#2"], 0));
    assert_eq!(read.report.triangles_in_scene, 2);
    // glTF's corners (0, 0, 0), (1, 0, 0), (0, 1, 0), twice as wide, turned, up 2 and at (1, 0, 0); z is up here.
    let expected = [DVec3::new(1.0, 0.0, 2.0), DVec3::new(-1.0, 0.0, 2.0), DVec3::new(1.0, 0.0, 3.0)];
    let found = read.environment.objects()[1].polygon_in_world(0);
    assert!(found.iter().zip(expected).all(|(a, b)| (*a - b).length() < 1e-12), "{found:?}");
    // Children are there once.
    let read = instanced(Some(json!({"name": "nest", "mesh": 0}))).import().unwrap();
    assert_eq!(names(&read), ["tree#2", "tree#3", "tree/nest"]);
    assert_eq!(read.environment.groups().into_keys().collect::<Vec<_>>(), ["tree"]);
}

#[test]
fn broken_instances_are_refused_and_counted_before_they_are_made() {
    let of = |accessor: usize, key: &str, value: Value| {
        let mut g = instanced(None);
        g.json["accessors"][accessor][key] = value;
        g
    };
    let mut missing = instanced(None);
    missing.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"] = json!({});
    for (g, words) in [
        (of(2, "count", json!(1)), ["node 0 \"tree\"", "differ in number"]),
        (of(2, "type", json!("VEC2")), ["accessor 2", "must be VEC3"]),
        (of(3, "normalized", json!(false)), ["node 0 \"tree\"", "instance 0 is not a unit quaternion"]),
        (missing, ["/nodes/0/extensions/EXT_mesh_gpu_instancing", "\"attributes\" is missing"]),
    ] {
        let e = g.import().unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && words.iter().all(|word| e.to_string().contains(word)), "{e}");
    }
    // Instances with long names, refused before they are made.
    let mut g = instanced(None);
    let many = g.accessor(&vec![0; 12 * 400_000], F32, "VEC3", 400_000);
    let node = json!({"name": "x".repeat(4000), "mesh": 0,
        "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": many}}}});
    g.json["nodes"] = json!([node]);
    let e = g.import().unwrap_err();
    assert!(e.to_string().contains("bytes of memory"), "{e}");
}

#[test]
fn hidden_nodes_hide_their_children() {
    let mut g = Gltf::triangle();
    let visibility = |visible: bool| json!({"KHR_node_visibility": {"visible": visible}});
    g.json["nodes"] = json!([
        {"name": "plate", "mesh": 0, "extensions": visibility(true)},
        {"name": "hidden", "mesh": 0, "extensions": visibility(false), "children": [2]},
        {"name": "child", "mesh": 0, "extensions": visibility(true)},
        {"name": "default", "mesh": 0, "extensions": {"KHR_node_visibility": {}}},
    ]);
    g.json["scenes"][0]["nodes"] = json!([0, 1, 3]);
    g.json["extensionsRequired"] = json!(["KHR_node_visibility"]);
    let read = g.import().unwrap();
    assert_eq!(names(&read), ["plate", "default"]);
    assert_eq!(read.report.notices, ["KHR_node_visibility hides objects: they are left out (2 objects)"]);
    g.json["nodes"][0]["extensions"]["KHR_node_visibility"]["visible"] = json!("no");
    let e = g.import().unwrap_err().to_string();
    assert!(e.contains("/nodes/0/extensions/KHR_node_visibility/visible"), "{e}");
}

#[test]
fn what_a_scale_of_zero_flattens_is_left_out_and_listed() {
    let mut g = Gltf::triangle();
    g.json["nodes"] = json!([
        {"name": "plate", "mesh": 0},
        {"name": "gone", "scale": [0, 0, 0], "children": [2]},
        {"name": "below", "mesh": 0, "rotation": [0, 0.6, 0, 0.8]},
        {"name": "flat", "scale": [1, 0, 1], "children": [4]},
        {"name": "turned", "mesh": 0, "rotation": [0.5, 0.5, 0.5, 0.5]},
    ]);
    g.json["scenes"][0]["nodes"] = json!([0, 1, 3]);
    let read = g.import().unwrap();
    assert_eq!(names(&read), ["plate"]);
    assert_eq!(read.report.total(ProblemKind::EmptyMesh), 2);
    let expected =
        "left out, because a scale of zero leaves no area: node 2 \"gone/below\", node 4 \"flat/turned\" (2 objects)";
    assert_eq!(read.report.notices, [expected]);
    // A triangle across the flattened axis is a plate: its area is kept.
    g.json["nodes"][3]["scale"] = json!([1, 1, 0]);
    g.json["nodes"][4]["rotation"] = json!([0, 0, 0, 1]);
    let flat = g.import().unwrap();
    assert_eq!(names(&flat), ["plate", "flat/turned"]);
    let [plate, turned] = [0, 1].map(|k| flat.environment.objects()[k].polygon_in_world(0));
    assert!(plate.iter().zip(&turned).all(|(a, b)| a.distance(*b) < 1e-6), "{plate:?} {turned:?}");
    // A tiny scale is still refused.
    g.json["nodes"][0]["scale"] = json!([1e-10, 1, 1]);
    assert!(g.import().unwrap_err().to_string().contains("node 0 \"plate\""));
}

/// glTF leaves the meaning of a buffer without `uri` to extensions, but the first one of a .glb is its chunk.
#[test]
fn objects_in_buffers_without_data_are_left_out_and_listed() {
    let mut g = Gltf::triangle();
    let nowhere = g.push("buffers", json!({"byteLength": 100}));
    let view = g.push("bufferViews", json!({"buffer": nowhere, "byteLength": 100}));
    assert_eq!(g.import().unwrap().report.notices, [""; 0]);
    let mut accessor =
        |kind: &str| g.push("accessors", json!({"bufferView": view, "componentType": F32, "type": kind, "count": 1}));
    let (lost, bind) = (accessor("VEC3"), accessor("MAT4"));
    let sparse = g.accessor(&[0; 36], F32, "VEC3", 3);
    let at = json!({"bufferView": view, "componentType": U8});
    g.json["accessors"][sparse]["sparse"] = json!({"count": 1, "indices": at, "values": {"bufferView": 0}});
    let (joints, weights) = (g.accessor(&[0; 12], U8, "VEC4", 3), g.accessor(&[0; 48], F32, "VEC4", 3));
    let attributes = json!({"POSITION": 0, "NORMAL": lost, "JOINTS_0": joints, "WEIGHTS_0": weights});
    let whole = g.mesh(json!([{"attributes": attributes}]));
    let shapes = [json!({"POSITION": lost}), json!({"POSITION": sparse})];
    let [first, second] =
        shapes.map(|attributes| g.mesh(json!([{"attributes": {"POSITION": 0}}, {"attributes": attributes}])));
    let instances = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": lost}}});
    g.json["skins"] = json!([{"joints": [0], "inverseBindMatrices": bind}]);
    g.json["nodes"] = json!([
        {"name": "plate", "mesh": whole, "children": [1]},
        {"name": "part", "mesh": first},
        {"name": "sparse", "mesh": second},
        {"name": "person", "mesh": whole, "skin": 0},
        {"name": "tree", "mesh": whole, "extensions": instances},
    ]);
    g.json["scenes"][0]["nodes"] = json!([0, 2, 3, 4]);
    let read = g.import().unwrap();
    assert_eq!(names(&read), ["plate"]);
    assert_eq!(read.report.total(ProblemKind::EmptyMesh), 4);
    let expected = "left out, because their buffer has no data: node 1 \"plate/part\", node 2 \"sparse\", node 3 \"person\", \
                    node 4 \"tree\" (4 objects); export the scene as .glb, which holds its buffers";
    assert_eq!(read.report.notices, [expected]);
    g.json["scenes"][0]["nodes"] = json!([2]);
    let e = g.import().unwrap_err().to_string();
    assert!(e.contains("no polygons; left out: node 2 \"sparse\": buffer 1 has no data; export"), "{e}");
    // Without its chunk, a .glb is truncated; its JSON alone is a scene without data.
    let mut glb = Gltf::triangle().glb();
    let end = 20 + u32::from_le_bytes(glb[12..16].try_into().unwrap());
    glb.truncate(end as usize);
    glb[8..12].copy_from_slice(&end.to_le_bytes());
    for (bytes, words) in [
        (&glb[..], "buffer 0: it has no data; the file is truncated"),
        (&glb[20..], "no polygons; left out: node 0 \"a\": buffer 0 has no data; export"),
    ] {
        let e = import_bytes("s", bytes, &SOURCE).unwrap_err().to_string();
        assert!(e.contains(words), "{e}");
    }
}
