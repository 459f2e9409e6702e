//! Compares the samples given up with a clairvoyant controller, which replays recorded frame costs.
//!
//! At each pose the engine is stopped at many moments, with full and with thinned images. Each record holds the number
//! of finished samples and the total time. The clairvoyant controller takes the best record that is in time.

use super::{Bench, Outcome, Setting, quantile};
use presight_model::geometry::Pose;
use presight_predict::free_poses::free_poses;
use presight_predict::request::Request;
use presight_render::cpu::CpuEngine;
use presight_render::deadline::Watch;
use presight_render::plan::{FramePlan, Images, Stats};
use std::time::Duration;

const POSES: usize = 20;
/// Frames to learn from.
const LEARN: usize = 50;
/// The number of moments at which the engine is stopped, and the runs at each.
const STOPS: u32 = 24;
const TIMES: usize = 5;
/// The strides of the columns and rows drawn: every one, every second one, ..
const STRIDES: [u32; 4] = [1, 2, 4, 8];

/// The milliseconds of a frame, and its finished samples.
type Record = (f64, f64);

pub fn print(args: &[String], setting: &Setting) -> Outcome {
    let mut bench = Bench::new(&args[0], args.get(1), setting)?;
    let mut engine = CpuEngine::new(bench.threads)?;
    for pose in free_poses(&bench.world, LEARN, 11)? {
        bench.frame(&pose, Some(1e6)).1?;
    }
    let poses = free_poses(&bench.world, POSES, 7)?;
    let shares = [0.3, 0.6, 0.8];
    let (mut given_up, mut must) = ([0.0; 3], [0.0; 3]);
    let mut floor = Vec::new();
    for pose in &poses {
        let full = quantile(&(0..TIMES).map(|_| bench.frame(pose, None).0).collect::<Vec<_>>(), 0.5);
        let records = record(&bench, &mut engine, pose, full)?;
        floor.push(records.iter().map(|(ms, _)| *ms).fold(f64::INFINITY, f64::min) / full);
        for (k, share) in shares.iter().enumerate() {
            let lost = (0..TIMES).map(|_| bench.lost(pose, share * full));
            given_up[k] += quantile(&lost.collect::<Vec<_>>(), 0.5);
            let in_time = records.iter().filter(|(ms, _)| *ms <= share * full);
            must[k] += bench.pixels() - in_time.map(|(_, there)| *there).fold(0.0, f64::max);
        }
    }
    println!("an image of nothing takes {:.0} % of the full time in the median", 100.0 * quantile(&floor, 0.5));
    let all = bench.pixels() * poses.len() as f64;
    for ((share, given_up), must) in shares.iter().zip(given_up).zip(must) {
        println!(
            "in {:.0} % of the full time: {:.1} % of the samples given up, {:.1} % by a clairvoyant controller: {:+.1} %",
            100.0 * share,
            100.0 * given_up / all,
            100.0 * must / all,
            100.0 * (given_up / must - 1.0)
        );
    }
    Ok(())
}

/// Records the finished samples when the engine is stopped at moments up to the full time; times are medians.
fn record(bench: &Bench, engine: &mut CpuEngine, pose: &Pose, full: f64) -> Outcome<Vec<Record>> {
    let mut records = Vec::new();
    let mut images = Images::default();
    for stride in STRIDES {
        for stop in 0..=STOPS {
            let after = Duration::from_secs_f64(1e-3 * full * f64::from(stop) / f64::from(STOPS));
            let (mut times, mut there) = (Vec::new(), Vec::new());
            for _ in 0..TIMES {
                let start = bench.clock.now();
                let mut plan = FramePlan::new(&bench.world, &bench.sensor, pose, &Request::default())?;
                plan.set_watch(Watch::start(bench.clock.clone(), after));
                if stride > 1 {
                    plan.set_part(stride, None)?;
                }
                let mut stats = Stats::default();
                engine.render(&plan, &mut images, &mut stats)?;
                times.push(bench.since(start));
                there.push(bench.pixels() - stats.degradation().map_or(0.0, |given_up| given_up.samples as f64));
            }
            records.push((quantile(&times, 0.5), quantile(&there, 0.5)));
        }
    }
    Ok(records)
}
