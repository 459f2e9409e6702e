//! Odds: what is known of a pose after some frames, as the natural logarithm of how much likelier it is than all rivals
//! together. Every decision of the localizer is a comparison of these odds with one of [`ErrorRates`].

use presight_model::statistics::median;

/// Scales that a null remembers.
const POOL: usize = 20;
/// The best wrong places, whose gaps tell the scale.
const BEST: usize = 8;
/// A frame has no more independent parts, and no fewer: surfaces whose readings err together. The bounds are chosen by drives
/// through changed rooms, not derived, and leave the pooled gaps little to say. They are too generous where six numbers are
/// sought: in the room of the drives' tests a pose 3.6 m off led by 7.1 scales once, which an exponential tail has in one of
/// 1,200 frames.
const DEPENDENT: (f64, f64) = (8.0, 7.0);
/// A frame whose evidence differs by more scales from what it was is a new look, however little the robot moved.
const SUDDEN: f64 = 3.0;
/// What a place has to lead by before it counts as singled out once more, natural logarithm: in changed maps right places
/// lead by 5 to 52 scales (5 % and 95 % of them), evenly, so .01 of them for each scale below 5; wrong ones exponentially.
const ASKED: f64 = 4.6;
/// A given start is not asked if the frame has this part of all the evidence that it could have: where all places look
/// alike, as in a corridor, the right one does not lead. Chosen, not derived: a start at another place of such a map that
/// looks the same passes always, whatever the error rates.
const MOSTLY: f64 = 0.8;
/// A fall loses so much of all the evidence that a frame could have: less is lost along the way in a map that is out of
/// date. Chosen, not derived: a robot that is carried to where less is lost is found out by its odds along the way alone.
const HALF: f64 = 0.5;
/// What the best of all wrong places leads by in the mean, scales.
const CHANCE: f64 = 1.0;
/// The mean of evidence forgets by this part a frame.
const FORGET: f64 = 0.2;

/// What wrong places of a map reach in one frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Null {
    /// Evidence of the best of all wrong places; at least that of "nothing of this map", 0.
    pub best: f64,
    /// Of the median of the best ones.
    pub usual: f64,
    /// The scale of the tail: evidence that is worth a factor of e.
    pub scale: f64,
    pool: Vec<f64>,
}

impl Null {
    /// Of distinct wrong places of a frame with so many readings, the best first.
    pub fn new(wrong: &[f64], readings: usize, before: Option<&Self>) -> Self {
        let mut pool = before.map_or_else(Vec::new, |null| null.pool.clone());
        let k = BEST.min(wrong.len() / 2);
        // Of an exponential tail the i-th gap times i has this scale, whatever i: Rényi. The median is not led astray by one
        // place that looks nearly as the robot's does, such as that after half a turn.
        let mut gaps: Vec<f64> = (1..=k).map(|i| i as f64 * (wrong[i - 1] - wrong[i])).collect();
        pool.extend(median(&mut gaps).map(|gap| gap / std::f64::consts::LN_2));
        pool.drain(..pool.len().saturating_sub(POOL));
        let mean = pool.iter().sum::<f64>() / pool.len().max(1) as f64;
        // One standard error more: each of the pool comes from so many exponential numbers.
        let error = 1.0 / ((BEST * pool.len().max(1)) as f64).sqrt();
        let readings = (readings as f64).max(1.0);
        let scale = (mean * (1.0 + error)).clamp(readings / DEPENDENT.0, readings / DEPENDENT.1);
        let at = |k: usize| wrong.get(k).copied().unwrap_or(0.0);
        // Nothing of this map is a rival, too: its evidence is 0.
        Self { best: at(0).max(0.0), usual: at(wrong.len() / 2), scale, pool }
    }

    /// What evidence says for a pose: its lead over the best rival, its lag behind a usual one, or nothing between.
    pub fn odds_of(&self, evidence: f64, rival: f64) -> f64 {
        let rival = rival.max(self.best);
        if evidence > rival { (evidence - rival) / self.scale } else { ((evidence - self.usual) / self.scale).min(0.0) }
    }
}

impl Null {
    /// What a frame says whose readings all decide.
    pub fn said(&self, odds: f64, evidence: f64) -> Said {
        Said { odds, evidence, full: evidence, scale: self.scale, deciding: 1.0, blind: false }
    }
}

