//! The clock, which tests replace.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Tells the time since some fixed moment.
pub trait Clock: fmt::Debug + Send + Sync {
    /// Time since that moment.
    fn now(&self) -> Duration;
}

/// The system's clock that only goes forward.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock(Instant);

impl Default for SystemClock {
    fn default() -> Self {
        Self(Instant::now())
    }
}

impl Clock for SystemClock {
    fn now(&self) -> Duration {
        self.0.elapsed()
    }
}

/// Work between two looks at the clock, all threads together: nanoseconds of a slow core.
const SPACING: u64 = 40_000;
/// In place of work done: the time is up, and nobody needs to look again.
const OVER: u64 = 1 << 63;

/// The time of one prediction.
#[derive(Clone, Debug)]
pub struct Watch {
    clock: Arc<dyn Clock>,
    start: Duration,
    /// From the start on: when drawing has to stop.
    stop: Duration,
    spacing: u64,
    /// Work done since the last look.
    worked: Arc<AtomicU64>,
}

impl Watch {
    /// Starts now; drawing has to stop after `stop`.
    pub fn start(clock: Arc<dyn Clock>, stop: Duration) -> Self {
        Self { start: clock.now(), clock, stop, spacing: SPACING, worked: Arc::default() }
    }

    /// Looks at the clock after any work: for tests, which stop by counted looks.
    #[doc(hidden)]
    #[must_use]
    pub fn looking_always(self) -> Self {
        Self { spacing: 0, ..self }
    }

    /// Time since the start. A clock that is set back tells no negative time.
    pub fn elapsed(&self) -> Duration {
        self.clock.now().saturating_sub(self.start)
    }

    /// True when drawing has to stop.
    pub fn is_over(&self) -> bool {
        self.elapsed() >= self.stop
    }

    /// The same after so much more work, in nanoseconds of a slow core. A look at the clock may take as long as drawing a polygon: all
    /// threads together look once in so much work, and the first that finds the time up tells the others.
    pub fn is_over_after(&self, work: u64) -> bool {
        let worked = self.worked.fetch_add(work, Ordering::Relaxed) + work;
        if worked < self.spacing {
            return false;
        }
        let over = worked >= OVER || self.is_over();
        self.worked.store(if over { OVER } else { 0 }, Ordering::Relaxed);
        over
    }

    /// Time left for drawing.
    pub fn left(&self) -> Duration {
        self.stop.saturating_sub(self.elapsed())
    }

    pub(crate) fn stop_later(&mut self, by: Duration) {
        self.stop_after(self.stop.saturating_add(by));
    }

    pub(crate) fn stop_after(&mut self, stop: Duration) {
        (self.stop, self.worked) = (stop, Arc::default());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every look takes a millisecond.
    #[derive(Debug, Default)]
    struct Looks(AtomicU64);

    impl Clock for Looks {
        fn now(&self) -> Duration {
            Duration::from_millis(self.0.fetch_add(1, Ordering::Relaxed))
        }
    }

    /// By hand: the watch starts at the first look, and its third one after that, at 3 ms, is over. Each comes after four pieces of work
    /// of a quarter of the spacing; then nobody looks.
    #[test]
    fn the_clock_is_looked_at_once_in_so_much_work() {
        let clock = Arc::new(Looks::default());
        let watch = Watch::start(clock.clone(), Duration::from_millis(3));
        let over: Vec<bool> = (0..20).map(|_| watch.clone().is_over_after(SPACING / 4)).collect();
        assert_eq!(over.iter().position(|over| *over), Some(11));
        assert!(over[11..].iter().all(|over| *over));
        assert_eq!(clock.0.load(Ordering::Relaxed), 4);
        // Another time to stop is looked for anew.
        let mut later = watch.clone();
        later.stop_later(Duration::from_secs(1));
        assert!(!later.is_over_after(SPACING) && watch.is_over_after(0));
        assert!(!later.looking_always().is_over_after(0));
    }
}
