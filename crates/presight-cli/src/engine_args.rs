//! Engine selection on the command line.

use clap::ValueEnum;
use presight::{Backend, Options, Raster, Threads, Way};

/// Flags that choose the engine.
#[derive(Clone, Debug, clap::Args)]
pub struct EngineArgs {
    /// The engine that predicts
    #[arg(long, value_enum, default_value_t = BackendArg::Auto)]
    backend: BackendArg,

    /// The rasterizer on a GPU; the same error bounds hold for both [default: compute]
    #[arg(long, value_enum)]
    raster: Option<RasterArg>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum BackendArg {
    /// A hardware GPU if there is one, otherwise the CPU engine
    Auto,
    /// The CPU engine
    Cpu,
    /// wgpu on any adapter, including software adapters
    Gpu,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RasterArg {
    /// Spans in compute shaders
    Compute,
    /// The hardware rasterizer for pinhole cameras, spans for everything else
    Render,
}

/// How the CPU engine finds what rays see.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum WayArg {
    /// Whichever is faster, by counts and by what the sensor's last frames took
    Auto,
    /// Whichever is faster by counts alone, the same in every run
    Counts,
    /// Polygons in view are selected and drawn
    Raster,
    /// Tiles of rays search a tree for each mesh
    Tiles,
}

impl WayArg {
    /// The way of predictor options.
    pub fn way(self) -> Way {
        match self {
            Self::Auto => Way::Auto,
            Self::Counts => Way::Counts,
            Self::Raster => Way::Raster,
            Self::Tiles => Way::Tiles,
        }
    }
}

impl EngineArgs {
    /// Predictor options with these flags set.
    pub fn options(&self, threads: Threads) -> Options {
        Options::new(self.backend().unwrap_or_default())
            .with_threads(threads)
            .with_raster(self.raster().unwrap_or_default())
    }

    /// The engine given with `--backend`; `None` for `auto`.
    pub fn backend(&self) -> Option<Backend> {
        match self.backend {
            BackendArg::Auto => None,
            BackendArg::Cpu => Some(Backend::Cpu),
            BackendArg::Gpu => Some(Backend::Gpu),
        }
    }

    /// The rasterizer given with `--raster`, if any.
    pub fn raster(&self) -> Option<Raster> {
        self.raster.map(|raster| match raster {
            RasterArg::Compute => Raster::Compute,
            RasterArg::Render => Raster::Render,
        })
    }
}
