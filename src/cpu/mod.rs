//! The CPU engine: exact spans.

use crate::error::Result;
use crate::plan::{FramePlan, Images};
use crate::predict::Stats;

/// The CPU engine with its buffers.
pub struct Engine {
    threads: usize,
}

impl Engine {
    /// With so many threads; 0 takes all cores.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if the threads cannot be started.
    pub fn new(threads: usize) -> Result<Self> {
        Ok(Self { threads })
    }

    /// Fills the asked images.
    ///
    /// # Errors
    /// None yet.
    pub fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        stats.threads = self.threads;
        images.prepare(plan.sensor.width(), plan.sensor.height(), plan.request.outputs);
        Ok(())
    }
}
