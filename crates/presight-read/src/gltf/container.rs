//! The parts of a scene file; paths and encoding of buffers.

use gltf::json;
use presight_model::error::{Error, ErrorKind, Result};
use std::path::{Component, Path, PathBuf};

/// "glTF", little-endian.
const MAGIC: &[u8; 4] = b"glTF";
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BIN_CHUNK: u32 = 0x004E_4942;

const TRUNCATED: &str = "the file is truncated; fetch or export it again";

/// The parts of a scene file: JSON text, and the binary chunk of a .glb.
pub(super) struct Container<'a> {
    pub json: &'a [u8],
    pub bin: Option<&'a [u8]>,
    /// True for a .glb.
    pub binary: bool,
    /// The length of a chunk without the padding that glTF requires, if the next one follows it directly.
    pub unpadded: Option<usize>,
}

/// Splits a .glb into its chunks. A .gltf is JSON text as a whole.
pub(super) fn open(bytes: &[u8]) -> Result<Container<'_>> {
    if bytes.starts_with(MAGIC) {
        return open_binary(bytes);
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let first = text.iter().find(|b| !b.is_ascii_whitespace());
    if first != Some(&b'{') {
        let what = if bytes.is_empty() { "the file is empty" } else { "this is not a glTF file" };
        return Err(Error::invalid(what, "give a glTF 2.0 .glb or .gltf file"));
    }
    Ok(Container { json: text, bin: None, binary: false, unpadded: None })
}

fn open_binary(bytes: &[u8]) -> Result<Container<'_>> {
    let short = || Error::invalid("the GLB header is cut off", TRUNCATED);
    let version = word(bytes, 4).ok_or_else(short)?;
    let length = word(bytes, 8).ok_or_else(short)? as usize;
    if version != 2 {
        return Err(Error::new(
            ErrorKind::Unsupported,
            format!("this is GLB version {version}"),
            "export it as glTF 2.0",
        ));
    }
    let Some(body) = bytes.get(12..length) else {
        return Err(Error::invalid(format!("the file has {} of {length} bytes", bytes.len()), TRUNCATED));
    };
    let (mut json, mut bin, mut unpadded) = (None, None, None);
    let mut rest = body;
    while rest.len() >= 8 {
        let (size, kind) = (word(rest, 0).unwrap_or(0) as usize, word(rest, 4).unwrap_or(0));
        let Some(chunk) = size.checked_add(8).and_then(|end| rest.get(8..end)) else {
            return Err(Error::invalid(format!("a chunk claims {size} bytes, {} are left", rest.len() - 8), TRUNCATED));
        };
        match kind {
            JSON_CHUNK if json.is_none() => json = Some(chunk),
            BIN_CHUNK if bin.is_none() => bin = Some(chunk),
            _ => {}
        }
        // Chunks start at multiples of 4. Some writers do not count the padding in the size, others write none.
        let padded = rest.get(8 + size.next_multiple_of(4)..).unwrap_or_default();
        let direct = rest.get(8 + size..).unwrap_or_default();
        let follows_directly = direct.len() > padded.len() && starts_chunk(direct) && !starts_chunk(padded);
        unpadded = unpadded.or(follows_directly.then_some(size));
        rest = if follows_directly { direct } else { padded };
    }
    let json = json.ok_or_else(|| Error::invalid("the GLB has no JSON chunk", "export it again"))?;
    Ok(Container { json, bin, binary: true, unpadded })
}

