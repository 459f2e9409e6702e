//! What a prediction cost.

use super::LeftOut;
use serde::Serialize;
use std::time::Instant;

/// The count of polygons that an engine left out because it could not prove on which side of them the sensor is.
pub const EDGE_ON: &str = "polygons edge-on";

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
    /// Milliseconds by stage, in order: those stages only that ran.
    pub stages_ms: Vec<(String, f64)>,
    /// Counts by name (polygons selected, set up, edge-on, ...), in order.
    pub counts: Vec<(String, u64)>,
    /// What was done, in numbers that no other work on the machine changes.
    pub work: Work,
    /// Variants of stages that the prediction took although they cost something, and why. Their times are those stages'.
    pub taken: Vec<Taken>,
    /// What was not needed, and why.
    pub left_out: Vec<LeftOut>,
    /// What the caller should know: a fallback taken, polygons edge-on.
    pub notices: Vec<String>,
}

/// What a prediction did and made, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Work {
    /// Compute passes that the device was given.
    pub gpu_passes: u64,
    /// Workgroups in them, those included whose number the device found itself.
    pub gpu_workgroups: u64,
    /// Bytes of the buffers that were made on the device: 0 in steady state.
    pub gpu_bytes_made: u64,
    /// Bytes written to the device.
    pub gpu_bytes_written: u64,
    /// Bytes read back from the device.
    pub gpu_bytes_read: u64,
    /// Bytes that the caller's images hold, and room that they had from before.
    pub image_bytes: u64,
}

impl Work {
    /// What was done since `before`; images are those of now.
    #[must_use]
    pub fn since(self, before: Self) -> Self {
        Self {
            gpu_passes: self.gpu_passes - before.gpu_passes,
            gpu_workgroups: self.gpu_workgroups - before.gpu_workgroups,
            gpu_bytes_made: self.gpu_bytes_made - before.gpu_bytes_made,
            gpu_bytes_written: self.gpu_bytes_written - before.gpu_bytes_written,
            gpu_bytes_read: self.gpu_bytes_read - before.gpu_bytes_read,
            image_bytes: self.image_bytes,
        }
    }

    /// Adds what was done on the device.
    pub fn add(&mut self, more: Self) {
        self.gpu_passes += more.gpu_passes;
        self.gpu_workgroups += more.gpu_workgroups;
        self.gpu_bytes_made += more.gpu_bytes_made;
        self.gpu_bytes_written += more.gpu_bytes_written;
        self.gpu_bytes_read += more.gpu_bytes_read;
    }

    /// Names and numbers, as statistics have them.
    pub fn counts(&self) -> [(&'static str, u64); 6] {
        [
            ("gpu passes", self.gpu_passes),
            ("gpu workgroups", self.gpu_workgroups),
            ("gpu bytes made", self.gpu_bytes_made),
            ("gpu bytes written", self.gpu_bytes_written),
            ("gpu bytes read", self.gpu_bytes_read),
            ("image bytes", self.image_bytes),
        ]
    }
}

/// A variant of a stage that was needed, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Taken {
    /// What was needed.
    pub what: String,
    /// Why it could not be left out.
    pub why: String,
}

/// A stage, a variant of one, an image, or objects: whether this prediction had to do with it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageRow {
    /// What it is.
    pub name: String,
    /// False if it was left out.
    pub ran: bool,
    /// Why it was taken or left out; empty for a stage that has no choice.
    pub why: String,
    /// Milliseconds in this prediction; `None` for what was left out, and for variants, whose time is that of stages.
    pub ms: Option<f64>,
}

/// Stages that follow a prediction only if they are asked for.
const AFTER: [&str; 2] = ["features", "regions of interest"];

impl Stats {
    /// Notes the time since `start` under a stage name.
    pub fn stage(&mut self, name: &str, start: Instant) {
        self.stages_ms.push((name.to_owned(), start.elapsed().as_secs_f64() * 1e3));
    }

    /// Notes a count.
    pub fn count(&mut self, name: &str, n: usize) {
        self.counts.push((name.to_owned(), n as u64));
    }

    /// Notes a variant that was needed.
    pub fn take(&mut self, what: impl Into<String>, why: impl Into<String>) {
        self.taken.push(Taken { what: what.into(), why: why.into() });
    }

    /// Notes what was not needed.
    pub fn leave_out(&mut self, what: impl Into<String>, why: impl Into<String>) {
        self.left_out.push(LeftOut { what: what.into(), why: why.into() });
    }

    /// Every stage, variant and image of this prediction: first the stages that ran, with their times, then the variants
    /// they took, then what was left out. One list for the command's `--explain` and for reports.
    ///
    /// ```
    /// use presight::Stats;
    /// let mut stats = Stats::default();
    /// stats.stages_ms.push(("setup".into(), 0.25));
    /// stats.leave_out("ray table", "no lens distortion");
    /// let rows = stats.stages();
    /// assert_eq!((rows[0].name.as_str(), rows[0].ran, rows[0].ms), ("setup", true, Some(0.25)));
    /// assert_eq!((rows[1].name.as_str(), rows[1].ran, rows[1].ms), ("ray table", false, None));
    /// assert_eq!(rows[2].why, "not asked for", "features, and after them regions of interest");
    /// ```
    pub fn stages(&self) -> Vec<StageRow> {
        let row = |name: &str, ran, why: &str, ms| StageRow { name: name.to_owned(), ran, why: why.to_owned(), ms };
        let mut rows: Vec<StageRow> = self.stages_ms.iter().map(|(name, ms)| row(name, true, "", Some(*ms))).collect();
        rows.extend(self.taken.iter().map(|t| row(&t.what, true, &t.why, None)));
        rows.extend(self.left_out.iter().map(|l| row(&l.what, false, &l.why, None)));
        for name in AFTER {
            if !rows.iter().any(|r| r.name == name) {
                rows.push(row(name, false, "not asked for", None));
            }
        }
        rows
    }
}
