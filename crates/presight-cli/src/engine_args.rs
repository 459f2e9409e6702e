//! Which engine predicts, as the command line says it.

use clap::ValueEnum;
use presight::{Backend, Options, Raster, Threads};

/// The flags by which commands choose their engine.
#[derive(Clone, Debug, clap::Args)]
pub struct EngineArgs {
    /// Which engine predicts
    #[arg(long, value_enum, default_value_t = BackendArg::Auto)]
    backend: BackendArg,

    /// What rasterizes on a GPU; the images keep the same bounds with either [default: compute]
    #[arg(long, value_enum)]
    raster: Option<RasterArg>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum BackendArg {
    /// A hardware GPU if there is one, otherwise the CPU engine
    Auto,
    /// The CPU engine
    Cpu,
    /// wgpu on any adapter, a software one too
    Gpu,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RasterArg {
    /// Spans in compute shaders
    Compute,
    /// The hardware rasterizer for pinhole cameras, spans for everything else
    Render,
}

impl EngineArgs {
    /// Options with them.
    pub fn options(&self, threads: Threads) -> Options {
        let backend = match self.backend {
            BackendArg::Auto => Backend::Auto,
            BackendArg::Cpu => Backend::Cpu,
            BackendArg::Gpu => Backend::Gpu,
        };
        Options::new(backend).with_threads(threads).with_raster(self.raster().unwrap_or_default())
    }

    /// The asked rasterizer, if one was asked for.
    pub fn raster(&self) -> Option<Raster> {
        self.raster.map(|raster| match raster {
            RasterArg::Compute => Raster::Compute,
            RasterArg::Render => Raster::Render,
        })
    }
}
