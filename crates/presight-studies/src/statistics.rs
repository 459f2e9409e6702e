//! Statistics of repeated predictions, as JSON and as text.

use presight::tools::write_atomically;
use presight_model::error::{Error, Result};
use presight_model::statistics::{median, quantile};
use presight_render::deadline::DeadlineOutcome;
use presight_render::plan::{CountName, Raster, StageName, StageRow, StageVariant, Stats, Way, Work};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// Format version of the statistics JSON.
const FORMAT: u32 = 1;

/// Milliseconds over all measured predictions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Milliseconds {
    /// The median. For an even count, the mean of the two middle values.
    pub median: f64,
    /// The 95th percentile by nearest rank.
    pub p95: f64,
    /// The minimum.
    pub min: f64,
}

impl Milliseconds {
    /// Computes the statistics; all are zero if `times` is empty.
    pub fn of(times: &[f64]) -> Self {
        let mut times = times.to_vec();
        let [median, p95, min] = [median(&mut times), quantile(&mut times, 0.95), quantile(&mut times, 0.0)];
        Self { median: median.unwrap_or(0.0), p95: p95.unwrap_or(0.0), min: min.unwrap_or(0.0) }
    }
}

/// The statistics JSON.
#[derive(Debug, Serialize)]
pub struct Statistics {
    format: u32,
    versions: BTreeMap<&'static str, &'static str>,
    scene: String,
    sensor: String,
    width: u32,
    height: u32,
    outputs: Vec<&'static str>,
    engine: &'static str,
    adapter: Option<String>,
    /// How the CPU engine found what rays see.
    #[serde(skip_serializing_if = "Option::is_none")]
    way: Option<Way>,
    /// The rasterizer on that adapter.
    #[serde(skip_serializing_if = "Option::is_none")]
    raster: Option<Raster>,
    threads: usize,
    index: &'static str,
    /// The number of measured predictions, without the warm-up.
    repeat: usize,
    prediction_ms: Milliseconds,
    /// Median times.
    stages_ms: OrderedMap<StageName, f64>,
    counts: OrderedMap<CountName, u64>,
    /// Work of the last prediction.
    work: Work,
    taken: Vec<StageVariant>,
    left_out: Vec<LeftOutRow>,
    notices: Vec<String>,
    /// The deadline outcome of the last prediction.
    #[serde(skip_serializing_if = "Option::is_none")]
    deadline: Option<DeadlineOutcome>,
    #[serde(skip)]
    rows: Vec<StageRow>,
}

/// A JSON object in the order of its entries.
#[derive(Debug)]
struct OrderedMap<K, T>(Vec<(K, T)>);

impl<K: Serialize, T: Serialize> Serialize for OrderedMap<K, T> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(k, v)| (k, v)))
    }
}

/// A stage or image that was skipped.
#[derive(Debug, Serialize)]
struct LeftOutRow {
    what: String,
    why: String,
}

/// The inputs named in the statistics.
#[derive(Debug)]
pub struct Subject {
    /// The scene's path as given.
    pub scene: String,
    /// The sensor's name.
    pub sensor: String,
    /// Columns and rows.
    pub size: (u32, u32),
    /// Names of the requested images.
    pub outputs: Vec<&'static str>,
}

impl Statistics {
    /// Computes the statistics from the total time of each measured prediction in ms, and from their own statistics.
    pub fn of(subject: Subject, times_ms: &[f64], runs: &[Stats]) -> Self {
        let mut last = runs.last().cloned().unwrap_or_default();
        let mut names: Vec<StageName> = Vec::new();
        for (name, _) in &last.stages_ms {
            if !names.contains(name) {
                names.push(*name);
            }
        }
        let stage = |name: StageName| {
            let times: Vec<f64> = runs.iter().map(|s| s.stage_ms(name).unwrap_or(0.0)).collect();
            (name, Milliseconds::of(&times).median)
        };
        last.stages_ms = names.into_iter().map(stage).collect();
        let rows = last.stages();
        let left_out = rows.iter().filter(|r| !r.ran);
        let left_out = left_out.map(|r| LeftOutRow { what: r.name.clone(), why: r.why.clone() }).collect();
        Self {
            format: FORMAT,
            versions: BTreeMap::from([("presight", env!("CARGO_PKG_VERSION"))]),
            scene: subject.scene,
            sensor: subject.sensor,
            width: subject.size.0,
            height: subject.size.1,
            outputs: subject.outputs,
            engine: last.engine,
            adapter: last.adapter,
            way: last.way,
            raster: last.raster,
            threads: last.threads,
            index: last.index,
            repeat: times_ms.len(),
            prediction_ms: Milliseconds::of(times_ms),
            stages_ms: OrderedMap(last.stages_ms),
            counts: OrderedMap(last.counts),
            work: last.work,
            taken: last.taken,
            left_out,
            notices: last.notices.clone(),
            deadline: last.deadline,
            rows,
        }
    }

