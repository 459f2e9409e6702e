//! Small files that need gigabytes are refused before any allocation, and shared data are read once.

use crate::build::*;
use presight_model::error::{Error, ErrorKind};
use presight_model::limits::MAX_IMPORT_BYTES;
use presight_read::gltf::import;
use serde_json::{Value, json};
use std::fs::File;
use std::time::{Duration, Instant};

/// Long for a task of a second, short for data that are read again and again.
const SOON: Duration = Duration::from_secs(15);

fn refused(name: &str, outcome: Result<presight_read::preparation::ImportedScene, Error>, words: &[&str]) {
    let e = outcome.map(|read| read.report).expect_err(name);
    let text = e.to_string();
    assert_eq!(e.kind(), ErrorKind::Invalid, "{name}: {text}");
    assert!(e.file().is_some() && !text.contains('\n') && text.len() < 500, "{name}: {text}");
    for word in [words, &["bytes of memory", &MAX_IMPORT_BYTES.to_string()]].concat() {
        assert!(text.contains(word), "{name}: {text:?} lacks {word:?}");
    }
    assert!(resident_peak() < 3 << 30, "{name}: {} bytes were taken", resident_peak());
}

/// The peak memory of this process, where the system reports it.
fn resident_peak() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<u64>().ok()).unwrap_or(0) << 10
}

/// This number of triangles without common vertices.
fn soup(g: &mut Gltf, triangles: usize) -> usize {
    let corners = |i: usize| {
        let (x, y) = ((i % 1000) as f32, (i / 1000) as f32);
        [[x, y, 0.0], [x + 0.5, y, 0.0], [x, y + 0.5, 0.0]]
    };
    let positions: Vec<[f32; 3]> = (0..triangles).flat_map(corners).collect();
    g.positions(&positions)
}

#[test]
fn repeats_of_triangles() {
    let mut g = Gltf::new();
    let positions = soup(&mut g, 88_000);
    // 33,440,000 triangles: under the limit on their number.
    g.mesh(vec![json!({"attributes": {"POSITION": positions}}); 380].into());
    g.node(json!({"mesh": 0}));
    refused("380 primitives on one accessor", g.import(), &["making its polygons"]);
}

#[test]
fn nodes_by_the_million() {
    let folder = Folder::new();
    let text = format!("{{\"asset\":{{\"version\":\"2.0\"}},\"nodes\":[{}{{}}]}}", "{},".repeat(6_000_000));
    refused("nodes", import(folder.write("a.gltf", text.as_bytes()), &SOURCE), &["its JSON"]);
    let mut g = Gltf::triangle();
    g.json["nodes"] = vec![json!({"mesh": 0}); 300_000].into();
    let children: Vec<usize> = (0..300_000).collect();
    let root = g.node(json!({"name": "x".repeat(4000), "children": children}));
    g.json["scenes"][0]["nodes"] = json!([root]);
    refused("long paths", g.import(), &["a node and its path"]);
}

/// Polygon numbers as only our own writer produces.
#[test]
fn repeats_of_polygons() {
    let mut g = Gltf::triangle();
    let rows = g.indices(U32, &vec![0; 999_999]);
    let mut mesh = g.json["meshes"][0].clone();
    mesh["extras"] = json!({"presight": {"rows": rows, "corners": rows, "order": "spatial", "blake3": "0"}});
    g.json["meshes"] = vec![mesh; 2000].into();
    g.json["nodes"] = (0..2000).map(|mesh| json!({"mesh": mesh})).collect();
    g.json["scenes"][0]["nodes"] = (0..2000).collect();
    let merged = Default::default();
    refused("polygons", g.import_with(&merged, None), &["mesh"]);
}

/// A scene next to files of these sizes, which are its buffers.
fn beside(folder: &Folder, buffers: &[(&str, u64)]) -> std::path::PathBuf {
    let mut json = Gltf::triangle().json;
    let buffer = |(uri, length): &(&str, u64)| json!({"uri": uri, "byteLength": length});
    json["buffers"] = buffers.iter().map(buffer).collect::<Vec<Value>>().into();
    folder.write("a.gltf", json.to_string().as_bytes())
}

