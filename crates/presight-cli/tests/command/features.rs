//! Features on the command line: layer files, reports, drawings and refusals.

use super::{Bad, Place, WALL, WALL_INDICES, bad, check, wall};
use presight::files;
use serde_json::{Value, json};
use std::fs;

/// Faces the wall from a distance of 2 m.
const AT_WALL: &str = "predict wall.glb --sensor video-camera --pose 0,0,1,0,0,0 --backend cpu";

/// A camera layer with a point and the wall's left edge. The point's confidence halves in about 7 s.
const LAYER: &str = r#"{"format": 1, "class": "video", "features": [
    {"id": 5, "kind": "point", "points": [[2, 0.25, 1.25]], "sigma": 0.01, "confirmed": 100, "rate": 0.1},
    {"id": 7, "kind": "segment", "name": "left", "points": [[2, 0.5, 0.9], [2, -0.5, 1.1]], "sigma": 0.01}]}"#;

#[test]
fn features_are_predicted_with_images() {
    let place = Place::new();
    place.write("l.json", LAYER.as_bytes());
    place.done(
        "predict wall.glb --sensor video-camera --pose 0,0,1,0,0,0 --backend cpu --layer l.json --features f.json \
         --time 110 --outputs range,feature_id --out a.exr --png a.png --feature-numbers --pose-cov 0.01,0.01,0,0,0,1",
    );
    let json: Value = serde_json::from_slice(&fs::read(place.path("f.json")).unwrap()).unwrap();
    assert_eq!((json["format"].as_u64(), json["sensor"].as_str()), (Some(1), Some("video-camera")));
    assert_eq!(json["world_from_sensor"].as_array().unwrap().len(), 7);
    assert_eq!(json["features"].as_array().unwrap().len(), 2);
    let (point, segment) = (&json["features"][0], &json["features"][1]);
    assert_eq!((point["id"].as_u64(), point["kind"].as_str()), (Some(5), Some("point")));
    assert_eq!(point["visible_fraction"], 1.0);
    let range = (4.0f64 + 2.0 * 0.0625).sqrt();
    assert!((point["range"].as_f64().unwrap() - range).abs() < 1e-6, "{point}");
    assert!((point["cos_incidence"].as_f64().unwrap() - 2.0 / range).abs() < 1e-6);
    assert!((point["properties"]["existence"].as_f64().unwrap() - (-1f64).exp()).abs() < 1e-12);
    assert_eq!((segment["name"].as_str(), segment["visible"][0]["t"][1].as_f64()), (Some("left"), Some(1.0)));
    assert_eq!(point["roi"].as_array().unwrap().len(), 4);
    // Only the requested images are written, and the point is drawn over the segment.
    let images = files::read_exr(&place.path("a.exr")).unwrap().images;
    assert!(images.polygon_id.is_empty() && images.range.len() == images.feature_id.len());
    let [u, v] = [0, 1].map(|i| point["visible"][0]["pixels"][0][i].as_f64().unwrap().round() as usize);
    assert_eq!(images.feature_id[v * images.width as usize + u], 5);
    assert!(images.feature_id.iter().filter(|id| **id == 7).count() > 20);
    assert!(place.path("a.png").exists());
}

/// Two points share a place and a third is elsewhere: the second of the pair adds no information. A fourth point
/// without contrast adds hardly any.
#[test]
fn the_most_informative_features_are_kept() {
    let place = Place::new();
    let point = |id: u32, y: f64, contrast: f64| json!({"id": id, "kind": "point", "points": [[2, y, 1]], "sigma": 0.001, "properties": {"contrast": contrast}});
    let features = [point(6, 0.0, 1.0), point(5, 0.0, 1.0), point(8, 0.5, 1e-9), point(9, -0.5, 1.0)];
    let layer = json!({"format": 1, "class": "video", "features": features});
    place.write("l.json", layer.to_string().as_bytes());
    for (most, kept) in [(0, &[][..]), (2, &[5, 9]), (3, &[5, 6, 9]), (4, &[5, 6, 8, 9]), (9, &[5, 6, 8, 9])] {
        let said =
            place.done(&format!("{AT_WALL} --layer l.json --features f.json --stats s.json --max-features {most}"));
        let read = |name: &str| -> Value { serde_json::from_slice(&fs::read(place.path(name)).unwrap()).unwrap() };
        let features = read("f.json")["features"].as_array().unwrap().clone();
        let mut ids: Vec<u64> = features.iter().map(|f| f["id"].as_u64().unwrap()).collect();
        ids.sort_unstable();
        assert_eq!(ids, kept, "{most}: {said:?}");
        let dropped = read("s.json")["counts"]["features not chosen"].as_u64();
        assert_eq!(dropped.unwrap_or(0), 4 - kept.len() as u64, "{most}");
    }
    let refused = place.run(&format!("{AT_WALL} --layer l.json --features f.json --max-features -1"));
    assert_eq!(refused.status, Some(2), "{}", refused.stderr);
}

