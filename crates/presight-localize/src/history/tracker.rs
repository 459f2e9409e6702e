//! Follows all features of an image.

use super::adapt::{Adaptation, FrameInnovations};
use super::border::{is_within, place, stay_within};
use super::common::CommonMotion;
use super::health::{Health, PredictionTrigger, spread};
use super::motion::PointMotion;
use super::options::TrackerOptions;
use super::outcome::{End, Match, MatchOutcome, SeedOutcome, Window};
use super::sightings::{Motions, Sightings, squares};
use super::track::{Seed, Track};
use super::window::BoxLevel;
use crate::matching::{Assignment, Candidates, Detection, ExpectedFeature, Matcher, Rejection, assign, floored};
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
/// Number of neighbours that estimate the speed of a new track.
const NEIGHBOURS: usize = 8;

/// Follows features from frame to frame.
#[derive(Clone, Debug)]
pub struct Tracker {
    options: TrackerOptions,
    level: BoxLevel,
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
        &self.tracks
    }

    /// Time of the last seeding or correction, seconds.
    pub fn time(&self) -> Option<f64> {
        self.time
    }

    /// Takes over the features of a full prediction for `time` (seconds). A track goes on if its feature is predicted
    /// near its position. All other predicted features start new tracks, and tracks without a predicted feature end.
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
            done.ended.extend(self.tracks.drain(..).map(|t| (t.id, End::Gap)));
        }
        if interval > 0.0 {
            let moved = self.propagated(interval);
            self.take_over(&moved, interval);
            self.common = moved.common;
        }
        let mut old = std::mem::take(&mut self.tracks).into_iter().peekable();
        let mut tracks: Vec<Track> = Vec::with_capacity(seeds.len());
        let mut begun = Vec::new();
        for seed in seeds {
            while let Some(gone) = old.next_if(|t| t.id < seed.id) {
                done.ended.push((gone.id, End::NotPredicted));
            }
            let known = old.next_if(|t| t.id == seed.id);
            if let Err(why) = check_seed(&seed) {
                done.ended.extend(known.map(|t| (t.id, End::NotPredicted)));
                done.refused.push((seed.id, why));
                continue;
            }
            match known.filter(|track| self.agrees(track, &seed)) {
                Some(mut track) => {
                    track.flow.points_world.clone_from(&seed.points_world);
                    done.kept.push(seed.id);
                    tracks.push(track);
                }
                None => {
                    done.begun.push(seed.id);
                    begun.push(tracks.len());
                    tracks.push(Track::new(seed, &self.options));
                }
            }
        }
        done.ended.extend(old.map(|t| (t.id, End::NotPredicted)));
        self.tracks = tracks;
        self.lend_speeds(&begun);
        self.seeded = self.tracks.len();
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
        let mut windows = Vec::with_capacity(self.tracks.len());
        for (row, track) in self.tracks.iter().enumerate() {
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
            matches.ended.extend(self.tracks.drain(..).map(|t| (t.id, End::Gap)));
        }
        let elapsed = interval + std::mem::take(&mut self.before_seeding);
        if elapsed > 0.0 && elapsed <= self.options.longest_gap {
            self.noise.pass(elapsed);
        }
        let mut moved = self.propagated(interval);
        let expected: Vec<ExpectedFeature> = (self.tracks.iter().enumerate())
            .map(|(row, track)| self.expected(track, moved.of(row), &moved.common))
            .collect();
        let matcher = self.matcher();
        let candidates = matcher.candidates(&expected, found);
        let assignment = assign(&candidates.pairs, &vec![matcher.unseen_cost(); expected.len()])?;
        let mut seen = Sightings::new(&expected, found, &assignment, &self.options);
        let shift = moved.common.correct(&seen.witnesses(&self.tracks, &moved, self.noise.scale), elapsed);
        seen.points.iter_mut().for_each(|p| p.innovation -= shift);
        self.adapt(elapsed, &expected, &candidates, &seen, &mut moved);
        self.take_over(&moved, interval);
        self.take_in(&seen, found, &assignment, moved.common);
        self.report(&candidates, &assignment, found.len(), &mut matches);
        self.end_tracks(&mut matches);
        (self.time, self.is_corrected) = (Some(time), true);
        Ok(matches)
    }

    /// Reports how well the tracks cover the image, and whether a full prediction is needed.
    pub fn health(&self) -> Health {
        let spread = spread(&self.tracks, &self.options.image);
        let share = self.tracks.len() as f64 / self.seeded.max(1) as f64;
        let wants = if self.has_gap {
            Some(PredictionTrigger::Gap)
        } else if self.time.is_none() {
            Some(PredictionTrigger::Start)
        } else if self.tracks.len() < self.options.least_tracks {
            Some(PredictionTrigger::TooFew)
        } else if spread < self.options.least_spread {
            Some(PredictionTrigger::BadlySpread)
        } else if share < self.options.least_share {
            Some(PredictionTrigger::Thinned)
        } else {
            None
        };
        Health { tracks: self.tracks.len(), spread, share, noise_scale: self.noise.scale, wants }
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
            let variance = self.options.memory.powi(-6) * track.detection_variance();
            let jerk = if usual > 0.0 { variance / usual.powi(5) } else { 0.0 };
            let first = points.len();
            track.propagated(interval, jerk, &self.options, &mut points);
            for motion in &mut points[first..] {
                motion.position += common.displacement();
                if usual > 0.0 {
                    motion.change_acceleration(track.changed * (interval / usual).powi(4), interval);
                }
            }
            starts.push(points.len() as u32);
        }
        common.rebase();
        Motions { points, starts, common }
    }

    /// Returns the expected feature of a track with its window.
    fn expected(&self, track: &Track, motions: &[PointMotion], common: &CommonMotion) -> ExpectedFeature {
        let mut expected = track.expected(motions, self.noise.scale, common);
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
        moved: &mut Motions,
    ) {
        let mut frame = FrameInnovations::default();
        for (row, track) in self.tracks.iter_mut().enumerate() {
            track.changed *= FADE;
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
            }
        }
        let change = self.noise.observe(&frame);
        if interval <= 0.0 {
            return;
        }
        if change.displacement > 1.0 {
            moved.common.lose((change.displacement - 1.0) * self.options.detection_sigma.powi(2) * self.noise.scale);
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
            track.changed = track.changed.max(variance);
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
        for (row, track) in self.tracks.iter_mut().enumerate() {
            for (motion, seen) in track.motions.iter_mut().zip(seen.of(row)) {
                let mut innovation = seen.innovation;
                if let Some(along) = seen.slides {
                    let sigma = along.dot((motion.pp + seen.covariance) * along).sqrt();
                    let slid = along.dot(innovation);
                    innovation += along * (slid.clamp(-SLIDES * sigma, SLIDES * sigma) - slid);
                }
                motion.correct(innovation, seen.covariance);
            }
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
            let id = self.tracks[row].id;
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
            } else if track.misses >= misses {
                Some(End::Lost)
            } else {
                None
            };
            matches.ended.extend(why.map(|why| (track.id, why)));
            why.is_none()
        });
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

    /// Initializes the speed of new tracks from older tracks nearby.
    fn lend_speeds(&mut self, begun: &[usize]) {
        let speed = |t: &Track| t.motions.iter().map(|m| m.speed).sum::<DVec2>() / t.motions.len() as f64;
        let is_new = |i: &usize| begun.binary_search(i).is_ok();
        let old: Vec<(DVec2, DVec2)> = (0..self.tracks.len())
            .filter(|i| !is_new(i) && self.tracks[*i].seen >= OLD_ENOUGH && self.tracks[*i].misses == 0)
            .map(|i| (self.tracks[i].shape.centre(), speed(&self.tracks[i])))
            .collect();
        if old.len() < NEIGHBOURS {
            return;
        }
        let mut near: Vec<(f64, DVec2)> = Vec::new();
        for i in begun {
            let track = &mut self.tracks[*i];
            let at = track.shape.centre();
            near.clear();
            near.extend(old.iter().map(|(p, v)| (p.distance_squared(at), *v)));
            near.select_nth_unstable_by(NEIGHBOURS - 1, |a, b| a.0.total_cmp(&b.0));
            let near = &near[..NEIGHBOURS];
            let mean = near.iter().map(|n| n.1).sum::<DVec2>() / NEIGHBOURS as f64;
            let spread: f64 = near.iter().map(|n| n.1.distance_squared(mean)).sum::<f64>() / NEIGHBOURS as f64;
            // Twice the spread of the neighbours, because depths differ more than positions in the image.
            let variance = (2.0 * spread).max(self.options.residual_speed_sigma.powi(2));
            for motion in &mut track.motions {
                if variance < motion.vv.x_axis.x {
                    motion.speed = mean;
                    motion.vv = super::motion::isotropic(variance);
                }
            }
        }
    }
}

fn check_seed(seed: &Seed) -> Result<(), Rejection> {
    seed.shape.check()?;
    let points = seed.shape.points().len();
    if seed.covariances.len() != points || !(seed.points_world.is_empty() || seed.points_world.len() == points) {
        return Err(Rejection::Degenerate);
    }
    for covariance in &seed.covariances {
        Detection { covariance: *covariance, ..Detection::new(seed.shape.clone(), 1.0) }.check()?;
    }
    if seed.points_world.iter().all(|p| p.is_finite()) { Ok(()) } else { Err(Rejection::NotFinite) }
}
