//! `presight update`: a site that changed, its proposed changes, and inputs that teach nothing.

use super::Place;
use glam::{DVec3, Vec3};
use presight::Pose;
use presight::environment::{Appearance, Environment, Material, Mesh, NewObject};
use presight::store;
use std::fs;

pub const LIDAR: &str = "format = 1\nkind = \"scanner\"\nclass = \"laser\"\nrange_max = 20\n[azimuth]\nstart_deg = -180\nstep_deg = 2\ncount = 180\n\
    [elevation]\nstart_deg = -20\nstep_deg = 2\ncount = 14\n[noise]\nrange_sigma = 0.01\n[mount]\nxyz = [0.0, 0.0, 1.0]\n";

/// How `update` is given the poses of the drive.
pub const POSES: &str = "--init reference --poses drive.tum --pose-cov 0.005,0.005,0.005,0.1,0.1,0.1";

/// As [`POSES`], and the model is changed.
pub const CHANGE: &str = "--init reference --poses drive.tum --pose-cov 0.005,0.005,0.005,0.1,0.1,0.1 --policy change";

/// A room of 9 x 6 m with six crates along its walls; `without` leaves one out, `moved` moves another by 0.6 m.
pub fn room(without: Option<usize>, moved: Option<usize>) -> Environment {
    crates(without, |k, x| if moved == Some(k) { x + 0.6 } else { x }, None)
}

/// The room, with the x of each crate changed, and one crate of glass: sensors of class radar see through it.
pub fn crates(without: Option<usize>, x_of: impl Fn(usize, f64) -> f64, glass: Option<usize>) -> Environment {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    let mut clear = Material::named("glass");
    clear.appearance.insert("radar".to_owned(), Appearance::Transparent);
    environment.add_material(clear).unwrap();
    let mut add = |name: &str, least: Vec3, size: Vec3, at: DVec3| {
        let material = u16::from(glass.is_some_and(|k| name == format!("crate {k}")));
        let mesh = Mesh::cuboid(name, least, least + size, material).unwrap();
        let pose = Pose { translation: at, ..Pose::IDENTITY };
        environment.insert(NewObject::new(name, pose, mesh.into())).unwrap();
    };
    add("room", Vec3::ZERO, Vec3::new(9.0, 6.0, 2.6), DVec3::ZERO);
    for k in 0..6 {
        let (x, y) = (1.0 + 2.6 * (k / 2) as f64, if k % 2 == 0 { 0.3 } else { 4.9 });
        if without != Some(k) {
            let size = Vec3::new(0.7, 0.6 + 0.05 * k as f32, 0.8 + 0.1 * k as f32);
            add(&format!("crate {k}"), Vec3::ZERO, size, DVec3::new(x_of(k, x), y, 0.0));
        }
    }
    environment
}

/// A place with the store of a room, and the log of a drive through the changed room.
pub fn site(without: Option<usize>, moved: Option<usize>) -> Place {
    site_of(&room(None, None), &room(without, moved))
}

/// A place with the store of a map, and the log of a drive through a site.
pub fn site_of(map: &Environment, site: &Environment) -> Place {
    let place = Place::new();
    store::create(&place.path("map.presight"), map, &store::Note::new("test", 0.0)).unwrap();
    place.write("lidar.toml", LIDAR.as_bytes());
    let line = |k: usize| format!("{} {} {} 0 0 0 0 1\n", k, 1.0 + 0.29 * k as f64, 2.6 + 0.02 * k as f64);
    place.write("drive.tum", (0..24).map(line).collect::<String>().as_bytes());
    drive(&place, site, "log");
    place
}

/// The log of the drive through a site, in a folder.
pub fn drive(place: &Place, site: &Environment, folder: &str) {
    let name = format!("{folder}.presight");
    store::create(&place.path(&name), site, &store::Note::new("test", 0.0)).unwrap();
    let made = place.run(&format!("simulate {name} --sensor lidar.toml --poses drive.tum --out {folder}"));
    assert_eq!(made.status, Some(0), "{}", made.stderr);
}

pub fn changes(place: &Place, folder: &str) -> Vec<serde_json::Value> {
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
    let done = place.run(&format!("update log/scans.jsonl --map map.presight {CHANGE} --out found"));
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
    assert!(page.contains("crate 2") && page.contains("src=\"001.png\"") && place.path("found/001.png").exists());
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
    let done = place.run(&format!("update log/scans.jsonl --map map.presight {CHANGE} --out found --apply"));
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
    let first = learn("a.jsonl");
    assert!(first.contains("0 gone") && first.contains("doubtful: crate 2") && first.contains("look from"), "{first}");
    let doubts = fs::read_to_string(place.path("found/doubts.jsonl")).unwrap();
    let doubt: serde_json::Value = doubts.lines().find(|line| line.contains("crate 2")).unwrap().parse().unwrap();
    assert!(doubt["look_from"]["log_odds"].as_f64().unwrap() >= 9.0, "{doubt}");
    assert!((doubt["look_from"]["pose"][2].as_f64().unwrap() - 1.0).abs() < 0.01, "{doubt}");
    let page = fs::read_to_string(place.path("found/index.html")).unwrap();
    assert!(page.contains("src=\"doubt-001.png\"") && place.path("found/doubt-001.png").exists());
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
            super::bad(line("other.presight", "e.json"), 1, &["e.json", "another map"]),
            super::bad(line("map.presight", "torn.json"), 1, &["torn.json", "not evidence"]),
            super::bad(line("map.presight", "newer.json"), 1, &["newer.json", "newer"]),
        ],
    );
}

