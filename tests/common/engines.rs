//! The engines under test, each as a function from a plan to images.

#[cfg(feature = "gpu")]
use super::skip::no_adapter;
use presight::{FramePlan, Images, Stats, cpu};

/// Images that held something else before: an engine must write every pixel.
fn used(plan: &FramePlan) -> Images {
    let mut images = Images::default();
    images.prepare(plan.sensor.width(), plan.sensor.height(), plan.request.outputs);
    images.range.fill(-7.0);
    images.depth_z.fill(-7.0);
    images.cos_incidence.fill(-7.0);
    images.echo.fill(-7.0);
    images.polygon_id.fill(0x7777_7777);
    images.object_id.fill(0x7777_7777);
    images
}

/// The CPU engine on so many threads.
pub fn cpu(threads: usize) -> impl FnMut(&FramePlan) -> Images {
    let mut engine = cpu::Engine::new(threads).expect("threads");
    move |plan| {
        let mut images = used(plan);
        engine.render(plan, &mut images, &mut Stats::default()).expect("the engine renders");
        images
    }
}

/// The GPU engine on whatever adapter there is; `None` where there is none and none is required (also by
/// `PRESIGHT_REQUIRE_GPU`).
#[cfg(feature = "gpu")]
#[expect(clippy::print_stderr, reason = "it says which adapter is tested")]
pub fn gpu() -> Option<impl FnMut(&FramePlan) -> Images> {
    let mut engine = match presight::gpu::Engine::new(presight::gpu::DeviceOptions::default()) {
        Ok(engine) => engine,
        Err(e) => {
            assert!(std::env::var_os("PRESIGHT_REQUIRE_GPU").is_none(), "an adapter is required here: {e}");
            no_adapter(e);
            return None;
        }
    };
    eprintln!("GPU engine on {}", engine.adapter());
    Some(move |plan: &FramePlan| {
        let (mut images, mut stats) = (used(plan), Stats::default());
        engine.render(plan, &mut images, &mut stats).expect("the engine renders");
        let lost = stats.counts.iter().find(|(name, _)| name.contains("internal")).map_or(0, |(_, n)| *n);
        assert_eq!(lost, 0, "hits without id");
        images
    })
}
