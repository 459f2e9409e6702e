//! The library's names of arguments, as the flags that the user of the command gives.

/// The words of the library's messages, and the command's words for them.
const WORDS: &[(&str, &str)] = &[
    ("`Backend::Cpu`", "--backend cpu"),
    ("`BagOptions::base`", "--base"),
    ("`BagOptions::mount`", "--mount"),
    ("`BagOptions::reflector`", "--reflector"),
    ("`BagOptions::topic`", "--topic"),
    ("`Existing::Replace`", "--replace"),
    ("`GridOptions::cell`", "--cell"),
    ("`GridOptions::from_height`", "--from-height"),
    ("`GridOptions::slope_deg`", "--slope"),
    ("`GridOptions::to_height`", "--to-height"),
    ("`ImportOptions::scale`", "--scale"),
    ("`ImportOptions::up`", "--up"),
    ("`OdometryNoise`", "--odometry-sigma"),
    ("`PoseFrame::Optical`", "--pose-frame optical"),
    ("`PoseOf::Robot`", "--pose-of robot"),
    ("`ProgramRecognizer::within`", "--recognizer-ms"),
    ("`SceneOptions::exclude`", "--exclude"),
    ("`SearchOptions::floor`", "--floor"),
    ("`SearchOptions::margin`", "--margin"),
    ("`Settings::floor_z_world`", "--floor"),
    ("`View::features` of a layer", "a --layer"),
    ("`cascade: true`", "--cascade"),
    ("`port`", "--port"),
    ("`rectified: true`", "--rectified"),
    ("give `poses`", "give --poses FILE.tum"),
    ("start fewer `Threads`", "lower --threads"),
];

/// A message of the library, with the command's flags in place of the library's arguments.
pub fn named(message: &str) -> String {
    WORDS.iter().fold(message.to_owned(), |text, (argument, flag)| text.replace(argument, flag))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::path::Path;

    /// Calls `visit` with the path and the lines of code, without comments, of all source files below a folder.
    fn code(folder: &Path, visit: &mut dyn FnMut(&Path, &str)) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                code(&path, visit);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                text.lines().filter(|line| !line.trim_start().starts_with("//")).for_each(|line| visit(&path, line));
            }
        }
    }

    #[test]
    fn the_library_names_arguments_and_every_one_that_is_mapped() {
        let crates = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let libraries = [
            "model",
            "render",
            "features",
            "predict",
            "files",
            "read",
            "pictures",
            "store",
            "localize",
            "supervise",
            "update",
            "explore",
            "editor",
        ];
        let mut folders: Vec<_> = libraries.iter().map(|l| crates.join(format!("presight-{l}/src"))).collect();
        folders.push(crates.parent().unwrap().join("src"));
        let mut unused: Vec<&str> = WORDS.iter().map(|(argument, _)| *argument).collect();
        for folder in folders {
            code(&folder, &mut |path, line| {
                let is_flag = |tail: &str| tail.starts_with(|c: char| c.is_ascii_lowercase());
                assert!(!line.split("--").skip(1).any(is_flag), "{}: a flag in the library: {line}", path.display());
                unused.retain(|argument| !line.contains(argument));
            });
        }
        assert!(unused.is_empty(), "the library does not say {unused:?}");
        assert_eq!(named("drop `ImportOptions::up`, or use `Backend::Cpu`"), "drop --up, or use --backend cpu");
    }
}
