//! From the file to an environment, every row proven.

use super::blob;
use super::hash::{Digest, Hash};
use super::op::{MaterialFields, affine_of, pose_of};
use super::rows::{Meta, feature_hash, from_json, group_hash, layer_hash, material_hash, mesh_hash, object_hash};
use super::schema::{damaged, refusal, version};
use crate::environment::{Environment, FeatureLayer, Mesh, NewObject};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::index::{MeshTree, Trees};
use crate::io::layer::{FeatureFields, from_fields};
use rusqlite::{Connection, Row};
use std::collections::HashMap;
use std::mem::MaybeUninit;
use std::path::Path;
use std::sync::Arc;

/// A version of the store, in memory.
pub(super) struct Loaded {
    pub environment: Environment,
    pub meta: Meta,
    pub meshes: HashMap<i64, LoadedMesh>,
    /// Of the meshes in the environment, if they were asked for.
    pub trees: Trees,
}

pub(super) struct LoadedMesh {
    pub name: String,
    /// BLAKE3 of the blob.
    pub content: Hash,
    /// None where no object has it.
    pub mesh: Option<Arc<Mesh>>,
}

/// A mesh's row but for its content.
struct MeshRow {
    number: i64,
    name: String,
    /// Vertices and polygons.
    counts: (i64, i64),
    /// Bytes of the content.
    size: usize,
    hash: Hash,
}

impl MeshRow {
    /// The hash of its content, if that is what was written.
    fn prove(&self, content: &[u8]) -> Result<Hash> {
        let content = *blake3::hash(content).as_bytes();
        if mesh_hash(self.number, &self.name, self.counts.0, self.counts.1, &content) != self.hash {
            return Err(damaged("it is not what was written").at(format!("mesh {} {:?}", self.number, self.name)));
        }
        Ok(content)
    }
}

/// Reads within the caller's transaction, with trees for the meshes if these will be indexed.
pub(super) fn load(connection: &Connection, path: &Path, with_trees: bool) -> Result<Loaded> {
    let reader = Reader { connection, path, with_trees, digest: std::cell::Cell::default() };
    reader.load().map_err(|e| e.in_file(path))
}

struct Reader<'a> {
    connection: &'a Connection,
    path: &'a Path,
    with_trees: bool,
    digest: std::cell::Cell<Digest>,
}

