//! Files that the recorder compressed as a whole (`--compression-mode file`), and messages that it compressed one by one.

use super::{Container, MAX_RECORD_BYTES, container_of_bytes, first_bytes};
use presight_model::error::{Error, Result};
use std::borrow::Cow;
use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::Path;
use tempfile::TempDir;

/// The first bytes of a zstd frame. A CDR message begins with 0.
pub(super) const ZSTD_MAGIC: &[u8] = b"\x28\xb5\x2f\xfd";

/// The largest file in relation to its packed size that is unpacked to the disk. Measurements have noise: packed scans and
/// clouds are a third to a hundredth of their size. Only constant data shrinks to less than a thousandth.
const MAX_RATIO: u64 = 1000;

/// True if a file is compressed as a whole.
pub(super) fn is_packed(file: &Path) -> Result<bool> {
    Ok(first_bytes(file)?.starts_with(ZSTD_MAGIC))
}

/// The container in a compressed file.
pub(super) fn container_in(file: &Path) -> Result<Container> {
    let mut bytes = Vec::new();
    unpacking(file)?.take(16).read_to_end(&mut bytes).map_err(|e| damaged(&e).in_file(file))?;
    container_of_bytes(&bytes).map_err(|e| e.in_file(file))
}

/// Unpacks a compressed file during reading. The memory is the window of the compression, at most 128 MiB.
pub(super) fn unpacking(file: &Path) -> Result<impl Read + Send + use<>> {
    let opened = File::open(file).map_err(|e| Error::io(file, "open the bag", e))?;
    zstd::stream::read::Decoder::with_buffer(BufReader::new(opened)).map_err(|e| damaged(&e).in_file(file))
}

/// Unpacks a compressed file to `bag.db3` in a temporary folder, which is deleted when it is dropped.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] for a damaged file, and for one that grows beyond [`MAX_RATIO`];
/// [`presight_model::ErrorKind::System`] if the disk of temporary files is full.
pub(super) fn unpacked(file: &Path) -> Result<TempDir> {
    let size = std::fs::metadata(file).map_err(|e| Error::io(file, "read the bag", e))?.len();
    let max = size.saturating_mul(MAX_RATIO);
    let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), "make a temporary folder", e))?;
    let path = folder.path().join("bag.db3");
    let refused = |e| Error::io(&path, "unpack the bag", e);
    let (mut from, mut to) = (unpacking(file)?, File::create(&path).map_err(refused)?);
    let (mut block, mut written) = (vec![0; 1 << 20], 0u64);
    loop {
        let read = from.read(&mut block).map_err(|e| damaged(&e).in_file(file))?;
        if read == 0 {
            return Ok(folder);
        }
        written += read as u64;
        if written > max {
            let what = format!("the file unpacks to more than {MAX_RATIO} times its size of {size} bytes");
            let remedy = "if it is a bag all the same, unpack it with: zstd -d FILE";
            return Err(Error::invalid(what, remedy).in_file(file));
        }
        to.write_all(&block[..read]).map_err(refused)?;
    }
}

/// A message as it was before the recorder compressed it (`--compression-mode message`).
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] for a damaged message, and for one of more than [`MAX_RECORD_BYTES`].
pub(super) fn message(data: Cow<'_, [u8]>) -> Result<Vec<u8>> {
    if !data.starts_with(ZSTD_MAGIC) {
        return Ok(data.into_owned());
    }
    let mut message = Vec::new();
    let decoder = zstd::stream::read::Decoder::with_buffer(&*data).map_err(|e| damaged(&e))?;
    decoder.take(MAX_RECORD_BYTES as u64 + 1).read_to_end(&mut message).map_err(|e| damaged(&e))?;
    if message.len() > MAX_RECORD_BYTES {
        return Err(Error::invalid(
            format!("a compressed message of more than {MAX_RECORD_BYTES} bytes"),
            "record smaller messages",
        ));
    }
    Ok(message)
}

pub(super) fn damaged(e: &std::io::Error) -> Error {
    Error::invalid(format!("the compressed data is damaged: {e}"), "copy the file again from the recorder")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bombs_and_cut_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.db3.zstd");
        // 64 MiB of zeros become some kilobytes.
        std::fs::write(&path, zstd::encode_all(std::io::repeat(0).take(1 << 26), 3).unwrap()).unwrap();
        let e = unpacked(&path).unwrap_err().to_string();
        assert!(e.contains("more than 1000 times its size") && e.contains("zstd -d"), "{e}");
        let noise: Vec<u8> = (0..1u32 << 20).map(|k| (k.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
        let packed = zstd::encode_all(&noise[..], 3).unwrap();
        std::fs::write(&path, &packed).unwrap();
        assert_eq!(std::fs::read(unpacked(&path).unwrap().path().join("bag.db3")).unwrap(), noise);
        std::fs::write(&path, &packed[..packed.len() / 2]).unwrap();
        let e = unpacked(&path).unwrap_err().to_string();
        assert!(e.contains("a.db3.zstd") && e.contains("damaged"), "{e}");
        assert_eq!(message(Cow::Borrowed(&packed)).unwrap(), noise);
        let bomb = zstd::encode_all(std::io::repeat(0).take(MAX_RECORD_BYTES as u64 + 1), 3).unwrap();
        assert!(message(Cow::Owned(bomb)).unwrap_err().to_string().contains("bytes"));
    }
}
