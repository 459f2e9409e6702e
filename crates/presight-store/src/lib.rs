//! The stored environment: one SQLite file, `.presight`, that holds the environment and the log of all its changes.
//!
//! - `meta`: one row: `created` (UTC seconds) and `cause`, `genesis` (hash of the initial content), `next_object` and
//!   `next_slot` (the first unused numbers), `changes` (length of the log), `head` (hash of its last entry), `digest`
//!   (sum of the hashes of all rows below)
//! - `groups`: `path`, `pose` [x, y, z, qx, qy, qz, qw] of its frame in the world; only groups with a frame of their
//!   own
//! - `objects`: `number` (`object_id` in images is one more), `name` (full path), `pose` [x, y, z, qx, qy, qz, qw] of
//!   the object in the world, metres, `object_from_mesh` (12 numbers, column by column; null: identity), `mesh`,
//!   `first_slot`, `first_source`
//! - `meshes`: `number`, `name`, `vertices`, `polygons`, `content` (a blob, see the source of `blob`); objects share
//!   meshes, and an unused mesh is kept, because an undo may need it
//! - `materials`: `number`, `name`, `properties` (`reflection`, `one_sided`, `color`, `classes`)
//! - `layers`: sensor `class`, `tolerance` in metres, `pose_covariances` [[object, 6 x 6], ..]
//! - `features`: `class`, `id`, `kind`, `object`, `feature` (as in a layer file, with covariance, existence and last
//!   confirmation); `kind` and `feature` are null for a deleted feature, whose id is never reused
//! - `log`: `number` from 1, `time` (UTC seconds), `cause`, `id` (the caller's, if any), `undoes` (the entry it
//!   undoes), `change` and `inverse` (JSON in the format of `presight env apply`), `request` (BLAKE3 of the input line;
//!   only for changes with an id), `evidence` (JSON of the caller, if any)
//! - `marks`: `name`, `mark` (`object`, `kind`, `class`, `box`)
//! - `trust`: `object`, `trust` (`existence`, `confirmed` UTC seconds, `rate` 1 / s)
//!
//! This is format 5. A store of format 4, which lacks `evidence`, `marks` and `trust`, gets them at the first change.
//!
//! Lists of numbers are JSON texts, because SQLite's REAL drops the sign of zero. Each row ends in its `hash`. The hash
//! of a log entry also covers the entry before it. Opening a store verifies all hashes. They are neither secret nor
//! signed: they detect damage, not forgery.
//!
//! A commit is on disk when the call returns: rollback journal, `synchronous = EXTRA`. Between commits the file alone
//! is complete and can be copied. A [`Store`] holds SQLite's write lock until it is dropped; a second writer gets an
//! error immediately. Readers load one version in one transaction and then work in memory.

mod assign;
mod beliefs;
mod blob;
mod context;
mod create;
mod feature_lines;
mod hash;
mod ids;
mod line;
mod log;
mod merge;
mod meshes;
mod op;
mod pair;
mod proposal;
mod read;
mod rows;
mod scene;
mod schema;
mod unique;
mod write;

pub use create::create;
pub use feature_lines::{feature_change, feature_line};
pub use line::apply_line;
pub use log::LogEntry;
pub use proposal::{ChangeEvidence, Edit, EditPose, ProposedChange, ShapeSource};
pub use scene::{Existing, SceneMerge};
pub use write::{ChangeBatch, Note};

use presight_model::change::Change;
use presight_model::environment::{Environment, Mesh};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::index::{IndexKind, WorldIndex};
use presight_model::world::World;
use presight_read::layer::LayerFile;
use rows::Meta;
use rusqlite::Connection;
use schema::{Access, check_identity, connect, refusal};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Weak};

/// A store opened for changes. The file and its world in memory change together. The store holds the write lock until
/// it is dropped.
///
/// ```
/// use presight::Scene;
/// use presight::store::{Note, Store, create};
/// use presight::environment::{Environment, Material};
/// use presight::Change;
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("hall.presight");
/// create(&path, &Environment::new(), &Note::new("a new hall", 0.0))?;
///
/// let mut store = Store::open(&path)?;
/// let paint = Change::AddMaterial(Material::named("paint"));
/// let number = store.apply(paint, &Note::new("delivered", 12.5))?;
/// assert_eq!((number, store.changes()), (1, 1));
/// drop(store);
/// assert_eq!(Scene::open(&path)?.world.environment().materials().len(), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Store {
    connection: Connection,
    path: PathBuf,
    meta: Meta,
    /// The format of the tables.
    format: i32,
    world: World,
    /// True while the write lock is held.
    locked: bool,
    /// Numbers of the stored objects, by name.
    objects: HashMap<String, u32>,
    /// Paths of the stored groups.
    groups: HashSet<String>,
    materials: usize,
    meshes: Meshes,
    /// Numbers of log entries, by the caller's id.
    ids: HashMap<String, u64>,
}

