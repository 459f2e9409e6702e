//! Writes changes to the file.

use super::context::Context;
use super::hash::{Hash, of_content};
use super::line::Line;
use super::log::LogEntry;
use super::op::{Key, KeySets, Op};
use super::proposal::ProposedChange;
use super::rows::{
    Meta, ObjectRow, feature_hash, group_hash, json, layer_hash, material_hash, material_json, mesh_hash, object_hash,
    pose_text,
};
use super::schema::refusal;
use super::{Store, blob, ids, meshes, read};
use presight_model::change::Change;
use presight_model::environment::{Environment, Mesh};
use presight_model::error::{Error, Result};
use presight_model::placement;
use presight_model::world::World;
use presight_read::layer::to_fields;
use rusqlite::{OptionalExtension, Params, ToSql, params};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

/// Why and when a change was made, for the log. The caller gives the time; the store reads no clock.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Note {
    /// Why the change is made.
    pub cause: String,
    /// UTC seconds.
    pub time: f64,
    /// The caller's own id for the change. Applying the change again with the same id does nothing.
    pub id: Option<String>,
    /// Evidence for the change, as JSON; the log keeps it.
    pub evidence: Option<String>,
}

impl Note {
    /// Makes a note of a cause and a time (UTC seconds).
    pub fn new(cause: impl Into<String>, time: f64) -> Self {
        Self { cause: cause.into(), time, ..Self::default() }
    }
}

/// How restored features are checked in changes whose new features must lie on polygons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RestoreCheck {
    /// They must also lie on polygons.
    Checked,
    /// They are exempt, because they were in the environment before.
    Exempt,
}

/// Options for applying a change, and its further columns in the log.
#[derive(Clone, Debug, Default)]
pub(super) struct Entry {
    /// `Some` if features must lie on polygons.
    pub placed: Option<RestoreCheck>,
    /// Features exempt from this check, by class and id.
    pub lost: Vec<(String, u32)>,
    /// The hash of the input line.
    pub request: Option<[u8; 32]>,
    /// The entry that it undoes.
    pub undoes: Option<u64>,
}

/// Changes that become durable together, by [`ChangeBatch::commit`]. If the batch is dropped before that, or a write
/// fails, the world and the store return to their state before the batch.
pub struct ChangeBatch<'a> {
    store: &'a mut Store,
    /// True while there are uncommitted changes.
    open: bool,
    /// True after a failed write rolled the batch back.
    taken_back: bool,
    ids: Vec<String>,
    notices: Vec<String>,
}

impl<'a> ChangeBatch<'a> {
    pub(super) fn new(store: &'a mut Store) -> Self {
        Self { store, open: false, taken_back: false, ids: Vec::new(), notices: Vec::new() }
    }

    /// The world, including all changes so far.
    pub fn world(&self) -> &World {
        &self.store.world
    }

    /// False if writing a change failed. The whole batch is then undone.
    pub fn is_whole(&self) -> bool {
        !self.taken_back
    }

    /// The number of the log entry with this id, if any.
    pub fn number_of(&self, id: &str) -> Option<u64> {
        self.store.ids.get(id).copied()
    }

    /// Applies a change and returns its number in the log. A change whose id is already in the log does nothing. New
    /// and altered features must lie on polygons, as in [`World::apply`].
    ///
    /// # Errors
    /// As [`World::apply`]; [`presight_model::ErrorKind::Invalid`] if the id belongs to another change. Earlier changes
    /// then stay in the batch. If writing to the store fails, the whole batch is undone.
    pub fn apply(&mut self, change: Change, note: &Note) -> Result<u64> {
        self.record(change, note, &Entry { placed: Some(RestoreCheck::Exempt), ..Entry::default() })
    }

    /// Like [`ChangeBatch::apply`], but features need not lie on polygons, as in [`World::apply_unchecked`].
    ///
    /// # Errors
    /// As [`ChangeBatch::apply`].
    pub fn apply_unchecked(&mut self, change: Change, note: &Note) -> Result<u64> {
        self.record(change, note, &Entry::default())
    }

