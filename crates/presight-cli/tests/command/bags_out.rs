//! ROS 2 bags that commands write, read back as logs and message by message.

use super::{Place, bad, check};
use presight::files::{self, BagOptions, LogFrames, Observation};
use presight_ros::Bag;
use presight_ros::message::{MarkerArray, Message, PointCloud2, PoseWithCovarianceStamped};
use presight_testkit::data;
use serde_json::Value;
use std::fs;
use std::path::Path;

const ROOM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb");
/// A drive of three poses, with stamps of nanoseconds.
const DRIVE: &str = "1700000000.123456789 1.2 1.4 0.9 0 0 0 1\n\
    1700000000.223456789 1.25 1.4 0.9 0 0 0.05 0.99874921777\n\
    1700000000.323456789 1.3 1.42 0.9 0 0 0.1 0.99498743710\n";

fn frames(path: &Path, topic: &str) -> Vec<Observation> {
    let options = BagOptions::default().with_topic(Some(topic.to_owned()));
    let log = LogFrames::open_with(path, None, &Default::default(), &options).unwrap();
    log.map(Result::unwrap).collect()
}

/// The serialized messages of a topic.
fn messages(path: &Path, topic: &'static str) -> Vec<Vec<u8>> {
    let of_topic = Bag::open(path).unwrap().messages(move |t| t.name == topic);
    of_topic.map(|record| record.unwrap().data).collect()
}

fn report(place: &Place, bag: &str) -> Value {
    let done = place.run(&format!("bag {bag} --json"));
    serde_json::from_str(&done.stdout).unwrap_or_else(|e| panic!("{e}: {}", done.stderr))
}

fn scanner(place: &Place) {
    fs::copy(ROOM, place.path("room.glb")).unwrap();
    place.write("drive.tum", DRIVE.as_bytes());
}

fn done(place: &Place, line: &str) {
    let outcome = place.run(line);
    assert_eq!(outcome.status, Some(0), "{line}: {}", outcome.stderr);
}

/// The bag of a replay is a log of its own: the scans bit by bit, and as their reference the poses of the TUM file,
/// which /tf gives by way of the odometry.
#[test]
fn answers_and_measurements_read_back() {
    let (Some(bags), Some(map)) = (data::file("ros"), data::file("lidar2d/malaga_corridor_map.glb")) else { return };
    let (place, bag) = (Place::new(), bags.join("malaga_zstd.mcap"));
    let of_log = format!("{} --map {} --init unknown", bag.display(), map.display());
    done(&place, &format!("localize {of_log} --out a.tum --mcap a.mcap"));
    done(&place, &format!("replay {of_log} --mcap b.mcap"));
    let poses = files::read_tum(&place.path("a.tum")).unwrap();
    assert!(poses.len() > 30);

    let told = report(&place, "a.mcap");
    assert_eq!(told["topics"]["/presight/pose"]["count"], poses.len(), "{told}");
    assert_eq!(told["topics"]["/diagnostics"]["type"], "diagnostic_msgs/msg/DiagnosticArray");
    assert!(
        told["transforms"].as_array().unwrap().iter().any(|t| t["parent"] == "map" && t["child"] == "odom"),
        "{told}"
    );
    for (data, pose) in messages(&place.path("a.mcap"), "/presight/pose").iter().zip(&poses) {
        let message = PoseWithCovarianceStamped::decode(data).unwrap();
        assert_eq!(message.header.frame_id, "map");
        assert!((message.header.stamp_ns as f64 * 1e-9 - pose.time).abs() < 1e-6);
        assert!(message.pose.unwrap().translation.distance(pose.pose.translation) < 1e-12);
        assert!(message.covariance[0] > 0.0);
    }

    let (was, is) = (frames(&bag, "/scan"), frames(&place.path("b.mcap"), "/scan"));
    assert_eq!(was.len(), is.len());
    for (was, is) in was.iter().zip(&is) {
        assert_eq!(was.recorded.as_ref().unwrap().data, is.recorded.as_ref().unwrap().data);
        assert_eq!(was.frame.ranges().len(), is.frame.ranges().len());
    }
    let known: Vec<&Observation> = is.iter().filter(|o| o.reference.is_some()).collect();
    assert_eq!(known.len(), poses.len());
    for (observation, pose) in known.iter().zip(&poses) {
        let there = observation.reference.unwrap().world_from_robot();
        assert!(there.translation.distance(pose.pose.translation) < 1e-9, "{there:?} {pose:?}");
        assert!(there.rotation.angle_between(pose.pose.rotation) < 1e-7);
    }
    let told = report(&place, "b.mcap");
    for (topic, message_type) in [
        ("/presight/predicted", "sensor_msgs/msg/LaserScan"),
        ("/presight/predicted/points", "sensor_msgs/msg/PointCloud2"),
        ("/presight/verdict", "sensor_msgs/msg/PointCloud2"),
        ("/presight/model", "visualization_msgs/msg/MarkerArray"),
    ] {
        assert_eq!(told["topics"][topic]["type"], message_type, "{told}");
    }
    let model = messages(&place.path("b.mcap"), "/presight/model");
    assert!(!MarkerArray::decode(&model[0]).unwrap().markers.is_empty());
}

