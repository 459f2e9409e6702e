//! What several tests share.
#![allow(dead_code, reason = "no test file uses all of it")]

pub mod data;
pub mod engines;
pub mod hard;
pub mod oracle;
pub mod scenes;
pub mod skip;

use presight::{FramePlan, IdScheme, Images, Outputs, Pose, Request, Sensor, World};

/// A plan that asks for everything.
pub fn plan(world: &World, sensor: &Sensor, world_from_sensor: &Pose) -> FramePlan {
    let all = Outputs::ALL;
    let outputs = if sensor.is_camera() { all } else { all.without(presight::Output::DepthZ) };
    FramePlan::new(world, sensor, world_from_sensor, &Request { outputs, ids: IdScheme::Model, ..Request::default() })
        .expect("a sound pose")
}

/// The reference's images.
pub fn reference(plan: &FramePlan) -> Images {
    let mut images = Images::default();
    presight::reference::render(plan, &mut images).expect("the reference renders");
    images
}

/// A small seeded generator (SplitMix64), so that a failing case is named by its seed.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in `low..high`.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform below `n`; 0 for 0.
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n.max(1) as u64) as usize
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
pub fn summary(report: &presight::compare::Report) -> String {
    format!(
        "{} pixels: {} same, {} edge, {} coincident, {} faults; worst share of the bound: range {:.3}, depth_z {:.3}, \
         cos_incidence {:.3}, echo {:.3}",
        report.pixels,
        report.same,
        report.edge,
        report.coincident,
        report.fault,
        report.worst.range,
        report.worst.depth_z,
        report.worst.cos_incidence,
        report.worst.echo
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
