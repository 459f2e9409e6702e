//! Odds of a pose after some frames: the natural logarithm of the ratio of its probability to that of all rivals together. Every decision of the localizer is a comparison of these odds with one of [`ErrorRates`].

use glam::DVec3;
use presight_model::statistics::median;
use std::collections::BTreeMap;

/// Scales that a null remembers.
const POOL: usize = 20;
/// The best wrong places, whose gaps determine the scale.
const BEST: usize = 8;
/// A frame has no more independent parts, and no fewer: surfaces whose readings err together. The bounds are chosen by drives
/// through changed rooms, not derived, and leave the pooled gaps little to say. Their error rate was counted for level scanners
/// (`cargo bench --bench localize -- leads 40`): none of 80 scans of another building leads by more than 3, where an
/// exponential tail has 4, and their 95 % quantiles are 1.1 and 1.4, where it has 3.0. Cameras have fewer rivals: a pose 3.6 m
/// off led by 7.1 scales once.
const DEPENDENT: (f64, f64) = (8.0, 7.0);
/// A frame whose evidence changes by more scales is a new view, however little the robot moved.
const SUDDEN: f64 = 3.0;
/// What a place has to lead by before it counts as singled out once more, natural logarithm: a wrong place does by chance in
/// one of 100 frames. Right places of two buildings with 15 % gone and 15 % moved led by more in 78 of 80 scans, with 40 %
/// and 40 % in 57 of 80.
pub(super) const ASKED: f64 = 4.6;
/// A wrong place that nobody selected is better than the best of 192 rivals, the fewest there are, with a probability of 1 in
/// 193; natural logarithm.
const UNSELECTED: f64 = 5.26;
/// What the best of all wrong places leads by in the mean, scales.
pub(super) const CHANCE: f64 = 1.0;
/// The mean of evidence forgets by this part a frame.
const FORGET: f64 = 0.2;

/// What wrong places of a map reach in one frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Null {
    /// Evidence of the best of all wrong places; at least that of "nothing of this map", 0.
    pub best: f64,
    /// Where the best of them is; `None` for "nothing of this map", or if that was not looked at.
    pub best_at: Option<DVec3>,
    /// Evidence of the median of the best ones.
    pub usual: f64,
    /// The scale of the tail: evidence that is worth a factor of e.
    pub scale: f64,
    pool: Vec<f64>,
}

impl Null {
    /// Null of a frame with this number of readings, from distinct wrong places, the best first.
    pub fn new(wrong: &[f64], readings: usize, before: Option<&Self>) -> Self {
        let mut pool = before.map_or_else(Vec::new, |null| null.pool.clone());
        let k = BEST.min(wrong.len() / 2);
        // The i-th gap of an exponential tail times i has this scale, whatever i: Rényi. The median is not led astray by one
        // place that looks nearly as the robot's does, such as that after half a turn.
        let mut gaps: Vec<f64> = (1..=k).map(|i| i as f64 * (wrong[i - 1] - wrong[i])).collect();
        pool.extend(median(&mut gaps).map(|gap| gap / std::f64::consts::LN_2));
        pool.drain(..pool.len().saturating_sub(POOL));
        let mean = pool.iter().sum::<f64>() / pool.len().max(1) as f64;
        // One standard error more: each of the pool comes from `BEST` exponential numbers.
        let error = 1.0 / ((BEST * pool.len().max(1)) as f64).sqrt();
        let readings = (readings as f64).max(1.0);
        let scale = (mean * (1.0 + error)).clamp(readings / DEPENDENT.0, readings / DEPENDENT.1);
        let at = |k: usize| wrong.get(k).copied().unwrap_or(0.0);
        // Nothing of this map is a rival, too: its evidence is 0.
        Self { best: at(0).max(0.0), best_at: None, usual: at(wrong.len() / 2), scale, pool }
    }

    /// What evidence says for a pose: its lead over the best rival, its lag behind a usual one, or nothing between.
    pub fn odds_of(&self, evidence: f64, rival: f64) -> f64 {
        let rival = rival.max(self.best);
        if evidence > rival { (evidence - rival) / self.scale } else { ((evidence - self.usual) / self.scale).min(0.0) }
    }
}

