//! Sums the visible and hidden intervals and shares of one feature over its samples.

use super::VisibilityContext;
use super::windows::Windows;
use crate::sample::{Piece, Sample};
use crate::{HiddenInterval, Reason, VisibleInterval};
use glam::{DVec2, DVec3};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SampleState {
    Seen,
    Hidden(Reason, Option<u32>),
}

/// A hidden part, and the slot of its occluder. The occluder is looked up only when the part is reported.
#[derive(Clone, Copy, Debug)]
pub(super) struct HiddenPart {
    t: [f64; 2],
    pub reason: Reason,
    slot: Option<u32>,
}

impl HiddenPart {
    pub fn interval(&self, frame: &VisibilityContext<'_>) -> HiddenInterval {
        let Self { t, reason, slot } = *self;
        HiddenInterval { t, reason, by: slot.and_then(|slot| frame.occluder(slot)) }
    }
}

/// The intervals and sums of one feature.
#[derive(Default)]
pub(super) struct Tally {
    pub visible: Vec<VisibleInterval>,
    pub hidden: Vec<HiddenPart>,
    /// The state of the previous piece, and the index of its sum.
    last: Option<(SampleState, usize)>,
    /// Weights and numbers of the samples inside the image and limits, and of the visible ones.
    pub inside: [f64; 2],
    pub seen: [f64; 2],
    by_state: Vec<(SampleState, [f64; 2])>,
    pub bounds: Option<[DVec2; 2]>,
    /// The nearest visible sample: its squared range, and its position.
    pub nearest: Option<(f64, DVec3)>,
    pub pixels: Vec<u32>,
    /// The image boxes in which a patch is seen, if regions are requested.
    pub windows: Option<Box<Windows>>,
}

impl Tally {
    pub fn take(&mut self, frame: &VisibilityContext<'_>, piece: &Piece, state: SampleState) {
        match piece {
            Piece::Inside(sample) => {
                self.take_some(state, sample.t, sample.ends, [sample.weight, 1.0]);
                if state == SampleState::Seen {
                    self.see(frame, sample);
                }
            }
            Piece::Outside { t, .. } => self.take_some(state, *t, [DVec2::ZERO; 2], [0.0, 1.0]),
        }
    }

    /// Adds neighbouring samples of one state: their interval of the length, ends in the image, and weight and number.
    pub fn take_some(&mut self, state: SampleState, t: [f64; 2], pixels: [DVec2; 2], more: [f64; 2]) {
        let add = |sum: &mut [f64; 2]| (0..2).for_each(|i| sum[i] += more[i]);
        let goes_on = self.last.is_some_and(|(last, _)| last == state);
        let at = match self.last {
            Some((_, at)) if goes_on => at,
            _ => self.by_state.iter().rposition(|s| s.0 == state).unwrap_or_else(|| {
                self.by_state.push((state, [0.0; 2]));
                self.by_state.len() - 1
            }),
        };
        add(&mut self.by_state[at].1);
        self.last = Some((state, at));
        if !matches!(state, SampleState::Hidden(reason, _) if reason.is_outside()) {
            add(&mut self.inside);
        }
        match state {
            SampleState::Seen => {
                add(&mut self.seen);
                match self.visible.last_mut().filter(|_| goes_on) {
                    Some(v) => (v.t[1], v.pixels[1]) = (t[1], pixels[1]),
                    None => self.visible.push(VisibleInterval { t, pixels }),
                }
            }
            SampleState::Hidden(reason, slot) => match self.hidden.last_mut().filter(|_| goes_on) {
                Some(h) => h.t[1] = t[1],
                None => self.hidden.push(HiddenPart { t, reason, slot }),
            },
        }
    }

    /// Adds weight to the samples inside the image, and to the visible ones.
    pub fn weigh(&mut self, inside: f64, seen: f64) {
        self.inside[0] += inside;
        self.seen[0] += seen;
    }

    /// Appends the next piece of a curve, which takes the interval `[from, to]` of its length.
    pub fn append(&mut self, piece: Self, [from, to]: [f64; 2]) {
        // Neighbouring pieces share a bound exactly.
        let place = |t: f64| if t >= 1.0 { to } else { from + t * (to - from) };
        for v in piece.visible {
            let t = v.t.map(place);
            match self.visible.last_mut().filter(|last| last.t[1] == t[0]) {
                Some(last) => (last.t[1], last.pixels[1]) = (t[1], v.pixels[1]),
                None => self.visible.push(VisibleInterval { t, ..v }),
            }
        }
        for h in piece.hidden {
            let t = h.t.map(place);
            let is_same = |last: &&mut HiddenPart| last.t[1] == t[0] && (last.reason, last.slot) == (h.reason, h.slot);
            match self.hidden.last_mut().filter(is_same) {
                Some(last) => last.t[1] = t[1],
                None => self.hidden.push(HiddenPart { t, ..h }),
            }
        }
        for i in 0..2 {
            self.inside[i] += piece.inside[i];
            self.seen[i] += piece.seen[i];
        }
        if let Some((squared, at)) = piece.nearest.filter(|n| self.nearest.is_none_or(|known| n.0 < known.0)) {
            self.nearest = Some((squared, at));
        }
        self.pixels.extend(piece.pixels);
    }

