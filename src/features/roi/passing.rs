//! With what probability any side is passed: thresholds at a common number of standard deviations.

use super::SIDES;
use super::seen::Seen;
use crate::features::normal::{joint_tail, tail, tail_quantile};

/// The number of standard deviations k at which no side is passed but with probability `fail`.
pub(super) fn common_deviation(seen: &[Seen], fail: f64) -> f64 {
    let lowest = tail_quantile(fail);
    // Which events count, and the tree, are settled at Bonferroni's k for four sides; there the tails hardly change.
    let first = tail_quantile(0.25 * fail);
    let events = events(seen, first);
    if events.is_empty() {
        return lowest;
    }
    let edges = tree(&events);
    let passed = |k: f64| {
        let reach = |e: &Event| e.deviations + (k - first);
        let sum: f64 = events.iter().map(|e| tail(reach(e))).sum();
        sum - edges.iter().map(|(i, j, rho)| joint_tail(reach(&events[*i]), reach(&events[*j]), *rho)).sum::<f64>()
    };
    let (mut low, mut high) = (lowest, tail_quantile(fail / events.len() as f64).max(lowest) + 1e-9);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if passed(middle) > fail { low = middle } else { high = middle }
    }
    high
}

/// A point passing a side.
struct Event {
    /// Unit vector of errors along which it goes there.
    direction: Vec<f64>,
    /// How many standard deviations away the side is.
    deviations: f64,
}

fn events(seen: &[Seen], k: f64) -> Vec<Event> {
    /// Most points a side that are looked at: the ends and those that stand out.
    const MOST: usize = 4;
    let mut events: Vec<Event> = Vec::new();
    for (c, sign) in SIDES {
        let limit = seen.iter().map(|s| sign * s.at[c] + k * s.sigma[c]).fold(f64::NEG_INFINITY, f64::max);
        let mut near: Vec<(f64, &Seen)> = seen
            .iter()
            .filter(|s| s.sigma[c] > 0.0)
            .map(|s| ((limit - sign * s.at[c]) / s.sigma[c], s))
            .filter(|(deviations, _)| *deviations < k + 1.5)
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let before = events.len();
        for (deviations, s) in near {
            let direction: Vec<f64> = s.slopes[c].iter().map(|x| sign * x / s.sigma[c]).collect();
            // Points that move as one pass as one.
            let same = |e: &Event| dot(&e.direction, &direction) > 1.0 - 1e-6;
            if events.len() < before + MOST && !events[before..].iter().any(same) {
                events.push(Event { direction, deviations });
            }
        }
    }
    events
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The spanning tree of greatest joint tails: pairs and their correlations (Prim).
fn tree(events: &[Event]) -> Vec<(usize, usize, f64)> {
    let mut edges = Vec::with_capacity(events.len().saturating_sub(1));
    let mut best: Vec<(f64, usize, f64)> = vec![(-1.0, 0, 0.0); events.len()];
    let mut out: Vec<usize> = (1..events.len()).collect();
    let mut last = 0;
    while !out.is_empty() {
        for &i in &out {
            let rho = dot(&events[i].direction, &events[last].direction).clamp(-1.0, 1.0);
            let joint = joint_tail(events[i].deviations, events[last].deviations, rho);
            if joint > best[i].0 {
                best[i] = (joint, last, rho);
            }
        }
        let at = (0..out.len()).fold(0, |b, i| if best[out[i]].0 > best[out[b]].0 { i } else { b });
        last = out.swap_remove(at);
        edges.push((last, best[last].1, best[last].2));
    }
    edges
}
