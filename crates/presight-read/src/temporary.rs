//! Temporary files in the folder of the final file: locked while written, and removed if a killed process leaves them.

use presight_model::clock::{self, Instant};
use presight_model::error::{self, Error, ErrorKind};
use std::collections::{BTreeSet, HashMap};
use std::ffi::OsStr;
use std::fs::{self, DirEntry, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Duration;
use tempfile::NamedTempFile;

const PREFIX: &str = ".presight-";
const SUFFIX: &str = ".part";
/// Letters and digits between prefix and suffix.
const RANDOM: usize = 6;

/// A younger file may belong to a process that has not locked it yet. Also the least time between searches of a folder.
const MINUTE: Duration = Duration::from_secs(60);

/// The files that this process is writing. While the mutex is locked, none is created or renamed.
static LIVE: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Who may read a new file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Everybody whom the user's umask allows.
    Umask,
    /// Only the user.
    Private,
}

/// A temporary file; removed when it is dropped.
pub struct Temporary {
    // Fields drop in this order: the file is removed before it leaves the list.
    file: NamedTempFile,
    _listed: ListedFile,
}

/// A file in [`LIVE`].
struct ListedFile(PathBuf);

impl Drop for ListedFile {
    fn drop(&mut self) {
        lock(&LIVE).remove(&self.0);
    }
}

impl Temporary {
    /// Creates a file in a folder, after removing temporary files that killed processes left there.
    ///
    /// # Errors
    /// The system's error, without the file's name.
    pub fn new(folder: &Path, access: Access) -> io::Result<Self> {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        remove_left_behind(folder);
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX).suffix(SUFFIX).rand_bytes(RANDOM);
        let mut live = lock(&LIVE);
        let file = builder.make_in(folder, |path| create(path, access))?;
        // Where files cannot be locked, no other process can lock and remove this one.
        let _ = file.as_file().lock();
        let path = file.path().to_owned();
        live.insert(path.clone());
        Ok(Self { file, _listed: ListedFile(path) })
    }

    /// The path of the temporary file.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// The open file.
    pub fn file(&mut self) -> &mut File {
        self.file.as_file_mut()
    }

    /// Renames the file to its final name and replaces a file of that name.
    pub fn keep_as(self, path: &Path) -> io::Result<()> {
        self.keep(|file| file.persist(path))
    }

    /// Renames the file to its final name; fails if that name exists.
    pub fn keep_as_new(self, path: &Path) -> io::Result<()> {
        self.keep(|file| file.persist_noclobber(path))
    }

    fn keep(self, rename: impl FnOnce(NamedTempFile) -> Result<File, tempfile::PersistError>) -> io::Result<()> {
        let Self { file, _listed } = self;
        let kept = {
            // Blocks while [`abandon`] ends the process.
            let _live = lock(&LIVE);
            rename(file)
        };
        // Dropping the error removes a file that could not be renamed.
        kept.map(drop).map_err(|e| e.error)
    }
}

fn create(path: &Path, access: Access) -> io::Result<File> {
    let mut options = File::options();
    options.read(true).write(true).create_new(true);
    #[cfg(unix)]
    {
        let mode = if access == Access::Private { 0o600 } else { 0o666 };
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
    }
    #[cfg(not(unix))]
    let _ = access;
    options.open(path)
}

/// Creates an output folder and checks that it is writable, so that a program fails before minutes of work, not after.
///
/// # Errors
/// [`ErrorKind::System`] naming the folder, whatever the cause: no input file is at fault.
pub fn create_folder(folder: &Path) -> error::Result<()> {
    let refused = |what: &str, e: io::Error| {
        let what = format!("cannot {what}: {e}");
        Error::new(ErrorKind::System, what, "choose another folder").in_file(folder).caused_by(e)
    };
    fs::create_dir_all(folder).map_err(|e| refused("create the folder", e))?;
    Temporary::new(folder, Access::Private).map(drop).map_err(|e| refused("write into the folder", e))
}

/// Does a short piece of work that [`abandon`] waits for, so that no signal ends the process in its middle.
pub(crate) fn undisturbed<T>(work: impl FnOnce() -> T) -> T {
    let _live = lock(&LIVE);
    work()
}

/// Removes the files that this process is writing, because it is about to end. While the returned guard lives, no file
/// is created or gets its final name.
pub fn abandon() -> impl Sized {
    /// How long to wait for the renaming of a file before the process ends anyway.
    const PATIENCE: Duration = Duration::from_secs(2);
    let start = Instant::now();
    let live = loop {
        match LIVE.try_lock() {
            Ok(live) => break Some(live),
            Err(TryLockError::Poisoned(e)) => break Some(e.into_inner()),
            Err(TryLockError::WouldBlock) if start.elapsed() > PATIENCE => break None,
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(1)),
        }
    };
    for path in live.iter().flat_map(|live| live.iter()) {
        // The process ends: nobody could read an error.
        let _ = fs::remove_file(path);
    }
    live
}

