//! The error type: kind, file, place, fault and remedy.

use crate::limits;
use crate::printable::{clipped, clipped_inside, printable};
use std::error::Error as StdError;
use std::fmt;
use std::path::{Path, PathBuf};

/// The cause of an error, by who is at fault. It decides the exit status of the command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// A file or a value passed to the API is invalid. Exit status 1.
    Invalid,
    /// A file uses something that presight does not support. Exit status 1.
    Unsupported,
    /// Wrong usage: a flag, an unknown preset, a pose with NaN. Exit status 2.
    Usage,
    /// No device for the requested backend. Exit status 3.
    NoDevice,
    /// The device was lost. Exit status 3.
    DeviceLost,
    /// The device has too little memory. Exit status 3.
    DeviceMemory,
    /// The operating system refused: disk full, memory, locked, permission. Exit status 4.
    System,
    /// Nothing can be predicted before the deadline. Exit status 4.
    Deadline,
}

impl ErrorKind {
    /// The exit status of the command for this kind of error.
    pub fn exit_status(self) -> u8 {
        match self {
            Self::Invalid | Self::Unsupported => 1,
            Self::Usage => 2,
            Self::NoDevice | Self::DeviceLost | Self::DeviceMemory => 3,
            Self::System | Self::Deadline => 4,
        }
    }
}

/// An error with file, place and remedy. Its `Display` is one printable line of bounded length, whatever the names in
/// it.
///
/// ```
/// use presight::{Error, ErrorKind};
/// let e = Error::invalid("vertex 7 is NaN", "repair the model and export it again")
///     .at("mesh \"door\", primitive 0")
///     .in_file("hall.glb");
/// assert_eq!(e.kind(), ErrorKind::Invalid);
/// assert_eq!(
///     e.to_string(),
///     "hall.glb: mesh \"door\", primitive 0: vertex 7 is NaN; repair the model and export it again"
/// );
/// ```
#[derive(Debug)]
pub struct Error(Box<Inner>);

#[derive(Debug)]
struct Inner {
    kind: ErrorKind,
    file: Option<PathBuf>,
    place: Option<String>,
    what: String,
    remedy: String,
    source: Option<Box<dyn StdError + Send + Sync>>,
}

/// The result of every fallible function in presight.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// An error of `kind`: `what` is wrong, and the `remedy` (may be empty).
    pub fn new(kind: ErrorKind, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self(Box::new(Inner { kind, file: None, place: None, what: what.into(), remedy: remedy.into(), source: None }))
    }

    /// An [`ErrorKind::Invalid`] error.
    pub fn invalid(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(ErrorKind::Invalid, what, remedy)
    }

    /// An [`ErrorKind::Usage`] error.
    pub fn usage(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(ErrorKind::Usage, what, remedy)
    }

    /// An input/output error on `file`. A missing input is the file's fault, everything else the system's.
    pub fn io(file: impl AsRef<Path>, doing: &str, source: std::io::Error) -> Self {
        use std::io::ErrorKind as Io;
        let (kind, remedy) = match source.kind() {
            Io::NotFound | Io::NotADirectory => (ErrorKind::Invalid, "check the path"),
            Io::InvalidFilename | Io::InvalidInput => (ErrorKind::Invalid, "give a path that the system accepts"),
            Io::UnexpectedEof => (ErrorKind::Invalid, "the file is truncated; fetch it again"),
            Io::PermissionDenied => (ErrorKind::System, "check the permissions"),
            Io::StorageFull => (ErrorKind::System, "free some disk space"),
            _ => (ErrorKind::System, "see the system's message"),
        };
        let mut e = Self::new(kind, format!("cannot {doing}: {source}"), remedy).in_file(file);
        e.0.source = Some(Box::new(source));
        e
    }

    /// Names the file at fault, unless a file is named already.
    #[must_use]
    pub fn in_file(mut self, file: impl AsRef<Path>) -> Self {
        self.0.file.get_or_insert_with(|| file.as_ref().to_owned());
        self
    }

    /// Adds an outer place in front of the current one ("object 3" before "polygon 7").
    #[must_use]
    pub fn at(mut self, place: impl fmt::Display) -> Self {
        self.0.place = Some(match self.0.place.take() {
            Some(inner) => format!("{place}: {inner}"),
            None => place.to_string(),
        });
        self
    }

    /// Names the file and the place that refer to the faulty file. They come before a file that is named already.
    #[must_use]
    pub fn named_in(self, file: impl AsRef<Path>, place: impl fmt::Display) -> Self {
        self.in_place().at(place).in_file(file)
    }

    /// Turns the file at fault, if any, into a place, so that the file referring to it can be named in front.
    #[must_use]
    pub fn in_place(mut self) -> Self {
        match self.0.file.take() {
            Some(named) => self.at(named.display()),
            None => self,
        }
    }

    /// Keeps the error that caused this one.
    #[must_use]
    pub fn caused_by(mut self, source: impl StdError + Send + Sync + 'static) -> Self {
        self.0.source = Some(Box::new(source));
        self
    }

    /// The cause, by who is at fault.
    pub fn kind(&self) -> ErrorKind {
        self.0.kind
    }

    /// The file at fault, if any.
    pub fn file(&self) -> Option<&Path> {
        self.0.file.as_deref()
    }

    /// The place inside the file or value, if any.
    pub fn place(&self) -> Option<&str> {
        self.0.place.as_deref()
    }

    /// The fault, without file, place and remedy.
    pub fn what(&self) -> &str {
        &self.0.what
    }

    /// The remedy; may be empty.
    pub fn remedy(&self) -> &str {
        &self.0.remedy
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let e = &self.0;
        if let Some(file) = &e.file {
            write!(f, "{}: ", printable(&clipped_inside(&file.to_string_lossy(), limits::MAX_SHOWN)))?;
        }
        if let Some(place) = &e.place {
            write!(f, "{}: ", printable(&clipped(place, limits::MAX_SHOWN)))?;
        }
        // Messages of other crates may span lines; ours must be one line.
        let what = e.what.split_whitespace().collect::<Vec<_>>().join(" ");
        f.write_str(&printable(&clipped(&what, limits::MAX_SHOWN)))?;
        if !e.remedy.is_empty() {
            write!(f, "; {}", printable(&clipped(&e.remedy, limits::MAX_SHOWN)))?;
        }
        Ok(())
    }
}

