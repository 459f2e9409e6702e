//! The target of an edited layer: a layer file with a journal of the steps that are not saved yet, or a store.

use super::answer::Answer;
use super::session::{Session, SessionOptions, by_id};
use presight::environment::{DEFAULT_TOLERANCE, Environment, IndexKind};
use presight::features::{Feature, FeatureLayer};
use presight::files::{self, LayerFile, layer_fields};
use presight::store::{Note, Store, feature_line};
use presight::tools::{self, write_atomically};
use presight::{Change, Error, ErrorKind, Result};
use serde::Deserialize;
use serde_json::value::RawValue;
use std::collections::{HashMap, HashSet};
use std::fs::{File, TryLockError};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

/// The first bytes of an SQLite file.
const SQLITE: &[u8; 16] = b"SQLite format 3\0";

/// What the page calls the steps of an editor in a store's log.
const CAUSE: &str = "edit";

/// Asks to write the layer.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SaveRequest {
    #[serde(rename = "version")]
    _version: u64,
    /// Another name for the file, in the same folder.
    name: Option<String>,
}

/// Takes or drops the steps of an earlier session.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RestoreRequest {
    #[serde(rename = "version")]
    _version: u64,
    /// True to take them.
    pub keep: bool,
}

/// The target of a layer.
#[derive(Clone, Debug)]
pub enum Target {
    /// A store, with the length of its log.
    Store { path: PathBuf, changes: u64 },
    /// A layer file, with its text as it was read or written last; `None` for one that does not exist yet.
    File { path: PathBuf, text: Option<String> },
}

impl Target {
    /// The file of `options.layer`; else a store's own layer; else a new file named after scene and class.
    pub fn of(scene: &Path, options: &SessionOptions, class: &str) -> Result<Self> {
        if let Some(path) = &options.layer {
            return Ok(Self::File { path: path.clone(), text: Some(read(path)?) });
        }
        let is_store = scene.extension().is_some_and(|e| e.eq_ignore_ascii_case("presight"));
        if is_store || tools::file_starts_with(scene, SQLITE) {
            return Ok(Self::Store { path: scene.to_owned(), changes: changes_of(scene)? });
        }
        let stem = scene.file_stem().unwrap_or_default().to_string_lossy();
        let plain = |c: char| if c.is_alphanumeric() || "-_ ".contains(c) { c } else { '_' };
        let class: String = class.chars().map(plain).collect();
        let free = |n: u32| {
            let number = if n == 1 { String::new() } else { format!("-{n}") };
            options.folder.join(format!("{stem}{number}.{class}.layer.json"))
        };
        let path = (1..).map(free).find(|path| !path.exists()).unwrap_or_else(|| free(1));
        Ok(Self::File { path, text: None })
    }

    /// The file's name, for the page.
    pub fn in_words(&self) -> String {
        match self {
            Self::Store { path, .. } | Self::File { path, .. } => path.display().to_string(),
        }
    }

    /// False for a file that does not exist yet.
    pub fn is_named(&self) -> bool {
        !matches!(self, Self::File { text: None, .. })
    }

    /// True for a store.
    pub fn is_store(&self) -> bool {
        matches!(self, Self::Store { .. })
    }
}

fn read(path: &Path) -> Result<String> {
    let bytes = tools::read_file(tools::open_file(path)?, path, tools::MAX_FILE_BYTES)?;
    String::from_utf8(bytes).map_err(|_| Error::invalid("it is not UTF-8", "write it as UTF-8 text").in_file(path))
}

fn changes_of(path: &Path) -> Result<u64> {
    let mut last = 0;
    presight::store::log(path, |entry| {
        last = entry.number;
        Ok(())
    })?;
    Ok(last)
}

/// The change that puts a layer file over the layer of an environment.
pub fn merging(environment: &Environment, file: &LayerFile) -> Change {
    let LayerFile { layer, removed, .. } = file;
    let class = || layer.class.clone();
    let own = environment.layer(&layer.class);
    let there = |id: u32| environment.feature(&layer.class, id).is_some();
    let tolerance = own.map_or(layer.tolerance, |own| own.tolerance.max(layer.tolerance));
    let mut changes = vec![Change::SetTolerance { class: class(), tolerance }];
    changes.extend(removed.iter().filter(|id| there(**id)).map(|id| Change::DeleteFeature { class: class(), id: *id }));
    changes.extend(layer.features.iter().map(|feature| {
        let feature = Feature::clone(feature);
        match there(feature.id) {
            true => Change::SetFeature { class: class(), feature },
            // An earlier version of a store's layer may have had the id.
            false => Change::RestoreFeature { class: class(), feature },
        }
    }));
    changes.extend(layer.pose_covariances.iter().map(|(object, covariance)| Change::SetPoseCovariance {
        class: class(),
        object: object.clone(),
        covariance: Some(*covariance),
    }));
    Change::Group(changes)
}

