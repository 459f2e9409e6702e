//! All paths from a scene to an image.

use super::views::ImageVariant;
use crate::index::Scheme;
use presight_model::threads::Threads;
use presight_predict::engine::EngineKind;
use presight_render::verify::Precision;

/// The engine of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EnginePath {
    /// The reference, on all cores.
    Reference,
    /// The CPU engine on one thread.
    CpuOne,
    /// The CPU engine on all cores.
    CpuAll,
    /// The GPU engine with its defaults: 64-bit keys if the device supports them.
    Gpu,
    /// The GPU engine with 32-bit keys, in two passes.
    GpuNarrow,
}

impl EnginePath {
    /// The engine and its threads.
    pub fn engine(self) -> (EngineKind, Threads) {
        match self {
            Self::Reference => (EngineKind::Reference, 0.into()),
            Self::CpuOne => (EngineKind::Cpu, 1.into()),
            Self::CpuAll => (EngineKind::Cpu, 0.into()),
            Self::Gpu => (EngineKind::Gpu, 0.into()),
            Self::GpuNarrow => (EngineKind::GpuNarrow, 0.into()),
        }
    }
}

/// The names of a path in tables, charts and advice.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PathName {
    /// `reference`, `cpu` or `gpu`.
    pub engine: &'static str,
    /// The name among the paths of the engine.
    pub variant: String,
    /// Flags or settings that select the path.
    pub how: String,
    /// True for the path that a user gets by default.
    pub default: bool,
    /// The series in charts.
    pub family: String,
    /// The label in charts.
    pub label: String,
}

/// One path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Path {
    pub which: EnginePath,
    pub view: ImageVariant,
    /// An index other than the default.
    pub index: Option<Scheme>,
}

impl Path {
    /// All paths, with those of the GPU if `gpu` is set.
    pub fn all(gpu: bool) -> Vec<Self> {
        let path = |which, view| Self { which, view, index: None };
        let views = [
            ImageVariant::Whole,
            ImageVariant::Rays,
            ImageVariant::Reduced(2),
            ImageVariant::Reduced(4),
            ImageVariant::Region,
        ];
        let mut all = vec![path(EnginePath::Reference, ImageVariant::Whole)];
        all.extend([ImageVariant::Whole, ImageVariant::Rays].map(|view| path(EnginePath::CpuOne, view)));
        all.extend(views.map(|view| path(EnginePath::CpuAll, view)));
        let others = Scheme::ALL.into_iter().filter(|s| *s != Scheme::default());
        all.extend(others.map(|s| Self { index: Some(s), ..path(EnginePath::CpuAll, ImageVariant::Whole) }));
        if gpu {
            all.extend(views.map(|view| path(EnginePath::Gpu, view)));
            all.push(path(EnginePath::GpuNarrow, ImageVariant::Whole));
        }
        all
    }

    /// The name of the engine in files.
    pub fn engine(&self) -> &'static str {
        match self.which {
            EnginePath::Reference => "reference",
            EnginePath::CpuOne | EnginePath::CpuAll => "cpu",
            EnginePath::Gpu | EnginePath::GpuNarrow => "gpu",
        }
    }

    /// The precision whose bounds apply to the engine.
    pub fn precision(&self) -> Precision {
        if self.engine() == "gpu" { Precision::F32 } else { Precision::F64 }
    }
}
