//! Bags with one fault each, made message by message: the error is one line with the topic, the stamp and a remedy.

use super::Place;
use glam::DVec3;
use presight::Pose;
use presight::ros::{BagWriter, create_bag};
use presight_ros::message::{
    CameraInfo, Header, Image, LaserScan, Message, Odometry, PointCloud2, PointField, Scalar, TFMessage,
    TransformStamped,
};
use presight_ros::{Record, Topic};
use presight_testkit::data;
use std::fs;
use std::path::Path;
use std::sync::Arc;

const ROOM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb");
/// 2023-11-14, nanoseconds.
const START: i64 = 1_700_000_000_000_000_000;
/// Nanoseconds from one scan to the next.
const PERIOD: i64 = 100_000_000;

fn header(stamp_ns: i64, frame: &str) -> Header {
    Header { stamp_ns, frame_id: frame.into() }
}

fn scan(stamp_ns: i64) -> LaserScan {
    LaserScan {
        header: header(stamp_ns, "laser"),
        angle_min: -1.0,
        angle_max: 1.0,
        angle_increment: 0.02,
        time_increment: 0.0,
        scan_time: 0.0,
        range_min: 0.1,
        range_max: 10.0,
        ranges: vec![1.0; 101],
        intensities: vec![],
    }
}

fn transform(parent: &str, child: &str, stamp_ns: i64) -> TransformStamped {
    let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.0, 0.9), 0.0, 0.0, 0.0);
    TransformStamped { header: header(stamp_ns, parent), child_frame_id: child.into(), parent_from_child: Some(pose) }
}

fn transforms(topic: &str, edges: &[(&str, &str)], stamp_ns: i64) -> Record {
    let transforms = edges.iter().map(|(parent, child)| transform(parent, child, stamp_ns)).collect();
    Record::of(topic, stamp_ns, &TFMessage { transforms })
}

fn cloud(data: &[u8], point_step: u32, offset: u32) -> PointCloud2<'_> {
    let field = |(k, name): (u32, &str)| PointField {
        name: name.into(),
        offset: offset + 4 * k,
        scalar: Some(Scalar::F32),
        count: 1,
    };
    PointCloud2 {
        header: header(START, "laser"),
        height: 1,
        width: 2,
        fields: [(0, "x"), (1, "y"), (2, "z")].map(field).to_vec(),
        is_bigendian: false,
        point_step,
        row_step: 2 * point_step,
        data,
        is_dense: true,
    }
}

fn camera(k: [f64; 9]) -> CameraInfo {
    CameraInfo {
        header: header(START, "optical"),
        height: 2,
        width: 3,
        distortion_model: String::new(),
        d: vec![],
        k,
        r: [0.0; 9],
        p: [0.0; 12],
        binning: [0; 2],
        roi: [0; 4],
        do_rectify: false,
    }
}

fn image(data: &[u8], encoding: &str) -> Record {
    let (header, encoding) = (header(START, "optical"), encoding.to_owned());
    let image = Image { header, height: 2, width: 3, encoding, is_bigendian: false, step: 12, data };
    Record::of("/depth/image", START, &image)
}

fn write(path: &Path, records: impl IntoIterator<Item = Record>) {
    let mut bag: BagWriter = create_bag(path).unwrap();
    records.into_iter().for_each(|record| bag.add(&record).unwrap());
    bag.finish().unwrap();
}

/// The room, the mount of the sensor, and these messages.
fn mounted(place: &Place, records: impl IntoIterator<Item = Record>) {
    let mount = transforms("/tf_static", &[("base_link", "laser"), ("base_link", "optical")], START);
    write(&place.path("a.mcap"), std::iter::once(mount).chain(records));
}

fn of_scan(stamp_ns: i64, change: impl FnOnce(&mut LaserScan)) -> Record {
    let mut scan = scan(stamp_ns);
    change(&mut scan);
    // The recorder's time, some milliseconds later.
    Record::of("/scan", stamp_ns.max(START) + 5_000_000, &scan)
}

