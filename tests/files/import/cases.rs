//! Stored scene files of other programs, with the distance of the first wall ahead that each must give.

use crate::build::SOURCE;
use glam::DVec3;
use presight_read::gltf::{ImportOptions, import};
use presight_read::preparation::{ImportReport, ImportedScene, ProblemKind};
use std::path::{Path, PathBuf};

fn case(name: &str, file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/files/cases").join(name).join(file)
}

/// The smallest and the largest coordinates of all corners.
fn extent(read: &ImportedScene) -> [DVec3; 2] {
    let corners = (0..read.environment.slot_count()).flat_map(|slot| read.environment.polygon_in_world(slot).unwrap());
    corners.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], p| [low.min(p), high.max(p)])
}

/// The distance from the origin along x to the first plate, and the report. All plates face the origin.
fn ahead(name: &str, file: &str) -> (f64, ImportReport) {
    let read = import(case(name, file), &ImportOptions::default()).unwrap_or_else(|e| panic!("{name}: {e}"));
    let [low, high] = extent(&read);
    // The turn from y-up rounds in f64.
    let off = (low - DVec3::new(low.x, -1.0, -1.0)).abs().max((high - DVec3::new(2.0, 1.0, 1.0)).abs());
    assert!(off.max_element() < 1e-12, "{name}: {low} {high}");
    (low.x, read.report)
}

#[test]
fn valid_files_are_read() {
    for (name, file) in [
        ("gltf-scene-without-nodes", "scene.glb"),
        ("gltf-animation-without-node", "scene.glb"),
        ("gltf-unused-buffer", "scene.gltf"),
        ("gltf-whole-numbers-as-floats", "scene.gltf"),
    ] {
        let (range, report) = ahead(name, file);
        assert_eq!((range, report.notices), (2.0, Vec::new()), "{name}");
    }
}

#[test]
fn followed_features_place_their_objects() {
    for (name, range, notice) in [
        ("gltf-ignored-feature-untold", 1.5, None),
        ("gltf-node-visibility", 2.0, Some("KHR_node_visibility hides objects: they are left out (1 object)")),
        (
            "gltf-scale-zero",
            2.0,
            Some("left out, because a scale of zero leaves no area: node 1 \"hidden\" (1 object)"),
        ),
        (
            "gltf-glb-unaligned-chunk",
            2.0,
            Some("a chunk of the GLB has 553 bytes, which is not a multiple of 4: it is read as it was written"),
        ),
    ] {
        let (found, report) = ahead(name, "scene.glb");
        assert_eq!(found, range, "{name}");
        assert_eq!(report.notices, notice.map(str::to_owned).into_iter().collect::<Vec<_>>(), "{name}");
    }
    let (_, report) = ahead("gltf-scale-zero", "scene.glb");
    let empty = report.problems.iter().find(|p| p.kind == ProblemKind::EmptyMesh).unwrap();
    assert_eq!(empty.places, ["node 1 \"hidden\": a scale of zero"]);
}

/// The mesh is in centimetres at the root; its armature scales by 0.01.
#[test]
fn a_skinned_person_has_the_size_of_the_armature() {
    let read = import(case("gltf-skin-rest-pose", "scene.glb"), &SOURCE).unwrap();
    let [low, high] = extent(&read);
    // 0.01 is not exact in binary.
    assert!((low - DVec3::new(2.0, -1.0, -1.0)).length() < 1e-6, "{low}");
    assert!((high - DVec3::new(2.0, 1.0, 1.0)).length() < 1e-6, "{high}");
    assert_eq!(read.report.notices, Vec::<String>::new());
}

#[test]
fn vertices_in_map_coordinates_are_a_warning() {
    let report = import(case("gltf-baked-utm", "baked.glb"), &SOURCE).unwrap().report;
    let expected =
        "mesh 0 \"m\": its vertices are 0.5 m apart at best, because they lie 5333.7 km from the mesh's origin";
    assert_eq!(report.notices, [format!("{expected}; export them around a local origin and move the node")]);
    let lost = report.problems.iter().find(|p| p.kind == ProblemKind::LostPrecision).unwrap();
    assert_eq!(lost.places, [expected]);
}
