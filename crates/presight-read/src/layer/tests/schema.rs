//! Compares the schema with the reader: sound files fit both, files with wrong types and ranges fit neither.

use super::super::{parse, schema, to_string};
use super::{FeatureShape, SOUND, file_with};
use serde_json::Value;

/// Returns true if a value fits a schema. Panics at a keyword that our schema does not use.
fn fits(root: &Value, schema: &Value, value: &Value) -> bool {
    let keys = match schema {
        Value::Bool(all) => return *all,
        Value::Object(keys) => keys,
        _ => panic!("no schema: {schema}"),
    };
    keys.iter().all(|(key, rule)| match key.as_str() {
        "$schema" | "title" | "description" | "default" | "$defs" => true,
        // Handled by `if`.
        "then" | "else" => true,
        "$ref" => {
            let pointer = rule.as_str().unwrap().strip_prefix('#').unwrap();
            fits(root, root.pointer(pointer).unwrap(), value)
        }
        "type" => match rule.as_str().unwrap() {
            "object" => value.is_object(),
            "array" => value.is_array(),
            "string" => value.is_string(),
            "number" => value.is_number(),
            "integer" => value.as_f64().is_some_and(|x| x.fract() == 0.0),
            other => panic!("type {other}"),
        },
        "const" => value == rule || value.as_f64().zip(rule.as_f64()).is_some_and(|(a, b)| a == b),
        "enum" => rule.as_array().unwrap().contains(value),
        "minimum" => value.as_f64().is_none_or(|x| x >= rule.as_f64().unwrap()),
        "maximum" => value.as_f64().is_none_or(|x| x <= rule.as_f64().unwrap()),
        "exclusiveMinimum" => value.as_f64().is_none_or(|x| x > rule.as_f64().unwrap()),
        "minLength" => value.as_str().is_none_or(|s| s.chars().count() as u64 >= rule.as_u64().unwrap()),
        "minItems" => value.as_array().is_none_or(|a| a.len() as u64 >= rule.as_u64().unwrap()),
        "maxItems" => value.as_array().is_none_or(|a| a.len() as u64 <= rule.as_u64().unwrap()),
        "items" => value.as_array().is_none_or(|a| a.iter().all(|v| fits(root, rule, v))),
        "required" => value
            .as_object()
            .is_none_or(|o| rule.as_array().unwrap().iter().all(|k| o.contains_key(k.as_str().unwrap()))),
        "properties" => value.as_object().is_none_or(|o| {
            rule.as_object().unwrap().iter().all(|(k, rule)| o.get(k).is_none_or(|v| fits(root, rule, v)))
        }),
        "additionalProperties" => value.as_object().is_none_or(|o| {
            let named = |k: &String| keys.get("properties").is_some_and(|p| p.get(k).is_some());
            o.iter().filter(|(k, _)| !named(k)).all(|(_, v)| fits(root, rule, v))
        }),
        "anyOf" => rule.as_array().unwrap().iter().any(|s| fits(root, s, value)),
        "allOf" => rule.as_array().unwrap().iter().all(|s| fits(root, s, value)),
        "if" => {
            let branch = if fits(root, rule, value) { "then" } else { "else" };
            keys.get(branch).is_none_or(|s| fits(root, s, value))
        }
        other => panic!("keyword {other}"),
    })
}

fn fits_ours(text: &str) -> bool {
    let root: Value = serde_json::from_str(schema()).unwrap();
    fits(&root, &root, &serde_json::from_str(text).unwrap())
}

#[test]
fn sound_files_fit() {
    assert!(fits_ours(SOUND));
    let layer = parse(SOUND).unwrap().layer;
    assert!(fits_ours(&to_string(&layer).unwrap()));
}

/// The example in the module's documentation is valid.
#[test]
fn the_documented_example_fits() {
    let docs = include_str!("../mod.rs");
    let lines = docs.lines().skip_while(|l| *l != "//! ```json").skip(1).take_while(|l| *l != "//! ```");
    let text: Vec<&str> = lines.map(|l| l.trim_start_matches("//!")).collect();
    let text = text.join("\n");
    assert!(fits_ours(&text));
    assert_eq!(parse(&text).unwrap().layer.features.len(), 3);
}

/// The schema and the reader both accept 1.0 for 1.
#[test]
fn whole_numbers_may_be_written_with_a_fraction_of_nothing() {
    let text = r#"{"format": 1.0, "class": "video", "features": [
        {"id": 2e0, "kind": "point", "points": [[0, 0, 0]]}, {"id": 4294967295.0, "remove": true},
        {"id": 3.0, "kind": "fiducial", "points": [[0, 0, 1], [1, 0, 1], [1, 0, 0], [0, 0, 0]],
         "properties": {"family": "DICT_4X4_50", "code": 17.0}}]}"#;
    assert!(fits_ours(text));
    let file = parse(text).unwrap();
    assert_eq!((file.layer.features[0].id, file.removed.as_slice()), (2, [u32::MAX].as_slice()));
    let FeatureShape::Fiducial { code, .. } = file.layer.features[1].shape else { panic!("no fiducial") };
    assert_eq!(code, 17);
    for (instead_of, put) in [("1.0", "1.5"), ("2e0", "2.5"), ("17.0", "17.5"), ("4294967295.0", "4294967296.0")] {
        let text = text.replacen(instead_of, put, 1);
        assert!(parse(&text).is_err() && !fits_ours(&text), "{put}");
    }
}

