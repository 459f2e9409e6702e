//! Shared test support of presight: scenes, engines, an oracle, data, and the rule for skipped tests.
//!
//! Unit tests inside the library's `src` cannot use functions with types of the library: for them, these types belong
//! to another copy of the library.

pub mod buildings;
pub mod caster;
pub mod changes;
pub mod data;
pub mod engines;
#[cfg(feature = "gpu")]
pub mod faulty;
pub mod hall;
pub mod hard;
pub mod intruders;
pub mod judge;
pub mod oracle;
pub mod pictures;
pub mod route;
pub mod scenes;
pub mod skip;
pub mod tags;

pub use pictures::compare_or_show;
pub use presight_model::environment::{CUBOID_FACES, cuboid_corners};
use presight_model::geometry::Pose;
pub use presight_model::random::SplitMix64 as Random;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::request::Request;
use presight_render::plan::Samples;
use presight_render::plan::{FramePlan, Images, Output, Outputs};

/// A plan that requests all images that the sensor has.
pub fn plan(world: &World, sensor: &Sensor, world_from_sensor: &Pose) -> FramePlan {
    let all = Outputs::ALL;
    let outputs = if sensor.is_camera() { all } else { all.without(Output::DepthZ) };
    FramePlan::new(world, sensor, world_from_sensor, &Request::of(outputs)).expect("a sound pose")
}

/// The reference's images.
pub fn reference(plan: &FramePlan) -> Images {
    let mut images = Images::default();
    presight_render::reference::render(plan, &mut images).expect("the reference renders");
    images
}

/// The bits of an image of any sample type; empty if the image does not exist.
pub fn bits(images: &Images, output: Output) -> Vec<u32> {
    match images.samples(output) {
        Some(Samples::Floats(image)) => image.iter().map(|v| v.to_bits()).collect(),
        Some(Samples::Ids(image)) => image.to_vec(),
        Some(Samples::Vectors(image)) => image.as_flattened().iter().map(|v| v.to_bits()).collect(),
        None => Vec::new(),
    }
}

/// True if this machine has an adapter for the GPU engine.
#[cfg(feature = "gpu")]
pub fn has_adapter() -> bool {
    !presight_predict::gpu::adapters().is_empty()
}

/// Reads a number from an environment variable, to vary runs or to reproduce one.
pub fn env_number(name: &str, default: u64) -> u64 {
    match std::env::var(name) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{name}={text} is not a number")),
        Err(_) => default,
    }
}

/// A one-line summary of a comparison.
pub fn summary(report: &presight_render::verify::Report) -> String {
    format!(
        "{} pixels: {} same, {} edge, {} coincident, {} faults; worst share of the bound: {}",
        report.pixels, report.same, report.edge, report.coincident, report.fault, report.worst
    )
}

/// Makes any later use of rayon's global pool panic. The product must use its own threads, which can fail to start
/// without a panic.
pub fn forbid_global_pool() {
    let refuse = |_| Err(std::io::Error::other("forbidden here"));
    // The first call fails and leaves the pool without threads permanently, so later calls fail too.
    let started = rayon::ThreadPoolBuilder::new().num_threads(1).spawn_handler(refuse).build_global();
    assert!(started.is_err());
    let used = std::panic::catch_unwind(|| rayon::join(|| (), || ()));
    assert!(used.is_err(), "something used the global pool before");
}
