//! Follows all features of an image.

use super::options::TrackerOptions;
use super::seed::Seed;
use super::track::Track;
use super::window::{BoxLevel, Window};
use crate::matching::{Detection, ExpectedFeature, Matcher, Rejection, assign};
use glam::DMat2;
use presight_model::error::{Error, Result};

/// A feature and its detection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// The feature's number.
    pub id: u32,
    /// Index of the detection.
    pub detection: usize,
}

/// Why a track ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum End {
    /// It was missed too often in a row.
    Lost,
    /// It left the image.
    Left,
}

/// Result of matching a frame's detections to the tracks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MatchOutcome {
    /// Features found.
    pub matched: Vec<Match>,
    /// Features not found. Their positions are extrapolated.
    pub missed: Vec<u32>,
    /// Tracks that ended.
    pub ended: Vec<(u32, End)>,
    /// Indices of detections that match no track.
    pub unmatched: Vec<usize>,
    /// Detections with invalid values.
    pub rejected: Vec<(usize, Rejection)>,
}

/// Follows features from frame to frame.
#[derive(Clone, Debug)]
pub struct Tracker {
    options: TrackerOptions,
    matcher: Matcher,
    level: BoxLevel,
    /// By number.
    tracks: Vec<Track>,
    /// Time of the last frame or seeding, seconds.
    time: Option<f64>,
    /// True once detections of that time have corrected the tracks.
    is_corrected: bool,
}

impl Tracker {
    /// A tracker without tracks.
    ///
    /// # Errors
    /// The errors of [`TrackerOptions::check`].
    pub fn new(options: TrackerOptions) -> Result<Self> {
        options.check()?;
        let level = BoxLevel::new(options.confidence);
        let matcher = options.matcher.with_turn(options.image.turn);
        Ok(Self { options, matcher, level, tracks: Vec::new(), time: None, is_corrected: false })
    }

    /// The tracks, sorted by number.
    pub fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// Time of the last seeding or correction, seconds.
    pub fn time(&self) -> Option<f64> {
        self.time
    }

    /// Takes over the features of a full prediction for `time` (seconds). A track is kept if its feature is predicted
    /// near its position. All other predicted features start new tracks, and tracks without a predicted feature end.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for a time that is not finite or is before the last time, for two seeds
    /// with one number, and for a seed with unusable values. The tracks are then unchanged.
    pub fn seed(&mut self, time: f64, mut seeds: Vec<Seed>) -> Result<()> {
        let interval = self.interval(time)?;
        seeds.sort_by_key(|s| s.id);
        if let Some(pair) = seeds.windows(2).find(|pair| pair[0].id == pair[1].id) {
            let what = format!("feature {} is given twice", pair[0].id);
            return Err(Error::invalid(what, "give each its own number"));
        }
        if let Some((id, why)) = seeds.iter().find_map(|s| Some((s.id, s.check().err()?))) {
            let what = format!("feature {id} cannot be followed: {why:?}");
            return Err(Error::invalid(what, "give finite points with one valid covariance each"));
        }
        let follow = |seed: Seed| {
            let known = self.tracks.binary_search_by_key(&seed.id, |t| t.id).ok();
            let known = known.map(|i| self.tracks[i].advanced(interval, &self.options));
            known.filter(|track| self.agrees(track, &seed)).unwrap_or_else(|| Track::new(seed, &self.options))
        };
        self.tracks = seeds.into_iter().map(follow).collect();
        (self.time, self.is_corrected) = (Some(time), self.is_corrected && interval == 0.0);
        Ok(())
    }

    /// Predicts the windows of all tracked features at `time` (seconds). Features outside the image are omitted.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for a time that is not finite or not after the last frame.
    pub fn predict(&self, time: f64) -> Result<Vec<Window>> {
        let tracks = self.advanced(time)?;
        let window = |track: &Track| {
            let ExpectedFeature { shape, covariances, window, .. } = self.expected(track);
            let covariances = covariances.iter().map(|c| *c + track.detection).collect();
            Some(Window { id: track.id, shape, covariances, bounds: self.clip(window)? })
        };
        Ok(tracks.iter().filter_map(window).collect())
    }

