//! Follows all features of an image.

use super::adapt::{Adaptation, FrameInnovations};
use super::border::{is_within, place, stay_within};
use super::common::CommonMotion;
use super::health::{Health, PredictionTrigger, spread};
use super::lend::{known_speeds, lend_speeds};
use super::motion::PointMotion;
use super::options::TrackerOptions;
use super::outcome::{End, Match, MatchOutcome, SeedOutcome, Window};
use super::sightings::{Motions, Pairing, Sightings, squares};
use super::track::{Seed, Track};
use super::unaided::{MOST_UNAIDED, UnaidedSquares};
use super::window::BoxLevel;
use crate::matching::{
    Assignment, Candidates, Detection, ExpectedFeature, Matcher, assign, floored, unwrap, withhold_doubtful,
};
use glam::{DMat2, DVec2, DVec3};
use presight_model::error::{Error, Result};

/// Largest number of tracks at a time.
pub const MAX_TRACKS: usize = 1 << 16;
/// Largest number of detections in a frame.
pub const MAX_DETECTIONS: usize = 1 << 20;

/// Limit on the innovation of a sliding end along its segment, standard deviations.
const SLIDES: f64 = 2.0;
/// A track's motion has changed if its mean squared innovation exceeds this. The second limits the resulting inflation.
const OWN: f64 = 4.0;
const MOST_OWN: f64 = 8.0;
/// Weight of one frame in that mean.
const OWN_RATE: f64 = 0.3;
/// Factor per frame by which the variance of a changed acceleration fades.
const FADE: f64 = 0.1;
/// Limit on the predicted variance that the inflation of one track multiplies, in units of the detection variance.
const WIDE: f64 = 1.0;
/// Limit on the detections of one window that count as clutter.
const MOST_CLUTTER: u32 = 16;
/// A track must have been seen in this many frames before its speed is lent to new tracks.
pub(super) const OLD_ENOUGH: u32 = 5;

/// Follows features from frame to frame.
#[derive(Clone, Debug)]
pub struct Tracker {
    options: TrackerOptions,
    level: BoxLevel,
    /// First the followed tracks, then the waiting ones, both by number.
    tracks: Vec<Track>,
    noise: Adaptation,
    common: CommonMotion,
    /// Time of the last frame or seeding, seconds.
    time: Option<f64>,
    /// True once detections of that time have corrected the tracks.
    is_corrected: bool,
    /// Seconds from the last frame to a seeding after it.
    before_seeding: f64,
    /// Number of tracks after the last seeding.
    seeded: usize,
    has_gap: bool,
}

impl Tracker {
    /// A tracker without tracks.
    ///
    /// # Errors
    /// The errors of [`TrackerOptions::check`].
    pub fn new(options: TrackerOptions) -> Result<Self> {
        options.check()?;
        let level = BoxLevel::new(options.confidence);
        let noise = Adaptation::new(&level, options.clutter_density, options.detection_probability);
        Ok(Self {
            options,
            level,
            tracks: Vec::new(),
            noise,
            common: CommonMotion::still(),
            time: None,
            is_corrected: false,
            before_seeding: 0.0,
            seeded: 0,
            has_gap: false,
        })
    }

    /// The options of this tracker.
    pub fn options(&self) -> &TrackerOptions {
        &self.options
    }

    /// The tracks, sorted by number.
    pub fn tracks(&self) -> &[Track] {
        &self.tracks[..self.tracks.partition_point(|t| t.waits.is_none())]
    }

    /// Time of the last seeding or correction, seconds.
    pub fn time(&self) -> Option<f64> {
        self.time
    }

