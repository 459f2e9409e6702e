//! `presight update`: a site that changed, its proposed changes, and inputs that teach nothing.

use super::Place;
use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Material, Mesh, NewObject};
use presight_model::geometry::Pose;
use presight_store as store;
use std::fs;

const LIDAR: &str = "format = 1\nkind = \"scanner\"\nclass = \"laser\"\nrange_max = 20\n[azimuth]\nstart_deg = -180\nstep_deg = 2\ncount = 180\n\
    [elevation]\nstart_deg = -20\nstep_deg = 2\ncount = 14\n[noise]\nrange_sigma = 0.01\n[mount]\nxyz = [0.0, 0.0, 1.0]\n";

/// How `update` is given the poses of the drive.
const POSES: &str = "--init reference --poses drive.tum --pose-cov 0.005,0.005,0.005,0.1,0.1,0.1";

/// A room of 9 x 6 m with six crates along its walls; `without` leaves one out, `moved` moves another by 0.6 m.
fn room(without: Option<usize>, moved: Option<usize>) -> Environment {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    let mut add = |name: &str, least: Vec3, size: Vec3, at: DVec3| {
        let mesh = Mesh::cuboid(name, least, least + size, 0).unwrap();
        let pose = Pose { translation: at, ..Pose::IDENTITY };
        environment.insert(NewObject::new(name, pose, mesh.into())).unwrap();
    };
    add("room", Vec3::ZERO, Vec3::new(9.0, 6.0, 2.6), DVec3::ZERO);
    for k in 0..6 {
        let (x, y) = (1.0 + 2.6 * (k / 2) as f64, if k % 2 == 0 { 0.3 } else { 4.9 });
        let aside = if moved == Some(k) { 0.6 } else { 0.0 };
        if without != Some(k) {
            let size = Vec3::new(0.7, 0.6 + 0.05 * k as f32, 0.8 + 0.1 * k as f32);
            add(&format!("crate {k}"), Vec3::ZERO, size, DVec3::new(x + aside, y, 0.0));
        }
    }
    environment
}

/// A place with the store of a room, and the log of a drive through the changed room.
fn site(without: Option<usize>, moved: Option<usize>) -> Place {
    let place = Place::new();
    let note = store::Note::new("test", 0.0);
    store::create(&place.path("map.presight"), &room(None, None), &note).unwrap();
    store::create(&place.path("site.presight"), &room(without, moved), &note).unwrap();
    place.write("lidar.toml", LIDAR.as_bytes());
    let line = |k: usize| format!("{} {} {} 0 0 0 0 1\n", k, 1.0 + 0.29 * k as f64, 2.6 + 0.02 * k as f64);
    place.write("drive.tum", (0..24).map(line).collect::<String>().as_bytes());
    let made = place.run("simulate site.presight --sensor lidar.toml --poses drive.tum --out log");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    place
}

