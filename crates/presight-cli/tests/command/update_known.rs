//! `presight update` with new things of known shapes: a library of meshes, and a program that names things.

use super::update::{POSES, changes, room, site_of};
use super::{Outcome, Place, bad, check};
use glam::{DVec3, Vec3};
use presight::Pose;
use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight::files::write_glb;
use presight::store;
use std::fs;
use std::time::{Duration, Instant};

/// A ramp: its back is upright, its top falls to the front. `scale` 1: 1.2 x 0.8 x 0.8 m.
fn ramp(length: f32, scale: f32) -> Mesh {
    let (x, y, z) = (length * scale, 0.8 * scale, 0.8 * scale);
    let corner = |x, y, z| Vec3::new(x, y, z);
    let vertices = vec![
        corner(0.0, 0.0, 0.0),
        corner(x, 0.0, 0.0),
        corner(x, y, 0.0),
        corner(0.0, y, 0.0),
        corner(0.0, 0.0, z),
        corner(0.0, y, z),
    ];
    let faces = [vec![0, 3, 2, 1], vec![0, 4, 5, 3], vec![4, 1, 2, 5], vec![0, 1, 4], vec![3, 5, 2]];
    let polygons = faces.into_iter().map(|corners| Polygon::new(corners, 0)).collect();
    Mesh::new("ramp", vertices, polygons, PolygonOrder::Given).unwrap()
}

fn alone(name: &str, mesh: Mesh) -> Environment {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    environment.insert(NewObject::new(name, Pose::IDENTITY, mesh.into())).unwrap();
    environment
}

/// Where the ramp stands: turned by 115 degrees.
fn stands() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(4.6, 0.9, 0.0), 0.0, 0.0, 115f64.to_radians())
}

/// A place with the map of a room, and the log of a drive through it with a ramp.
fn with_ramp() -> Place {
    with_ramp_in(room(None, None))
}

fn with_ramp_in(mut site: Environment) -> Place {
    site.insert(NewObject::new("ramp", stands(), ramp(1.2, 1.0).into())).unwrap();
    let place = site_of(&room(None, None), &site);
    fs::create_dir(place.path("library")).unwrap();
    place
}

fn put(place: &Place, name: &str, mesh: Mesh) {
    write_glb(&place.path(&format!("library/{name}.glb")), &alone(name, mesh)).unwrap();
}

fn learn(place: &Place, rest: &[&str]) -> Outcome {
    let line = format!("update log/scans.jsonl --map map.presight {POSES} --out found");
    let args: Vec<&str> = line.split(' ').chain(rest.iter().copied()).collect();
    let mut done = place.run_args(&args);
    // The notice on readings is not under test here.
    done.stderr =
        done.stderr.split_inclusive('\n').filter(|line| !line.contains(" readings, presight takes ")).collect();
    done
}

/// The ramp of the library takes the place of the boxes, where it stands; a longer one, which is seen through, does not, and a
/// crate explains no more than boxes do. The line inserts the mesh of the file; applied, it is found where it stands.
#[test]
fn a_mesh_of_the_library_takes_the_place_of_boxes() {
    let place = with_ramp();
    let boxes = learn(&place, &[]);
    assert!(boxes.stdout.contains("0 gone, 0 moved, ") && boxes.stdout.contains("\nnew: "), "{boxes:?}");
    put(&place, "long", ramp(2.4, 1.0));
    put(&place, "crate", Mesh::cuboid("crate", Vec3::ZERO, Vec3::new(1.2, 0.8, 0.8), 0).unwrap());
    let wrong = learn(&place, &["--library", "library"]);
    assert_eq!((wrong.status, &wrong.stdout), (Some(0), &boxes.stdout), "{wrong:?}");
    put(&place, "ramp", ramp(1.2, 1.0));
    for policy in ["mark", "change"] {
        let done = learn(&place, &["--library", "library", "--policy", policy]);
        assert!(done.status == Some(0) && done.stderr.is_empty(), "{done:?}");
        assert!(done.stdout.contains("0 gone, 0 moved, 1 new") && done.stdout.contains("new: ramp at "), "{done:?}");
        let line = &changes(&place, "found")[0];
        let insert = if policy == "mark" { &line["changes"][0] } else { line };
        assert!(insert["op"] == "insert_object" && insert["from_object"] == "ramp", "{line}");
    }
    place.done("env apply map.presight found/changes.jsonl");
    let environment = store::check(&place.path("map.presight")).unwrap().environment;
    let found = environment.objects().last().unwrap();
    assert!(found.name.starts_with("provisional/") && found.mesh.polygon_count() == 5, "{}", found.name);
    let off = stands().inverse() * found.world_from_object;
    assert!(off.translation.length() < 0.02 && off.rotation.angle_between(glam::DQuat::IDENTITY) < 0.02, "{off:?}");
    let again = learn(&place, &[]);
    assert!(again.stdout.contains("0 gone, 0 moved, 0 new"), "{again:?}");
}

