//! Probability of passing any side, with thresholds at a common number of standard deviations.
//!
//! The probability of a union is at most the sum of the tails minus the joint tails along any spanning tree (Hunter
//! 1976; Worsley 1982). The maximum spanning tree gives the tightest bound. Correlations do not depend on the
//! thresholds, so the tree is built once. The joint tail uses the larger of the two thresholds for both events. It
//! never overestimates, and if the thresholds differ much, the farther event hardly matters.

use super::image_point::{MARGIN, PointDerivatives, dot};
use super::{SIDES, Side};
use presight_model::statistics::{Tails, apart, tail_quantile};

/// Maximum number of points considered for a side.
pub const MAX_SIDE_POINTS: usize = 3;

/// Maximum number of events.
pub const EVENTS: usize = 4 * MAX_SIDE_POINTS;

/// Thresholds for one confidence, shared by all features.
#[derive(Clone, Copy)]
pub struct Level {
    /// 1 - confidence.
    pub fail: f64,
    /// Standard deviations at which a single event has this probability.
    pub lowest: f64,
    /// Standard deviations at which each of four events has a quarter of it. The search starts here.
    pub first: f64,
    /// Standard deviations at which each of [`EVENTS`] events has an equal share of it.
    pub highest: f64,
    /// Logarithm of `fail`, tail at `first`, and the hazard rate there.
    wanted: f64,
    tail: f64,
    hazard: f64,
    tails: &'static Tails,
}

impl Level {
    /// The level of a confidence.
    pub fn new(confidence: f64) -> Self {
        let fail = 1.0 - confidence;
        let shared = |n: f64| tail_quantile(fail / n);
        let (tails, first) = (Tails::get(), shared(4.0));
        Self {
            fail,
            lowest: shared(1.0),
            first,
            highest: shared(EVENTS as f64),
            wanted: fail.ln(),
            tail: tails.tail(first),
            hazard: 0.398_942_280_401_432_7 / tails.mills(first),
            tails,
        }
    }
}

/// The event that a point passes a side.
#[derive(Clone, Copy, Debug)]
struct Event {
    /// Index of the point.
    seen: usize,
    side: Side,
    /// Distance of the side at the start of the search, standard deviations.
    deviations: f64,
    /// Change of that distance per unit of the common number.
    rate: f64,
    tail: f64,
    /// Index of its direction, shared by both signs of a coordinate.
    direction: usize,
}

/// An event's neighbour in the spanning tree, and the separation of the two.
#[derive(Clone, Copy, Debug)]
struct Parent {
    event: usize,
    /// Separation ([`apart`]); below 0 without a neighbour.
    apart: f64,
    /// Joint tail with the neighbour.
    joint: f64,
    /// True while not in the tree.
    out: bool,
}

/// The relevant events and the tree between them, in reused memory.
#[derive(Default)]
pub(super) struct Exceedance {
    events: Vec<Event>,
    /// Point and coordinate by direction.
    directions: Vec<(usize, usize)>,
    /// Correlation and separation of each direction with the earlier ones, row by row.
    pairs: Vec<(f64, f64)>,
    parents: Vec<Parent>,
    /// Deviation and tail of each event.
    reach: Vec<(f64, f64)>,
    /// Further points that may pass a side, with their deviations.
    near: Vec<(f64, usize)>,
}

impl Exceedance {
    /// Returns the number of standard deviations k at which the probability of passing any side is 1 - confidence.
    pub fn common_deviation(&mut self, seen: &[PointDerivatives], level: &Level) -> f64 {
        self.take_events(seen, level);
        if self.events.is_empty() {
            return level.lowest;
        }
        self.take_pairs(seen);
        self.join(level.tails);
        let within = |k: f64| k.clamp(level.lowest, level.highest);
        // The logarithm of a sum of tails is nearly a parabola, so a Newton step and a secant step suffice.
        let before = self.passed_first().ln() - level.wanted;
        let k = within(level.first + before / level.hazard);
        let step = k - level.first;
        if step.abs() < 1e-6 {
            return k;
        }
        let after = self.passed(step, level.tails).ln() - level.wanted;
        let slope = (after - before) / step;
        within(if slope < -0.1 { k - after / slope } else { k })
    }