/// The largest residual of a bag's verdicts, metres, and the number of points.
fn largest_residual(path: &Path) -> (f64, usize) {
    let (mut largest, mut count) = (0.0f64, 0);
    for data in messages(path, "/presight/verdict") {
        let cloud = PointCloud2::decode(&data).unwrap();
        for residual in cloud.values("residual").unwrap().unwrap().filter(|r| !r.is_nan()) {
            (largest, count) = (largest.max(residual.abs()), count + 1);
        }
    }
    (largest, count)
}

/// What presight predicted is what it predicts again: scans, points and depths have no residual, and a mount that is
/// off by a degree has one.
#[test]
fn a_predicted_log_has_no_residual() {
    let place = Place::new();
    scanner(&place);
    for (sensor, topic) in [
        ("laser-scanner", "/laser_scanner/scan"),
        ("laser-scanner", "/laser_scanner/points"),
        ("vlp-16", "/vlp_16/points"),
        ("realsense-d435", "/realsense_d435/depth"),
    ] {
        done(&place, &format!("predict room.glb --sensor {sensor} --poses drive.tum --mcap a.mcap"));
        let replay = format!("replay a.mcap --topic {topic} --map room.glb --init reference --given --mcap b.mcap");
        done(&place, &replay);
        let (residual, count) = largest_residual(&place.path("b.mcap"));
        // Directions of points are of f32: 6e-8 of a range, at grazing incidence up to a hundred times that.
        assert!(residual < 2e-5 && count > 300, "{topic}: {residual} m of {count}");
        done(&place, &format!("{replay} --mount 0,0,0,0,0,1"));
        let (residual, _) = largest_residual(&place.path("b.mcap"));
        assert!(residual > 1e-3, "{topic}: {residual} m");
    }
}

/// Stamps keep their nanoseconds, and the frame of the poses is the one that was named.
#[test]
fn predictions_have_the_stamps_of_their_poses() {
    let place = Place::new();
    scanner(&place);
    done(&place, "predict room.glb --sensor laser-scanner --poses drive.tum --mcap a.mcap --frame world");
    let scans = frames(&place.path("a.mcap"), "/laser_scanner/scan");
    let stamps: Vec<i64> = scans.iter().map(|o| o.recorded.as_ref().unwrap().stamp_ns).collect();
    assert_eq!(stamps, [1_700_000_000_123_456_789, 1_700_000_000_223_456_789, 1_700_000_000_323_456_789]);
    let told = report(&place, "a.mcap");
    let edges: Vec<(&str, &str)> = told["transforms"]
        .as_array()
        .unwrap()
        .iter()
        .map(|t| (t["parent"].as_str().unwrap(), t["child"].as_str().unwrap()))
        .collect();
    assert_eq!(edges, [("base_link", "laser-scanner"), ("world", "base_link")]);
}

/// A simulated bag and the simulated log beside it are the same frames.
#[test]
fn a_simulated_bag_equals_its_log() {
    let place = Place::new();
    scanner(&place);
    done(&place, "simulate room.glb --sensor laser-scanner --intensities --poses drive.tum --out run --mcap run.mcap");
    let log = LogFrames::open(&place.path("run/scans.jsonl"), None, &Default::default()).unwrap();
    let log: Vec<Observation> = log.map(Result::unwrap).collect();
    let bag = frames(&place.path("run.mcap"), "/laser_scanner/scan");
    assert_eq!((log.len(), bag.len()), (3, 3));
    for (a, b) in log.iter().zip(&bag) {
        let bits = |o: &Observation| o.frame.ranges().iter().map(|r| r.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(a), bits(b));
        let place = |o: &Observation| o.reference.unwrap().world_from_robot().translation;
        assert!(place(a).distance(place(b)) < 1e-9);
        let motion = |o: &Observation| o.frame.motion.map(|m| m.previous_from_current);
        assert_eq!(motion(a).is_some(), motion(b).is_some());
        if let (Some(a), Some(b)) = (motion(a), motion(b)) {
            assert!(a.translation.distance(b.translation) < 1e-9, "{a:?} {b:?}");
        }
    }
}

#[test]
fn outputs_that_cannot_be_are_refused() {
    let place = Place::new();
    scanner(&place);
    let log = "a.mcap --map room.glb --init reference";
    done(&place, "predict room.glb --sensor laser-scanner --poses drive.tum --mcap a.mcap");
    check(
        &place,
        vec![
            bad("predict room.glb --sensor vlp-16 --pose 1,1,1,0,0,0 --mcap a.mcap", 2, &["--poses"]),
            bad("predict room.glb --sensor vlp-16 --poses drive.tum --mcap a.bag", 2, &["--mcap", ".mcap"]),
            bad(format!("localize {log} --out a.tum --mcap a.mcap"), 2, &["a.mcap", "input file"]),
            bad(format!("replay {log} --given"), 2, &["--mcap"]),
            bad(format!("replay {log}"), 2, &["--out"]),
            bad("predict room.glb --sensor vlp-16 --poses drive.tum --mcap nowhere/a.mcap", 4, &["nowhere/a.mcap"]),
        ],
    );
}
