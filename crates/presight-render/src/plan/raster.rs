//! The rasterizer on a GPU.

use serde::Serialize;

presight_model::words! {
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
        Compute = "compute",
        /// The hardware rasterizer for pinhole cameras. Compute spans draw all other sensors, polygons that it cannot
        /// draw exactly, predictions with a deadline, and everything on adapters without the required features.
        Render = "render",
    }
}