/// Localizes along the bag of a place; the status, and the last line of the messages.
fn localize(place: &Place, flags: &str) -> (Option<i32>, String) {
    let line = format!("localize a.mcap --map {ROOM} --init 1.2,1.4,0,0,0,0 {flags} --out a.tum");
    let done = place.run(&line);
    let lines: Vec<&str> = done.stderr.lines().collect();
    assert!(!done.stderr.contains("panicked"), "{}", done.stderr);
    (done.status, lines.last().copied().unwrap_or_default().to_owned())
}

/// Checks that the bag is refused with a last line of these words.
fn refused(place: &Place, flags: &str, status: i32, words: &[&str]) {
    let (found, line) = localize(place, flags);
    assert_eq!(found, Some(status), "{line}");
    assert!(words.iter().all(|word| line.contains(word)), "{words:?}: {line}");
}

#[test]
fn scans_that_contradict_themselves() {
    let place = Place::new();
    type Fault = fn(&mut LaserScan);
    let faults: [(Fault, &str); 7] = [
        (|s| s.angle_increment = 0.0, "angle_increment is 0"),
        (|s| s.angle_increment = f32::NAN, "angle_increment is NaN"),
        (|s| s.angle_min = f32::INFINITY, "angle_min is inf"),
        (|s| s.ranges = vec![1.0; 90], "90 ranges do not fit the angles"),
        (|s| s.ranges = vec![], "no ranges"),
        (|s| s.intensities = vec![1.0; 7], "7 intensities for 101 ranges"),
        (|s| s.range_max = f32::NAN, "range_max"),
    ];
    for (fault, words) in faults {
        mounted(&place, [of_scan(START, |_| ()), of_scan(START + PERIOD, fault)]);
        refused(&place, "", 1, &["a.mcap", "/scan", "1700000000.105", words, "; "]);
    }
    // The scanner turns the other way: no fault.
    mounted(&place, [of_scan(START, |s| (s.angle_min, s.angle_max, s.angle_increment) = (1.0, -1.0, -0.02))]);
    assert_eq!(localize(&place, "").0, Some(0));
}

#[test]
fn stamps_that_fall_and_stamps_of_zero() {
    let place = Place::new();
    let at = |stamp: i64| of_scan(stamp, |_| ());
    for stamp in [START, START - 3_600_000_000_000] {
        mounted(&place, [at(START), at(stamp)]);
        refused(&place, "", 1, &["/scan", "is not after 1700000000.000000 s", "cut the bag where the clock jumps"]);
    }
    let without = |at: i64| Record { log_time_ns: at, ..of_scan(0, |_| ()) };
    mounted(&place, [without(START), without(START + PERIOD)]);
    let done = place.run(&format!("localize a.mcap --map {ROOM} --init 1.2,1.4,0,0,0,0 --out a.tum"));
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    assert!(done.stderr.contains("2 messages have the stamp 0: the recorder's time is taken"), "{}", done.stderr);
    let poses = fs::read_to_string(place.path("a.tum")).unwrap();
    assert!(poses.is_empty() || poses.starts_with("1700000000.0"), "{poses}");
}

#[test]
fn frames_without_a_path_with_two_parents_and_in_a_loop() {
    let place = Place::new();
    write(&place.path("a.mcap"), [of_scan(START, |_| ())]);
    refused(&place, "", 2, &["no static transform leads from \"base_link\" to \"laser\"", "--mount", "--base"]);
    refused(&place, "--mount 0,0,0,0,0", 2, &["--mount"]);
    assert_eq!(localize(&place, "--mount 0.1,0,0.9,0,0,0").0, Some(0));

    let odd = |edges: &[(&str, &str)]| transforms("/tf_static", edges, START);
    mounted(&place, [odd(&[("mast", "laser")]), of_scan(START, |_| ())]);
    let done = place.run("bag a.mcap");
    assert!(done.stdout.contains("frame \"laser\" has two parents, \"base_link\" and \"mast\""), "{}", done.stdout);
    mounted(&place, [odd(&[("laser", "base_link")]), of_scan(START, |_| ())]);
    let done = place.run("bag a.mcap");
    assert!(done.stdout.contains("are parents of each other"), "{}", done.stdout);
    refused(&place, "--base nowhere", 2, &["no transform has the frame \"nowhere\"", "frames: base_link, laser"]);
}