/// A program gets the points of the ramp as PLY. A thing that it names at about the right place is fitted and proposed; elsewhere, or as
/// something else, it is not.
#[cfg(unix)]
#[test]
fn a_program_names_what_evidence_confirms() {
    let place = with_ramp();
    put(&place, "ramp", ramp(1.2, 1.0));
    // The library alone would find it; from an empty one only the program's names count.
    fs::rename(place.path("library"), place.path("hidden")).unwrap();
    let mut map = room(None, None);
    map.insert(NewObject::new(
        "store/ramp",
        Pose::from_xyz_rpy(DVec3::new(40.0, 0.0, 0.0), 0.0, 0.0, 0.0),
        ramp(1.2, 1.0).into(),
    ))
    .unwrap();
    fs::remove_file(place.path("map.presight")).unwrap();
    store::create(&place.path("map.presight"), &map, &store::Note::new("test", 0.0)).unwrap();
    let says = |object: &str, pose: &str| {
        let script = format!("cat > points.ply\necho '{{\"object\": \"{object}\", \"pose\": {pose}}}'\n");
        place.write("name.sh", script.as_bytes());
        learn(&place, &["--recognizer", "sh name.sh"])
    };
    let done = says("store/ramp", "[4.7, 1.0, 0.05, 0, 0, 125]");
    assert!(done.status == Some(0) && done.stderr.is_empty(), "{done:?}");
    assert!(done.stdout.contains("1 new") && done.stdout.contains("new: store/ramp at "), "{done:?}");
    // It may slide some centimetres along its slope: only small faces hold it there.
    let place_and_yaw = done.stdout.split("store/ramp at ").nth(1).unwrap().split([',', ' ']);
    let found: Vec<f64> = place_and_yaw.filter_map(|word| word.parse().ok()).take(4).collect();
    let off = (DVec3::from_slice(&found) - DVec3::new(4.6, 0.9, 0.0)).length();
    assert!(off < 0.05 && (found[3] - 115.0).abs() < 0.5, "{done:?}");
    let insert = changes(&place, "found")[0]["changes"][0].clone();
    assert_eq!(insert["like"], "store/ramp", "{insert}");
    let cloud = presight::files::read_cloud(&place.path("points.ply")).unwrap();
    assert!(cloud.points.len() > 100, "{}", cloud.points.len());
    assert!(cloud.points.iter().all(|p| p.distance(DVec3::new(4.0, 1.3, 0.4)) < 1.2), "world frame");
    for (object, pose) in [
        ("store/ramp", "[4.7, 4.0, 0, 0, 0, 125]"),
        ("crate 0", "[4.3, 1.0, 0, 0, 0, 1, 0]"),
        ("store/ramp", "[4.7, 1.0, 0, 0, 0, 250]"),
    ] {
        let done = says(object, pose);
        assert!(done.status == Some(0) && done.stdout.contains("\nnew: ") && !done.stdout.contains(object), "{done:?}");
    }
}

