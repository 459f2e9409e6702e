//! Runs `presight report` as a process and checks its files, their content and its refusals.

use assert_cmd::Command;
#[cfg(feature = "gpu")]
use presight_testkit::skip;
use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::Path;
use std::process::Output;
use std::time::Duration;

const COLUMNS: &str = "scene,sensor,engine,variant,error_kind,error,bound,median_ms,p95_ms,pareto";

/// A small camera and a small scanner with rows that can be thinned out.
const CAMERA: &str = "format = 1\nkind = \"camera\"\nname = \"small\"\nclass = \"video\"\nwidth = 64\nheight = 48\nfx = 40.0\nfy = 40.0\ncx = 31.5\ncy = 23.5\n";
const SCANNER: &str = "format = 1\nkind = \"scanner\"\nname = \"turning\"\nclass = \"laser\"\nrange_max = 30.0\n[azimuth]\nstart_deg = -180.0\nstep_deg = 4.0\ncount = 90\n[elevation]\nstart_deg = -28.0\nstep_deg = 4.0\ncount = 16\n";

fn room() -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/room.glb").display().to_string()
}

fn presight(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::cargo_bin("presight").unwrap();
    command.current_dir(folder).args(arguments);
    // Hides every Vulkan driver, so that the command behaves the same on every machine.
    for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        command.env(variable, "/nonexistent");
    }
    command.output().unwrap()
}

fn report(folder: &Path, arguments: &[&str]) -> Output {
    presight(folder, &[&["report"], arguments].concat())
}

fn json_of(folder: &Path) -> serde_json::Value {
    serde_json::from_str(&fs::read_to_string(folder.join("study/report.json")).unwrap()).unwrap()
}

/// Splits a CSV line in which quoted names contain commas.
fn cells(line: &str) -> Vec<String> {
    let (mut cells, mut quoted) = (vec![String::new()], false);
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => cells.push(String::new()),
            c => cells.last_mut().unwrap().push(c),
        }
    }
    cells
}

#[test]
fn a_quick_study_writes_its_results() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("camera.toml"), CAMERA).unwrap();
    fs::write(folder.path().join("scanner.toml"), SCANNER).unwrap();
    let room = room();
    let sensors = ["--sensor", "camera.toml", "--sensor", "scanner.toml"];
    let done = report(folder.path(), &[&[room.as_str(), "--out", "study", "--quick"][..], &sensors].concat());
    assert_eq!(String::from_utf8_lossy(&done.stderr), "");
    assert_eq!(done.status.code(), Some(0));
    let said = String::from_utf8(done.stdout).unwrap();
    assert_eq!(said.matches("on this machine take cpu, ").count(), 2, "{said}");
    assert_eq!(said.matches(", measured on ").count(), 2, "{said}");
    check_csv(&fs::read_to_string(folder.path().join("study/work_precision.csv")).unwrap());
    check_html(&fs::read_to_string(folder.path().join("study/index.html")).unwrap());
    let json = json_of(folder.path());
    assert_eq!(json["format"], 1);
    assert_eq!(json["findings"].as_array().unwrap().len(), 2);
    assert_eq!(json["machine"]["command"][1], "report");
    check_approximations(folder.path(), &json["approximations"]);
    for finding in json["findings"].as_array().unwrap() {
        check_notes(finding["notes"].as_array().unwrap());
        assert!(finding["features"].as_u64() >= Some(10) && finding["seen_share"].as_f64() > Some(0.1), "{finding}");
    }
    check_ways(folder.path(), &json["findings"][0]["notes"]);
}