/// Removes temporary files of killed processes: files with our name that are over a minute old and not locked.
fn remove_left_behind(folder: &Path) {
    /// The last search of each folder: a folder may hold very many files.
    static SEARCHED: LazyLock<Mutex<HashMap<PathBuf, Instant>>> = LazyLock::new(Mutex::default);
    const FOLDERS: usize = 1000;
    {
        let mut searched = lock(&SEARCHED);
        if searched.get(folder).is_some_and(|at| at.elapsed() <= MINUTE) {
            return;
        }
        if searched.len() >= FOLDERS {
            searched.clear();
        }
        searched.insert(folder.to_owned(), Instant::now());
    }
    // A later process may succeed, so errors are ignored.
    for entry in fs::read_dir(folder).into_iter().flatten().flatten().filter(|e| is_ours(&e.file_name())) {
        if let Some(_held) = left_behind(&entry) {
            let _ = fs::remove_file(entry.path());
        }
    }
}

fn is_ours(name: &OsStr) -> bool {
    let random = name.to_str().and_then(|n| n.strip_prefix(PREFIX)).and_then(|n| n.strip_suffix(SUFFIX));
    random.is_some_and(|r| r.len() == RANDOM && r.bytes().all(|b| b.is_ascii_alphanumeric()))
}

/// Locks and returns the file if it is old and no other process has locked it.
fn left_behind(entry: &DirEntry) -> Option<File> {
    let metadata = entry.metadata().ok()?;
    let age = clock::age(metadata.modified().ok()?)?;
    if !metadata.is_file() || age <= MINUTE {
        return None;
    }
    let file = File::open(entry.path()).ok()?;
    file.try_lock().ok()?;
    Some(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::SystemTime;

    fn names_in(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn aged(path: &Path, seconds: u64) -> File {
        let file = File::create(path).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(seconds)).unwrap();
        file
    }

    #[test]
    fn only_what_is_ours_old_and_held_by_nobody_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        aged(&at(".presight-gone00.part"), 70);
        aged(&at(".presight-young0.part"), 50);
        let held = aged(&at(".presight-held00.part"), 70);
        held.lock().unwrap();
        let others = [
            ".presight-short.part",
            ".presight-longer7.part",
            ".presight-a-b-c-.part",
            "presight-other0.part",
            "a.part",
        ];
        others.iter().for_each(|name| drop(aged(&at(name), 7000)));
        fs::create_dir(at(".presight-folder.part")).unwrap();
        let mut expected = vec![".presight-folder.part", ".presight-held00.part", ".presight-young0.part"];
        expected.extend(others);
        expected.sort_unstable();
        drop(Temporary::new(folder.path(), Access::Umask).unwrap());
        assert_eq!(names_in(folder.path()), expected);
    }

    #[test]
    fn a_file_is_held_while_it_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let mut temporary = Temporary::new(folder.path(), Access::Umask).unwrap();
        let path = temporary.path().to_owned();
        let [name] = names_in(folder.path()).try_into().unwrap();
        assert!(is_ours(OsStr::new(&name)), "{name}");
        temporary.file().set_modified(SystemTime::now() - Duration::from_secs(7000)).unwrap();
        assert!(File::open(&path).unwrap().try_lock().is_err());
        assert!(lock(&LIVE).contains(&path));
        temporary.keep_as(&folder.path().join("kept")).unwrap();
        assert_eq!(names_in(folder.path()), ["kept"]);
        assert!(!lock(&LIVE).contains(&path));
        File::open(folder.path().join("kept")).unwrap().try_lock().unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn links_are_never_followed_to_what_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join(".presight-link00.part"));
        aged(&file, 7000);
        std::os::unix::fs::symlink(&file, &link).unwrap();
        drop(Temporary::new(folder.path(), Access::Umask).unwrap());
        assert_eq!(names_in(folder.path()), [".presight-link00.part", "file"]);
    }

    #[test]
    fn errors_do_not_tell_the_temporary_name() {
        let folder = tempfile::tempdir().unwrap();
        let e = Temporary::new(&folder.path().join("none"), Access::Umask).err().unwrap();
        assert_eq!(e.kind(), io::ErrorKind::NotFound);
        assert!(!e.to_string().contains("presight"), "{e}");
    }
}
