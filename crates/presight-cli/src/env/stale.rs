//! Objects and features without a recent confirmation: `presight env info --stale`.

use presight::environment::Environment;
use presight::{Error, Result};

/// An age, and the time that it is counted back from.
pub struct Stale {
    seconds: f64,
    /// `None`: the newest confirmation in the store.
    from: Option<f64>,
}

impl Stale {
    /// Parses an age such as `30d`.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] for another text, or a time that is not finite.
    pub fn new(age: &str, from: Option<f64>) -> Result<Self> {
        let units = [('d', 86_400.0), ('h', 3_600.0), ('m', 60.0), ('s', 1.0)];
        let parsed = units.iter().find_map(|(unit, seconds)| {
            let number = age.strip_suffix(*unit)?.parse::<f64>().ok()?;
            Some(number * seconds).filter(|s| s.is_finite() && *s >= 0.0)
        });
        let wrong = || Error::usage(format!("--stale {age}"), "give a number and d, h, m or s, such as 30d");
        if let Some(time) = from.filter(|time| !time.is_finite()) {
            return Err(Error::usage(format!("--time {time}"), "give finite UTC seconds"));
        }
        Ok(Self { seconds: parsed.ok_or_else(wrong)?, from })
    }

    /// Objects and features that were not confirmed since, with their last confirmation, UTC seconds; objects that
    /// were never confirmed have none.
    pub fn of(&self, environment: &Environment) -> Vec<(String, Option<f64>)> {
        let features = || {
            environment.layers().iter().flat_map(|layer| {
                let name = move |id: u32| format!("feature {id} for class {}", layer.class);
                layer.features.iter().map(move |f| (name(f.id), Some(f.existence.confirmed)))
            })
        };
        let live = environment.objects().iter().filter(|o| !o.is_deleted());
        let objects = live.map(|o| (o.name.clone(), environment.trust(&o.name).map(|t| t.confirmed)));
        let all: Vec<(String, Option<f64>)> = objects.chain(features()).collect();
        let newest = all.iter().filter_map(|(_, time)| *time).reduce(f64::max);
        let Some(from) = self.from.or(newest) else { return all };
        all.into_iter().filter(|(_, time)| time.is_none_or(|t| t < from - self.seconds)).collect()
    }
}
