//! The time measurement that the benches share.

use std::time::Instant;

/// Milliseconds of the fastest run, of at least three and as many as fit in half a second. The fastest run is the one
/// that other work on the machine disturbs least.
pub fn fastest(mut run: impl FnMut()) -> f64 {
    let (start, mut runs, mut least) = (Instant::now(), 0, f64::INFINITY);
    while start.elapsed().as_secs_f64() < 0.5 || runs < 3 {
        let begin = Instant::now();
        run();
        least = least.min(begin.elapsed().as_secs_f64() * 1e3);
        runs += 1;
    }
    least
}
