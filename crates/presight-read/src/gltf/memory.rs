//! Counts the memory of an import before it is allocated, because a small file can request any amount.

use crate::text::json_memory;
use presight_model::error::{Error, Result};
use presight_model::limits;
use presight_model::memory::{of_building, of_kept};

/// Bytes of a node and its object, without the path.
const NODE: u64 = 1200;
/// Copies of the path of a node.
const PATHS: u64 = 6;
/// Bytes for each number of an exact mesh, both while it is read and afterwards.
const EXACT: u64 = 24;
/// Maximum number of meshes built at the same time, on any machine.
const AT_ONCE: usize = 16;

/// The known memory of an import.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Memory {
    bytes: u64,
    /// The part that the environment keeps.
    kept: u64,
}

impl Memory {
    /// Counts `bytes` more, for `what`.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the total exceeds the limit.
    pub(super) fn take(&mut self, bytes: u64, what: &str) -> Result<()> {
        self.bytes = self.bytes.saturating_add(bytes);
        if self.bytes <= limits::MAX_IMPORT_BYTES {
            return Ok(());
        }
        let what = format!("reading it takes at least {} bytes of memory, {bytes} of them for {what}", self.bytes);
        let remedy = format!("{} is the limit; split the environment into several files", limits::MAX_IMPORT_BYTES);
        Err(Error::invalid(what, remedy))
    }

    /// Counts `bytes` more that the environment keeps, for `what`.
    fn keep(&mut self, bytes: u64, what: &str) -> Result<()> {
        self.kept = self.kept.saturating_add(bytes);
        self.take(bytes, what)
    }

    /// Drops the memory that was needed only during the import.
    #[cfg(feature = "script")]
    pub fn after_import(self) -> Self {
        Self { bytes: self.kept, ..self }
    }

    /// The bytes counted so far.
    #[cfg(feature = "script")]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Counts the memory of parsed JSON text, and of its reduced copy.
    pub(super) fn take_json(&mut self, text: &[u8]) -> Result<()> {
        self.take(json_memory(text).saturating_add(text.len() as u64), "its JSON")
    }

    /// Counts a node of the scene; `path`: the length of its path, bytes.
    pub(super) fn take_node(&mut self, path: usize) -> Result<()> {
        self.keep(NODE + PATHS * path as u64, "a node and its path")
    }

    /// Counts meshes by their claimed numbers of triangles, the numbers of their exact meshes and their words.
    pub(super) fn take_meshes(&mut self, meshes: impl Iterator<Item = (u64, u64, String)>) -> Result<()> {
        let mut all = Vec::new();
        for (triangles, exact_numbers, words) in meshes {
            let bytes = of_kept(triangles).saturating_add(EXACT.saturating_mul(exact_numbers));
            self.keep(bytes, &words)?;
            all.push(triangles);
        }
        self.take(of_building(all, AT_ONCE), "making its polygons")
    }
}
