//! ROS 2 bags as logs, against the same measurements in a JSON log and against what other readers of bags found.

use super::{Outcome, Place, bad, check};
use presight::files;
use presight_testkit::data;
use serde_json::Value;
use std::fs;
use std::path::PathBuf;

/// The scanner of the drive, with the noise that a LaserScan cannot hold.
const SCANNER: &str = "format = 1\nkind = \"scanner\"\nclass = \"laser\"\nrange_max = 80.0\n[azimuth]\nstart_deg = -90.0\n\
    step_deg = 0.5\ncount = 361\n[elevation]\nangles_deg = [0.0]\n[noise]\nrange_sigma = 0.009999999776482582\n";

/// The folder of bags, and a place with the corridor and its JSON log.
fn corridor() -> Option<(Place, PathBuf)> {
    let (bags, scans) = (data::file("ros")?, data::file("lidar2d/malaga_corridor_run_scans.json")?);
    let place = Place::new();
    fs::copy(&scans, place.path("scans.json")).unwrap();
    fs::copy(scans.with_file_name("malaga_corridor_map.glb"), place.path("corridor.glb")).unwrap();
    place.write("scanner.toml", SCANNER.as_bytes());
    Some((place, bags))
}

fn localize(place: &Place, log: &str, flags: &str) -> Outcome {
    place.run(&format!("localize {log} --map corridor.glb --init unknown {flags} --out a.tum"))
}

/// Bags in MCAP, in SQLite and in two files give the poses of the JSON log within 0.1 mm and 0.001 degrees.
#[test]
fn a_bag_gives_the_poses_of_the_same_scans_in_json() {
    let Some((place, bags)) = corridor() else { return };
    let of_json = localize(&place, "scans.json", "");
    assert_eq!(of_json.status, Some(0), "{}", of_json.stderr);
    let expected = files::read_tum(&place.path("a.tum")).unwrap();
    assert!(expected.len() > 30, "{}", of_json.stdout);
    for name in ["malaga_zstd.mcap", "malaga_humble", "malaga_split"] {
        let done = localize(&place, &bags.join(name).to_string_lossy(), "--sensor scanner.toml");
        assert_eq!(done.status, Some(0), "{name}: {}", done.stderr);
        let found = files::read_tum(&place.path("a.tum")).unwrap();
        assert_eq!(found.len(), expected.len(), "{name}: {}", done.stdout);
        for (f, e) in found.iter().zip(&expected) {
            assert!((f.time - e.time).abs() < 1e-6, "{name}: {f:?} {e:?}");
            assert!(f.pose.translation.distance(e.pose.translation) < 1e-4, "{name}: {f:?} {e:?}");
            assert!(f.pose.rotation.angle_between(e.pose.rotation).to_degrees() < 1e-3, "{name}: {f:?} {e:?}");
        }
        fs::remove_file(place.path("a.tum")).unwrap();
    }
}

/// A mount that is off by a degree moves the poses by far more than the bound above.
#[test]
fn a_wrong_mount_moves_the_poses() {
    let Some((place, bags)) = corridor() else { return };
    let bag = bags.join("malaga_zstd.mcap");
    let poses = |mount: &str| {
        let done = localize(&place, &bag.to_string_lossy(), &format!("--sensor scanner.toml {mount}"));
        assert_eq!(done.status, Some(0), "{}", done.stderr);
        files::read_tum(&place.path("a.tum")).unwrap()
    };
    let by_transforms = poses("");
    fs::remove_file(place.path("a.tum")).unwrap();
    fs::remove_file(place.path("a.jsonl")).unwrap();
    let turned = poses("--mount 0.78,0,0.3,0,0,1");
    let last = (by_transforms.last().unwrap().pose, turned.last().unwrap().pose);
    assert!(last.0.rotation.angle_between(last.1.rotation).to_degrees() > 0.1, "{last:?}");
}

