//! What the model is not sure of.

use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::world::World;

/// Which features count as uncertain.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct UncertainOptions {
    /// Probability of existence below which a feature is uncertain.
    pub least_existence: f64,
    /// Time at which existence is evaluated, UTC seconds; `None` for the newest confirmation of each layer.
    pub time: Option<f64>,
    /// Features that were not confirmed since then are uncertain, UTC seconds; `None` to ask for existence alone.
    pub since: Option<f64>,
}

impl Default for UncertainOptions {
    fn default() -> Self {
        Self { least_existence: 0.5, time: None, since: None }
    }
}

presight_model::with_options!(
    UncertainOptions:
    with_least_existence least_existence: f64,
    with_time time: Option<f64>,
    with_since since: Option<f64>,
);

/// Why a feature is uncertain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// It probably does not exist any more.
    LowExistence,
    /// It was not confirmed for long.
    NotConfirmed,
}

impl Doubt {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
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
    /// Its first point in the world, metres.
    pub at: DVec3,
    /// Probability of existence at the time.
    pub existence: f64,
    /// Last confirmation, UTC seconds.
    pub confirmed: f64,
    /// Why it is uncertain.
    pub doubt: Doubt,
}

/// Features of all layers that are uncertain, the least probable first.
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for times that are not finite, and a probability outside 0 to 1.
pub fn uncertain_features(world: &World, options: &UncertainOptions) -> Result<Vec<UncertainFeature>> {
    if [options.time, options.since].into_iter().flatten().any(|time| !time.is_finite()) {
        return Err(Error::usage("a time that is not finite", "give UTC seconds"));
    }
    if !(0.0..=1.0).contains(&options.least_existence) {
        return Err(Error::usage(format!("an existence of {}", options.least_existence), "give 0 to 1"));
    }
    let environment = world.environment();
    let mut found = Vec::new();
    for layer in environment.layers() {
        let time = options.time.unwrap_or_else(|| layer.newest_confirmation());
        for feature in &layer.features {
            let existence = feature.existence.at(time);
            let confirmed = feature.existence.confirmed;
            let doubt = if existence < options.least_existence {
                Doubt::LowExistence
            } else if options.since.is_some_and(|since| confirmed < since) {
                Doubt::NotConfirmed
            } else {
                continue;
            };
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
