//! Materials as a sensor class sees them.

use presight_model::environment::{Appearance, Environment, Material};

/// Visibility of a material for the sensor's class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Facing {
    /// Opaque to the sensor's class.
    pub opaque: bool,
    /// Visible only from the side of its normal.
    pub one_sided: bool,
}

/// Visibility of an environment's materials for a sensor class, by material index.
pub fn facings<'a>(environment: &'a Environment, class: &'a str) -> impl Iterator<Item = Facing> + 'a {
    let opaque = move |m: &Material| m.appearance(class) == Appearance::Opaque;
    environment.materials().iter().map(move |m| Facing { opaque: opaque(m), one_sided: m.one_sided })
}
