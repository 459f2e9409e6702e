//! Checks the sources against ARCHITECTURE's table of modules and its import rule.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Crates that only one module may use.
const HOMES: [(&str, &[&str]); 3] = [
    ("gpu", &["wgpu", "pollster"]),
    ("extract", &["apriltag"]),
    ("io", &["exr", "gltf", "rhai", "rusqlite", "serde_saphyr", "toml", "twox_hash"]),
];

/// The rendering modules. The rows between them and `predict` may use all of them.
const ENGINES: [&str; 3] = ["reference", "cpu", "gpu"];

/// A row of the table: modules and their dependencies. Modules of one row may import each other.
struct Row {
    modules: Vec<String>,
    depends: Vec<String>,
}

/// Parses the table of modules, without the rows of `crates/`.
fn table(text: &str) -> Vec<Row> {
    let start = text.find("| module | holds | depends on |").expect("the table of modules");
    let names = |cell: &str| -> Vec<String> {
        let is_name = |c: char| c.is_ascii_lowercase() || c == '_';
        cell.split(|c: char| !is_name(c)).filter(|w| !w.is_empty()).map(str::to_owned).collect()
    };
    let lines = text[start..].lines().skip(2).take_while(|line| line.starts_with('|'));
    lines
        .map(|line| {
            let cells: Vec<&str> = line.split('|').collect();
            Row { modules: names(cells[1]), depends: names(cells[3]) }
        })
        .collect()
}

/// Returns what each module may import: the modules of its own row, and of the rows that it names, transitively. Also
/// returns faults of the table itself.
fn allowed(rows: &[Row]) -> (BTreeMap<&str, BTreeSet<&str>>, Vec<String>) {
    let (mut allowed, mut faults) = (BTreeMap::<&str, BTreeSet<&str>>::new(), Vec::new());
    for row in rows {
        let mut all: BTreeSet<&str> = row.modules.iter().map(String::as_str).collect();
        for name in row.depends.iter().map(String::as_str) {
            match (name, allowed.get(name)) {
                ("nothing", _) => {}
                ("everything", _) => all.extend(allowed.keys()),
                (_, Some(its)) => all.extend(its),
                (_, None) => faults.push(format!("{name}, on which {:?} depends, has no row above", row.modules)),
            }
        }
        for module in &row.modules {
            if allowed.insert(module, all.clone()).is_some() {
                faults.push(format!("{module} has two rows"));
            }
        }
    }
    (allowed, faults)
}

/// The source without comments and without the test module at its end.
fn code(text: &str) -> String {
    let lines = text.lines().map(|line| line.split("//").next().unwrap_or_default());
    let text = lines.collect::<Vec<_>>().join("\n");
    let tests = ["#[cfg(test)]\nmod tests {", "#[cfg(all(test"].iter().filter_map(|start| text.find(start)).min();
    text[..tests.unwrap_or(text.len())].to_owned()
}

/// The modules of this crate that a source imports, resolved through the re-exports of `lib.rs`.
fn imports(code: &str, again: &BTreeMap<String, String>) -> BTreeSet<String> {
    let words = |text: &str| -> Vec<String> {
        text.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|w| !w.is_empty()).map(str::to_owned).collect()
    };
    let after = code.split("crate::").skip(1);
    let named = after.flat_map(|rest| match rest.strip_prefix('{') {
        Some(rest) => words(rest.split('}').next().unwrap_or_default()),
        None => words(rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default()),
    });
    named.map(|name| again.get(&name).cloned().unwrap_or(name)).collect()
}

/// The names that `lib.rs` re-exports, with their modules.
fn given_again(lib: &str) -> BTreeMap<String, String> {
    let mut names = BTreeMap::new();
    for rest in lib.split("\npub use ").skip(1) {
        let (module, list) =
            rest.split(';').next().and_then(|used| used.split_once("::")).expect("pub use module::name");
        for name in list.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|name| !name.is_empty()) {
            names.insert(name.to_owned(), module.to_owned());
        }
    }
    names
}

/// Collects the sources below a folder, without tests.
fn sources(folder: &Path, to: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap();
        match path.is_dir() {
            _ if name == "tests" || name.ends_with("_tests") => {}
            true => sources(&path, to),
            false if path.extension().is_some_and(|e| e == "rs") => to.push(path),
            false => {}
        }
    }
}

