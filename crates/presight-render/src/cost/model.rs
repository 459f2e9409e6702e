//! The unit costs of all keys.

use super::{Key, UnitCosts, WorkCounts};
use presight_model::error::{Error, Result};
use std::collections::BTreeMap;

/// Maximum number of keys of one model.
pub const MAX_MODELS: usize = 4096;

/// Predicted time of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeEstimate {
    /// Most likely, seconds.
    pub mean: f64,
    /// 99 % of frames take less, seconds.
    pub upper: f64,
    /// 99 % of frames take more, seconds.
    pub lower: f64,
    /// Number of frames it was learnt from; 0 means pessimistic defaults.
    pub frames: u64,
}

/// The costs of frames, by engine, adapter, threads, sensor geometry and outputs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CostModel {
    /// The costs of each kind of frame.
    #[doc(hidden)]
    pub models: BTreeMap<Key, UnitCosts>,
}

impl CostModel {
    /// Estimates the time of a frame with these counts; uses pessimistic defaults for an unknown key.
    #[doc(hidden)]
    pub fn estimate(&self, key: &Key, counts: &WorkCounts) -> TimeEstimate {
        let of = |costs: &UnitCosts| {
            let mean = costs.mean(counts);
            let [low, high] = costs.factors;
            TimeEstimate { mean, upper: mean * high, lower: mean * low, frames: costs.frames }
        };
        self.models.get(key).map_or_else(|| of(&UnitCosts::default()), of)
    }

    /// Learns from a frame with these counts that took `seconds`.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the time is NaN, infinite or not above 0 (for example after a clock
    /// was set back), or if there are more than [`MAX_MODELS`] keys. The model is then unchanged.
    #[doc(hidden)]
    pub fn observe(&mut self, key: &Key, counts: &WorkCounts, seconds: f64) -> Result<()> {
        if !(seconds > 0.0 && seconds <= 1e9) {
            let what = format!("a frame that takes {seconds} s");
            return Err(Error::invalid(what, "measure with a clock that only goes forward"));
        }
        if self.models.len() >= MAX_MODELS && !self.models.contains_key(key) {
            let what = format!("costs of more than {MAX_MODELS} engines, sensors and outputs");
            return Err(Error::invalid(what, "begin a new cost model"));
        }
        self.models.entry(key.clone()).or_default().observe(counts, seconds);
        Ok(())
    }

    /// Learnt seconds by kind of work ([`WorkCounts::NAMES`]); `None` for an unknown key.
    #[doc(hidden)]
    pub fn unit_costs(&self, key: &Key) -> Option<&[f64]> {
        self.models.get(key).map(|costs| costs.seconds.as_slice())
    }

    /// All known keys.
    #[doc(hidden)]
    pub fn keys(&self) -> impl Iterator<Item = &Key> {
        self.models.keys()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::Forecast;

    #[test]
    fn bad_times_are_errors_and_teach_nothing() {
        let key = Key {
            engine: "cpu".into(),
            adapter: None,
            threads: 1,
            geometry: "camera 2 x 2".into(),
            outputs: "range".into(),
            forecast: Forecast::Finished,
        };
        let mut model = CostModel::default();
        for seconds in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(
                model.observe(&key, &WorkCounts::default(), seconds).unwrap_err().kind(),
                presight_model::ErrorKind::Invalid
            );
        }
        assert_eq!(model, CostModel::default());
        // Extreme counts and times keep all numbers finite.
        let most = WorkCounts { polygons: u64::MAX, samples_tested: u64::MAX, ..WorkCounts::default() };
        for seconds in [1e-12, 1e9] {
            model.observe(&key, &most, seconds).unwrap();
            model.observe(&key, &WorkCounts::default(), seconds).unwrap();
        }
        let estimate = model.estimate(&key, &most);
        assert!(estimate.mean.is_finite() && estimate.upper.is_finite(), "{estimate:?}");
        assert!(model.unit_costs(&key).unwrap().iter().all(|c| *c >= 0.0 && c.is_finite()));
    }
}
