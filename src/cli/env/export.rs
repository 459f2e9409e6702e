//! `presight env export`: a store as a scene with layer files.

use crate::cli::print;
use crate::environment::FeatureLayer;
use crate::error::{Error, ErrorKind, Result};
use crate::io::gltf::write_glb;
use crate::io::{layer, store};
use std::path::{Path, PathBuf};

/// Write a store as glTF with layer files, which create and import read back without loss
///
/// A folder gets scene.glb and CLASS.layer.json; beside FILE.glb layers are FILE.CLASS.layer.json. In CLASS, what is no letter,
/// digit, - _ or . is written as %XX. The log stays behind, and so do numbers of objects, ids of deleted features, and objects
/// without polygons; a store without any polygon is refused, for no scene is read without one.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,

    /// A folder, made where there is none, or a file that ends in .glb
    #[arg(value_name = "DIR|FILE.glb")]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// Those of reading the store and writing the files.
pub fn run(args: &Args) -> Result<()> {
    let environment = store::read(&args.store)?;
    let is_file = args.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb"));
    let (scene, prefix) = match is_file {
        true => (args.out.clone(), format!("{}.", args.out.file_stem().unwrap_or_default().display())),
        false => {
            std::fs::create_dir_all(&args.out).map_err(|e| {
                let remedy = "check the permissions, or write elsewhere";
                let what = format!("cannot make the folder: {e}");
                Error::new(ErrorKind::System, what, remedy).in_file(&args.out).caused_by(e)
            })?;
            (args.out.join("scene.glb"), String::new())
        }
    };
    let folder = scene.parent().unwrap_or(Path::new(""));
    let full = |l: &&FeatureLayer| !(l.features.is_empty() && l.pose_covariances.is_empty());
    let mut files: Vec<(PathBuf, &FeatureLayer)> = Vec::new();
    for own in environment.layers().iter().filter(full) {
        files.push((folder.join(format!("{prefix}{}.layer.json", file_name(&own.class))), own));
    }
    write_glb(&scene, &environment).map_err(|e| e.in_file(&args.store))?;
    for (path, own) in &files {
        layer::write(path, own)?;
    }
    let mut lines = format!("{}\n", scene.display());
    files.iter().for_each(|(path, _)| lines += &format!("{}\n", path.display()));
    print::data(&lines)
}

/// A class as a part of a file's name; no two have the same.
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