/// The steps since the layer was saved, as lines of `presight env apply` in a file next to it.
#[derive(Debug, Default)]
pub struct Journal {
    /// `None` for stores.
    path: Option<PathBuf>,
    file: Option<File>,
    /// The cause of its first line.
    cause: String,
    /// The steps of a session that ended before it saved.
    offered: Vec<String>,
    /// True if the layer is the one that these steps were made to.
    fits: bool,
    replays: bool,
}

impl Journal {
    /// Opens what an earlier session left.
    pub fn open(target: &Target) -> Result<Self> {
        let Target::File { path, text } = target else { return Ok(Self::default()) };
        let mut name = path.clone().into_os_string();
        name.push(".edits");
        let path = &PathBuf::from(name);
        let mut journal = Self { path: Some(path.clone()), cause: cause_of(text.as_deref()), ..Self::default() };
        let mut file = match File::options().read(true).append(true).open(path) {
            Ok(file) => file,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(journal),
            Err(e) => return Err(Error::io(path, "open it", e)),
        };
        lock(&file, path)?;
        let mut text = String::new();
        let limit = tools::MAX_FILE_BYTES;
        let size = Read::by_ref(&mut file)
            .take(limit + 1)
            .read_to_string(&mut text)
            .map_err(|e| Error::io(path, "read it", e))?;
        if size as u64 > limit {
            return Err(Error::invalid("it is too large", "move it away").in_file(path));
        }
        // A line that was cut short was not acknowledged.
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        let mut lines = text[..whole].lines().map(str::to_owned);
        journal.fits = lines.next().is_some_and(|first| first == header(&journal.cause));
        journal.offered = lines.collect();
        if whole < text.len() {
            file.set_len(whole as u64).map_err(|e| Error::io(path, "write it", e))?;
        }
        if journal.offered.is_empty() {
            remove(path)?;
        } else {
            journal.file = Some(file);
        }
        Ok(journal)
    }

    /// True while steps of an earlier session wait for a decision.
    pub fn offers(&self) -> bool {
        !self.offered.is_empty()
    }

    /// The steps that wait, as the page lists them.
    pub fn offered(&self) -> Option<serde_json::Value> {
        self.offers().then(|| serde_json::json!({ "steps": self.offered.len(), "fits": self.fits }))
    }

    /// The steps, which are then no longer offered.
    pub fn take_offered(&mut self) -> Vec<String> {
        std::mem::take(&mut self.offered)
    }

    /// Offers them again.
    pub fn offer(&mut self, lines: Vec<String>) {
        self.offered = lines;
    }

    /// While steps are replayed they are not written a second time.
    pub fn replays(&mut self, replays: bool) {
        self.replays = replays;
    }

    /// Adds a step. A killed process loses none.
    fn append(&mut self, change: &Change) -> Result<()> {
        let Some(path) = self.path.as_ref().filter(|_| !self.replays) else { return Ok(()) };
        let wrap = |e| Error::io(path, "write it", e);
        if self.file.is_none() {
            let file = File::options().append(true).create_new(true).open(path).map_err(|e| match e.kind() {
                std::io::ErrorKind::AlreadyExists => busy(path),
                _ => wrap(e),
            })?;
            lock(&file, path)?;
            let file = self.file.insert(file);
            file.write_all(format!("{}\n", header(&self.cause)).as_bytes()).map_err(wrap)?;
        }
        let line = format!("{}\n", feature_line(change)?);
        let Some(file) = &mut self.file else { return Ok(()) };
        let before = file.metadata().map_err(wrap)?.len();
        file.write_all(line.as_bytes()).map_err(|e| {
            // Half a line would join the next one.
            let _nothing_more_can_be_done = file.set_len(before);
            wrap(e)
        })
    }

    /// Removes the file: its steps are saved, or dropped.
    pub fn clear(&mut self) -> Result<()> {
        self.offered.clear();
        match (self.file.take(), &self.path) {
            (Some(_), Some(path)) => remove(path),
            _ => Ok(()),
        }
    }
}

fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io(path, "remove it", e)),
        _ => Ok(()),
    }
}

