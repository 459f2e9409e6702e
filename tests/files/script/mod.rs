//! Scene scripts: every function, every limit, the scenes of this repository, and the command.

mod bad;
mod functions;
mod same;
mod scenes;
mod size;

use presight_read::preparation::ImportedScene;
use presight_read::script;
use presight_testkit as common;
use std::path::Path;

/// Runs a file; also returns the printed lines.
fn load(path: &Path) -> (presight_model::error::Result<ImportedScene>, Vec<String>) {
    let mut said = Vec::new();
    let outcome = script::load(path, &Default::default(), &mut |line| said.push(line.to_owned()));
    (outcome, said)
}

/// Runs a text in a folder of its own.
fn run(text: &str) -> presight_model::error::Result<ImportedScene> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.rhai");
    std::fs::write(&path, text).unwrap();
    load(&path).0
}
