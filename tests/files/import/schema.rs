//! Valid files are read: a file with every property of the schema, without each of them in turn.

use crate::build::*;
use presight_model::error::{Error, ErrorKind};
use presight_read::gltf::{ImportOptions, import};
use presight_read::preparation::ImportedScene;
use serde_json::{Value, json};

/// The required properties of the schema that presight uses; `*` is any number.
const REQUIRED: [&str; 18] = [
    "/asset",
    "/asset/version",
    "/accessors/*/componentType",
    "/accessors/*/count",
    "/accessors/*/type",
    "/accessors/*/sparse/count",
    "/accessors/*/sparse/indices",
    "/accessors/*/sparse/values",
    "/accessors/*/sparse/indices/bufferView",
    "/accessors/*/sparse/indices/componentType",
    "/accessors/*/sparse/values/bufferView",
    "/bufferViews/*/buffer",
    "/bufferViews/*/byteLength",
    "/buffers/*/byteLength",
    "/meshes/*/primitives",
    "/meshes/*/primitives/*/attributes",
    "/skins/*/joints",
    "/nodes/*/extensions/EXT_mesh_gpu_instancing/attributes",
];

/// Optional properties without which this file is not valid or empty: others name their entries.
const NEEDED: [&str; 10] = [
    "/scenes",
    "/nodes",
    "/meshes",
    "/materials",
    "/accessors",
    "/bufferViews",
    "/buffers",
    "/skins",
    "/scenes/0/nodes",
    // A rotation of zeros.
    "/accessors/8/bufferView",
];

/// The parts that presight does not use, as a file of any program may have them.
fn unused() -> Value {
    json!({
        "animations": [{
            "name": "run",
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}, {"sampler": 0, "target": {
                "path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": "/nodes/0/scale"}}}}],
            "samplers": [{"input": 0, "output": 0, "interpolation": "LINEAR"}],
        }],
        "cameras": [
            {"type": "perspective", "name": "c", "perspective":
                {"yfov": 1.0, "znear": 0.1, "zfar": 100, "aspectRatio": 1.5}},
            {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 9}},
        ],
        "images": [{"uri": "http://example.org/a.png", "mimeType": "image/png"}, {"bufferView": 0, "mimeType": "image/webp"}],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33648}],
        "textures": [{"sampler": 0, "source": 0, "extensions": {"EXT_texture_webp": {"source": 1}}}],
        "extras": {"a": null},
    })
}