/// Numbers of the stored meshes.
#[derive(Default)]
struct Meshes {
    next: i64,
    /// Key: name and hash of the blob.
    by_content: HashMap<(String, u128), i64>,
    by_number: HashMap<i64, Weak<Mesh>>,
    by_pointer: HashMap<usize, i64>,
}

impl Meshes {
    fn remember(&mut self, number: i64, mesh: &Arc<Mesh>) {
        self.by_number.insert(number, Arc::downgrade(mesh));
        self.by_pointer.insert(Arc::as_ptr(mesh) as usize, number);
    }

    /// Returns the number of this very mesh, if it was remembered and is still in memory.
    fn known(&self, mesh: &Arc<Mesh>) -> Option<i64> {
        let number = *self.by_pointer.get(&(Arc::as_ptr(mesh) as usize))?;
        let same = self.by_number.get(&number)?.upgrade().is_some_and(|known| Arc::ptr_eq(&known, mesh));
        same.then_some(number)
    }

    /// Returns the number of this mesh, or of a stored mesh with equal content.
    fn stored(&self, mesh: &Arc<Mesh>) -> Option<i64> {
        let equal = || (mesh.name().to_owned(), hash::of_content(&[&blob::encode(mesh)]));
        self.known(mesh).or_else(|| self.by_content.get(&equal()).copied())
    }
}

/// Reads a store into memory. Writers are not blocked.
///
/// # Errors
/// [`ErrorKind::Invalid`] if the file is missing, not a store, or damaged; [`ErrorKind::Unsupported`] if it has another
/// format version; [`ErrorKind::System`] if the operating system refuses access.
pub fn read(path: &Path) -> Result<Environment> {
    let connection = connect(path, Access::Read)?;
    in_one_version(&connection, path, |c, format| read::load(c, path, format, false)).map(|loaded| loaded.environment)
}

/// Reads a store and indexes it. This is faster than [`read`] followed by [`World::with_index`], because meshes are
/// indexed while others are read.
///
/// # Errors
/// As [`read`].
pub fn read_world(path: &Path, kind: &IndexKind) -> Result<World> {
    let connection = connect(path, Access::Read)?;
    let with_trees = matches!(kind, IndexKind::TwoLevel(_));
    let loaded = in_one_version(&connection, path, |c, format| read::load(c, path, format, with_trees))?;
    let index = WorldIndex::with_trees(&loaded.environment, kind, &loaded.trees);
    Ok(World::of(index, loaded.environment))
}

/// The facts that `presight env info` prints.
#[derive(Clone, Debug)]
pub struct Info {
    /// Creation time, UTC seconds.
    pub created: f64,
    /// Why it was created.
    pub cause: String,
    /// Number of log entries.
    pub changes: u64,
    /// Hash of the last log entry.
    pub head: String,
    /// Hash of the initial content: the same for all versions of the store.
    pub genesis: String,
    /// The stored environment.
    pub environment: Environment,
}

/// Reads a store and verifies it, including its whole log.
///
/// # Errors
/// As [`read`].
pub fn info(path: &Path) -> Result<Info> {
    let connection = connect(path, Access::Read)?;
    in_one_version(&connection, path, |c, format| {
        let read::StoreVersion { environment, meta, .. } = read::load(c, path, format, false)?;
        log::walk(c, path, (&meta, format), |_| Ok(()))?;
        let (changes, head) = (meta.changes as u64, hash::hex(&meta.head));
        let genesis = hash::hex(&meta.genesis);
        Ok(Info { created: meta.created, cause: meta.cause, changes, head, genesis, environment })
    })
}

/// Verifies every log entry and passes it to `visit`, oldest first.
///
/// # Errors
/// As [`read`], and every error that `visit` returns.
pub fn log(path: &Path, visit: impl FnMut(LogEntry) -> Result<()>) -> Result<()> {
    let connection = connect(path, Access::Read)?;
    in_one_version(&connection, path, |c, format| log::walk(c, path, (&Meta::read(c, path)?, format), visit))
}

