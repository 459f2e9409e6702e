//! Priorities for predictions that cannot finish everything in time.

use presight_model::error::{Error, Result};

/// Priorities for predictions that cannot finish everything in time.
///
/// ```
/// use presight::predict::Priority;
/// // A robot that turns left looks there first; it steers by door 7.
/// let priority = Priority::default().with_heading(0.5).with_features(vec![7]);
/// assert_eq!(priority.min_radius, 2.0);
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Priority {
    /// Minimum radius, metres, above 0.
    pub min_radius: f64,
    /// Direction around which the angle shrinks: radians from the sensor's forward axis, counter-clockwise.
    pub heading: f64,
    /// Numbers of features to predict first, in this order. The others follow, longest image first.
    pub features: Vec<u32>,
}

impl Default for Priority {
    fn default() -> Self {
        Self { min_radius: 2.0, heading: 0.0, features: Vec::new() }
    }
}

impl Priority {
    /// Sets the least radius, metres.
    #[must_use]
    pub fn with_min_radius(self, metres: f64) -> Self {
        Self { min_radius: metres, ..self }
    }

    /// Sets the heading, radians from the sensor's forward axis, counter-clockwise.
    #[must_use]
    pub fn with_heading(self, radians: f64) -> Self {
        Self { heading: radians, ..self }
    }

    /// Sets the features to predict first, by number.
    #[must_use]
    pub fn with_features(self, ids: Vec<u32>) -> Self {
        Self { features: ids, ..self }
    }

    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a radius that is not above 0 and finite, and for a heading that is not
    /// finite.
    pub fn check(&self) -> Result<()> {
        if !(self.min_radius > 0.0 && self.min_radius.is_finite()) {
            let what = format!("the minimum radius is {} m", self.min_radius);
            return Err(Error::usage(what, "give metres above 0, such as 2"));
        }
        if !self.heading.is_finite() {
            return Err(Error::usage(format!("the heading is {} rad", self.heading), "give an angle, such as 0"));
        }
        Ok(())
    }
}