/// One primitive of a triangle with every property, one object with a skin, one with instances; `plate` is first.
fn full() -> Value {
    let mut g = Gltf::new();
    let positions = g.positions(&[[2.0, -1.0, 1.0], [2.0, -1.0, -1.0], [2.0, 1.0, -1.0]]);
    let indices = g.indices(U16, &[0, 1, 2]);
    let (other_positions, other_indices) =
        (g.positions(&[[3.0, -1.0, 1.0], [3.0, -1.0, -1.0], [3.0, 1.0, -1.0]]), g.indices(U8, &[0, 1, 2]));
    let joints = g.accessor(&[0; 12], U8, "VEC4", 3);
    let weights: Vec<u8> = [1.0f32, 0.0, 0.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let weights = g.accessor(&weights.repeat(3), F32, "VEC4", 3);
    let identity: Vec<u8> = (0..16).flat_map(|i| f32::to_le_bytes(if i % 5 == 0 { 1.0 } else { 0.0 })).collect();
    let bind = g.accessor(&identity, F32, "MAT4", 1);
    let zeros = g.accessor(&[0; 12], F32, "VEC3", 1);
    let turn: Vec<u8> = [0.0f32, 0.0, 0.0, 1.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let (turn, scale) = (g.accessor(&turn, F32, "VEC4", 1), g.positions(&[[1.0; 3]]));
    let (at, value) = (g.view(&[0]), g.view(&[0; 12]));
    g.json["accessors"][zeros]["sparse"] = json!({"count": 1,
        "indices": {"bufferView": at, "byteOffset": 0, "componentType": U8, "extras": 1},
        "values": {"bufferView": value, "byteOffset": 0, "extensions": {}}});
    for accessor in g.json["accessors"].as_array_mut().unwrap() {
        for (key, value) in [
            ("byteOffset", json!(0)),
            ("normalized", json!(false)),
            ("name", json!("a")),
            ("min", json!([0])),
            ("max", json!([1])),
            ("extras", json!("x")),
        ] {
            accessor[key] = value;
        }
    }
    g.json["meshes"] = json!([
        {"name": "m", "primitives": [{"attributes": {"POSITION": positions}, "indices": indices}]},
        {"name": "all", "weights": [0], "extras": [1], "primitives": [{
            "attributes": {"POSITION": other_positions, "NORMAL": positions, "JOINTS_0": joints, "WEIGHTS_0": weights, "_X": 0},
            "indices": other_indices, "material": 0, "mode": 4, "targets": [{"POSITION": positions}], "extras": true,
            "extensions": {"KHR_materials_variants": {"mappings": [{"material": 0, "variants": [0], "name": "v"}]}},
        }]},
    ]);
    g.json["materials"] = json!([{
        "name": "paint", "alphaMode": "MASK", "alphaCutoff": 0.4, "doubleSided": true, "emissiveFactor": [0, 0, 0],
        "normalTexture": {"index": 0, "texCoord": 0, "scale": 1}, "extras": {"b": 1},
        "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1], "baseColorTexture": {"index": 0, "texCoord": 0}},
        "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0}, "KHR_materials_volume": {}},
    }]);
    let instances = json!({"TRANSLATION": zeros, "ROTATION": turn, "SCALE": scale});
    g.json["nodes"] = json!([
        {"name": "plate", "mesh": 0},
        {"name": "person", "mesh": 1, "skin": 0, "weights": [0], "extras": 42, "camera": 0},
        {"name": "tree", "mesh": 0, "translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1], "children": [3],
            "extensions": {"EXT_mesh_gpu_instancing": {"attributes": instances}}},
        {"name": "leaf", "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
            "extensions": {"KHR_node_visibility": {"visible": true}, "KHR_lights_punctual": {"light": 0}}},
        {"extras": null}, {"extras": false}, {"extras": "string"}, {"children": [4]},
    ]);
    g.json["scenes"] = json!([{"name": "s", "nodes": [0, 1, 2, 7], "extras": 1}, {"name": "empty"}, {}]);
    g.json["skins"] = json!([{"joints": [0], "inverseBindMatrices": bind, "skeleton": 0, "name": "skin"}]);
    g.json["asset"] = json!({"version": "2.0", "minVersion": "2.0", "generator": "g", "copyright": "c"});
    g.json["extensionsUsed"] = json!(["KHR_materials_volume", "EXT_mesh_gpu_instancing", "KHR_node_visibility"]);
    g.json["extensionsRequired"] = json!(["KHR_node_visibility"]);
    g.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "point"}]}});
    let mut all = g.json;
    // Each view in a buffer of its own, so that its offset is the default.
    let views = all["bufferViews"].as_array().unwrap().clone();
    let bytes = |view: &Value| {
        let [start, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap() as usize);
        format!("data:application/octet-stream;base64,{}", base64(&g.bin[start..start + length]))
    };
    all["buffers"] =
        views.iter().map(|view| json!({"byteLength": view["byteLength"], "uri": bytes(view), "name": "b"})).collect();
    for (i, view) in all["bufferViews"].as_array_mut().unwrap().iter_mut().enumerate() {
        (view["buffer"], view["byteOffset"], view["target"], view["name"]) =
            (json!(i), json!(0), json!(34962), json!("v"));
    }
    all["bufferViews"][0]["byteStride"] = json!(12);
    all.as_object_mut().unwrap().extend(unused().as_object().unwrap().clone());
    all
}

/// The JSON pointers of all properties in a value.
fn pointers(value: &Value, at: &str, found: &mut Vec<String>) {
    let mut visit = |key: &str, value: &Value, is_property: bool| {
        let pointer = format!("{at}/{key}");
        if is_property {
            found.push(pointer.clone());
        }
        pointers(value, &pointer, found);
    };
    match value {
        Value::Object(map) => map.iter().for_each(|(key, value)| visit(key, value, true)),
        Value::Array(list) => list.iter().enumerate().for_each(|(i, value)| visit(&i.to_string(), value, false)),
        _ => {}
    }
}

/// The pointer with `*` in place of numbers.
fn pattern(pointer: &str) -> String {
    let steps = pointer.split('/').map(|step| if step.parse::<usize>().is_ok() { "*" } else { step });
    steps.collect::<Vec<_>>().join("/")
}

fn read(folder: &Folder, json: &Value) -> Result<ImportedScene, Error> {
    import(folder.write("s.gltf", json.to_string().as_bytes()), &ImportOptions::default())
}

