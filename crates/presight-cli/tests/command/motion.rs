//! Scans that a robot measures while it drives.

use super::Place;
use presight::files::read_exr;

/// A scanner of 361 columns from -90 to 90 degrees in 0.1 s, before the wall at x = 2 m.
fn place() -> Place {
    let place = Place::new();
    let sensor = place.done("sensors laser-scanner");
    place.write("turning.toml", format!("turn_s = 0.1\n{sensor}").as_bytes());
    let line = |t: f64| format!("{} {} 0 1 0 0 0 1\n", 10.0 + t, 2.0 * t);
    place.write("drive.tum", [0.0, 0.1, 0.2].map(line).concat().as_bytes());
    place.write("scans.tum", [0.0, 0.05].map(line).concat().as_bytes());
    place
}

const BASE: &str = "predict wall.glb --sensor turning.toml --backend cpu --outputs range,polygon_id";

/// By hand: the middle column is measured 0.1 x 180 / 361 s after the stamp. At 2 m/s the wall, 2 m ahead at the stamp,
/// is then 1.9003 m away.
#[test]
fn each_column_is_predicted_from_where_the_robot_is_then() {
    let place = place();
    let middle = |name: &str| f64::from(read_exr(&place.path(name)).unwrap().images.range[180]);
    let then = 2.0 - 2.0 * 0.1 * 180.0 / 361.0;
    place.done(&format!("{BASE} --pose 0,0,1,0,0,0 --out standing.exr"));
    assert!((middle("standing.exr") - 2.0).abs() < 1e-6);
    let end = 2.0 * 0.1 * 360.0 / 361.0;
    let ways = [
        "--pose 0,0,1,0,0,0 --twist 2,0,0,0,0,0".to_owned(),
        format!("--pose 0,0,1,0,0,0 --pose-end {end},0,1,0,0,0"),
        "--pose 0,0,1,0,0,0 --trajectory drive.tum --stamp 10".to_owned(),
    ];
    for way in ways {
        place.done(&format!("{BASE} {way} --out moving.exr --points moving.ply --deskew 0.05"));
        assert!((middle("moving.exr") - then).abs() < 1e-6, "{way}: {}", middle("moving.exr"));
        let same = place.run("compare moving.exr moving.exr --scene wall.glb --precision f64");
        assert_eq!(same.status, Some(0), "{}", same.stdout);
    }
    assert_eq!(place.run("compare moving.exr standing.exr --scene wall.glb").status, Some(1));
    place.done(&format!("{BASE} --poses scans.tum --trajectory drive.tum --out s{{i}}.exr"));
    place.done("batch wall.glb --sensor turning.toml --poses scans.tum --trajectory drive.tum --out many");
    for i in 0..2 {
        let [single, many] = [format!("s{i}.exr"), format!("many/00000{i}.exr")].map(|name| middle(&name));
        assert!((single - (then - 0.1 * f64::from(i))).abs() < 1e-6 && single == many, "{single} {many}");
    }
}

#[test]
fn bad_motion_is_refused_with_a_remedy() {
    let place = place();
    place.write("one.tum", b"10 0 0 1 0 0 0 1\n");
    place.write("back.tum", b"10 0 0 1 0 0 0 1\n9 0 0 1 0 0 0 1\n");
    place.write("gap.tum", b"10 0 0 1 0 0 0 1\n10.7 0 0 1 0 0 0 1\n");
    place.write("ns.tum", b"1700000000000000000 0 0 1 0 0 0 1\n1700000000200000000 0 0 1 0 0 0 1\n");
    place.write("late.tum", b"12 0 0 1 0 0 0 1\n");
    let refused = [
        ("--pose 0,0,1,0,0,0 --twist 1,2,3", "3 numbers"),
        ("--pose 0,0,1,0,0,0 --twist 1,0,0,0,0,nan", "not a finite number"),
        ("--pose 0,0,1,0,0,0 --pose-end 0,0,1,0,0,180", "ambiguous"),
        ("--poses scans.tum --out x{i}.exr --pose-end 0,0,1,0,0,1", "a series"),
        ("--pose 0,0,1,0,0,0 --trajectory drive.tum", "the stamp"),
        ("--pose 0,0,1,0,0,0 --trajectory drive.tum --stamp 10.15", "outside of the trajectory"),
        ("--pose 0,0,1,0,0,0 --trajectory one.tum --stamp 10", "a trajectory of 1 poses"),
        ("--pose 0,0,1,0,0,0 --trajectory back.tum --stamp 9", "goes back"),
        ("--pose 0,0,1,0,0,0 --trajectory gap.tum --stamp 10.1", "no pose between"),
        ("--pose 0,0,1,0,0,0 --trajectory ns.tum --stamp 1.7e18", "nanoseconds"),
        ("--pose 0,0,1,0,0,0 --trajectory drive.tum --stamp 9", "a scan from 9 s to 9.09"),
        ("--pose 0,0,1,0,0,0 --twist 1e300,0,0,0,0,0", "a twist of [1e300"),
        (
            "--pose 0,0,1,0,0,0 --trajectory drive.tum --stamp 10 --points x.ply --deskew 7",
            "--deskew 7: a motion that does",
        ),
        ("--poses late.tum --out x{i}.exr --trajectory drive.tum", "outside of the trajectory"),
        ("--pose 0,0,1,0,0,0 --twist 1,0,0,0,0,0 --deadline-ms 5", "a deadline"),
        ("--pose 0,0,1,0,0,0 --twist 1,0,0,0,0,0 --virtual depth-image", "virtual sensors"),
    ];
    for (flags, words) in refused {
        let outcome = place.run(&format!("{BASE} {flags}"));
        assert!(matches!(outcome.status, Some(1 | 2)), "{flags}: {}{}", outcome.stdout, outcome.stderr);
        assert!(outcome.stderr.contains(words), "{flags}: {}", outcome.stderr);
    }
    let at_once = place.run("predict wall.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --twist 1,0,0,0,0,0");
    assert!(at_once.stderr.contains("measures all rays at the stamp"), "{}", at_once.stderr);
}