    /// Corrects the tracks by the detections of a frame.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for a time that is not finite or not after the last frame. The tracks are
    /// then unchanged.
    pub fn correct(&mut self, time: f64, found: &[Detection]) -> Result<MatchOutcome> {
        let mut tracks = self.advanced(time)?;
        let expected: Vec<ExpectedFeature> = tracks.iter().map(|track| self.expected(track)).collect();
        let candidates = self.matcher.candidates(&expected, found);
        let assignment = assign(&candidates.pairs, &vec![self.matcher.unseen_cost(); expected.len()])?;
        let mut outcome = MatchOutcome {
            rejected: candidates.rejected.iter().map(|(i, why)| (*i as usize, *why)).collect(),
            ..MatchOutcome::default()
        };
        let mut is_free = vec![true; found.len()];
        outcome.rejected.iter().for_each(|(i, _)| is_free[*i] = false);
        for ((track, expected), column) in tracks.iter_mut().zip(&expected).zip(&assignment.columns) {
            match column.map(|i| i as usize) {
                Some(detection) => {
                    is_free[detection] = false;
                    track.correct(expected, &found[detection], self.options.image.turn);
                    outcome.matched.push(Match { id: track.id, detection });
                }
                None => {
                    track.misses += 1;
                    outcome.missed.push(track.id);
                }
            }
        }
        tracks.retain(|track| {
            let is_lost = !track.is_finite() || track.misses >= self.options.max_misses;
            let has_left = !track.is_within(&self.options.image);
            let why = if is_lost { Some(End::Lost) } else { has_left.then_some(End::Left) };
            outcome.ended.extend(why.map(|why| (track.id, why)));
            why.is_none()
        });
        outcome.unmatched = (0..found.len()).filter(|i| is_free[*i]).collect();
        (self.tracks, self.time, self.is_corrected) = (tracks, Some(time), true);
        Ok(outcome)
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

    /// The tracks at the time of the next frame.
    fn advanced(&self, time: f64) -> Result<Vec<Track>> {
        let interval = self.interval(time)?;
        if interval == 0.0 && self.is_corrected {
            let what = format!("the time stamp {time} s is the last frame's");
            return Err(Error::invalid(what, "give each frame once, with the time of its exposure"));
        }
        Ok(self.tracks.iter().map(|track| track.advanced(interval, &self.options)).collect())
    }

    /// Returns the expected feature of a track with its window, which also holds the noise of the detection.
    fn expected(&self, track: &Track) -> ExpectedFeature {
        let mut expected = track.expected();
        let covariances: Vec<DMat2> = expected.covariances.iter().map(|c| *c + track.detection).collect();
        expected.window = self.level.bounds(expected.shape.points(), &covariances);
        expected
    }

    /// Clips a window to the image; `None` if it is outside.
    fn clip(&self, [x0, y0, x1, y1]: [f64; 4]) -> Option<[f64; 4]> {
        let [width, height] = [self.options.image.width, self.options.image.height].map(f64::from);
        let within = |low: f64, high: f64, size: f64| {
            (high > -0.5 && low < size - 0.5).then(|| (low.max(-0.5), high.min(size - 0.5)))
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

    /// Returns true if a track matches the predicted feature in position and kind.
    fn agrees(&self, track: &Track, seed: &Seed) -> bool {
        let found = Detection {
            shape: seed.shape.clone(),
            covariance: seed.covariances.iter().copied().sum::<DMat2>() * (1.0 / seed.covariances.len() as f64),
            properties: Default::default(),
        };
        self.matcher.is_near(&track.expected(), &found)
    }
}
