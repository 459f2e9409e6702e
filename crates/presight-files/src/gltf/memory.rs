//! What an import takes of memory, counted before it is taken: a small file can ask for any amount.

use super::accessor::Document;
use super::mesh::mesh_words;
use crate::text::json_memory;
use presight_model::error::{Error, Result};
use presight_model::limits;
use presight_model::memory::{of_building, of_kept};

/// Bytes of a node and the object that it becomes, besides its path, and copies of that path.
const NODE: u64 = 1200;
const PATHS: u64 = 6;
/// Bytes of a number of a mesh that our own writer left, while it is read and as it is kept.
const EXACT: u64 = 24;
/// Most meshes that are built at a time, whatever machine it is.
const AT_ONCE: usize = 16;

/// The bytes that an import takes, as far as they are known.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Memory {
    bytes: u64,
    /// Those of them that the environment keeps.
    kept: u64,
}

impl Memory {
    /// Counts so many bytes more, of `what`.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if all together are over the limit.
    pub(super) fn take(&mut self, bytes: u64, what: &str) -> Result<()> {
        self.bytes = self.bytes.saturating_add(bytes);
        if self.bytes <= limits::MAX_IMPORT_BYTES {
            return Ok(());
        }
        let what = format!("reading it takes at least {} bytes of memory, {bytes} of them for {what}", self.bytes);
        let remedy = format!("{} are the limit; split the environment into several files", limits::MAX_IMPORT_BYTES);
        Err(Error::invalid(what, remedy))
    }

    /// Counts so many bytes more that are kept, of `what`.
    fn keep(&mut self, bytes: u64, what: &str) -> Result<()> {
        self.kept = self.kept.saturating_add(bytes);
        self.take(bytes, what)
    }

    /// Without what only reading took.
    #[cfg(feature = "script")]
    pub fn after_import(self) -> Self {
        Self { bytes: self.kept, ..self }
    }

    /// The bytes counted so far.
    #[cfg(feature = "script")]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Counts JSON text as what it becomes.
    pub(super) fn take_json(&mut self, text: &[u8]) -> Result<()> {
        self.take(json_memory(text), "its JSON")
    }

    /// Counts a node of the scene that has a path of so many bytes.
    pub(super) fn take_node(&mut self, path: usize) -> Result<()> {
        self.keep(NODE + PATHS * path as u64, "a node and its path")
    }

    /// Counts meshes by the triangles that each claims.
    pub(super) fn take_meshes(&mut self, document: &Document<'_>, claims: &[(usize, u64)]) -> Result<()> {
        for &(mesh, triangles) in claims {
            let exact = EXACT.saturating_mul(document.exact_numbers(mesh));
            let bytes = of_kept(triangles).saturating_add(exact);
            self.keep(bytes, &mesh_words(&document.root, mesh))?;
        }
        let triangles = claims.iter().map(|&(_, triangles)| triangles).collect();
        self.take(of_building(triangles, AT_ONCE), "making its polygons")
    }
}
