//! `presight simulate`, `localize` and `replay`: a drive is simulated, localized, compared with the truth, and drawn.

use super::Place;
use presight::files;
use std::fs;

const CAMERA: &str = "format = 1\nkind = \"camera\"\nclass = \"laser\"\nwidth = 80\nheight = 60\nfx = 70.0\nfy = 70.0\ncx = 39.5\n\
    cy = 29.5\nrange_max = 10.0\n[noise]\nrange_sigma = 0.005\n[mount]\nxyz = [0.1, 0.0, 0.3]\nrpy_deg = [0.0, 12.0, 0.0]\n";

/// A place with a room and the log of a drive of 8 frames through it.
fn drive() -> Place {
    drive_of(8)
}

fn drive_of(frames: usize) -> Place {
    let place = Place::new();
    let room = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb");
    fs::copy(room, place.path("room.glb")).unwrap();
    place.write("camera.toml", CAMERA.as_bytes());
    let line = |k: usize| {
        let (x, half) = (0.3 + 0.02 * k as f64, 0.5 * (0.66 + 0.01 * k as f64));
        format!("{} {x} 0.35 1.35 0 0 {} {}\n", 10 + k, half.sin(), half.cos())
    };
    place.write("drive.tum", (0..frames).map(line).collect::<String>().as_bytes());
    let made = place.run("simulate room.glb --sensor camera.toml --poses drive.tum --out log");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    place
}

#[test]
fn a_simulated_drive_is_localized() {
    let place = drive();
    let line = "localize log --map room.glb --sensor log/sensor.toml --init reference --out run.tum";
    let done = place.run(line);
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    assert!(done.stdout.contains("8 of 8 frames have a pose"), "{}", done.stdout);
    assert!(done.stdout.contains("against the log's own poses"), "{}", done.stdout);
    let (found, truth) =
        (files::read_tum(&place.path("run.tum")).unwrap(), files::read_tum(&place.path("drive.tum")).unwrap());
    assert_eq!(found.len(), truth.len());
    for (f, t) in found.iter().zip(&truth) {
        assert_eq!(f.time, t.time);
        assert!(f.pose.translation.distance(t.pose.translation) < 0.01, "{f:?} {t:?}");
        assert!(f.pose.rotation.angle_between(t.pose.rotation) < 0.01, "{f:?} {t:?}");
    }
    let details = fs::read_to_string(place.path("run.jsonl")).unwrap();
    let last: serde_json::Value = serde_json::from_str(details.lines().last().unwrap()).unwrap();
    assert_eq!(last["state"], "tracking");
    // The map is exact.
    let learnt = last["model_sigma"].as_f64().unwrap();
    let told = format!("surfaces of the map count as off by {learnt:.3} m");
    assert!(learnt < 0.003 && done.stdout.contains(&told), "{learnt} {}", done.stdout);
    assert!(last["help"].is_null(), "{last}");
    assert!(last["covariance"][0][0].as_f64().unwrap() > 0.0 && last["verdicts"]["confirmed"].as_u64().unwrap() > 2000);
}

/// A camera has six numbers, unless the options of a level scanner are chosen: then its height keeps no variance.
#[test]
fn a_preset_chooses_the_options() {
    let place = drive_of(1);
    for (preset, is_free) in [("", true), ("--preset depth_camera", true), ("--preset indoor_scanner", false)] {
        let done = place.run(&format!("localize log --map room.glb --init reference {preset} --out run.tum"));
        assert_eq!(done.status, Some(0), "{}", done.stderr);
        let details = fs::read_to_string(place.path("run.jsonl")).unwrap();
        let step: serde_json::Value = serde_json::from_str(details.lines().next().unwrap()).unwrap();
        assert_eq!(step["covariance"][2][2].as_f64().unwrap() > 1e-12, is_free, "{preset}: {step}");
    }
}

/// Images are named by their time in microseconds, so two poses within one would overwrite each other's image.
#[test]
fn poses_with_images_of_one_name_are_refused() {
    let place = Place::new();
    place.write("camera.toml", CAMERA.as_bytes());
    place.write("twice.tum", b"1.0000001 0 0 1 0 0 0 1\n2 0 0 1 0 0 0 1\n1.0000002 0 0 1 0 0 0 1\n");
    let line = "simulate wall.glb --sensor camera.toml --poses twice.tum --out log";
    super::check(
        &place,
        vec![super::bad(line, 1, &["twice.tum", "1.0000001 s and 1.0000002 s", "00000000001.000000.png"])],
    );
}

