//! Materials: how a surface appears to each class of sensor.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Appearance of a material to a sensor class.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Appearance {
    /// Visible, and hides everything behind it.
    #[default]
    Opaque,
    /// No range and no occlusion, but its features remain visible.
    Transparent,
    /// Absent: no range, no occlusion, no features.
    Invisible,
}

/// A surface material (paper section 2.1).
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name in the source file.
    pub name: String,
    /// Reflection factor, 0..=1.
    pub reflection: f64,
    /// Visible only from the side of its normal; a mirrored object keeps its fronts. Off by default.
    pub one_sided: bool,
    /// Linear RGB for pictures.
    pub color: [f32; 3],
    /// Appearance by sensor class. It is opaque to classes that are not listed.
    pub appearance: BTreeMap<String, Appearance>,
}

impl Material {
    /// A material that is opaque to every class, two-sided, with reflection factor 1.
    pub fn named(name: impl Into<String>) -> Self {
        Self { name: name.into(), reflection: 1.0, one_sided: false, color: [0.8; 3], appearance: BTreeMap::new() }
    }

    /// Its appearance to a sensor class.
    pub fn appearance(&self, class: &str) -> Appearance {
        self.appearance.get(class).copied().unwrap_or_default()
    }

    /// Returns an error unless the reflection factor is from 0 to 1.
    pub fn check(&self) -> Result<()> {
        if (0.0..=1.0).contains(&self.reflection) {
            return Ok(());
        }
        Err(Error::invalid(
            format!("reflection factor {} is outside 0..=1", self.reflection),
            "give the fraction of power that is reflected",
        )
        .at(format!("material {:?}", self.name)))
    }
}