impl Reader<'_> {
    fn load(&self) -> Result<Loaded> {
        let meta = Meta::read(self.connection, self.path)?;
        let mut environment = Environment::new();
        self.materials(&mut environment)?;
        let mut groups = Vec::new();
        let (meshes, trees) = self.meshes(environment.materials().len(), || self.groups(&mut groups))?;
        self.objects(&mut environment, &meshes)?;
        environment.restore_groups(groups)?;
        let number = |n: i64| u32::try_from(n).map_err(|_| damaged("a number is out of range"));
        environment.skip_to(number(meta.next_object)?, number(meta.next_slot)?).map_err(damaged)?;
        self.layers(&mut environment)?;
        if self.digest.get() != meta.digest {
            return Err(damaged("rows are missing, or there are too many"));
        }
        Ok(Loaded { environment, meta, meshes, trees })
    }

    /// Each row through `read`, whose error names table and row.
    fn each(&self, table: &str, columns: &str, mut read: impl FnMut(&Row<'_>) -> Result<()>) -> Result<()> {
        let wrap = |e| refusal(self.path, "read the store", e);
        let mut statement = self.connection.prepare(&format!("SELECT {columns} FROM {table}")).map_err(wrap)?;
        let mut rows = statement.query([]).map_err(wrap)?;
        let mut count = 0;
        while let Some(row) = rows.next().map_err(wrap)? {
            count += 1;
            read(row).map_err(|e| e.at(format!("table {table}, row {count}")))?;
        }
        Ok(())
    }

    /// Compares a row's hash with the one it carries, and counts it.
    fn prove(&self, found: Hash, stored: Hash) -> Result<()> {
        if found != stored {
            return Err(damaged("the row is not what was written"));
        }
        let mut digest = self.digest.get();
        digest.add(&found);
        self.digest.set(digest);
        Ok(())
    }

    fn materials(&self, environment: &mut Environment) -> Result<()> {
        self.each("materials", "number, name, properties, hash", |row| {
            let (number, name, properties): (i64, String, String) = (get(row, 0)?, get(row, 1)?, get(row, 2)?);
            self.prove(material_hash(number, &name, &properties), get(row, 3)?)?;
            let material = MaterialFields { name, ..from_json(&properties)? }.material()?;
            let added = environment.add_material(material)?;
            if i64::from(added) != number { Err(damaged("a number is left out")) } else { Ok(()) }
        })
    }

    /// Meshes that no object has are proven and not kept. `beside` is done while the last of them are decoded.
    fn meshes(
        &self,
        materials: usize,
        beside: impl FnOnce() -> Result<()>,
    ) -> Result<(HashMap<i64, LoadedMesh>, Trees)> {
        let mut used = std::collections::HashSet::new();
        self.each("objects", "mesh", |row| {
            used.insert(get::<i64>(row, 0)?);
            Ok(())
        })?;
        let mut rows = Vec::new();
        self.each("meshes", "number, name, vertices, polygons, length(content), hash", |row| {
            let counts = (get(row, 2)?, get(row, 3)?);
            let size = usize::try_from(get::<i64>(row, 4)?).map_err(|_| damaged("a number is out of range"))?;
            rows.push(MeshRow { number: get(row, 0)?, name: get(row, 1)?, counts, size, hash: get(row, 5)? });
            Ok(())
        })?;
        // The largest first: others are decoded beside it.
        rows.sort_by_key(|row| std::cmp::Reverse(row.size));
        let mut bytes = self.room_for(&rows)?;
        let mut rest = &mut *bytes;
        let mut done: Vec<_> = rows.iter().map(|_| (None, None)).collect();
        let with_trees = self.with_trees;
        let decode = move |row: &MeshRow, bytes: &[u8]| {
            let mesh = blob::decode(&row.name, bytes, materials)?;
            let tree = with_trees.then(|| Arc::new(MeshTree::new(&mesh)));
            Ok((Arc::new(mesh), tree))
        };
        // Each is proven and decoded while the next is read.
        rayon::in_place_scope(|scope| -> Result<()> {
            for (row, (content, mesh)) in rows.iter().zip(&mut done) {
                let bytes;
                (bytes, rest) = std::mem::take(&mut rest).split_at_mut(row.size);
                let bytes = self.read_content(row.number, bytes)?;
                scope.spawn(move |_| *content = Some(row.prove(bytes)));
                if used.contains(&row.number) {
                    scope.spawn(move |_| *mesh = Some(decode(row, bytes)));
                }
            }
            beside()
        })?;
        let (mut meshes, mut trees) = (HashMap::with_capacity(rows.len()), Trees::default());
        for (row, (content, decoded)) in rows.into_iter().zip(done) {
            let content = content.ok_or_else(|| damaged("a mesh was not proven"))??;
            let (mesh, tree) = decoded.transpose()?.unzip();
            trees.extend(mesh.as_ref().map(Arc::as_ptr).zip(tree.flatten()));
            self.prove(row.hash, row.hash)?;
            meshes.insert(row.number, LoadedMesh { name: row.name, content, mesh });
        }
        Ok((meshes, trees))
    }

    /// One piece of memory for all contents: the system hands out a large one faster than many.
    fn room_for(&self, rows: &[MeshRow]) -> Result<Box<[MaybeUninit<u8>]>> {
        let file = std::fs::metadata(self.path).map_err(|e| Error::io(self.path, "read the store", e))?.len();
        let total = rows.iter().try_fold(0usize, |sum, row| sum.checked_add(row.size));
        match total.filter(|total| *total as u64 <= file) {
            Some(total) => Ok(Box::new_uninit_slice(total)),
            None => Err(damaged("its meshes are longer than the file")),
        }
    }

    /// The blob of a mesh, without the copies that SQLite makes of a column.
    fn read_content<'b>(&self, mesh: i64, to: &'b mut [MaybeUninit<u8>]) -> Result<&'b [u8]> {
        let wrap = |e| refusal(self.path, "read the store", e);
        let blob = self.connection.blob_open("main", "meshes", "content", mesh, true).map_err(wrap)?;
        if blob.len() != to.len() {
            return Err(damaged(format!("mesh {mesh} is not as long as it claims")));
        }
        blob.raw_read_at_exact(to, 0).map(|bytes| &*bytes).map_err(wrap)
    }

    fn objects(&self, environment: &mut Environment, meshes: &HashMap<i64, LoadedMesh>) -> Result<()> {
        let columns = "number, name, pose, object_from_mesh, mesh, first_slot, first_source, hash";
        self.each("objects", columns, |row| {
            let (number, name, pose): (i64, &str, &str) = (get(row, 0)?, text(row, 1)?, text(row, 2)?);
            let affine: Option<String> = get(row, 3)?;
            let rest: (i64, i64, i64) = (get(row, 4)?, get(row, 5)?, get(row, 6)?);
            self.prove(object_hash(number, name, (pose, affine.as_deref()), rest), get(row, 7)?)?;
            let mesh = meshes.get(&rest.0).and_then(|m| m.mesh.clone()).ok_or_else(|| damaged("it has no mesh"))?;
            let affine: Option<Vec<f64>> = affine.as_deref().map(from_json).transpose()?;
            let [number, slot, source] = [number, rest.1, rest.2].map(u32::try_from);
            let (Ok(number), Ok(slot), Ok(first_source)) = (number, slot, source) else {
                return Err(damaged("a number is out of range"));
            };
            let new = NewObject {
                object_from_mesh: affine_of(affine.as_deref())?,
                first_source,
                ..NewObject::new(name, pose_of(&seven(pose)?)?, mesh)
            };
            environment.insert_at(number, slot, new)
        })
    }

    /// Frames of groups; older stores have none.
    fn groups(&self, to: &mut Vec<(String, Pose)>) -> Result<()> {
        if version(self.connection, self.path)? < 3 {
            return Ok(());
        }
        self.each("groups", "path, pose, hash", |row| {
            // There are many, and each is soon read: no copies.
            let (path, pose) = (text(row, 0)?, text(row, 1)?);
            self.prove(group_hash(path, pose), get(row, 2)?)?;
            to.push((path.to_owned(), pose_of(&seven(pose)?)?));
            Ok(())
        })
    }

    fn layers(&self, environment: &mut Environment) -> Result<()> {
        let mut layers: HashMap<String, FeatureLayer> = HashMap::new();
        self.each("layers", "class, tolerance, pose_covariances, hash", |row| {
            let (class, tolerance, covariances): (String, String, String) = (get(row, 0)?, get(row, 1)?, get(row, 2)?);
            self.prove(layer_hash(&class, &tolerance, &covariances), get(row, 3)?)?;
            let pose_covariances: Vec<(String, [[f64; 6]; 6])> = from_json(&covariances)?;
            let tolerance = from_json(&tolerance)?;
            let layer = FeatureLayer { class: class.clone(), tolerance, pose_covariances, features: Vec::new() };
            layers.insert(class, layer);
            Ok(())
        })?;
        self.each("features", "class, id, kind, object, feature, hash", |row| {
            let (class, id): (String, i64) = (get(row, 0)?, get(row, 1)?);
            let columns: [Option<String>; 3] = [get(row, 2)?, get(row, 3)?, get(row, 4)?];
            let texts = columns.each_ref().map(|c| c.as_deref());
            self.prove(feature_hash(&class, id, texts), get(row, 5)?)?;
            let Some(text) = texts[2] else {
                environment.retire(&class, u32::try_from(id).map_err(|_| damaged("an id is out of range"))?);
                return Ok(());
            };
            let layer = layers.get_mut(&class).ok_or_else(|| damaged("its layer is missing"))?;
            let fields: FeatureFields = from_json(text)?;
            layer.features.push(from_fields(fields, layer.tolerance)?);
            Ok(())
        })?;
        layers.into_values().try_for_each(|layer| environment.add_layer(layer))
    }
}