impl Null {
    /// What a frame says of a place, compared with this rival, too, if all of its readings decide.
    pub fn said(&self, details: Details, rival: f64) -> Said {
        let Details { evidence, full, pieces } = details;
        let (odds, rival) = (self.odds_of(evidence, rival), self.best.max(rival));
        Said {
            odds,
            evidence,
            full,
            rival,
            rival_at: self.best_at,
            scale: self.scale,
            deciding: 1.0,
            blind: false,
            pieces,
        }
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

/// A piece of the map's surfaces: a cube of [`PIECE`].
pub(super) type Piece = [i32; 3];
/// Side of a piece of the map's surfaces, metres: readings of one piece of furniture, or of one part of a wall, err together.
const PIECE: f64 = 0.5;
/// Where the cubes begin, metres: walls and scanners stand at round figures, and rounding must not move them from one cube to
/// the next.
const BEGIN: f64 = 0.1927;

/// The piece at a point of the map, metres.
pub(super) fn piece_at(point: DVec3) -> Piece {
    point.to_array().map(|x| ((x - BEGIN) / PIECE).floor() as i32)
}

/// What the readings of a frame say of a place.
#[derive(Clone, Debug)]
pub(super) struct Details {
    /// Against nothing of this map.
    pub evidence: f64,
    /// The evidence if all readings were as predicted.
    pub full: f64,
    /// The piece of the map that each reading should meet, and its evidence.
    pub pieces: Vec<(Piece, f64)>,
}

/// What one frame says of a pose.
#[derive(Clone, Debug)]
pub(super) struct Said {
    /// Log-odds; 0 for nothing.
    pub odds: f64,
    /// Against nothing of this map.
    pub evidence: f64,
    /// The evidence if all readings were as predicted.
    pub full: f64,
    /// Evidence of the best rival.
    pub rival: f64,
    /// Where it is, in the map, if it is a place.
    pub rival_at: Option<DVec3>,
    /// Scale of the null.
    pub scale: f64,
    /// Share of the readings that are not before the map's surfaces: readings before them say nothing about the map.
    pub deciding: f64,
    /// No reading has evidence.
    pub blind: bool,
    /// What each reading should meet in the map, and its evidence; empty if that is not known.
    pub pieces: Vec<(Piece, f64)>,
}

impl Said {
    /// True if the frame singles out the pose.
    pub fn singles_out(&self) -> bool {
        !self.blind && self.odds >= ASKED
    }

    /// True if the frame has nearly all the evidence that it could have: in a corridor all places look alike, and the right
    /// one does not lead. What x scales are missing of has a probability of exp(-x) if the start is right; after that a start
    /// with these odds is still tracked.
    pub fn is_whole(&self, rates: &ErrorRates) -> bool {
        let missing = (self.full - self.evidence) / self.scale;
        !self.blind && self.evidence > 0.0 && missing <= rates.given() - rates.tracked()
    }

    /// A frame without evidence.
    pub const NOTHING: Self = Self {
        odds: 0.0,
        evidence: 0.0,
        full: 0.0,
        rival: 0.0,
        rival_at: None,
        scale: 1.0,
        deciding: 0.0,
        blind: true,
        pieces: Vec::new(),
    };
}

/// Odds of one pose.
#[derive(Clone, Debug)]
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
    /// How many different views there were: in each a wrong place may lead by chance.
    views: f64,
    /// Pieces of the map that were seen, and the most readings of one frame that met them.
    seen: BTreeMap<Piece, u32>,
    /// The sum of the news so far less its highest value, 0 or less.
    owed: f64,
}

impl Odds {
    /// Odds of a place that is selected by the frame that comes next, after some views in which others were.
    pub fn of(memory: f64, views: f64) -> Self {
        Self {
            memory,
            now: memory,
            mean: None,
            fallen: false,
            unproven: false,
            views,
            seen: BTreeMap::new(),
            owed: 0.0,
        }
    }

    /// Odds of a start that was given: its first frame costs [`ASKED`], and the start waits, until one singles it out.
    pub fn given(memory: f64) -> Self {
        Self { unproven: true, ..Self::of(memory, 0.0) }
    }

