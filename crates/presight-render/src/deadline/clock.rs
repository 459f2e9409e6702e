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
/// And at most this share of the time left, where it is far: work may take so many times as long as on a slow core.
const SHARE: u32 = 16;
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
    /// Work done since the last look, and after how much the next one follows.
    worked: Arc<AtomicU64>,
    next: Arc<AtomicU64>,
}

impl Watch {
    /// Starts now; drawing has to stop after `stop`.
    pub fn start(clock: Arc<dyn Clock>, stop: Duration) -> Self {
        let next = Arc::new(AtomicU64::new(SPACING));
        Self { start: clock.now(), clock, stop, spacing: SPACING, worked: Arc::default(), next }
    }

    /// Looks at the clock after any work: for tests, which stop by counted looks.
    #[doc(hidden)]
    #[must_use]
    pub fn looking_always(self) -> Self {
        Self { spacing: 0, next: Arc::default(), ..self }
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
    /// threads together look once in so much work, the more seldom the more time is left, and the first that finds the time up
    /// tells the others.
    pub fn is_over_after(&self, work: u64) -> bool {
        let worked = self.worked.fetch_add(work, Ordering::Relaxed) + work;
        if worked < self.next.load(Ordering::Relaxed) {
            return false;
        }
        let left = if worked >= OVER { Duration::ZERO } else { self.left() };
        if self.spacing > 0 {
            let share = u64::try_from((left / SHARE).as_nanos()).unwrap_or(OVER).min(OVER);
            self.next.store(share.max(self.spacing), Ordering::Relaxed);
        }
        self.worked.store(if left.is_zero() { OVER } else { 0 }, Ordering::Relaxed);
        left.is_zero()
    }

    /// Time left for drawing.
    pub fn left(&self) -> Duration {
        self.stop.saturating_sub(self.elapsed())
    }

    pub fn stop_later(&mut self, by: Duration) {
        self.stop_after(self.stop.saturating_add(by));
    }

    pub fn stop_after(&mut self, stop: Duration) {
        (self.stop, self.worked) = (stop, Arc::default());
        self.next = Arc::new(AtomicU64::new(self.spacing));
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

    /// By hand: the watch starts at the first look, and its third one after that, at 3 ms, is over. They come after 40 us of work, after
    /// a sixteenth of the 2 ms that are left then, 125 us, and of 1 ms, 62.5 us: pieces 4, 17 and 24 of 10 us each. Then nobody looks.
    #[test]
    fn the_clock_is_looked_at_once_in_so_much_work() {
        let clock = Arc::new(Looks::default());
        let watch = Watch::start(clock.clone(), Duration::from_millis(3));
        let over: Vec<bool> = (0..40).map(|_| watch.clone().is_over_after(SPACING / 4)).collect();
        assert_eq!(over.iter().position(|over| *over), Some(23));
        assert!(over[23..].iter().all(|over| *over));
        assert_eq!(clock.0.load(Ordering::Relaxed), 4);
        // Another time to stop is looked for anew.
        let mut later = watch.clone();
        later.stop_later(Duration::from_secs(1));
        assert!(!later.is_over_after(SPACING) && watch.is_over_after(0));
        assert!(!later.looking_always().is_over_after(0));
    }
}
