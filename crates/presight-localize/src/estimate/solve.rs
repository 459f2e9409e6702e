//! The iteration: predict, compare, move, twice; and again from elsewhere where that explains too little.

use super::answer::{Estimate, EstimateState, Hypothesis, covariance, weak_directions};
use super::descent::{SEARCH, SETTLE, Schedule, descend, serves};
use super::deviation::{SeenDeviation, SurfaceVariance};
use super::findings::{find_at, has_reflectors, place_error, reflectors};
use super::normal::{CommonError, Normal};
use super::offsets::OffsetVariance;
use super::options::EstimateOptions;
use super::prior;
use super::range::measured_points;
use super::reflectors::{MatchedReflectors, hold, other_camp};
use super::run::{Expectation, FrameMeasurement, Minimum, Run, Start};
use super::scan_twist::{self, ScanError, ScanTwist};
use crate::extract::{FeatureFindings, MeasuredRanges};
use crate::matching::Shape;
use crate::motion::{Vector, motion_between};
use crate::verdict::{ExpectedImage, Surfaces, Verdicts, body_from_image, judge};
use glam::DVec3;
use presight_features::{FeatureOptions, PlacedFeatures};
use presight_model::error::{Error, Result};
use presight_model::geometry::{PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{Matrix, add_to, apply, inverse, quadratic, restricted, scaled, turn};
use presight_model::measured::{Frame, RangeNoise};
use presight_model::statistics::chi_squared_quantile;
use presight_model::world::World;
use presight_predict::predict::Predictor;
use std::sync::Arc;

/// Estimates poses from frames, one after the other.
pub struct Estimator {
    /// Makes the predictions.
    pub predictor: Predictor,
    surfaces: Surfaces,
    features: FeatureOptions,
    /// The options.
    pub options: EstimateOptions,
    /// Of the offsets of polygon groups.
    pub(super) offsets: OffsetVariance,
    /// The variance of points about their surfaces.
    deviation: SurfaceVariance,
    /// Of the motion that was undone in the scans that come next.
    scan_error: ScanError,
    /// The prediction that the frame before ended with, and the version of the world that it is of.
    before: Option<(u64, Arc<Expectation>)>,
}

/// PoseEstimate standard deviations that the first gate is wide.
const GATE: f64 = 1.75;

/// A prior that is tighter leaves room for one minimum only: metres and radians of the gate.
pub(super) const LOOSE: (f64, f64) = (0.05, 0.05);
/// A pose as far from the prior as one in 100 is looked for anew, from elsewhere: standard normal deviate.
const DOUBTFUL: f64 = 2.326;
/// By how much a pose may be off in standard deviations of a search, of independent errors, for regions of interest.
const SETTLED: f64 = 3.0;
/// A pose that grey images alone tell rests on at least so many features, or on so many fiducials: they are never taken for another, but of
/// two nobody knows which one was moved.
const FEWEST: (usize, usize) = (4, 3);
/// And more than half of the matches have to agree: some edges are always taken for others, and of two fiducials one may have been moved.
const LEAST_MATCHED: f64 = 0.55;
/// And the pose has to be one that was to be expected: standard normal deviates of the probability of one as far from the prior, 1 in 10,000,
/// and of one as far from where all but one fiducial lead, 1 in 1,000.
const UNLIKELY: (f64, f64) = (3.719, 3.09);

/// What an estimate must explain, and the part of a search that it makes.
pub(super) struct Asked {
    /// Other starts are tried below this share of explained points.
    pub(super) least: f64,
    /// It does not count below this share.
    counts: f64,
    /// A part of a search: how many starts are drawn, and which.
    pub(super) part: Option<(usize, u64)>,
}

impl Estimator {
    /// Makes an estimator that predicts with `predictor`.
    pub fn new(predictor: Predictor, options: EstimateOptions) -> Self {
        let offsets = OffsetVariance::of_sigma(options.offset_sigma);
        Self {
            predictor,
            surfaces: Surfaces::default(),
            features: FeatureOptions::default(),
            options,
            offsets,
            deviation: SurfaceVariance::of_sigma(options.model_sigma),
            scan_error: ScanError::default(),
            before: None,
        }
    }

    /// How far each point of a surface is off, as stated or as learnt so far, one standard deviation, metres.
    pub fn model_sigma(&self) -> f64 {
        if self.options.learns_sigma { self.deviation.sigma() } else { self.options.model_sigma }
    }

    /// Learns how far surfaces are off from an estimate of this estimator that is known to be right.
    pub fn learn(&mut self, estimate: &Estimate) {
        self.deviation.learn(&estimate.deviation);
    }

    /// How well the motion is known that was undone in the scans that come next. Points err by it as long as they were measured
    /// off the middle of the scan.
    pub(crate) fn set_scan_error(&mut self, error: ScanError) {
        self.scan_error = error;
    }

    /// With the features that are looked for in grey images, and the reflectors in scans with intensities, instead of the world's own layer
    /// for the sensor's class. They have to be placed in the world that frames are compared with.
    #[must_use]
    pub fn with_features(self, placed: PlacedFeatures) -> Self {
        Self { features: FeatureOptions::default().with_placed(placed), ..self }
    }

    /// Where the robot is, by frames of its sensors taken at one time: ranges, and grey images in which features are looked for.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] without a frame, for a prior that is none, and for a grey image without
    /// features to look for; [`presight_model::ErrorKind::Invalid`] for a scan whose rays do not have one pose
    /// ([`Frame::at_one_moment`]); the errors of [`Predictor::predict`].
    pub fn estimate(&mut self, world: &World, frames: &[&Frame], prior: &PoseEstimate) -> Result<Estimate> {
        // One hand-over to the threads: one for each part of it costs as much as the parts of a scan.
        let (threads, least) = (self.predictor.task_threads()?, self.options.least_explained);
        threads.run(|| self.estimate_here(world, frames, prior, &Asked { least, counts: least, part: None }))?
    }

    /// The same for a caller that judges the pose by other evidence than the share of explained points: other starts are
    /// tried where it is small, but the estimate counts whatever it is.
    ///
    /// # Errors
    /// Those of [`Estimator::estimate`].
    pub(crate) fn look_round(&mut self, world: &World, frames: &[&Frame], prior: &PoseEstimate) -> Result<Estimate> {
        let (threads, least) = (self.predictor.task_threads()?, self.options.least_explained);
        threads.run(|| self.estimate_here(world, frames, prior, &Asked { least, counts: 0.0, part: None }))?
    }

    /// [`Self::look_round`] for a robot that is lost: one frame draws `part.0` starts from the prior, and the next part of the search
    /// draws others. Second minima are left out.
    ///
    /// # Errors
    /// Those of [`Estimator::estimate`].
    pub(crate) fn look_on(
        &mut self,
        world: &World,
        frames: &[&Frame],
        prior: &PoseEstimate,
        part: (usize, u64),
    ) -> Result<Estimate> {
        let (threads, least) = (self.predictor.task_threads()?, self.options.least_explained);
        threads.run(|| self.estimate_here(world, frames, prior, &Asked { least, counts: 0.0, part: Some(part) }))?
    }

    /// [`Self::look_round`] without other starts.
    ///
    /// # Errors
    /// Those of [`Estimator::estimate`].
    pub(crate) fn follow(&mut self, world: &World, frames: &[&Frame], prior: &PoseEstimate) -> Result<Estimate> {
        let threads = self.predictor.task_threads()?;
        threads.run(|| self.estimate_here(world, frames, prior, &Asked { least: 0.0, counts: 0.0, part: None }))?
    }

    fn estimate_here(
        &mut self,
        world: &World,
        frames: &[&Frame],
        prior: &PoseEstimate,
        asked: &Asked,
    ) -> Result<Estimate> {
        let mut run = self.start(world, frames, prior)?;
        if run.is_blind() {
            return Ok(self.blind(&run));
        }
        let expected = match self.at_hand(&run) {
            Some(before) => before,
            None => self.expected(&mut run, prior)?,
        };
        run.first = Some(expected.clone());
        let found = self.descend(&run, &expected, prior.world_from_robot, &SEARCH);
        let mut best = self.settle(&mut run, &found)?;
        // What was matched in grey images is matched from another start, too.
        let reflectors = MatchedReflectors::at(&run, &best.expected, &best.pose).counts();
        let doubtful = (best.normal.explained_share() < asked.least && !hold(reflectors))
            || run.deviations_squared(&best.pose)
                > chi_squared_quantile(self.options.freedom.axes().len() as u32, DOUBTFUL);
        if !run.has_greys_only() && doubtful {
            best = self.restart(&mut run, &expected, best, asked)?;
        }
        let others = if asked.part.is_none() { self.other_minima(&mut run, &best)? } else { Vec::new() };
        // Of what is not explained nobody knows which polygons it was.
        if best.normal.explained_share() >= self.options.least_explained {
            self.offsets.learn(&best.normal, &run.prior_information, self.options.freedom);
        }
        self.before = Some((world.stamp(), best.expected.clone()));
        self.answer(&run, best, others, asked.counts)
    }

    /// The prediction that the frame before ended with, if it was made near the prior's pose: it serves for the search, which ends in a
    /// prediction of its own.
    pub(super) fn at_hand(&self, run: &Run<'_>) -> Option<Arc<Expectation>> {
        let (_, before) = self.before.as_ref().filter(|(stamp, _)| *stamp == run.world.stamp())?;
        let near = |(e, m): (&ExpectedImage, &FrameMeasurement<'_>)| {
            let sensor = m.frame.sensor();
            let off = motion_between(
                &e.world_from_image,
                &(run.prior.world_from_robot * sensor.spec().mount * body_from_image(sensor)),
            );
            e.sensor.spec() == sensor.spec() && length(&off[..3]) < LOOSE.0 && length(&off[3..]) < LOOSE.1
        };
        let same = run.looked.is_empty() && before.images.len() == run.measured.len();
        (same && before.images.iter().zip(&run.measured).all(near)).then(|| before.clone())
    }

    /// The minimum that the prior's pose leads to, whatever it explains: nothing else is looked for, and nothing is learnt.
    pub(crate) fn refine(&mut self, world: &World, frame: &Frame, prior: &PoseEstimate) -> Result<Estimate> {
        let mut run = self.start(world, &[frame], prior)?;
        if run.is_blind() {
            return Ok(self.blind(&run));
        }
        let expected = self.expected(&mut run, prior)?;
        let found = self.descend(&run, &expected, prior.world_from_robot, &SEARCH);
        let end = self.settle(&mut run, &found)?;
        self.answer(&run, end, Vec::new(), self.options.least_explained)
    }

    /// [`Self::refine`] for a deskewed scan whose twist is estimated, too, and what the scan alone says of it. `known` is the
    /// covariance of the twist that was undone, in the robot's axes.
    pub(crate) fn refine_with_twist(
        &mut self,
        world: &World,
        frame: &Frame,
        prior: &PoseEstimate,
        known: &Matrix,
    ) -> Result<(Estimate, ScanTwist)> {
        let freedom = self.options.freedom;
        let rotation = prior.world_from_robot.rotation;
        let mut run = self.start(world, &[frame], prior)?;
        if run.is_blind() {
            return Ok((self.blind(&run), ScanTwist::default()));
        }
        run.twist_prior = Some(inverse(&scan_twist::in_world(known, rotation), freedom.axes()));
        let expected = self.expected(&mut run, prior)?;
        let found = self.descend(&run, &expected, prior.world_from_robot, &SEARCH);
        let end = self.settle(&mut run, &found)?;
        let off = motion_between(&run.prior.world_from_robot, &end.pose);
        let pull = apply(&run.prior_information, &off);
        let prior = (&run.prior_information, &pull);
        let shared = self.shared_errors(&end);
        let twist = ScanTwist::of(&end.normal, prior, &end.twist, end.spread, freedom, &shared);
        let twist = twist.in_axes(&turn(end.pose.rotation));
        drop(shared);
        Ok((self.answer(&run, end, Vec::new(), self.options.least_explained)?, twist))
    }

    /// Covariances of the errors that residuals share, by the error.
    fn shared_errors<'a>(&'a self, best: &'a Minimum) -> impl Fn(CommonError) -> Matrix + 'a {
        let offset = self.offsets.sigma().powi(2);
        let stored =
            |object: u32| best.expected.images.iter().find_map(|e| e.errors.get(&object)).map(|e| e.covariance);
        let axes = self.options.freedom.axes();
        let of_scan = |m: &Matrix| restricted(&scan_twist::in_world(m, best.pose.rotation), axes);
        move |error: CommonError| match error {
            CommonError::Object(object) => stored(object).unwrap_or_default(),
            CommonError::Offset(_) | CommonError::Edge(_) => {
                let mut m = [[0.0; 6]; 6];
                m[0][0] = offset;
                m
            }
            CommonError::Place(feature) => place_error(&best.expected.findings, feature, offset),
            CommonError::Twist => of_scan(&self.scan_error.twist),
            CommonError::Acceleration => of_scan(&self.scan_error.acceleration),
        }
    }

    /// Where the reflectors are that are looked for in the scans of a frame's sensor, world, metres.
    pub(crate) fn reflectors(&self, world: &World, frame: &Frame) -> Vec<DVec3> {
        reflectors(world, &self.features, frame).collect()
    }

    pub(super) fn start<'a>(
        &mut self,
        world: &'a World,
        frames: &[&'a Frame],
        prior: &PoseEstimate,
    ) -> Result<Run<'a>> {
        prior::check(prior, self.options.freedom)?;
        if frames.is_empty() {
            return Err(Error::usage("an estimate without a frame", "give at least one"));
        }
        if let Some(moving) = frames.iter().find(|frame| frame.grey().is_none() && !frame.has_one_pose()) {
            let remedy = "give Frame::at_one_moment, or the scan to a localizer";
            let e = Error::invalid("the rays of a scan do not have one pose", remedy);
            return Err(e.at(format!("the frame at {} s", moving.stamp)));
        }
        let ranges: Vec<&Frame> = frames.iter().copied().filter(|f| f.grey().is_none()).collect();
        let is_looked_at = |f: &&Frame| f.grey().is_some() || has_reflectors(world, &self.features, f);
        let looked = frames.iter().copied().filter(is_looked_at).collect();
        let one =
            |frame| FrameMeasurement { frame, points: measured_points(frame), noise: RangeNoise::of(frame.sensor()) };
        let measured: Vec<FrameMeasurement<'a>> =
            self.predictor.on_threads(|| ranges.into_iter().map(one).collect())?;
        let axes = self.options.freedom.axes();
        let sigma =
            |from: usize| axes.iter().filter(|i| **i / 3 == from).map(|i| prior.covariance[*i][*i]).sum::<f64>().sqrt();
        Ok(Run {
            world,
            reach: reach_of(&measured, std::iter::empty()),
            measured,
            looked,
            model_sigma: self.model_sigma(),
            learns_sigma: self.options.learns_sigma,
            offset_sigma: self.offsets.sigma(),
            prior: *prior,
            prior_information: inverse(prior.covariance.as_rows(), axes),
            unlikely: chi_squared_quantile(axes.len() as u32, UNLIKELY.0),
            extent: (GATE * sigma(0), (GATE * sigma(1)).min(1.0)),
            only: self.options.only,
            first: None,
            twist_prior: None,
            predictions: 0,
        })
    }

    /// Predicts all sensors at a pose of the robot.
    pub(super) fn expected(&mut self, run: &mut Run<'_>, robot: &PoseEstimate) -> Result<Arc<Expectation>> {
        run.predictions += 1;
        let one = |m: &FrameMeasurement<'_>| {
            let sensor = m.frame.sensor();
            let pose = &robot.world_from_robot;
            ExpectedImage::predict(&mut self.predictor, run.world, &mut self.surfaces, sensor, &RobotPose::new(*pose))
        };
        let images = run.measured.iter().map(one).collect::<Result<Vec<ExpectedImage>>>()?;
        let unstated = run.model_sigma.hypot(run.offset_sigma);
        let what = (run.world, &self.features);
        let find = |frame: &&Frame| find_at(&mut self.predictor, what, frame, robot, unstated);
        let findings = run.looked.iter().map(find).collect::<Result<Vec<FeatureFindings>>>()?;
        Ok(Arc::new(Expectation { images, findings }))
    }

    /// Settles where a search ended, in a new prediction unless the one before serves.
    pub(super) fn settle(&mut self, run: &mut Run<'_>, found: &Minimum) -> Result<Minimum> {
        self.settle_with(run, found, &SETTLE)
    }

    pub(super) fn settle_with(&mut self, run: &mut Run<'_>, found: &Minimum, schedule: &Schedule) -> Result<Minimum> {
        let robust;
        let found = if run.has_greys_only() {
            // What was taken for something else, or was moved, must not lead the second look astray.
            robust = self.descend(run, &found.expected, found, &SETTLE);
            &robust
        } else {
            found
        };
        // A frame is judged by a prediction of its own.
        let expected = if run.predictions > 0 && serves(run, &found.expected, &found.pose) {
            found.expected.clone()
        } else {
            let mut information = found.normal.information;
            add_to(&mut information, &run.prior_information);
            // Regions of interest get narrower with what was learnt, but it may be wrong.
            let mut known = scaled(&inverse(&information, self.options.freedom.axes()), SETTLED * SETTLED);
            // What the model is off by moves features, too.
            (0..3).for_each(|i| known[i][i] += self.offsets.sigma().powi(2) + run.model_sigma.powi(2));
            self.expected(run, &PoseEstimate::new(RobotPose::new(found.pose), PoseCovariance::from_rows(known)))?
        };
        Ok(self.descend(run, &expected, found, schedule))
    }

    /// Steps from a start to rest, without a new prediction.
    pub(super) fn descend(
        &mut self,
        run: &Run<'_>,
        expected: &Arc<Expectation>,
        start: impl Into<Start>,
        schedule: &Schedule,
    ) -> Minimum {
        let (freedom, start) = (self.options.freedom, start.into());
        let at_once = || descend(run, expected, start, schedule, freedom, |_| false);
        self.predictor.on_threads(at_once).unwrap_or_else(|_| at_once())
    }

    fn answer(&mut self, run: &Run<'_>, best: Minimum, others: Vec<Minimum>, least: f64) -> Result<Estimate> {
        let freedom = self.options.freedom;
        let shared = self.shared_errors(&best);
        let matched =
            best.expected.findings.iter().flat_map(FeatureFindings::matched).flat_map(|(f, _)| &f.points_world);
        let reach = reach_of(&run.measured, matched.map(|p| p.distance_squared(best.pose.translation)));
        let prior = Some(&run.prior_information);
        let mut covariance = covariance(&best.normal, prior, freedom, best.spread, &shared);
        let weak = weak_directions(
            &best.normal,
            Some(run.prior.covariance.as_rows()),
            freedom,
            reach,
            best.spread,
            self.options.loosest,
            &shared,
        );
        drop(shared);
        let hypothesis = best.hypothesis();
        let reflectors = MatchedReflectors::at(run, &best.expected, &best.pose).counts();
        let state = match self.doubt_of_features(run, &best) {
            Some(why) => EstimateState::Undetermined(why),
            None if run.has_greys_only() => {
                state(&hypothesis, &others, self.options.least_explained.min(LEAST_MATCHED))
            }
            // The ranges may then be those of things that come and go.
            None if hold(reflectors) && !run.is_unlikely(&best.pose) => state(&hypothesis, &others, 0.0),
            None => state(&hypothesis, &others, least),
        };
        let apart = |off: &Vector| std::array::from_fn(|i| std::array::from_fn(|j| off[i] * off[j]));
        for off in self.hanging_on_one(run, &best, &covariance).into_iter().chain(other_camp(run, &best, freedom)) {
            add_to(&mut covariance, &apart(&off));
        }
        for other in &others {
            let off = motion_between(&best.pose, &other.pose);
            add_to(&mut covariance, &scaled(&apart(&off), 1.0 / (1.0 + others.len() as f64)));
        }
        let pose = PoseEstimate::new(RobotPose::new(best.pose), PoseCovariance::from_rows(covariance));
        let verdicts = self.verdicts(run, &best, &pose)?;
        let mut findings = best.expected.findings.clone();
        for (m, verdicts) in run.measured.iter().zip(&verdicts) {
            let sensor = m.frame.sensor();
            let ranges = MeasuredRanges {
                verdicts,
                sensor,
                pose: RobotPose::new(best.pose).sensor(sensor),
                intensities: m.frame.intensities(),
            };
            findings.iter_mut().for_each(|f| f.explain(&ranges));
        }
        Ok(Estimate {
            pose,
            verdicts,
            findings,
            reflectors,
            weak,
            explained: hypothesis.explained,
            cost: hypothesis.cost,
            spread: best.spread,
            model_sigma: run.model_sigma,
            deviation: best.normal.deviation,
            offset_sigma: self.offsets.sigma(),
            hypotheses: std::iter::once(hypothesis).chain(others.iter().map(Minimum::hypothesis)).collect(),
            state,
            predictions: run.predictions,
        })
    }

    /// Why features alone do not tell this pose, if they do not: they are too few, or they lead to where the robot hardly is.
    fn doubt_of_features(&self, run: &Run<'_>, best: &Minimum) -> Option<String> {
        if !run.has_greys_only() {
            return None;
        }
        let matched = || best.expected.findings.iter().flat_map(FeatureFindings::matched);
        let tags = matched().filter(|(f, _)| matches!(f.predicted, Shape::Fiducial(_))).count();
        let (matched, (fewest, fewest_tags)) = (matched().count(), FEWEST);
        if matched < fewest && tags < fewest_tags {
            return Some(format!("{matched} features are matched, fewer than {fewest}, or {fewest_tags} fiducials"));
        }
        let off = motion_between(&run.prior.world_from_robot, &best.pose);
        run.is_unlikely(&best.pose).then(|| {
            let (metres, degrees) = (length(&off[..3]), length(&off[3..]).to_degrees());
            format!("the features lead {metres:.3} m and {degrees:.2} deg away, where the robot hardly is by what was known before")
        })
    }

    /// Motions to where a pose by grey images alone would be without one of its fiducials, if that is farther off than the covariance
    /// says: it hangs on this one, and nothing tells whether this one was moved.
    fn hanging_on_one(&mut self, run: &Run<'_>, best: &Minimum, covariance: &Matrix) -> Vec<Vector> {
        let freedom = self.options.freedom;
        let claimed = inverse(covariance, freedom.axes());
        let most = chi_squared_quantile(freedom.axes().len() as u32, UNLIKELY.1);
        let matched = best.expected.findings.iter().flat_map(FeatureFindings::matched);
        let tags = matched.filter(|(f, _)| matches!(f.predicted, Shape::Fiducial(_)) && run.has_greys_only());
        let without = |id: u32| {
            let findings = best.expected.findings.iter().map(|f| f.without(id)).collect();
            let others = Arc::new(Expectation { images: Vec::new(), findings });
            motion_between(&best.pose, &self.descend(run, &others, best.pose, &SETTLE).pose)
        };
        tags.map(|(f, _)| f.id).map(without).filter(|off| quadratic(&claimed, off) > most).collect()
    }

    fn verdicts(&mut self, run: &Run<'_>, best: &Minimum, pose: &PoseEstimate) -> Result<Vec<Verdicts>> {
        let polygons = self.model_sigma().hypot(self.offsets.sigma());
        let one = |(m, expected): (&FrameMeasurement<'_>, &ExpectedImage)| judge(m.frame, expected, pose, polygons);
        let all = || run.measured.iter().zip(&best.expected.images).map(one).collect();
        self.predictor.on_threads(all)
    }

    fn blind(&self, run: &Run<'_>) -> Estimate {
        let known = restricted(run.prior.covariance.as_rows(), self.options.freedom.axes());
        Estimate {
            pose: PoseEstimate::new(run.prior.robot(), PoseCovariance::from_rows(known)),
            verdicts: Vec::new(),
            findings: Vec::new(),
            reflectors: (0, 0),
            weak: weak_directions(
                &Normal::default(),
                Some(run.prior.covariance.as_rows()),
                self.options.freedom,
                1.0,
                1.0,
                self.options.loosest,
                &|_| [[0.0; 6]; 6],
            ),
            explained: 0.0,
            cost: 0.0,
            spread: 1.0,
            model_sigma: run.model_sigma,
            deviation: SeenDeviation::default(),
            offset_sigma: self.offsets.sigma(),
            hypotheses: Vec::new(),
            state: EstimateState::Undetermined("no pixel measured a range within the sensor's limits".into()),
            predictions: 0,
        }
    }
}

pub(super) fn length(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn state(best: &Hypothesis, others: &[Minimum], least: f64) -> EstimateState {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    if best.explained < least {
        return EstimateState::Undetermined(format!(
            "{} of the measured points are explained, less than {}",
            percent(best.explained),
            percent(least)
        ));
    }
    let Some(other) = others.first() else { return EstimateState::Determined };
    let off = motion_between(&best.pose.world_from_robot(), &other.pose);
    EstimateState::Undetermined(format!(
        "a pose {:.3} m and {:.2} deg off explains {}, the best one {}",
        length(&off[..3]),
        length(&off[3..]).to_degrees(),
        percent(other.normal.explained_share()),
        percent(best.explained)
    ))
}

/// How far away points are measured or matched, root of the mean square, metres.
fn reach_of(measured: &[FrameMeasurement<'_>], matched: impl Iterator<Item = f64>) -> f64 {
    let points = measured.iter().flat_map(|m| &m.points).map(|p| p.point.as_dvec3().length_squared());
    let (sum, count) = points.chain(matched).fold((0.0, 0.0), |(s, n), x| (s + x, n + 1.0));
    (sum / f64::max(count, 1.0)).sqrt().max(1e-3)
}