fn without(json: &Value, pointer: &str) -> Value {
    let mut json = json.clone();
    let (above, key) = pointer.rsplit_once('/').unwrap();
    json.pointer_mut(above).unwrap().as_object_mut().unwrap().remove(key).unwrap();
    json
}

#[test]
fn each_optional_property_may_be_absent_and_each_required_one_is_named() {
    let (folder, full) = (Folder::new(), full());
    let names = |read: &ImportedScene| read.environment.objects().iter().map(|o| o.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&read(&folder, &full).unwrap()), ["plate", "person", "tree#2", "tree/leaf"]);
    let mut all = Vec::new();
    pointers(&full, "", &mut all);
    let mut refused = 0;
    for pointer in &all {
        let (above, key) = pointer.rsplit_once('/').unwrap();
        let read = read(&folder, &without(&full, pointer));
        if NEEDED.contains(&pointer.as_str()) || NEEDED.contains(&pattern(pointer).as_str()) {
            assert!(read.is_err_and(|e| e.kind() == ErrorKind::Invalid), "{pointer}");
            continue;
        }
        if !REQUIRED.contains(&pattern(pointer).as_str()) {
            let read = read.unwrap_or_else(|e| panic!("without {pointer}: {e}"));
            assert!(!read.environment.objects().is_empty(), "without {pointer}");
            continue;
        }
        let e = read.map(|read| read.report).expect_err(pointer);
        let text = e.to_string();
        refused += 1;
        assert!(e.kind() == ErrorKind::Invalid && e.file().is_some() && !e.remedy().is_empty(), "{pointer}: {text}");
        let place = if above.is_empty() { "s.gltf: JSON line".into() } else { format!("s.gltf: {above}: JSON line") };
        assert!(text.contains(&place) && text.contains(&format!("{key:?} is missing")), "{pointer}: {text}");
    }
    eprintln!("{} properties removed, {refused} refused", all.len());
    assert!(all.len() > 250 && refused == 80, "{} {refused}", all.len());
}

/// Whole numbers may have a fraction of zero anywhere.
#[test]
fn all_whole_numbers_may_be_written_as_floats() {
    fn floats(value: &mut Value) {
        match value {
            Value::Object(map) => map.values_mut().for_each(floats),
            Value::Array(list) => list.iter_mut().for_each(floats),
            Value::Number(n) => *value = json!(n.as_f64().unwrap()),
            _ => {}
        }
    }
    let (folder, full) = (Folder::new(), full());
    let mut floated = full.clone();
    floats(&mut floated);
    assert!(floated.to_string().contains("5126.0"));
    let [a, b] = [&full, &floated].map(|json| read(&folder, json).unwrap());
    assert_eq!((a.environment.content_hash(), a.report), (b.environment.content_hash(), b.report));
}

/// A value of another kind, a repeated property and a fraction are refused with their place.
#[test]
fn wrong_kinds_are_refused_with_their_place() {
    let (folder, full) = (Folder::new(), full());
    for (pointer, value) in [
        ("/asset/version", json!(2.0)),
        ("/accessors/0/count", json!(3.5)),
        ("/accessors/0/bufferView", json!(-1)),
        ("/accessors/0/normalized", json!(1)),
        ("/accessors/7/sparse/indices", json!([])),
        ("/bufferViews/0", json!(7)),
        ("/buffers/0/uri", json!({})),
        ("/meshes/0/primitives", json!({})),
        ("/meshes/0/primitives/0/attributes", json!(["POSITION"])),
        ("/meshes/0/primitives/0/attributes/POSITION", json!("0")),
        ("/meshes/0/primitives/0/indices", json!(4_294_967_296u64)),
        ("/nodes/3/matrix", json!([1, 2, 3])),
        ("/nodes/2/translation", json!([0, 0, "0"])),
        ("/nodes/2/children", json!([3.5])),
        ("/scenes/0/nodes", json!(null)),
        ("/materials/0/pbrMetallicRoughness/baseColorFactor", json!([1, 1, 1])),
        ("/extensionsUsed", json!("KHR_a")),
    ] {
        let mut json = full.clone();
        *json.pointer_mut(pointer).unwrap() = value;
        let e = read(&folder, &json).map(|read| read.report).expect_err(pointer);
        let text = e.to_string();
        assert!(text.contains(&format!("s.gltf: {pointer}")) && !e.remedy().is_empty(), "{pointer}: {text}");
        assert!(e.kind() == ErrorKind::Invalid && !text.contains('\n'), "{pointer}: {text}");
    }
}