/// The errors that are accepted, as probabilities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorRates {
    /// A pose that is called tracked is wrong.
    pub wrong: f64,
    /// A given start is wrong.
    pub wrong_start: f64,
    /// The robot is carried away from one frame to the next.
    pub carried_away: f64,
}

impl Default for ErrorRates {
    fn default() -> Self {
        Self { wrong: 1e-3, wrong_start: 1e-4, carried_away: 1e-6 }
    }
}

impl ErrorRates {
    /// Odds above which a pose is tracked, natural logarithm.
    pub(super) fn tracked(&self) -> f64 {
        -self.wrong.ln()
    }

    /// Odds of a given start.
    pub(super) fn given(&self) -> f64 {
        -self.wrong_start.ln()
    }

    /// Most odds: no number of frames says that the robot was not carried away just now.
    pub(super) fn most(&self) -> f64 {
        -self.carried_away.ln()
    }
}

/// What one frame says of a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Said {
    /// Log-odds; 0 for nothing.
    pub odds: f64,
    /// Against nothing of this map.
    pub evidence: f64,
    /// The evidence if all readings were as predicted.
    pub full: f64,
    /// Of the null.
    pub scale: f64,
    /// Share of the readings that are not before what the map has: those before it tell nothing of the map.
    pub deciding: f64,
    /// No reading could tell anything.
    pub blind: bool,
}

impl Said {
    /// True if the frame singles out the pose, or has most of the evidence that it could have.
    fn proves(&self) -> bool {
        !self.blind && (self.odds >= ASKED || self.evidence >= MOSTLY * self.full)
    }

    /// Of a frame that tells nothing.
    pub const NOTHING: Self = Self { odds: 0.0, evidence: 0.0, full: 0.0, scale: 1.0, deciding: 0.0, blind: true };
}

/// What is known of one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Odds {
    /// By all frames so far.
    pub memory: f64,
    /// With what the latest frame says against the pose.
    pub now: f64,
    /// Usual evidence of a frame.
    mean: Option<f64>,
    /// There was a sudden fall.
    fallen: bool,
    /// No frame singled out the pose so far, and none selected it.
    pub unproven: bool,
    /// Against minima beside the pose; `None` until they were looked for.
    pub beside: Option<f64>,
}

impl Odds {
    /// Odds of a place that is selected by the frame that comes next.
    pub fn of(memory: f64) -> Self {
        Self { memory, now: memory, mean: None, fallen: false, unproven: false, beside: None }
    }

    /// Odds of a start that was given: the frame that comes next is asked in full.
    pub fn given(memory: f64) -> Self {
        Self { unproven: true, ..Self::of(memory) }
    }

    /// True if evidence differs from what it was by more than frames of one view do.
    pub fn is_sudden(&self, frame: &Said) -> bool {
        self.mean.is_none_or(|mean| (frame.evidence - mean).abs() > SUDDEN * frame.scale)
    }

    /// True if there was a sudden fall, and the pose is not certain since.
    pub fn is_lost(&self, rates: &ErrorRates) -> bool {
        self.now < 0.0 || (self.fallen && self.now < rates.tracked())
    }

    /// Takes in what a frame says. Frames of one view say it once: `way` is how much of another view this one is, 0 to 1.
    ///
    /// A sudden fall to where the frame no longer singles out the pose counts in full: evidence that is Δ scales below what
    /// is usual here has a probability of exp(-Δ) if the robot still is here. A pose that is singled out after that counts as
    /// one that is found there.
    pub fn add(&mut self, frame: &Said, way: f64, rates: &ErrorRates) {
        let (most, said, evidence) = (rates.most(), frame.odds, frame.evidence);
        // What stands before the sensor thins what can be expected.
        let lost = self.mean.map_or(0.0, |mean| frame.deciding * mean.max(0.0) - evidence);
        let below = lost / frame.scale;
        if frame.proves() {
            self.unproven = false;
        }
        let falls = !frame.proves() && below > SUDDEN && lost > HALF * frame.deciding * frame.full;
        self.fallen |= falls;
        let counts = match self.mean {
            None if self.unproven && !frame.proves() => said - ASKED,
            None => said,
            Some(_) if falls => said.min(said.max(0.0) - below),
            Some(_) if said > 0.0 && self.unproven => 0.0,
            Some(_) if said > 0.0 => way * (said - CHANCE).max(0.0),
            Some(_) => way * said,
        };
        let mut after = (self.memory + counts).clamp(-most, most);
        if self.fallen && said > ASKED {
            after = after.max(said - ASKED).min(most);
        }
        // What speaks against a pose counts at once, what speaks for it as it is remembered.
        self.now = if falls || said > 0.0 { after } else { self.memory + said.min(counts) };
        self.memory = after;
        if self.now >= rates.tracked() {
            self.fallen = false;
        }
        if frame.blind {
            return;
        }
        let mean = self.mean.filter(|_| !falls).unwrap_or(evidence);
        self.mean = Some(mean + FORGET * (evidence - mean));
    }