    /// True if evidence changes by more than frames of one view differ.
    pub fn is_sudden(&self, frame: &Said) -> bool {
        self.mean.is_none_or(|mean| (frame.evidence - mean).abs() > SUDDEN * frame.scale)
    }

    /// True if there was a sudden fall, and the pose is not certain since.
    pub fn is_lost(&self, rates: &ErrorRates) -> bool {
        self.now < 0.0 || (self.fallen && self.now < rates.tracked())
    }

    /// Takes in what a frame says. Frames of one view say it once: `way` is how much of another view this one is, 0 to 1. If a
    /// place lacks evidence that it could have, each piece of the map says it once ([`Odds::news`]): a wrong place that resembles
    /// the right one goes on resembling it until the robot sees something else. The frame by itself counts if it says more, less
    /// the chance that another view gave a wrong place.
    ///
    /// A sudden fall to where the frame no longer singles out the pose counts in full: evidence that is Δ scales below what
    /// is usual here has a probability of exp(-Δ) if the robot still is here. If the robot is elsewhere, the pose leads by x
    /// with one of exp(-x) at a place that was selected, and this one was not ([`UNSELECTED`]). A pose that is singled out after
    /// that counts as one that is found there.
    pub fn add(&mut self, frame: &Said, way: f64, rates: &ErrorRates) {
        let (most, said, evidence) = (rates.most(), frame.odds, frame.evidence);
        let is_whole = frame.is_whole(rates);
        let (fresh, news) = self.news(frame);
        // What only resembles the map goes on resembling it.
        let (fresh, news) = if is_whole || frame.pieces.is_empty() { (way, way * evidence) } else { (fresh, news) };
        self.views += fresh;
        let chances = self.views.max(1.0).ln();
        // What stands before the sensor thins what can be expected.
        let lost = self.mean.map_or(0.0, |mean| frame.deciding * mean.max(0.0) - evidence);
        let below = lost / frame.scale;
        let proves = frame.singles_out() || is_whole;
        self.unproven &= !proves;
        // A smaller fall leaves a pose tracked that was certain.
        let falls = !proves && below > most - rates.tracked();
        let counts = match self.mean {
            None if self.unproven => said - ASKED,
            None => said,
            Some(_) if falls && said > 0.0 => said.min(UNSELECTED + said - below),
            Some(_) if falls => said.min(-below),
            Some(_) if said > 0.0 && self.unproven => 0.0,
            Some(_) if said > 0.0 => self.gain(frame, fresh, news),
            Some(_) => fresh * said,
        };
        let mut after = (self.memory + counts).clamp(-most, most);
        if self.fallen && said > ASKED {
            after = after.max(said - ASKED).min(most);
        } else if !self.fallen && !self.unproven && self.mean.is_some() && after > 0.0 {
            after = after.max((said - chances).min(most));
        }
        // Evidence against a pose counts at once, until a frame speaks for the pose again.
        self.now = if falls || said > 0.0 { after } else { self.now.min(self.memory + said.min(counts)) };
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

    /// The share of a frame's readings that show more of the map's pieces than any frame before, and their evidence: a piece
    /// that one beam met from afar is new to the ten beams that meet it from nearby. These readings did not take part when the
    /// place was selected, so they are an unbiased test of it.
    fn news(&mut self, frame: &Said) -> (f64, f64) {
        let mut met: BTreeMap<Piece, (u32, f64)> = BTreeMap::new();
        for (piece, log) in &frame.pieces {
            let (count, sum) = met.entry(*piece).or_default();
            (*count, *sum) = (*count + 1, *sum + log);
        }
        let (mut more, mut evidence) = (0.0, 0.0);
        for (piece, (count, sum)) in met {
            let before = self.seen.entry(piece).or_default();
            let new = f64::from(count.saturating_sub(*before));
            (more, evidence) = (more + new, evidence + sum * new / f64::from(count));
            *before = count.max(*before);
        }
        (more / frame.pieces.len().max(1) as f64, evidence)
    }

    /// What the new part of a frame adds to a place that leads: its own lead over as much of the best rival. It is the logarithm of a
    /// likelihood ratio, so at a wrong place the highest that its sum ever reaches exceeds x with a probability of at most exp(-x)
    /// (Ville, 1939): memory keeps the highest value, and `owed` the distance below it.
    fn gain(&mut self, frame: &Said, fresh: f64, news: f64) -> f64 {
        let sum = self.owed + (news - fresh * frame.rival) / frame.scale - fresh * CHANCE;
        self.owed = sum.min(0.0);
        sum.max(0.0)
    }

    /// Takes in a frame that leads to another place than the motion does. If its evidence is Δ scales below the usual one, more
    /// than frames of one view differ by, the memory of the pose says nothing for that place: a wrong one leads by
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
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame with a scale of 10. All of its readings decide.
    fn said(odds: f64, evidence: f64) -> Said {
        Said {
            odds,
            evidence,
            full: 200.0,
            rival: evidence - 10.0 * odds,
            rival_at: None,
            scale: 10.0,
            deciding: 1.0,
            blind: false,
            pieces: Vec::new(),
        }
    }

    /// By hand: frames with an evidence of 190 are usual. Another place with 80 is 11 scales below that, and leads by 7: -4. Along
    /// the way the same frame does not count as a fall, because it singles out the pose. A place with 170 is usual, and memory stays.
    #[test]
    fn a_place_that_the_motion_does_not_lead_to_has_to_be_as_good_as_usual() {
        let rates = ErrorRates::default();
        let mut odds = Odds::given(rates.given());
        odds.add(&said(18.0, 190.0), 0.1, &rates);
        assert!((odds.now - rates.most()).abs() < 1e-9, "{}", odds.now);
        let (mut there, mut here, mut usual) = (odds.clone(), odds.clone(), odds);
        there.leap(&said(7.0, 80.0), 0.1, &rates);
        assert!((there.now + 4.0).abs() < 1e-9 && there.is_lost(&rates), "{}", there.now);
        here.add(&said(7.0, 80.0), 0.1, &rates);
        assert!(here.now > rates.tracked() && !here.is_lost(&rates), "{}", here.now);
        usual.leap(&said(0.0, 170.0), 0.1, &rates);
        assert!((usual.now - rates.most()).abs() < 1e-9, "{}", usual.now);
    }

    /// Readings of these pieces, which share an evidence evenly.
    fn seen(odds: f64, evidence: f64, pieces: &[i32]) -> Said {
        let share = evidence / pieces.len() as f64;
        Said { pieces: pieces.iter().map(|k| ([*k; 3], share)).collect(), ..said(odds, evidence) }
    }

    /// By hand: a place with 150 of 200 (5 scales less than all it could have) is found with a lead of 4, and four frames of the
    /// same four pieces lead by 4 again: it stays at 4, because they add nothing new. A frame that sees one other piece of four
    /// adds (4 - 1) / 4. One that leads by 9 counts as 9, less ln(1.25) for the views so far. Frames whose pieces are not known
    /// add 3 for each metre, and so do frames with all of their evidence.
    #[test]
    fn each_piece_of_the_map_says_it_once() {
        let rates = ErrorRates::default();
        let mut odds = Odds::of(0.0, 0.0);
        (0..5).for_each(|_| odds.add(&seen(4.0, 150.0, &[0, 1, 2, 3]), 1.0, &rates));
        assert!((odds.now - 4.0).abs() < 1e-9, "{}", odds.now);
        odds.add(&seen(4.0, 150.0, &[0, 1, 2, 4]), 1.0, &rates);
        assert!((odds.now - 4.75).abs() < 1e-9, "{}", odds.now);
        let (mut unknown, mut whole) = (odds.clone(), odds.clone());
        whole.add(&seen(4.0, 190.0, &[0, 1, 2, 3]), 1.0, &rates);
        assert!((whole.now - 7.75).abs() < 1e-9, "{}", whole.now);
        odds.add(&seen(9.0, 150.0, &[0, 1, 2, 3]), 1.0, &rates);
        assert!((odds.now - (9.0 - 1.25f64.ln())).abs() < 1e-9, "{}", odds.now);
        unknown.add(&said(4.0, 150.0), 1.0, &rates);
        assert!((unknown.now - 7.75).abs() < 1e-9, "{}", unknown.now);
    }

    /// By hand: piece 1 is met by one of four readings, and by three of four from nearby: two of four are new, and lead by as much
    /// as all, so they add (4 - 1) / 2. From as near again they add nothing.
    #[test]
    fn a_piece_that_is_seen_from_nearer_is_news() {
        let rates = ErrorRates::default();
        let mut odds = Odds::of(0.0, 0.0);
        odds.add(&seen(4.0, 150.0, &[0, 0, 0, 1]), 1.0, &rates);
        (0..2).for_each(|_| odds.add(&seen(4.0, 150.0, &[0, 1, 1, 1]), 1.0, &rates));
        assert!((odds.now - 5.5).abs() < 1e-9, "{}", odds.now);
    }

    /// By hand: a place leads by 4 of its scales, which was selected by three quarters of each frame. A new quarter
    /// without evidence lacks the rival's 110 / 4, which is 2.75 scales, and the 1 / 4 that chance leads by: 3 are owed. The
    /// place stays at 4 for the next four quarters that are as the others are, each worth 3 / 4, and is at 4.75 with the fifth.
    #[test]
    fn what_comes_into_view_tests_a_place() {
        let rates = ErrorRates::default();
        let mut odds = Odds::of(0.0, 0.0);
        odds.add(&seen(4.0, 150.0, &[0, 1, 2, 3]), 1.0, &rates);
        let mut wrong = seen(4.0, 150.0, &[0, 1, 2, 4]);
        wrong.pieces[3].1 = 0.0;
        odds.add(&wrong, 1.0, &rates);
        for (k, left) in (5..).zip([4.0, 4.0, 4.0, 4.0, 4.75]) {
            odds.add(&seen(4.0, 150.0, &[0, 1, 2, k]), 1.0, &rates);
            assert!((odds.now - left).abs() < 1e-9, "{k}: {}", odds.now);
        }
    }

    /// Walls and scanners stand at multiples of 5 cm: rounding does not move them to another piece.
    #[test]
    fn rounding_moves_no_wall_to_another_piece() {
        for k in -400..400 {
            let at = DVec3::splat(0.05 * f64::from(k));
            assert_eq!(piece_at(at - DVec3::splat(1e-5)), piece_at(at + DVec3::splat(1e-5)), "{at}");
        }
        assert_eq!(piece_at(DVec3::new(0.2, 0.65, 0.7)), [0, 0, 1]);
    }

    /// By hand: a frame that lags by 9 scales behind the usual places makes a pose doubtful (13.8 - 9 = 4.8), and frames that say
    /// nothing leave it so. A frame that leads again ends the doubt.
    #[test]
    fn a_doubt_lasts_until_a_frame_speaks_for_the_pose() {
        let rates = ErrorRates::default();
        let mut odds = Odds::of(rates.most(), 0.0);
        odds.add(&said(20.0, 60.0), 0.0, &rates);
        odds.add(&said(-9.0, 60.0), 0.0, &rates);
        assert!((odds.now - (rates.most() - 9.0)).abs() < 1e-9, "{}", odds.now);
        (0..3).for_each(|_| odds.add(&said(0.0, 60.0), 0.0, &rates));
        assert!(odds.now < rates.tracked(), "{}", odds.now);
        odds.add(&said(5.0, 60.0), 0.0, &rates);
        assert!((odds.now - rates.most()).abs() < 1e-9, "{}", odds.now);
    }

    /// By hand: a start of 10^4 is tracked while its frame lacks at most 9.2 - 6.9 = 2.3 scales of all its evidence, if it does not
    /// lead: 23 of 200. With 24 it costs 4.6 and waits, as does one that leads by 3.
    #[test]
    fn a_given_start_is_kept_where_nothing_is_singled_out() {
        let rates = ErrorRates::default();
        for (lead, evidence, left, proven) in
            [(0.0, 177.0, 9.21, true), (0.0, 176.0, 4.61, false), (3.0, 100.0, 7.61, false), (5.0, 100.0, 13.8, true)]
        {
            let mut odds = Odds::given(rates.given());
            odds.add(&said(lead, evidence), 0.0, &rates);
            assert!((odds.now - left).abs() < 0.02 && odds.unproven != proven, "{evidence}: {}", odds.now);
        }
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