    /// Like [`ChangeBatch::apply`], for imported content. Features in `lost` (class, id) need not lie on polygons.
    ///
    /// # Errors
    /// As [`ChangeBatch::apply`].
    pub fn apply_imported(&mut self, change: Change, lost: Vec<(String, u32)>, note: &Note) -> Result<u64> {
        self.record(change, note, &Entry { placed: Some(RestoreCheck::Exempt), lost, ..Entry::default() })
    }

    /// Applies a change and writes it with its log entry.
    pub(super) fn record(&mut self, change: Change, note: &Note, entry: &Entry) -> Result<u64> {
        if let Some(id) = &note.id
            && let Some(known) = self.store.known(id)?
        {
            return known.same_change(id, self.store.op_of_known_shapes(&change).as_ref());
        }
        if self.taken_back {
            return Err(Error::invalid("the batch was rolled back", "begin another one"));
        }
        if !note.time.is_finite() {
            return Err(Error::invalid(format!("the time {} is not finite", note.time), "give UTC seconds"));
        }
        let inverse = match entry.placed {
            None => self.store.world.apply_unchecked(change.clone())?,
            Some(restored) => {
                placement::apply(&mut self.store.world, change.clone(), restored == RestoreCheck::Checked, &entry.lost)?
            }
        };
        self.open = true;
        let environment = self.store.world.environment().clone();
        let written = self.store.write(&environment, (&change, &inverse), note, entry);
        drop(environment);
        match written {
            Ok(number) => {
                self.ids.extend(note.id.clone());
                Ok(number)
            }
            Err(e) => {
                self.take_back();
                Err(e)
            }
        }
    }

    /// Applies a line of `presight env apply`. File paths in it are relative to `folder`. Returns its number in the
    /// log, and true if it is new.
    ///
    /// # Errors
    /// As [`ChangeBatch::apply`], where restored features must also lie on polygons;
    /// [`presight_model::ErrorKind::Invalid`] if the line is not a valid change.
    pub fn apply_line(&mut self, line: &str, folder: &Path, note: &Note) -> Result<(u64, bool)> {
        self.apply_parsed(Line::parse(line)?, folder, note)
    }

    /// Applies a proposed change. Relative paths of scene files start at the working folder. Returns its number in the
    /// log, and true if it is new.
    ///
    /// # Errors
    /// As [`ChangeBatch::apply_line`].
    pub fn apply_proposed(&mut self, change: &ProposedChange, note: &Note) -> Result<(u64, bool)> {
        self.apply_parsed(change.parsed()?, Path::new("."), note)
    }

    fn apply_parsed(&mut self, line: Line, folder: &Path, note: &Note) -> Result<(u64, bool)> {
        let Line { cause, id, evidence, was, op } = line;
        let cause = cause.unwrap_or_else(|| note.cause.clone());
        if let Some(id) = &id
            && let Some(known) = self.store.known(id)?
        {
            return Ok((known.same_line(id, &op)?, false));
        }
        was.iter().try_for_each(|was| was.check(self.store.world.environment()))?;
        let request = id.as_ref().map(|_| ids::request(&op)).transpose()?;
        let mut mesh = |_| Err(Error::invalid("mesh numbers are valid only in the log", "give \"like\""));
        let environment = self.store.world.environment();
        let mut context = Context::new(environment, Some(folder), &mut mesh);
        let change = context.change(op)?;
        self.notices.append(&mut context.notices);
        let entry = Entry { placed: Some(RestoreCheck::Checked), request, ..Entry::default() };
        Ok((self.record(change, &Note { id, cause, evidence, ..note.clone() }, &entry)?, true))
    }

    /// Returns what the applied lines' scene files hold that is not followed, and forgets it.
    pub fn take_notices(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notices)
    }

    /// Parses the JSON of a change in the log.
    pub(super) fn change_of_log(&self, text: &str) -> Result<Change> {
        let store = &*self.store;
        let environment = self.store.world.environment();
        let materials = environment.materials().len();
        let mut mesh = |number: i64| match store.meshes.by_number.get(&number).and_then(std::sync::Weak::upgrade) {
            Some(mesh) => Ok(mesh),
            None => meshes::read(&store.connection, &store.path, number, materials),
        };
        let op: Op = super::rows::from_json(text)?;
        Context::new(environment, None, &mut mesh).change(op)
    }

    /// Makes all changes durable. They are on disk when this returns.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the commit fails; world and store then return to their state before the
    /// batch.
    pub fn commit(mut self) -> Result<()> {
        if !self.open {
            return Ok(());
        }
        let done = self.store.commit();
        if done.is_ok() {
            self.open = false;
        }
        done
    }

    /// Rolls back to the state on disk.
    fn take_back(&mut self) {
        (self.open, self.taken_back) = (false, true);
        for id in self.ids.drain(..) {
            self.store.ids.remove(&id);
        }
        self.store.roll_back();
    }
}