/// Checks the costs of simpler lidars: five approximations for each of three presets with beam tables, and three for the
/// pattern. Points moved by the true motion are wrong at edges only, far less often than points as sensed.
fn check_approximations(folder: &Path, costs: &serde_json::Value) {
    let costs = costs.as_array().unwrap();
    assert_eq!(costs.len(), 18);
    let wrong = |sensor: &str, name: &str| {
        let cost = costs.iter().find(|c| c["sensor"] == sensor && c["approximation"] == name).unwrap();
        let [two, ten] = ["wrong_2cm", "wrong_10cm"].map(|key| cost[key].as_f64().unwrap());
        assert!(cost["rays"].as_u64() > Some(1000) && two >= ten && two <= 1.0, "{cost}");
        two
    };
    for sensor in ["vlp-16-real", "vlp-32c-real", "os1-128-real", "mid-360-like"] {
        let [right, middle, stamp] = ["deskewed", "middle_pose", "stamp_pose"].map(|name| wrong(sensor, name));
        assert!(right < 0.2 * middle && middle < stamp, "{sensor}: {right} {middle} {stamp}");
    }
    let csv = fs::read_to_string(folder.join("study/approximations.csv")).unwrap();
    assert_eq!(csv.lines().next(), Some("scene,sensor,approximation,rays,wrong_2cm,wrong_10cm,median_m"));
    assert_eq!(csv.lines().count(), 19);
}

/// Checks that the notes have stage times with their spread, and one default for each family of paths: images,
/// features, and regions at three pose errors.
fn check_notes(notes: &[serde_json::Value]) {
    assert_eq!(notes.iter().filter(|n| n["default"] == true).count(), 5, "{notes:?}");
    let one_thread = &notes[1];
    assert_eq!(one_thread["variant"], "1 thread");
    let stages = one_thread["stages"].as_array().unwrap();
    let ms = |stage: &serde_json::Value, key: &str| stage[key].as_f64().unwrap();
    assert!(stages.len() >= 3 && stages.iter().all(|s| ms(s, "p95_ms") >= ms(s, "median_ms")), "{one_thread}");
}

/// Checks that the command accepts the flags that a study recommends for its paths.
fn check_ways(folder: &Path, notes: &serde_json::Value) {
    let ways = notes.as_array().unwrap().iter().map(|n| n["how"].as_str().unwrap());
    let flags: HashSet<&str> = ways.filter_map(|how| how.split(';').next().filter(|f| f.starts_with("--"))).collect();
    assert!(flags.len() >= 7, "{flags:?}");
    let room = room();
    for line in flags {
        let view = ["predict", room.as_str(), "--sensor", "camera.toml", "--pose", "0.3,0.35,1.65,0,12,38"];
        let done = presight(folder, &[&view[..], &line.split_whitespace().collect::<Vec<_>>()].concat());
        assert_eq!(done.status.code(), Some(0), "{line}: {}", String::from_utf8_lossy(&done.stderr));
    }
}

/// Studies the GPU engine's paths, including regions of interest, where there is an adapter.
#[cfg(feature = "gpu")]
#[test]
fn the_gpu_engine_is_studied_where_there_is_one() {
    if !presight_testkit::has_adapter() {
        return skip::no_adapter("none is listed");
    }
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("camera.toml"), CAMERA).unwrap();
    let arguments = ["report", &room(), "--quick", "--out", "study", "--sensor", "camera.toml"];
    let done = Command::cargo_bin("presight").unwrap().current_dir(folder.path()).args(arguments).output().unwrap();
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let json = json_of(folder.path());
    let rows = json["findings"][0]["rows"].as_array().unwrap();
    let error = |engine: &str, variant: &str, kind: &str| {
        let of = |r: &&serde_json::Value| r["engine"] == engine && r["variant"] == variant && r["error_kind"] == kind;
        let row = rows.iter().find(of).unwrap_or_else(|| panic!("no {engine}, {variant}, {kind}"));
        row["error"].as_f64().unwrap()
    };
    for pose in ["1 cm 0.3 deg", "10 cm 3 deg", "20 cm 8 deg"] {
        let variant = format!("roi as needed, pose {pose}");
        let [gpu, cpu] = ["gpu", "cpu"].map(|engine| error(engine, &variant, "roi_missed"));
        assert!((gpu - cpu).abs() < 2e-3, "{variant}: {gpu}, by the CPU {cpu}");
    }
    assert_eq!(
        error("gpu", "features by images", "visible_fraction"),
        error("cpu", "features by images", "visible_fraction")
    );
    assert_eq!(error("gpu", "32-bit keys", "fault_share"), 0.0);
}

