//! Measures the machine's steadiness: repeats a fixed computation on as many threads as predictions use.

use super::quantile;
use std::hint::black_box;
use std::sync::Barrier;
use std::time::{Duration, Instant};

const ROUNDS: usize = 3000;
/// The duration of one round.
const AIM: Duration = Duration::from_micros(1500);

fn work(steps: u64) -> u64 {
    (0..steps).fold(1, |x: u64, i| black_box(x.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(i)))
}

/// Prints how often a round is late; deadlines cannot be kept more often than that allows.
pub fn print(threads: usize) {
    let trial = 20_000_000;
    let start = Instant::now();
    work(trial);
    let steps = (trial as f64 * AIM.as_secs_f64() / start.elapsed().as_secs_f64()) as u64;
    let together = Barrier::new(threads);
    let rounds = || -> Vec<f64> {
        let round = |_| {
            together.wait();
            let start = Instant::now();
            work(steps);
            start.elapsed().as_secs_f64() * 1e3
        };
        (0..ROUNDS).map(round).collect()
    };
    let of_threads: Vec<Vec<f64>> = std::thread::scope(|scope| {
        let started: Vec<_> = (0..threads).map(|_| scope.spawn(rounds)).collect();
        started.into_iter().map(|thread| thread.join().expect("arithmetic")).collect()
    });
    let slowest: Vec<f64> = (0..ROUNDS).map(|i| of_threads.iter().map(|times| times[i]).fold(0.0, f64::max)).collect();
    let median = quantile(&slowest, 0.5);
    let beyond =
        |factor: f64| 100.0 * slowest.iter().filter(|time| **time > factor * median).count() as f64 / ROUNDS as f64;
    println!(
        "the machine: fixed work of {median:.2} ms on {threads} threads takes over 1.1, 1.2, 1.5 times as long in {:.1}, {:.1}, {:.1} % of {ROUNDS} rounds",
        beyond(1.1),
        beyond(1.2),
        beyond(1.5)
    );
}
