//! Progress bars.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;

/// The number of steps so far and of those a second, on stderr, hidden if stderr is not a terminal.
pub fn count(name: &'static str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{pos} {prefix}, {per_sec}, {elapsed}; {wide_msg}");
    ProgressBar::no_length().with_prefix(name).with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()))
}

/// A progress bar on stderr, hidden if stderr is not a terminal.
pub fn bar(steps: u64) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:24} {pos}/{len} {elapsed} {wide_msg}");
    ProgressBar::new(steps).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