/// Only `map` to the base, and no odometry: the poses are the reference.
#[test]
fn a_reference_without_odometry() {
    let place = Place::new();
    let tf = |stamp: i64| transforms("/tf", &[("map", "base_link")], stamp);
    mounted(&place, [tf(START), of_scan(START, |_| ()), tf(START + PERIOD), of_scan(START + PERIOD, |_| ())]);
    let done = place.run("bag a.mcap");
    assert!(done.stdout.contains("takes  odometry none") && done.stdout.contains("/tf from map to"), "{}", done.stdout);
    let given = format!("replay a.mcap --map {ROOM} --init reference --given --mcap b.mcap");
    let done = place.run(&given);
    assert_eq!(done.status, Some(0), "{}", done.stderr);
}

#[test]
fn clouds_and_images_that_contradict_themselves() {
    let place = Place::new();
    let points = [1.0f32, 0.0, 0.0, 0.0, 1.0, 0.0].map(f32::to_le_bytes).concat();
    let of_cloud = |cloud: &PointCloud2<'_>| Record::of("/points", START, cloud);
    mounted(&place, [of_cloud(&cloud(&points, 12, 2))]);
    refused(&place, "", 1, &["/points", "1700000000.0", "field"]);
    mounted(&place, [of_cloud(&cloud(&points, 8, 0))]);
    refused(&place, "", 1, &["/points", "1700000000.0"]);
    mounted(&place, [of_cloud(&PointCloud2 { width: 9, ..cloud(&points, 12, 0) })]);
    refused(&place, "", 1, &["/points", "1700000000.0"]);
    mounted(&place, [of_cloud(&PointCloud2 { fields: vec![], ..cloud(&points, 12, 0) })]);
    refused(&place, "", 1, &["/points", "no field x", "record a topic with x, y and z"]);

    let pixels = [1.0f32; 6].map(f32::to_le_bytes).concat();
    mounted(&place, [image(&pixels, "32FC1")]);
    refused(&place, "", 1, &["/depth/image", "no CameraInfo", "record /depth/camera_info too"]);
    let info = |k: [f64; 9]| Record::of("/depth/camera_info", START, &camera(k));
    mounted(&place, [info([0.0; 9]), image(&pixels, "32FC1")]);
    refused(&place, "", 1, &["/depth/image", "1700000000.0", "; "]);
    let k = [2.0, 0.0, 1.0, 0.0, 2.0, 0.5, 0.0, 0.0, 1.0];
    mounted(&place, [info(k), image(&pixels[..20], "32FC1")]);
    refused(&place, "", 1, &["/depth/image", "1700000000.0", "; "]);
    mounted(&place, [info(k), image(&pixels, "bgr8")]);
    refused(&place, "", 1, &["no measurement", "depth or grey images"]);
    refused(&place, "--topic /depth/image", 2, &["its encoding is bgr8"]);
}

#[test]
fn other_serializations_and_types() {
    let place = Place::new();
    for encoding in ["ros1", "protobuf", "json", "wrong_format"] {
        let topic = Topic { encoding: encoding.into(), ..Topic::of::<LaserScan>("/scan") };
        mounted(&place, [Record { topic: Arc::new(topic), ..of_scan(START, |_| ()) }]);
        refused(&place, "", 1, &["/scan", encoding, "serialization format cdr"]);
    }
    // The type of the topic is not that of its messages.
    let odometry = Odometry {
        header: header(START, "laser"),
        child_frame_id: "base_link".into(),
        odom_from_child: Some(Pose::IDENTITY),
        pose_covariance: [0.0; 36],
        twist: [0.0; 6],
        twist_covariance: [0.0; 36],
    };
    mounted(&place, [Record { data: odometry.encode(), ..of_scan(START, |_| ()) }]);
    refused(&place, "", 1, &["/scan", "1700000000.0", "; "]);
    mounted(&place, [Record { data: vec![0, 1, 0, 0, 1, 2], ..of_scan(START, |_| ()) }]);
    refused(&place, "", 1, &["/scan", "; "]);
    mounted(&place, [Record { data: vec![], ..of_scan(START, |_| ()) }]);
    refused(&place, "", 1, &["/scan", "no whole message"]);
}

