mod bad;
mod round_trip;
mod schema;

use super::*;
use glam::{DMat3, DVec3};
use presight_model::environment::FeatureShape;
use presight_model::error::ErrorKind;

/// One feature in an otherwise sound file.
fn file_with(feature: &str) -> String {
    format!("{{\"format\": 1, \"class\": \"video\", \"features\": [\n{feature}\n]}}")
}

/// A file with a feature of each kind and every key at least once.
const SOUND: &str = r#"{
  "$schema": "layer.schema.json",
  "format": 1,
  "class": "video",
  "tolerance": 0.002,
  "pose_covariances": {"hall/door": [1e-4, 0, 0, 0, 0, 0,  0, 1e-4, 0, 0, 0, 0,  0, 0, 0, 0, 0, 0,
                                     0, 0, 0, 0, 0, 0,     0, 0, 0, 0, 0, 0,     0, 0, 0, 0, 0, 1e-6]},
  "features": [
    {"id": 9, "kind": "segment", "name": "door, left edge", "object": "hall/door", "points": [[0, 0, 0], [0, 0, 2]],
     "covariances": [[1, 0.5, 0, 0.5, 1, 0, 0, 0, 0], [4, 0, 0, 0, 4, 0, 0, 0, 0]],
     "cross_covariance": [0.5, 0.25, 0, 0, 0.5, 0, 0, 0, 0], "properties": {"contrast": 0.8}},
    {"id": 2, "kind": "reflector", "points": [[4.2, -1.0, 1.5]], "sigma": [0.002, 0.002, 0.01],
     "existence": 0.95, "confirmed": 1790000000, "rate": 1e-7, "properties": {"strength": 1, "normal": [0, 1, 0]}},
    {"id": 3, "kind": "fiducial", "points": [[1, 0, 2], [1.2, 0, 2], [1.2, 0, 1.8], [1, 0, 1.8]], "remove": false,
     "properties": {"family": "DICT_APRILTAG_36h11", "code": 17, "normal": [0, -1, 0]}},
    {"id": 4, "kind": "patch", "points": [[0, 0, 0], [1, 0, 0], [1, 1, 0.001], [0, 1, 0]], "sigma": 0.01},
    {"id": 4294967295, "kind": "point", "points": [[1, 2, 3]], "covariance": [1, 0, 0, 0, 1, 0, 0, 0, 1]},
    {"id": 5, "remove": true}
  ]
}"#;

#[test]
fn every_key_arrives() {
    let file = parse(SOUND).unwrap();
    let layer = &file.layer;
    assert_eq!((layer.class.as_str(), layer.tolerance), ("video", 0.002));
    assert_eq!(file.removed, [5]);
    assert_eq!(layer.features.iter().map(|f| f.id).collect::<Vec<_>>(), [2, 3, 4, 9, u32::MAX]);
    let (object, pose) = &layer.pose_covariances[0];
    assert_eq!((object.as_str(), pose[0][0], pose[5][5], pose[2][2]), ("hall/door", 1e-4, 1e-6, 0.0));
    let reflector = &layer.features[0];
    assert_eq!(reflector.existence, presight_model::environment::Existence { p0: 0.95, confirmed: 1.79e9, rate: 1e-7 });
    assert_eq!((reflector.properties.strength, reflector.properties.normal), (Some(1.0), Some(DVec3::Y)));
    let sigmas = DMat3::from_diagonal(DVec3::new(0.002 * 0.002, 0.002 * 0.002, 0.01 * 0.01));
    assert_eq!(reflector.shape, FeatureShape::Reflector { at: DVec3::new(4.2, -1.0, 1.5), covariance: sigmas });
    let FeatureShape::Segment { ends, covariances, cross } = &layer.features[3].shape else { panic!("no segment") };
    assert_eq!(ends, &[DVec3::ZERO, DVec3::new(0.0, 0.0, 2.0)]);
    assert_eq!((covariances[0].col(0).y, covariances[1].col(1).y), (0.5, 4.0));
    // Row-major: x of the first end with y of the second.
    assert_eq!((cross.col(1).x, cross.col(0).y), (0.25, 0.0));
    assert_eq!(layer.features[3].object.as_deref(), Some("hall/door"));
    let FeatureShape::Fiducial { family, code, .. } = &layer.features[1].shape else { panic!("no fiducial") };
    assert_eq!((family.as_str(), *code), ("DICT_APRILTAG_36h11", 17));
}