fn check_csv(csv: &str) {
    let mut lines = csv.lines();
    assert_eq!(lines.next(), Some(COLUMNS));
    let rows: Vec<Vec<String>> = lines.map(cells).collect();
    let mut errors: HashMap<(String, String, String, String), f64> = HashMap::new();
    let mut fronts = HashMap::new();
    for row in &rows {
        assert_eq!(row.len(), 10, "{row:?}");
        let number = |i: usize| row[i].parse::<f64>().unwrap_or_else(|e| panic!("{row:?}: {e}"));
        assert!(number(5) >= 0.0 && number(7) > 0.0 && number(8) >= number(7), "{row:?}");
        assert!(row[6].is_empty() || number(6) >= 0.0, "{row:?}");
        assert!(row[4] != "range_m" || row[6].is_empty() || number(6) > 0.0, "a bound of zero: {row:?}");
        let front: &mut usize = fronts.entry((row[1].clone(), row[4].clone())).or_default();
        *front += usize::from(row[9].parse::<bool>().unwrap());
        errors.insert((row[1].clone(), row[2].clone(), row[3].clone(), row[4].clone()), number(5));
    }
    let mut reduced = 0;
    for ((sensor, engine, variant, kind), error) in &errors {
        let path = format!("{sensor}: {engine}, {variant}, {kind}");
        let rough = variant.contains("resolution");
        match kind.as_str() {
            "fault_share" => assert_eq!(*error, 0.0, "{path}"),
            "range_of_bound" if !rough => assert!(*error <= 1.0, "{path}: {error}"),
            "id_mismatch" if engine == "reference" => assert_eq!(*error, 0.0, "{path}"),
            "id_mismatch" if rough => {
                assert!(*error > 0.0, "{path}");
                reduced += 1;
            }
            "id_mismatch" => assert!(*error <= 1e-3, "{path}: {error}"),
            "range_m" | "silhouette_px" if rough => assert!(*error > 0.0, "{path}"),
            // Images and rays decide the same samples in the same way; all samples are inside the room. Finer ones are
            // nearer to the truth.
            kind if kind.starts_with("visible_fraction") && !rough => {
                let of =
                    |variant: &str| errors[&(sensor.clone(), "cpu".to_owned(), variant.to_owned(), kind.to_owned())];
                let rays = of("features by rays");
                match variant.contains("every") {
                    false => assert!((error - rays).abs() < 1e-9, "{path}: {error}, rays {rays}"),
                    true => assert!(*error <= rays + 1e-9, "{path}: {error}, rays {rays}"),
                }
            }
            "missing_share" => assert!((0.4..0.9).contains(error), "{path}: {error}"),
            _ => {}
        }
    }
    assert_eq!(reduced, 4, "1/2 and 1/4 of both sensors");
    for sensor in ["small", "turning"] {
        for variant in ["1 thread", "1 thread, ray table"] {
            let key = (sensor.to_owned(), "cpu".to_owned(), variant.to_owned(), "id_mismatch".to_owned());
            assert!(errors.contains_key(&key), "{key:?} is missing");
        }
        assert!(fronts[&(sensor.to_owned(), "id_mismatch".to_owned())] > 0);
        let roi = |method: &str, kind: &str| {
            let variant = format!("roi {method}, pose 10 cm 3 deg");
            errors[&(sensor.to_owned(), "cpu".to_owned(), variant, kind.to_owned())]
        };
        // 1 % and a margin for the random draws; the derivative alone neglects curvature.
        assert!(roi("as needed", "roi_missed") <= 0.012 && roi("set", "roi_missed") <= 0.012, "{sensor}");
        assert!(roi("linear", "roi_area_share") < roi("as needed", "roi_area_share"), "{sensor}");
        assert!(roi("linear", "roi_missed") > roi("as needed", "roi_missed"), "{sensor}");
    }
}

/// The page loads nothing from the network and is complete.
fn check_html(html: &str) {
    for outside in ["src=\"http", "href=\"http", "<script", "<link", "url(", "@import"] {
        assert!(!html.contains(outside), "{outside}");
    }
    for inside in ["<svg", "data:image/png;base64,", "prefers-color-scheme:dark", "@media print", "Pareto front"] {
        assert!(html.contains(inside), "{inside}");
    }
    for told in ["adapter and driver", "Skipped", "ray table", "--quick", "How to select them", "--index s3d"] {
        assert!(html.contains(told), "{told}");
    }
    // The report has no `--backend` flag.
    assert!(html.contains("presight doctor says what to install") && !html.contains("use --backend cpu"));
}