    /// Takes over the features of a full prediction for `time` (seconds). A track goes on if its feature is predicted
    /// near its position. All other predicted features start new tracks, and tracks without a predicted feature end. Of
    /// features that lie in each other's windows and have like properties only one is followed; the others wait.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for a time that is not finite or is before the last time, for two seeds
    /// with one number, and for more than [`MAX_TRACKS`] seeds.
    pub fn seed(&mut self, time: f64, mut seeds: Vec<Seed>) -> Result<SeedOutcome> {
        let interval = self.interval(time)?;
        if seeds.len() > MAX_TRACKS {
            let what = format!("{} features are more than {MAX_TRACKS}", seeds.len());
            return Err(Error::invalid(what, "give the most important ones"));
        }
        seeds.sort_by_key(|s| s.id);
        if let Some(pair) = seeds.windows(2).find(|pair| pair[0].id == pair[1].id) {
            return Err(Error::invalid(
                format!("feature {} is given twice", pair[0].id),
                "give each a number of its own",
            ));
        }
        let mut done = SeedOutcome::default();
        if interval > self.options.longest_gap {
            self.end_all(End::Gap, &mut done.ended);
        }
        if interval > 0.0 {
            let moved = self.propagated(interval);
            self.pass_unaided(interval);
            self.take_over(&moved, interval);
            self.common = moved.common;
        }
        let mut old = std::mem::take(&mut self.tracks);
        old.sort_by_key(|t| t.id);
        let mut old = old.into_iter().peekable();
        let mut tracks: Vec<Track> = Vec::with_capacity(seeds.len());
        let mut begun = Vec::new();
        for seed in seeds {
            while let Some(gone) = old.next_if(|t| t.id < seed.id) {
                done.ended.extend(gone.waits.is_none().then_some((gone.id, End::NotPredicted)));
            }
            let known = old.next_if(|t| t.id == seed.id);
            if let Err(why) = seed.check() {
                done.ended.extend(known.filter(|t| t.waits.is_none()).map(|t| (t.id, End::NotPredicted)));
                done.refused.push((seed.id, why));
                continue;
            }
            match known.filter(|track| self.agrees(track, &seed)) {
                Some(mut track) => {
                    track.flow.points_world.clone_from(&seed.points_world);
                    done.kept.extend(track.waits.is_none().then_some(seed.id));
                    tracks.push(track);
                }
                None => {
                    begun.push(tracks.len());
                    tracks.push(Track::new(seed, &self.options));
                }
            }
        }
        done.ended.extend(old.filter(|t| t.waits.is_none()).map(|t| (t.id, End::NotPredicted)));
        self.tracks = tracks;
        let known = known_speeds(&self.tracks, &begun);
        lend_speeds(&mut self.tracks, &begun, &known, &self.options);
        done.begun = self.follow_distinguishable();
        self.seeded = self.tracks().len();
        done.waiting = self.tracks[self.seeded..].iter().map(|t| t.id).collect();
        self.before_seeding += interval;
        (self.time, self.is_corrected, self.has_gap) = (Some(time), self.is_corrected && interval == 0.0, false);
        Ok(done)
    }

    /// Sets the view of the next frame: `project` maps a point in the world (metres) to its pixel (column, row).
    /// For features with known world points, the resulting flow is removed and only the remaining motion is tracked.
    pub fn set_view(&mut self, project: impl Fn(DVec3) -> Option<DVec2>) {
        for track in &mut self.tracks {
            let points = track.flow.points_world.iter().map(|p| project(*p).filter(|p| p.is_finite()));
            track.flow.next = points.collect::<Option<Vec<_>>>().unwrap_or_default();
        }
    }

    /// Predicts the windows of all tracked features at `time` (seconds). Features outside the image are omitted.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for a time that is not finite or not after the last frame.
    pub fn predict(&self, time: f64) -> Result<Vec<Window>> {
        let interval = self.frame_interval(time)?;
        if interval > self.options.longest_gap {
            return Ok(Vec::new());
        }
        let moved = self.propagated(interval);
        let mut windows = Vec::with_capacity(self.tracks().len());
        for (row, track) in self.tracks().iter().enumerate() {
            let expected = self.expected(track, moved.of(row), &moved.common);
            if let Some(bounds) = self.clip(expected.window) {
                let noise = track.detection * self.noise.scale;
                let covariances = expected.covariances.iter().map(|c| *c + noise).collect();
                windows.push(Window { id: track.id, shape: expected.shape, covariances, bounds });
            }
        }
        Ok(windows)
    }