/// True if these bytes start with the header of a whole binary chunk.
fn starts_chunk(bytes: &[u8]) -> bool {
    let size = word(bytes, 0).map(|size| size as usize);
    word(bytes, 4) == Some(BIN_CHUNK) && size.is_some_and(|size| size <= bytes.len() - 8)
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    let four = bytes.get(at..at + 4)?;
    Some(u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
}

/// Checks that a file, if it exists, lies in a folder after symbolic links are resolved.
pub(super) fn check_within(path: &Path, folder: &Path) -> Result<()> {
    match path.canonicalize() {
        Ok(real) if !real.starts_with(folder) => {
            let what = format!("{} leads out of the scene's folder", path.display());
            Err(Error::invalid(what, "put the file itself there, not a link to it"))
        }
        _ => Ok(()),
    }
}

/// The relative path that a URI names. It must not leave the scene's folder, except through symbolic links.
pub(super) fn local_path(uri: &str) -> Result<PathBuf> {
    let outside = |what: &str| {
        Error::invalid(
            format!("buffer URI {uri:?} {what}"),
            "put the buffer into the folder of the scene file and give its relative path",
        )
    };
    let scheme =
        uri.split_once(':').is_some_and(|(s, _)| s.chars().all(|c| c.is_ascii_alphanumeric() || "+-.".contains(c)));
    if scheme {
        return Err(outside("is not a relative path"));
    }
    let text = percent_decoded(uri).ok_or_else(|| outside("is not valid percent-encoded UTF-8"))?;
    let path = PathBuf::from(text);
    let inside = path.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    if !inside || path.as_os_str().is_empty() {
        return Err(outside("leaves the folder of the scene"));
    }
    Ok(path)
}

/// The images that a scene names. They are not read, so their places are not checked.
pub(super) fn images(root: &json::Root, scene: &Path) -> Vec<PathBuf> {
    let folder = scene.parent().unwrap_or(Path::new(""));
    let uris = root.images.iter().filter_map(|image| image.uri.as_deref()).filter(|uri| !uri.starts_with("data:"));
    uris.flat_map(|uri| percent_decoded(uri).into_iter().chain([uri.to_owned()])).map(|uri| folder.join(uri)).collect()
}

fn percent_decoded(uri: &str) -> Option<String> {
    let bytes = uri.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while i < bytes.len() {
        if bytes[i] == b'%' {
            let hex = std::str::from_utf8(bytes.get(i + 1..i + 3)?).ok()?;
            out.push(u8::from_str_radix(hex, 16).ok()?);
            i += 3;
        } else {
            out.push(bytes[i]);
            i += 1;
        }
    }
    if out.contains(&0) {
        return None;
    }
    String::from_utf8(out).ok()
}

/// RFC 4648 base64, with or without padding.
pub(super) fn base64(text: &[u8]) -> Result<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 3);
    let (mut held, mut bits) = (0u32, 0u32);
    let body = text.iter().rposition(|&b| b != b'=').map_or(&text[..0], |last| &text[..=last]);
    for (i, &b) in body.iter().enumerate() {
        let six = match b {
            b'A'..=b'Z' => b - b'A',
            b'a'..=b'z' => b - b'a' + 26,
            b'0'..=b'9' => b - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            _ => {
                return Err(Error::invalid(
                    format!("byte {i} of the data URI is not base64"),
                    "export the model again",
                ));
            }
        };
        held = (held << 6) | u32::from(six);
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            out.push((held >> bits) as u8);
            held &= (1 << bits) - 1;
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_follows_the_rfc() {
        for (text, bytes) in [("", ""), ("Zg==", "f"), ("Zm8=", "fo"), ("Zm9v", "foo"), ("Zm9vYmE", "fooba")] {
            assert_eq!(base64(text.as_bytes()).unwrap(), bytes.as_bytes());
        }
        assert!(base64(b"Zm9*").is_err());
    }

    #[test]
    fn paths_stay_inside() {
        assert_eq!(local_path("a%20b/c.bin").unwrap(), PathBuf::from("a b/c.bin"));
        for bad in ["../x.bin", "/etc/passwd", "a/../../x", "http://x/y.bin", "%2e%2e/x", "%2Fetc", "", "a%00b", "%f"] {
            assert!(local_path(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn chunks_without_padding_are_read_as_they_are_written() {
        let glb = |json: &[u8], size: u8, bin: &[u8]| {
            let mut bytes = Vec::from(*b"glTF\x02\0\0\0\0\0\0\0");
            bytes.extend([size, 0, 0, 0]);
            bytes.extend(b"JSON".iter().chain(json));
            bytes.extend([bin.len() as u8, 0, 0, 0]);
            bytes.extend(b"BIN\0".iter().chain(bin));
            bytes[8] = bytes.len() as u8;
            bytes
        };
        for (json, size, bin, unpadded) in [
            (b"{}  ".as_slice(), 4, b"abcd".as_slice(), None),
            (b"{}  ", 2, b"abcd", None),
            (b"{}", 2, b"abcd", Some(2)),
            (b"{} ", 3, b"abc", Some(3)),
            (b"{}   ", 5, b"", Some(5)),
        ] {
            let bytes = glb(json, size, bin);
            let found = open(&bytes).unwrap();
            assert_eq!((found.json, found.bin), (&json[..usize::from(size)], Some(bin)), "{json:?}");
            assert_eq!(found.unpadded, unpadded, "{json:?}");
        }
        // A file that is cut in the next chunk is truncated, not unpadded.
        let mut cut = glb(b"{}", 2, b"abcd");
        cut.truncate(cut.len() - 1);
        cut[8] -= 1;
        assert!(open(&cut).is_err_and(|e| e.remedy().contains("truncated")));
    }

    #[test]
    fn cut_files_are_named_truncated() {
        let mut whole = Vec::from(*b"glTF\x02\0\0\0\x1c\0\0\0\x04\0\0\0JSON{}  \0\0\0\0BIN\0");
        assert_eq!(whole.len(), 32);
        whole[8] = 32;
        assert_eq!(open(&whole).unwrap().json, b"{}  ");
        assert_eq!(open(&whole).unwrap().unpadded, None);
        for n in 4..32 {
            let e = open(&whole[..n]).err().unwrap();
            assert!(e.remedy().contains("truncated"), "{n}: {e}");
        }
        assert!(open(b"").is_err() && open(b"PNG").is_err() && open(b"[]").is_err());
    }
}
