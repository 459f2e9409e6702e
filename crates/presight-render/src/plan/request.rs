//! Requests: the images that a prediction makes.

use super::output::Outputs;
use presight_model::environment::Object;

/// The meaning of `polygon_id`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum IdScheme {
    /// Slot + 1.
    #[default]
    Model,
    /// Number of the source triangle + 1; for environments imported without merging.
    Source,
}

impl IdScheme {
    /// The `polygon_id` of a polygon of an object.
    pub fn id_of(self, object: &Object, polygon: u32) -> u32 {
        match self {
            Self::Model => object.first_slot + polygon + 1,
            Self::Source => object.first_source + object.mesh.source(polygon) + 1,
        }
    }
}

/// The images that a plan includes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageRequest {
    /// The requested images; others cost nothing.
    pub outputs: Outputs,
    /// The meaning of `polygon_id`.
    pub ids: IdScheme,
}

impl From<Outputs> for ImageRequest {
    fn from(outputs: Outputs) -> Self {
        Self { outputs, ..Self::default() }
    }
}

impl From<&Self> for ImageRequest {
    fn from(request: &Self) -> Self {
        *request
    }
}