fn close(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Array(a), Value::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| close(a, b)),
        _ => match (a.as_f64(), b.as_f64()) {
            (Some(a), Some(b)) => (a - b).abs() <= 1e-6 * b.abs().max(1.0),
            _ => a == b,
        },
    }
}

/// Topics, counts, frames, stamps, sensors and transforms as rosbags and NumPy read them.
#[test]
fn reports_agree_with_other_readers() {
    let Some(bags) = data::file("ros") else { return };
    let place = Place::new();
    let expected: Value = serde_json::from_slice(&fs::read(bags.join("expected.json")).unwrap()).unwrap();
    let mut compared = 0;
    for (name, expected) in expected.as_object().unwrap() {
        let Some(topics) = expected["topics"].as_object() else { continue };
        let done = place.run(&format!("bag {} --json", bags.join(name).display()));
        let is_empty = name == "rosbag2_empty";
        assert_eq!(done.status, Some(i32::from(is_empty)), "{name}: {}", done.stderr);
        let report: Value = serde_json::from_str(&done.stdout).unwrap();
        assert_eq!(report["topics"].as_object().unwrap().len(), topics.len(), "{name}");
        for (topic, expected) in topics {
            let found = &report["topics"][topic];
            let keys = ["type", "count", "frame", "first_stamp", "last_stamp", "size", "encoding", "k", "d", "model"];
            for key in keys.iter().filter(|key| !expected[**key].is_null()) {
                // A leading slash of a frame does not count; compressed images do not state their size.
                let expected = match &expected[*key] {
                    Value::String(frame) if *key == "frame" => Value::from(frame.trim_start_matches('/')),
                    other => other.clone(),
                };
                let is_compressed = *key == "size" && found[*key].is_null();
                assert!(is_compressed || close(&found[*key], &expected), "{name} {topic} {key}: {found}");
            }
            for (key, value) in expected["sensor"].as_object().into_iter().flatten() {
                assert!(close(&found["sensor"][key], value), "{name} {topic} {key}: {found}");
            }
            compared += 1;
        }
        for (edge, pose) in expected["mount"].as_object().unwrap().iter().chain(expected["tf"].as_object().unwrap()) {
            let (parent, child) = edge.split_once(' ').unwrap();
            let transforms = report["transforms"].as_array().unwrap();
            let found = transforms.iter().find(|t| t["parent"] == parent && t["child"] == child);
            assert!(found.is_some_and(|t| close(&t["last_pose"], pose)), "{name} {edge}: {found:?}");
        }
    }
    assert!(compared >= 24, "{compared} topics");
}

#[test]
fn damaged_and_foreign_bags_are_named() {
    let Some(bags) = data::file("ros") else { return };
    let place = Place::new();
    let cut = place.run(&format!("bag {}", bags.join("cut_in_mid_chunk.mcap").display()));
    assert_eq!(cut.status, Some(0), "{}", cut.stderr);
    assert!(cut.stdout.contains("/scan  sensor_msgs/msg/LaserScan  26 messages"), "{}", cut.stdout);
    assert!(cut.stdout.contains("cut within a chunk"), "{}", cut.stdout);
    let line = |name: &str| format!("bag {}", bags.join(name).display());
    let odd = place.run(&line("rosbag2_odd_serialization"));
    assert_eq!(odd.status, Some(1), "{}", odd.stdout);
    assert!(odd.stderr.contains("wrong_format") && odd.stderr.contains("record it with"), "{}", odd.stderr);
    let empty = place.run(&line("rosbag2_empty"));
    assert!(empty.stderr.contains("the bag has no measurement"), "{}", empty.stderr);
    let several = place.run(&format!(
        "localize {} --map wall.glb --init unknown --out a.tum",
        bags.join("depth_images.mcap").display()
    ));
    assert_eq!(several.status, Some(2), "{}", several.stderr);
    let lists = [
        "several measured topics",
        "--topic",
        "/camera/depth/image_float (sensor_msgs/msg/Image, frame camera_depth_optical_frame, 2 messages, 10.0 Hz)",
    ];
    assert!(lists.iter().all(|text| several.stderr.contains(text)), "{}", several.stderr);
    let beside: Vec<_> = fs::read_dir(bags.join("rosbag2_empty")).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(beside.len(), 4, "nothing is written beside a bag: {beside:?}");
}

