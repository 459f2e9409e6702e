//! Reads an environment from the file and verifies every row.

use super::hash::{Digest, Hash};
use super::meshes::{LoadedMesh, known_materials};
use super::op::{MaterialFields, affine_of};
use super::rows::{Meta, feature_hash, from_json, group_hash, layer_hash, material_hash, object_hash};
use super::schema::{FORMAT, damaged, refusal};
use glam::DAffine3;
use presight_model::environment::{Environment, Feature, FeatureLayer, NewObject};
use presight_model::error::{Error, Result};
use presight_model::geometry::{InObject, Pose, PoseCovariance};
use presight_model::index::Trees;
use presight_model::memory;
use presight_model::threads::in_place_scope;
use presight_read::layer::{FeatureFields, from_fields};
use rayon::prelude::*;
use rusqlite::{Connection, Row};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// One version of the store, in memory.
pub(super) struct StoreVersion {
    pub environment: Environment,
    pub meta: Meta,
    pub format: i32,
    pub meshes: HashMap<i64, LoadedMesh>,
    /// Trees of the environment's meshes, if requested.
    pub trees: Trees,
}

/// Reads the store in the caller's transaction. `with_trees` also builds trees for the meshes, which indexing needs.
pub(super) fn load(connection: &Connection, path: &Path, format: i32, with_trees: bool) -> Result<StoreVersion> {
    let reader = Reader { connection, path, format, with_trees, digest: std::cell::Cell::default() };
    reader.load()
}

pub(super) struct Reader<'a> {
    pub connection: &'a Connection,
    pub path: &'a Path,
    pub format: i32,
    pub with_trees: bool,
    digest: std::cell::Cell<Digest>,
}

/// A verified row of an object whose mesh is not read yet.
struct ObjectRecord {
    number: u32,
    name: String,
    pose: Pose,
    object_from_mesh: DAffine3,
    mesh: i64,
    first_slot: u32,
    first_source: u32,
}

