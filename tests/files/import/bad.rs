//! A case for every way in which a scene file can be broken: a one-line error with file, place and remedy.

use crate::build::*;
use presight_model::error::{Error, ErrorKind};
use presight_read::gltf::import;
use serde_json::{Value, json};

struct Case {
    name: &'static str,
    bytes: Vec<u8>,
    kind: ErrorKind,
    /// The words that the message must contain.
    words: &'static [&'static str],
}

fn changed(name: &'static str, words: &'static [&'static str], change: impl Fn(&mut Gltf)) -> Case {
    let mut g = Gltf::triangle();
    change(&mut g);
    Case { name, bytes: g.glb(), kind: ErrorKind::Invalid, words }
}

fn set(pointer: &'static str, value: Value) -> impl Fn(&mut Gltf) {
    move |g| {
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        g.json.pointer_mut(parent).unwrap()[key] = value.clone();
    }
}

fn with_position(component: f32) -> impl Fn(&mut Gltf) {
    move |g| g.bin[4..8].copy_from_slice(&component.to_le_bytes())
}

fn node_cases() -> Vec<Case> {
    let nodes = |nodes: Value| set("/nodes", nodes);
    vec![
        changed("zero scale", &["node 0 \"a\"", "scale"], set("/nodes/0/scale", json!([1, 0, 1]))),
        changed("flat matrix", &["node 0", "scale"], {
            set("/nodes/0/matrix", json!([1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]))
        }),
        changed("infinite scale", &["JSON line 1", "out of range"], |g| {
            set("/nodes/0/scale", json!([1, 2, 12345]))(g);
        }),
        changed("projection", &["node 0", "last row"], {
            set("/nodes/0/matrix", json!([1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]))
        }),
        changed("matrix and scale", &["node 0", "matrix and"], |g| {
            let turn = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
            g.json["nodes"][0] = json!({"mesh": 0, "matrix": turn, "scale": [1, 1, 1]});
        }),
        changed("zero rotation", &["node 0", "quaternion"], set("/nodes/0/rotation", json!([0, 0, 0, 0]))),
        changed("far away", &["node 0", "finite"], set("/nodes/0/translation", json!([1e13, 0, 0]))),
        changed("cycle in the scene", &["node 0", "cycle"], {
            nodes(json!([{"mesh": 0, "children": [1]}, {"children": [0]}]))
        }),
        changed("own child", &["node 1", "cycle"], nodes(json!([{"mesh": 0}, {"children": [1]}]))),
        changed("two parents", &["node 2", "two parents", "0 and 1"], {
            nodes(json!([{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}]))
        }),
        changed("a root that is a child", &["node 1", "child of node 0 \"mover\"", "; list"], |g| {
            g.json["nodes"] = json!([{"name": "mover", "translation": [5, 0, 0], "children": [1]}, {"mesh": 0}]);
            g.json["scenes"][0]["nodes"] = json!([1]);
        }),
        changed("same root twice", &["node 0", "twice"], set("/scenes/0/nodes", json!([0, 0]))),
        changed("child out of range", &["node 0", "child 7"], set("/nodes/0/children", json!([7]))),
        changed("root out of range", &["scene", "node 9"], set("/scenes/0/nodes", json!([9]))),
        changed("scene out of range", &["scene 3"], set("/scene", json!(3))),
        changed("mesh out of range", &["node 0", "mesh 5"], set("/nodes/0/mesh", json!(5))),
        changed("depth bomb", &["nest"], |g| {
            let count = 200_000;
            let chain = (0..count).map(|i| json!({"children": [i + 1]})).chain([json!({"mesh": 0})]);
            g.json["nodes"] = chain.collect();
        }),
        changed("endless name", &["path"], set("/nodes/0/name", json!("x".repeat(5000)))),
        changed("empty scene", &["no polygons"], set("/scenes/0/nodes", json!([]))),
        changed("nothing but a flat triangle", &["no polygons"], |g| g.bin[..36].fill(0)),
    ]
}

fn accessor_cases() -> Vec<Case> {
    vec![
        changed("index out of range", &["mesh 0 \"mesh 0\"", "primitive 0", "index 1 is 9"], |g| {
            let at = g.bin.len() - 4;
            g.bin[at..at + 2].copy_from_slice(&9u16.to_le_bytes());
        }),
        changed("NaN", &["mesh 0", "primitive 0", "vertex 0", "NaN"], with_position(f32::NAN)),
        changed("infinity", &["mesh 0", "vertex 0", "inf"], with_position(f32::INFINITY)),
        changed("beyond f32's squares", &["mesh 0", "vertex 0"], with_position(2e12)),
        changed("a billion triangles", &["accessor 1", "3000000000 elements", "6 bytes"], {
            set("/accessors/1/count", json!(3_000_000_000u64))
        }),
        changed("a billion triangles out of nothing", &["accessor 0", "without data"], |g| {
            g.json["accessors"][0] = json!({"componentType": F32, "type": "VEC3", "count": 30_000_000});
            g.json["meshes"][0]["primitives"][0] = json!({"attributes": {"POSITION": 0}});
        }),
        changed("a billion triangles by repetition", &["triangles are claimed"], |g| {
            g.json["accessors"][0] = json!({"componentType": F32, "type": "VEC3", "count": 60_000});
            let primitive = json!({"attributes": {"POSITION": 0}});
            g.json["meshes"][0]["primitives"] = (0..3000).map(|_| primitive.clone()).collect();
        }),
        changed("a count that overflows", &["claimed"], set("/accessors/0/count", json!(u64::MAX))),
        changed("an offset that overflows", &["accessor 0"], set("/accessors/0/byteOffset", json!(u64::MAX - 8))),
        changed("view beyond its buffer", &["buffer view 0", "buffer 0 has"], {
            set("/bufferViews/0/byteLength", json!(1000))
        }),
        changed("view offset overflow", &["buffer view 0"], set("/bufferViews/0/byteOffset", json!(u64::MAX))),
        changed("stride too small", &["buffer view 0", "stride"], set("/bufferViews/0/byteStride", json!(4))),
        changed("stride huge", &["buffer view 0", "stride"], set("/bufferViews/0/byteStride", json!(1u64 << 62))),
        changed("no such view", &["buffer view 8"], set("/accessors/0/bufferView", json!(8))),
        changed("no such buffer", &["buffer view 0", "buffer 3"], set("/bufferViews/0/buffer", json!(3))),
        changed("no such accessor", &["accessor 17"], set("/meshes/0/primitives/0/indices", json!(17))),
        changed("no such positions", &["accessor 18"], {
            set("/meshes/0/primitives/0/attributes/POSITION", json!(18))
        }),
        changed("no such material", &["material 2"], set("/meshes/0/primitives/0/material", json!(2))),
        changed("unknown mode", &["primitive 0", "mode"], set("/meshes/0/primitives/0/mode", json!(9))),
        changed("float indices", &["accessor 1", "SCALAR"], |g| {
            g.json["accessors"][1]["componentType"] = json!(F32);
            g.json["accessors"][1]["count"] = json!(1);
        }),
        changed("positions of two", &["accessor 0", "VEC3"], set("/accessors/0/type", json!("VEC2"))),
        changed("unknown component", &["accessor 0", "component"], set("/accessors/0/componentType", json!(77))),
        changed("sparse out of range", &["accessor 0", "sparse", "index 0 is 200"], |g| {
            let at = g.view(&[200]);
            let value = g.view(&[0; 12]);
            g.json["accessors"][0]["sparse"] = json!({"count": 1,
                "indices": {"bufferView": at, "componentType": U8}, "values": {"bufferView": value}});
        }),
        changed("buffer longer than its bytes", &["buffer 0", "truncated"], {
            set("/buffers/0/byteLength", json!(1_000_000_000_000u64))
        }),
    ]
}

fn container_cases() -> Vec<Case> {
    let whole = Gltf::triangle().glb();
    let case = |name, bytes: &[u8], words| Case { name, bytes: bytes.to_vec(), kind: ErrorKind::Invalid, words };
    let unsupported = |case: Case| Case { kind: ErrorKind::Unsupported, ..case };
    let mut version_1 = whole.clone();
    version_1[4] = 1;
    vec![
        case("empty", b"", &["empty"]),
        case("not a glTF", b"solid cube\nfacet normal 0 0 1", &["not a glTF"]),
        case("JSON of something else", b"{\"a\": 1}", &["asset"]),
        case("cut JSON", b"{\"asset\": {\"version\": \"2.0\"}, \"nodes\": [", &["JSON line 1", "truncated"]),
        case("cut header", &whole[..10], &["truncated"]),
        case("cut in the middle", &whole[..whole.len() / 2], &["truncated"]),
        case("cut at the end", &whole[..whole.len() - 1], &["truncated"]),
        unsupported(case("GLB 1", &version_1, &["version 1"])),
        unsupported(changed("glTF 1", &["asset", "1.0"], set("/asset/version", json!("1.0")))),
        unsupported(changed("newer", &["asset", "2.1"], set("/asset/minVersion", json!("2.1")))),
        unsupported(changed("unknown extension", &["extensionsRequired", "KHR_draco"], {
            set("/extensionsRequired", json!(["KHR_materials_unlit", "KHR_draco_mesh_compression"]))
        })),
        changed("buffer over http", &["buffer 0", "http"], set("/buffers/0/uri", json!("http://a.b/c.bin"))),
        changed("buffer elsewhere", &["buffer 0", "folder"], set("/buffers/0/uri", json!("../../etc/passwd"))),
        changed("broken base64", &["buffer 0", "base64"], set("/buffers/0/uri", json!("data:;base64,%%%"))),
        changed("unknown presight key", &["material 0", "extras.presight", "glow"], {
            set("/materials", json!([{"extras": {"presight": {"glow": 1}}}]))
        }),
        changed("reflection of 2", &["material \"m\"", "0..=1"], {
            set("/materials", json!([{"name": "m", "extras": {"presight": {"reflection": 2}}}]))
        }),
    ]
}

#[test]
fn every_broken_file_has_its_own_message() {
    let folder = Folder::new();
    let mut seen = std::collections::HashMap::new();
    for mut case in [node_cases(), accessor_cases(), container_cases()].into_iter().flatten() {
        if case.name == "infinite scale" {
            // serde_json cannot write a number that it must refuse to read.
            let at = case.bytes.windows(5).position(|w| w == b"12345").unwrap();
            case.bytes[at..at + 5].copy_from_slice(b"1e999");
        }
        let path = folder.write("broken.glb", &case.bytes);
        let error: Error = match import(&path, &SOURCE) {
            Err(e) => e,
            Ok(read) => panic!("{}: was read: {:?}", case.name, read.report),
        };
        let text = error.to_string();
        eprintln!("{}: {text}", case.name);
        assert_eq!(error.kind(), case.kind, "{}: {text}", case.name);
        assert_eq!(error.kind().exit_status(), 1);
        assert_eq!(error.file(), Some(path.as_path()), "{}", case.name);
        assert!(!text.contains('\n') && text.len() < 500 && !error.remedy().is_empty(), "{}: {text}", case.name);
        for word in case.words {
            assert!(text.contains(word), "{}: {text:?} lacks {word:?}", case.name);
        }
        if let Some(other) = seen.insert(text.clone(), case.name) {
            assert!(text.contains("no polygons") || text.contains("truncated"), "{} and {other}: {text}", case.name);
        }
    }
}

#[test]
fn missing_files_and_folders_are_named() {
    let folder = Folder::new();
    for (name, words) in [("gone.glb", "check the path"), ("", "folder")] {
        let e = import(folder.path(name), &SOURCE).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::Invalid);
        assert!(e.to_string().contains(words) && !e.remedy().is_empty(), "{e}");
    }
}

/// A file cut or damaged at any byte may give an error, but never a panic.
#[test]
fn no_damage_panics() {
    let whole = Gltf::triangle().glb();
    let folder = Folder::new();
    for at in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[at] = damaged[at].wrapping_mul(7).wrapping_add(13);
        for bytes in [&whole[..at], &damaged] {
            if let Err(e) = import(folder.write("damaged.glb", bytes), &SOURCE) {
                assert!(!e.to_string().contains('\n'), "{at}: {e}");
            }
        }
    }
}
