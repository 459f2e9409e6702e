//! Progress bars.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::time::Duration;

/// The number of steps so far and of those a second, on stderr, hidden if stderr is not a terminal.
pub fn count(name: &'static str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{pos} {prefix}, {per_sec}, {elapsed}; {wide_msg}");
    ProgressBar::no_length().with_prefix(name).with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()))
}

/// How far a search of the whole map is: the part of the places that were looked round at, and the time that the others
/// take.
pub fn looking_round(done: usize, all: usize, since: Duration) -> String {
    let part = done as f64 / all.max(1) as f64;
    let left = since.as_secs_f64() * (1.0 - part) / part;
    let left = if left.is_finite() { format!(", {left:.0} s left") } else { String::new() };
    format!("looking round in the whole map: {:.0} %{left}", 100.0 * part)
}

/// A progress bar on stderr, hidden if stderr is not a terminal.
pub fn bar(steps: u64) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:24} {pos}/{len} {elapsed} {wide_msg}");
    ProgressBar::new(steps).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: a quarter took 3 s, so three quarters take 9 s. Nothing is known before the first place.
    #[test]
    fn a_search_says_the_time_left() {
        let said = looking_round(1000, 4000, Duration::from_secs(3));
        assert_eq!(said, "looking round in the whole map: 25 %, 9 s left");
        assert_eq!(looking_round(0, 4000, Duration::from_millis(1)), "looking round in the whole map: 0 %");
    }
}