impl Reader<'_> {
    fn load(&self) -> Result<StoreVersion> {
        let meta = Meta::read(self.connection, self.path)?;
        // SQLite knows the lengths without reading the blobs.
        self.each("meshes", "COALESCE(SUM(length(content)), 0)", |row| {
            memory::require(memory::of_stored(get::<i64>(row, 0)? as u64, self.with_trees))
        })?;
        let mut environment = Environment::new();
        let (mut groups, mut placed) = (Vec::new(), Vec::new());
        let (meshes, trees) = self.meshes(|| {
            self.materials(&mut environment)?;
            self.groups(&mut groups)?;
            self.objects(&mut placed)
        })?;
        let materials = environment.materials().len();
        for object in placed {
            let number = object.number;
            let mesh = meshes.get(&object.mesh).and_then(|m| m.mesh.clone()).ok_or_else(|| damaged("it has no mesh"));
            let inserted = mesh.and_then(|mesh| known_materials(mesh, materials)).and_then(|mesh| {
                let new = NewObject {
                    object_from_mesh: object.object_from_mesh,
                    first_source: object.first_source,
                    ..NewObject::new(object.name, object.pose, mesh)
                };
                environment.insert_at(object.number, object.first_slot, new)
            });
            inserted.map_err(|e| e.at(format!("table objects, number {number}")))?;
        }
        environment.restore_groups(groups)?;
        let number = |n: i64| u32::try_from(n).map_err(|_| damaged("a number is out of range"));
        environment.skip_to(number(meta.next_object)?, number(meta.next_slot)?).map_err(damaged)?;
        self.layers(&mut environment)?;
        if self.format >= FORMAT {
            self.beliefs(&mut environment)?;
        }
        if self.digest.get() != meta.digest {
            return Err(damaged("rows are missing or were added"));
        }
        Ok(StoreVersion { environment, meta, format: self.format, meshes, trees })
    }

    /// Calls `read` with each row; its errors get the table and row as their place.
    pub fn each(&self, table: &str, columns: &str, mut read: impl FnMut(&Row<'_>) -> Result<()>) -> Result<()> {
        let wrap = |e| refusal(self.path, "read the store", e);
        let mut statement = self.connection.prepare(&format!("SELECT {columns} FROM {table}")).map_err(wrap)?;
        let mut rows = statement.query([]).map_err(wrap)?;
        let mut count = 0;
        while let Some(row) = rows.next().map_err(wrap)? {
            count += 1;
            read(row).map_err(|e| e.at(place(table, count)))?;
        }
        Ok(())
    }

    /// Compares a row's computed and stored hashes, and adds the row to the digest.
    pub fn prove(&self, found: Hash, stored: Hash) -> Result<()> {
        check_row(found, stored)?;
        self.count(&found);
        Ok(())
    }

    /// Adds a verified row to the digest.
    pub fn count(&self, row: &Hash) {
        let mut digest = self.digest.get();
        digest.add(row);
        self.digest.set(digest);
    }

    fn materials(&self, environment: &mut Environment) -> Result<()> {
        self.each("materials", "number, name, properties, hash", |row| {
            let (number, name, properties): (i64, String, String) = (get(row, 0)?, get(row, 1)?, get(row, 2)?);
            self.prove(material_hash(number, &name, &properties), get(row, 3)?)?;
            let material = MaterialFields { name, ..from_json(&properties)? }.material()?;
            let added = environment.add_material(material)?;
            if i64::from(added) != number { Err(damaged("a number is missing")) } else { Ok(()) }
        })
    }

    fn objects(&self, to: &mut Vec<ObjectRecord>) -> Result<()> {
        let columns = "number, name, pose, object_from_mesh, mesh, first_slot, first_source, hash";
        self.each("objects", columns, |row| {
            // Borrowed, because copies of many short texts would dominate the time.
            let (number, name, pose): (i64, &str, &str) = (get(row, 0)?, text(row, 1)?, text(row, 2)?);
            let affine: Option<String> = get(row, 3)?;
            let rest: (i64, i64, i64) = (get(row, 4)?, get(row, 5)?, get(row, 6)?);
            self.prove(object_hash(number, name, (pose, affine.as_deref()), rest), get(row, 7)?)?;
            let affine: Option<Vec<f64>> = affine.as_deref().map(from_json).transpose()?;
            let [number, slot, source] = [number, rest.1, rest.2].map(u32::try_from);
            let (Ok(number), Ok(first_slot), Ok(first_source)) = (number, slot, source) else {
                return Err(damaged("a number is out of range"));
            };
            to.push(ObjectRecord {
                number,
                name: name.to_owned(),
                pose: Pose::of_numbers(&seven(pose)?)?,
                object_from_mesh: affine_of(affine.as_deref())?,
                mesh: rest.0,
                first_slot,
                first_source,
            });
            Ok(())
        })
    }

    fn groups(&self, to: &mut Vec<(String, Pose)>) -> Result<()> {
        self.each("groups", "path, pose, hash", |row| {
            let (path, pose) = (text(row, 0)?, text(row, 1)?);
            self.prove(group_hash(path, pose), get(row, 2)?)?;
            to.push((path.to_owned(), Pose::of_numbers(&seven(pose)?)?));
            Ok(())
        })
    }

    fn layers(&self, environment: &mut Environment) -> Result<()> {
        let mut layers: HashMap<String, FeatureLayer> = HashMap::new();
        self.each("layers", "class, tolerance, pose_covariances, hash", |row| {
            let (class, tolerance, covariances): (String, String, String) = (get(row, 0)?, get(row, 1)?, get(row, 2)?);
            self.prove(layer_hash(&class, &tolerance, &covariances), get(row, 3)?)?;
            let pose_covariances: Vec<(String, PoseCovariance<InObject>)> = from_json(&covariances)?;
            let tolerance = from_json(&tolerance)?;
            let layer = FeatureLayer { class: class.clone(), tolerance, pose_covariances, features: Vec::new() };
            layers.insert(class, layer);
            Ok(())
        })?;
        self.features(&mut layers, environment)?;
        layers.into_values().try_for_each(|layer| environment.add_layer(layer))
    }

    /// Reads features and the ids of deleted ones. This thread reads ahead while all threads verify and parse.
    fn features(&self, layers: &mut HashMap<String, FeatureLayer>, environment: &mut Environment) -> Result<()> {
        let wrap = |e| refusal(self.path, "read the store", e);
        let sql = "SELECT class, id, kind, object, feature, hash FROM features";
        let mut statement = self.connection.prepare(sql).map_err(wrap)?;
        let mut rows = statement.query([]).map_err(wrap)?;
        let mut count = 0;
        let mut next = || -> Result<Vec<FeatureRow>> {
            let mut batch = Vec::with_capacity(FEATURE_ROWS);
            while batch.len() < FEATURE_ROWS
                && let Some(row) = rows.next().map_err(wrap)?
            {
                count += 1;
                batch.push(FeatureRow::of(row).map_err(|e| e.at(place("features", count)))?);
            }
            Ok(batch)
        };
        let mut first = 1;
        let mut batch = next()?;
        while !batch.is_empty() {
            let mut found: Vec<Result<Option<Arc<Feature>>>> = Vec::new();
            let following = in_place_scope(|scope| {
                scope.spawn(|_| {
                    batch.par_iter().with_min_len(256).map(|row| row.read(layers)).collect_into_vec(&mut found)
                });
                next()
            })?;
            for ((number, row), feature) in (first..).zip(&batch).zip(found) {
                let at = |e: Error| e.at(place("features", number));
                self.count(&row.hash);
                match (feature.map_err(at)?, layers.get_mut(&row.class)) {
                    (Some(feature), Some(layer)) => layer.features.push(feature),
                    _ => {
                        let id = u32::try_from(row.id).map_err(|_| at(damaged("an id is out of range")))?;
                        environment.retire(&row.class, id);
                    }
                }
            }
            first += batch.len();
            batch = following?;
        }
        Ok(())
    }
}

