//! The libraries run beyond Unix: what depends on the system is in few places, which have a form for every system.

use std::fs;
use std::path::{Path, PathBuf};

const LIBRARIES: [&str; 8] = ["model", "render", "features", "predict", "files", "pictures", "localize", "supervise"];

/// What only some systems have, and the sources that may name it.
const HOMES: [(&str, &[&str]); 9] = [
    ("std::time::Instant", &["presight-model/src/clock.rs"]),
    ("SystemTime::now", &[]),
    ("thread::spawn", &[]),
    ("thread::scope", &["presight-model/src/threads.rs"]),
    ("thread::Builder", &["presight-model/src/threads.rs"]),
    // Waits for another thread of the process, so there are threads.
    ("thread::sleep", &["presight-read/src/temporary.rs"]),
    ("ThreadPoolBuilder", &["presight-model/src/threads.rs"]),
    ("available_parallelism", &["presight-model/src/threads.rs"]),
    // File modes, and the descriptors of the standard streams; under cfg(unix), as checked below.
    ("std::os::", &["presight-read/src/atomic.rs", "presight-read/src/temporary.rs"]),
];

/// Sources whose code for Unix is one way to do what the code after it does on every system.
const UNIX_FIRST: [&str; 1] = ["presight-read/src/atomic.rs"];

/// The faults of a source.
fn faults(name: &str, text: &str) -> Vec<String> {
    let code: String = text.lines().map(|line| line.split("//").next().unwrap_or_default().to_owned() + "\n").collect();
    let end = ["#[cfg(test)]\nmod tests {", "#[cfg(all(test"].iter().filter_map(|start| code.find(start)).min();
    // `use std::time::{Duration, Instant};` names the path in two parts.
    let code = code[..end.unwrap_or(code.len())].replace("std::time::{Duration, ", "std::time::");
    let mut faults = Vec::new();
    for (word, _) in HOMES.iter().filter(|(_, homes)| !homes.iter().any(|home| name.ends_with(home))) {
        if code.contains(word) {
            faults.push(format!("{name} names {word}"));
        }
    }
    if ["cfg(unix)", "cfg(windows)", "cfg(target_os"].iter().any(|c| code.contains(&format!("#[{c}")))
        && !code.contains("#[cfg(not(unix))]")
        && !UNIX_FIRST.iter().any(|home| name.ends_with(home))
    {
        faults.push(format!("{name} has code for some systems, and none for the others"));
    }
    faults
}

fn sources(folder: &Path, to: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let is_test = path.file_stem().is_some_and(|name| name == "tests");
        match path.is_dir() {
            _ if is_test => {}
            true => sources(&path, to),
            false if path.extension().is_some_and(|e| e == "rs") => to.push(path),
            false => {}
        }
    }
}

#[test]
fn libraries_ask_the_system_in_few_places() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all = Vec::new();
    sources(&root.join("src"), &mut all);
    LIBRARIES.iter().for_each(|name| sources(&root.join(format!("crates/presight-{name}/src")), &mut all));
    assert!(all.len() > 200, "{} sources", all.len());
    let of = |path: &PathBuf| faults(path.to_str().unwrap(), &fs::read_to_string(path).unwrap());
    let faults: Vec<String> = all.iter().flat_map(of).collect();
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn faults_are_found() {
    for bad in [
        "use std::time::{Duration, Instant};",
        "let start = std::time::Instant::now();",
        "let now = SystemTime::now();",
        "std::thread::spawn(work);",
        "#[cfg(unix)]\nfn only_there() {}",
        "use std::os::unix::fs::symlink;",
    ] {
        assert_eq!(faults("presight-model/src/world.rs", bad).len(), 1, "{bad}");
    }
    for good in [
        "// Instant::now() of std::time::Instant",
        "use std::time::Duration;",
        "#[cfg(unix)]\nfn f() {}\n#[cfg(not(unix))]\nfn f() {}",
        "#[cfg(test)]\nmod tests {\n    use std::os::unix::fs::symlink;\n}",
    ] {
        assert_eq!(faults("presight-model/src/world.rs", good), [""; 0], "{good}");
    }
}