/// Every value is checked before a file is opened, whatever the start. With the value that the remedy names, the log is
/// localized.
#[test]
fn invalid_flags_of_a_search_are_named_first() {
    let place = drive_of(1);
    for (flag, value, remedy, right) in [
        ("--lean", "1", "; give roll and pitch in degrees, as in --lean 0,20", "0,20"),
        ("--lean", "1,2,3", "; give roll and pitch in degrees, as in --lean 0,20", "0,20"),
        ("--lean", "nan,0", "; give finite degrees", "1,0"),
        ("--lean", "0,inf", "; give finite degrees", "0,1"),
        ("--floor", "nan", "; give finite metres", "1"),
        ("--floor-to", "inf", "; give finite metres", "1"),
        ("--margin", "-1", "; give finite metres of at least 0", "0"),
        ("--surrounded", "1.5", "; give a share of 0 to 1", "1"),
        ("--init-sigma", "0", "; give a finite deviation above 0", "0.1"),
        ("--init-sigma-deg", "nan", "; give a finite deviation above 0", "0.1"),
        ("--init-odds", "1", "; give finite odds above 1, such as 10000", "10000"),
        ("--model-sigma", "-1", "; give finite metres of at least 0", "0"),
        ("--odometry-sigma", "-1", "; give a finite fraction of at least 0", "0"),
    ] {
        for init in ["unknown", "reference", "0,0,0,0,0,0"] {
            let line = format!("localize none --map none.glb --init {init} {flag} {value} --out x.tum");
            super::check(&place, vec![super::bad(line, 2, &[flag])]);
        }
        let line = format!("localize log --map room.glb --init reference --out x.tum {flag} {value}");
        super::check(&place, vec![super::bad(line, 2, &[flag]).until(value, right, remedy)]);
    }
}

#[test]
fn a_search_where_nothing_is_free_names_flags_that_help() {
    let place = drive_of(1);
    for (change, to) in [("--floor 50", "--floor 1.35"), ("unknown", "0.3,0.35,1.35,0,0,37.8")] {
        let line = "localize log --map room.glb --sensor log/sensor.toml --init unknown --floor 50 --out x.tum";
        let remedy = "; give another --floor, a larger --margin or a pose to start from";
        let bad = super::bad(line, 2, &["no free place at 50.3 m"]).after_a_notice();
        super::check(&place, vec![bad.until(change, to, remedy)]);
    }
}

/// The log has people and moved objects that the model lacks. The same seed gives the same ones.
#[test]
fn simulated_scenes_differ_from_their_model() {
    let place = drive();
    let image = |folder: &str| {
        let depth = place.path(folder).join("depth");
        let first = fs::read_dir(depth).unwrap().map(|e| e.unwrap().path()).min().unwrap();
        fs::read(first).unwrap()
    };
    let run = |args: &str| place.run(&format!("simulate room.glb --sensor camera.toml --poses drive.tum {args}"));
    for (args, folder) in [
        ("--displace 0.02", "displaced"),
        ("--displace 0.02", "again"),
        ("--walkers 30 --height 1.35", "walked"),
        ("--seed 2", "other"),
    ] {
        let done = run(&format!("{args} --out {folder}"));
        assert_eq!(done.status, Some(0), "{args}: {}", done.stderr);
    }
    assert_eq!(image("displaced"), image("again"));
    for folder in ["displaced", "walked", "other"] {
        assert_ne!(image("log"), image(folder), "{folder}");
    }
    for args in ["--displace -1", "--displace nan", "--walkers 100000", "--walkers 1 --height inf"] {
        let refused = run(&format!("{args} --out none"));
        assert!(refused.status == Some(2) && !place.path("none").exists(), "{args}: {refused:?}");
    }
}

