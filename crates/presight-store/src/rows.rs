//! Contents and hashes of rows.

use super::hash::{Digest, Field, Hash, of_row};
use super::schema::{damaged, refusal};
use presight_model::environment::{Material, Object};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use rusqlite::{Connection, Row};
use std::path::Path;

/// The one row of `meta`: origin of the file and state of its log.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Meta {
    pub created: f64,
    pub cause: String,
    /// The hash of the initial content.
    pub genesis: Hash,
    pub next_object: i64,
    pub next_slot: i64,
    pub changes: i64,
    /// The hash of the last entry of the log.
    pub head: Hash,
    pub digest: Digest,
}

impl Meta {
    /// The hash that the first log entry chains to.
    pub fn first_head(&self) -> Hash {
        of_row(b"presight log 1", &[Field::Real(self.created), Field::Text(&self.cause), Field::Blob(&self.genesis)])
    }

    pub fn hash(&self) -> Hash {
        let fields = [
            Field::Real(self.created),
            Field::Text(&self.cause),
            Field::Blob(&self.genesis),
            Field::Integer(self.next_object),
            Field::Integer(self.next_slot),
            Field::Integer(self.changes),
            Field::Blob(&self.head),
            Field::Blob(&self.digest.to_bytes()),
        ];
        of_row(b"meta", &fields)
    }

    /// Reads and verifies the row.
    pub fn read(connection: &Connection, path: &Path) -> Result<Self> {
        let sql = "SELECT created, cause, genesis, next_object, next_slot, changes, head, digest, hash FROM meta";
        let read = |row: &Row<'_>| {
            let digest: Hash = row.get(7)?;
            let meta = Self {
                created: row.get(0)?,
                cause: row.get(1)?,
                genesis: row.get(2)?,
                next_object: row.get(3)?,
                next_slot: row.get(4)?,
                changes: row.get(5)?,
                head: row.get(6)?,
                digest: Digest::from_bytes(&digest),
            };
            Ok((meta, row.get::<_, Hash>(8)?))
        };
        let rows: rusqlite::Result<Vec<_>> =
            connection.prepare_cached(sql).and_then(|mut s| s.query_map([], read)?.collect());
        let mut rows = rows.map_err(|e| refusal(path, "read the store", e))?;
        match rows.pop().filter(|(meta, hash)| rows.is_empty() && meta.hash() == *hash) {
            Some((meta, _)) => Ok(meta),
            None => Err(damaged("table meta does not match its hash")),
        }
    }

    /// Writes the row in the caller's transaction.
    pub fn write(&self, connection: &Connection) -> rusqlite::Result<()> {
        let sql = "INSERT OR REPLACE INTO meta VALUES(1, ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)";
        let (digest, hash) = (self.digest.to_bytes(), self.hash());
        let standing = rusqlite::params![
            self.created,
            self.cause,
            self.genesis,
            self.next_object,
            self.next_slot,
            self.changes,
            self.head,
            digest,
            hash
        ];
        connection.prepare_cached(sql)?.execute(standing).map(drop)
    }
}

/// A pose in the form of a row: JSON of x, y, z, qx, qy, qz, qw.
pub(super) fn pose_text(pose: &Pose) -> String {
    numbers(&pose.to_array())
}

/// The columns of an object's row that hold numbers as JSON.
pub(super) struct ObjectRow {
    pub pose: String,
    pub object_from_mesh: Option<String>,
}

/// Numbers as JSON, which keeps every bit. SQLite's REAL drops the sign of zero.
pub(super) fn numbers(values: &[f64]) -> String {
    // Finite numbers always have a JSON form.
    serde_json::to_string(values).unwrap_or_default()
}

impl ObjectRow {
    pub fn of(object: &Object) -> Self {
        let object_from_mesh = super::op::affine_fields(&object.object_from_mesh).map(|m| numbers(&m));
        Self { pose: pose_text(&object.world_from_object), object_from_mesh }
    }
}

pub(super) fn object_hash(
    number: i64,
    name: &str,
    row: (&str, Option<&str>),
    (mesh, first_slot, first_source): (i64, i64, i64),
) -> Hash {
    let fields = [
        Field::Integer(number),
        Field::Text(name),
        Field::Text(row.0),
        row.1.into(),
        Field::Integer(mesh),
        Field::Integer(first_slot),
        Field::Integer(first_source),
    ];
    of_row(b"objects", &fields)
}

pub(super) fn group_hash(path: &str, pose: &str) -> Hash {
    of_row(b"groups", &[Field::Text(path), Field::Text(pose)])
}

/// The hash of a mesh's row. `content` is the hash of its blob, in the bytes that the format stores.
pub(super) fn mesh_hash(number: i64, name: &str, (vertices, polygons): (i64, i64), content: &[u8]) -> Hash {
    let fields = [
        Field::Integer(number),
        Field::Text(name),
        Field::Integer(vertices),
        Field::Integer(polygons),
        Field::Blob(content),
    ];
    of_row(b"meshes", &fields)
}

pub(super) fn material_hash(number: i64, name: &str, properties: &str) -> Hash {
    of_row(b"materials", &[Field::Integer(number), Field::Text(name), Field::Text(properties)])
}

/// The properties of a material as JSON, without its name, which has its own column.
pub(super) fn material_json(material: &Material) -> Result<String> {
    let fields = super::op::MaterialFields { name: String::new(), ..super::op::MaterialFields::of(material) };
    json(&fields)
}

pub(super) fn layer_hash(class: &str, tolerance: &str, covariances: &str) -> Hash {
    of_row(b"layers", &[Field::Text(class), Field::Text(tolerance), Field::Text(covariances)])
}

pub(super) fn feature_hash(class: &str, id: i64, columns: [Option<&str>; 3]) -> Hash {
    let [kind, object, feature] = columns.map(Field::from);
    of_row(b"features", &[Field::Text(class), Field::Integer(id), kind, object, feature])
}

pub(super) fn json(value: &impl serde::Serialize) -> Result<String> {
    serde_json::to_string(value)
        .map_err(|e| presight_model::error::Error::invalid(format!("cannot write JSON: {e}"), "").caused_by(e))
}

pub(super) fn from_json<T: serde::de::DeserializeOwned>(text: &str) -> Result<T> {
    serde_json::from_str(text).map_err(|e| damaged(e.to_string()))
}