    /// Corrects the tracks by the detections of a frame.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for a time that is not finite or not after the last frame, and for more
    /// than [`MAX_DETECTIONS`] detections. The tracks are then unchanged.
    pub fn correct(&mut self, time: f64, found: &[Detection]) -> Result<MatchOutcome> {
        let interval = self.frame_interval(time)?;
        if found.len() > MAX_DETECTIONS {
            let what = format!("{} detections are more than {MAX_DETECTIONS}", found.len());
            return Err(Error::invalid(what, "extract in the windows only"));
        }
        let mut matches = MatchOutcome::default();
        if interval > self.options.longest_gap {
            self.has_gap |= !self.tracks.is_empty();
            self.end_all(End::Gap, &mut matches.ended);
        }
        let elapsed = interval + std::mem::take(&mut self.before_seeding);
        if elapsed > 0.0 && elapsed <= self.options.longest_gap {
            self.noise.pass(elapsed);
        }
        let mut pairing = self.pair(interval, found)?;
        if self.lend_to_doubtful(&pairing, interval, found) {
            pairing = self.pair(interval, found)?;
        }
        let Pairing { mut moved, expected, candidates, assignment, doubtful } = pairing;
        let mut seen = Sightings::new(&expected, found, &assignment, &self.options);
        let witnesses = seen.witnesses(&self.tracks, &moved, self.noise.scale);
        if elapsed > 0.0
            && let Some(common) = moved.common.give_up(&witnesses)
        {
            moved.points.iter_mut().for_each(|m| m.add(&common));
        }
        let shift = moved.common.correct(&witnesses, elapsed);
        seen.points.iter_mut().for_each(|p| p.innovation -= shift);
        self.adapt(elapsed, &expected, &candidates, &seen, &doubtful, &mut moved);
        self.take_over(&moved, interval);
        self.take_in(&seen, found, &assignment, moved.common);
        self.report(&candidates, &assignment, found.len(), &mut matches);
        self.end_tracks(&mut matches);
        matches.begun = self.follow_distinguishable();
        (self.time, self.is_corrected) = (Some(time), true);
        Ok(matches)
    }

    /// Predicts all tracks and assigns detections to them.
    fn pair(&self, interval: f64, found: &[Detection]) -> Result<Pairing> {
        let moved = self.propagated(interval);
        let expected: Vec<ExpectedFeature> = (self.tracks.iter().enumerate())
            .map(|(row, track)| self.expected(track, moved.of(row), &moved.common))
            .collect();
        let matcher = self.matcher();
        let candidates = matcher.candidates(&expected, found);
        let unseen = matcher.unseen_cost();
        let mut assignment = assign(&candidates.pairs, &vec![unseen; expected.len()])?;
        let doubtful = withhold_doubtful(&candidates.pairs, unseen, self.options.confidence, &mut assignment);
        Ok(Pairing { moved, expected, candidates, assignment, doubtful })
    }

    /// Takes the unknown speed of new tracks with a doubtful detection from the certain detections nearby. Returns true if
    /// that changed one.
    fn lend_to_doubtful(&mut self, pairing: &Pairing, interval: f64, found: &[Detection]) -> bool {
        let is_new = |row: &usize| {
            let track = &self.tracks[*row];
            track.seen <= 1 && track.misses == 0 && track.flow.next.is_empty()
        };
        let new: Vec<usize> = pairing.doubtful.iter().copied().filter(is_new).collect();
        if new.is_empty() || interval <= 0.0 {
            return false;
        }
        let shared = pairing.moved.common.displacement();
        let speed = |(row, column): (usize, &Option<u32>)| {
            let (from, to) = (self.tracks[row].shape.centre(), found[(*column)? as usize].shape.centre());
            let shift = to - from + DVec2::new(unwrap(self.options.image.turn, from.x, to.x), 0.0);
            Some((from, (shift - shared) / interval))
        };
        let known: Vec<(DVec2, DVec2)> = pairing.assignment.columns.iter().enumerate().filter_map(speed).collect();
        lend_speeds(&mut self.tracks, &new, &known, &self.options)
    }

    /// Reports how well the tracks cover the image, and whether a full prediction is needed.
    pub fn health(&self) -> Health {
        let spread = spread(self.tracks(), &self.options.image);
        let followed = self.tracks().len();
        let share = followed as f64 / self.seeded.max(1) as f64;
        let wants = if self.has_gap {
            Some(PredictionTrigger::Gap)
        } else if self.time.is_none() {
            Some(PredictionTrigger::Start)
        } else if followed < self.options.least_tracks {
            Some(PredictionTrigger::TooFew)
        } else if spread < self.options.least_spread {
            Some(PredictionTrigger::BadlySpread)
        } else if share < self.options.least_share {
            Some(PredictionTrigger::Thinned)
        } else {
            None
        };
        Health { tracks: followed, spread, share, noise_scale: self.noise.scale, wants }
    }

