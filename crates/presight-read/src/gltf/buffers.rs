//! The bytes of the buffers, embedded or in separate files. Each file is read once, however many buffers name it,
//! and only as far as they need.

use super::container::{Container, base64, check_within, local_path};
use super::memory::Memory;
use super::{BufferFiles, Origin};
use crate::file;
use gltf::json;
use presight_model::error::{Error, ErrorKind, Result};
use std::collections::HashMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// The remedy for a model whose parts do not fit each other.
pub(super) const REPAIR: &str = "repair the model or export it again";

/// All buffers of a scene file.
#[derive(Default)]
pub(super) struct Buffers<'a> {
    /// The binary chunk of a .glb.
    bin: Option<&'a [u8]>,
    /// Contents of files and decoded data URIs.
    owned: Vec<Vec<u8>>,
    /// The files read.
    pub files: Vec<PathBuf>,
    /// For each buffer: where its bytes are, and their number.
    buffers: Vec<(Source, usize)>,
}

/// Source of the bytes of a buffer.
#[derive(Clone, Copy)]
enum Source {
    /// In the binary chunk of a .glb.
    Bin,
    /// In `owned`.
    Owned(usize),
    /// Nowhere: glTF leaves the meaning of such a buffer to extensions (glTF 2.0, section 3.6.1.2).
    Nowhere,
}

/// A file that buffers name.
struct BufferFile {
    real: PathBuf,
    shown: PathBuf,
    /// Maximum length that a buffer claims, and the first buffer that claims it.
    claimed: u64,
    buffer: usize,
}

impl<'a> Buffers<'a> {
    /// The bytes of buffer `index`.
    pub fn get(&self, index: usize) -> Result<&[u8]> {
        let Some(&(source, length)) = self.buffers.get(index) else {
            let what = format!("buffer {index} does not exist, there are {}", self.buffers.len());
            return Err(Error::invalid(what, REPAIR));
        };
        let remedy = "the file is truncated or broken; export it again";
        let whole = self.whole(source).ok_or_else(|| Error::invalid("it has no data", remedy));
        Ok(&whole.map_err(|e| e.at(format!("buffer {index}")))?[..length])
    }

    /// The bytes of a source, if it has any.
    fn whole(&self, source: Source) -> Option<&[u8]> {
        match source {
            Source::Bin => self.bin,
            Source::Owned(i) => Some(&self.owned[i]),
            Source::Nowhere => None,
        }
    }

    /// True if the file gives no source for the bytes of buffer `index`.
    pub fn is_nowhere(&self, index: usize) -> bool {
        matches!(self.buffers.get(index), Some((Source::Nowhere, _)))
    }

    /// Reads the buffers of a scene.
    pub fn load(root: &json::Root, container: &Container<'a>, origin: Origin<'_>, memory: &mut Memory) -> Result<Self> {
        let place = |index: usize| move |e: Error| e.at(format!("buffer {index}"));
        let mut all = Self { bin: container.bin, ..Self::default() };
        let mut files = Files::default();
        // Pairs of buffer and file, for buffers in files.
        let mut of_file = Vec::with_capacity(root.buffers.len());
        for (index, buffer) in root.buffers.iter().enumerate() {
            let source = match &buffer.uri {
                None if index == 0 && container.binary => Source::Bin,
                None => Source::Nowhere,
                Some(uri) => match uri.strip_prefix("data:") {
                    Some(data) => {
                        memory.take(data.len() as u64, "an embedded buffer").map_err(place(index))?;
                        all.owned.push(decoded(data).map_err(place(index))?);
                        Source::Owned(all.owned.len() - 1)
                    }
                    None => {
                        let claim = (buffer.byte_length.0, index);
                        of_file.push((index, files.note(uri, claim, origin).map_err(place(index))?));
                        Source::Nowhere
                    }
                },
            };
            all.buffers.push((source, 0));
        }
        let first = all.owned.len();
        for named in &mut files.named {
            named.count(memory).map_err(place(named.buffer))?;
        }
        for named in &files.named {
            all.owned.push(named.read().map_err(place(named.buffer))?);
        }
        all.files = files.named.into_iter().map(|named| named.shown).collect();
        of_file.into_iter().for_each(|(buffer, file)| all.buffers[buffer].0 = Source::Owned(first + file));
        for (index, buffer) in root.buffers.iter().enumerate() {
            all.set_length(index, buffer.byte_length.0).map_err(place(index))?;
        }
        Ok(all)
    }

