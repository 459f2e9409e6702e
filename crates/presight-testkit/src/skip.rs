//! Skipping of tests that lack a requirement. Skips are reported and counted, and fail where everything must be tested.

use std::io::Write;

/// Environment variable with the file of skipped tests, which `tests/run` counts.
const LIST: &str = "PRESIGHT_SKIPPED";

/// Skips a test or a part of one: prints the reason to stderr and appends a line to the file in `PRESIGHT_SKIPPED`.
///
/// # Panics
/// In CI and with `PRESIGHT_REQUIRE_DATA=1`, where skipping is not allowed.
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
    // A single append, because tests run in parallel.
    let file = std::fs::OpenOptions::new().append(true).open(&list);
    file.and_then(|mut file| file.write_all(line.as_bytes())).unwrap_or_else(|e| panic!("{LIST}={list:?}: {e}"));
}

/// Calls [`skip`] because the GPU engine cannot be opened.
#[expect(clippy::print_stderr, reason = "which fault it is differs from machine to machine, and is not counted apart")]
pub fn no_adapter(fault: impl std::fmt::Display) {
    eprintln!("no adapter: {fault}");
    skip("there is no adapter; see presight doctor");
}