    fn interval(&self, time: f64) -> Result<f64> {
        if !(time.is_finite() && time.abs() <= 1e15) {
            return Err(Error::invalid(format!("the time stamp {time} is not a valid time"), "give seconds"));
        }
        let interval = self.time.map_or(0.0, |last| time - last);
        if interval < 0.0 {
            let last = time - interval;
            let what = format!("the time stamp {time} s is before the last one, {last} s");
            return Err(Error::invalid(what, "give frames in the order of their times, or begin a new tracker"));
        }
        Ok(interval)
    }

    /// Same as [`Self::interval`], but fails for an interval of 0 if that time has been corrected already.
    fn frame_interval(&self, time: f64) -> Result<f64> {
        let interval = self.interval(time)?;
        if interval == 0.0 && self.is_corrected {
            let what = format!("the time stamp {time} s is the last frame's");
            return Err(Error::invalid(what, "give each frame once, with the time of its exposure"));
        }
        Ok(interval)
    }

    /// Predicts all tracks `interval` seconds after the last frame or seeding.
    fn propagated(&self, interval: f64) -> Motions {
        let usual = self.noise.interval;
        let mut common = self.common.propagated(interval, usual);
        let mut points = Vec::with_capacity(self.tracks.iter().map(|t| t.motions.len()).sum());
        let mut starts = vec![0];
        for track in &self.tracks {
            let (jerk, changed) = track.disturbance(interval, usual, &self.options);
            let first = points.len();
            track.propagated(interval, jerk, &self.options, &mut points);
            for motion in &mut points[first..] {
                motion.position += common.displacement();
                motion.change_acceleration(changed, interval);
            }
            starts.push(points.len() as u32);
        }
        common.rebase();
        Motions { points, starts, common }
    }

    /// Returns the expected feature of a track with its window.
    fn expected(&self, track: &Track, motions: &[PointMotion], common: &CommonMotion) -> ExpectedFeature {
        let mut expected = track.expected(motions, self.noise.scale * self.noise.unaided(track.misses), common);
        let noise = track.detection * self.noise.scale;
        let points = expected.shape.points();
        let [x0, y0, x1, y1] = if let [p] = points {
            self.level.bounds(&[*p], &[expected.covariances[0] + noise])
        } else {
            let covariances: Vec<DMat2> = expected.covariances.iter().map(|c| *c + noise).collect();
            self.level.bounds(points, &covariances)
        };
        // A window has at least one pixel on each side.
        let [wide, high] = [x1 - x0, y1 - y0].map(|side| (0.5 * (1.0 - side)).max(0.0));
        expected.window = [x0 - wide, y0 - high, x1 + wide, y1 + high];
        expected
    }

    fn matcher(&self) -> Matcher {
        Matcher {
            detection_probability: self.options.detection_probability,
            clutter_density: self.noise.clutter,
            noise: self.noise.scale,
            properties: self.options.properties,
            turn: self.options.image.turn,
            ..Matcher::default()
        }
    }

    /// Clips a window to the image; `None` if it is outside.
    fn clip(&self, [x0, y0, x1, y1]: [f64; 4]) -> Option<[f64; 4]> {
        let [width, height] = [self.options.image.width, self.options.image.height].map(f64::from);
        let within = |low: f64, high: f64, size: f64| {
            (high > -0.5 && low < size - 0.5).then(|| (low.clamp(-0.5, size - 1.5), high.clamp(0.5, size - 0.5)))
        };
        let (y0, y1) = within(y0, y1, height)?;
        let (x0, x1) = match self.options.image.turn {
            Some(turn) if x1 - x0 >= turn => (-0.5, width - 0.5),
            Some(turn) => {
                let back = turn * ((x0 + 0.5) / turn).floor();
                (x0 - back, x1 - back)
            }
            None => within(x0, x1, width)?,
        };
        Some([x0, y0, x1, y1])
    }

