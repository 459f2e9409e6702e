//! Printing that survives a reader who went away.

use presight::io::series::SeriesProgress;
use presight::limits;
use presight::{Error, ErrorKind, Result};
use presight_model::printable::{clipped, printable};
use std::io::{self, Write};

/// Prints lines for people to stdout: names in them cannot break a line, or drive the terminal.
///
/// # Errors
/// As [`data`].
pub fn lines<S: AsRef<str>>(lines: impl IntoIterator<Item = S>) -> Result<()> {
    let mut text = String::new();
    for line in lines {
        text += &printable(line.as_ref());
        text.push('\n');
    }
    data(&text)
}

/// Prints a text to stdout as it is. A closed pipe (`presight sensors | head -1`) is no error: nobody wants more.
///
/// # Errors
/// [`ErrorKind::System`] if stdout cannot be written for another reason (a full disk behind it).
pub fn data(text: &str) -> Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            let what = format!("cannot write: {e}");
            Err(Error::new(ErrorKind::System, what, "check where stdout goes").at("stdout").caused_by(e))
        }
        _ => Ok(()),
    }
}

/// Prints one line to stderr, printable and of bounded length. If stderr is gone nobody can be told.
pub fn message(line: &str) {
    // An error has four parts.
    let line = clipped(line, 5 * limits::MAX_SHOWN);
    let _ = writeln!(io::stderr().lock(), "{}", printable(&line));
}

/// Tells what an interrupted run of a series left, if anything.
pub fn finished_before(progress: &SeriesProgress, count: usize) {
    if progress.finished() > 0 {
        let finished = progress.finished();
        message(&format!("note: {finished} of {count} poses are finished already; this goes on with the others"));
    }
}

/// Prints things to know that stopped nothing, one line each.
pub fn notices<'a>(notices: impl IntoIterator<Item = &'a String>) {
    for notice in notices {
        message(&format!("note: {notice}"));
    }
}