/// A quarter of four rays is one ray, too few for features; the second sensor has only one ray from the start. The
/// report has everything else.
#[test]
fn an_impossible_path_does_not_stop_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let table = |name: &str, rays: &[&str]| {
        let (width, rays) = (rays.len(), rays.join(", "));
        let head = format!("format = 1\nkind = \"rays\"\nclass = \"video\"\nwidth = {width}\nheight = 1\n");
        fs::write(folder.path().join(name), format!("{head}directions = [{rays}]\n")).unwrap();
    };
    table("few.toml", &["[1, 0.3, 0]", "[1, 0.1, 0]", "[1, -0.1, 0]", "[1, -0.3, 0]"]);
    table("lone.toml", &["[1, 0, 0]"]);
    fs::write(folder.path().join("camera.toml"), CAMERA).unwrap();
    let room = room();
    let sensors = ["--sensor", "camera.toml", "--sensor", "few.toml", "--sensor", "lone.toml"];
    let done = report(folder.path(), &[&[room.as_str(), "--out", "study", "--quick"][..], &sensors].concat());
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let json = json_of(folder.path());
    let said = |at: usize| json["findings"][at]["not_measured"].to_string();
    assert_eq!(said(0), "[]");
    assert!(said(1).contains("features by images, 1/4 resolution: sensor"), "{}", said(1));
    assert!(said(1).contains("fewer than two rays") && !said(1).contains("1/2"), "{}", said(1));
    assert!(said(2).contains("features and regions of interest: sensor"), "{}", said(2));
    for finding in json["findings"].as_array().unwrap() {
        assert!(finding["rows"].as_array().unwrap().iter().any(|r| r["variant"] == "1 thread"), "{finding}");
    }
    let html = fs::read_to_string(folder.path().join("study/index.html")).unwrap();
    assert_eq!(html.matches("Not measured<").count(), 2, "headings");
}

#[test]
fn bad_input_is_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "not a folder").unwrap();
    // Nothing surrounds a sensor here.
    let open = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/files/cases/update-removed-object/new.glb");
    fs::copy(open, folder.path().join("open.glb")).unwrap();
    fs::write(folder.path().join("empty.tum"), "# timestamp tx ty tz qx qy qz qw\n").unwrap();
    let room = room();
    for (arguments, status, told) in [
        (&["--out", "study"][..], 2, "no scene"),
        (&["nothing.glb", "--out", "study"][..], 1, "nothing.glb"),
        (&[room.as_str(), "--out", "study", "--sensor", "nothing"][..], 2, "nothing"),
        (&[room.as_str()][..], 2, "--out"),
        (&[room.as_str(), "--quick", "--out", "file/study"][..], 4, "file/study"),
        (&["--stability", "--out", "file/study"][..], 4, "file/study"),
        (&["--stability", "--out", "study", "--up", "z"][..], 2, "--up"),
        (&["--stability", "--out", "study", "--scale", "2"][..], 2, "--scale"),
        (&[room.as_str(), "--out", "study", "--poses", "empty.tum"][..], 1, "empty.tum: the file has no poses"),
        (
            &["open.glb", "--out", "study"][..],
            1,
            "open.glb: only 0 of 3 free poses found in 6000 tries; give --poses FILE.tum",
        ),
    ] {
        let done = report(folder.path(), arguments);
        let message = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(status), "{arguments:?}: {message}");
        assert!(message.contains(told) && message.lines().count() == 1, "{arguments:?}: {message}");
        assert!(!folder.path().join("study").exists(), "{arguments:?}");
    }
}

/// Not even root can write to /proc. The study, which takes minutes, must not start.
#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_written_is_refused_before_any_work() {
    let room = room();
    for arguments in [
        &["report", &room, "--out", "/proc"][..],
        &["report", "--stability", "--out", "/proc"],
        &["index", &room, "--out", "/proc"],
    ] {
        let mut command = Command::cargo_bin("presight").unwrap();
        let done = command.args(arguments).timeout(Duration::from_secs(20)).output().unwrap();
        let message = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(4), "{arguments:?}: {message}");
        assert!(message.contains("/proc: cannot write into the folder"), "{arguments:?}: {message}");
        assert!(done.stdout.is_empty(), "{arguments:?}");
    }
}
