//! The rasterizer on a GPU.

use serde::Serialize;
use std::fmt;

/// The rasterizer on a GPU. Both choices have the same error bounds.
///
/// ```
/// use presight::Raster;
/// assert_eq!(Raster::default(), Raster::Compute);
/// assert_eq!(Raster::Render.to_string(), "render");
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Raster {
    /// Spans in compute shaders, for every sensor.
    #[default]
    Compute,
    /// The hardware rasterizer for pinhole cameras. Compute spans draw all other sensors, polygons that it cannot draw
    /// exactly, predictions with a deadline, and everything on adapters without the required features.
    Render,
}

impl Raster {
    /// The word in files and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Compute => "compute",
            Self::Render => "render",
        }
    }
}

impl fmt::Display for Raster {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