    /// Sets the length of a buffer, and checks that it has that many bytes.
    fn set_length(&mut self, index: usize, claimed: u64) -> Result<()> {
        let Some(there) = self.whole(self.buffers[index].0).map(<[u8]>::len) else { return Ok(()) };
        if claimed > there as u64 {
            let what = format!("{claimed} bytes are claimed, but only {there} exist");
            return Err(Error::invalid(what, "the buffer is truncated; fetch or export it again"));
        }
        // Fits, because it is at most the length of a slice.
        self.buffers[index].1 = claimed as usize;
        Ok(())
    }
}

/// The files that buffers name, without repetition.
#[derive(Default)]
struct Files {
    named: Vec<BufferFile>,
    by_uri: HashMap<String, usize>,
    by_path: HashMap<PathBuf, usize>,
}

impl Files {
    /// Returns the number of the file that a URI names, and notes how many bytes a buffer claims of it.
    fn note(&mut self, uri: &str, (claimed, buffer): (u64, usize), origin: Origin<'_>) -> Result<usize> {
        let number = match self.by_uri.get(uri) {
            Some(&number) => number,
            None => {
                let local = local_path(uri)?;
                let shown = origin.scene.parent().unwrap_or(Path::new("")).join(local);
                match origin.buffers {
                    BufferFiles::Linked => {}
                    BufferFiles::Within(folder) => check_within(&shown, folder)?,
                    BufferFiles::None => {
                        let what = format!("it is in the file {uri:?}, which a scene in memory cannot name");
                        let remedy = "export it as .glb, which holds its buffers, or open the scene from its file";
                        return Err(Error::new(ErrorKind::Unsupported, what, remedy));
                    }
                }
                // A missing file is reported when it is opened.
                let real = shown.canonicalize().unwrap_or_else(|_| shown.clone());
                let number = *self.by_path.entry(real.clone()).or_insert(self.named.len());
                if number == self.named.len() {
                    self.named.push(BufferFile { real, shown, claimed, buffer });
                }
                self.by_uri.insert(uri.to_owned(), number);
                number
            }
        };
        let named = &mut self.named[number];
        if claimed > named.claimed {
            (named.claimed, named.buffer) = (claimed, buffer);
        }
        Ok(number)
    }
}

impl BufferFile {
    /// Counts the bytes to read: the claimed length, or less if the file is shorter.
    fn count(&mut self, memory: &mut Memory) -> Result<()> {
        self.claimed = self.claimed.min(file::open_as(&self.real, &self.shown)?.limit());
        memory.take(self.claimed, &self.shown.display().to_string())
    }

    /// Reads these bytes.
    fn read(&self) -> Result<Vec<u8>> {
        let opened = file::open_as(&self.real, &self.shown)?;
        file::read(opened.into_inner().take(self.claimed), &self.shown, self.claimed)
    }
}

/// Decodes a data URI, given without its `data:`.
fn decoded(data: &str) -> Result<Vec<u8>> {
    let (head, body) =
        data.split_once(',').ok_or_else(|| Error::invalid("the data URI has no comma", "export the model again"))?;
    if !head.ends_with(";base64") {
        return Err(Error::new(ErrorKind::Unsupported, "the data URI is not base64", "export it as .glb"));
    }
    base64(body.as_bytes())
}
