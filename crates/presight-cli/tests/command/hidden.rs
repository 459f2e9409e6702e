//! What the features file says of hidden features, and of the parts of contours in the image.

use super::{Place, bad, check};
use serde_json::{Value, json};
use std::fs;

/// On the wall at x = 2: seen, partly outside of the image, and two below it.
const LAYER: &str = r#"{"format": 1, "class": "video", "features": [
    {"id": 1, "kind": "point", "name": "seen", "points": [[2, 0.05, 1.45]], "sigma": 0.01},
    {"id": 2, "kind": "segment", "points": [[2, -1, 1.4], [2, 1, 1.4]], "sigma": 0.01},
    {"id": 3, "kind": "segment", "points": [[2, -1, 0], [2, 1, 0]], "sigma": 0.01},
    {"id": 4, "kind": "patch", "points": [[2, 0.8, 0.1], [2, 0.9, 0.1], [2, 0.9, 0.2]], "sigma": 0.01}]}"#;
const PREDICT: &str = "predict wall.glb --sensor video-camera --backend cpu --layer l.json";

fn place() -> Place {
    let place = Place::new();
    place.write("l.json", LAYER.as_bytes());
    // Ahead of the wall, and with the back to it.
    place.write("two.tum", b"0 1.5 0 1.5 0 0 0 1\n1 1.5 0 1.5 0 0 1 0\n");
    place
}

fn entries(file: &Value) -> Vec<&Value> {
    file["features"].as_array().unwrap().iter().collect()
}

