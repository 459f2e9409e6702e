//! The last line of `tests/run` has the count of skipped tests.
#![cfg(unix)]

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

/// Runs `tests/run` with a stand-in for cargo that executes a script; returns the status and the last line printed.
fn run(cargo: &str) -> (Option<i32>, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cargo");
    std::fs::write(&path, format!("#!/usr/bin/env bash\n{cargo}\n")).unwrap();
    std::fs::set_permissions(&path, PermissionsExt::from_mode(0o755)).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/run");
    let mut command = Command::new("bash");
    let paths = format!("{}:{}", folder.path().display(), std::env::var("PATH").unwrap());
    // Naming a driver prevents an installation.
    let output = command.arg(script).arg("--test=engines").env("PATH", paths).env("VK_DRIVER_FILES", "/nonexistent");
    let output = output.output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    (output.status.code(), said.lines().last().unwrap_or_default().to_owned())
}

#[test]
fn skipped_tests_are_counted_with_their_reasons() {
    assert_eq!(run("true"), (Some(0), "tests/run: no test was skipped".into()));
    // The same test and reason twice, and one test with two reasons.
    let notes =
        r#"printf 'a x\tno data\na x\tno data\nb x\tno data\nb x\tno adapter\nb y\tno data\n' >> "$PRESIGHT_SKIPPED""#;
    let told = "tests/run: 3 tests were skipped, all or in part: 3 because no data, 1 because no adapter";
    assert_eq!(run(notes), (Some(0), told.into()));
    assert_eq!(
        run(&format!("{notes}\n[[ $1 == test && ${{!#}} == --test=engines ]] || exit 7\nexit 101")).0,
        Some(101)
    );
}

/// A test without its data leaves a note, and fails where everything must be tested.
#[test]
fn a_test_without_its_data_leaves_a_note() {
    const TESTS: &str = "skipped::lacks_data";
    let folder = tempfile::tempdir().unwrap();
    let list = folder.path().join("list");
    std::fs::write(&list, "").unwrap();
    let run = |required: &str| {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args([TESTS, "--exact", "--ignored"]).env_remove("CI");
        command.env("PRESIGHT_DATA", folder.path().join("none")).env("PRESIGHT_SKIPPED", &list);
        command.env("PRESIGHT_REQUIRE_DATA", required).output().unwrap().status.success()
    };
    assert!(run("0"));
    let noted = std::fs::read_to_string(&list).unwrap();
    let reason =
        format!("\tthe shared data {} is not there; set PRESIGHT_DATA\n", folder.path().join("none").display());
    assert!(noted.contains(TESTS) && noted.ends_with(&reason) && noted.lines().count() == 1, "{noted}");
    assert!(!run("1"));
}

#[test]
#[ignore = "run by the test above, in a process of its own"]
fn lacks_data() {
    assert_eq!(presight_testkit::data::file("env/hospital.glb"), None);
}