/// Returns the violations of the rule: `files` are top-level modules with one of their sources.
fn breaches(architecture: &str, lib: &str, files: &[(String, String)]) -> Vec<String> {
    let rows = table(architecture);
    let (allowed, mut faults) = allowed(&rows);
    for engine in ["cpu", "gpu", "engine", "predict"] {
        if allowed.get("io").is_some_and(|may| may.contains(engine)) {
            faults.push(format!("io depends on {engine}"));
        }
    }
    let again = given_again(lib);
    for (module, source) in files {
        let Some(may) = allowed.get(module.as_str()) else {
            faults.push(format!("{module} has no row"));
            continue;
        };
        let code = code(source);
        for name in imports(&code, &again) {
            // Other names are items of the crate's root, such as macros.
            if allowed.contains_key(name.as_str()) && !may.contains(name.as_str()) {
                faults.push(format!("{module} imports {name}"));
            }
            let engine = ENGINES.contains(&module.as_str()) && ENGINES.contains(&name.as_str()) && *module != name;
            if engine || module == "io" && [&ENGINES[..], &["engine", "predict"]].concat().contains(&name.as_str()) {
                faults.push(format!("{module} knows {name}"));
            }
        }
        for (home, crates) in HOMES.iter().filter(|(home, _)| home != module) {
            let named = |c: &&&str| {
                [format!("use {c}::"), format!(" {c}::"), format!("({c}::")].iter().any(|n| code.contains(n))
            };
            faults.extend(crates.iter().filter(named).map(|c| format!("{module} names {c}, which only {home} may")));
        }
    }
    faults.sort();
    faults.dedup();
    faults
}

#[test]
fn modules_import_only_what_the_table_allows() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |path: &Path| fs::read_to_string(path).unwrap();
    let (mut paths, mut files) = (Vec::new(), Vec::new());
    sources(&root.join("src"), &mut paths);
    for path in paths.iter().filter(|path| !path.ends_with("src/lib.rs")) {
        let relative = path.strip_prefix(root.join("src")).unwrap();
        let module = Path::new(relative.iter().next().unwrap()).file_stem().unwrap().to_str().unwrap();
        files.push((module.to_owned(), read(path)));
    }
    assert!(files.len() > 200, "{} sources", files.len());
    let faults = breaches(&read(&root.join("ARCHITECTURE.md")), &read(&root.join("src/lib.rs")), &files);
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn breaches_are_found() {
    let table = "| module | holds | depends on |\n|---|---|---|\n| `error`, `limits` | x | nothing |\n| `plan` | x | error |\n\
                 | `cpu` | x | plan |\n| `gpu` | x | plan |\n| `io` | one file per format | plan |\n\ntext | `later` |\n";
    let lib = "mod plan;\npub use plan::{FramePlan, Images};\n";
    let of = |module: &str, source: &str| breaches(table, lib, &[(module.to_owned(), source.to_owned())]);
    let sound = [
        ("io", "use crate::limits;\nuse crate::{Images, error};\nuse exr::x;"),
        ("cpu", "use crate::plan::FramePlan; // crate::gpu\n#[cfg(test)]\nmod tests {\n    use crate::gpu;\n}"),
        ("error", "use crate::limits::MOST;"),
    ];
    for (module, source) in sound {
        assert_eq!(of(module, source), [""; 0], "{module}: {source}");
    }
    let broken = [
        ("plan", "use crate::cpu::Engine;", "plan imports cpu"),
        ("error", "use crate::Images;", "error imports plan"),
        ("error", "use crate::{limits, plan};", "error imports plan"),
        ("io", "fn f() { crate::gpu::open() }", "io knows gpu"),
        ("plan", "use wgpu::Device;", "plan names wgpu, which only gpu may"),
        ("later", "", "later has no row"),
    ];
    for (module, source, said) in broken {
        assert!(of(module, source).iter().any(|fault| fault == said), "{module}: {source}: {:?}", of(module, source));
    }
    let through = table.replace("| plan |\n\n", "| gpu |\n\n");
    assert!(breaches(&through, lib, &[]).contains(&"io depends on gpu".to_owned()));
    let upward = table.replace("| x | nothing |", "| x | plan |");
    assert!(breaches(&upward, lib, &[]).iter().any(|fault| fault.starts_with("plan, on which")), "a row below");
}
