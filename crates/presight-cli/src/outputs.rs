//! The files that a command is going to write, compared with all that it reads and with each other before it writes any.

use presight::{Error, Result};
use presight_files::atomic::{is_given, target_of};
use presight_files::inputs;
use same_file::Handle;
use std::collections::HashMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Files to be written.
#[derive(Debug, Default)]
pub struct OutputFiles {
    /// As messages call them, such as `--out a.exr`.
    by_file: HashMap<FileId, String>,
    by_place: HashMap<PathBuf, String>,
    folders: Folders,
}

impl OutputFiles {
    /// None; from now on it is noted what is read.
    pub fn new() -> Self {
        inputs::record();
        Self::default()
    }

    /// Adds a file that is named on the command line and holds a format, by the option and the endings of names that the
    /// format has. Devices and pipes take any name.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] for `-`, another ending, or a file that is among these already.
    pub fn add(&mut self, option: &str, path: Option<&Path>, endings: &[&str]) -> Result<()> {
        let Some(path) = path else { return Ok(()) };
        let name = format!("{option} {}", path.display());
        if path == Path::new("-") {
            return Err(Error::usage(format!("{name}: this is no name of a file"), "/dev/stdout writes to stdout"));
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

    /// Adds a file that is bound to no ending: a store, or what a command writes into a folder.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] for a file that is among these already.
    pub fn add_any(&mut self, path: &Path) -> Result<()> {
        self.add_named(path.display().to_string(), path)
    }

    /// Adds what a command will write into a folder that is named on the command line.
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
            return Err(Error::usage(what, "give each a file of its own"));
        }
        self.by_file.extend(identity.file.map(|file| (file, name.clone())));
        self.by_place.extend(identity.place.map(|place| (place, name)));
        Ok(())
    }

    /// The output that is this file.
    fn find(&self, identity: &Identity) -> Option<&String> {
        let by_file = identity.file.as_ref().and_then(|file| self.by_file.get(file));
        by_file.or_else(|| identity.place.as_ref().and_then(|place| self.by_place.get(place)))
    }

    /// That none is a file that will be read: before any work.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] naming both.
    pub fn check_named<'a>(&self, inputs: impl IntoIterator<Item = &'a Path>) -> Result<()> {
        for input in inputs {
            let identity = Identity::of(input, &mut Folders::new())?;
            if let Some(output) = self.find(&identity) {
                let what = format!("{output}: this would overwrite {}, which is read", input.display());
                return Err(Error::usage(what, "write elsewhere"));
            }
        }
        Ok(())
    }

    /// That none is a file that was read, by whatever included it: before the first is written. They are given up here: some
    /// systems replace no file that is open.
    ///
    /// # Errors
    /// As [`OutputFiles::check_named`].
    pub fn check_read(self) -> Result<()> {
        if self.by_file.is_empty() && self.by_place.is_empty() {
            return Ok(());
        }
        // No store is open now: whoever closes one, even a second time, gives up this process's locks on it.
        self.check_named(inputs::so_far().iter().map(PathBuf::as_path))
    }
}

/// That a store or a folder, which no format binds to an ending, is not meant to be stdout.
///
/// # Errors
/// [`presight::ErrorKind::Usage`] for `-`.
pub fn check_no_dash(path: &Path) -> Result<()> {
    if path == Path::new("-") {
        let remedy = "name a file or folder; ./- if that is its name, and /dev/stdout where one file is written";
        return Err(Error::usage("-: stdout takes no store and no folder", remedy));
    }
    Ok(())
}

/// Which file a path leads to, however it is spelled. Nothing for devices, pipes and folders.
#[derive(Debug)]
struct Identity {
    /// If it is there and may be read.
    file: Option<FileId>,
    /// Folder and name without links.
    place: Option<PathBuf>,
}

/// Folders without links, by how they are given.
type Folders = HashMap<PathBuf, PathBuf>;

impl Identity {
    fn of(path: &Path, folders: &mut Folders) -> Result<Self> {
        match fs::metadata(path) {
            // Two that are there at different places may be one; one that cannot be read was not read.
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

/// Device and inode: without open files, of which there may be few.
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

/// Where a file would come to be.
fn new_place(path: &Path, folders: &mut Folders) -> Option<PathBuf> {
    let target = std::path::absolute(target_of(path).ok()?).ok()?;
    let (folder, name) = (target.parent()?, target.file_name()?);
    // Many files go into few folders.
    if !folders.contains_key(folder) {
        let real = fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
        folders.insert(folder.to_owned(), real);
    }
    Some(folders.get(folder)?.join(name))
}
