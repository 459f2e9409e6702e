//! How deadlines are kept: `cargo bench --bench deadline -- SCENE.glb [SENSOR] [FRAMES]`. Prints the figures of docs/deadline.md.

#![allow(missing_docs, clippy::print_stdout, reason = "a program that prints figures")]

use presight::free_poses::free_poses;
use presight::io::gltf::{ImportOptions, import};
use presight::{Backend, ErrorKind, Options, Pose, Predictor, Request, Sensor, Stats, World};
use std::error::Error;
use std::time::{Duration, Instant};

const POSES: usize = 20;

/// SplitMix64, 0..1.
fn random(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
        .get(((sorted.len() as f64 * share) as usize).min(sorted.len().saturating_sub(1)))
        .copied()
        .unwrap_or(f64::NAN)
}

struct Bench {
    world: World,
    sensor: Sensor,
    predictor: Predictor,
}

impl Bench {
    /// Milliseconds of one prediction from outside, and what it says.
    fn frame(&mut self, pose: &Pose, deadline_ms: Option<f64>) -> (f64, presight::Result<Stats>) {
        let deadline = deadline_ms.map(|ms| Duration::from_secs_f64(ms / 1e3));
        let mut request = Request::default();
        request.deadline = deadline;
        let start = Instant::now();
        let prediction = self.predictor.predict(&self.world, &self.sensor, pose, &request);
        (start.elapsed().as_secs_f64() * 1e3, prediction.map(|p| p.stats))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).filter(|arg| arg != "--bench").collect();
    let Some(scene) = args.first() else {
        println!("give a scene: cargo bench --bench deadline -- SCENE.glb [SENSOR] [FRAMES]");
        return Ok(());
    };
    let sensor = presight::preset(args.get(1).map_or("microwave-radar-image", String::as_str))?;
    let frames: usize = args.get(2).map_or(Ok(2000), |n| n.parse())?;
    let world = World::new(import(scene, &ImportOptions::default())?.environment);
    let poses = free_poses(&world, POSES, 7)?;
    let predictor = Predictor::new(Options::new(Backend::Cpu))?;
    let mut bench = Bench { world, sensor, predictor };
    println!("{scene}, {}, {frames} frames", bench.sensor.spec().name);

    // Without a deadline, and with one that asks for nothing to be given up, in turns.
    let (mut full, mut plain, mut generous) = (vec![Vec::new(); POSES], Vec::new(), Vec::new());
    for _ in 0..10 {
        for (pose, full) in poses.iter().zip(&mut full) {
            full.push(bench.frame(pose, None).0);
            plain.push(full[full.len() - 1]);
            generous.push(bench.frame(pose, Some(1e6)).0);
        }
    }
    let full: Vec<f64> = full.iter().map(|times| quantile(times, 0.5)).collect();
    let (plain_ms, generous_ms) = (quantile(&plain, 0.5), quantile(&generous, 0.5));
    println!("full {plain_ms:.3} ms median; a generous deadline {:+.1} %", 100.0 * (generous_ms / plain_ms - 1.0));

    let (mut state, mut over, mut refused, mut late_refusals) = (5, Vec::new(), 0, 0);
    let (mut estimates, mut without) = (Vec::new(), 0);
    for frame in 0..frames {
        let at = frame % POSES;
        let deadline = full[at] * (0.7 + random(&mut state));
        without += usize::from(full[at] > deadline);
        let (took, answer) = bench.frame(&poses[at], Some(deadline));
        match answer {
            Ok(stats) => {
                over.extend((took > deadline).then_some((took - deadline, deadline)));
                estimates.extend(stats.deadline.map(|kept| (kept.estimate_ms / kept.time_ms - 1.0).abs()));
            }
            Err(e) if e.kind() == ErrorKind::Deadline => {
                refused += 1;
                late_refusals += usize::from(took > deadline);
            }
            Err(e) => return Err(e.into()),
        }
    }
    let slight = over.iter().filter(|(by, deadline)| *by <= (0.1 * deadline).max(1.0)).count();
    println!(
        "kept {:.2} % (without control {:.0} %); {} missed, {slight} of them by at most 10 % or 1 ms, the worst by {:.2} ms; {refused} \
         refused, {late_refusals} of them late",
        100.0 * (1.0 - (over.len() + late_refusals) as f64 / frames as f64),
        100.0 * (1.0 - without as f64 / frames as f64),
        over.len(),
        over.iter().map(|(by, _)| *by).fold(0.0, f64::max),
    );
    println!(
        "estimate of a finished frame: off by {:.1} % median, {:.1} % p95",
        100.0 * quantile(&estimates, 0.5),
        100.0 * quantile(&estimates, 0.95)
    );

    for share in [0.3, 0.6, 0.8] {
        let (mut there, mut complete) = (Vec::new(), Vec::new());
        for _ in 0..5 {
            for (pose, full) in poses.iter().zip(&full) {
                let Ok(stats) = bench.frame(pose, Some(share * full)).1 else {
                    there.push(0.0);
                    complete.push(0.0);
                    continue;
                };
                let lost = stats.degradation().map_or(0, |given_up| given_up.samples);
                there.push(1.0 - lost as f64 / (bench.sensor.width() * bench.sensor.height()) as f64);
                complete.push(stats.degradation().map_or(f64::INFINITY, |given_up| given_up.complete_to));
            }
        }
        println!(
            "in {:.0} % of the full time: {:.0} % of the samples and complete to {:.1} m in the median, {:.0} % and {:.1} m in the worst tenth",
            100.0 * share,
            100.0 * quantile(&there, 0.5),
            quantile(&complete, 0.5),
            100.0 * quantile(&there, 0.1),
            quantile(&complete, 0.1),
        );
    }
    let impossible = bench.frame(&poses[0], Some(1e-3));
    println!("a deadline of 1 us is refused after {:.4} ms", impossible.0);
    Ok(())
}