    /// Adds several samples of a patch, all of the same weight.
    pub fn take_pixels(&mut self, state: SampleState, count: usize) {
        let more = [count as f64; 2];
        let add = |sum: &mut [f64; 2]| (0..2).for_each(|i| sum[i] += more[i]);
        // The most recent state is the most likely one.
        match self.by_state.iter_mut().rev().find(|(known, _)| *known == state) {
            Some((_, sum)) => add(sum),
            None => self.by_state.push((state, more)),
        }
        if !matches!(state, SampleState::Hidden(reason, _) if reason.is_outside()) {
            add(&mut self.inside);
        }
        if state == SampleState::Seen {
            add(&mut self.seen);
        }
    }

    /// Records that everything between two pixels is seen.
    pub fn reach_between(&mut self, from: DVec2, to: DVec2) {
        self.reach(from);
        self.reach(to);
        if let Some(windows) = &mut self.windows {
            windows.reach(from, to);
        }
    }

    /// Records that a pixel is seen.
    fn reach(&mut self, pixel: DVec2) {
        let [low, high] = self.bounds.unwrap_or([pixel, pixel]);
        self.bounds = Some([low.min(pixel), high.max(pixel)]);
    }

    /// Keeps a visible place if it is the nearest so far.
    pub fn see_at(&mut self, at: DVec3) {
        let squared = at.length_squared();
        if self.nearest.is_none_or(|n| squared < n.0) {
            self.nearest = Some((squared, at));
        }
    }

    fn see(&mut self, frame: &VisibilityContext<'_>, sample: &Sample) {
        self.see_at(sample.at);
        let pixel = sample.pixel;
        self.reach_between(pixel, pixel);
        if frame.options.feature_id {
            self.mark(frame, pixel);
        }
    }

    /// Records that the feature shows in a pixel.
    pub fn mark(&mut self, frame: &VisibilityContext<'_>, pixel: DVec2) {
        let (column, row) = frame.sampler.nearest_pixel(pixel);
        let at = (row * i64::from(frame.images.width) + column) as u32;
        if self.pixels.last() != Some(&at) {
            self.pixels.push(at);
        }
    }

    /// Returns true if no part of the feature is seen.
    pub fn is_unseen(&self, is_area: bool) -> bool {
        if is_area { self.bounds.is_none() } else { self.visible.is_empty() }
    }

    /// Shares of a patch's area, as intervals: one for its visible part and one for each pair of a reason and an object
    /// that hides it. The polygon that hides most stands for its object.
    pub fn shares(&self, frame: &VisibilityContext<'_>) -> (Vec<VisibleInterval>, Vec<HiddenPart>) {
        let keyed = |(state, sum): &(SampleState, [f64; 2])| match state {
            SampleState::Seen => ((0, None, None), *sum),
            SampleState::Hidden(reason, slot) => {
                let object = slot.and_then(|slot| frame.environment.locate(slot)).map(|(object, _)| object);
                ((1 + *reason as usize, object, *slot), *sum)
            }
        };
        type Keyed = ((usize, Option<u32>, Option<u32>), [f64; 2]);
        let mut all: Vec<Keyed> = self.by_state.iter().map(keyed).collect();
        all.sort_by_key(|(key, _)| *key);
        let sum = |some: &[Keyed]| some.iter().fold([0.0; 2], |sum, (_, w)| [sum[0] + w[0], sum[1] + w[1]]);
        let whole = sum(&all);
        let (mut visible, mut hidden, mut from, mut left) = (Vec::new(), Vec::new(), 0.0, all.len());
        for some in all.chunk_by(|(a, _), (b, _)| (a.0, a.1) == (b.0, b.1)) {
            left -= some.len();
            let to = if left == 0 { 1.0 } else { (from + share(sum(some), whole)).min(1.0) };
            let t = [from, to];
            let most = some.iter().skip(1).fold(&some[0], |most, s| if s.1[1] > most.1[1] { s } else { most });
            let (reason, _, slot) = most.0;
            match reason.checked_sub(1).map(|reason| Reason::ALL[reason]) {
                None => visible.extend(self.bounds.map(|pixels| VisibleInterval { t, pixels })),
                Some(reason) => hidden.push(HiddenPart { t, reason, slot }),
            }
            from = to;
        }
        (visible, hidden)
    }
}

/// The ratio of the weights, or of the numbers if the weight is 0; 0 without samples.
pub(super) fn share(part: [f64; 2], whole: [f64; 2]) -> f64 {
    let of = |i: usize| (part[i] / whole[i]).min(1.0);
    match whole {
        [weight, _] if weight > 0.0 => of(0),
        [_, count] if count > 0.0 => of(1),
        _ => 0.0,
    }
}
