//! Runs every command of docs/first-hour.md in order in an empty folder.

use super::{Place, python};
use std::path::Path;
use std::process::Command;

/// Returns the code blocks of a page with their languages.
fn blocks(page: &str) -> Vec<(&str, String)> {
    let mut blocks = Vec::new();
    let mut lines = page.lines();
    while let Some(line) = lines.next() {
        if let Some(language) = line.strip_prefix("```") {
            let code: Vec<&str> = lines.by_ref().take_while(|line| *line != "```").collect();
            blocks.push((language, code.join("\n") + "\n"));
        }
    }
    blocks
}

/// Returns the first block that fails, with its output.
fn first_failure(python: &Path, page: &str) -> Option<String> {
    let place = Place::new();
    let mut printed = String::new();
    let folders = [Path::new(env!("CARGO_BIN_EXE_presight")).parent().unwrap(), python.parent().unwrap()];
    let path = std::env::var_os("PATH").unwrap_or_default();
    let path =
        std::env::join_paths(folders.into_iter().map(Path::to_owned).chain(std::env::split_paths(&path))).unwrap();
    for (language, code) in blocks(page) {
        let mut command = match language {
            "sh" => Command::new("bash"),
            "python" => Command::new(python),
            "text" if printed.contains(code.trim()) => continue,
            other => return Some(format!("{other}: {code}; printed was {printed}")),
        };
        if language == "sh" {
            command.args(["-e", "-o", "pipefail"]);
        }
        let output = command.args(["-c", &code]).current_dir(place.folder.path()).env("PATH", &path).output().unwrap();
        if !output.status.success() {
            return Some(format!("{code}: {}", String::from_utf8_lossy(&output.stderr)));
        }
        printed = String::from_utf8_lossy(&output.stdout).into_owned();
    }
    None
}

#[test]
fn every_command_of_the_first_hour_runs() {
    let Some(python) = python() else { return };
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/first-hour.md")).unwrap();
    assert_eq!(blocks(&page).iter().filter(|(language, _)| *language == "sh").count(), 7);
    assert_eq!(first_failure(python, &page), None);
    // Without the right sidecar the hall lies on its side, and an assertion of the page fails.
    let fallen = page.replace("up = \"z\"", "up = \"y\"");
    assert!(first_failure(python, &fallen).is_some_and(|why| why.contains("AssertionError")));
}
