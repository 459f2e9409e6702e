//! Printing to stdout and stderr that tolerates closed pipes.

use super::flags;
use super::series::SeriesProgress;
use glam::DVec3;
use presight::tools::{self, clipped, printable};
use presight::{Error, ErrorKind, Result, Scene};
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};

/// Prints lines for people to stdout. Escapes control characters: names cannot break a line or control the terminal.
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

/// Prints text to stdout unchanged. A closed pipe is not an error: see `presight sensors | head -1`.
///
/// # Errors
/// [`ErrorKind::System`] if writing to stdout fails for another reason, such as a full disk.
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

/// Prints one line to stderr, escaped, of bounded length and with the command's flags in place of the library's
/// arguments. Errors are ignored: there is nowhere to report them.
pub fn message(line: &str) {
    let line = flags::named(line);
    // An error has up to four parts of MAX_SHOWN each.
    let line = clipped(&line, 5 * tools::MAX_SHOWN);
    let _ = writeln!(io::stderr().lock(), "{}", printable(&line));
}

/// Prints how many poses an interrupted run has finished, if any.
pub fn finished_before(progress: &SeriesProgress, count: usize) {
    if progress.finished() > 0 {
        let finished = progress.finished();
        message(&format!("note: {finished} of {count} poses are already finished; continuing with the rest"));
    }
}

/// Prints a notice if poses are farther outside of a model than it is large.
pub fn far_outside(scene: &Scene, positions: impl IntoIterator<Item = DVec3>) {
    notices(&tools::poses_far_outside(&scene.world.environment().bounds(), positions));
}

/// Prints notices, one line each. A notice that this process has printed is not printed again: most of a series would
/// come with every frame.
pub fn notices<'a>(notices: impl IntoIterator<Item = &'a String>) {
    static PRINTED: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    for notice in notices {
        if PRINTED.lock().unwrap_or_else(PoisonError::into_inner).insert(notice.clone()) {
            message(&format!("note: {notice}"));
        }
    }
}