impl Drop for ChangeBatch<'_> {
    fn drop(&mut self) {
        if self.open {
            self.take_back();
        }
    }
}

impl Store {
    /// Writes the rows that a change affects, and its log entry.
    fn write(
        &mut self,
        now: &Environment,
        (change, inverse): (&Change, &Change),
        note: &Note,
        entry: &Entry,
    ) -> Result<u64> {
        self.upgrade()?;
        self.write_materials(now)?;
        let (change, inverse) = {
            let mut number_of = |mesh: &Arc<Mesh>| self.number_of(mesh);
            (Op::of(change, &mut number_of)?, Op::of(inverse, &mut number_of)?)
        };
        // A layer's row is written once, however many of its features changed.
        let mut layers = BTreeSet::new();
        for key in KeySets::of(&[&change, &inverse]).writes {
            match key {
                Key::Object(name) => {
                    self.write_object(now, &name)?;
                    self.write_group(now, &name)?;
                }
                Key::Feature(class, id) => {
                    self.write_feature(now, &class, id)?;
                    // The class may be new.
                    layers.insert(class);
                }
                Key::Layer(class) => {
                    layers.insert(class);
                }
                Key::Mark(name) => self.write_mark(now, &name)?,
                Key::Trust(object) => self.write_trust(now, &object)?,
                Key::Existence(_) => {}
            }
        }
        layers.iter().try_for_each(|class| self.write_layer(now, class))?;
        (self.meta.next_object, self.meta.next_slot) = (now.objects().len() as i64, i64::from(now.slot_count()));
        self.append((&change, &inverse), note, entry)
    }

    /// Converts a change to the form of the log; `None` if it inserts a shape that is not stored.
    fn op_of_known_shapes(&self, change: &Change) -> Option<Op> {
        let unknown = || Error::invalid("this shape is not stored", "");
        Op::of(change, &mut |mesh: &Arc<Mesh>| self.meshes.stored(mesh).ok_or_else(unknown)).ok()
    }

    fn write_materials(&mut self, now: &Environment) -> Result<()> {
        for (number, material) in now.materials().iter().enumerate().skip(self.materials) {
            let (number, properties) = (number as i64, material_json(material)?);
            let hash = material_hash(number, &material.name, &properties);
            let sql = "INSERT INTO materials VALUES(?1, ?2, ?3, ?4)";
            self.run(sql, params![number, material.name, properties, hash])?;
            self.meta.digest.add(&hash);
        }
        self.materials = now.materials().len();
        Ok(())
    }

    fn append(&mut self, (change, inverse): (&Op, &Op), note: &Note, how: &Entry) -> Result<u64> {
        let number = self.meta.changes as u64 + 1;
        let mut entry = LogEntry {
            number,
            // Turns -0 into 0, because SQLite drops the sign.
            time: note.time + 0.0,
            cause: note.cause.clone(),
            id: note.id.clone(),
            undoes: how.undoes,
            change: json(change)?,
            inverse: json(inverse)?,
            request: how.request,
            evidence: note.evidence.clone(),
            hash: [0; 32],
        };
        entry.hash = entry.hash_after(&self.meta.head);
        let undone = how.undoes.map(|n| n as i64);
        let LogEntry { time, cause, id, change, inverse, request, hash, evidence, .. } = &entry;
        let sql = "INSERT INTO log VALUES(?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)";
        self.run(sql, params![number as i64, time, cause, id, undone, change, inverse, request, hash, evidence])?;
        (self.meta.changes, self.meta.head) = (number as i64, entry.hash);
        self.ids.extend(entry.id.map(|id| (id, number)));
        Ok(number)
    }

