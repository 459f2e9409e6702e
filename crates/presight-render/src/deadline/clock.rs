//! The clock, which tests can replace.

use presight_model::clock::Instant;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Returns the time since a fixed moment.
pub trait Clock: fmt::Debug + Send + Sync {
    /// Time since that moment.
    fn now(&self) -> Duration;
}

/// The system's monotonic clock.
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

/// Work between two reads of the clock by all threads together, in nanoseconds of a slow core.
const SPACING: u64 = 40_000;
/// Also at most this share of the time left. The divisor allows for machines this many times slower than the slow core.
const SHARE: u32 = 16;
/// Sentinel for the work done: the time is up, and no thread needs to read the clock again.
const OVER: u64 = 1 << 63;

/// The time budget of one prediction.
#[derive(Clone, Debug)]
pub struct Watch {
    clock: Arc<dyn Clock>,
    start: Duration,
    /// Time after the start at which drawing must stop.
    stop: Duration,
    spacing: u64,
    /// Work since the last read of the clock, and the work after which the next one is due.
    worked: Arc<AtomicU64>,
    next: Arc<AtomicU64>,
}

impl Watch {
    /// Starts now. Drawing must stop after `stop`.
    pub fn start(clock: Arc<dyn Clock>, stop: Duration) -> Self {
        let next = Arc::new(AtomicU64::new(SPACING));
        Self { start: clock.now(), clock, stop, spacing: SPACING, worked: Arc::default(), next }
    }

    /// Reads the clock after any amount of work, for tests that count reads.
    #[must_use]
    pub fn looking_always(self) -> Self {
        Self { spacing: 0, next: Arc::default(), ..self }
    }

    /// Time since the start; zero if the clock was set back.
    pub fn elapsed(&self) -> Duration {
        self.clock.now().saturating_sub(self.start)
    }

    /// True if drawing must stop.
    pub fn is_over(&self) -> bool {
        self.elapsed() >= self.stop
    }

    /// The same after this much more work, in nanoseconds of a slow core. Reading the clock may take as long as drawing
    /// a polygon. All threads therefore share one read per amount of work, which grows with the time left, and the
    /// first thread that finds the time up informs the others.
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

    /// Moves the stop to a later time.
    pub fn stop_later(&mut self, by: Duration) {
        self.stop_after(self.stop.saturating_add(by));
    }

    /// Stops this long after the start.
    pub fn stop_after(&mut self, stop: Duration) {
        (self.stop, self.worked) = (stop, Arc::default());
        self.next = Arc::new(AtomicU64::new(self.spacing));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every read takes a millisecond.
    #[derive(Debug, Default)]
    struct Looks(AtomicU64);

    impl Clock for Looks {
        fn now(&self) -> Duration {
            Duration::from_millis(self.0.fetch_add(1, Ordering::Relaxed))
        }
    }

    /// By hand: the watch starts at the first read; the third read after that, at 3 ms, is over. Reads are due after
    /// 40 us of work, then after a sixteenth of the 2 ms left (125 us) and of 1 ms (62.5 us): at pieces 4, 17 and 24.
    #[test]
    fn the_clock_is_looked_at_once_in_so_much_work() {
        let clock = Arc::new(Looks::default());
        let watch = Watch::start(clock.clone(), Duration::from_millis(3));
        let over: Vec<bool> = (0..40).map(|_| watch.clone().is_over_after(SPACING / 4)).collect();
        assert_eq!(over.iter().position(|over| *over), Some(23));
        assert!(over[23..].iter().all(|over| *over));
        assert_eq!(clock.0.load(Ordering::Relaxed), 4);
        // A changed stop time requires a new read.
        let mut later = watch.clone();
        later.stop_later(Duration::from_secs(1));
        assert!(!later.is_over_after(SPACING) && watch.is_over_after(0));
        assert!(!later.looking_always().is_over_after(0));
    }
}
