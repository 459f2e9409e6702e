//! Logs of a robot's other sensors.

use presight::Result;
use presight::files::{LogFrames, Observation};

/// The log of another sensor.
pub(super) struct LogBeside {
    pub frames: LogFrames,
    pub next: Option<Observation>,
}

/// Maximum difference between the stamps of simultaneous frames, seconds.
const SAME_TIME: f64 = 0.01;

impl LogBeside {
    /// The frame that was taken at a time. Earlier ones are passed over.
    pub fn next_at(&mut self, stamp: f64) -> Result<Option<Observation>> {
        loop {
            let next = match self.next.take() {
                Some(next) => next,
                None => match self.frames.next().transpose()? {
                    Some(next) => next,
                    None => return Ok(None),
                },
            };
            if next.frame.stamp > stamp + SAME_TIME {
                self.next = Some(next);
                return Ok(None);
            }
            if next.frame.stamp >= stamp - SAME_TIME {
                return Ok(Some(next));
            }
        }
    }
}