/// The first line of a journal: an empty change, which names the layer file it starts from.
fn header(cause: &str) -> String {
    serde_json::json!({ "op": "group", "changes": [], "cause": cause }).to_string()
}

fn cause_of(text: Option<&str>) -> String {
    match text {
        Some(text) => format!("{CAUSE} of {}", blake3::hash(text.as_bytes()).to_hex()),
        None => format!("{CAUSE} of a new layer"),
    }
}

fn lock(file: &File, path: &Path) -> Result<()> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(busy(path)),
        Err(TryLockError::Error(e)) => Err(Error::io(path, "lock it", e)),
    }
}

fn busy(path: &Path) -> Error {
    let remedy = "close that editor, or edit a copy of the layer";
    Error::new(ErrorKind::System, "another editor has this layer open", remedy).in_file(path)
}

impl Session {
    /// Keeps a step: in the store, or in the journal.
    pub(crate) fn keep(&mut self, change: &Change, label: &str) -> Result<()> {
        let Target::Store { path, changes } = &mut self.target else { return self.journal.append(change) };
        let mut store = Store::open_with_index(path, &IndexKind::None)?;
        if store.changes() != *changes {
            self.stale = true;
            let what = "another program has changed the store, which is read again";
            return Err(Error::new(ErrorKind::System, what, "repeat the step").in_file(path));
        }
        let seconds = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64());
        let cause = if label.is_empty() { CAUSE.to_owned() } else { format!("{CAUSE}: {label}") };
        let mut batch = store.batch()?;
        // The session has checked where its features lie.
        batch.apply_unchecked(change.clone(), &Note::new(cause, seconds))?;
        batch.commit()?;
        *changes = store.changes();
        Ok(())
    }

    /// Reads a store again that another program has changed.
    pub(crate) fn read_again(&mut self) -> Result<()> {
        let Target::Store { path, changes } = &mut self.target else { return Ok(()) };
        let kind = self.world.index().kind();
        let world = presight::store::read_world(path, &kind)?;
        *changes = changes_of(path)?;
        self.reload(world)
    }

    /// Writes the layer, and returns a sentence for the page.
    pub(crate) fn save(&mut self, request: &SaveRequest) -> Result<String> {
        let now = by_id(&self.world, &self.class);
        let Target::File { path, text } = &self.target else { return Ok("every step is stored already".into()) };
        if self.journal.offers() {
            return Err(Error::usage("steps of an earlier session are offered", "restore or drop them first"));
        }
        if now == self.saved && request.name.is_none() {
            self.journal.clear()?;
            return Ok("nothing to save".into());
        }
        let to = match &request.name {
            Some(name) => named(path, name)?,
            None => path.clone(),
        };
        let is_same = to == *path && text.is_some();
        check_unchanged(&to, text.as_deref().filter(|_| is_same))?;
        let tolerance = self.tolerance();
        let empty =
            || files::layer_to_string(&FeatureLayer { class: self.class.clone(), tolerance, ..Default::default() });
        let base = text.clone().map_or_else(empty, Ok)?;
        let written =
            spliced(&base, &Versions { saved: &self.saved, now: &now, own: &self.own, next: self.next_id, tolerance })
                .map_err(|e| e.in_file(path))?;
        write_atomically(&to, |file| file.write_all(written.as_bytes()))?;
        self.journal.clear()?;
        let target = Target::File { path: to.clone(), text: Some(written) };
        self.journal = Journal::open(&target)?;
        (self.target, self.saved) = (target, now);
        Ok(format!("saved {}", to.display()))
    }
}

/// A file of that name in the folder of the layer.
fn named(path: &Path, name: &str) -> Result<PathBuf> {
    let remedy = "give a plain name that ends in .json; it is written into the layer's folder";
    let plain = !name.contains(['/', '\\', '\0', ':']) && !name.starts_with(['.', '-']) && name.len() <= 200;
    if !plain || !name.ends_with(".json") {
        return Err(Error::usage(format!("{name:?} is not a name for a layer file"), remedy));
    }
    Ok(path.with_file_name(name))
}

/// Refuses to overwrite a file that this session has not read or written in this form.
fn check_unchanged(path: &Path, text: Option<&str>) -> Result<()> {
    let on_disk = match std::fs::metadata(path) {
        Ok(_) => Some(read(path)?),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => None,
        Err(e) => return Err(Error::io(path, "read it", e)),
    };
    let what = match (on_disk.as_deref(), text) {
        (now, before) if now == before => return Ok(()),
        (Some(_), None) => "the file exists already",
        (None, _) => "the file was deleted while it was open",
        (Some(_), Some(_)) => "another program has changed the file since it was read",
    };
    Err(Error::usage(what, "save under another name; no file is overwritten").in_file(path))
}

