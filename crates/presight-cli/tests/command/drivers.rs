//! What Vulkan drivers print.

use super::Place;
use assert_cmd::Command;
use presight_testkit::skip::no_adapter;

/// Mesa prints a line that looks like an error of the command where there is no folder for a Wayland display.
#[test]
fn what_drivers_print_comes_through_except_for_one_line() {
    let place = Place::new();
    let line = "predict wall.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --backend gpu";
    for folder in [None, Some(""), Some("relative"), Some("/nonexistent")] {
        let mut command = Command::cargo_bin("presight").unwrap();
        command.current_dir(place.folder.path()).args(line.split(' ')).env("VK_LOADER_DEBUG", "all");
        match folder {
            Some(folder) => command.env("XDG_RUNTIME_DIR", folder),
            None => command.env_remove("XDG_RUNTIME_DIR"),
        };
        let output = command.output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        if output.status.code() == Some(3) {
            return no_adapter(said.lines().last().unwrap_or_default());
        }
        assert_eq!(output.status.code(), Some(0), "{folder:?}: {said}");
        assert!(!said.contains("XDG_RUNTIME_DIR"), "{folder:?}: {said}");
        assert!(said.lines().any(|line| line.contains("ICD") || line.contains("LAYER")), "{folder:?}: {said}");
    }
}