#[test]
fn errors_in_a_log_are_named() {
    let place = drive();
    let run = |log: &str, init: &str| place.run(&format!("localize {log} --map room.glb --init {init} --out x.tum"));
    let refused = |log: &str, init: &str, status: i32, told: &str| {
        let done = run(log, init);
        assert!(done.status == Some(status) && done.stderr.contains(told), "{done:?}");
        assert!(!place.path("x.tum").exists());
    };
    refused("nowhere", "0,0,1,0,0,0", 1, "nowhere");
    refused("log", "0,0,nan,0,0,0", 2, "--init");
    for flag in ["--init-sigma=-1", "--init-sigma-deg=0", "--from=NaN"] {
        let (name, _) = flag.split_once('=').unwrap();
        refused("log", &format!("0,0,1,0,0,0 {flag}"), 2, name);
    }
    fs::remove_file(place.path("log/poses.txt")).unwrap();
    refused("log", "reference", 2, "no poses");
    let first = fs::read_dir(place.path("log/depth")).unwrap().map(|e| e.unwrap().path()).min().unwrap();
    let bytes = fs::read(&first).unwrap();
    fs::write(&first, &bytes[..bytes.len() / 2]).unwrap();
    let name = first.file_name().unwrap().to_str().unwrap().to_owned();
    refused("log", "0.3,0.35,1.35,0,0,38", 1, &name);
}

/// `replay` writes a picture for each frame and a page with all of them. Features come with regions of interest.
#[cfg(feature = "report")]
#[test]
fn a_drive_is_drawn() {
    let place = drive();
    let line = "replay log --map room.glb --sensor log/sensor.toml --init reference";
    let done = place.run(&format!("{line} --out shown"));
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    assert!(done.stdout.contains("8 of 8 frames have a pose"), "{}", done.stdout);
    let html = fs::read_to_string(place.path("shown/index.html")).unwrap();
    let data = html.split("type=\"application/json\">").nth(1).unwrap().split("</script>").next().unwrap();
    let leaves: Vec<serde_json::Value> = serde_json::from_str(data).unwrap();
    assert_eq!(leaves.len(), 8);
    for leaf in &leaves {
        let picture = place.path("shown").join(leaf["picture"].as_str().unwrap());
        let (w, h) = image::image_dimensions(picture).unwrap();
        assert!(w > 3 * h / 2, "three panels side by side: {w} x {h}");
        assert!(leaf["off"][0].as_f64().unwrap() < 0.01 && leaf["nees"].as_f64().unwrap() < 6.0, "{leaf}");
    }
    assert_eq!(leaves[7]["state"], "tracking");
    // The map is exact, and the page shows the deviation learnt from it.
    assert!(
        leaves[7]["model_sigma"].as_f64().unwrap() < 0.003 && html.contains("standard deviation of the map's surfaces")
    );
    // Features are drawn only on request.
    let made = place.run("features room.glb --class laser --out edges.layer.json");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    let done = place.run(&format!("{line} --layer edges.layer.json --out with"));
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    let bytes = |folder: &str| fs::read(place.path(folder).join("frames/000007.png")).unwrap();
    assert_ne!(bytes("shown"), bytes("with"));
    let late = place.run("replay log --map room.glb --init 0.3,0.35,1.35,0,0,38 --from 99 --out x");
    assert!(late.status == Some(1) && late.stderr.contains("no frame"), "{late:?}");
    for (args, told) in [
        ("--own-features --out x", "has none for class"),
        ("--reference-sigma nan --out x", "--reference-sigma"),
        ("--layer x/index.html --out x", "overwrite"),
    ] {
        let refused = place.run(&format!("{line} {args}"));
        assert!(refused.status.is_some_and(|s| s > 0) && refused.stderr.contains(told), "{args}: {refused:?}");
    }
}