/// A column; another type than was written is damage.
pub(super) fn get<T: rusqlite::types::FromSql>(row: &Row<'_>, column: usize) -> Result<T> {
    row.get(column).map_err(|e| damaged(e.to_string()))
}

/// A column of text, where it lies.
fn text<'a>(row: &'a Row<'_>, column: usize) -> Result<&'a str> {
    let value = row.get_ref(column).map_err(|e| damaged(e.to_string()))?;
    value.as_str().map_err(|e| damaged(e.to_string()))
}

/// The numbers of a pose.
fn seven(text: &str) -> Result<[f64; 7]> {
    from_json(text)
}

/// A mesh's row alone, proven.
pub(super) fn mesh(connection: &Connection, path: &Path, number: i64, materials: usize) -> Result<Arc<Mesh>> {
    let sql = "SELECT name, vertices, polygons, content, hash FROM meshes WHERE number = ?1";
    let columns = |row: &Row<'_>| {
        let (counts, content): (_, Vec<u8>) = ((row.get(1)?, row.get(2)?), row.get(3)?);
        Ok((MeshRow { number, name: row.get(0)?, counts, size: 0, hash: row.get(4)? }, content))
    };
    let (row, bytes) = connection.query_row(sql, [number], columns).map_err(|e| refusal(path, "read the store", e))?;
    row.prove(&bytes).map_err(|e| e.in_file(path))?;
    blob::decode(&row.name, &bytes, materials).map(Arc::new)
}