    /// Returns the number of a mesh's row. Writes the row if the mesh is new.
    fn number_of(&mut self, mesh: &Arc<Mesh>) -> Result<i64> {
        if let Some(number) = self.meshes.known(mesh) {
            return Ok(number);
        }
        let bytes = blob::encode(mesh);
        let content = of_content(&[&bytes]);
        let key = (mesh.name().to_owned(), content);
        let number = match self.meshes.by_content.get(&key) {
            Some(number) => *number,
            None => {
                let number = self.meshes.next;
                let counts @ (vertices, polygons) = (mesh.vertices().len() as i64, mesh.polygon_count() as i64);
                let hash = mesh_hash(number, mesh.name(), counts, &content.to_le_bytes());
                let sql = "INSERT INTO meshes VALUES(?1, ?2, ?3, ?4, ?5, ?6)";
                self.run(sql, params![number, mesh.name(), vertices, polygons, hash, bytes])?;
                self.meta.digest.add(&hash);
                self.meshes.next += 1;
                self.meshes.by_content.insert(key, number);
                number
            }
        };
        self.meshes.remember(number, mesh);
        Ok(number)
    }

    fn write_object(&mut self, now: &Environment, name: &str) -> Result<()> {
        let number = now.index_of(name).ok();
        if let Some(before) = self.objects.get(name).copied().filter(|before| Some(*before) != number) {
            self.remove("DELETE FROM objects WHERE number = ?1 RETURNING hash", params![before])?;
            self.objects.remove(name);
        }
        let Some(number) = number else { return Ok(()) };
        let object = &now.objects()[number as usize];
        let ObjectRow { pose, object_from_mesh } = ObjectRow::of(object);
        let mesh = self.number_of(&object.mesh)?;
        let (slot, source) = (i64::from(object.first_slot), i64::from(object.first_source));
        let hash = object_hash(i64::from(number), name, (&pose, object_from_mesh.as_deref()), (mesh, slot, source));
        if self.objects.contains_key(name) {
            let old = self.old_hash("SELECT hash FROM objects WHERE number = ?1", params![number])?;
            self.meta.digest.subtract(&old);
            let sql = "UPDATE objects SET pose = ?2, hash = ?3 WHERE number = ?1";
            self.run(sql, params![number, pose, hash])?;
        } else {
            let sql = "INSERT INTO objects VALUES(?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)";
            self.run(sql, params![number, name, pose, object_from_mesh, mesh, slot, source, hash])?;
            self.objects.insert(name.to_owned(), number);
        }
        self.meta.digest.add(&hash);
        Ok(())
    }

    /// Writes the group's current frame. Removes the row if it has none.
    fn write_group(&mut self, now: &Environment, path: &str) -> Result<()> {
        if self.groups.remove(path) {
            self.remove("DELETE FROM groups WHERE path = ?1 RETURNING hash", params![path])?;
        }
        let Some(pose) = now.group(path).map(pose_text) else { return Ok(()) };
        let hash = group_hash(path, &pose);
        self.run("INSERT INTO groups VALUES(?1, ?2, ?3)", params![path, pose, hash])?;
        self.groups.insert(path.to_owned());
        self.meta.digest.add(&hash);
        Ok(())
    }

    fn write_feature(&mut self, now: &Environment, class: &str, id: u32) -> Result<()> {
        let feature = now.feature(class, id);
        if feature.is_none() && !now.is_retired(class, id) {
            return Ok(());
        }
        let kind = feature.map(|f| f.shape.kind());
        let object = feature.and_then(|f| f.object.as_deref());
        let text = feature.map(|f| json(&to_fields(f))).transpose()?;
        let hash = feature_hash(class, i64::from(id), [kind, object, text.as_deref()]);
        self.remove("DELETE FROM features WHERE class = ?1 AND id = ?2 RETURNING hash", params![class, id])?;
        let sql = "INSERT INTO features VALUES(?1, ?2, ?3, ?4, ?5, ?6)";
        self.run(sql, params![class, id, kind, object, text, hash])?;
        self.meta.digest.add(&hash);
        Ok(())
    }

