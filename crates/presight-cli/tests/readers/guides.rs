//! Runs every command of the guides, of README.md and of the help as it is printed: docs/tour.md and docs/first-hour.md
//! in an empty folder, the others in the folder that `scenes/examples.sh` makes.

use super::{Place, python};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// The mark in the line before a block that cannot run, with the reason.
const NOT_RUN: &str = "<!-- not run: ";

/// Returns the code blocks of a page with their languages; `not run` for those with a mark.
fn blocks(page: &str) -> Vec<(&str, String)> {
    let mut blocks = Vec::new();
    let mut lines = page.lines();
    let mut is_marked = false;
    while let Some(line) = lines.next() {
        if let Some(language) = line.strip_prefix("```") {
            let code: Vec<&str> = lines.by_ref().take_while(|line| *line != "```").collect();
            blocks.push((if is_marked { "not run" } else { language }, code.join("\n") + "\n"));
        }
        is_marked = line.starts_with(NOT_RUN);
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
            "text" => return Some(format!("{code}; printed was {printed}")),
            // Formats and programs are tested elsewhere.
            _ => continue,
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

/// On the bag and the map of a corridor. The node is tested with Python.
#[test]
fn every_command_of_the_ros_guide_runs() {
    let data = presight_testkit::data::file;
    let (Some(bag), Some(map)) = (data("ros/malaga_zstd.mcap"), data("lidar2d/malaga_corridor_map.glb")) else {
        return;
    };
    let page = guide("ros.md");
    let commands = page.split("## The node").next().unwrap();
    assert_eq!(blocks(commands)[0].1.lines().count(), 4);
    let place = Place::new();
    for (file, name) in [(bag, "drive.mcap"), (map, "corridor.glb")] {
        std::os::unix::fs::symlink(file.canonicalize().unwrap(), place.path(name)).unwrap();
    }
    assert_eq!(first_failure(&place, Path::new("/usr/bin/python3"), commands), None);
    let spoilt = commands.replace("localize drive.mcap", "localize lost.mcap");
    assert!(first_failure(&place, Path::new("/usr/bin/python3"), &spoilt).is_some_and(|e| e.contains("lost.mcap")));
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

/// The files that the guides and the help name, made once by the script that they name.
fn examples() -> &'static Path {
    static MADE: OnceLock<tempfile::TempDir> = OnceLock::new();
    let made = MADE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let script = root().join("scenes/examples.sh");
        let output = bash(&format!("{} made", script.display()), folder.path());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        folder
    });
    Box::leak(made.path().join("made").into_boxed_path())
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// Runs lines with this presight on the path.
fn bash(code: &str, folder: &Path) -> Output {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let ours = Path::new(env!("CARGO_BIN_EXE_presight")).parent().unwrap().to_owned();
    let path = std::env::join_paths(std::iter::once(ours).chain(std::env::split_paths(&path))).unwrap();
    Command::new("bash")
        .args(["-e", "-o", "pipefail", "-c", code])
        .current_dir(folder)
        .env("PATH", path)
        .output()
        .unwrap()
}

/// Runs blocks in order in a copy of the folder of the examples; the first failure.
fn failure_in_examples(blocks: &[String]) -> Option<String> {
    let copy = tempfile::tempdir().unwrap();
    let copied = bash(&format!("cp -a {}/. .", examples().display()), copy.path());
    assert!(copied.status.success());
    blocks.iter().find_map(|code| {
        let output = bash(code, copy.path());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        (!output.status.success()).then(|| format!("{code}: {said}"))
    })
}

/// The commands of a page: its blocks, and the first cells of tables of commands.
fn commands_of_page(page: &str) -> Vec<String> {
    let of_blocks = blocks(page).into_iter().filter(|(language, _)| *language == "sh").map(|(_, code)| code);
    let cell = |line: &str| line.strip_prefix("| `presight ").and_then(|rest| Some(rest.split_once('`')?.0.to_owned()));
    // A lone name is not an example.
    let of_tables =
        page.lines().filter_map(cell).filter(|words| words.contains(' ')).map(|words| format!("presight {words}"));
    of_blocks.chain(of_tables.filter(|line| !serves(line))).collect()
}

/// True for a command that runs until it is stopped.
fn serves(line: &str) -> bool {
    line.starts_with("presight edit")
}

/// The examples of the help of a command, whole lines: with what a backslash or an open quote continues.
fn examples_of_help(help: &str) -> Vec<String> {
    let mut examples = Vec::new();
    let mut open: Option<String> = None;
    for line in help.lines() {
        let word = line.trim_start();
        let begins = (2..=4).contains(&(line.len() - word.len()))
            && (word.starts_with("presight ") || word.starts_with("echo "));
        let code = match open.take() {
            Some(before) => format!("{before}\n{line}"),
            None if begins => word.to_owned(),
            None => continue,
        };
        if code.ends_with('\\') || code.matches('\'').count() % 2 == 1 {
            open = Some(code);
        } else if !serves(&code) && !MEASURE.iter().any(|command| code.starts_with(command)) {
            examples.push(code);
        }
    }
    examples
}

/// Commands that measure for minutes: README.md and docs/studies.md run one of each.
const MEASURE: [&str; 2] = ["presight index", "presight report"];

fn help_of(command: &str) -> String {
    let output = bash(&format!("presight {command} --help"), Path::new("/"));
    String::from_utf8(output.stdout).unwrap()
}

/// The names of the subcommands that a help lists.
fn subcommands(help: &str) -> Vec<String> {
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let name = |line: &str| line.strip_prefix("  ").filter(|rest| !rest.starts_with(' ')).map(str::to_owned);
    let words = listed.filter_map(name).filter_map(|line| line.split_whitespace().next().map(str::to_owned));
    words.filter(|name| name != "help").collect()
}

/// Pages whose commands another test runs, or that hold no commands of this repository's own.
const ELSEWHERE: [&str; 4] = ["tour.md", "first-hour.md", "ros.md", "python.md"];

/// Maximum number of blocks with a mark: builds, servers, and files of manufacturers.
const MAX_NOT_RUN: usize = 4;

#[test]
fn every_command_of_the_guides_runs() {
    let mut pages = vec![root().join("README.md")];
    let guides = std::fs::read_dir(root().join("docs")).unwrap().map(|entry| entry.unwrap().path());
    pages.extend(guides.filter(|path| path.extension().is_some_and(|e| e == "md")));
    pages.retain(|path| !ELSEWHERE.iter().any(|name| path.ends_with(name)));
    let (mut marked, mut count, mut failures) = (0, 0, Vec::new());
    for path in pages {
        let page = std::fs::read_to_string(&path).unwrap();
        marked += page.lines().filter(|line| line.starts_with(NOT_RUN)).count();
        let commands = commands_of_page(&page);
        count += commands.len();
        failures.extend(failure_in_examples(&commands).map(|why| format!("{}: {why}", path.display())));
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(count >= 35 && marked <= MAX_NOT_RUN, "{count} run, {marked} are marked");
}

#[test]
fn every_example_of_the_help_runs() {
    let mut commands: Vec<String> = subcommands(&help_of(""));
    for command in commands.clone() {
        commands.extend(subcommands(&help_of(&command)).into_iter().map(|sub| format!("{command} {sub}")));
    }
    assert!(commands.len() >= 25, "{commands:?}");
    commands.push(String::new());
    let (mut count, mut failures) = (0, Vec::new());
    for command in commands {
        let examples = examples_of_help(&help_of(&command));
        count += examples.len();
        failures.extend(failure_in_examples(&examples).map(|why| format!("{command}: {why}")));
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(count >= 50, "{count} examples");
}

/// Planted faults: a flag that is not there, a file that nothing makes, and a row of a table.
#[test]
fn a_command_that_does_not_run_is_found() {
    for page in [
        "```sh\npresight inspect hall.glb --colour\n```\n",
        "```sh\npresight inspect castle.glb\n```\n",
        "| command | what |\n|---|---|\n| `presight query scenes/room.glb --path A B` | routes |\n",
    ] {
        assert!(failure_in_examples(&commands_of_page(page)).is_some(), "{page}");
    }
    assert_eq!(commands_of_page("<!-- not run: needs a robot -->\n```sh\nfalse\n```\n"), Vec::<String>::new());
    let help = "Examples:\n  presight a \\\n    --b\n  echo 'x\n    y' | presight c\n\nOptions:\n  presight\n";
    assert_eq!(examples_of_help(help), ["presight a \\\n    --b", "echo 'x\n    y' | presight c"]);
}
