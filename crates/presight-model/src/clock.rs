//! The clock of the libraries: no other module reads the system's.
//!
//! WebAssembly without an operating system has no clock. There the time stands still until [`set_clock`] provides one:
//! durations in statistics are zero, and a deadline never passes.

use std::sync::OnceLock;
use std::time::{Duration, SystemTime};

/// The clock that replaces the system's.
static GIVEN: OnceLock<fn() -> f64> = OnceLock::new();

/// Sets the clock of the libraries: a function that returns the seconds since a fixed moment and never goes back, such
/// as a browser's `performance.now() / 1000`. Only the first call has an effect; call it before anything else.
///
/// Returns true if the clock was set.
///
/// ```
/// # use std::time::Instant;
/// # use std::sync::LazyLock;
/// fn seconds() -> f64 {
///     // In a browser, a call of an imported function.
/// #   static START: LazyLock<Instant> = LazyLock::new(Instant::now);
/// #   START.elapsed().as_secs_f64()
/// }
/// assert!(presight::set_clock(seconds));
/// assert!(!presight::set_clock(seconds), "only once");
/// ```
pub fn set_clock(seconds: fn() -> f64) -> bool {
    GIVEN.set(seconds).is_ok()
}

/// A moment, as in [`std::time::Instant`], on every platform.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Instant(Duration);

impl Instant {
    /// This moment.
    pub fn now() -> Self {
        Self(GIVEN.get().map_or_else(system, |seconds| duration(seconds())))
    }

    /// The time since this moment; zero if the clock went back.
    pub fn elapsed(self) -> Duration {
        Self::now().0.saturating_sub(self.0)
    }
}

/// Zero for anything that is not a duration.
fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

#[cfg(not(target_family = "wasm"))]
fn system() -> Duration {
    static START: std::sync::LazyLock<std::time::Instant> = std::sync::LazyLock::new(std::time::Instant::now);
    START.elapsed()
}

#[cfg(target_family = "wasm")]
fn system() -> Duration {
    Duration::ZERO
}

/// The age of a file that was modified at this time; `None` if that is in the future, or if there is no calendar.
pub fn age(modified: SystemTime) -> Option<Duration> {
    if cfg!(target_family = "wasm") { None } else { modified.elapsed().ok() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};

    static MILLISECONDS: AtomicU64 = AtomicU64::new(1000);

    fn given() -> f64 {
        MILLISECONDS.load(Ordering::Relaxed) as f64 / 1e3
    }

    /// One test: the clock is set for the whole process.
    #[test]
    fn the_clock_runs_and_can_be_replaced_once() {
        let before = Instant::now();
        std::thread::sleep(Duration::from_millis(2));
        assert!(before.elapsed() >= Duration::from_millis(2));
        assert!(set_clock(given) && !set_clock(|| 0.0));
        let start = Instant::now();
        assert_eq!(start.elapsed(), Duration::ZERO);
        MILLISECONDS.store(3500, Ordering::Relaxed);
        assert_eq!(start.elapsed(), Duration::from_millis(2500));
        MILLISECONDS.store(0, Ordering::Relaxed);
        assert_eq!(start.elapsed(), Duration::ZERO, "it went back");
        for odd in [-1.0, f64::NAN, f64::INFINITY, 1e300] {
            assert_eq!(duration(odd), Duration::ZERO);
        }
    }

    #[test]
    fn files_of_the_future_have_no_age() {
        let hour = Duration::from_secs(3600);
        assert!(age(SystemTime::UNIX_EPOCH).is_some_and(|age| age > hour));
        assert_eq!(age(SystemTime::now() + hour), None);
    }
}
