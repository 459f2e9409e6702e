//! `presight env export`: exports a store as a scene with layer files.

use crate::outputs::{OutputFiles, check_no_dash};
use crate::print;
use presight::features::{self, FeatureLayer};
use presight::files::{self, write_glb};
use presight::store;
use presight::{Error, ErrorKind, Result};
use std::path::{Path, PathBuf};

/// Write a store as glTF with layer files, which create and import read back without loss
///
/// Writes scene.glb and CLASS.layer.json into a folder, or FILE.glb and FILE.CLASS.layer.json next to it. Characters of
/// CLASS other than letters, digits, - _ and . are written as %XX. Features that lost their surface are marked
/// "surface": "lost". Other layer files in the folder are an error: importing them would restore deleted features. The
/// export leaves out the log, the numbers of objects, the ids of deleted features, and objects without polygons. A
/// store without polygons is an error: it would not make a valid scene.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,

    /// A folder, created if it does not exist, or a .glb file
    #[arg(value_name = "DIR|FILE.glb")]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// Errors from reading the store and writing the files.
pub fn run(args: &Args) -> Result<()> {
    check_no_dash(&args.out)?;
    let is_file = args.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb"));
    let (scene, prefix) = match is_file {
        true => (args.out.clone(), format!("{}.", args.out.file_stem().unwrap_or_default().display())),
        false => (args.out.join("scene.glb"), String::new()),
    };
    let mut outputs = OutputFiles::default();
    outputs.add_any(&scene)?;
    outputs.check_named([args.store.as_path()])?;
    let environment = store::read(&args.store)?;
    let folder = scene.parent().unwrap_or(Path::new(""));
    let full = |l: &&FeatureLayer| !(l.features.is_empty() && l.pose_covariances.is_empty());
    let mut files: Vec<(PathBuf, &FeatureLayer)> = Vec::new();
    for own in environment.layers().iter().filter(full) {
        files.push((folder.join(format!("{prefix}{}{SUFFIX}", file_name(&own.class))), own));
    }
    files.iter().try_for_each(|(path, _)| outputs.add_any(path))?;
    outputs.check_named([args.store.as_path()])?;
    // Closed before writing: some systems cannot replace an open file.
    drop(outputs);
    if !is_file {
        std::fs::create_dir_all(&args.out).map_err(|e| {
            let remedy = "check the permissions, or write elsewhere";
            let what = format!("cannot create the folder: {e}");
            Error::new(ErrorKind::System, what, remedy).in_file(&args.out).caused_by(e)
        })?;
    }
    refuse_others(folder, &prefix, &files)?;
    let lost = features::lost_features(&environment).map_err(|e| e.in_file(&args.store))?;
    write_glb(&scene, &environment).map_err(|e| e.in_file(&args.store))?;
    for (path, own) in &files {
        let lost: Vec<u32> = lost.iter().filter(|(class, _)| *class == own.class).map(|(_, id)| *id).collect();
        files::write_layer_with_lost(path, own, &lost)?;
    }
    let (marks, trusts) = (environment.marks().len(), environment.trusts().len());
    let left_out = (marks + trusts > 0).then(|| {
        format!("{marks} marks and the trust in {trusts} objects stay in the store: no exported file holds them")
    });
    print::notices(&left_out);
    let written = std::iter::once(&scene).chain(files.iter().map(|(path, _)| path));
    print::lines(written.map(|path| path.display().to_string()))
}

/// Refuses layer files from an earlier export whose class no longer exists: importing the whole folder would restore
/// deleted features. They belong to the user, so they are not removed.
fn refuse_others(folder: &Path, prefix: &str, files: &[(PathBuf, &FeatureLayer)]) -> Result<()> {
    const LISTED: usize = 5;
    let here = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let mut others = Vec::new();
    // Ignore a folder that cannot be listed: if it cannot be written either, writing reports why.
    for entry in std::fs::read_dir(here).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let Some(text) = name.to_str() else { continue };
        let ours = text.starts_with(prefix) && text.len() > prefix.len() + SUFFIX.len() && text.ends_with(SUFFIX);
        // Next to x.glb, x.y.video.layer.json may belong to x.y.glb.
        let longer = || text.match_indices('.').filter(|(i, _)| *i >= prefix.len()).map(|(i, _)| &text[..i]);
        let ours = ours && (prefix.is_empty() || !longer().any(|stem| here.join(format!("{stem}.glb")).exists()));
        if ours && !files.iter().any(|(path, _)| path.file_name() == Some(&name)) {
            others.push(text.to_owned());
        }
    }
    if others.is_empty() {
        return Ok(());
    }
    others.sort_unstable();
    let listed = others[..others.len().min(LISTED)].join(", ");
    let more = if others.len() > LISTED { ", .." } else { "" };
    let what = format!("there are layer files that this export does not write: {listed}{more}");
    Err(Error::invalid(what, "move or delete them, or export elsewhere").in_file(here))
}

/// The ending of layer file names.
const SUFFIX: &str = ".layer.json";

/// Encodes a class as part of a file name. Different classes get different names.
fn file_name(class: &str) -> String {
    let mut name = String::new();
    for c in class.chars() {
        let mut bytes = [0; 4];
        match c {
            _ if c.is_alphanumeric() || "-_.".contains(c) => name.push(c),
            _ => c.encode_utf8(&mut bytes).bytes().for_each(|byte| name += &format!("%{byte:02X}")),
        }
    }
    name
}

#[cfg(test)]
mod tests {
    use super::file_name;

    #[test]
    fn classes_keep_names_of_their_own() {
        let classes = ["a/b", "a_b", "a%2Fb", "a b", "..", "r\u{e4}dar", "a\u{2028}b"];
        let names = classes.map(file_name);
        assert_eq!(names, ["a%2Fb", "a_b", "a%252Fb", "a%20b", "..", "r\u{e4}dar", "a%E2%80%A8b"]);
    }
}
