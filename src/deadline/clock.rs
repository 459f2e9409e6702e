//! The clock, which tests replace.

use std::fmt;
use std::sync::Arc;
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

/// The time of one prediction.
#[derive(Clone, Debug)]
pub struct Watch {
    clock: Arc<dyn Clock>,
    start: Duration,
    /// From the start on: when drawing has to stop.
    stop: Duration,
}

impl Watch {
    /// Starts now; drawing has to stop after `stop`.
    pub fn start(clock: Arc<dyn Clock>, stop: Duration) -> Self {
        Self { start: clock.now(), clock, stop }
    }

    /// Time since the start. A clock that is set back tells no negative time.
    pub fn elapsed(&self) -> Duration {
        self.clock.now().saturating_sub(self.start)
    }

    /// True when drawing has to stop.
    pub fn is_over(&self) -> bool {
        self.elapsed() >= self.stop
    }

    /// Time left for drawing.
    pub fn left(&self) -> Duration {
        self.stop.saturating_sub(self.elapsed())
    }

    pub(crate) fn stop_later(&mut self, by: Duration) {
        self.stop = self.stop.saturating_add(by);
    }

    pub(crate) fn stop_after(&mut self, stop: Duration) {
        self.stop = stop;
    }
}