/// Formats a number for messages: in full if that is short, else with a power of ten.
pub fn short(x: f64) -> String {
    if x == 0.0 || !x.is_finite() || (1e-5..1e15).contains(&x.abs()) { x.to_string() } else { format!("{x:e}") }
}

/// [`short`] for the coordinates of a point.
pub fn short_point(p: impl Into<[f64; 3]>) -> String {
    format!("[{}]", p.into().map(short).join(", "))
}

impl StdError for Error {
    fn source(&self) -> Option<&(dyn StdError + 'static)> {
        self.0.source.as_deref().map(|e| e as _)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_one_printable_line_of_bounded_length() {
        let e = Error::invalid("no wall\n\u{1b}[2J here", "ask\nsomebody").at("mesh a\nb").in_file("a\u{7}.glb");
        assert_eq!(e.to_string(), "a\\u{7}.glb: mesh a\\nb: no wall \\u{1b}[2J here; ask\\nsomebody");
        assert_eq!(e.what(), "no wall\n\u{1b}[2J here", "programs get it unchanged");
        let long = "\u{1}x".repeat(1 << 20);
        let line = Error::invalid(&long, &long).at(&long).in_file(format!("{long}/end.glb")).to_string();
        assert!(line.len() < 40 * limits::MAX_SHOWN && line.contains("end.glb: "), "{} bytes", line.len());
    }

    #[test]
    fn what_a_file_names_is_at_fault_where_it_is_named() {
        let e = Error::invalid("is NaN", "").at("mesh 1").in_file("p.glb").named_in("c.jsonl", "line 2");
        assert_eq!(e.to_string(), "c.jsonl: line 2: p.glb: mesh 1: is NaN");
        assert_eq!(Error::invalid("no", "").at("b").named_in("c", "line 3").to_string(), "c: line 3: b: no");
    }

    #[test]
    fn numbers_in_messages_are_short_and_read_back() {
        for (x, text) in [(0.0, "0"), (0.001, "0.001"), (-1e12, "-1000000000000"), (1e308, "1e308"), (5e-324, "5e-324")]
        {
            assert_eq!(short(x), text);
            assert_eq!(short(x).parse::<f64>().unwrap(), x);
        }
        assert_eq!(short_point([1.5, f64::NAN, -1e300]), "[1.5, NaN, -1e300]");
    }
}
