//! What a prediction cost.

use super::LeftOut;
use serde::Serialize;
use std::time::Instant;

/// What one prediction cost.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Stats {
    /// `cpu`, `gpu` or `reference`.
    pub engine: String,
    /// Adapter and driver, for the GPU engine.
    pub adapter: Option<String>,
    /// CPU threads.
    pub threads: usize,
    /// Scheme of the index that selected polygons.
    pub index: String,
    /// Milliseconds by stage, in order.
    pub stages_ms: Vec<(String, f64)>,
    /// Counts by name (polygons selected, set up, edge-on, ...), in order.
    pub counts: Vec<(String, u64)>,
    /// What was not needed, and why.
    pub left_out: Vec<LeftOut>,
    /// What the caller should know: a fallback taken, polygons edge-on.
    pub notices: Vec<String>,
}

impl Stats {
    /// Notes the time since `start` under a stage name.
    pub fn stage(&mut self, name: &str, start: Instant) {
        self.stages_ms.push((name.to_owned(), start.elapsed().as_secs_f64() * 1e3));
    }

    /// Notes a count.
    pub fn count(&mut self, name: &str, n: usize) {
        self.counts.push((name.to_owned(), n as u64));
    }
}
