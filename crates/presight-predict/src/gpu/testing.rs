//! Test setups for real devices, also used by `doctor`: reduced limits, planted faults, and device loss.

use super::{DeviceAllocations, DeviceOptions, GpuEngine};
use presight_model::error::Result;
use std::any::Any;

/// When the engine tests whether polygons are hidden.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Hiding {
    /// If there are enough polygons.
    #[default]
    WhereItPays,
    /// Never: all runs in one wave.
    Off,
    /// In every frame of more than one run.
    Always,
    /// As `Always`, with a fault: coarse depth is nearer than the truth by the allowed rounding.
    TooNear,
    /// As `Always`, with a fault: if the last frame is reused, only the polygons that it showed are drawn.
    LastFrameOnly,
}

/// The configuration of a device in a test.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Setup {
    /// Limit the size of a buffer to this many bytes, even if the adapter allows more.
    pub largest_binding: Option<u64>,
    /// Run every stage on the device. On a software adapter some stages otherwise run on the CPU, which is faster.
    pub all_on_device: bool,
    /// When the engine tests whether polygons are hidden.
    pub hiding: Hiding,
    /// Plants a fault: shapes for the hardware rasterizer are not enlarged.
    pub shapes_not_grown: bool,
}

impl Setup {
    /// Runs every stage on the device.
    pub const ALL_ON_DEVICE: Self =
        Self { largest_binding: None, all_on_device: true, hiding: Hiding::WhereItPays, shapes_not_grown: false };
}

/// [`GpuEngine::new`] with a setup for tests.
///
/// # Errors
/// Same as [`GpuEngine::new`].
pub fn open(options: DeviceOptions, setup: Setup) -> Result<GpuEngine> {
    GpuEngine::open(options, setup)
}

/// Returns a function that destroys the present device, as a driver reset would. It works from any thread, also in the
/// middle of a prediction.
pub fn device_loss(engine: &GpuEngine) -> impl Fn() + Send + use<> {
    let device = engine.gpu.device.clone();
    move || device.destroy()
}

/// Allocations that a GPU engine has made on its device; `None` for another engine.
pub fn allocations(engine: &dyn Any) -> Option<DeviceAllocations> {
    engine.downcast_ref::<GpuEngine>().map(GpuEngine::allocations)
}
