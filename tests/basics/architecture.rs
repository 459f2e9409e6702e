//! What the compiler does not prove of ARCHITECTURE's rules: the picture of the crates, who names which crate from
//! outside, engines that do not know each other, and a facade that stays small.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The crates of ARCHITECTURE's picture, lowest first, with those that stand directly below each.
const PICTURE: [(&str, &[&str]); 17] = [
    ("presight-model", &[]),
    ("presight-read", &["presight-model"]),
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
const FOREIGN: [(&[&str], &[&str], Option<&str>); 7] = [
    (&["wgpu", "pollster"], &["presight-predict"], Some("gpu")),
    (&["apriltag"], &["presight-localize"], Some("extract")),
    (&["exr"], &["presight-files", "presight-read"], None),
    (&["gltf", "rhai", "serde-saphyr", "toml"], &["presight-read"], None),
    (&["rusqlite", "twox-hash"], &["presight-store"], None),
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

/// Most modules, most types, and most names at the root of the facade. Supervision, queries, updates and exploration are
/// modules of their own: robots that only predict do not meet them. Recognizers of new things are six types; updates need
/// one for poses that were refined, and one for poses to look from.
const FACADE: [usize; 3] = [16, 228, 63];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn folder_of(name: &str) -> PathBuf {
    if name == "presight" { root().to_owned() } else { root().join("crates").join(name) }
}

fn read(path: &Path) -> String {
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
fn code(text: &str) -> String {
    let lines = text.lines().map(|line| line.split("//").next().unwrap_or_default());
    let text = lines.collect::<Vec<_>>().join("\n");
    let tests = ["#[cfg(test)]\nmod tests {", "#[cfg(all(test"].iter().filter_map(|start| text.find(start)).min();
    text[..tests.unwrap_or(text.len())].to_owned()
}

fn words(text: &str) -> impl Iterator<Item = &str> {
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
fn sources(folder: &Path) -> Vec<PathBuf> {
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

/// What the facade's sources offer: modules, and the names given on, by file, each with its original name.
#[derive(Default)]
struct Facade {
    modules: usize,
    names: Vec<(String, String)>,
    globs: Vec<String>,
}

impl Facade {
    fn read(files: &[(String, String)]) -> Self {
        let mut facade = Self::default();
        for (file, text) in files {
            let code = code(text);
            facade.modules += code.lines().filter(|line| line.trim_start().starts_with("pub mod ")).count();
            for used in code.split("pub use ").skip(1).map(|rest| rest.split(';').next().unwrap_or_default()) {
                let (path, list) = used.split_once('{').unwrap_or_else(|| used.rsplit_once("::").unwrap_or(("", used)));
                for item in list.trim_end_matches('}').split(',').map(str::trim).filter(|item| !item.is_empty()) {
                    let original = item.split(" as ").next().unwrap_or_default();
                    match words(original).collect::<Vec<_>>()[..] {
                        [name] if name != "self" => facade.names.push((file.clone(), name.to_owned())),
                        _ => facade.globs.push(format!("{file}: {path}{item}")),
                    }
                }
            }
        }
        facade
    }

    /// What breaks the bounds; `types` and `others` are the names of all types, and of all functions and constants.
    fn faults(&self, types: &BTreeSet<String>, others: &BTreeSet<String>) -> Vec<String> {
        let mut faults: Vec<String> = self.globs.iter().map(|glob| format!("{glob}: name items one by one")).collect();
        let unknown = |(_, name): &&(String, String)| !types.contains(name) && !others.contains(name);
        faults.extend(self.names.iter().filter(unknown).map(|(file, name)| format!("{file}: {name} is not an item")));
        let known = self.names.iter().filter(|(_, name)| types.contains(name)).count();
        let at_root = self.names.iter().filter(|(file, _)| file == "lib.rs").count() + self.modules;
        for ((what, count), most) in
            [("modules", self.modules), ("types", known), ("names at the root", at_root)].into_iter().zip(FACADE)
        {
            if count > most {
                faults.push(format!("the facade has {count} {what}, at most {most} are allowed"));
            }
        }
        faults
    }
}

/// The names of all public types, and of all public functions and constants, in the library's sources.
fn items() -> [BTreeSet<String>; 2] {
    let mut items = [BTreeSet::new(), BTreeSet::new()];
    let folders =
        PICTURE.iter().take_while(|(name, _)| *name != "presight-testkit").map(|(name, _)| folder_of(name).join("src"));
    for path in folders.flat_map(|folder| sources(&folder)) {
        // The macro `options!` declares structs, which are therefore indented.
        let is_item = |line: &&str| line.starts_with("pub ") || line.starts_with("    pub struct ");
        for line in code(&read(&path)).lines().filter(is_item) {
            let mut words = words(line).skip(1).filter(|word| !["unsafe", "async"].contains(word));
            match (words.next().unwrap_or_default(), words.next().unwrap_or_default()) {
                ("struct" | "enum" | "trait" | "type" | "union", name) => items[0].insert(name.to_owned()),
                ("fn" | "static", name) => items[1].insert(name.to_owned()),
                ("const", "fn") => items[1].insert(words.next().unwrap_or_default().to_owned()),
                ("const", name) => items[1].insert(name.to_owned()),
                _ => false,
            };
        }
    }
    items
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
    assert!(count > 100, "{count} sources");
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn the_facade_is_small() {
    let folder = root().join("src");
    let files: Vec<_> = sources(&folder)
        .into_iter()
        .map(|path| (path.file_name().unwrap().to_str().unwrap().to_owned(), read(&path)))
        .collect();
    let facade = Facade::read(&files);
    let [types, others] = items();
    assert!(facade.modules > 5 && facade.names.len() > 100, "{} names", facade.names.len());
    let faults = facade.faults(&types, &others);
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

    let names: Vec<String> = (0..=FACADE[1]).map(|i| format!("Type{i}")).collect();
    let many = format!("pub mod a;\n#[doc(inline)]\npub use presight_model::{{{}}};\n", names.join(", "));
    let facade = Facade::read(&[("a.rs".to_owned(), many), ("lib.rs".to_owned(), "pub mod b;\n".repeat(FACADE[0]))]);
    let types = names.into_iter().collect();
    let faults = facade.faults(&types, &BTreeSet::new());
    assert_eq!(
        faults,
        [
            format!("the facade has {} modules, at most {} are allowed", FACADE[0] + 1, FACADE[0]),
            format!("the facade has {} types, at most {} are allowed", FACADE[1] + 1, FACADE[1])
        ]
    );
    let glob =
        "pub use presight_model::*;\npub use presight_files::layer;\npub use presight_files::poses::{self, Type1};\n";
    let faults = Facade::read(&[("lib.rs".to_owned(), glob.to_owned())]).faults(&types, &BTreeSet::new());
    assert_eq!(faults.len(), 3, "{faults:?}");
}