/// A scan, as points or as a range image, is a log of one frame. World-frame points include the sensor position.
#[test]
fn scans_of_points_are_logs() {
    let place = drive();
    let scanner = "format = 1\nkind = \"scanner\"\nrange_max = 10.0\n[azimuth]\nstart_deg = -180.0\nstep_deg = 3.0\ncount = 120\n\
        [elevation]\nstart_deg = -40.0\nstep_deg = 2.0\ncount = 41\n[noise]\nrange_sigma = 0.005\n";
    place.write("scanner.toml", scanner.as_bytes());
    let pose = "0.3,0.35,1.35,0,0,40";
    for (file, how) in [
        ("scan.ply", "--points scan.ply"),
        ("world.ply", "--points world.ply --points-frame world"),
        ("scan.pcd", "--points scan.pcd"),
        ("scan.exr", "--out scan.exr"),
    ] {
        let made = place.run(&format!("predict room.glb --sensor scanner.toml --pose {pose} {how}"));
        assert_eq!(made.status, Some(0), "{}", made.stderr);
        for init in ["reference", "0.33,0.33,1.34,0,0,41"] {
            let line = format!("localize {file} --map room.glb --init {init} --out run.tum");
            let done = place.run(&line);
            assert_eq!(done.status, Some(0), "{file}: {}", done.stderr);
            assert!(done.stdout.contains("1 of 1 frames have a pose"), "{file}: {}", done.stdout);
            let found = files::read_tum(&place.path("run.tum")).unwrap()[0].pose;
            let off = found.translation.distance(glam::DVec3::new(0.3, 0.35, 1.35));
            assert!(off < 0.01, "{file}, {init}: {off} m");
        }
    }
    #[cfg(feature = "report")]
    {
        let done = place.run("replay scan.ply --map room.glb --init reference --out shown");
        assert_eq!(done.status, Some(0), "{}", done.stderr);
        assert!(place.path("shown/frames/000000.png").exists());
    }
    place.write("cut.ply", &fs::read(place.path("scan.ply")).unwrap()[..2000]);
    let cut = place.run("localize cut.ply --map room.glb --init reference --out x.tum");
    assert_eq!(cut.status, Some(1), "{}", cut.stderr);
    assert!(cut.stderr.contains("cut.ply") && cut.stderr.contains("the file is truncated"), "{}", cut.stderr);
}

/// A build with AprilTag searches grey images for the layer's fiducials. Other builds skip them and report that, as
/// does a library that lacks their dictionary.
#[test]
fn fiducials_of_a_layer_are_searched_for() {
    use presight::Pose;
    use presight::environment::{Environment, Material};
    use presight::files;
    let place = Place::new();
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    let room = presight::environment::Mesh::cuboid("room", [0.0; 3].into(), [6.0, 4.0, 2.6].into(), 0).unwrap();
    environment
        .insert(presight::environment::NewObject::new("room", Pose::IDENTITY, std::sync::Arc::new(room)))
        .unwrap();
    // The fiducials face the robot, which looks along x.
    let facing = glam::DQuat::from_mat3(&glam::DMat3::from_cols_array(&[0., -1., 0., 0., 0., 1., -1., 0., 0.]));
    let tags = [(0, [5.9, 1.2, 1.9]), (1, [5.9, 2.0, 1.1]), (2, [5.9, 2.9, 1.8]), (3, [4.4, 2.4, 0.7])];
    let feature = |(tag, at): (usize, [f64; 3])| {
        let pose = Pose { translation: at.into(), rotation: facing };
        let corners = presight_testkit::tags::add_tag(&mut environment, &format!("board {tag}"), tag, &pose, 0.3);
        let corners: Vec<[f64; 3]> = corners.iter().map(|c| c.to_array()).collect();
        let properties = serde_json::json!({ "family": "DICT_APRILTAG_36h11", "code": tag });
        serde_json::json!({ "id": tag + 1, "kind": "fiducial", "points": corners, "properties": properties })
    };
    let features: Vec<serde_json::Value> = tags.into_iter().map(feature).collect();
    let layer =
        serde_json::json!({ "format": 1, "class": "video", "tolerance": 0.001, "features": features }).to_string();
    place.write("tags.json", layer.as_bytes());
    place.write("other.json", layer.replace("APRILTAG_36h11", "4X4_50").as_bytes());
    files::write_glb(&place.path("tags.glb"), &environment).unwrap();
    place.write("camera.toml", CAMERA.as_bytes());
    let video = CAMERA.replace("laser", "video").replace("60", "240").replace("80", "320").replace("70.0", "280.0");
    place
        .write("video.toml", video.replace("39.5", "159.5").replace("29.5", "119.5").replace("12.0", "0.0").as_bytes());
    let drive: String = (0..3).map(|k| format!("{k} {} 2 1.2 0 0 0 1\n", 1.5 + 0.02 * f64::from(k))).collect();
    place.write("drive.tum", drive.as_bytes());
    let made = place.run("simulate tags.glb --sensor camera.toml --grey video.toml --poses drive.tum --out log");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    let run = |layer: &str| {
        let line = format!(
            "localize log --map tags.glb --sensor log/sensor.toml --layer {layer} --init reference --out run.tum"
        );
        let done = place.run(&line);
        assert!(done.status == Some(0) && done.stdout.contains("3 of 3 frames have a pose"), "{done:?}");
        let text = fs::read_to_string(place.path("run.jsonl")).unwrap();
        let last: serde_json::Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
        (last["features"]["matched"].as_u64(), done.stderr)
    };
    let (matched, told) = run("tags.json");
    if cfg!(feature = "fiducials") {
        assert!(matched == Some(4) && !told.contains("not searched for"), "{matched:?} {told}");
    } else {
        assert!(
            matched == Some(0) && told.contains("4 fiducials of the layer are not searched for"),
            "{matched:?} {told}"
        );
    }
    let (matched, told) = run("other.json");
    assert!(matched == Some(0) && told.contains("4 fiducials of the layer are not searched for"), "{matched:?} {told}");
}

