//! Bad files: each gives a typed error that names the place.

use super::{SOUND, file_with};
use crate::layer::{parse, read};
use presight_model::error::ErrorKind;

/// A bad feature, with [`SHORT`] names for what features share, and a text that its error must contain.
const FEATURES: &[(&str, &str)] = &[
    (r#"{"id": 0, "kind": "point", "points": [[0, 0, 0]]}"#, "features[0] (id 0): id 0 is nothing"),
    (r#"{"id": -1, "kind": "point", "points": [[0, 0, 0]]}"#, "line 2"),
    (r#"{"id": 1.5, "kind": "point", "points": [[0, 0, 0]]}"#, "line 2"),
    (r#"{"id": 4294967296, "kind": "point", "points": [[0, 0, 0]]}"#, "line 2"),
    (r#"{"id": "1", "kind": "point", "points": [[0, 0, 0]]}"#, "line 2"),
    (r#"{"kind": "point", "points": [[0, 0, 0]]}"#, "missing field `id`"),
    (r#"{"id": 1, "points": [[0, 0, 0]]}"#, "(id 1): kind is missing"),
    (r#"{"id": 1, "kind": "outline", "points": [[0, 0, 0]]}"#, "unknown variant `outline`"),
    (r#"{"id": 1, "kind": "point", "point": [0, 0, 0]}"#, "unknown field `point`"),
    (r#"{@point, "properties": {"colour": 1}}"#, "unknown field `colour`"),
    (r#"{"id": 1, "kind": "point", "kind": "point", "points": [[0, 0, 0]]}"#, "duplicate field `kind`"),
    (r#"{"id": 1, "kind": "point", "points": [0, 0, 0]}"#, "line 2"),
    (r#"{"id": 1, "kind": "point", "points": [[0, 0]]}"#, "line 2"),
    (r#"{"id": 1, "kind": "point", "points": [[0, 0, "0"]]}"#, "line 2"),
    (r#"{"id": 1, "kind": "point", "points": [[0, 0, null]]}"#, "line 2"),
    (r#"{"id": 1, "kind": "point", "points": [[0, 0, NaN]]}"#, "line 2"),
    (r#"{"id": 1, "kind": "point", "points": [[0, 0, Infinity]]}"#, "line 2"),
    (r#"{"id": 1, "kind": "point", "points": [[0, 0, 1e999]]}"#, "number out of range"),
    (r#"{"id": 1, "kind": "point", "points": [[0, 0, 1e13]]}"#, "(id 1): point 0 is"),
    (r#"{"id": 1, "kind": "point"}"#, "0 points, but this kind has 1"),
    (r#"{"id": 1, "kind": "reflector", "points": [[0, 0, 0], [0, 0, 1]]}"#, "2 points, but this kind has 1"),
    (r#"{"id": 1, "kind": "segment", "points": [[0, 0, 0]]}"#, "1 points, but this kind has 2"),
    (r#"{"id": 1, "kind": "segment", "points": [[0, 0, 1], [0, 0, 1]]}"#, "(id 1): the segment has no length"),
    // Covariances.
    (r#"{@point, "covariance": [1, 0, 0, 1, 0, 0]}"#, "line 2"),
    (r#"{@point, "covariance": [1, 0.1, 0, 0.2, 1, 0, 0, 0, 1]}"#, "not symmetric: [0][1] is 0.1, [1][0] is 0.2"),
    (r#"{@point, "covariance": [1, 2, 0, 2, 1, 0, 0, 0, 1]}"#, "the covariance is indefinite"),
    (
        r#"{@patch: [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "covariance": [1, 0, 0, 0, 1, 0, 0, 0, -1]}"#,
        "variance at [2][2] is negative",
    ),
    (
        r#"{@segment, "covariances": [[1, 0, 0, 0, 1, 0, 0, 0, 1], [1, 0, 0, 0, 1, 0, 0, 2, 1]]}"#,
        "(id 1): end 1: the covariance is not symmetric",
    ),
    (
        r#"{@segment, "sigma": 1, "cross_covariance": [1.1, 0, 0, 0, 0, 0, 0, 0, 0]}"#,
        "both ends with their cross-covariance: the covariance is indefinite",
    ),
    (r#"{@point, "sigma": -0.1}"#, "(id 1): sigma -0.1 is negative"),
    (r#"{@point, "sigma": [1, 2]}"#, "line 2"),
    (r#"{@point, "sigma": "1"}"#, "a standard deviation in metres, or three"),
    (r#"{@point, "sigma": 1, "covariance": [1, 0, 0, 0, 1, 0, 0, 0, 1]}"#, "(id 1): the covariance is given twice"),
    (
        r#"{@point, "cross_covariance": [1, 0, 0, 0, 1, 0, 0, 0, 1]}"#,
        "(id 1): covariances and cross_covariance are for segments",
    ),
    (r#"{@point, "sigma": 1e200}"#, "not finite or too large"),
    // Probabilities, times, rates.
    (r#"{@point, "existence": 1.01}"#, "existence probability 1.01 is outside 0..=1"),
    (r#"{@point, "existence": -0.01}"#, "existence probability -0.01 is outside 0..=1"),
    (r#"{@point, "existence": true}"#, "line 2"),
    (r#"{@point, "rate": -1e-9}"#, "the decay rate -0.000000001 is negative"),
    (r#"{@point, "confirmed": "2026-01-01"}"#, "line 2"),
    (r#"{@point, "properties": {"strength": 2}}"#, "the strength 2 is outside 0..=1"),
    (r#"{@point, "properties": {"contrast": -1}}"#, "the contrast -1 is outside 0..=1"),
    (r#"{@point, "properties": {"normal": [0, 0, 1.01]}}"#, "has length 1.01, not 1"),
    (r#"{@point, "properties": {"normal": [0, 0, 0]}}"#, "has length 0, not 1"),
    (r#"{@point, "properties": {"family": "DICT_4X4_50"}}"#, "family and code are for fiducials"),
    // Patches.
    (r#"{@patch: [[0, 0, 0], [1, 0, 0]]}"#, "a patch of 2 corners"),
    (r#"{@patch: [[0, 0, 0], [1, 0, 0], [3, 0, 0]]}"#, "the patch has no area"),
    (r#"{@patch: [[0, 0, 0], [1, 0, 0], [1, 1, 0.1], [0, 1, 0]]}"#, "off the patch's plane"),
    (r#"{@patch: [[0, 0, 0], [2, 0, 0], [0.5, 0.5, 0], [0, 2, 0]]}"#, "corner 2 turns inwards"),
    // Bow-ties with equal and unequal halves, and a star.
    (
        r#"{@patch: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}"#,
        "the outline crosses itself; list each corner once, in order around the patch",
    ),
    (r#"{@patch: [[0, 0, 7], [1, 0, 7], [0, 1, 7], [3, 1, 7]]}"#, "the outline crosses itself"),
    (r#"{@patch: [[0, 0, 0], [1, 0, 0], [2, 1, 0], [2, 0, 0], [0, 1, 0]]}"#, "the outline crosses itself"),
    (r#"{@patch: [[0, 0, 0], [0, 0, 1e300], [0, 0, 1]]}"#, "point 1 is [0, 0, 1e300]"),
    (r#"{@patch: [[0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0]]}"#, "corner 2 repeats the one before"),
    (r#"{@patch: [@square, @square]}"#, "the outline winds more than once"),
    (
        r#"{@patch: [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "properties": {"normal": [0, 1, 0]}}"#,
        "the normal is 90.0 degrees off",
    ),
    // Fiducials.
    (r#"{@fiducial}"#, "a fiducial needs its family and code"),
    (
        r#"{@marker: [[0, 0, 1], [1, 0, 1], [1, 0, 0]], "properties": {"family": "x", "code": 1}}"#,
        "3 points, but this kind has 4",
    ),
    (
        r#"{@marker: [[0, 0, 1], [2, 0, 1], [2, 0, 0], [0, 0, 0]], "properties": {"family": "x", "code": 1}}"#,
        "do not form a square",
    ),
    (
        r#"{@marker: [[0, 0, 1], [1, 0, 0], [1, 0, 1], [0, 0, 0]], "properties": {"family": "x", "code": 1}}"#,
        "do not form a square",
    ),
    (r#"{@fiducial, "properties": {"family": "DICT_4X4_50", "code": 50}}"#, "code 50 is not below 50"),
    (
        r#"{@fiducial, "properties": {"family": "DICT_8X8_50", "code": 1}}"#,
        "(id 1): family \"DICT_8X8_50\": OpenCV has no such dictionary",
    ),
    (r#"{@fiducial, "properties": {"family": "apriltag 36h11", "code": 1}}"#, "OpenCV has no such dictionary"),
    (r#"{@fiducial, "properties": {"family": "", "code": 1}}"#, "family \"\""),
    (
        r#"{@fiducial, "properties": {"family": "x", "code": 1, "normal": [0, 1, 0]}}"#,
        "the normal is 180.0 degrees off",
    ),
    // Several entries.
    (
        r#"{"id": 7, "kind": "point", "points": [[0, 0, 0]]}, {"id": 7, "kind": "point", "points": [[1, 0, 0]]}"#,
        "features[1] (id 7): features[0] has this id already",
    ),
    (
        r#"{"id": 7, "remove": true}, {"id": 7, "kind": "point", "points": [[1, 0, 0]]}"#,
        "features[0] has this id already",
    ),
    (r#"{"id": 7, "remove": true, "name": "x"}"#, "(id 7): \"remove\": true does not allow other keys"),
    (r#"{"id": 0, "remove": true}"#, "id 0 is nothing"),
    (r#"{"id": 7, "remove": 1}"#, "line 2"),
    (r#"{"id": 7, "remove": false}"#, "kind is missing"),
];

/// Short names for parts of features.
const SHORT: [(&str, &str); 6] = [
    ("@point", r#""id": 1, "kind": "point", "points": [[0, 0, 0]]"#),
    ("@segment", r#""id": 1, "kind": "segment", "points": [[0, 0, 0], [0, 0, 1]]"#),
    ("@fiducial", r#""id": 1, "kind": "fiducial", "points": [[0, 0, 1], [1, 0, 1], [1, 0, 0], [0, 0, 0]]"#),
    ("@patch", r#""id": 1, "kind": "patch", "points""#),
    ("@marker", r#""id": 1, "kind": "fiducial", "points""#),
    ("@square", r#"[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]"#),
];

/// A part of the sound file, its replacement, and a text that the error must contain.
const FILES: &[(&str, &str, &str)] = &[
    ("\"format\": 1", "\"format\": 0", "format 0 never existed"),
    ("\"format\": 1,", "", "does not name its format; write \"format\": 1"),
    ("\"format\": 1", "\"format\": \"1\"", "line 3"),
    ("\"class\": \"video\",", "", "missing field `class`"),
    ("\"video\"", "\"\"", "the sensor class is empty"),
    ("\"video\"", "7", "line 4"),
    ("\"tolerance\": 0.002", "\"tolerance\": 0", "the tolerance 0 is not a valid length"),
    ("\"tolerance\": 0.002", "\"tolerance\": -1", "the tolerance -1 is not a valid length"),
    ("\"tolerance\"", "\"tolerence\"", "unknown field `tolerence`"),
    ("1e-6]", "]", "line 7"),
    ("0, 1e-6]", "1e-6]", "35 numbers for object \"hall/door\""),
    ("0, 1e-6]", "1e-3, 1e-6]", "pose covariance of object \"hall/door\": the covariance is not symmetric"),
    (", 1e-6]", ", -1e-6]", "the variance at [5][5] is negative"),
    (", 1e-6]", ", 1e-6], \"hall/door\": []", "0 numbers for object \"hall/door\""),
    ("{\"id\": 5, \"remove\": true}", "{\"id\": 5, \"remove\": true},", "line"),
    ("\"features\"", "\"feature\"", "unknown field `feature`"),
    ("\"format\": 1", "\"format\": 1.5", "a whole number from 0"),
    ("\"format\": 1", "\"format\": -1", "a whole number from 0"),
    ("{\"id\": 5, \"remove\": true}", "[5]", "expected an object, {\"key\": value, ..}"),
    ("{\n  \"$schema\"", "[{\"$schema\"", "expected an object, {\"key\": value, ..}"),
];

#[test]
fn each_bad_feature_is_named() {
    for (feature, says) in FEATURES {
        let feature = &SHORT.iter().fold((*feature).to_owned(), |text, (short, long)| text.replace(short, long));
        let text = file_with(feature);
        let error = parse(&text).map(|file| panic!("accepted: {feature}: {file:?}")).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Invalid, "{feature}");
        let message = error.to_string();
        assert!(message.contains(says), "{feature}\n  said: {message}\n  not:  {says}");
        assert!(!error.remedy().is_empty() && error.place().is_some(), "{feature}: {message}");
        assert!(!message.contains('\n'));
    }
}

#[test]
fn each_bad_file_is_named() {
    assert!(parse(SOUND).is_ok());
    let folder = tempfile::tempdir().unwrap();
    for (i, (instead_of, put, says)) in FILES.iter().enumerate() {
        assert!(SOUND.contains(instead_of), "{instead_of}");
        let path = folder.path().join(format!("{i}.json"));
        std::fs::write(&path, SOUND.replacen(instead_of, put, 1)).unwrap();
        let error = read(&path).map(|_| panic!("accepted: {put} for {instead_of}")).unwrap_err();
        assert_eq!((error.kind(), error.file()), (ErrorKind::Invalid, Some(path.as_path())), "{put}");
        assert!(error.to_string().contains(says), "{put} for {instead_of}\n  said: {error}\n  not:  {says}");
    }
}

#[test]
fn newer_formats_and_broken_files_are_refused() {
    let newer = parse(r#"{"format": 3, "class": 7, "whatever": []}"#).unwrap_err();
    assert_eq!((newer.kind(), newer.remedy()), (ErrorKind::Unsupported, "update presight"));
    for text in ["", "{", "[]", "7", "{\"format\": 1}", "\u{feff}{}", &SOUND[..SOUND.len() - 3]] {
        assert_eq!(parse(text).unwrap_err().kind(), ErrorKind::Invalid, "{text}");
    }
    let deep = "[".repeat(100_000);
    assert_eq!(parse(&format!("{{\"format\": 1, \"x\": {deep}")).unwrap_err().kind(), ErrorKind::Invalid);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("none.json");
    assert_eq!(read(&path).unwrap_err().kind(), ErrorKind::Invalid);
    std::fs::write(&path, b"{\"format\": 1, \"class\": \"\xff\"}").unwrap();
    assert_eq!(read(&path).unwrap_err().kind(), ErrorKind::Invalid);
    assert_eq!(read(folder.path()).unwrap_err().file(), Some(folder.path()));
}
