//! What tests of presight share: scenes, engines, an oracle, data, and the rule for tests that lack something.
//!
//! Tests of the library inside `src` cannot use what takes or returns types of the library: to them those are of another
//! copy of it.

pub mod data;
pub mod engines;
#[cfg(feature = "gpu")]
pub mod faulty;
pub mod hall;
pub mod hard;
pub mod oracle;
pub mod pictures;
pub mod scenes;
pub mod skip;
pub mod tags;

pub use pictures::compare_or_show;
use presight_model::geometry::Pose;
pub use presight_model::random::SplitMix64 as Random;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::request::Request;
use presight_render::plan::Samples;
use presight_render::plan::{FramePlan, Images, Output, Outputs};

/// A plan that asks for everything.
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

/// The bits of an image, whatever a pixel of it holds; empty if it is not there.
pub fn bits(images: &Images, output: Output) -> Vec<u32> {
    match images.samples(output) {
        Some(Samples::Floats(image)) => image.iter().map(|v| v.to_bits()).collect(),
        Some(Samples::Ids(image)) => image.to_vec(),
        Some(Samples::Vectors(image)) => image.as_flattened().iter().map(|v| v.to_bits()).collect(),
        None => Vec::new(),
    }
}

/// A number from the environment, for spreading runs and for reproducing one.
pub fn env_number(name: &str, default: u64) -> u64 {
    match std::env::var(name) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{name}={text} is not a number")),
        Err(_) => default,
    }
}

/// One line on a comparison.
pub fn summary(report: &presight_render::verify::Report) -> String {
    format!(
        "{} pixels: {} same, {} edge, {} coincident, {} faults; worst share of the bound: {}",
        report.pixels, report.same, report.edge, report.coincident, report.fault, report.worst
    )
}

/// From now on everything that runs on rayon's global pool panics: the product has its own threads, whose start can fail
/// without a panic.
pub fn forbid_global_pool() {
    let refuse = |_| Err(std::io::Error::other("forbidden here"));
    // The first call fails and leaves the pool without threads for good; a later one finds it so.
    let started = rayon::ThreadPoolBuilder::new().num_threads(1).spawn_handler(refuse).build_global();
    assert!(started.is_err());
    let used = std::panic::catch_unwind(|| rayon::join(|| (), || ()));
    assert!(used.is_err(), "something used the global pool before");
}
