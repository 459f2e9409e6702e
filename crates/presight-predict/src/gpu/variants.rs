//! The pipelines that a frame needs: the variant of each stage, its shader text and its constants.

use super::device::Gpu;
use super::grid::Tables;
use super::layout::GridKind;
use super::shaders;
use super::stage::{Stage, Variant};
use super::testing::{self, Hiding};
use super::uploads::FrameUploads;
use presight_model::error::Result;
use presight_render::plan::Output;

/// A planted fault for tests: depth appears nearer by this share, more than rounding allows near the axis.
const TOO_NEAR: f64 = 1e-4;

/// A constant of a shader.
pub(super) type Constant = (&'static str, f64);

fn flag(name: &'static str, on: bool) -> Constant {
    (name, f64::from(u32::from(on)))
}

/// The variants that a frame needs.
#[derive(Clone, Copy)]
pub(super) struct Variants<'a> {
    gpu: &'a Gpu,
    frame: &'a FrameUploads,
    kind: GridKind,
    /// True if a uniform buffer holds the rays.
    short: bool,
}

impl<'a> Variants<'a> {
    pub fn of(gpu: &'a Gpu, tables: &Tables, frame: &'a FrameUploads) -> Self {
        Self { gpu, frame, kind: tables.kind, short: tables.short() }
    }

    fn variant(&self, bits: u32) -> Variant {
        Variant { kind: self.kind, bits }
    }

    /// The constant that selects the shader's source of rays.
    pub fn rays(&self) -> Constant {
        flag("SHORT", self.short)
    }

    pub fn sift(&self) -> Variant {
        self.variant(u32::from(self.frame.few()) << 1 | u32::from(self.short) << 2)
    }

    pub fn prepare_sift(&self, stage: &mut Stage) -> Result<()> {
        let text = match self.kind {
            GridKind::Camera => shaders::SIFT_CAMERA,
            GridKind::Scanner => shaders::SIFT_SCANNER,
            GridKind::Rays => shaders::SIFT_RAYS,
        };
        let constants = [self.kind.constant(), self.rays(), flag("FEW", self.frame.few())];
        stage.prepare(self.gpu, self.sift(), text, &constants)
    }

    pub fn cull(&self) -> Variant {
        self.variant(u32::from(self.frame.plain) | self.sift().bits)
    }

    pub fn prepare_cull(&self, stage: &mut Stage) -> Result<()> {
        let text = match self.kind {
            GridKind::Camera => shaders::CULL_CAMERA,
            GridKind::Scanner => shaders::CULL_SCANNER,
            GridKind::Rays => shaders::CULL_RAYS,
        };
        let (few, plain) = (flag("FEW", self.frame.few()), flag("PLAIN", self.frame.plain));
        stage.prepare(self.gpu, self.cull(), text, &[self.kind.constant(), self.rays(), few, plain])
    }

    pub fn setup(&self) -> Variant {
        self.variant(u32::from(self.frame.few()) | u32::from(self.frame.rendered) << 1)
    }

    pub fn prepare_setup(&self, stage: &mut Stage, test: testing::Setup) -> Result<()> {
        let (few, rendered) = (flag("FEW", self.frame.few()), flag("RENDER", self.frame.rendered));
        let all = [self.kind.constant(), few, rendered, flag("GROWTH", !test.shapes_not_grown)];
        let (text, constants) = match self.kind {
            GridKind::Rays => (shaders::SETUP_RAYS, &all[..3]),
            GridKind::Camera | GridKind::Scanner => (shaders::SETUP_LINES, &all[..]),
        };
        stage.prepare(self.gpu, self.setup(), text, constants)
    }

    pub fn raster(&self) -> Variant {
        self.variant(u32::from(self.short) << 1)
    }

    /// The second raster pass, for devices without 64-bit atomics.
    pub fn second(&self) -> Option<Variant> {
        (!self.gpu.int64).then(|| self.variant(self.raster().bits | 1))
    }

    pub fn prepare_raster(&self, stage: &mut Stage) -> Result<()> {
        let text = match (self.kind, self.gpu.int64) {
            (GridKind::Rays, true) => shaders::RASTER_RAYS_64,
            (GridKind::Rays, false) => shaders::RASTER_RAYS_32,
            (_, true) => shaders::RASTER_LINES_64,
            (_, false) => shaders::RASTER_LINES_32,
        };
        for (second, variant) in [Some(self.raster()), self.second()].into_iter().flatten().enumerate() {
            // wgpu rejects unknown constants: units of 64 bits do not declare SECOND, nor those for rays SHORT.
            let all = [("SECOND", second as f64), self.kind.constant(), self.rays()];
            let (first, end) = (usize::from(self.gpu.int64), if self.kind == GridKind::Rays { 2 } else { 3 });
            stage.prepare(self.gpu, variant, text, &all[first..end])?;
        }
        Ok(())
    }

    pub fn farthest(&self) -> Variant {
        self.variant(u32::from(self.short))
    }

    pub fn prepare_farthest(&self, stage: &mut Stage, test: testing::Setup) -> Result<()> {
        let too_near = ("TOO_NEAR", if test.hiding == Hiding::TooNear { TOO_NEAR } else { 0.0 });
        let constants = [self.kind.constant(), self.rays(), too_near];
        stage.prepare(self.gpu, self.farthest(), shaders::FARTHEST, &constants)
    }

    pub fn resolve(&self) -> Variant {
        let bits = self.frame.outputs.iter().fold(0, |bits, o| bits | 1 << o as u32);
        self.variant(bits | u32::from(self.frame.shown_words() > 0) << 31)
    }

    pub fn prepare_resolve(&self, stage: &mut Stage) -> Result<()> {
        let output = |name, output| flag(name, self.frame.outputs.has(output));
        let constants = [
            self.kind.constant(),
            output("RANGE", Output::Range),
            output("DEPTH", Output::DepthZ),
            output("POLYGON", Output::PolygonId),
            output("OBJECT", Output::ObjectId),
            output("COSINE", Output::CosIncidence),
            flag("SHOWN", self.frame.shown_words() > 0),
        ];
        stage.prepare(self.gpu, self.resolve(), shaders::RESOLVE, &constants)
    }
}