/// The saved layer, the present one, the scene's own, the first id that was never used, and the present tolerance.
struct Versions<'a> {
    saved: &'a HashMap<u32, Arc<Feature>>,
    now: &'a HashMap<u32, Arc<Feature>>,
    own: &'a HashMap<u32, Arc<Feature>>,
    next: u32,
    tolerance: f64,
}

/// The text of a layer file with the present features. Untouched entries keep their bytes and their order. A dropped
/// feature leaves a removal if the scene's own layer has it, or if its id is the greatest of all, which would otherwise
/// be used again.
fn spliced(text: &str, versions: &Versions<'_>) -> Result<String> {
    #[derive(Deserialize)]
    struct Parts<'a> {
        #[serde(borrow)]
        format: &'a RawValue,
        tolerance: Option<&'a RawValue>,
        #[serde(borrow)]
        features: &'a RawValue,
    }
    #[derive(Deserialize)]
    struct Entry {
        id: f64,
        remove: Option<bool>,
    }
    let wrong = |e: serde_json::Error| Error::invalid("it is not a layer", "give another name").caused_by(e);
    let parts: Parts<'_> = serde_json::from_str(text).map_err(wrong)?;
    let entries: Vec<&RawValue> = serde_json::from_str(parts.features.get()).map_err(wrong)?;
    let Versions { saved, now, own, next, tolerance } = *versions;
    let removal = |id: u32| format!("{{\"id\":{id},\"remove\":true}}");
    let line = |feature: &Feature| serde_json::to_string(&layer_fields(feature)).map_err(wrong);
    let (mut lines, mut there) = (Vec::with_capacity(entries.len()), HashSet::new());
    for raw in entries {
        let entry: Entry = serde_json::from_str(raw.get()).map_err(wrong)?;
        let id = entry.id as u32;
        there.insert(id);
        match now.get(&id) {
            None if entry.remove == Some(true) => lines.push(raw.get().to_owned()),
            None if own.contains_key(&id) || id.checked_add(1) == Some(next) => lines.push(removal(id)),
            None => {}
            Some(feature) if saved.get(&id) == Some(feature) => lines.push(raw.get().to_owned()),
            Some(feature) => lines.push(line(feature)?),
        }
    }
    let mut new: Vec<&Arc<Feature>> =
        now.values().filter(|f| !there.contains(&f.id) && own.get(&f.id) != Some(f)).collect();
    new.sort_by_key(|f| f.id);
    let gone = own.keys().filter(|id| !now.contains_key(id) && !there.contains(id));
    for feature in new {
        lines.push(line(feature)?);
    }
    let mut gone: Vec<u32> = gone.copied().collect();
    gone.sort_unstable();
    lines.extend(gone.into_iter().map(removal));
    let list = if lines.is_empty() { "[]".to_owned() } else { format!("[\n    {}\n  ]", lines.join(",\n    ")) };
    let contours = now.values().any(|f| f.shape.is_contour());
    let mut format = if contours { "2" } else { parts.format.get() }.to_owned();
    let mut cuts = vec![(parts.features, list)];
    let written = parts.tolerance.map(|raw| raw.get().parse()).unwrap_or(Ok(DEFAULT_TOLERANCE));
    match parts.tolerance {
        _ if written == Ok(tolerance) => {}
        Some(raw) => cuts.push((raw, tolerance.to_string())),
        None => format += &format!(",\n  \"tolerance\": {tolerance}"),
    }
    cuts.push((parts.format, format));
    let at = |part: &RawValue| part.get().as_ptr() as usize - text.as_ptr() as usize;
    cuts.sort_by_key(|(part, _)| std::cmp::Reverse(at(part)));
    let mut whole = text.to_owned();
    cuts.iter().for_each(|(part, new)| whole.replace_range(at(part)..at(part) + part.get().len(), new));
    files::parse_layer(&whole)?;
    Ok(whole)
}

/// Returns [`Answer::Behind`] if a store was read again.
pub fn behind(session: &mut Session, e: Error) -> Result<Answer> {
    if !std::mem::take(&mut session.stale) {
        return Err(e);
    }
    session.read_again()?;
    let mut state = session.state();
    state["said"] = e.to_string().into();
    Ok(Answer::Behind(state.to_string()))
}
