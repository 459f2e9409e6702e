//! A test that lacks something it needs says so, is counted, and fails where everything has to be tested.

use std::io::Write;

/// Names the file that `tests/run` counts.
const LIST: &str = "PRESIGHT_SKIPPED";

/// Skips a test or a part of one: says why on stderr and adds a line to the file that `PRESIGHT_SKIPPED` names.
///
/// # Panics
/// In CI and with `PRESIGHT_REQUIRE_DATA=1`: nothing may be skipped there.
#[expect(clippy::print_stderr, reason = "a skipped test says so")]
pub fn skip(reason: &str) {
    let required = std::env::var_os("CI").is_some() || std::env::var("PRESIGHT_REQUIRE_DATA").is_ok_and(|v| v == "1");
    assert!(!required, "nothing may be skipped here: {reason}");
    eprintln!("SKIPPED: {reason}");
    let Some(list) = std::env::var_os(LIST) else { return };
    let program = std::env::current_exe().unwrap_or_default();
    let program = program.file_stem().unwrap_or_default().to_string_lossy();
    let thread = std::thread::current();
    let line = format!("{program} {}\t{}\n", thread.name().unwrap_or_default(), reason.replace(['\t', '\n'], " "));
    // One write, at the end of the file: tests run side by side.
    let file = std::fs::OpenOptions::new().append(true).open(&list);
    file.and_then(|mut file| file.write_all(line.as_bytes())).unwrap_or_else(|e| panic!("{LIST}={list:?}: {e}"));
}

/// [`skip`] where the GPU engine cannot be opened.
#[expect(clippy::print_stderr, reason = "which fault it is differs from machine to machine, and is not counted apart")]
pub fn no_adapter(fault: impl std::fmt::Display) {
    eprintln!("no adapter: {fault}");
    skip("there is no adapter; see presight doctor");
}
