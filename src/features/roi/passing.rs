//! With what probability any side is passed: thresholds at a common number of standard deviations.
//!
//! The probability of a union is at most the sum of the tails less the joint tails along any spanning tree (Hunter 1976;
//! Worsley 1982), and least along the greatest. Correlations do not depend on the thresholds, so the tree is made once.
//! The joint tail of two thresholds is taken as that of the greater one for both: never more, and where they differ much the
//! farther event hardly counts.

use super::SIDES;
use super::errors::KIND;
use super::seen::{MARGIN, Seen, dot};
use crate::features::normal::{Tails, apart, tail_quantile};

/// Most points of a side that are looked at.
pub(crate) const MOST: usize = 3;

/// Most events.
pub(crate) const EVENTS: usize = 4 * MOST;

/// What a confidence says about thresholds, made once for all features.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Level {
    /// The probability that is left.
    pub fail: f64,
    /// Standard deviations at which a single event has it.
    pub lowest: f64,
    /// At which each of four independent ones has a quarter of it: where the search starts.
    pub first: f64,
    /// At which so many as are looked at have it together.
    pub highest: f64,
}

impl Level {
    pub fn new(confidence: f64) -> Self {
        let fail = 1.0 - confidence;
        let shared = |n: f64| tail_quantile(fail / n);
        Self { fail, lowest: shared(1.0), first: shared(4.0), highest: shared(EVENTS as f64) }
    }
}

/// A point passing a side.
#[derive(Clone, Copy, Debug, Default)]
struct Event {
    /// Whose slopes.
    seen: usize,
    /// Which coordinate, and which way.
    side: (usize, f64),
    /// How many standard deviations away the side is where the search starts.
    deviations: f64,
    /// By how many more for each that the common number rises.
    rate: f64,
    tail: f64,
}

/// The events that count, and the tree between them.
struct Events {
    events: [Event; EVENTS],
    count: usize,
    /// For all but the first event of a tree: its neighbour, and how far apart they are.
    parents: [(usize, f64); EVENTS],
}

/// The number of standard deviations k at which no side is passed but with the probability that is left.
pub(super) fn common_deviation(seen: &[Seen], level: &Level) -> f64 {
    let tails = Tails::get();
    let mut events = Events::new(seen, level.first, tails);
    if events.count == 0 {
        return level.lowest;
    }
    events.join(seen, tails);
    let wanted = level.fail.ln();
    let excess = |k: f64| events.passed(k - level.first, tails).ln() - wanted;
    let within = |k: f64| k.clamp(level.lowest, level.highest);
    // The logarithm of a sum of tails is nearly a parabola: one step along a tail's own slope, one along the secant.
    let hazard = |k: f64| 0.398_942_280_401_432_7 / tails.mills(k);
    let before = excess(level.first);
    let k = within(level.first + before / hazard(level.first));
    let step = k - level.first;
    if step.abs() < 1e-6 {
        return k;
    }
    let after = excess(k);
    let slope = (after - before) / step;
    within(if slope < -0.1 { k - after / slope } else { k })
}

impl Events {
    /// Chosen at `k` standard deviations: of each side the point that makes it, and those nearly as likely to pass.
    fn new(seen: &[Seen], k: f64, tails: &Tails) -> Self {
        let none = Event::default();
        let mut all = Self { events: [none; EVENTS], count: 0, parents: [(0, -1.0); EVENTS] };
        let at_first = tails.tail(k);
        for side in SIDES {
            let c = side.0;
            let maker =
                (0..seen.len()).fold(0, |b, i| if seen[i].reach(side, k) > seen[b].reach(side, k) { i } else { b });
            let (limit, sigma) = (seen[maker].reach(side, k), seen[maker].sigma[c]);
            let first = all.count;
            let mut at = Some((f64::NEG_INFINITY, maker));
            while let Some((nearest, i)) = at {
                let s = &seen[i];
                let deviations = nearest.max(k);
                if !(s.sigma[c] > 0.0 && deviations < k + MARGIN) {
                    break;
                }
                // Points that move as one pass as one.
                let one = |e: &Event| {
                    dot(&seen[e.seen].slopes[c], &s.slopes[c]) > (1.0 - 1e-6) * s.sigma[c] * seen[e.seen].sigma[c]
                };
                if !all.events[first..all.count].iter().any(one) {
                    let rate = sigma / s.sigma[c];
                    // Those that make a side are all as far.
                    let tail = if deviations == k { at_first } else { tails.tail(deviations) };
                    all.events[all.count] = Event { seen: i, side, deviations, rate, tail };
                    all.count += 1;
                }
                if all.count == first + MOST {
                    break;
                }
                // The next nearest.
                let after = if i == maker { (f64::NEG_INFINITY, 0) } else { (nearest, i) };
                at = next(seen, side, limit, maker, after);
            }
        }
        all
    }