fn changes(place: &Place, folder: &str) -> Vec<serde_json::Value> {
    let text = fs::read_to_string(place.path(folder).join("changes.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// A crate is gone, another was moved: both are proposed, with evidence; applied, they are the site, and undone they are
/// the first content. The same lines again change nothing.
#[test]
fn a_changed_room_is_proposed_applied_and_undone() {
    let place = site(Some(2), Some(5));
    let before = fs::read(place.path("map.presight")).unwrap();
    let first = store::check(&place.path("map.presight")).unwrap().environment.content_hash();
    let done = place.run(&format!("update log/scans.jsonl --map map.presight {POSES} --out found"));
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    assert!(done.stdout.contains("1 gone, 1 moved, 0 new"), "{}", done.stdout);
    assert_eq!(fs::read(place.path("map.presight")).unwrap(), before, "the store is untouched");
    let lines = changes(&place, "found");
    assert_eq!((&lines[0]["op"], &lines[0]["object"]), (&"delete_object".into(), &"crate 2".into()));
    assert_eq!((&lines[1]["op"], &lines[1]["object"]), (&"set_pose".into(), &"crate 5".into()));
    assert!(lines[0]["evidence"]["log_odds"].as_f64().unwrap() >= 9.0);
    let [x, y] = [0, 1].map(|i| lines[1]["pose"][i].as_f64().unwrap());
    assert!((x - 6.8).abs() < 0.01 && (y - 4.9).abs() < 0.01, "{x} {y}");
    assert_eq!(lines[2]["changes"].as_array().unwrap().len(), 5, "trust in the room and four crates");
    let page = fs::read_to_string(place.path("found/index.html")).unwrap();
    assert!(
        page.contains("crate 2") && page.contains("001-measured.png") && place.path("found/001-after.png").exists()
    );
    let apply = || place.run("env apply map.presight found/changes.jsonl");
    assert_eq!(apply().stdout, "ack 1\nack 2\nack 3\n");
    assert_eq!(apply().status, Some(0));
    let info = store::check(&place.path("map.presight")).unwrap();
    assert_eq!(info.changes, 3, "nothing applies twice");
    assert!(info.environment.object("crate 2").is_none() && info.environment.trust("crate 0").unwrap().p0 > 0.999);
    for change in [3, 2, 1] {
        place.done(&format!("env undo map.presight {change}"));
    }
    assert_eq!(store::check(&place.path("map.presight")).unwrap().environment.content_hash(), first);
}

/// Applied at once, the next drive finds the site as the store has it.
#[test]
fn applied_changes_are_confirmed_by_the_next_drive() {
    let place = site(Some(1), None);
    let done = place.run(&format!("update log/scans.jsonl --map map.presight {POSES} --out found --apply"));
    assert!(done.status == Some(0) && done.stdout.contains("1 gone, 0 moved, 0 new"), "{done:?}");
    let done = place.run(&format!("update log/scans.jsonl --map map.presight {POSES} --out again"));
    assert!(done.stdout.contains("0 gone, 0 moved, 0 new") && done.stdout.contains("6 confirmed"), "{done:?}");
    let stale = place.done("env info map.presight --stale 1d --time 1e9");
    assert!(stale.contains("stale      crate 0: confirmed 1970"), "{stale}");
}

/// Two views do not decide; with the rest of the drive, which comes tomorrow, they do.
#[test]
fn evidence_goes_on_with_another_log() {
    let place = site(Some(2), None);
    let log = fs::read_to_string(place.path("log/scans.jsonl")).unwrap();
    let lines: Vec<&str> = log.lines().collect();
    for (name, from, to) in [("a.jsonl", 1, 5), ("b.jsonl", 5, 9)] {
        place.write(name, format!("{}\n{}\n", lines[0], lines[from..to].join("\n")).as_bytes());
    }
    let learn = |log: &str| {
        let line = format!("update {log} --map map.presight {POSES} --evidence e.json --out found --views 5 --sure 15");
        let done = place.run(&line);
        assert_eq!(done.status, Some(0), "{}", done.stderr);
        done.stdout
    };
    assert!(learn("a.jsonl").contains("0 gone"));
    assert!(learn("b.jsonl").contains("1 gone"));
    // Evidence of another map, and files without evidence.
    store::create(&place.path("other.presight"), &room(Some(0), None), &store::Note::new("test", 0.0)).unwrap();
    place.write("torn.json", b"{\"format\": 1, \"kind\": \"pres");
    place.write("newer.json", b"{\"format\": 2}");
    let line =
        |map: &str, evidence: &str| format!("update a.jsonl --map {map} {POSES} --evidence {evidence} --out found");
    super::check(
        &place,
        vec![
            super::bad(&line("other.presight", "e.json"), 1, &["e.json", "another map"]),
            super::bad(&line("map.presight", "torn.json"), 1, &["torn.json", "not evidence"]),
            super::bad(&line("map.presight", "newer.json"), 1, &["newer.json", "newer"]),
        ],
    );
}

/// The object of a change was moved in the meantime: the line is refused by name, the others apply.
#[test]
fn changes_of_other_content_apply_where_their_objects_are_untouched() {
    let place = site(Some(2), Some(5));
    let done = place.run(&format!("update log/scans.jsonl --map map.presight {POSES} --out found"));
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    place.write("move.jsonl", b"{\"op\":\"move\",\"object\":\"crate 2\",\"pose\":[4,3,0,0,0,0]}\n");
    place.done("env apply map.presight move.jsonl");
    let refused = place.run("env apply map.presight found/changes.jsonl");
    assert!(refused.status == Some(1) && refused.stderr.contains("\"crate 2\" is not where it was"), "{refused:?}");
    let text = fs::read_to_string(place.path("found/changes.jsonl")).unwrap();
    let rest: Vec<&str> = text.lines().skip(1).collect();
    place.write("rest.jsonl", rest.join("\n").as_bytes());
    assert_eq!(place.done("env apply map.presight rest.jsonl"), "ack 1\nack 2\n");
}

/// A mount that is 0.5 m off moves everything: that is said, and nothing is proposed.
#[test]
fn a_wrong_mount_is_no_change_of_the_site() {
    let place = site(None, None);
    place.write("wrong.toml", LIDAR.replace("xyz = [0.0, 0.0, 1.0]", "xyz = [0.4, 0.3, 1.0]").as_bytes());
    let before = fs::read(place.path("map.presight")).unwrap();
    let line = format!("update log/scans.jsonl --map map.presight --sensor wrong.toml {POSES} --out found --apply");
    let done = place.run(&line);
    assert!(changes(&place, "found").is_empty(), "{done:?}");
    assert_eq!(fs::read(place.path("map.presight")).unwrap(), before);
}

#[test]
fn inputs_that_teach_nothing_are_named() {
    let place = site(None, None);
    fs::copy(place.path("wall.glb"), place.path("scene.glb")).unwrap();
    let line = |rest: &str| format!("update log/scans.jsonl --map map.presight --init reference --out found {rest}");
    super::check(
        &place,
        vec![
            super::bad(&line("--sure 0"), 2, &["--sure 0"]),
            super::bad(&line("--most-per-view nan"), 2, &["--most-per-view"]),
            super::bad(&line("--time inf"), 2, &["--time inf"]),
            super::bad(&line("--poses drive.tum --pose-cov 1,2"), 2, &["--pose-cov", "6 are needed"]),
            super::bad(&line("--evidence map.presight"), 2, &["map.presight", "overwrite"]),
            super::bad("update none.jsonl --map map.presight --init unknown --out found", 1, &["none.jsonl"]),
            super::bad(
                &format!("update log/scans.jsonl --map scene.glb {POSES} --out found --apply"),
                2,
                &["--apply", "not a store"],
            ),
        ],
    );
    place.write("late.tum", b"100 0 0 0 0 0 0 1\n");
    let done = place.run("update log/scans.jsonl --map map.presight --init reference --poses late.tum --pose-cov 0,0,0,0,0,0 --out found");
    assert!(done.status == Some(0) && done.stderr.contains("24 frames have no pose"), "{done:?}");
    assert!(changes(&place, "found").is_empty());
}
