//! Temporary files beside the files that they become: locked while they are written, removed when they are left behind.

use std::collections::{BTreeSet, HashMap};
use std::ffi::OsStr;
use std::fs::{self, DirEntry, File};
use std::io;
use std::path::{Path, PathBuf};
#[cfg(unix)]
use std::sync::TryLockError;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tempfile::NamedTempFile;

const PREFIX: &str = ".presight-";
const SUFFIX: &str = ".part";
/// Letters and digits between prefix and suffix.
const RANDOM: usize = 6;

/// Files younger than this may be of a process that has not locked them yet; folders are searched no more often.
const MINUTE: Duration = Duration::from_secs(60);

/// The files that this process is writing. Whoever holds the lock keeps them as they are.
static LIVE: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Who may read a new file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Whoever the user's umask lets.
    Umask,
    /// The user alone.
    Private,
}

/// A temporary file; removed when it is dropped.
pub struct Temporary {
    // Dropped in this order.
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
    /// A new file in a folder. What was left behind there is removed first.
    ///
    /// # Errors
    /// The system's own, without the file's name.
    pub fn new(folder: &Path, access: Access) -> io::Result<Self> {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        remove_left_behind(folder);
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX).suffix(SUFFIX).rand_bytes(RANDOM);
        let mut live = lock(&LIVE);
        let file = builder.make_in(folder, |path| create(path, access))?;
        // Where files cannot be locked, nobody takes this one for left behind either.
        let _ = file.as_file().lock();
        let path = file.path().to_owned();
        live.insert(path.clone());
        Ok(Self { file, _listed: ListedFile(path) })
    }

    /// Where it is.
    #[cfg(any(feature = "store", test))]
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// The open file.
    pub fn file(&mut self) -> &mut File {
        self.file.as_file_mut()
    }

    /// Gives it its final name, in the place of what has that name.
    pub fn keep_as(self, path: &Path) -> io::Result<()> {
        self.keep(|file| file.persist(path))
    }

    /// Gives it its final name, unless something has that name.
    #[cfg(feature = "store")]
    pub fn keep_as_new(self, path: &Path) -> io::Result<()> {
        self.keep(|file| file.persist_noclobber(path))
    }

    fn keep(self, rename: impl FnOnce(NamedTempFile) -> Result<File, tempfile::PersistError>) -> io::Result<()> {
        let Self { file, _listed } = self;
        let kept = {
            // Not while the process is about to end.
            let _live = lock(&LIVE);
            rename(file)
        };
        // What failed is removed with the error's file.
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

/// Removes what this process is writing. While the answer lives, no other file is begun and none gets its final name: it is
/// for a process that is about to end.
#[cfg(unix)]
pub fn abandon() -> impl Sized {
    /// How long a file system may take to rename a file before the process ends all the same.
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
        // Nobody is left who could be told.
        let _ = fs::remove_file(path);
    }
    live
}

/// Removes files of our name that nobody holds and that are over a minute old: those of processes that were killed.
fn remove_left_behind(folder: &Path) {
    /// When folders were searched. A folder may hold very many files.
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
    // Who cannot list or remove leaves it to the next.
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

/// The file, locked, if it is old and nobody else holds it.
fn left_behind(entry: &DirEntry) -> Option<File> {
    let metadata = entry.metadata().ok()?;
    let age = metadata.modified().ok()?.elapsed().ok()?;
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