    fn write_layer(&mut self, now: &Environment, class: &str) -> Result<()> {
        let Some(layer) = now.layer(class) else { return Ok(()) };
        let (tolerance, covariances) = (json(&layer.tolerance)?, json(&layer.pose_covariances)?);
        let hash = layer_hash(class, &tolerance, &covariances);
        self.remove("DELETE FROM layers WHERE class = ?1 RETURNING hash", params![class])?;
        self.run("INSERT INTO layers VALUES(?1, ?2, ?3, ?4)", params![class, tolerance, covariances, hash])?;
        self.meta.digest.add(&hash);
        Ok(())
    }

    /// Writes a whole environment into empty tables.
    pub(super) fn write_all(&mut self, now: &Environment) -> Result<()> {
        self.write_materials(now)?;
        for object in now.objects().iter().filter(|o| !o.is_deleted()) {
            self.write_object(now, &object.name)?;
        }
        for (path, _) in now.given_groups() {
            self.write_group(now, path)?;
        }
        for layer in now.layers() {
            self.write_layer(now, &layer.class)?;
            for id in layer.features.iter().map(|f| f.id).chain(now.retired(&layer.class)) {
                self.write_feature(now, &layer.class, id)?;
            }
        }
        for (name, _) in now.marks() {
            self.write_mark(now, name)?;
        }
        for (object, _) in now.trusts() {
            self.write_trust(now, object)?;
        }
        (self.meta.next_object, self.meta.next_slot) = (now.objects().len() as i64, i64::from(now.slot_count()));
        Ok(())
    }

    /// Removes a row from its table and from the digest, if it exists.
    pub(super) fn remove(&mut self, sql: &str, params: impl Params) -> Result<()> {
        let found = self.connection.prepare_cached(sql).and_then(|mut s| {
            let mut rows = s.query(params)?;
            let hash = rows.next()?.map(|row| row.get::<_, Hash>(0)).transpose()?;
            // SQLite completes the DELETE only when all rows have been read.
            while rows.next()?.is_some() {}
            Ok(hash)
        });
        if let Some(hash) = found.map_err(|e| refusal(&self.path, "write to the store", e))? {
            self.meta.digest.subtract(&hash);
        }
        Ok(())
    }

    fn old_hash(&self, sql: &str, params: &[&dyn ToSql]) -> Result<Hash> {
        let found = self
            .connection
            .prepare_cached(sql)
            .and_then(|mut s| s.query_row(params, |row| row.get::<_, Hash>(0)).optional());
        let found = found.map_err(|e| refusal(&self.path, "write to the store", e))?;
        found.ok_or_else(|| super::schema::damaged("a row is missing").in_file(&self.path))
    }

    pub(super) fn run(&self, sql: &str, params: &[&dyn ToSql]) -> Result<()> {
        let done = self.connection.prepare_cached(sql).and_then(|mut s| s.execute(params));
        done.map(drop).map_err(|e| refusal(&self.path, "write to the store", e))
    }

    pub(super) fn write_meta(&self) -> Result<()> {
        self.meta.write(&self.connection).map_err(|e| refusal(&self.path, "write to the store", e))
    }

    /// Commits, and then reacquires the write lock.
    fn commit(&mut self) -> Result<()> {
        self.write_meta()?;
        let commit = self.connection.execute_batch("COMMIT");
        commit.map_err(|e| refusal(&self.path, "commit to the store", e))?;
        // If another writer changes the store before this, the next batch detects it.
        self.locked = self.connection.execute_batch("BEGIN IMMEDIATE").is_ok();
        Ok(())
    }

    /// Discards uncommitted changes and reloads the store from disk. If that fails, every further batch is refused.
    fn roll_back(&mut self) {
        // SQLite may already have rolled back, for example on a full disk.
        if !self.connection.is_autocommit() {
            let _ = self.connection.execute_batch("ROLLBACK");
        }
        self.locked = false;
        let locked =
            self.connection.execute_batch("BEGIN IMMEDIATE").is_ok() || self.connection.execute_batch("BEGIN").is_ok();
        let loaded = super::schema::check_identity(&self.connection, &self.path)
            .and_then(|format| read::load(&self.connection, &self.path, format, false));
        let _ = self.connection.execute_batch("ROLLBACK");
        match loaded {
            Ok(loaded) if locked => {
                self.register(&loaded);
                self.world.reset(loaded.environment);
            }
            // No file has -1 changes, so `lock` fails before the next batch.
            _ => self.meta = Meta { changes: -1, ..self.meta.clone() },
        }
    }
}