#[test]
fn contours_are_told_by_anchor_and_angle() {
    let file = |feature: &str| format!(r#"{{"format": 2, "class": "video", "features": [{feature}]}}"#);
    let sound = file(r#"{"id": 1, "kind": "contour", "anchor": [0, 0, 0], "crease_deg": 30, "sigma": 0.01}"#);
    assert!(fits_ours(&sound) && parse(&sound).is_ok());
    // Files of format 2 may also contain features of the other kinds.
    let point = file(r#"{"id": 1, "kind": "point", "points": [[0, 0, 0]]}"#);
    assert!(fits_ours(&point) && parse(&point).is_ok());
    for (instead_of, put) in [
        ("2", "1"),
        ("30", "0"),
        ("30", "91"),
        ("30", "\"30\""),
        (", \"crease_deg\": 30", ""),
        ("\"anchor\": [0, 0, 0], ", ""),
        ("anchor", "points"),
        ("[0, 0, 0]", "[0, 0]"),
        ("\"sigma\"", "\"points\": [[0, 0, 0]], \"sigma\""),
        ("contour", "point"),
    ] {
        let text = sound.replacen(instead_of, put, 1);
        assert!(parse(&text).is_err() && !fits_ours(&text), "{put} for {instead_of}");
    }
}

/// The schema refuses these features, as the reader does.
#[test]
fn wrong_types_and_ranges_do_not_fit() {
    let point = |more: &str| format!(r#"{{"id": 1, "kind": "point", "points": [[0, 0, 0]]{more}}}"#);
    let of_kind = |kind: &str, points: usize| {
        let points = vec!["[0, 0, 0]"; points].join(", ");
        format!(r#"{{"id": 1, "kind": "{kind}", "points": [{points}], "properties": {{}}}}"#)
    };
    assert!(fits_ours(&file_with(&point(""))));
    let lost = file_with(&point(r#", "surface": "lost""#));
    assert!(fits_ours(&lost) && parse(&lost).unwrap().lost == [1]);
    let bad = [
        r#"{"kind": "point", "points": [[0, 0, 0]]}"#.to_owned(),
        r#"{"id": 0, "kind": "point", "points": [[0, 0, 0]]}"#.to_owned(),
        r#"{"id": 4294967296, "kind": "point", "points": [[0, 0, 0]]}"#.to_owned(),
        r#"{"id": 1, "points": [[0, 0, 0]]}"#.to_owned(),
        r#"{"id": 1, "kind": "point", "points": [[0, 0]]}"#.to_owned(),
        r#"{"id": 1, "remove": true, "name": "x"}"#.to_owned(),
        r#"{"id": 1, "remove": true, "surface": "lost"}"#.to_owned(),
        point(r#", "surface": "found""#),
        point(r#", "surface": true"#),
        of_kind("contour", 1),
        of_kind("point", 2),
        of_kind("reflector", 0),
        of_kind("segment", 1),
        of_kind("patch", 2),
        of_kind("fiducial", 4),
        point(r#", "sigma": -1"#),
        point(r#", "sigma": [1, 1]"#),
        point(r#", "sigma": null"#).replace("null", "\"1\""),
        point(r#", "covariance": [1, 0, 0]"#),
        point(r#", "cross_covariance": [1, 0, 0, 0, 1, 0, 0, 0, 1]"#),
        point(r#", "existence": 1.5"#),
        point(r#", "rate": -1"#),
        point(r#", "confirmed": "now""#),
        point(r#", "properties": {"strength": 2}"#),
        point(r#", "properties": {"normal": [1, 0]}"#),
        point(r#", "properties": {"family": "x", "code": 1}"#),
        r#"{"id": 1, "kind": "fiducial", "points": [[0, 0, 1], [1, 0, 1], [1, 0, 0], [0, 0, 0]], "#.to_owned()
            + r#""properties": {"family": "x", "code": 1}}"#,
        point(r#", "properties": {"direction": 1}"#),
        point(r#", "colour": "red""#),
        // Lists of values in the order of the keys are not objects.
        r#"[1, "point", null, null, [[0, 0, 0]]]"#.to_owned(),
        point(r#", "properties": [0.5]"#),
    ];
    for feature in &bad {
        let text = file_with(feature);
        assert!(parse(&text).is_err(), "read: {feature}");
        assert!(!fits_ours(&text), "fits: {feature}");
    }
    for (instead_of, put) in [
        ("\"format\": 1", "\"format\": 3"),
        ("\"class\": \"video\",", ""),
        ("\"video\"", "\"\""),
        ("\"tolerance\": 0.002", "\"tolerance\": 0"),
        ("0, 1e-6]", "1e-6]"),
        ("\"tolerance\"", "\"tolerence\""),
    ] {
        let text = SOUND.replacen(instead_of, put, 1);
        assert!(parse(&text).is_err() && !fits_ours(&text), "{put} for {instead_of}");
    }
}