    /// Writes the statistics as JSON.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let json = serde_json::to_string_pretty(self)
            .map_err(|e| Error::invalid(format!("cannot write the statistics as JSON: {e}"), "").in_file(path))?;
        write_atomically(path, |file| writeln!(file, "{json}"))
    }

    /// The median time of a prediction.
    pub fn median_ms(&self) -> f64 {
        self.prediction_ms.median
    }

    /// `cpu with 2 threads`, `gpu on <adapter>`.
    pub fn engine_in_words(&self) -> String {
        match &self.adapter {
            Some(adapter) => format!("{} on {adapter}", self.engine),
            None if self.threads == 1 => format!("{} with 1 thread", self.engine),
            None => format!("{} with {} threads", self.engine, self.threads),
        }
    }

    /// The text of `--explain`: stages with their times, counts, and skipped stages with the reason.
    pub fn explanation(&self) -> Vec<String> {
        let mut lines = vec![
            format!("scene     {}", self.scene),
            format!("sensor    {}, {} x {}", self.sensor, self.width, self.height),
            format!("outputs   {}", self.outputs.join(", ")),
            format!("engine    {}", self.engine_in_words()),
            format!("index     {}", self.index),
        ];
        lines.extend(self.way.map(|way| format!("way       {way}")));
        lines.extend(self.raster.map(|raster| format!("raster    {raster}")));
        let ms = &self.prediction_ms;
        lines.push(match self.repeat {
            1 => format!("time      {:.2} ms", ms.median),
            n => format!("time      {:.2} ms median, {:.2} p95, {:.2} min of {n}", ms.median, ms.p95, ms.min),
        });
        if let Some(kept) = &self.deadline {
            let DeadlineOutcome { deadline_ms, time_ms, estimate_ms, .. } = kept;
            lines.push(format!("deadline  {time_ms:.2} of {deadline_ms} ms, estimate {estimate_ms:.2} ms"));
            let given_up = kept.given_up.as_ref();
            let told = given_up.map(|given_up| given_up.explanation(u64::from(self.width) * u64::from(self.height)));
            lines.extend(told.iter().flatten().map(|line| format!("given up  {line}")));
            lines.extend(given_up.is_none().then(|| "given up  nothing".to_owned()));
        }
        let counts = || {
            let of_work = self.work.counts().into_iter().filter(|(_, n)| *n > 0);
            self.counts.0.iter().map(|(name, n)| (name.name(), *n)).chain(of_work)
        };
        let names = self.rows.iter().filter(|r| r.ran).map(|r| r.name.as_str()).chain(counts().map(|(name, _)| name));
        let width = names.map(str::len).max().unwrap_or(0);
        lines.push("stages".into());
        lines.extend(self.rows.iter().filter(|r| r.ran).map(|r| match r.ms {
            Some(ms) => format!("  {:width$}  {ms:>10.3} ms", r.name),
            None => format!("  {:width$}  {}", r.name, r.why),
        }));
        lines.push("counts".into());
        lines.extend(counts().map(|(name, n)| format!("  {name:width$}  {n:>10}")));
        lines.push("left out".into());
        lines.extend(self.rows.iter().filter(|r| !r.ran).map(|r| format!("  {}: {}", r.name, r.why)));
        if !self.notices.is_empty() {
            lines.push("notices".into());
            lines.extend(self.notices.iter().map(|n| format!("  {n}")));
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_by_nearest_rank() {
        let times: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(Milliseconds::of(&times), Milliseconds { median: 50.5, p95: 95.0, min: 1.0 });
        assert_eq!(Milliseconds::of(&[3.0]), Milliseconds { median: 3.0, p95: 3.0, min: 3.0 });
        assert_eq!(Milliseconds::of(&[2.0, 1.0]), Milliseconds { median: 1.5, p95: 2.0, min: 1.0 });
        assert_eq!(Milliseconds::of(&[]).median, 0.0);
    }
}