/// Rows of features in a batch.
const FEATURE_ROWS: usize = 1 << 13;

/// A feature's row, not verified yet.
struct FeatureRow {
    class: String,
    id: i64,
    /// Kind, object and feature.
    columns: [Option<String>; 3],
    hash: Hash,
}

impl FeatureRow {
    fn of(row: &Row<'_>) -> Result<Self> {
        let columns = [get(row, 2)?, get(row, 3)?, get(row, 4)?];
        Ok(Self { class: get(row, 0)?, id: get(row, 1)?, columns, hash: get(row, 5)? })
    }

    /// Verifies the row and returns its feature; `None` if it was deleted.
    fn read(&self, layers: &HashMap<String, FeatureLayer>) -> Result<Option<Arc<Feature>>> {
        let texts = self.columns.each_ref().map(|c| c.as_deref());
        check_row(feature_hash(&self.class, self.id, texts), self.hash)?;
        let Some(text) = texts[2] else { return Ok(None) };
        let layer = layers.get(&self.class).ok_or_else(|| damaged("its layer is missing"))?;
        let fields: FeatureFields = from_json(text)?;
        Ok(Some(Arc::new(from_fields(fields, layer.tolerance)?)))
    }
}

/// The place of a row in error messages.
fn place(table: &str, number: usize) -> String {
    format!("table {table}, row {number}")
}

/// Compares a row's computed and stored hashes.
fn check_row(found: Hash, stored: Hash) -> Result<()> {
    if found == stored { Ok(()) } else { Err(damaged("the row does not match its hash")) }
}

/// Reads a column. A value of the wrong type means damage.
pub(super) fn get<T: rusqlite::types::FromSql>(row: &Row<'_>, column: usize) -> Result<T> {
    row.get(column).map_err(|e| damaged(e.to_string()))
}

fn text<'a>(row: &'a Row<'_>, column: usize) -> Result<&'a str> {
    let value = row.get_ref(column).map_err(|e| damaged(e.to_string()))?;
    value.as_str().map_err(|e| damaged(e.to_string()))
}

/// Parses the seven numbers of a pose.
fn seven(text: &str) -> Result<[f64; 7]> {
    from_json(text)
}
