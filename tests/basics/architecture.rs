//! What the compiler does not prove of ARCHITECTURE's rules: the picture of the crates, who names which crate from
//! outside, engines that do not know each other.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The crates of ARCHITECTURE's picture, lowest first, with those that stand directly below each.
pub const PICTURE: [(&str, &[&str]); 18] = [
    ("presight-model", &[]),
    ("presight-ros", &["presight-model"]),
    ("presight-read", &["presight-ros"]),
    ("presight-render", &["presight-model"]),
    ("presight-features", &["presight-render"]),
    ("presight-predict", &["presight-features"]),
    ("presight-files", &["presight-predict", "presight-read"]),
    ("presight-pictures", &["presight-predict", "presight-read"]),
    ("presight-store", &["presight-read"]),
    ("presight-localize", &["presight-predict"]),
    ("presight-supervise", &["presight-localize"]),
    ("presight-update", &["presight-localize", "presight-store"]),
    ("presight-explore", &["presight-localize", "presight-store"]),
    ("presight", &["presight-explore", "presight-files", "presight-pictures", "presight-supervise", "presight-update"]),
    ("presight-testkit", &["presight-pictures"]),
    ("presight-studies", &["presight", "presight-testkit"]),
    ("presight-editor", &["presight-studies"]),
    ("presight-cli", &["presight-editor"]),
];

/// Crates from outside that only some crates may use, and there only one folder of the sources if it is named.
const FOREIGN: [(&[&str], &[&str], Option<&str>); 10] = [
    (&["wgpu", "pollster"], &["presight-predict"], Some("gpu")),
    (&["apriltag"], &["presight-localize"], Some("extract")),
    (&["exr"], &["presight-files", "presight-read"], None),
    (&["gltf", "rhai", "toml"], &["presight-read"], None),
    (&["serde-saphyr"], &["presight-read", "presight-ros"], None),
    (&["rusqlite"], &["presight-ros", "presight-store"], None),
    (&["mcap"], &["presight-ros"], None),
    (&["twox-hash"], &["presight-store"], None),
    (&["image", "png"], &["presight-pictures", "presight-read"], None),
    (&["hyper", "tokio"], &["presight-editor"], Some("http")),
];

/// Folders, and names of modules and types that their sources may not import.
const STRANGERS: [(&str, &[&str]); 4] = [
    ("crates/presight-render/src/cpu", &["reference"]),
    ("crates/presight-render/src/reference", &["cpu"]),
    ("crates/presight-predict/src/gpu", &["reference", "cpu", "engine", "predict"]),
    ("crates/presight-files/src", &["reference", "cpu", "gpu", "engine", "Predictor"]),
];

pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

pub fn folder_of(name: &str) -> PathBuf {
    if name == "presight" { root().to_owned() } else { root().join("crates").join(name) }
}

pub fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The names in the section `[dependencies]` of a Cargo.toml.
fn dependencies(manifest: &str) -> Vec<&str> {
    let section = manifest.split("\n[dependencies]\n").nth(1).unwrap_or_default();
    let lines = section.lines().take_while(|line| !line.starts_with('['));
    lines
        .filter_map(|line| line.split(['.', ' ', '=']).next().filter(|n| !n.is_empty() && !n.starts_with('#')))
        .collect()
}

/// The crates below each one.
fn below(picture: &[(&'static str, &[&'static str])]) -> BTreeMap<&'static str, BTreeSet<&'static str>> {
    let mut below = BTreeMap::<_, BTreeSet<_>>::new();
    for (name, direct) in picture {
        let mut all: BTreeSet<_> = direct.iter().copied().collect();
        direct.iter().for_each(|d| all.extend(&below[d]));
        below.insert(*name, all);
    }
    below
}

/// Dependencies of a crate that the picture or the list of crates from outside forbids.
fn forbidden(name: &str, manifest: &str) -> Vec<String> {
    let below = below(&PICTURE);
    let mut faults = Vec::new();
    for d in dependencies(manifest) {
        if d.starts_with("presight") && !below[name].contains(d) {
            faults.push(format!("{name} depends on {d}, which is not below it"));
        }
        for (_, homes, _) in FOREIGN.iter().filter(|(crates, homes, _)| crates.contains(&d) && !homes.contains(&name)) {
            faults.push(format!("{name} depends on {d}, which only {} may", homes.join(" and ")));
        }
    }
    faults
}

/// The source without comments and without its tests, which stand at the end.
pub fn code(text: &str) -> String {
    let lines = text.lines().map(|line| line.split("//").next().unwrap_or_default());
    let text = lines.collect::<Vec<_>>().join("\n");
    let tests = ["#[cfg(test)]\nmod tests {", "#[cfg(all(test"].iter().filter_map(|start| text.find(start)).min();
    text[..tests.unwrap_or(text.len())].to_owned()
}

pub fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty())
}