#[test]
fn buffers_are_counted_before_they_are_read() {
    let folder = Folder::new();
    for name in ["a.bin", "b.bin", "c.bin"] {
        // The files are sparse and occupy no disk space.
        File::create(folder.path(name)).unwrap().set_len(2 << 30).unwrap();
    }
    let path = beside(&folder, &[("a.bin", 2 << 30), ("b.bin", 2 << 30), ("c.bin", 2 << 30)]);
    let start = Instant::now();
    refused("three buffers", import(path, &SOURCE), &["buffer 1", "b.bin"]);
    assert!(start.elapsed() < SOON, "{:?}", start.elapsed());
}

#[test]
fn a_file_is_read_once_and_no_further_than_needed() {
    let folder = Folder::new();
    let bytes = Gltf::triangle().bin;
    let mut whole = bytes.clone();
    whole.resize(8 << 20, 0);
    folder.write("a.bin", &whole);
    // One file under one name and under other names, partly and completely used.
    let names = ["a.bin", "./a.bin", "%61.bin"];
    let of = |i: usize| if i == 0 { bytes.len() as u64 } else { 8 << 20 };
    let buffers: Vec<(&str, u64)> = (0..1000).map(|i| (names[i % 3], of(i))).collect();
    let read = import(beside(&folder, &buffers), &SOURCE).unwrap();
    assert_eq!(read.report.triangles_stored, 1);
    assert!(resident_peak() < 3 << 30, "{} bytes were taken", resident_peak());
    // A file of 1 TB whose buffer needs one triangle.
    File::options().write(true).open(folder.path("a.bin")).unwrap().set_len(1 << 40).unwrap();
    let read = import(beside(&folder, &[("a.bin", bytes.len() as u64)]), &SOURCE).unwrap();
    assert_eq!(read.report.triangles_stored, 1);
    let e = import(beside(&folder, &[("a.bin", 20), ("a.bin", 1 << 41)]), &SOURCE).unwrap_err().to_string();
    assert!(e.contains("buffer 1") && e.contains("bytes of memory"), "{e}");
    folder.write("a.bin", &bytes);
    let e = import(beside(&folder, &[("a.bin", 20), ("a.bin", 1000)]), &SOURCE).unwrap_err().to_string();
    assert!(e.contains("buffer 1: 1000 bytes are claimed, but only 42 exist"), "{e}");
}

/// Large accessors shared by small primitives: only the used part of each is read.
#[test]
fn small_parts_of_large_accessors() {
    let start = Instant::now();
    let mut g = Gltf::new();
    let (count, used) = (1_000_000, [0, 1, 2]);
    // Every third vertex repeats one of three corners.
    let corner = |i: usize| [[0i16, 0, 0], [32767, 0, 0], [0, 32767, 0]][i % 3];
    let bytes = |skip: usize| (0..count).flat_map(|i| corner(i + skip)).flat_map(i16::to_le_bytes).collect::<Vec<u8>>();
    let large = [0, 3].map(|skip| g.accessor(&bytes(skip), I16, "VEC3", count));
    for accessor in large {
        g.json["accessors"][accessor]["normalized"] = json!(true);
    }
    let indices = g.indices(U32, &used);
    let all = g.indices(U32, &(0..count as u32).collect::<Vec<_>>());
    let triangle = |i: usize| json!({"attributes": {"POSITION": large[i % 2]}, "indices": indices, "mode": 4});
    let lines = |_: usize| json!({"attributes": {"POSITION": large[0]}, "indices": all, "mode": 1});
    g.mesh((0..5000).map(triangle).chain((0..5000).map(lines)).collect());
    g.node(json!({"mesh": 0}));
    let read = g.import().unwrap();
    assert_eq!(read.report.triangles_stored, 5000);
    assert!(start.elapsed() < SOON, "{:?}", start.elapsed());
}
