//! `presight env import`.

use super::{FrameArgs, NoteArgs, environment_of, open_store};
use crate::print;
use presight::features;
use presight::files;
use presight::store::{Existing, SceneMerge};
use presight::tools::{self, quoted};
use presight::{Change, Error, Result};
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  A newer export of the model, with a list of what changed; then as the only source of objects:
    presight env import factory.presight hall-2.glb --replace
    presight env import factory.presight hall-2.glb --mirror";

/// Merge a scene or a layer file (.json), as one change
///
/// Objects that already exist unchanged are kept. An object with the same path but different content is an error,
/// unless --replace or --mirror is given; these list the objects added, changed and left over. Where a name is repeated
/// in the file (chair, chair#2, ..), objects are paired by shape, then by the least sum of distances. Features of the
/// file replace those with the same id; `"remove": true` deletes one. Features must lie on polygons, unless a layer
/// file marks them `"surface": "lost"`, or they have already lost their surface in the imported store.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The store
    store: PathBuf,

    /// The scene or layer file
    file: PathBuf,

    /// Replace objects that have the same path; features in their frame are kept
    #[arg(long)]
    replace: bool,

    /// As --replace, and delete the objects that the file lacks, with the features in their frame
    #[arg(long)]
    mirror: bool,

    #[command(flatten)]
    frame: FrameArgs,

    #[command(flatten)]
    note: NoteArgs,
}

/// Runs the command.
///
/// # Errors
/// Errors from reading the file, and store errors.
pub fn run(args: &Args) -> Result<()> {
    let Args { store: path, file, frame, .. } = args;
    let existing = match (args.mirror, args.replace) {
        (true, _) => Existing::Mirror,
        (false, true) => Existing::Replace,
        (false, false) => Existing::Keep,
    };
    let mut note = args.note.note(|| format!("import of {}", file.display()))?;
    let is_layer = file.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
    if is_layer && existing != Existing::Keep {
        let flag = if args.mirror { "--mirror" } else { "--replace" };
        let what = format!("{flag} is for objects, and this is a layer file");
        let remedy = format!("drop {flag}: features replace those with the same id");
        return Err(Error::usage(what, remedy).in_file(file));
    }
    // Read the file before the store is locked: it may be the same file.
    let (layer, scene) = match is_layer {
        true => (Some(files::read_layer(file)?), None),
        false => {
            let (scene, lay, _) = environment_of(file, frame)?;
            note.cause += &lay;
            (None, Some(scene))
        }
    };
    if let Some(scene) = &scene {
        tools::require_memory(tools::memory_of_writing(scene.objects().iter().map(|o| o.mesh.polygon_count() as u64)))?;
    }
    let mut store = open_store(path)?;
    // Features that have already lost their surface in the imported file or store are accepted.
    let lost = match (&layer, &scene) {
        (Some(file), _) => file.lost.iter().map(|id| (file.layer.class.clone(), *id)).collect(),
        (None, Some(scene)) => features::lost_features(scene).map_err(|e| e.in_file(file))?,
        (None, None) => Vec::new(),
    };
    let (mut changes, mut notes) = (Vec::new(), Vec::new());
    changes.extend(layer.map(|layer| store.merging_layer(&layer)));
    if let Some(scene) = scene {
        let merge = store.merging_scene(&scene, existing).map_err(|e| e.in_file(file))?;
        notes = notes_of(&merge, existing);
        changes.push(merge.change);
    }
    let change = Change::of(changes);
    if matches!(&change, Change::Group(changes) if changes.is_empty()) {
        print::notices(&notes);
        return print::data("nothing to change\n");
    }
    let mut batch = store.batch()?;
    let number = batch.apply_imported(change, lost, &note).map_err(|e| e.in_file(file))?;
    batch.commit()?;
    print::notices(&notes);
    print::data(&format!("change {number}\n"))
}

/// What an import does to the objects of the store, one line for each kind.
fn notes_of(merge: &SceneMerge, existing: Existing) -> Vec<String> {
    let mut notes = Vec::new();
    if !merge.renamed.is_empty() {
        let pairs = merge.renamed.iter().map(|(scene, store)| format!("{} is {}", quoted(scene), quoted(store)));
        let pairs = listed(pairs);
        notes.push(format!("names are repeated; objects of file and store are paired by shape and place: {pairs}"));
    }
    if !merge.ties.is_empty() {
        let names = listed(merge.ties.iter().map(|name| quoted(name)));
        notes.push(format!("several pairings fit equally well for {names}; check which objects changed"));
    }
    if existing == Existing::Keep {
        return notes;
    }
    let objects = |names: &[String]| names.iter().map(|name| quoted(name)).collect::<Vec<_>>();
    let mirror = existing == Existing::Mirror;
    let left =
        if mirror { "objects deleted that the file lacks" } else { "objects left in the store, not in the file" };
    let remedy = if mirror { "" } else { "; --mirror deletes what the file lacks" };
    for (what, names, after) in [
        ("objects added", objects(&merge.added), ""),
        ("objects moved", objects(&merge.moved), ""),
        ("objects with another shape", objects(&merge.reshaped), ""),
        ("groups with another frame", objects(&merge.reframed), ""),
        (left, objects(&merge.missing), remedy),
    ] {
        if !names.is_empty() {
            let count = names.len();
            notes.push(format!("{count} {}: {}{after}", singular(what, count), listed(names.into_iter())));
        }
    }
    for features in merge.features.chunk_by(|a, b| a.0 == b.0) {
        let what = singular("features deleted with their objects", features.len());
        let ids: Vec<u32> = features.iter().map(|(_, id)| *id).collect();
        notes.push(format!("{} {what}, class {}: {}", ids.len(), quoted(&features[0].0), ranges(&ids)));
    }
    if merge.renumbered > 0 {
        notes.push(format!("objects that got other numbers of source triangles only: {}", merge.renumbered));
    }
    notes
}

/// Rising numbers, with runs in short: 1-5, 9.
fn ranges(ids: &[u32]) -> String {
    let runs = ids.chunk_by(|a, b| a + 1 == *b).map(|run| match run {
        [first, .., last] => format!("{first}-{last}"),
        _ => run[0].to_string(),
    });
    runs.collect::<Vec<_>>().join(", ")
}

/// A phrase in the singular or the plural.
fn singular(what: &str, count: usize) -> String {
    match count {
        1 => what
            .replace("objects", "object")
            .replace("groups", "group")
            .replace("features", "feature")
            .replace("their", "its"),
        _ => what.to_owned(),
    }
}

/// The first of some names, and the number of the others.
fn listed(names: impl ExactSizeIterator<Item = String>) -> String {
    const LISTED: usize = 20;
    let more = names.len().saturating_sub(LISTED);
    let names: Vec<String> = names.take(LISTED).collect();
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", names.join(", "))
}
