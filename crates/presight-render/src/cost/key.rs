//! The key that selects a set of unit costs.

use crate::plan::Outputs;
use presight_model::sensor::{Geometry, Sensor};
use std::fmt;

presight_model::words! {
    /// The point of a frame at which its time is estimated. Before the end, counts are only bounds or means.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum Forecast {
        /// Before the frame: the selection alone.
        Access = "access",
        /// After selection: the drawing.
        Selection = "selection",
        /// After a wave's setup, from bounds of its counts.
        Wave = "wave",
        /// The steps after drawing.
        Images = "images",
        /// Features and their regions of interest.
        Features = "features",
        /// A finished frame, from its actual work.
        Finished = "finished",
        /// Before a frame by tiles, which select nothing: all of it.
        Tiles = "tiles",
        /// Before a row in the plane: all of it.
        Row = "row",
    }
}

/// Everything that unit costs depend on: costs learnt for one key do not apply to another.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Key {
    /// `cpu`, `gpu` or `reference`.
    pub engine: String,
    /// Adapter and driver of the GPU engine.
    pub adapter: Option<String>,
    /// CPU threads.
    pub threads: usize,
    /// Image geometry: kind and size, and whether rays come from a table.
    pub geometry: String,
    /// Names of the requested outputs.
    pub outputs: String,
    /// The point at which the estimate is made.
    pub forecast: Forecast,
}

impl Key {
    /// The key of a prediction.
    pub fn new(
        engine: &str,
        adapter: Option<&str>,
        threads: usize,
        sensor: &Sensor,
        outputs: Outputs,
        forecast: Forecast,
    ) -> Self {
        let kind = match &sensor.spec().geometry {
            Geometry::Camera(camera) if camera.distortion == presight_model::sensor::Distortion::None => "camera",
            Geometry::Camera(_) => "camera with a lens",
            Geometry::Scanner(_) => "scanner",
            Geometry::Rays(_) => "rays",
        };
        Self {
            engine: engine.to_owned(),
            adapter: adapter.map(str::to_owned),
            threads,
            geometry: format!("{kind} {} x {}", sensor.width(), sensor.height()),
            outputs: outputs.iter().map(crate::plan::Output::name).collect::<Vec<_>>().join(","),
            forecast,
        }
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { engine, adapter, threads, geometry, outputs, forecast } = self;
        let adapter = adapter.as_deref().unwrap_or("no adapter");
        write!(f, "{engine}, {adapter}, {threads} threads, {geometry}, {outputs}, {}", forecast.name())
    }
}
