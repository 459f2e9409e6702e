//! What rasterizes on a GPU.

use serde::Serialize;
use std::fmt;

/// What rasterizes polygons on a GPU. The images are held to the same bounds with either.
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
    /// The hardware rasterizer for pinhole cameras; compute spans for all other sensors, for polygons that it cannot draw exactly,
    /// for predictions with a deadline, and on adapters that lack what it needs.
    Render,
}

impl Raster {
    /// As files and tables show it.
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