    /// Collects the events at the first number of standard deviations: for each side the point that sets it, and the
    /// points that are nearly as likely to pass.
    fn take_events(&mut self, seen: &[PointDerivatives], level: &Level) {
        self.events.clear();
        self.directions.clear();
        let k = level.first;
        for side in SIDES {
            let Side { axis: c, sign } = side;
            let mut maker = (f64::NEG_INFINITY, 0);
            for (i, s) in seen.iter().enumerate() {
                let reach = s.reach(side, k);
                maker = if reach > maker.0 { (reach, i) } else { maker };
            }
            let (limit, maker) = maker;
            if !seen.get(maker).is_some_and(|s| s.sigma[c] > 0.0) {
                continue;
            }
            self.near.clear();
            for (i, s) in seen.iter().enumerate().filter(|(i, s)| *i != maker && s.sigma[c] > 0.0) {
                let to_side = limit - sign * s.rough.at[c];
                if to_side < (k + MARGIN) * s.sigma[c] {
                    self.near.push((to_side / s.sigma[c], i));
                }
            }
            let first = self.events.len();
            self.take_event(Event { seen: maker, side, deviations: k, rate: 1.0, tail: level.tail, direction: 0 });
            while self.events.len() < first + MAX_SIDE_POINTS
                && let Some(nearest) =
                    (0..self.near.len()).reduce(|a, b| if self.near[b] < self.near[a] { b } else { a })
            {
                let (deviations, i) = self.near.swap_remove(nearest);
                let s = &seen[i];
                // Points that move together pass together.
                let is_one = |e: &Event| {
                    let (slopes, sigma) = (&seen[e.seen].slopes[c], seen[e.seen].sigma[c]);
                    dot(slopes, &s.slopes[c]) > (1.0 - 1e-6) * s.sigma[c] * sigma
                };
                if !self.events[first..].iter().any(is_one) {
                    let deviations = deviations.max(k);
                    let tail = if deviations == k { level.tail } else { level.tails.tail(deviations) };
                    let rate = seen[maker].sigma[c] / s.sigma[c];
                    self.take_event(Event { seen: i, side, deviations, rate, tail, direction: 0 });
                }
            }
        }
    }

    /// Adds an event and sets its direction.
    fn take_event(&mut self, event: Event) {
        let wanted = (event.seen, event.side.axis);
        let known = self.directions.iter().position(|d| *d == wanted);
        let direction = known.unwrap_or_else(|| {
            self.directions.push(wanted);
            self.directions.len() - 1
        });
        self.events.push(Event { direction, ..event });
    }

    fn take_pairs(&mut self, seen: &[PointDerivatives]) {
        self.pairs.clear();
        for (n, (of, c)) in self.directions.iter().enumerate() {
            let (slopes, sigma) = (&seen[*of].slopes[*c], seen[*of].sigma[*c]);
            for (before, d) in &self.directions[..n] {
                let rho = dot(slopes, &seen[*before].slopes[*d]) / (sigma * seen[*before].sigma[*d]);
                self.pairs.push((rho, apart(rho.abs())));
            }
            self.pairs.push((1.0, 0.0));
        }
    }

    /// Separation of the errors behind two events; `None` if they are opposite or independent.
    #[inline]
    fn apart(&self, a: &Event, b: &Event) -> Option<f64> {
        let (more, less) = (a.direction.max(b.direction), a.direction.min(b.direction));
        let (rho, apart) = self.pairs[more * (more + 1) / 2 + less];
        (a.side.sign * b.side.sign * rho > 0.0).then_some(apart)
    }

    /// Builds the maximum spanning tree of joint tails (Prim).
    fn join(&mut self, tails: &Tails) {
        self.parents.clear();
        self.parents.resize(self.events.len(), Parent { event: 0, apart: -1.0, joint: -1.0, out: true });
        let mut last = 0;
        for _ in 1..self.events.len() {
            self.parents[last].out = false;
            let mut next = usize::MAX;
            let b = self.events[last];
            for i in 0..self.events.len() {
                if !self.parents[i].out {
                    continue;
                }
                let a = &self.events[i];
                // Opposite events almost never coincide.
                if let Some(apart) = self.apart(a, &b) {
                    let (far, less) =
                        if a.deviations > b.deviations { (a.deviations, a.tail) } else { (b.deviations, b.tail) };
                    let joint = less * tails.shared(far, apart);
                    if joint > self.parents[i].joint {
                        self.parents[i] = Parent { event: last, apart, joint, out: true };
                    }
                }
                if next == usize::MAX || self.parents[i].joint > self.parents[next].joint {
                    next = i;
                }
            }
            last = next;
        }
    }

    /// Upper bound on the probability of passing any side at the first number of standard deviations.
    fn passed_first(&self) -> f64 {
        let alone: f64 = self.events.iter().map(|e| e.tail).sum();
        let joint: f64 = self.parents.iter().filter(|p| p.apart >= 0.0).map(|p| p.joint).sum();
        (alone - joint).max(f64::MIN_POSITIVE)
    }

    /// This bound with the common number increased by `more`.
    fn passed(&mut self, more: f64, tails: &Tails) -> f64 {
        self.reach.clear();
        for e in &self.events {
            let deviations = (e.deviations + more * e.rate).max(0.0);
            // All events that set a side have the same deviation.
            let known = self.reach.iter().find(|r| r.0 == deviations).map(|r| r.1);
            self.reach.push((deviations, known.unwrap_or_else(|| tails.tail(deviations))));
        }
        let mut sum = 0.0;
        for (reach, parent) in self.reach.iter().zip(&self.parents) {
            sum += reach.1;
            if parent.apart >= 0.0 {
                let other = self.reach[parent.event];
                let (far, less) = if reach.0 > other.0 { *reach } else { other };
                sum -= less * tails.shared(far, parent.apart);
            }
        }
        sum.max(f64::MIN_POSITIVE)
    }
}
