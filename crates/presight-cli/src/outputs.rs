//! Output files of a command. Before any is written, they are checked against the input files and against each other.

use presight::files::files_named_by;
use presight::tools::{is_given, target_of};
use presight::{Error, Result};
use same_file::Handle;
use std::collections::HashMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// The output files of a command.
#[derive(Debug, Default)]
pub struct OutputFiles {
    /// Values are names for messages, such as `--out a.exr`.
    by_file: HashMap<FileId, String>,
    by_place: HashMap<PathBuf, String>,
    folders: Folders,
}

impl OutputFiles {
    /// Adds the file of a command line option. Its name must have one of the endings, unless it is a device or pipe.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] for `-`, another ending, or a file that has already been added.
    pub fn add(&mut self, option: &str, path: Option<&Path>, endings: &[&str]) -> Result<()> {
        let Some(path) = path else { return Ok(()) };
        let name = format!("{option} {}", path.display());
        if path == Path::new("-") {
            return Err(Error::usage(format!("{name}: not a file name"), "use /dev/stdout to write to stdout"));
        }
        let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        let free = is_given(path) || fs::metadata(path).is_ok_and(|m| !m.is_file());
        if !free && !endings.iter().any(|e| e.eq_ignore_ascii_case(ending)) {
            let all = |before: &str| endings.iter().map(|e| format!("{before}.{e}")).collect::<Vec<_>>().join(" or ");
            let (what, remedy) =
                (format!("{name}: {option} writes {}", all("")), format!("end the name in {}", all("")));
            return Err(Error::usage(what, remedy));
        }
        self.add_named(name, path)
    }

    /// Adds a file with any ending: a store, or a file in an output folder.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] for a file that has already been added.
    pub fn add_any(&mut self, path: &Path) -> Result<()> {
        self.add_named(path.display().to_string(), path)
    }

    /// Adds the files that a command writes into an output folder.
    ///
    /// # Errors
    /// As [`OutputFiles::add_any`], and for `-`.
    pub fn add_folder(&mut self, folder: &Path, names: &[&str]) -> Result<()> {
        check_no_dash(folder)?;
        names.iter().try_for_each(|name| self.add_any(&folder.join(name)))
    }

    fn add_named(&mut self, name: String, path: &Path) -> Result<()> {
        let identity = Identity::of(path, &mut self.folders)?;
        if let Some(other) = self.find(&identity) {
            let what = format!("{name}: the same file as {other}");
            return Err(Error::usage(what, "give each its own file"));
        }
        self.by_file.extend(identity.file.map(|file| (file, name.clone())));
        self.by_place.extend(identity.place.map(|place| (place, name)));
        Ok(())
    }

    /// The name of the output with this identity.
    fn find(&self, identity: &Identity) -> Option<&String> {
        let by_file = identity.file.as_ref().and_then(|file| self.by_file.get(file));
        by_file.or_else(|| identity.place.as_ref().and_then(|place| self.by_place.get(place)))
    }

    /// Checks that no output is one of these input files, or is named by one that is a sensor or robot file.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] naming the output and the input.
    pub fn check_named<'a>(&self, inputs: impl IntoIterator<Item = &'a Path>) -> Result<()> {
        for input in inputs.into_iter().flat_map(|path| std::iter::once(path.to_owned()).chain(files_named_by(path))) {
            let identity = Identity::of(&input, &mut Folders::new())?;
            if let Some(output) = self.find(&identity) {
                let what = format!("{output}: this would overwrite {}, an input file", input.display());
                return Err(Error::usage(what, "write elsewhere"));
            }
        }
        Ok(())
    }

    /// Checks before the first write that no output is a file of a scene. Consumes `self` to close its handles: some
    /// systems cannot replace an open file.
    ///
    /// # Errors
    /// As [`OutputFiles::check_named`].
    pub fn check_scene(self, files: &[PathBuf]) -> Result<()> {
        if self.by_file.is_empty() && self.by_place.is_empty() {
            return Ok(());
        }
        // No store may be open here: closing any handle to its file drops this process's locks on it.
        self.check_named(files.iter().map(PathBuf::as_path))
    }
}

/// Refuses `-` as the name of a store or folder, which cannot be written to stdout.
///
/// # Errors
/// [`presight::ErrorKind::Usage`] for `-`.
pub fn check_no_dash(path: &Path) -> Result<()> {
    if path == Path::new("-") {
        let remedy = "name a file or folder: ./- if that is its name, /dev/stdout to write a single file";
        return Err(Error::usage("-: cannot write a store or folder to stdout", remedy));
    }
    Ok(())
}

/// The file behind a path, independent of spelling and links. Both fields are `None` for devices, pipes and folders.
#[derive(Debug)]
struct Identity {
    /// Set if the file exists and is readable.
    file: Option<FileId>,
    /// Set otherwise: the path with links resolved.
    place: Option<PathBuf>,
}

/// Folders with links resolved, by the path as given.
type Folders = HashMap<PathBuf, PathBuf>;

impl Identity {
    fn of(path: &Path, folders: &mut Folders) -> Result<Self> {
        match fs::metadata(path) {
            // Existing files are compared by id because of hard links. An unreadable file cannot be an input.
            Ok(metadata) if metadata.is_file() => match id_of(path) {
                Ok(file) => Ok(Self { file: Some(file), place: None }),
                Err(e) if e.kind() == io::ErrorKind::PermissionDenied => {
                    Ok(Self { file: None, place: fs::canonicalize(path).ok() })
                }
                Err(e) => Err(Error::io(path, "open it", e)),
            },
            Ok(_) => Ok(Self { file: None, place: None }),
            Err(_) => Ok(Self { file: None, place: new_place(path, folders) }),
        }
    }
}

/// Device and inode. Unlike a [`Handle`] they keep no file open: the number of open files is limited.
#[cfg(unix)]
type FileId = (u64, u64);

#[cfg(unix)]
fn id_of(path: &Path) -> io::Result<FileId> {
    Handle::from_path(path).map(|file| (file.dev(), file.ino()))
}

#[cfg(not(unix))]
type FileId = Handle;

#[cfg(not(unix))]
fn id_of(path: &Path) -> io::Result<FileId> {
    Handle::from_path(path)
}

/// The resolved path at which a new file would be created.
fn new_place(path: &Path, folders: &mut Folders) -> Option<PathBuf> {
    let target = std::path::absolute(target_of(path).ok()?).ok()?;
    let (folder, name) = (target.parent()?, target.file_name()?);
    // Cache the folders: many files go into few folders.
    if !folders.contains_key(folder) {
        let real = fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
        folders.insert(folder.to_owned(), real);
    }
    Some(folders.get(folder)?.join(name))
}