/// Verifies all content and SQLite's internal structures.
///
/// # Errors
/// As [`read`]; [`ErrorKind::Invalid`] names the damaged place.
pub fn check(path: &Path) -> Result<Info> {
    let found = info(path)?;
    let connection = connect(path, Access::Read)?;
    let verdict: String = connection
        .query_row("PRAGMA integrity_check(1)", [], |row| row.get(0))
        .map_err(|e| refusal(path, "check the store", e))?;
    if verdict != "ok" {
        return Err(schema::damaged(verdict).in_file(path));
    }
    Ok(found)
}

/// Runs `read` with the format in one transaction, so that it sees a single version of the store.
fn in_one_version<T>(
    connection: &Connection,
    path: &Path,
    read: impl FnOnce(&Connection, i32) -> Result<T>,
) -> Result<T> {
    let wrap = |e| refusal(path, "read the store", e);
    let transaction = connection.unchecked_transaction().map_err(wrap)?;
    let answer = check_identity(&transaction, path)
        .and_then(|format| read(&transaction, format))
        .map_err(|e| e.in_file(path))?;
    transaction.commit().map_err(wrap)?;
    Ok(answer)
}

impl Store {
    /// Opens a store for changes and indexes its world with the default index.
    ///
    /// # Errors
    /// As [`read`]; [`ErrorKind::System`] if another writer holds the lock or the file is read-only.
    pub fn open(path: &Path) -> Result<Self> {
        Self::open_with_index(path, &IndexKind::default())
    }