/// The object of a change was moved in the meantime: the line is refused by name, the others apply.
#[test]
fn changes_of_other_content_apply_where_their_objects_are_untouched() {
    let place = site(Some(2), Some(5));
    let done = place.run(&format!("update log/scans.jsonl --map map.presight {CHANGE} --out found"));
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
            super::bad(line("--sure 0"), 2, &["--sure 0"]),
            super::bad(line("--most-per-view nan"), 2, &["--most-per-view"]),
            super::bad(line("--time inf"), 2, &["--time inf"]),
            super::bad(line("--policy gone=burn"), 2, &["--policy", "gone=burn", "come-back"]),
            super::bad(line("--poses drive.tum --pose-cov 1,2"), 2, &["--pose-cov", "6 are needed"]),
            super::bad(line("--evidence map.presight"), 2, &["map.presight", "overwrite"]),
            super::bad("update none.jsonl --map map.presight --init unknown --out found", 1, &["none.jsonl"]),
            super::bad(
                format!("update log/scans.jsonl --map scene.glb {POSES} --out found --apply"),
                2,
                &["--apply", "not a store"],
            ),
        ],
    );
    place.write("late.tum", b"100 0 0 0 0 0 0 1\n");
    let done = place.run("update log/scans.jsonl --map map.presight --init reference --poses late.tum --pose-cov 0,0,0,0,0,0 --out found");
    assert!(
        done.status == Some(1) && done.stderr.contains("no frame has a pose of --poses: the nearest are "),
        "{done:?}"
    );
    let without =
        place.run("update log/scans.jsonl --map map.presight --poses late.tum --pose-cov 0,0,0,0,0,0 --out found");
    assert_eq!((without.status, without.stderr), (done.status, done.stderr), "poses from elsewhere need no start");
    let started = place.run("update log/scans.jsonl --map map.presight --out found");
    assert!(started.status == Some(2) && started.stderr.contains("--init is missing"), "{started:?}");
}

/// By default changes are marks: the crate stays in the model, and so does the one that was moved, with a copy of it at its new
/// place, all uncertain. The next drive marks nothing again. Undone, the store is as it was.
#[test]
fn changes_are_marks_by_default_and_once() {
    let place = site(Some(2), Some(5));
    let first = store::check(&place.path("map.presight")).unwrap().environment.content_hash();
    let learn = || place.run(&format!("update log/scans.jsonl --map map.presight {POSES} --out found --apply"));
    let done = learn();
    assert!(done.status == Some(0) && done.stdout.contains("1 gone, 1 moved, 0 new"), "{done:?}");
    let marked = || store::check(&place.path("map.presight")).unwrap();
    let info = marked();
    let marks: Vec<&str> = info.environment.marks().map(|(_, mark)| mark.object.as_str()).collect();
    assert_eq!(marks.len(), 3, "{marks:?}");
    assert!(marks.contains(&"crate 2") && marks.contains(&"crate 5"), "{marks:?}");
    let copy = marks.iter().find(|name| name.starts_with("provisional/")).unwrap();
    let at = info.environment.object(copy).unwrap().world_from_object.translation;
    assert!(at.distance(DVec3::new(6.8, 4.9, 0.0)) < 0.01, "{at}");
    assert_eq!(info.environment.object("crate 2").unwrap().world_from_object.translation, DVec3::new(3.6, 0.3, 0.0));
    learn();
    let again = marked();
    assert_eq!(again.environment.marks().count(), 3);
    for change in (1..=again.changes).rev() {
        place.done(&format!("env undo map.presight {change}"));
    }
    assert_eq!(marked().environment.content_hash(), first);
}

/// The paper's four: stop with the pose to look from, come back by a list that survives, mark and ignore.
#[test]
fn a_policy_stops_comes_back_or_ignores() {
    let place = site(Some(2), Some(5));
    let learn = |policy: &str| {
        place.run(&format!("update log/scans.jsonl --map map.presight {POSES} --out found --policy {policy}"))
    };
    let done = learn("gone=stop,moved=come-back");
    assert_eq!(done.status, Some(1), "{done:?}");
    assert!(done.stderr.contains("stop: gone: crate 2") && done.stderr.contains("; look from"), "{done:?}");
    let doubts = fs::read_to_string(place.path("found/doubts.jsonl")).unwrap();
    assert!(doubts.contains("gone: crate 2") && doubts.contains("\"look_from\""), "{doubts}");
    let list = || fs::read_to_string(place.path("found/come_back.jsonl")).unwrap();
    assert!(list().contains("moved: crate 5") && list().contains("look from"), "{}", list());
    let ops =
        |folder: &str| changes(&place, folder).iter().map(|c| c["op"].as_str().unwrap().to_owned()).collect::<Vec<_>>();
    assert_eq!(ops("found"), ["group"], "only the trust in what stands");
    // The list survives a run that adds nothing to it, and is not repeated.
    assert_eq!(learn("ignore").status, Some(0));
    assert_eq!(ops("found"), ["group"]);
    learn("gone=ignore,moved=come-back");
    assert_eq!(list().lines().count(), 1, "{}", list());
}