/// The names that a source takes from its own crate and its sisters, lists in braces included.
fn imports(code: &str) -> BTreeSet<&str> {
    let mut names = BTreeSet::new();
    let sisters = ["crate::", "presight_model::", "presight_render::", "presight_features::", "presight_predict::"];
    for rest in sisters.iter().flat_map(|sister| code.split(sister).skip(1)) {
        let path = rest.split(|c: char| !c.is_alphanumeric() && !"_:{".contains(c)).next().unwrap_or_default();
        names.extend(words(path));
        if let Some((_, list)) = rest.split_once('{').filter(|(before, _)| path.starts_with(*before)) {
            names.extend(words(list.split([';', ')']).next().unwrap_or_default()));
        }
    }
    names
}

/// Names that sources below a folder import although they are strangers to it.
fn strangers(folder: &str, code: &str) -> Vec<String> {
    let rule = STRANGERS.iter().find(|(of, _)| *of == folder).expect("a folder of the list");
    let imported = imports(code);
    rule.1.iter().filter(|name| imported.contains(**name)).map(|name| format!("{folder} imports {name}")).collect()
}

/// Crates from outside that a source names although it is not in their folder.
fn misplaced(of_crate: &str, file: &str, code: &str) -> Vec<String> {
    let mut faults = Vec::new();
    for (crates, homes, module) in FOREIGN {
        let Some(module) = module.filter(|_| homes.contains(&of_crate)) else { continue };
        if file.starts_with(&format!("{module}/")) || file == format!("{module}.rs") {
            continue;
        }
        let names = |c: &&&str| code.contains(&format!("{c}::"));
        faults.extend(crates.iter().filter(names).map(|c| format!("{of_crate}: {file} names {c}, only {module} may")));
    }
    faults
}

/// Sources below a folder, without files and folders of tests.
pub fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap();
        match path.is_dir() {
            _ if name == "tests" || name.ends_with("_tests") => {}
            true => found.extend(sources(&path)),
            false if path.extension().is_some_and(|e| e == "rs") => found.push(path),
            false => {}
        }
    }
    found
}

#[test]
fn crates_depend_on_those_below_them() {
    let mut faults = Vec::new();
    for (name, _) in PICTURE {
        faults.extend(forbidden(name, &read(&folder_of(name).join("Cargo.toml"))));
    }
    assert!(faults.is_empty(), "{faults:#?}");
    let crates = fs::read_dir(root().join("crates")).unwrap().map(|entry| entry.unwrap().file_name());
    let unknown: Vec<_> = crates.filter(|name| !PICTURE.iter().any(|(known, _)| name == *known)).collect();
    assert!(unknown.is_empty(), "not in the picture: {unknown:?}");
}

#[test]
fn sources_name_only_what_they_may() {
    let (mut faults, mut count) = (Vec::new(), 0);
    for (folder, _) in STRANGERS {
        for path in sources(&root().join(folder)) {
            count += 1;
            faults
                .extend(strangers(folder, &code(&read(&path))).into_iter().map(|f| format!("{}: {f}", path.display())));
        }
    }
    for name in FOREIGN.iter().filter(|(.., module)| module.is_some()).flat_map(|(_, homes, _)| *homes) {
        let src = folder_of(name).join("src");
        for path in sources(&src) {
            let file = path.strip_prefix(&src).unwrap().to_str().unwrap();
            faults.extend(misplaced(name, file, &code(&read(&path))));
        }
    }
    assert!(count > 50, "{count} sources");
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn planted_faults_are_found() {
    let upward = "[package]\n\n[dependencies]\npresight-model.workspace = true\npresight-files.workspace = true\n\n\
                  [dev-dependencies]\npresight = 1\n";
    assert_eq!(
        forbidden("presight-render", upward),
        ["presight-render depends on presight-files, which is not below it"]
    );
    let foreign = "\n[dependencies]\ntoml = { version = \"1\" }\nserde.workspace = true\n";
    assert_eq!(forbidden("presight-model", foreign), ["presight-model depends on toml, which only presight-read may"]);
    assert!(forbidden("presight-read", foreign).is_empty());

    let files = "crates/presight-files/src";
    for source in [
        "use presight_predict::predict::{Options, Predictor};",
        "fn f() { presight_render::cpu::draw() }",
        "use presight_predict::{batch, engine};",
    ] {
        assert_eq!(strangers(files, source).len(), 1, "{source}");
    }
    let sound = "use presight_predict::request::Request; // presight_predict::gpu\n#[cfg(test)]\nmod tests {\n    \
                 use presight_predict::Predictor;\n}";
    assert!(strangers(files, &code(sound)).is_empty());
    assert_eq!(strangers("crates/presight-render/src/cpu", "use crate::reference::Face;").len(), 1);

    assert_eq!(misplaced("presight-predict", "batch/mod.rs", "fn f(d: &wgpu::Device) {}").len(), 1);
    assert!(misplaced("presight-predict", "gpu/mod.rs", "fn f(d: &wgpu::Device) {}").is_empty());
}