    /// The spanning tree of greatest joint tails (Prim).
    fn join(&mut self, seen: &[Seen], tails: &Tails) {
        let events = &self.events[..self.count];
        let directions = Directions::new(events, seen);
        let mut best = [-1.0f64; EVENTS];
        let mut out = [true; EVENTS];
        let mut last = 0;
        for _ in 1..self.count {
            out[last] = false;
            let mut next = usize::MAX;
            let b = &events[last];
            for (i, a) in events.iter().enumerate().filter(|(i, _)| out[*i]) {
                // What goes opposite ways hardly ever happens together.
                if let Some(apart) = directions.apart((i, a), (last, b)) {
                    let (far, less) =
                        if a.deviations > b.deviations { (a.deviations, a.tail) } else { (b.deviations, b.tail) };
                    let joint = less * tails.shared(far, apart);
                    if joint > best[i] {
                        (best[i], self.parents[i]) = (joint, (last, apart));
                    }
                }
                if next == usize::MAX || best[i] > best[next] {
                    next = i;
                }
            }
            last = next;
        }
    }

    /// At most this probability that any side is passed, with the common number of standard deviations so much higher.
    fn passed(&self, more: f64, tails: &Tails) -> f64 {
        let mut reach = [(0.0, 0.0); EVENTS];
        for i in 0..self.count {
            let e = &self.events[i];
            let deviations = (e.deviations + more * e.rate).max(0.0);
            let same = reach[..i].last().filter(|r| r.0 == deviations);
            reach[i] = match same {
                _ if more == 0.0 => (e.deviations, e.tail),
                Some(known) => *known,
                None if deviations == reach[0].0 => reach[0],
                None => (deviations, tails.tail(deviations)),
            };
        }
        let mut sum = 0.0;
        for i in 0..self.count {
            let (parent, apart) = self.parents[i];
            sum += reach[i].1;
            if apart >= 0.0 {
                let (far, less) = if reach[i].0 > reach[parent].0 { reach[i] } else { reach[parent] };
                sum -= less * tails.shared(far, apart);
            }
        }
        sum.max(f64::MIN_POSITIVE)
    }
}

/// How far apart the errors are that make events: both ways through a side are one direction.
struct Directions {
    /// By event.
    number: [usize; EVENTS],
    /// Correlations, and what is apart of their amounts, by pairs of directions, the greater number first.
    pairs: [[(f64, f64); EVENTS]; EVENTS],
}

impl Directions {
    fn new(events: &[Event], seen: &[Seen]) -> Self {
        let mut all = Self { number: [0; EVENTS], pairs: [[(0.0, 0.0); EVENTS]; EVENTS] };
        let mut known = [(&[[0.0; KIND]; 3], 0.0, (0, 0)); EVENTS];
        let mut count = 0;
        for (e, number) in events.iter().zip(&mut all.number) {
            let (of, c) = (e.seen, e.side.0);
            *number = (0..count).find(|n| known[*n].2 == (of, c)).unwrap_or_else(|| {
                let (slopes, sigma) = (&seen[of].slopes[c], seen[of].sigma[c]);
                for (before, pair) in known[..count].iter().zip(&mut all.pairs[count]) {
                    let rho = dot(slopes, before.0) / (sigma * before.1);
                    *pair = (rho, apart(rho.abs()));
                }
                all.pairs[count][count] = (1.0, 0.0);
                known[count] = (slopes, sigma, (of, c));
                count += 1;
                count - 1
            });
        }
        all
    }

    /// Of two events; `None` if they go opposite ways, or are independent.
    #[inline]
    fn apart(&self, (i, a): (usize, &Event), (j, b): (usize, &Event)) -> Option<f64> {
        let (m, n) = (self.number[i], self.number[j]);
        let (rho, apart) = self.pairs[m.max(n)][m.min(n)];
        (a.side.1 * b.side.1 * rho > 0.0).then_some(apart)
    }
}

/// The point that comes next after one with so many deviations, by deviations and then by number; not the one that makes
/// the side.
fn next(seen: &[Seen], (c, sign): (usize, f64), limit: f64, maker: usize, after: (f64, usize)) -> Option<(f64, usize)> {
    let mut best: Option<(f64, usize)> = None;
    for (i, s) in seen.iter().enumerate().filter(|(i, s)| *i != maker && s.sigma[c] > 0.0) {
        let here = ((limit - sign * s.rough.at[c]) / s.sigma[c], i);
        if here > after && best.is_none_or(|b| here < b) {
            best = Some(here);
        }
    }
    best
}