    /// Adapts process noise and noise scale to the innovations.
    fn adapt(
        &mut self,
        interval: f64,
        expected: &[ExpectedFeature],
        candidates: &Candidates,
        seen: &Sightings,
        doubtful: &[usize],
        moved: &mut Motions,
    ) {
        self.pass_unaided(interval);
        let mut frame = FrameInnovations::default();
        let mut unaided = UnaidedSquares::default();
        for (row, track) in self.tracks.iter_mut().enumerate() {
            track.changed *= FADE;
            // A doubtful detection does not count as a miss, and a waiting track has no window.
            if track.waits.is_some() || doubtful.binary_search(&row).is_ok() {
                continue;
            }
            frame.wanted += u32::from(is_within(expected[row].shape.centre(), &self.options.image));
            let [x0, y0, x1, y1] = expected[row].window;
            frame.area += (x1 - x0) * (y1 - y0);
            let (own, points) = (seen.of(row), moved.of(row));
            let clutter = candidates.in_window[row].saturating_sub(u32::from(!own.is_empty()));
            // A single window full of clutter says nothing about the others.
            frame.clutter += clutter.min(MOST_CLUTTER);
            if own.is_empty() {
                continue;
            }
            let (squares, coordinates) = squares(own, points, self.noise.scale);
            track.own += OWN_RATE * (squares / f64::from(coordinates) - track.own);
            frame.seen += 1;
            // The uncertainty of a new track is only a guess, so it must not affect the noise scale.
            if track.seen >= OLD_ENOUGH {
                frame.squares += squares;
                frame.coordinates += coordinates;
                track.unaided.compare(own, self.noise.scale, &mut unaided);
            }
        }
        self.noise.observe_unaided(&unaided);
        let change = self.noise.observe(&frame);
        if interval <= 0.0 {
            return;
        }
        if change.displacement > 1.0 {
            let variance = (change.displacement - 1.0) * self.options.detection_sigma.powi(2) * self.noise.scale;
            moved.common.lose(variance, interval);
        }
        for (row, track) in self.tracks.iter_mut().enumerate() {
            let own = if track.own > OWN { std::mem::replace(&mut track.own, 1.0).min(MOST_OWN) } else { 1.0 };
            let inflation = change.inflation.max(own);
            if inflation <= 1.0 {
                continue;
            }
            let detection = track.detection_variance();
            let points = moved.of_mut(row);
            let predicted = 0.5 * (points[0].pp.x_axis.x + points[0].pp.y_axis.y) + detection;
            // A wide window already covers the change, so the added variance is limited.
            let variance = (inflation - 1.0) * predicted.min(WIDE * detection);
            points.iter_mut().for_each(|m| m.change_acceleration(variance, interval));
            track.unaided.change(variance, interval);
            track.changed = track.changed.max(variance);
        }
    }

    fn pass_unaided(&mut self, interval: f64) {
        for track in &mut self.tracks {
            let (jerk, changed) = track.disturbance(interval, self.noise.interval, &self.options);
            track.unaided.pass(interval, jerk, changed);
        }
    }

    /// Moves the tracks to their predicted positions.
    fn take_over(&mut self, moved: &Motions, interval: f64) {
        for (row, track) in self.tracks.iter_mut().enumerate() {
            track.motions.copy_from_slice(moved.of(row));
            track.pass_flow(interval, self.options.image.turn);
        }
    }

    /// Corrects the tracks by their detections. The shared motion also moves tracks without a detection.
    fn take_in(&mut self, seen: &Sightings, found: &[Detection], assignment: &Assignment, mut common: CommonMotion) {
        let most = (self.options.misses as usize - 1).min(MOST_UNAIDED);
        for (row, track) in self.tracks.iter_mut().enumerate() {
            let predicted = track.motions[0];
            for (motion, seen) in track.motions.iter_mut().zip(seen.of(row)) {
                let mut innovation = seen.innovation;
                if let Some(along) = seen.slides {
                    let sigma = along.dot((motion.pp + seen.covariance) * along).sqrt();
                    let slid = along.dot(innovation);
                    innovation += along * (slid.clamp(-SLIDES * sigma, SLIDES * sigma) - slid);
                }
                motion.correct(innovation, seen.covariance);
            }
            track.unaided.leave_out(&predicted, &track.motions[0], most);
            track.motions.iter_mut().for_each(|m| m.position += common.displacement());
            match assignment.columns[row] {
                None => track.misses += 1,
                Some(column) => {
                    let detection = &found[column as usize];
                    track.detection = floored(detection.covariance);
                    track.misses = 0;
                    track.seen = track.seen.saturating_add(1);
                    track.learn_properties(detection, &self.options.properties);
                }
            }
            place(track, self.options.image.turn);
            track.shared = [common.speed(), common.acceleration()];
        }
        common.rebase();
        self.common = common;
    }