#[test]
fn layers_of_other_classes_are_ignored_and_features_need_a_layer() {
    let place = Place::new();
    place.write("l.json", LAYER.replace("video", "radar").as_bytes());
    let line = "predict wall.glb --sensor video-camera --pose 0,0,1,0,0,0 --backend cpu";
    let outcome = place.run(&format!("{line} --layer l.json --features f.json"));
    assert_eq!(outcome.status, Some(0));
    assert!(outcome.stderr.contains("2 features"), "{}", outcome.stderr);
    for wrong in [
        "--outputs feature_id --out a.exr",
        "--features f.json",
        "--time 3",
        "--confidence 0.9",
        "--layer l.json --confidence 2",
    ] {
        assert_eq!(place.run(&format!("{line} {wrong}")).status, Some(2), "{wrong}");
    }
    place.write("l.json", LAYER.replace("[[2, 0.25", "[[1.9, 0.25").as_bytes());
    assert_eq!(place.run(&format!("{line} --layer l.json --features f.json")).status, Some(1), "off its polygons");
}

#[test]
fn the_summary_counts_features() {
    let place = Place::new();
    let behind = LAYER.replace(
        "]}",
        r#",
        {"id": 9, "kind": "point", "points": [[2, 0.9, 1.9]], "sigma": 0.01}]}"#,
    );
    place.write("l.json", behind.as_bytes());
    let said = place.done(&format!("{AT_WALL} --layer l.json"));
    assert!(said.contains("2 of 3 features seen") && said.lines().count() == 1, "{said}");
    assert!(!place.done(AT_WALL).contains("feature"));
}

/// A file's tolerance applies to its own features only, whatever other files are read with it.
#[test]
fn tolerances_stay_with_their_files() {
    let place = Place::new();
    let floating = |class: &str| LAYER.replace("[[2, 0.25", "[[1.95, 0.25").replace("video", class);
    place.write("off.json", floating("video").as_bytes());
    let other = r#"{"format": 1, "class": "video", "tolerance": 0.1, "features": [
        {"id": 77, "kind": "point", "points": [[1.96, -0.25, 1.25]]}]}"#;
    place.write("wide.json", other.as_bytes());
    place.done(&format!("{AT_WALL} --layer wide.json --features a.json"));
    let off = |layers: &str| {
        bad(format!("{AT_WALL} {layers} --features f.json"), 1, &["off.json: feature 5: ", "0.050000 m off"])
    };
    check(
        &place,
        vec![
            off("--layer off.json"),
            off("--layer off.json --layer wide.json"),
            off("--layer wide.json --layer off.json"),
        ],
    );
    // The later file replaces the feature, so the later file's tolerance applies.
    let wide = floating("video").replace("\"features\"", "\"tolerance\": 0.1, \"features\"");
    place.write("later.json", wide.as_bytes());
    place.done(&format!("{AT_WALL} --layer off.json --layer later.json --features b.json"));
}

