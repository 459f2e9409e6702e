//! Deadlines kept, errors of the estimates, samples given up, and the overhead of a generous deadline.

use super::{Bench, Outcome, Setting, quantile, steadiness};
use presight_model::error::ErrorKind;
use presight_model::geometry::Pose;
use presight_predict::free_poses::free_poses;
use presight_render::plan::Way;
use std::collections::BTreeMap;

/// The number of poses for frames with a deadline.
const POSES: usize = 20;
/// The frames to learn from and the frames with judged estimates, each at its own pose.
const LEARN: usize = 50;
const JUDGED: usize = 150;

/// SplitMix64, uniform in [0, 1).
fn random(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

pub fn print(args: &[String], setting: &Setting) -> Outcome {
    let mut bench = Bench::new(&args[0], args.get(1), setting)?;
    let frames: usize = args.get(2).map_or(Ok(2000), |n| n.parse())?;
    if !setting.by_cpu_time {
        steadiness::print(std::thread::available_parallelism()?.get());
    }
    estimates(&mut bench)?;
    let poses = free_poses(&bench.world, POSES, 7)?;
    let full = free(&mut bench, &poses);
    kept(&mut bench, &poses, &full, frames)?;
    given_up(&mut bench, &poses, &full);
    let refused: Vec<f64> = (0..100).map(|_| bench.frame(&poses[0], Some(1e-3)).0).collect();
    println!(
        "a deadline of 1 us is refused after {:.4} ms, {:.4} at most",
        quantile(&refused, 0.5),
        quantile(&refused, 1.0)
    );
    Ok(())
}

/// Prints the errors of whole-frame estimates at poses that were not learnt from.
fn estimates(bench: &mut Bench) -> Outcome {
    let poses = free_poses(&bench.world, LEARN + JUDGED, 11)?;
    let (mut finished, mut waves, mut first) = (Vec::new(), Vec::new(), Vec::new());
    for (i, pose) in poses.iter().enumerate() {
        let stats = bench.frame(pose, Some(1e6)).1?;
        let Some(kept) = stats.deadline.filter(|_| i >= LEARN) else { continue };
        let off = |estimate: f64, time: f64| (estimate / time - 1.0).abs();
        finished.push(off(kept.estimate_ms, kept.images_ms));
        first.extend(kept.first_estimate_ms.map(|estimate| off(estimate, kept.images_ms)));
        waves.extend(kept.wave.map(|wave| off(wave.estimate_ms, wave.time_ms)));
    }
    for (name, off) in
        [("a finished frame", finished), ("a wave after its setup", waves), ("a frame after selection", first)]
    {
        let (median, p95) = (quantile(&off, 0.5), quantile(&off, 0.95));
        println!(
            "estimate of {name}: off by {:.1} % median, {:.1} % p95 of {}",
            100.0 * median,
            100.0 * p95,
            off.len()
        );
    }
    Ok(())
}

/// Runs frames alternately without a deadline and with a generous one. Returns the median time at each pose.
fn free(bench: &mut Bench, poses: &[Pose]) -> Vec<f64> {
    let (mut full, mut generous) = (vec![Vec::new(); poses.len()], vec![Vec::new(); poses.len()]);
    for _ in 0..20 {
        for (i, pose) in poses.iter().enumerate() {
            full[i].push(bench.frame(pose, None).0);
            generous[i].push(bench.frame(pose, Some(1e6)).0);
        }
    }
    let medians = |times: &[Vec<f64>]| times.iter().map(|times| quantile(times, 0.5)).collect::<Vec<_>>();
    let (full, generous) = (medians(&full), medians(&generous));
    let (plain_ms, generous_ms) = (full.iter().sum::<f64>(), generous.iter().sum::<f64>());
    let poses = poses.len() as f64;
    println!("full {:.3} ms; a generous deadline {:+.1} %", plain_ms / poses, 100.0 * (generous_ms / plain_ms - 1.0));
    full
}

/// Runs frames under deadlines; 30 % of these would be missed without control.
fn kept(bench: &mut Bench, poses: &[Pose], full: &[f64], frames: usize) -> Outcome {
    let (mut state, mut over, mut refused, mut late_refusals, mut without) = (5, Vec::new(), 0, 0, 0);
    let mut ways: BTreeMap<&str, [usize; 3]> = BTreeMap::new();
    for frame in 0..frames {
        let at = frame % poses.len();
        let deadline = full[at] * (0.7 + random(&mut state));
        without += usize::from(full[at] > deadline);
        let (took, answer) = bench.frame(&poses[at], Some(deadline));
        match answer {
            Ok(stats) => {
                over.extend((took > deadline).then_some((took - deadline, deadline)));
                let way = if stats.engine == "row" { "row" } else { stats.way.map_or("gpu", Way::name) };
                let [drawn, late, complete] = ways.entry(way).or_default();
                *drawn += 1;
                *late += usize::from(took > deadline);
                *complete += usize::from(stats.degradation().is_none());
            }
            Err(e) if e.kind() == ErrorKind::Deadline => {
                refused += 1;
                late_refusals += usize::from(took > deadline);
            }
            Err(e) => return Err(e.into()),
        }
    }
    let slight = over.iter().filter(|(by, deadline)| *by <= (0.1 * deadline).max(1.0)).count();
    let share = |n: usize| 100.0 * (1.0 - n as f64 / frames as f64);
    println!(
        "kept {:.2} % of {frames} (without control {:.0} %); {} missed, {slight} of them by at most 10 % or 1 ms, the worst by {:.2} \
         ms; {refused} refused, {late_refusals} of them late",
        share(over.len() + late_refusals),
        share(without),
        over.len(),
        over.iter().map(|(by, _)| *by).fold(0.0, f64::max),
    );
    for (way, [drawn, late, complete]) in ways {
        println!("  by {way}: {drawn}, {late} of them late; {complete} complete");
    }
    Ok(())
}

/// Prints the finished samples under tight deadlines.
fn given_up(bench: &mut Bench, poses: &[Pose], full: &[f64]) {
    for share in [0.3, 0.6, 0.8] {
        let (mut there, mut complete, mut thinned) = (Vec::new(), Vec::new(), 0);
        for _ in 0..5 {
            for (pose, full) in poses.iter().zip(full) {
                let stats = bench.frame(pose, Some(share * full)).1.ok();
                let given_up = stats.as_ref().map(|stats| stats.degradation());
                let lost = given_up.map_or(bench.pixels(), |g| g.map_or(0.0, |g| g.samples as f64));
                there.push(1.0 - lost / bench.pixels());
                complete.push(given_up.map_or(0.0, |g| g.map_or(f64::INFINITY, |g| g.complete_to)));
                thinned += usize::from(given_up.flatten().is_some_and(|g| g.stride > 1));
            }
        }
        println!(
            "in {:.0} % of the full time: {:.0} % of the samples and complete to {:.1} m in the median, {:.0} % and {:.1} m in the worst \
             tenth; {thinned} of {} thinned",
            100.0 * share,
            100.0 * quantile(&there, 0.5),
            quantile(&complete, 0.5),
            100.0 * quantile(&there, 0.1),
            quantile(&complete, 0.1),
            there.len(),
        );
    }
}