/// A program that answers nonsense, late, never or too much, fails or is missing: one line says so with a remedy, the boxes stay,
/// and it is not asked again.
#[cfg(unix)]
#[test]
fn a_recognizer_that_fails_costs_nothing_but_its_answer() {
    // Two new things are two questions.
    let mut site = room(None, None);
    let block = Mesh::cuboid("block", Vec3::ZERO, Vec3::new(0.6, 0.5, 0.7), 0).unwrap();
    let pose = Pose { translation: DVec3::new(7.6, 1.2, 0.0), ..Pose::IDENTITY };
    site.insert(NewObject::new("block", pose, block.into())).unwrap();
    let place = with_ramp_in(site);
    let boxes = learn(&place, &[]).stdout;
    place.write("none.sh", b"echo asked >> count\n");
    assert_eq!(learn(&place, &["--recognizer", "sh none.sh"]).stdout, boxes);
    assert_eq!(fs::read_to_string(place.path("count")).unwrap().lines().count(), 2);
    for (script, words) in [
        ("echo ramp", "line 1 of its answer is not a valid proposal"),
        ("echo '{\"object\": \"ramp\"}'", "missing field `pose`"),
        ("echo '{\"object\": \"crate 0\", \"pose\": [1, 2]}'", "the pose has 2 numbers"),
        ("echo '{\"object\": \"crate 0\", \"pose\": [0, 0, 1e300, 0, 0, 0]}'", "not a valid proposal"),
        (
            "echo '{\"object\": \"sofa\", \"pose\": [0, 0, 0, 0, 0, 0]}'",
            "\"sofa\", which is neither in the library nor in the map",
        ),
        ("printf '\\377'", "not UTF-8"),
        ("exit 3", "exit status: 3"),
        ("exec sleep 600", "no answer within 300 ms; give it more time with --recognizer-ms"),
        ("exec >&-; exec sleep 600", "no answer within 300 ms"),
        ("exec yes", "longer than 1048576 bytes"),
    ] {
        place.write("bad.sh", format!("echo asked >> count\n{script}\n").as_bytes());
        let _ = fs::remove_file(place.path("count"));
        let started = Instant::now();
        let done = learn(&place, &["--recognizer", "sh bad.sh", "--recognizer-ms", "300"]);
        assert!(done.status == Some(0) && done.stdout == boxes, "{script}: {done:?}");
        assert!(done.stderr.contains(words) && done.stderr.lines().count() == 1, "{script}: {done:?}");
        assert_eq!(fs::read_to_string(place.path("count")).unwrap().lines().count(), 1, "{script}");
        assert!(started.elapsed() < Duration::from_secs(60), "{script}");
    }
    let done = learn(&place, &["--recognizer", "./none"]);
    assert!(done.status == Some(0) && done.stdout == boxes && done.stderr.contains("./none"), "{done:?}");
    let line = |rest: &str| format!("update log/scans.jsonl --map map.presight {POSES} --out found {rest}");
    check(
        &place,
        vec![
            bad(line("--recognizer-ms 5"), 2, &["--recognizer"]),
            bad(line("--recognizer true --recognizer-ms 0"), 2, &["--recognizer-ms 0"]),
            bad(line("--recognizer true --recognizer-ms nan"), 2, &["--recognizer-ms"]),
        ],
    );
}

/// Libraries in millimetres, without a mesh, or with a broken one are refused before the drive is read; the remedy works. Meshes in
/// other formats and things that are too small are named.
#[test]
fn a_library_that_cannot_serve_is_refused() {
    let place = with_ramp();
    let line = |log: &str| format!("update {log} --map map.presight {POSES} --out found --library library");
    let none = "none.jsonl";
    check(&place, vec![bad(line(none), 1, &["library", "0 files are .glb or .gltf"])]);
    put(&place, "ramp", ramp(1.2, 1000.0));
    let in_mm = ["ramp.glb", "1200.000 x 800.000 x 800.000 m", "scale = 0.001 into ramp.materials.toml"];
    check(&place, vec![bad(line(none), 1, &in_mm)]);
    place.write("library/ramp.materials.toml", b"format = 1\nscale = 0.001\n");
    place.write("library/sofa.stl", b"solid\n");
    let mm = ramp(1.2, 0.01);
    write_glb(&place.path("library/screw.glb"), &alone("screw", mm)).unwrap();
    let done = learn(&place, &["--library", "library"]);
    assert!(done.status == Some(0) && done.stdout.contains("new: ramp at "), "{done:?}");
    let pose = &changes(&place, "found")[0]["changes"][0]["pose"];
    let at = DVec3::from_array([0, 1, 2].map(|k| pose[k].as_f64().unwrap()));
    assert!(at.distance(stands().translation) < 0.02, "{at}");
    assert!(done.stderr.contains("screw is 0.012 x 0.008 x 0.008 m, too small"), "{done:?}");
    assert!(done.stderr.contains("sofa.stl are left out: convert"), "{done:?}");
    place.write("library/broken.glb", b"glTF");
    check(&place, vec![bad(line(none), 1, &["broken.glb"])]);
    fs::remove_dir_all(place.path("library")).unwrap();
    check(&place, vec![bad(line(none), 1, &["library", "read the folder"])]);
    place.write("library", b"");
    check(&place, vec![bad(line(none), 1, &["library", "Not a directory"])]);
}
