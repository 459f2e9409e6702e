//! Reads meshes from the file; each is verified and decoded while the next is read.

use super::blob::Parts;
use super::hash::{Hash, of_content};
use super::read::{Reader, get};
use super::rows::mesh_hash;
use super::schema::{damaged, pragma, refusal};
use presight_model::environment::Mesh;
use presight_model::error::{Error, Result};
use presight_model::index::{MeshTree, PolygonBoxes, Trees};
use presight_model::threads::in_place_scope;
use rusqlite::{Connection, Row};
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

pub(super) struct LoadedMesh {
    pub name: String,
    /// Hash of the blob.
    pub content: u128,
    /// `None` if no object uses it.
    pub mesh: Option<Arc<Mesh>>,
}

/// A mesh's row without its content.
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
    /// Verifies the row with its content and returns the content's hash.
    fn prove(&self, content: &Parts) -> Result<u128> {
        let hash = of_content(&content.bytes());
        let found = mesh_hash(self.number, &self.name, self.counts, &hash.to_le_bytes());
        if found == self.hash { Ok(hash) } else { Err(damaged("it does not match its hash")) }
    }

    fn place(&self, e: Error) -> Error {
        e.at(format!("mesh {} {:?}", self.number, self.name))
    }

    fn content(&self, connection: &Connection, path: &Path) -> Result<Parts> {
        let wrap = |e| refusal(path, "read the store", e);
        // Read as a blob, because SQLite would copy a column.
        let blob = connection.blob_open("main", "meshes", "content", self.number, true).map_err(wrap)?;
        if blob.len() != self.size {
            return Err(damaged("its content does not have the recorded length"));
        }
        Parts::read(self.size, |to, at| blob.read_at_exact(to, at).map_err(wrap))
    }
}

impl Reader<'_> {
    /// Reads all meshes; runs `in_parallel` while they are decoded. Meshes that no object uses are verified but not
    /// kept.
    pub fn meshes(&self, in_parallel: impl FnOnce() -> Result<()>) -> Result<(HashMap<i64, LoadedMesh>, Trees)> {
        let mut used = HashSet::new();
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
        // The largest first, so that others are decoded in parallel with it.
        rows.sort_by_key(|row| std::cmp::Reverse(row.size));
        self.check_sizes(&rows)?;
        let mut done: Vec<_> = rows.iter().map(|_| None).collect();
        let with_trees = self.with_trees;
        let decode = move |row: &MeshRow, parts: Parts, used: bool| {
            let content = row.prove(&parts)?;
            if !used {
                return Ok((content, None, None));
            }
            let mut boxes = with_trees.then(|| PolygonBoxes::new(parts.polygons()));
            let mesh = parts.into_mesh(&row.name, |i, extent| {
                if let Some(boxes) = &mut boxes {
                    boxes.set(i, extent);
                }
            })?;
            let tree = boxes.map(|boxes| Arc::new(MeshTree::with_boxes(&mesh, boxes)));
            Ok((content, Some(Arc::new(mesh)), tree))
        };
        in_place_scope(|scope| -> Result<()> {
            for (row, done) in rows.iter().zip(&mut done) {
                let parts = row.content(self.connection, self.path).map_err(|e| row.place(e))?;
                let used = used.contains(&row.number);
                scope.spawn(move |_| *done = Some(decode(row, parts, used).map_err(|e| row.place(e))));
            }
            in_parallel()
        })??;
        let (mut meshes, mut trees) = (HashMap::with_capacity(rows.len()), Trees::default());
        for (row, done) in rows.into_iter().zip(done) {
            let (content, mesh, tree) = done.ok_or_else(|| damaged("a mesh was not verified"))??;
            trees.extend(mesh.as_ref().map(Arc::as_ptr).zip(tree));
            self.count(&row.hash);
            meshes.insert(row.number, LoadedMesh { name: row.name, content, mesh });
        }
        Ok((meshes, trees))
    }

    /// Checks sizes before memory is allocated. SQLite reads the missing end of a truncated file as zeros.
    fn check_sizes(&self, rows: &[MeshRow]) -> Result<()> {
        let file = std::fs::metadata(self.path).map_err(|e| Error::io(self.path, "read the store", e))?.len();
        let wrap = |e| refusal(self.path, "read the store", e);
        let pages: u32 = pragma(self.connection, "page_count").map_err(wrap)?;
        let page: u32 = pragma(self.connection, "page_size").map_err(wrap)?;
        if u64::from(pages) * u64::from(page) > file {
            return Err(damaged("the end of the file is missing"));
        }
        let total = rows.iter().try_fold(0u64, |sum, row| sum.checked_add(row.size as u64));
        match total.filter(|total| *total <= file) {
            Some(_) => Ok(()),
            None => Err(damaged("its meshes are longer than the file")),
        }
    }
}

/// Returns the mesh if all its material numbers are below `count`.
pub(super) fn known_materials(mesh: Arc<Mesh>, count: usize) -> Result<Arc<Mesh>> {
    match mesh.materials().last() {
        Some(last) if usize::from(*last) >= count => {
            Err(damaged(format!("mesh {:?} has material {last}, which does not exist", mesh.name())))
        }
        _ => Ok(mesh),
    }
}

fn row_of(connection: &Connection, path: &Path, number: i64) -> Result<MeshRow> {
    let sql = "SELECT name, vertices, polygons, length(content), hash FROM meshes WHERE number = ?1";
    let columns = |row: &Row<'_>| {
        let (counts, size) = ((row.get(1)?, row.get(2)?), row.get::<_, u32>(3)? as usize);
        Ok(MeshRow { number, name: row.get(0)?, counts, size, hash: row.get(4)? })
    };
    connection.query_row(sql, [number], columns).map_err(|e| refusal(path, "read the store", e))
}

/// Reads and verifies a single mesh.
pub(super) fn read(connection: &Connection, path: &Path, number: i64, materials: usize) -> Result<Arc<Mesh>> {
    let row = row_of(connection, path, number)?;
    let mesh = || {
        let parts = row.content(connection, path)?;
        row.prove(&parts)?;
        known_materials(Arc::new(parts.into_mesh(&row.name, |_, _| ())?), materials)
    };
    mesh().map_err(|e| row.place(e).in_file(path))
}