    fn report(&self, candidates: &Candidates, assignment: &Assignment, found: usize, matches: &mut MatchOutcome) {
        let mut is_free = vec![true; found];
        for (column, why) in &candidates.rejected {
            is_free[*column as usize] = false;
            matches.rejected.push((*column as usize, *why));
        }
        for (row, taken) in assignment.candidates.iter().enumerate() {
            let Track { id, waits: None, .. } = self.tracks[row] else { continue };
            let Some(taken) = taken else {
                matches.missed.push(id);
                continue;
            };
            let (pair, distance) = (&candidates.pairs[*taken as usize], &candidates.distances[*taken as usize]);
            is_free[pair.column as usize] = false;
            matches.matched.push(Match {
                id,
                detection: pair.column as usize,
                distance_squared: distance.squared,
                dimensions: distance.dimensions,
            });
        }
        matches.unmatched = (0..found).filter(|i| is_free[*i]).collect();
        matches.greedy_groups = assignment.greedy_groups;
    }

    fn end_tracks(&mut self, matches: &mut MatchOutcome) {
        let (image, misses) = (self.options.image, self.options.misses);
        self.tracks.retain_mut(|track| {
            let why = if !track.motions.iter().all(PointMotion::is_finite) {
                Some(End::Lost)
            } else if !stay_within(track, &image) {
                Some(End::Left)
            } else if track.misses >= misses && track.waits.is_none() {
                Some(End::Lost)
            } else {
                None
            };
            matches.ended.extend(why.filter(|_| track.waits.is_none()).map(|why| (track.id, why)));
            why.is_none()
        });
        // Without the track for which a feature waits, its place is as doubtful.
        let followed: Vec<u32> = self.tracks().iter().map(|t| t.id).collect();
        self.tracks.retain(|t| t.waits.is_none_or(|id| followed.binary_search(&id).is_ok()));
    }

    /// Ends all tracks.
    fn end_all(&mut self, why: End, ended: &mut Vec<(u32, End)>) {
        ended.extend(self.tracks.drain(..).filter(|t| t.waits.is_none()).map(|t| (t.id, why)));
    }

    /// Begins to follow the waiting tracks that detections can distinguish from the followed ones, and returns their
    /// numbers. A detection as expected of the one must not be a candidate of the other.
    fn follow_distinguishable(&mut self) -> Vec<u32> {
        let mut begun = Vec::new();
        if self.tracks.iter().all(|t| t.waits.is_none()) {
            return begun;
        }
        let expected: Vec<ExpectedFeature> =
            self.tracks.iter().map(|t| self.expected(t, &t.motions, &self.common)).collect();
        let usual: Vec<Detection> = expected.iter().zip(&self.tracks).map(|(e, t)| e.detected(t.detection)).collect();
        let pairs = self.matcher().candidates(&expected, &usual).pairs;
        let mut near: Vec<[u32; 2]> = pairs.iter().flat_map(|p| [[p.row, p.column], [p.column, p.row]]).collect();
        near.extend((0..self.tracks.len() as u32).map(|row| [row, row]));
        near.sort_unstable();
        for own in near.chunk_by(|a, b| a[0] == b[0]) {
            let row = own[0][0] as usize;
            if self.tracks[row].waits.is_some() {
                let mut others = own.iter().map(|[_, other]| &self.tracks[*other as usize]);
                let followed = others.find(|t| t.waits.is_none()).map(|t| t.id);
                self.tracks[row].waits = followed;
                begun.extend(followed.is_none().then_some(self.tracks[row].id));
            }
        }
        self.tracks.sort_by_key(|t| (t.waits.is_some(), t.id));
        begun
    }

    /// Returns true if a track matches the predicted feature in position and kind.
    fn agrees(&self, track: &Track, seed: &Seed) -> bool {
        let expected = track.expected(&track.motions, self.noise.scale, &self.common);
        let found = Detection {
            shape: seed.shape.clone(),
            covariance: seed.covariances.iter().copied().sum::<DMat2>() * (1.0 / seed.covariances.len() as f64),
            properties: Default::default(),
        };
        self.matcher().is_near(&expected, &found)
    }
}
