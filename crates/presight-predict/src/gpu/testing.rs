//! What tests of the real device need, and `doctor`: a device that has less, does more, or goes away.

use super::{DeviceAllocations, DeviceOptions, GpuEngine};
use presight_model::error::Result;
use std::any::Any;

/// When polygons that others hide are looked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Hiding {
    /// Where there are enough polygons.
    #[default]
    WhereItPays,
    /// Never: all runs in one wave.
    Off,
    /// In every frame of more than one run.
    Always,
    /// As always, with a fault: what was drawn is taken to be nearer than it is by what rounding is allowed.
    TooNear,
    /// As always, with a fault: where the last frame is reused, nothing is drawn that it did not show.
    LastFrameOnly,
}

/// How a device is used in a test.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Setup {
    /// Take no more bytes than this in one buffer, even where the adapter could.
    pub largest_binding: Option<u64>,
    /// Run every stage on the device, even on a software adapter, where some are faster on the CPU directly.
    pub all_on_device: bool,
    /// When polygons that others hide are looked for.
    pub hiding: Hiding,
    /// A fault: shapes for the hardware rasterizer are not grown.
    pub shapes_not_grown: bool,
}

impl Setup {
    /// Every stage on the device.
    pub const ALL_ON_DEVICE: Self =
        Self { largest_binding: None, all_on_device: true, hiding: Hiding::WhereItPays, shapes_not_grown: false };
}

/// [`GpuEngine::new`] with a setup for tests.
///
/// # Errors
/// As [`GpuEngine::new`].
pub fn open(options: DeviceOptions, setup: Setup) -> Result<GpuEngine> {
    GpuEngine::open(options, setup)
}

/// Returns a function that destroys the present device, as a driver's reset would, from any thread and in the midst of a
/// prediction, too.
pub fn device_loss(engine: &GpuEngine) -> impl Fn() + Send + use<> {
    let device = engine.gpu.device.clone();
    move || device.destroy()
}

/// What a GPU engine has made on its device so far; `None` of another engine.
pub fn allocations(engine: &dyn Any) -> Option<DeviceAllocations> {
    engine.downcast_ref::<GpuEngine>().map(GpuEngine::allocations)
}