fn keys(entry: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = entry.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

#[test]
fn hidden_features_are_listed_in_full_with_a_reason_or_counted() {
    let place = place();
    let features = |hidden: &str| {
        place.done(&format!("{PREDICT} --pose 1.5,0,1.5,0,0,0 --features f.json {hidden}"));
        place.json("f.json")
    };
    let [plain, full, reason, count] = ["", "--hidden full", "--hidden reason", "--hidden count"].map(features);
    assert_eq!(plain, full, "one pose gives the full file");
    let ids = |file: &Value| entries(file).iter().map(|f| f["id"].as_u64().unwrap()).collect::<Vec<_>>();
    assert_eq!((ids(&full), ids(&reason), ids(&count)), (vec![1, 2, 3, 4], vec![1, 2, 3, 4], vec![1, 2]));
    assert_eq!(
        (&count["all_features"], &full["all_features"], &reason["all_features"]),
        (&json!(4), &Value::Null, &Value::Null)
    );
    for i in 0..2 {
        assert!(full["features"][i]["visible_fraction"].as_f64() > Some(0.0), "{full}");
        assert_eq!((&reason["features"][i], &count["features"][i]), (&full["features"][i], &full["features"][i]));
    }
    for i in 2..4 {
        let (of_full, short) = (&full["features"][i], &reason["features"][i]);
        assert_eq!(keys(short), ["hidden", "id", "kind", "visible", "visible_fraction"]);
        assert_eq!(short["hidden"], json!([{"t": [0.0, 1.0], "reason": "outside_image"}]), "{of_full}");
        for key in ["id", "kind", "visible", "visible_fraction"] {
            assert_eq!(short[key], of_full[key]);
        }
    }
    // A line for each.
    features("--hidden reason");
    let text = fs::read_to_string(place.path("f.json")).unwrap();
    let lines = text.lines().map(str::trim).filter(|line| line.starts_with("{\"id\":"));
    assert!(lines.clone().all(|line| line.trim_end_matches(',').ends_with("\"outside_image\"}]}")), "{text}");
    assert_eq!(lines.count(), 2, "{text}");
}

#[test]
fn a_file_of_poses_gives_reasons_by_default() {
    let place = place();
    place.done(&format!("{PREDICT} --poses two.tum --features {{i}}.json"));
    let [ahead, away] = ["0.json", "1.json"].map(|name| place.json(name));
    assert_eq!(entries(&ahead).iter().filter(|f| keys(f).len() == 5).count(), 2);
    assert!(
        entries(&away).len() == 4 && entries(&away).iter().all(|f| f["hidden"][0]["reason"] == "behind_sensor"),
        "{away}"
    );
    place.done(&format!("{PREDICT} --poses two.tum --features full-{{i}}.json --hidden full"));
    place.done(&format!("{PREDICT} --pose 1.5,0,1.5,0,0,0 --features one.json"));
    assert_eq!(place.json("full-0.json"), place.json("one.json"));
    // A preview draws hidden parts, whatever the file says.
    place.done(&format!("{PREDICT} --pose 1.5,0,1.5,0,0,0 --features p.json --png p.png --hidden count"));
    place.done(&format!("{PREDICT} --pose 1.5,0,1.5,0,0,0 --features q.json --png q.png"));
    assert_eq!(entries(&place.json("p.json")).len(), 2);
    assert!(fs::read(place.path("p.png")).unwrap() == fs::read(place.path("q.png")).unwrap());
    check(
        &place,
        vec![
            bad(format!("{PREDICT} --pose 0,0,1,0,0,0 --hidden count"), 2, &["--features"]),
            bad(format!("{PREDICT} --pose 0,0,1,0,0,0 --features f.json --hidden none"), 2, &["--hidden", "reason"]),
        ],
    );
}

/// An equidistant fisheye 0.6 m before a post 4 m high: its silhouettes are bent by many pixels. At the angle a from the
/// axis the image is 163 a pixels from the centre.
#[cfg(feature = "script")]
#[test]
fn the_pixels_of_a_contour_are_its_polyline() {
    let place = Place::new();
    place.write("post.rhai", b"place(\"post\", cylinder(0.25, 4), pose(0.85, 0, 0));");
    let fisheye = "format = 1\nkind = \"camera\"\nwidth = 512\nheight = 512\nfx = 163.0\nfy = 163.0\ncx = 255.5\ncy = 255.5\n\
        [distortion]\nmodel = \"equidistant\"\ncoefficients = [0.0, 0.0, 0.0, 0.0]\n";
    place.write("fisheye.toml", fisheye.as_bytes());
    place.done("features post.rhai --class video --kinds contour --out l.json");
    place.done(
        "predict post.rhai --sensor fisheye.toml --pose 0,0,2,0,0,0 --backend cpu --layer l.json --features f.json",
    );
    let file = place.json("f.json");
    let curves: Vec<&Value> =
        entries(&file).into_iter().filter(|f| f["visible_fraction"].as_f64() > Some(0.9)).collect();
    assert!(curves.len() >= 2, "two sides: {file}");
    let numbers = |v: &Value| -> Vec<Vec<f64>> {
        let list = |v: &Value| v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        v.as_array().unwrap().iter().map(list).collect()
    };
    let project = |p: &[f64]| {
        let (right, down) = (-p[1], 2.0 - p[2]);
        let off = right.hypot(down);
        let angle = off.atan2(p[0]);
        [255.5 + 163.0 * angle * right / off, 255.5 + 163.0 * angle * down / off]
    };
    let distance = |p: [f64; 2], a: &[f64], b: &[f64]| {
        let (ab, ap) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
        let s = ((ab[0] * ap[0] + ab[1] * ap[1]) / (ab[0] * ab[0] + ab[1] * ab[1]).max(1e-300)).clamp(0.0, 1.0);
        (ap[0] - s * ab[0]).hypot(ap[1] - s * ab[1])
    };
    let mut most_bent = 0.0f64;
    for visible in curves.iter().map(|c| (numbers(&c["points_world"]), &c["visible"])).flat_map(|(points, visible)| {
        visible.as_array().unwrap().iter().map(move |v| (points.clone(), v)).collect::<Vec<_>>()
    }) {
        let (points, part) = visible;
        let pixels = numbers(&part["pixels"]);
        let t: Vec<f64> = part["t"].as_array().unwrap().iter().map(|t| t.as_f64().unwrap()).collect();
        let length = |w: &[Vec<f64>]| (0..3).map(|i| (w[1][i] - w[0][i]).powi(2)).sum::<f64>().sqrt();
        let whole: f64 = points.windows(2).map(length).sum();
        let mut before = 0.0;
        for w in points.windows(2) {
            for i in 0..=100 {
                let s = f64::from(i) / 100.0;
                let at = (before + s * length(w)) / whole;
                if (t[0]..=t[1]).contains(&at) {
                    let p = project(&(0..3).map(|k| w[0][k] + s * (w[1][k] - w[0][k])).collect::<Vec<_>>());
                    let off = pixels.windows(2).map(|w| distance(p, &w[0], &w[1])).fold(f64::INFINITY, f64::min);
                    assert!(off <= 0.25, "{off} pixels at {at} of {part}");
                    most_bent = most_bent.max(distance(p, &pixels[0], &pixels[pixels.len() - 1]));
                }
            }
            before += length(w);
        }
    }
    assert!(most_bent > 20.0, "two ends are off by {most_bent} pixels only");
}