#[test]
fn normals_written_with_few_digits_become_unit_ones() {
    let text = file_with(
        r#"{"id": 1, "kind": "point", "points": [[0, 0, 0]], "properties": {"normal": [0.7071, 0.7071, 0]}}"#,
    );
    let normal = parse(&text).unwrap().layer.features[0].properties.normal.unwrap();
    assert!((normal.length() - 1.0).abs() < 1e-15);
}

#[test]
fn later_layers_win_by_id() {
    let layer = |features: &str, more: &str| {
        parse(&format!("{{\"format\": 1, \"class\": \"video\"{more}, \"features\": [{features}]}}")).unwrap()
    };
    let point = |id: u32, x: f64| format!(r#"{{"id": {id}, "kind": "point", "points": [[{x}, 0, 0]]}}"#);
    let zeros = |x: f64| format!("[{x}{}]", ", 0".repeat(35));
    let base = layer(
        &[point(1, 1.0), point(2, 2.0), point(3, 3.0)].join(","),
        &format!(r#", "tolerance": 0.01, "pose_covariances": {{"a": {}, "b": {}}}"#, zeros(1.0), zeros(2.0)),
    );
    let second = layer(
        &[point(3, 30.0), r#"{"id": 2, "remove": true}"#.into(), r#"{"id": 77, "remove": true}"#.into()].join(","),
        "",
    );
    let third = layer(&point(2, 20.0), &format!(r#", "pose_covariances": {{"a": {}}}"#, zeros(5.0)));
    let xs = |files: &[LayerFile]| -> Vec<(u32, f64)> {
        let features = files.iter().flat_map(|file| &file.layer.features);
        features.map(|f| (f.id, f.shape.points()[0].x)).collect()
    };
    let two = merge([base.clone(), second.clone()]).unwrap();
    assert_eq!(xs(&two), [(1, 1.0), (3, 30.0)]);
    let three = merge([base.clone(), second.clone(), third.clone()]).unwrap();
    assert_eq!(xs(&three), [(1, 1.0), (3, 30.0), (2, 20.0)]);
    // Each file keeps its own tolerance for its remaining features.
    let default = presight_model::environment::DEFAULT_TOLERANCE;
    let tolerances: Vec<_> = three.iter().map(|f| (f.layer.tolerance, f.layer.features.len())).collect();
    assert_eq!(tolerances, [(0.01, 1), (default, 1), (default, 1)]);
    let poses: Vec<_> =
        three.iter().flat_map(|f| &f.layer.pose_covariances).map(|(o, c)| (o.as_str(), c[0][0])).collect();
    assert_eq!(poses, [("b", 2.0), ("a", 5.0)]);
    // The order matters.
    assert_eq!(xs(&merge([third, second, base]).unwrap()), [(1, 1.0), (2, 2.0), (3, 3.0)]);
    assert!(merge([]).unwrap().is_empty());
}

#[test]
fn features_of_other_classes_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let paths = ["a.json", "b.json"].map(|name| folder.path().join(name));
    std::fs::write(&paths[0], SOUND).unwrap();
    std::fs::write(&paths[1], SOUND.replace("\"video\"", "\"radar\"")).unwrap();
    let loaded = load(None, &paths, "radar").unwrap();
    let [file] = loaded.layers.as_slice() else { panic!("{loaded:?}") };
    assert_eq!((file.layer.features.len(), loaded.other_classes, file.layer.class.as_str()), (5, 5, "radar"));
    assert_eq!(file.path.as_deref(), Some(paths[1].as_path()));
    // The environment's own layer comes first and has no path.
    let own = presight_model::environment::FeatureLayer { class: "radar".into(), tolerance: 0.5, ..Default::default() };
    let both = load(Some(&own), &paths[1..], "radar").unwrap().layers;
    assert_eq!(
        both.iter().map(|f| (f.path.is_some(), f.layer.tolerance)).collect::<Vec<_>>(),
        [(false, 0.5), (true, 0.002)]
    );
    let mixed = merge(paths.iter().map(|p| read(p).unwrap())).unwrap_err();
    assert_eq!((mixed.kind(), mixed.file()), (ErrorKind::Invalid, Some(paths[1].as_path())));
    // Files of other classes are checked too.
    std::fs::write(&paths[0], SOUND.replace("0.95", "1.95")).unwrap();
    let wrong = load(None, &paths, "radar").unwrap_err();
    assert_eq!(wrong.file(), Some(paths[0].as_path()));
    assert!(wrong.to_string().contains("features[1] (id 2): the existence probability 1.95"), "{wrong}");
}
