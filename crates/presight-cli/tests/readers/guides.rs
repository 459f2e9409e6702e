//! Runs every command of docs/tour.md and docs/first-hour.md, in order, in an empty folder.

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

fn guide(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs").join(name)).unwrap()
}

/// Returns the first block that fails, with its output. `python` runs the blocks of that language.
fn first_failure(place: &Place, python: &Path, page: &str) -> Option<String> {
    let mut printed = String::new();
    let command = Path::new(env!("CARGO_BIN_EXE_presight"));
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = [command, python].map(|program| program.parent().unwrap().to_owned());
    let path = std::env::join_paths(folders.into_iter().chain(std::env::split_paths(&path))).unwrap();
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

/// In a folder with the scenes, as in a clone of the repository.
#[test]
fn every_command_of_the_tour_runs() {
    let page = guide("tour.md");
    assert_eq!(blocks(&page).iter().filter(|(language, _)| *language == "sh").count(), 6);
    let place = Place::new();
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes").canonicalize().unwrap();
    std::os::unix::fs::symlink(scenes, place.path("scenes")).unwrap();
    assert_eq!(first_failure(&place, Path::new("/usr/bin/python3"), &page), None);
}

#[test]
fn every_command_of_the_first_hour_runs() {
    let Some(python) = python() else { return };
    let page = guide("first-hour.md");
    assert_eq!(blocks(&page).iter().filter(|(language, _)| *language == "sh").count(), 4);
    assert_eq!(first_failure(&Place::new(), python, &page), None);
    // Without the right sidecar the hall lies on its side, and an assertion of the page fails.
    let fallen = page.replace("up = \"z\"", "up = \"y\"");
    assert!(first_failure(&Place::new(), python, &fallen).is_some_and(|why| why.contains("AssertionError")));
}
