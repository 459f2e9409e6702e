//! Scanners and logs as drivers deliver them, from `tests/files/cases`, with the truths that the logs were made with.

use super::Place;
use presight::files;
use std::fs;
use std::path::Path;

/// A place with the files of a case.
pub fn case(name: &str) -> Place {
    let place = Place::new();
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/files/cases")).join(name);
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, place.path(path.file_name().unwrap().to_str().unwrap())).unwrap();
    }
    place
}

/// Follows a log in the hall; the poses that are known are within 5 mm and 0.2 degrees of the truth of their frame:
/// 0.25 m and 0.05 m farther, and 2 degrees further left, than in the frame before.
fn check(place: &Place, line: &str, at_least: usize) {
    let done = place.run(&format!("localize {line} --map hall.glb --out out.tum"));
    assert_eq!((done.status, done.stderr.as_str()), (Some(0), ""), "{line}\n{}", done.stdout);
    let found = files::read_tum(&place.path("out.tum")).unwrap();
    assert!(found.len() >= at_least, "{line}: {} poses\n{}", found.len(), done.stdout);
    for f in found {
        let (t, yaw) = (f.pose.translation, f.pose.rpy().2.to_degrees());
        let off = (t.x - 1.5 - 0.25 * f.time).hypot(t.y - 3.5 - 0.05 * f.time);
        let turned = (yaw - 5.0 - 2.0 * f.time).abs();
        assert!(off < 5e-3 && turned < 0.2, "{line}, {}: {off} m, {turned} deg", f.time);
    }
}

/// The rotation of a mount that hangs upside down is not level to the last bit.
#[test]
fn a_scanner_that_hangs_upside_down_is_found() {
    let place = case("localize-upside-down");
    check(&place, "run.jsonl --init unknown", 1);
    check(&place, "run.jsonl --init 1.5,3.5,0,0,0,5", 5);
}

/// -3.124139 to 3.141539 radians in 360 beams: steps of 0.9999914 degrees.
#[test]
fn an_rplidar_is_found() {
    let place = case("localize-rplidar");
    check(&place, "scans.json --init unknown", 1);
    check(&place, "scans.json --init 1.5,3.5,0,0,0,5", 6);
}

/// 0 to 6.28318977 radians in 360 beams, the last one in the direction of the first.
#[test]
fn a_turtlebot3_is_found_and_followed() {
    let place = case("scan-turtlebot3");
    check(&place, "scans.json --init unknown", 1);
    check(&place, "scans.json --init 1.5,3.5,0,0,0,5", 6);
    let refused = fs::read_to_string(place.path("scans.json")).unwrap().replace("6.28318977356", "6.30");
    place.write("more.json", refused.as_bytes());
    let line = "localize more.json --map hall.glb --init unknown --out out.tum";
    super::check(&place, vec![super::bad(line, 1, &["more.json", "angle_max 6.3", "more than a turn"])]);
}

/// By hand: seen from the origin to the left of it, 180 degrees behind a scanner that is turned round, the wall is 2 m
/// away: in the first and in the last of 720 columns, and to either side of them 2 m / cos 0.5006954 deg.
#[test]
fn a_scanner_that_goes_fully_round_ends_with_its_first_column() {
    let place = case("scan-full-circle");
    let line = "predict wall.glb --sensor lidar.toml --pose 0,0,0.5,0,0,180 --backend cpu --out out.exr";
    place.done(line);
    let range = place.images("out.exr").images.range;
    assert_eq!((range.len(), range[0].to_bits()), (720, range[719].to_bits()));
    let beside = (2.0 / 0.500_695_410_292_f64.to_radians().cos()) as f32;
    assert_eq!(range[0], 2.0);
    assert!((range[1] - beside).abs() < 1e-6 && (range[718] - beside).abs() < 1e-6, "{} {}", range[1], range[718]);
}