    /// Opens a store for changes and indexes its world. [`IndexKind::None`] is enough for a store that makes no
    /// predictions.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub fn open_with_index(path: &Path, kind: &IndexKind) -> Result<Self> {
        let connection = connect(path, Access::Write)?;
        Self::load(connection, path, kind).map_err(|e| e.in_file(path))
    }

    fn load(connection: Connection, path: &Path, kind: &IndexKind) -> Result<Self> {
        let wrap = |e| refusal(path, "open the store for writing", e);
        connection.execute_batch("BEGIN IMMEDIATE").map_err(wrap)?;
        // Another writer may have changed the file between `connect` and the lock.
        let format = check_identity(&connection, path)?;
        let mut loaded = read::load(&connection, path, format, matches!(kind, IndexKind::TwoLevel(_)))?;
        let mut ids = HashMap::new();
        log::walk(&connection, path, (&loaded.meta, format), |entry| {
            ids.extend(entry.id.map(|id| (id, entry.number)));
            Ok(())
        })?;
        let mut store = Self { ids, ..Self::empty(connection, path, loaded.meta.clone()) };
        store.register(&loaded);
        let index = WorldIndex::with_trees(&loaded.environment, kind, &std::mem::take(&mut loaded.trees));
        store.world = World::of(index, loaded.environment);
        Ok(store)
    }

    /// A locked store whose content is not loaded yet.
    fn empty(connection: Connection, path: &Path, meta: Meta) -> Self {
        Self {
            connection,
            path: path.to_owned(),
            meta,
            format: schema::FORMAT,
            world: World::with_index(Environment::new(), &IndexKind::None),
            locked: true,
            objects: HashMap::new(),
            groups: HashSet::new(),
            materials: 0,
            meshes: Meshes { next: 1, ..Meshes::default() },
            ids: HashMap::new(),
        }
    }

    /// The stored world, including all changes so far.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Keeps the feature layers open from now on: many changes follow, without a reader of the layers in between.
    pub fn begin_row(&mut self) {
        self.world.begin_row();
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Number of log entries.
    pub fn changes(&self) -> u64 {
        self.meta.changes as u64
    }

    /// Applies a change to the world and the file, durably. Returns its number in the log.
    ///
    /// # Errors
    /// As [`World::apply`]; [`ErrorKind::System`] if the write fails. The world and the file are then unchanged.
    pub fn apply(&mut self, change: Change, note: &Note) -> Result<u64> {
        let mut batch = self.batch()?;
        let number = batch.apply(change, note)?;
        batch.commit()?;
        Ok(number)
    }

    /// Begins a batch of changes that become durable together.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if another writer has changed or locked the store since the last batch.
    pub fn batch(&mut self) -> Result<ChangeBatch<'_>> {
        self.lock()?;
        Ok(ChangeBatch::new(self))
    }

    /// Lets other programs write until the next batch begins. If one did, that batch is refused.
    pub fn release(&mut self) {
        if self.locked {
            let _ = self.connection.execute_batch("ROLLBACK");
            self.locked = false;
        }
    }

    /// Undoes a log entry by appending its inverse. Returns the numbers of the new entries. With `cascade`, later
    /// changes of the same objects and features are undone before it, newest first.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if the entry was already undone, or if later changes depend on it and `cascade` is false.
    pub fn undo(&mut self, number: u64, cascade: bool, note: &Note) -> Result<Vec<u64>> {
        self.lock()?;
        let (entries, plan) = self.plan(number, cascade)?;
        let mut batch = self.batch()?;
        let mut made = Vec::with_capacity(plan.len());
        for n in plan {
            let place = |e: Error| e.at(format!("undoing change {n}"));
            let inverse = &entries[n as usize - 1].inverse;
            let change = batch.change_of_log(inverse).map_err(place)?;
            let entry = write::Entry { undoes: Some(n), ..write::Entry::default() };
            made.push(batch.record(change, note, &entry).map_err(place)?);
        }
        batch.commit()?;
        Ok(made)
    }

    /// Returns the entries that [`Store::undo`] would undo, in that order, without changing anything.
    ///
    /// # Errors
    /// As [`Store::undo`].
    pub fn undo_plan(&self, number: u64, cascade: bool) -> Result<Vec<u64>> {
        self.plan(number, cascade).map(|(_, plan)| plan)
    }

    /// All log entries, and the numbers of the ones to undo.
    fn plan(&self, number: u64, cascade: bool) -> Result<(Vec<LogEntry>, Vec<u64>)> {
        let mut entries = Vec::new();
        let walked = log::walk(&self.connection, &self.path, (&self.meta, self.format), |entry| {
            entries.push(entry);
            Ok(())
        });
        let plan = walked.and_then(|()| log::undo_plan(&entries, number, cascade));
        plan.map_err(|e| e.in_file(&self.path)).map(|plan| (entries, plan))
    }

    /// Returns the change that merges a scene into the world, with lists of the objects that it affects. Content that
    /// both have in common is not changed. Objects have the same path in both; where the scene repeats a name, so that
    /// paths depend on the order of the file, they are paired by shape and then by distance.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if a stored object of the same path differs and `existing` ones are kept.
    pub fn merging_scene(&self, scene: &Environment, existing: Existing) -> Result<SceneMerge> {
        scene::merge_scene(self.world.environment(), scene, existing)
    }

    /// Returns the change that merges a layer file. Its features replace stored features with the same id.
    pub fn merging_layer(&self, file: &LayerFile) -> Change {
        merge::merge_layer(self.world.environment(), file)
    }

    /// Commits without waiting for the disk: a deliberate fault that the durability tests must detect.
    pub fn without_sync(&mut self) -> Result<()> {
        let sql = "ROLLBACK; PRAGMA synchronous = OFF; BEGIN IMMEDIATE";
        self.connection.execute_batch(sql).map_err(|e| refusal(&self.path, "open the store", e))
    }

    /// Reacquires the write lock if it was lost, and checks that no other program has written in the meantime.
    fn lock(&mut self) -> Result<()> {
        if self.locked {
            return Ok(());
        }
        self.lock_again().map_err(|e| e.in_file(&self.path))
    }

    fn lock_again(&mut self) -> Result<()> {
        let wrap = |e| refusal(&self.path, "write to the store", e);
        self.connection.execute_batch("BEGIN IMMEDIATE").map_err(wrap)?;
        if Meta::read(&self.connection, &self.path)? != self.meta {
            let _ = self.connection.execute_batch("ROLLBACK");
            let what = "another program changed the store since it was opened";
            return Err(Error::new(ErrorKind::System, what, "open it again"));
        }
        self.locked = true;
        Ok(())
    }

    fn register(&mut self, loaded: &read::StoreVersion) {
        let read::StoreVersion { environment, meta, meshes, format, .. } = loaded;
        self.meta = meta.clone();
        self.format = *format;
        self.materials = environment.materials().len();
        let live = environment.objects().iter().zip(0..).filter(|(o, _)| !o.is_deleted());
        self.objects = live.map(|(o, number)| (o.name.clone(), number)).collect();
        self.groups = environment.given_groups().map(|(path, _)| path.to_owned()).collect();
        self.meshes = Meshes { next: 1, ..Meshes::default() };
        for (number, loaded) in meshes {
            self.meshes.next = self.meshes.next.max(number + 1);
            self.meshes.by_content.insert((loaded.name.clone(), loaded.content), *number);
            if let Some(mesh) = &loaded.mesh {
                self.meshes.remember(*number, mesh);
            }
        }
    }
}