#[test]
fn a_feature_without_a_surface_is_reported_with_its_file() {
    let place = Place::new();
    let layer =
        |more: &str, feature: &str| format!("{{\"format\": 1, \"class\": \"video\"{more}, \"features\": [{feature}]}}");
    let point = |rest: &str| format!("{{\"id\": 1, \"kind\": \"point\", \"points\": [[2, 0, 1]]{rest}}}");
    let zeros = format!("[{}]", vec!["0"; 36].join(","));
    for (name, text) in [
        ("good.json", layer("", &point(""))),
        ("object.json", layer("", &point(", \"object\": \"door\""))),
        ("pose.json", layer(&format!(", \"pose_covariances\": {{\"door\": {zeros}}}"), &point(""))),
        ("huge.json", layer("", &point("").replace("[2, 0, 1]", "[1e308, 0, 1]"))),
        (
            "bow.json",
            layer("", "{\"id\": 3, \"kind\": \"patch\", \"points\": [[2, 0, 1], [2, 1, 2], [2, 1, 1], [2, 0, 2]]}"),
        ),
        ("list.json", "[1]".to_owned()),
        (
            "lone.toml",
            "format = 1\nclass = \"video\"\nkind = \"rays\"\nwidth = 1\nheight = 1\ndirections = [[1, 0, 0]]\n"
                .to_owned(),
        ),
    ] {
        place.write(name, text.as_bytes());
    }
    let with = |layers: &str| format!("{AT_WALL} --layer {layers} --features f.json");
    let lone = AT_WALL.replace("video-camera", "lone.toml");
    place.done(&format!("{lone} --out a.exr"));
    let cases: Vec<Bad> = vec![
        bad(with("object.json"), 1, &["object.json: feature 1: ", "no object \"door\"", "; "]),
        bad(with("object.json --layer good.json --layer object.json"), 1, &["object.json: feature 1: "]),
        bad(with("good.json --layer pose.json"), 1, &["pose.json: pose covariance of object \"door\": ", "; "]),
        bad(with("huge.json"), 1, &["huge.json: features[0] (id 1): ", "[1e308, 0, 1]"]),
        bad(with("bow.json"), 1, &["bow.json: features[0] (id 3): ", "crosses itself", "; "]),
        bad(with("list.json"), 1, &["list.json: line 1", "expected an object"]),
        bad(format!("{lone} --layer good.json --features f.json"), 1, &["lone.toml: ", "fewer than two rays", "; "]),
    ];
    check(&place, cases);
}

#[test]
fn feature_generation_reports_errors_in_the_units_of_the_flags() {
    let place = Place::new();
    check(
        &place,
        vec![
            bad("features wall.glb --class video --crease-deg 200", 2, &["crease angle of 200 degrees"]).until(
                "200",
                "90",
                "; give 0.6 to 90 degrees",
            ),
            bad("features wall.glb --class video --min-length 1e-9", 2, &["length of 1e-9"]).until(
                "1e-9",
                "0.0001",
                "; give 0.0001 m .. 1000 km",
            ),
            bad("features wall.glb --class video --flatness 2", 2, &["flatness of 2"]).until(
                "2",
                "0.01",
                "; give 0 to 1 m",
            ),
        ],
    );
    let outcome = place.run_args(&["features", "wall.glb", "--class", ""]);
    assert_eq!((outcome.status, outcome.stdout.as_str()), (Some(2), ""), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("--class"), "{}", outcome.stderr);
}

#[test]
fn a_byte_order_mark_is_skipped() {
    let place = Place::new();
    place.write("l.json", format!("\u{feff}{LAYER}").as_bytes());
    let sensor = place.done("sensors video-camera");
    place.write("s.toml", format!("\u{feff}{sensor}").as_bytes());
    place.write("wall.materials.toml", "\u{feff}format = 1\n".as_bytes());
    let said = place.done(&AT_WALL.replace("video-camera", "s.toml --layer l.json"));
    assert!(said.contains("2 of 2 features seen"), "{said}");
}

/// A covariance of 36 numbers takes one line a row of the matrix, not one line a number.
#[test]
fn a_covariance_is_short_in_the_file() {
    let place = Place::new();
    place.write("l.json", LAYER.as_bytes());
    place.done(&format!("{AT_WALL} --layer l.json --features f.json --pose-cov 0.01,0.01,0,0,0,1"));
    let text = fs::read_to_string(place.path("f.json")).unwrap();
    let from = text.lines().position(|l| l.contains("pose_covariance")).unwrap();
    let to = text.lines().position(|l| l.contains("confidence")).unwrap();
    assert!(to - from <= 6, "{text}");
    assert_eq!(place.json("f.json")["pose_covariance"].as_array().unwrap().len(), 36);
}