/// Grey images with depth images, and alone: the layer's features are searched for, classified, reported and drawn.
#[test]
fn grey_images_are_localized_and_drawn() {
    let place = drive();
    let video = CAMERA.replace("laser", "video").replace("60", "120").replace("80", "160").replace("70.0", "140.0");
    let video = video.replace("39.5", "79.5").replace("29.5", "59.5");
    place.write("video.toml", video.as_bytes());
    let made = place.run("features room.glb --class video --out edges.json");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    let drive = fs::read_to_string(place.path("drive.tum")).unwrap();
    let short: String = drive.lines().take(3).map(|line| format!("{line}\n")).collect();
    place.write("short.tum", short.as_bytes());
    let made = place.run("simulate room.glb --sensor camera.toml --grey video.toml --poses short.tum --out both");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    assert_eq!(fs::read_dir(place.path("both/grey")).unwrap().count(), 3);
    let line =
        "localize both --map room.glb --sensor both/sensor.toml --layer edges.json --init reference --out both.tum";
    let done = place.run(line);
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    assert!(done.stdout.contains("3 of 3 frames have a pose"), "{}", done.stdout);
    let matched = |details: &str| {
        let text = fs::read_to_string(place.path(details)).unwrap();
        let last: serde_json::Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
        (last["features"]["matched"].as_u64(), last["verdicts"]["confirmed"].as_u64())
    };
    let (features, confirmed) = matched("both.jsonl");
    assert!(features.unwrap() >= 4 && confirmed.unwrap() > 2000, "{features:?} {confirmed:?}");
    // The grey images alone, with the camera that the log describes.
    fs::rename(place.path("both/depth"), place.path("depth")).unwrap();
    let alone = "localize both --map room.glb --sensor both/sensor.toml --init reference --out x.tum";
    let camera = place.run(alone);
    assert!(camera.status != Some(0), "the images are not of the depth camera's size: {camera:?}");
    let text = fs::read_to_string(place.path("both/camera.json")).unwrap();
    let text = text.replace(":60", ":120").replace(":80", ":160").replace(":70.0", ":140.0");
    place.write("both/camera.json", text.replace(":39.5", ":79.5").replace(":29.5", ":59.5").as_bytes());
    let alone = "localize both --map room.glb --sensor both/grey.toml --init reference --out alone.tum";
    let without = place.run(alone);
    assert!(without.status == Some(2) && without.stderr.contains("layer"), "{without:?}");
    let done = place.run(&format!("{alone} --layer edges.json"));
    assert!(done.status == Some(0) && done.stdout.contains("3 of 3 frames have a pose"), "{done:?}");
    let (found, truth) =
        (files::read_tum(&place.path("alone.tum")).unwrap(), files::read_tum(&place.path("short.tum")).unwrap());
    for (f, t) in found.iter().zip(&truth) {
        // The largest error in development was 1.2 cm.
        assert!(f.pose.translation.distance(t.pose.translation) < 0.02, "{f:?} {t:?}");
    }
    let (features, confirmed) = matched("alone.jsonl");
    assert!(features.is_some() && confirmed == Some(0), "there are no ranges: {features:?} {confirmed:?}");
    #[cfg(feature = "report")]
    {
        let line = "replay both --map room.glb --sensor both/grey.toml --init reference --layer edges.json --out shown";
        let shown = place.run(line);
        assert_eq!(shown.status, Some(0), "{}", shown.stderr);
        assert_eq!(fs::read_dir(place.path("shown/frames")).unwrap().count(), 3);
        assert!(fs::read_to_string(place.path("shown/index.html")).unwrap().contains("only_found"));
    }
}

