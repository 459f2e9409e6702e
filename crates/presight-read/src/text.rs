//! Shared code for reading presight's text files: bounded reading, the format number, errors with line numbers.

use crate::file;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::limits;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::io::{BufRead, Read};
use std::path::Path;

/// The only format version that this build reads.
pub const FORMAT: i64 = 1;

/// Checks the name of a new object: one or more path segments.
///
/// # Errors
/// [`ErrorKind::Invalid`] if a segment is empty or has control characters, or the name is too long.
pub fn check_name(name: &str) -> Result<()> {
    let sound = |segment: &str| !segment.is_empty() && !segment.chars().any(char::is_control);
    if name.len() <= limits::MAX_NAME_BYTES && name.split('/').all(sound) {
        return Ok(());
    }
    let remedy = format!("give segments such as \"cell1/robot\", at most {} bytes", limits::MAX_NAME_BYTES);
    Err(Error::invalid(format!("{} is not a valid object name", presight_model::printable::quoted(name)), remedy))
}

/// Upper bounds on the memory, bytes, of a JSON object and of a list element, for all types read here.
const JSON_OBJECT: u64 = 768;
const JSON_ELEMENT: u64 = 32;

/// Upper bound on the memory, bytes, that reading JSON text takes.
pub(crate) fn json_memory(text: &[u8]) -> u64 {
    let (mut objects, mut elements) = (0, 0);
    for byte in text {
        objects += u64::from(*byte == b'{');
        elements += u64::from(*byte == b',');
    }
    text.len() as u64 + JSON_OBJECT * objects + JSON_ELEMENT * elements
}

/// Refuses JSON text that could take too much memory, before any is allocated.
pub fn check_json_memory(text: &str) -> Result<()> {
    let bytes = json_memory(text.as_bytes());
    if bytes <= limits::MAX_IMPORT_BYTES {
        return Ok(());
    }
    let what = format!("reading its JSON could take {bytes} bytes of memory");
    Err(Error::invalid(what, format!("the limit is {}: split the file", limits::MAX_IMPORT_BYTES)))
}

/// Reads and parses a text file; all errors name it.
pub fn from_text<T>(path: &Path, parse: impl FnOnce(&str) -> Result<T>) -> Result<T> {
    read_text(path).and_then(|text| parse(&text)).map_err(|e| e.in_file(path))
}

/// As `from_text`, with the lower size limit of settings files.
pub fn from_settings<T>(path: &Path, parse: impl FnOnce(&str) -> Result<T>) -> Result<T> {
    read_settings(path).and_then(|text| parse(&text)).map_err(|e| e.in_file(path))
}

/// Reads a whole file as text, or the content of a pipe that was passed to this process.
pub fn read_text(path: &Path) -> Result<String> {
    read_up_to(path, limits::MAX_FILE_BYTES)
}

/// As `read_text`, with the lower size limit of settings files.
pub fn read_settings(path: &Path) -> Result<String> {
    read_up_to(path, limits::MAX_SETTINGS_BYTES)
}

fn read_up_to(path: &Path, limit: u64) -> Result<String> {
    let bytes = file::read(file::open_or_given(path)?, path, limit)?;
    String::from_utf8(bytes).map(file::without_mark).map_err(|e| {
        Error::invalid(format!("byte {} is not UTF-8", e.utf8_error().valid_up_to()), "save the file as UTF-8 text")
            .in_file(path)
    })
}

/// Reads the next line, with its line end; `None` at the end of the file.
pub(crate) fn read_line(reader: &mut impl BufRead, number: usize) -> Result<Option<String>> {
    let mut line = Vec::new();
    let read = reader.by_ref().take(limits::MAX_LINE_BYTES + 1).read_until(b'\n', &mut line);
    let at = |e: Error| e.at(format!("line {number}"));
    if read.map_err(|e| at(Error::io("", "read it", e)))? == 0 {
        return Ok(None);
    }
    if line.len() as u64 > limits::MAX_LINE_BYTES {
        let remedy = "split it";
        let what = format!("the line is longer than {} bytes", limits::MAX_LINE_BYTES);
        return Err(at(Error::invalid(what, remedy)));
    }
    let text =
        String::from_utf8(line).map_err(|_| at(Error::invalid("it is not UTF-8", "save the file as UTF-8 text")))?;
    let text = if number == 1 { file::without_mark(text) } else { text };
    Ok(Some(text))
}

/// The line number (from 1) of a byte offset.
pub(crate) fn line_of(text: &str, offset: usize) -> usize {
    1 + text.as_bytes().iter().take(offset).filter(|&&b| b == b'\n').count()
}

/// Parses TOML into a type; errors name the line.
pub(crate) fn toml_from_str<T: DeserializeOwned>(text: &str) -> Result<T> {
    if text.len() as u64 > limits::MAX_SETTINGS_BYTES {
        let what = format!("the TOML has {} bytes", text.len());
        return Err(Error::invalid(what, format!("the limit is {}: put rays in a file", limits::MAX_SETTINGS_BYTES)));
    }
    toml::from_str(text).map_err(|e| {
        let wrong = Error::invalid(e.message().to_owned(), "correct the file; docs/formats.md describes its keys");
        let placed = match e.span() {
            Some(span) => wrong.at(format!("line {}", line_of(text, span.start))),
            None => wrong,
        };
        placed.caused_by(e)
    })
}

/// Checks `format = 1` before anything else, because a newer file may have keys that this build cannot know.
pub(crate) fn check_format(text: &str) -> Result<()> {
    #[derive(Deserialize)]
    struct Header {
        format: Option<i64>,
    }
    check_version(toml_from_str::<Header>(text)?.format, FORMAT, "format = 1")
}

/// Checks the format number of a file. This build reads the formats 1 to `newest`. `example` is the key as in the file.
///
/// # Errors
/// [`ErrorKind::Unsupported`] for a newer format; [`ErrorKind::Invalid`] for a missing one and for one below 1.
pub fn check_version(format: Option<i64>, newest: i64, example: &str) -> Result<()> {
    match format {
        Some(known) if (1..=newest).contains(&known) => Ok(()),
        Some(newer) if newer > newest => {
            let what = format!("format {newer} is newer than this presight, which reads formats up to {newest}");
            Err(Error::new(ErrorKind::Unsupported, what, "update presight"))
        }
        Some(other) => Err(Error::invalid(format!("format {other} never existed"), format!("write {example}"))),
        None => Err(Error::invalid("the file does not name its format", format!("write {example} at its top"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_order_mark_is_no_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.toml");
        for (bytes, text) in
            [("\u{feff}format = 1", "format = 1"), ("a\u{feff}", "a\u{feff}"), ("\u{feff}\u{feff}", "\u{feff}")]
        {
            std::fs::write(&path, bytes).unwrap();
            assert_eq!(read_text(&path).unwrap(), text);
        }
    }

    #[test]
    fn lines_are_counted_from_one() {
        assert_eq!([0, 1, 2, 4, 99].map(|i| line_of("a\nb\nc", i)), [1, 1, 2, 3, 3]);
    }

    #[test]
    fn format_is_asked_for_first() {
        assert!(check_format("format = 1\nwhatever = 3").is_ok());
        let newer = check_format("format = 2\nwhatever = 3").unwrap_err();
        assert_eq!(newer.kind(), ErrorKind::Unsupported);
        assert!(check_format("format = 0").is_err());
        assert!(check_format("kind = 'camera'").unwrap_err().to_string().contains("format = 1"));
        let broken = check_format("format = 1\nx = = 2").unwrap_err();
        assert_eq!(broken.place(), Some("line 2"));
    }
}