/// `pick` proposes an edge that is visible at the pixel, not the nearest edge in space.
#[test]
fn picking_proposes_visible_edges() {
    let place = Place::new();
    // A second wall, 2 cm behind the first and 10 cm lower.
    let two = wall(
        |root| {
            let back = json!({"mesh": 0, "name": "back", "translation": [0.02, -0.1, 0]});
            root["nodes"].as_array_mut().unwrap().push(back);
            root["scenes"][0]["nodes"] = json!([0, 1]);
        },
        WALL,
        WALL_INDICES,
    );
    place.write("two.glb", &two);
    let pick = |more: &str| {
        place.done(&format!("features pick two.glb --sensor video-camera --pose 0,0,1.5,0,0,0 --pixel {more}"))
    };
    let entry = |said: &str| {
        let line = said.lines().skip_while(|l| !l.starts_with("an entry")).nth(1).expect("an entry");
        serde_json::from_str::<Value>(line).expect("JSON")
    };
    // The pixel is 11 cm below the front wall's upper edge and 2 cm from the back wall's.
    let said = pick("256,120 --reach 0.3");
    let top = entry(&said);
    assert_eq!((&top["kind"], &top["object"]), (&json!("segment"), &json!("wall")), "{said}");
    let at_top = |p: &Value| [1, 2].iter().any(|axis| (p[axis].as_f64().unwrap() - 2.0).abs() < 1e-6);
    assert!(top["points"].as_array().unwrap().iter().all(at_top), "{said}");
    let hidden: Vec<&str> = said.lines().skip_while(|l| !l.starts_with("hidden edges and corners")).skip(1).collect();
    assert!(hidden[0].contains(" border ") && hidden[0].ends_with("back"), "{said}");
    // No edge is within 1 cm of the image centre, so `pick` proposes the point on the surface.
    assert_eq!(entry(&pick("256,256 --reach 0.01"))["kind"], "point");
}

/// The room's layer fixes a camera's pose at most places. Thinned to far fewer features it does so nearly as well.
#[test]
fn worth_is_reported_by_place_and_layers_are_thinned() {
    let place = Place::new();
    fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb"), place.path("room.glb")).unwrap();
    let camera = r#"
format = 1
kind = "camera"
name = "eye"
class = "video"
width = 160
height = 120
fx = 120
fy = 120
cx = 79.5
cy = 59.5
[mount]
xyz = [0.0, 0.0, 1.2]
[noise]
pixel_sigma = 0.5
"#;
    place.write("eye.toml", camera.as_bytes());
    let said = place.done(
        "features room.glb --worth --sensor eye.toml --spacing 0.7 --csv w.csv --png w.png --thin --out few.layer.json",
    );
    let csv = fs::read_to_string(place.path("w.csv")).unwrap();
    let rows: Vec<Vec<f64>> = csv.lines().skip(1).map(|l| l.split(',').map(|x| x.parse().unwrap()).collect()).collect();
    assert!(rows.len() > 3 && rows.iter().all(|r| r[2] == 1.2 && r[4] > 0.0 && r[5] > 0.0), "{csv}");
    assert!(rows.iter().any(|r| r[4] < 1.0 && r[5] < 20.0), "{csv}");
    assert!(place.path("w.png").exists());
    let line = said.lines().find(|l| l.starts_with("thinned")).unwrap();
    let numbers: Vec<f64> = line.split(' ').filter_map(|w| w.parse().ok()).collect();
    let [kept, given, position, heading] = numbers[..] else { panic!("{line}") };
    assert!(kept > 2.0 && kept < 0.7 * given && position <= 10.0 && heading <= 10.0, "{line}");
    let few: Value = serde_json::from_slice(&fs::read(place.path("few.layer.json")).unwrap()).unwrap();
    assert_eq!(few["features"].as_array().unwrap().len() as f64, kept);
    // The thinned layer has almost the same worth at the same places.
    place.done("features room.glb --worth --sensor eye.toml --spacing 0.7 --layer few.layer.json --csv few.csv");
    let after = fs::read_to_string(place.path("few.csv")).unwrap();
    for (before, after) in rows.iter().zip(after.lines().skip(1)) {
        let after: Vec<f64> = after.split(',').map(|x| x.parse().unwrap()).collect();
        assert!((4..6).all(|k| before[k].is_infinite() || after[k] <= 1.1001 * before[k]), "{before:?} {after:?}");
    }
    for (line, said) in [
        ("features room.glb --worth --csv a.csv", "--sensor"),
        ("features room.glb --worth --sensor realsense-d435 --csv a.csv", "pixel_sigma"),
        ("features room.glb --worth --sensor eye.toml --spacing 0", "spacing above 0"),
        ("features room.glb --worth --sensor eye.toml --floor 50", "is free"),
        ("features room.glb --class video --csv a.csv", "--worth"),
    ] {
        let outcome = place.run(line);
        assert!(outcome.status != Some(0) && outcome.stderr.contains(said), "{line}: {}", outcome.stderr);
    }
}
