//! Uncertain features and objects.

use glam::DVec3;
use presight_model::environment::{Existence, MarkKind};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::world::World;

presight_model::options! {
    /// The threshold of uncertainty.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct UncertainOptions {
        /// Probability of existence below which a feature is uncertain.
        min_existence: f64 = 0.5, with_min_existence;
        /// Time at which existence is evaluated, UTC seconds; `None` for the newest confirmation of each layer.
        time: Option<f64> = None, with_time;
        /// Features that were not confirmed since then are uncertain, UTC seconds; `None` to use their existence alone.
        since: Option<f64> = None, with_since;
    }
}

/// The reason why a feature or an object is uncertain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UncertaintyReason {
    /// A mark states it.
    Marked(MarkKind),
    /// Its probability of existence is low.
    LowExistence,
    /// Its last confirmation is old.
    NotConfirmed,
}

impl UncertaintyReason {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Marked(kind) => kind.name(),
            Self::LowExistence => "low_existence",
            Self::NotConfirmed => "not_confirmed",
        }
    }
}

/// A feature that is uncertain.
#[derive(Clone, Debug, PartialEq)]
pub struct UncertainFeature {
    /// Sensor class of its layer.
    pub class: String,
    /// Its number.
    pub id: u32,
    /// Its name.
    pub name: Option<String>,
    /// Path of its object; `None` if it belongs to the world.
    pub object: Option<String>,
    /// Its first point, world, metres.
    pub at: DVec3,
    /// Probability of existence at the time.
    pub existence: f64,
    /// Last confirmation, UTC seconds.
    pub confirmed: f64,
    /// Why it is uncertain.
    pub doubt: UncertaintyReason,
}

/// An object that is uncertain.
#[derive(Clone, Debug, PartialEq)]
pub struct UncertainObject {
    /// Its path.
    pub object: String,
    /// Name of the mark that states it; `None` if the trust in the object is low.
    pub mark: Option<String>,
    /// Sensor class that the mark concerns; `None` for all.
    pub class: Option<String>,
    /// Probability of existence at the time, if one is stored.
    pub existence: Option<f64>,
    /// Last confirmation, UTC seconds, if one is stored.
    pub confirmed: Option<f64>,
    /// Why it is uncertain.
    pub doubt: UncertaintyReason,
}

impl UncertainOptions {
    fn check(&self) -> Result<()> {
        if [self.time, self.since].into_iter().flatten().any(|time| !time.is_finite()) {
            return Err(Error::usage("a time that is not finite", "give UTC seconds"));
        }
        if !(0.0..=1.0).contains(&self.min_existence) {
            return Err(Error::usage(format!("an existence of {}", self.min_existence), "give 0 to 1"));
        }
        Ok(())
    }

    /// The reason for a feature or object with this existence; `None` if it is certain. `newest` is used without a time
    /// in the options.
    fn doubt(&self, existence: &Existence, newest: f64) -> Option<UncertaintyReason> {
        if existence.at(self.time.unwrap_or(newest)) < self.min_existence {
            return Some(UncertaintyReason::LowExistence);
        }
        self.since.filter(|since| existence.confirmed < *since).map(|_| UncertaintyReason::NotConfirmed)
    }
}

/// Objects with a mark by the name of the mark, then objects with a low trust by path.
///
/// # Errors
/// As [`uncertain_features`].
pub fn uncertain_objects(world: &World, options: &UncertainOptions) -> Result<Vec<UncertainObject>> {
    options.check()?;
    let environment = world.environment();
    let newest = environment.trusts().map(|(_, trust)| trust.confirmed).reduce(f64::max).unwrap_or(0.0);
    let time = options.time.unwrap_or(newest);
    let marked = environment.marks().map(|(name, mark)| {
        let trust = environment.trust(&mark.object);
        UncertainObject {
            object: mark.object.clone(),
            mark: Some(name.to_owned()),
            class: mark.class.clone(),
            existence: trust.map(|t| t.at(time)),
            confirmed: trust.map(|t| t.confirmed),
            doubt: UncertaintyReason::Marked(mark.kind),
        }
    });
    let doubted = environment.trusts().filter_map(|(object, trust)| {
        Some(UncertainObject {
            object: object.to_owned(),
            mark: None,
            class: None,
            existence: Some(trust.at(time)),
            confirmed: Some(trust.confirmed),
            doubt: options.doubt(trust, newest)?,
        })
    });
    Ok(marked.chain(doubted).collect())
}

/// Uncertain features of all layers by rising probability of existence.
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for times that are not finite, and a probability outside 0 to 1.
pub fn uncertain_features(world: &World, options: &UncertainOptions) -> Result<Vec<UncertainFeature>> {
    options.check()?;
    let environment = world.environment();
    let mut found = Vec::new();
    for layer in environment.layers() {
        let newest = layer.newest_confirmation();
        for feature in &layer.features {
            let Some(doubt) = options.doubt(&feature.existence, newest) else { continue };
            let existence = feature.existence.at(options.time.unwrap_or(newest));
            let confirmed = feature.existence.confirmed;
            let object = feature.object.as_deref().and_then(|path| environment.object(path));
            let pose = object.map_or(Pose::IDENTITY, |o| o.world_from_object);
            found.push(UncertainFeature {
                class: layer.class.clone(),
                id: feature.id,
                name: feature.name.clone(),
                object: feature.object.clone(),
                at: pose.transform_point(feature.shape.points()[0]),
                existence,
                confirmed,
                doubt,
            });
        }
    }
    found.sort_by(|a, b| a.existence.total_cmp(&b.existence));
    Ok(found)
}