    /// Takes in a frame that leads to another place than the motion does. If its evidence is Δ scales below what is usual, more
    /// than frames of one view differ by, what was remembered of the pose says nothing for that place: a wrong one leads by
    /// x scales with a probability of exp(-x), and the right one falls by Δ with one of exp(-Δ).
    pub fn leap(&mut self, frame: &Said, way: f64, rates: &ErrorRates) {
        let below = self.mean.map_or(0.0, |mean| (frame.deciding * mean.max(0.0) - frame.evidence) / frame.scale);
        if below <= SUDDEN {
            return self.add(frame, way, rates);
        }
        let most = rates.most();
        self.now = (frame.odds - below).clamp(-most, most).min(self.memory);
        (self.memory, self.fallen) = (self.now, self.now < rates.tracked());
    }

    /// Takes in what a frame says against minima beside the pose.
    pub fn add_beside(&mut self, said: f64, way: f64, rates: &ErrorRates) {
        let before = self.beside.unwrap_or(0.0);
        let part = if before == 0.0 { 1.0 } else { way };
        self.beside = Some((before + part * said).min(rates.most()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame with a scale of 10, of which all readings decide.
    fn said(odds: f64, evidence: f64) -> Said {
        Said { odds, evidence, full: 200.0, scale: 10.0, deciding: 1.0, blind: false }
    }

    /// By hand: frames with an evidence of 190 are usual. Another place with 80 is 11 scales below that, and leads by 7: -4. Along
    /// the way the same frame is no fall, because it singles out the pose. A place with 170 is as usual, and memory stays.
    #[test]
    fn a_place_that_the_motion_does_not_lead_to_has_to_be_as_good_as_usual() {
        let rates = ErrorRates::default();
        let mut odds = Odds::given(rates.given());
        odds.add(&said(18.0, 190.0), 0.1, &rates);
        assert!((odds.now - rates.most()).abs() < 1e-9, "{}", odds.now);
        let (mut there, mut here, mut usual) = (odds, odds, odds);
        there.leap(&said(7.0, 80.0), 0.1, &rates);
        assert!((there.now + 4.0).abs() < 1e-9 && there.is_lost(&rates), "{}", there.now);
        here.add(&said(7.0, 80.0), 0.1, &rates);
        assert!(here.now > rates.tracked() && !here.is_lost(&rates), "{}", here.now);
        usual.leap(&said(0.0, 170.0), 0.1, &rates);
        assert!((usual.now - rates.most()).abs() < 1e-9, "{}", usual.now);
    }

    /// By hand: wrong places at 100, 90, 80, .. have gaps of 10, times i 10, 20, 30, .., 40 at the median of eight: 45. Over
    /// ln 2 that is 65, one standard error more is 88: at 360 readings at most 360 / 7 = 51.
    #[test]
    fn the_scale_is_that_of_an_exponential_tail_within_bounds() {
        let wrong: Vec<f64> = (0..17).map(|k| 100.0 - 10.0 * f64::from(k)).collect();
        let null = Null::new(&wrong, 360, None);
        assert!((null.scale - 360.0 / 7.0).abs() < 1e-9, "{}", null.scale);
        assert!((null.best - 100.0).abs() < 1e-9 && (null.usual - 20.0).abs() < 1e-9, "{null:?}");
        assert!((null.odds_of(200.0, f64::NEG_INFINITY) - 100.0 / null.scale).abs() < 1e-9);
        assert_eq!(null.odds_of(60.0, f64::NEG_INFINITY), 0.0);
        assert!(null.odds_of(10.0, f64::NEG_INFINITY) < 0.0);
    }
}
