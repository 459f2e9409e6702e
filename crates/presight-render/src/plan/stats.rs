//! Statistics: the stages of a prediction, their times and their work.

use super::names::{CountName, Part, StageName};
use super::raster::Raster;
use super::way::Way;
use crate::deadline::{DeadlineOutcome, Degradation};
use presight_model::clock::Instant;
use serde::Serialize;
use std::borrow::Cow;

/// Statistics of one prediction.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Stats {
    /// `cpu`, `gpu`, `reference`, or `row` for a cut of the world.
    pub engine: &'static str,
    /// Adapter and driver, for the GPU engine.
    pub adapter: Option<String>,
    /// The rasterizer used on that adapter; `None` if it drew no polygon.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub raster: Option<Raster>,
    /// Strategy of the CPU engine; `None` for other engines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub way: Option<Way>,
    /// CPU threads.
    pub threads: usize,
    /// Name of the index that selected the polygons.
    pub index: &'static str,
    /// Milliseconds by stage, in order. Only stages that ran are listed.
    #[doc(hidden)]
    pub stages_ms: Vec<(StageName, f64)>,
    /// Counts by name, in order.
    #[doc(hidden)]
    pub counts: Vec<(CountName, u64)>,
    /// The work done, as counts that do not depend on the machine's load.
    #[doc(hidden)]
    pub work: Work,
    /// Variants of stages that this prediction needed, and why. Their times are included in the stages' times.
    #[doc(hidden)]
    pub taken: Vec<StageVariant>,
    /// Stages and images that were not needed, and why.
    #[doc(hidden)]
    pub left_out: Vec<Omission>,
    /// Notices for the caller, such as a fallback to the CPU.
    pub notices: Vec<String>,
    /// Outcome of the deadline, if there was one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deadline: Option<DeadlineOutcome>,
}

/// Work counts of a prediction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Work {
    /// Compute passes submitted to the device.
    pub gpu_passes: u64,
    /// Workgroups in these passes, including indirect dispatches.
    pub gpu_workgroups: u64,
    /// Bytes of buffers allocated on the device; 0 in steady state.
    pub gpu_bytes_made: u64,
    /// Bytes written to the device.
    pub gpu_bytes_written: u64,
    /// Bytes read back from the device.
    pub gpu_bytes_read: u64,
    /// Bytes of the caller's images, including unused capacity of earlier images.
    pub image_bytes: u64,
}

impl Work {
    /// The work since `before`; `image_bytes` is the current value.
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

    /// Adds device work.
    pub fn add(&mut self, more: Self) {
        self.gpu_passes += more.gpu_passes;
        self.gpu_workgroups += more.gpu_workgroups;
        self.gpu_bytes_made += more.gpu_bytes_made;
        self.gpu_bytes_written += more.gpu_bytes_written;
        self.gpu_bytes_read += more.gpu_bytes_read;
    }

    /// Names and values, as in the statistics file.
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

/// A variant of a stage that was needed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct StageVariant {
    /// Its name.
    pub what: StageName,
    /// Why it was needed.
    pub why: &'static str,
}

/// A stage or image that this prediction does not need, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Omission {
    /// The omitted stage, image or group.
    pub what: Part,
    /// Why it is not needed.
    pub why: Cow<'static, str>,
}

/// One row of [`Stats::stages`]: a stage, a variant of one, an image, or a group of objects.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageRow {
    /// Its name.
    pub name: String,
    /// False if it was left out.
    pub ran: bool,
    /// Why it ran or was left out; empty for a stage that always runs.
    pub why: String,
    /// Milliseconds in this prediction; `None` for omitted rows, and for variants, whose time is included in a stage.
    pub ms: Option<f64>,
}

/// Stages that run after a prediction, only on request.
const AFTER: [StageName; 2] = [StageName::Features, StageName::RegionsOfInterest];

impl Stats {
    /// The parts given up for the deadline; `None` if the prediction is complete.
    pub fn degradation(&self) -> Option<&Degradation> {
        self.deadline.as_ref()?.given_up.as_ref()
    }

    /// Milliseconds of a stage, summed over its runs; `None` if it did not run.
    #[doc(hidden)]
    pub fn stage_ms(&self, name: StageName) -> Option<f64> {
        let mut runs = self.stages_ms.iter().filter(|(stage, _)| *stage == name).map(|(_, ms)| *ms);
        let first = runs.next()?;
        Some(runs.fold(first, |sum, ms| sum + ms))
    }

    /// The first count with this name; `None` if there is none.
    #[doc(hidden)]
    pub fn count_of(&self, name: CountName) -> Option<u64> {
        self.counts.iter().find(|(count, _)| *count == name).map(|(_, n)| *n)
    }

    /// Records the time since `start` under a stage name.
    #[doc(hidden)]
    pub fn stage(&mut self, name: StageName, start: Instant) {
        self.stages_ms.push((name, start.elapsed().as_secs_f64() * 1e3));
    }

    /// Records a count.
    #[doc(hidden)]
    pub fn count(&mut self, name: CountName, n: usize) {
        self.counts.push((name, n as u64));
    }

    /// Records a variant that was needed.
    #[doc(hidden)]
    pub fn take(&mut self, what: StageName, why: &'static str) {
        self.taken.push(StageVariant { what, why });
    }

    /// Records a stage or image that was not needed.
    #[doc(hidden)]
    pub fn leave_out(&mut self, what: impl Into<Part>, why: impl Into<Cow<'static, str>>) {
        self.left_out.push(Omission { what: what.into(), why: why.into() });
    }

    /// Every stage, variant and image of this prediction: stages that ran, with times; variants that they needed; then
    /// everything left out. `--explain` and reports show this list.
    pub fn stages(&self) -> Vec<StageRow> {
        let row = |name: String, ran, why: &str, ms| StageRow { name, ran, why: why.to_owned(), ms };
        let ran = self.stages_ms.iter().map(|(name, ms)| row(name.to_string(), true, "", Some(*ms)));
        let mut rows: Vec<StageRow> = ran.collect();
        rows.extend(self.taken.iter().map(|t| row(t.what.to_string(), true, t.why, None)));
        rows.extend(self.left_out.iter().map(|l| row(l.what.to_string(), false, &l.why, None)));
        for name in AFTER {
            if !rows.iter().any(|r| r.name == name.name()) {
                rows.push(row(name.to_string(), false, "not requested", None));
            }
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_one_stage_add_up_and_stages_left_out_say_why() {
        let mut stats = Stats::default();
        stats.stages_ms.extend([(StageName::Setup, 0.25), (StageName::Setup, 0.5)]);
        assert_eq!((stats.stage_ms(StageName::Setup), stats.stage_ms(StageName::Echo)), (Some(0.75), None));
        stats.leave_out(StageName::RayTable, "no lens distortion");
        let rows = stats.stages();
        assert_eq!((rows[0].name.as_str(), rows[0].ran), ("setup", true));
        let left_out = rows.iter().find(|row| row.name == "ray table").unwrap();
        assert_eq!((left_out.ran, left_out.ms, left_out.why.as_str()), (false, None, "no lens distortion"));
    }
}