#[test]
fn files_that_are_no_bags_are_refused_with_a_remedy() {
    let place = Place::new();
    place.write("old.bag", b"#ROSBAG V2.0\n");
    place.write("cut.mcap", b"\x89MCAP0\r\n");
    place.write("text.mcap", b"hello, world");
    place.write("packed.db3", b"\x28\xb5\x2f\xfd....");
    let cut = place.run("bag cut.mcap");
    assert_eq!(cut.status, Some(1), "{}", cut.stdout);
    assert!(cut.stdout.contains("cut within a chunk") && cut.stderr.contains("no measurement"), "{}", cut.stderr);
    check(
        &place,
        vec![
            bad("bag old.bag", 1, &["old.bag", "rosbags-convert --src"]),
            bad("localize old.bag --map wall.glb --init unknown --out a.tum", 1, &["old.bag", "rosbags-convert --src"]),
            bad("bag text.mcap", 1, &["text.mcap", "neither an MCAP nor an SQLite file"]),
            bad("bag packed.db3", 1, &["packed.db3", "the compressed data is damaged", "copy the file again"]),
            bad("bag nothing.mcap", 1, &["nothing.mcap", "check the path"]),
            bad("bag cut.mcap --reflector -1", 2, &["--reflector -1"]),
            bad("bag cut.mcap --mount 1,2", 2, &["--mount"]),
        ],
    );
}

/// The three images of one drive are the same depths: in metres, in millimetres, and compressed.
#[test]
fn depth_images_of_all_codings_localize() {
    let Some(bags) = data::file("ros") else { return };
    let place = Place::new();
    fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb"), place.path("room.glb")).unwrap();
    let bag = bags.join("depth_images.mcap");
    for topic in ["image_float", "image_rect_raw", "image_rect_raw/compressedDepth"] {
        let line = format!(
            "localize {} --topic /camera/depth/{topic} --map room.glb --init 0.6,0.65,0,0,0,37.2 --init-sigma 0.3 --out a.tum",
            bag.display()
        );
        let done = place.run(&line);
        assert_eq!(done.status, Some(0), "{topic}: {}", done.stderr);
        let poses = files::read_tum(&place.path("a.tum")).unwrap();
        assert_eq!(poses.len(), 2, "{topic}: {}", done.stdout);
        // The last transform from odom to base_link.
        let there = poses[1].pose.translation;
        assert!(there.distance(glam::DVec3::new(0.6, 0.65, 0.0)) < 0.01, "{topic}: {there}");
        for name in ["a.tum", "a.jsonl"] {
            fs::remove_file(place.path(name)).unwrap();
        }
    }
}

/// Points of an organized and of an unorganized cloud become rays; the log's own `map` frame is the reference.
#[test]
fn clouds_localize() {
    let Some(bags) = data::file("ros") else { return };
    let place = Place::new();
    fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb"), place.path("room.glb")).unwrap();
    for (name, topic) in [("ouster_points.mcap", "/ouster/points"), ("velodyne_points.mcap", "/velodyne_points")] {
        let report = place.run(&format!("bag {}", bags.join(name).display()));
        assert!(report.stdout.contains(&format!("takes  points of {topic}")), "{}", report.stdout);
        let line = format!("localize {} --map room.glb --init reference --out a.tum", bags.join(name).display());
        let done = place.run(&line);
        assert_eq!(done.status, Some(0), "{name}: {}", done.stderr);
        assert!(done.stderr.contains("times of points are taken from the field t"), "{name}: {}", done.stderr);
        let poses = files::read_tum(&place.path("a.tum")).unwrap();
        assert_eq!(poses.len(), 2, "{name}: {}", done.stdout);
        for name in ["a.tum", "a.jsonl"] {
            fs::remove_file(place.path(name)).unwrap();
        }
    }
}