#[test]
fn the_output_is_not_the_input() {
    let place = Place::new();
    mounted(&place, [of_scan(START, |_| ())]);
    let before = fs::read(place.path("a.mcap")).unwrap();
    for line in [
        format!("localize a.mcap --map {ROOM} --init 1,1,0,0,0,0 --out a.tum --mcap a.mcap"),
        format!("replay a.mcap --map {ROOM} --init 1,1,0,0,0,0 --mcap ./a.mcap"),
        "explore a.mcap --out a.presight --mcap a.mcap".into(),
    ] {
        let done = place.run(&line);
        assert_eq!(done.status, Some(2), "{line}: {}", done.stderr);
        assert!(done.stderr.contains("a.mcap"), "{}", done.stderr);
    }
    assert_eq!(fs::read(place.path("a.mcap")).unwrap(), before);
}

/// Each flipped byte is reported in one line or harmless.
#[test]
fn flipped_bytes_are_told() {
    let place = Place::new();
    mounted(&place, (0..20).map(|k| of_scan(START + k * PERIOD, |_| ())));
    let whole = fs::read(place.path("a.mcap")).unwrap();
    let mut told = 0;
    for at in (0..whole.len()).step_by(whole.len() / 40 + 1) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x55;
        fs::write(place.path("a.mcap"), bytes).unwrap();
        let done = place.run("bag a.mcap");
        assert!(matches!(done.status, Some(0 | 1)) && !done.stderr.contains("panicked"), "{at}: {}", done.stderr);
        told += usize::from(done.stdout.contains("lost  ") || done.status == Some(1));
    }
    assert!(told > 10, "{told}");
}

/// The two scanners of a drive in one bag are the sensors of one robot; elsewhere a second topic is refused.
#[test]
fn several_topics_are_sensors_of_one_drive() {
    let (Some(bags), Some(map)) = (data::file("ros"), data::file("lidar2d/malaga_corridor_map.glb")) else { return };
    let (place, bag) = (Place::new(), presight_ros::Bag::open(&bags.join("malaga_zstd.mcap")).unwrap());
    let rear = TransformStamped { parent_from_child: Some(Pose::IDENTITY), ..transform("laser", "rear", START) };
    let mut records = vec![Record::of("/tf_static", START, &TFMessage { transforms: vec![rear] })];
    for record in bag.messages(|_| true).map(Result::unwrap) {
        if record.topic.name == "/scan" {
            let mut rear = LaserScan::decode(&record.data).unwrap();
            rear.header.frame_id = "rear".into();
            records.push(Record::of("/rear", record.log_time_ns, &rear));
        }
        records.push(record);
    }
    write(&place.path("two.mcap"), records);
    let run = |line: &str| place.run(&line.replace("MAP", &map.to_string_lossy()));
    let one = run("update two.mcap --topic /scan --map MAP --init unknown --out one");
    let two = run("update two.mcap --topic /scan --topic /rear --map MAP --init unknown --out two");
    assert_eq!((one.status, two.status), (Some(0), Some(0)), "{} {}", one.stderr, two.stderr);
    assert_ne!(one.stdout, two.stdout, "the second sensor counts");
    let line =
        "supervise two.mcap --topic /scan --topic /rear --map MAP --init unknown --corridor way.json --out a.jsonl";
    place
        .write("way.json", br#"{"polyline_in_robot": [[0, 0], [2, 0]], "half_width": 0.4, "z_min": 0.05, "z_max": 1}"#);
    let done = run(line);
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    for (line, words) in [
        ("localize two.mcap --topic /scan --topic /rear --map MAP --init unknown --out a.tum", "follows one sensor"),
        ("replay two.mcap --topic /scan --topic /rear --map MAP --init unknown --out page", "follows one sensor"),
        ("update two.mcap --topic /scan --topic /scan --map MAP --init unknown --out b", "given twice"),
        ("update two.mcap --topic /scan --topic /rear --mount 0,0,0,0,0,0 --map MAP --init unknown --out b", "--mount"),
        ("update two.mcap --map MAP --init unknown --out b", "several measured topics"),
    ] {
        let done = run(line);
        assert_eq!(done.status, Some(2), "{line}: {}", done.stderr);
        assert!(done.stderr.contains(words), "{line}: {}", done.stderr);
    }
}
