//! Every command that takes a scene also takes a script.

use assert_cmd::Command;
use std::fs;
use tempfile::TempDir;

fn presight(folder: &TempDir) -> Command {
    let mut command = Command::cargo_bin("presight").unwrap();
    command.current_dir(folder.path()).env_remove("CI");
    command
}

fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let text = r#"print("hello");
        place("room", box(12, 12, 6), pose(0, 0, -3));
        place("walls/wall", box(0.2, 4, 2).point("video", [-0.1, 0, 1], #{ name: "spot" }), pose(2, 0, -1));
        place("back", box(0.2, 4, 2), pose(-3, 0, -1));"#;
    fs::write(folder.path().join("wall.rhai"), text).unwrap();
    folder
}

#[test]
fn all_commands_take_scripts() {
    let folder = folder();
    let run = |args: &str| presight(&folder).args(args.split(' ')).assert().success().get_output().clone();
    let pose = "--pose 0,0,0,0,0,0 --backend cpu";
    let told = run("inspect wall.rhai");
    assert!(String::from_utf8_lossy(&told.stdout).contains("walls/wall"));
    assert_eq!(String::from_utf8_lossy(&told.stderr), "hello\n", "the script prints to stderr");
    run(&format!("predict wall.rhai --sensor laser-scanner {pose} --out a.exr"));
    run(&format!("predict wall.rhai --sensor laser-scanner {pose} --ids source --out b.exr"));
    run(&format!("predict wall.rhai --sensor video-camera {pose} --features f.json"));
    let features = fs::read_to_string(folder.path().join("f.json")).unwrap();
    assert!(features.contains("spot"), "the script's own layer is predicted");
    run("compare a.exr a.exr --scene wall.rhai");
    run("features wall.rhai --class video --out l.json");
    run("features pick wall.rhai --sensor video-camera --pose 0,0,0,0,0,0 --pixel 256,256");
    run("index wall.rhai --out study");
}

/// A store made from a script has the same content as the script's scene.
#[cfg(feature = "store")]
#[test]
fn stores_are_made_of_scripts() {
    let folder = folder();
    let run = |args: &str| presight(&folder).args(args.split(' ')).assert().success().get_output().stdout.clone();
    run("env create wall.presight wall.rhai");
    let content = |scene: &str| {
        let told = String::from_utf8(run(&format!("inspect {scene}"))).unwrap();
        told.lines().find(|l| l.starts_with("content")).expect("the content hash").to_owned()
    };
    assert_eq!(content("wall.presight"), content("wall.rhai"));
}

#[test]
fn faults_end_with_status_1_and_one_line() {
    let folder = folder();
    fs::write(folder.path().join("bad.rhai"), "\n  box(1, 2);").unwrap();
    let output = presight(&folder).args(["inspect", "bad.rhai"]).assert().code(1).get_output().clone();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        said.starts_with("error: bad.rhai: line 2, column 3, in the call of box: ") && said.lines().count() == 1,
        "{said}"
    );
    presight(&folder).args(["inspect", "none.rhai"]).assert().code(1);
}

#[test]
fn a_sidecar_of_a_script_is_refused() {
    let folder = folder();
    fs::write(folder.path().join("wall.materials.toml"), "format = 1\n").unwrap();
    let output = presight(&folder).args(["inspect", "wall.rhai"]).assert().code(1).get_output().clone();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("wall.materials.toml") && said.contains("material("), "{said}");
    // The sidecar may belong to a model of the same name.
    fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb"), folder.path().join("wall.glb")).unwrap();
    presight(&folder).args(["inspect", "wall.rhai"]).assert().success();
}