/// A run that is cut in the middle of a line goes on behind the frames that are complete, by the same command, and has all frames in
/// the end, each once. With another flag it starts from the first.
#[test]
fn an_interrupted_run_goes_on() {
    let place = drive();
    let line = "localize log --map room.glb --sensor log/sensor.toml --init reference --out run.tum";
    // An image that cannot be read ends the run after five frames.
    let image = fs::read_dir(place.path("log/depth")).unwrap().map(|e| e.unwrap().path()).max().unwrap();
    let whole = fs::read(&image).unwrap();
    fs::write(&image, b"no image").unwrap();
    assert_eq!(place.run(line).status, Some(1));
    assert!(place.path("run.resume").exists());
    let times =
        |name: &str| -> Vec<f64> { files::read_tum(&place.path(name)).unwrap().iter().map(|p| p.time).collect() };
    assert_eq!(times("run.tum"), (10..17).map(f64::from).collect::<Vec<_>>());
    // The end of a run that was killed: half a line.
    let cut = |name: &str| {
        let text = fs::read_to_string(place.path(name)).unwrap();
        fs::write(place.path(name), &text[..text.len() - 30]).unwrap();
    };
    cut("run.tum");
    cut("run.jsonl");
    fs::write(&image, &whole).unwrap();
    let done = place.run(line);
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    assert!(done.stderr.contains("continuing after the frame at 15 s"), "{}", done.stderr);
    assert_eq!(times("run.tum"), (10..18).map(f64::from).collect::<Vec<_>>());
    assert_eq!(fs::read_to_string(place.path("run.jsonl")).unwrap().lines().count(), 8);
    assert!(!place.path("run.resume").exists());
    let again = place.run(line);
    assert!(!again.stderr.contains("continuing") && again.stdout.contains("8 of 8 frames"), "{}", again.stderr);
}

/// By hand: a folder's odometry gives the motion between its images; half-way between two lines the robot is half-way.
#[test]
fn depth_folders_carry_odometry() {
    let place = drive_of(3);
    let frames = || {
        let log = files::LogFrames::open(&place.path("log"), None, &Default::default()).unwrap();
        log.map(|o| o.unwrap().frame.motion.map(|m| m.previous_from_current.translation)).collect::<Vec<_>>()
    };
    assert!(frames()[0].is_none() && frames()[1].is_some_and(|t| (t.length() - 0.02).abs() < 0.005));
    place.write("log/odometry.txt", b"10 0 0 0 0 0 0 1\n11.5 0.3 0 0 0 0 0 1\n12 0.5 0 0 0 0 0 1\n");
    let steps = frames();
    assert!((steps[1].unwrap().x - 0.2).abs() < 1e-9 && (steps[2].unwrap().x - 0.3).abs() < 1e-9, "{steps:?}");
    place.write("log/odometry.txt", b"10 0 0 0 0 0 0 1\n10 0.3 0 0 0 0 0 1\n");
    let line = "localize log --map room.glb --init reference --out x.tum";
    super::check(&place, vec![super::bad(line, 1, &["odometry.txt", "sort the poses by time"])]);
}

/// A scan that takes longer than the scans are apart is refused, with a remedy that works.
#[test]
fn a_turn_longer_than_the_frame_distance_is_refused() {
    let place = Place::new();
    let room = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb");
    fs::copy(room, place.path("room.glb")).unwrap();
    let pose = |k: usize| format!("{} {} 0.35 1.65 0 0 0.324 0.946\n", k as f64 / 10.0, 0.3 + 0.01 * k as f64);
    place.write("drive.tum", (0..6).map(pose).collect::<String>().as_bytes());
    let sensor = place.run("sensors laser-scanner").stdout;
    place.write("slow.toml", format!("turn_s = 0.5\n{sensor}").as_bytes());
    let made = place.run("simulate room.glb --sensor slow.toml --poses drive.tum --out log");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    assert!(fs::read_to_string(place.path("log/scans.jsonl")).unwrap().contains("turn_s"));
    let line = "localize log/scans.jsonl --map room.glb --sensor slow.toml --init reference --out x.tum";
    let refused = place.run(line);
    assert_eq!(refused.status, Some(1), "{}", refused.stderr);
    assert!(refused.stderr.contains("a scan of 0.499 s, but the scans come every 0.100 s"), "{}", refused.stderr);
    place.write("slow.toml", format!("turn_s = 0.1\n{sensor}").as_bytes());
    place.done("simulate room.glb --sensor slow.toml --poses drive.tum --out log");
    let done = place.run(line);
    assert_eq!(done.status, Some(0), "{}", done.stderr);
}
