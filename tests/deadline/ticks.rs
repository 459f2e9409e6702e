//! Clocks that do not depend on time.

use presight_render::deadline::Clock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Every reading advances the clock by a microsecond or by another step.
#[derive(Debug)]
pub struct Ticks {
    looks: AtomicU64,
    microseconds: u64,
}

impl Default for Ticks {
    fn default() -> Self {
        Self::of(1)
    }
}

impl Ticks {
    pub fn of(microseconds: u64) -> Self {
        Self { looks: AtomicU64::new(0), microseconds }
    }

    /// The number of readings.
    pub fn looks(&self) -> u64 {
        self.looks.load(Ordering::Relaxed)
    }
}

impl Clock for Ticks {
    fn now(&self) -> Duration {
        Duration::from_micros(self.microseconds * self.looks.fetch_add(1, Ordering::Relaxed))
    }
}

/// A clock that must not be read.
#[derive(Debug)]
pub struct Untouchable;

impl Clock for Untouchable {
    fn now(&self) -> Duration {
        panic!("a clock decides about a prediction without a deadline")
    }
}

/// A clock that jumps back and forth.
#[derive(Debug, Default)]
pub struct Jumping(AtomicU64);

impl Clock for Jumping {
    fn now(&self) -> Duration {
        let n = self.0.fetch_add(1, Ordering::Relaxed);
        Duration::from_micros(if n.is_multiple_of(3) { 5_000_000 - n } else { n * n })
    }
}

/// Every reading advances the clock by a microsecond; from a certain reading on, an hour has passed.
#[derive(Debug)]
pub struct Sudden {
    looks: AtomicU64,
    at: u64,
}

impl Sudden {
    pub fn at(look: u64) -> Self {
        Self { looks: AtomicU64::new(0), at: look }
    }
}

impl Clock for Sudden {
    fn now(&self) -> Duration {
        let n = self.looks.fetch_add(1, Ordering::Relaxed);
        Duration::from_micros(if n < self.at { n } else { 3_600_000_000 + n })
    }
}
