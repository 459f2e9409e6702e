//! Where a robot may be that nothing is known of: one scan weighed at all headings of all free places, and the best places refined.

use super::likelihood::{PoseLikelihood, heading_of};
use super::odds::Odds;
use super::reflectors::{ODDS, SeenReflectors};
use super::round::{HEADINGS, RoundViews, STEP};
use crate::estimate::{Estimate, Estimator, Freedom};
use glam::{DQuat, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, PoseEstimate, RobotPose};
use presight_model::measured::Frame;
use presight_model::sensor::{Geometry, Sensor};
use presight_model::world::World;
use presight_predict::batch::{Headings, Panoramas, PoseCell};
use presight_render::row::is_level;
use rayon::prelude::*;

/// How a [`Search`] looks for a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SearchOptions {
    /// Distance between neighbouring places, metres.
    pub cell: f64,
    /// Most headings of a place.
    pub headings: u32,
    /// Height of the robot's frame, metres.
    pub floor: f64,
    /// Where the height is not known: up to so high, metres, in steps of `cell`. Less than `floor` counts as `floor`.
    pub floor_to: f64,
    /// How far beyond the bounds of the map the robot may be, metres: a map of surfaces that were seen ends where they do, and need not
    /// reach to where they were seen from.
    pub margin: f64,
    /// How the robot leans about its own x and y axes, radians, as an inertial sensor tells it: roll and pitch.
    pub lean: [f64; 2],
    /// A place is free if nothing is nearer to the sensor, metres.
    pub clearance: f64,
    /// A place is inside if this share of all directions meets something.
    pub surrounded: f64,
    /// Candidates that are kept.
    pub candidates: usize,
    /// How many beams tell as much as one independent beam, for a sensor that states 1.
    pub beam_dependence: f64,
}

impl Default for SearchOptions {
    fn default() -> Self {
        Self {
            cell: 0.25,
            headings: 360,
            floor: 0.0,
            floor_to: 0.0,
            margin: 0.0,
            lean: [0.0; 2],
            clearance: 0.25,
            surrounded: 0.5,
            candidates: 40,
            beam_dependence: 20.0,
        }
    }
}

presight_model::with_options!(
    SearchOptions:
    with_cell cell: f64,
    with_headings headings: u32,
    with_floor floor: f64,
    with_floor_to floor_to: f64,
    with_margin margin: f64,
    with_lean lean: [f64; 2],
    with_clearance clearance: f64,
    with_surrounded surrounded: f64,
    with_candidates candidates: usize,
    with_beam_dependence beam_dependence: f64,
);

/// A place where the robot may be.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The place.
    pub pose: PoseEstimate,
    /// During a search over frames: natural logarithm of its odds against all other places. For one search alone: the
    /// log-likelihood of the frame; only its differences have a meaning.
    pub log_likelihood: f64,
    /// Share of the readings that the pose explains, in the mean over the frames.
    pub explained: f64,
    /// Frames that it was compared with.
    pub frames: usize,
    /// What the estimator said of the latest frame.
    pub estimate: Estimate,
    pub(super) odds: Odds,
}

/// The free places of one version of a world, and what a sensor sees from them.
#[derive(Clone, Debug)]
pub struct Search {
    options: SearchOptions,
    views: Views,
    likelihood: PoseLikelihood,
    /// How the sensor stands where the robot's heading is 0.
    level_from_sensor: DQuat,
}

/// What is seen from free places.
#[derive(Clone, Debug)]
enum Views {
    /// By a level scanner, with all its beams.
    Level(Panoramas),
    /// By any other sensor, coarsely and all round.
    Round(RoundViews),
}

/// Most places of a search: 16 hectares in cells of 0.25 m, before those that are not free are left out.
const MOST_PLACES: f64 = 2.5e6;
/// Likewise for other sensors than level scanners, whose views take more memory and time.
const MOST_ROUND: usize = 100_000;
/// Places that are looked round at before the next word on how far a search is.
const AT_ONCE: usize = 4096;
/// Two peaks are one within so many cells, and so many degrees.
const APART: (f64, f64) = (2.0, 8.0);

impl Search {
    /// Looks round at all free places of a world; `estimator` is the one that refines. A level scanner takes part with all its
    /// beams and needs [`Freedom::Planar`], as does a row that hangs upside down. What any other sensor sees is compared in steps of
    /// 5 degrees; its robot leans as `options` say.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] if the world has no free place or too many; the errors of [`presight_predict::Predictor::panoramas`] and
    /// [`presight_predict::Predictor::batch`].
    pub fn new(estimator: &mut Estimator, world: &World, sensor: &Sensor, options: SearchOptions) -> Result<Self> {
        Self::watched(estimator, world, sensor, options, &mut |_, _| ())
    }

    /// [`Search::new`], which calls `watch` with the number of places so far and of all as it looks round.
    ///
    /// # Errors
    /// Those of [`Search::new`].
    pub fn watched(
        estimator: &mut Estimator,
        world: &World,
        sensor: &Sensor,
        options: SearchOptions,
        watch: &mut dyn FnMut(usize, usize),
    ) -> Result<Self> {
        options.check()?;
        let planar = estimator.options.freedom == Freedom::Planar;
        let mount = &sensor.spec().mount;
        let is_scanner = matches!(sensor.spec().geometry, Geometry::Scanner(_));
        let is_upright = is_scanner && is_level(mount) && options.lean == [0.0; 2];
        if is_upright && !planar && sensor.height() == 1 {
            return Err(Error::usage("an unknown start with six numbers", "give an estimator of Freedom::Planar"));
        }
        let level_from_sensor = options.lean() * *mount;
        let (model_sigma, dependence) = (estimator.options.model_sigma, options.beam_dependence);
        let row = |sensor| PoseLikelihood::new(sensor, level_from_sensor.rotation, world, model_sigma, dependence);
        let row = (is_scanner && planar).then(|| row(sensor)).transpose()?.filter(PoseLikelihood::is_level);
        let (views, likelihood) = if let Some(row) = row {
            let headings = Headings::new(row.scanner(), headings_of(sensor, options.headings))?;
            let places = grid(world, options.floor + level_from_sensor.translation.z, &options)?;
            let mut panoramas = estimator.predictor.panoramas(world, &headings, Vec::new())?;
            for (k, part) in places.chunks(AT_ONCE).enumerate() {
                watch(k * AT_ONCE, places.len());
                let mut more = estimator.predictor.panoramas(world, &headings, part.to_vec())?;
                more.retain(|range| options.is_free(range));
                panoramas.append(more);
            }
            (Views::Level(panoramas), row)
        } else {
            let likelihood = PoseLikelihood::of_image(sensor, world, model_sigma, dependence)?;
            (Views::Round(round_views(estimator, world, sensor, &options, watch)?), likelihood)
        };
        let search = Self { options, views, likelihood, level_from_sensor: level_from_sensor.rotation };
        if search.places().is_empty() {
            let what = format!("the map has no free place at {} m", options.floor + sensor.spec().mount.translation.z);
            return Err(Error::usage(
                what,
                "give another `SearchOptions::floor`, a larger `SearchOptions::margin` or a pose to start from",
            ));
        }
        Ok(search)
    }

    /// Free places of the sensor.
    pub fn places(&self) -> &[DVec3] {
        match &self.views {
            Views::Level(panoramas) => panoramas.places(),
            Views::Round(views) => &views.places,
        }
    }

    /// The best distinct places for a frame, refined, the likeliest first. None if the frame has no reading.
    ///
    /// # Errors
    /// Those of [`presight_predict::batch::RangeLikelihood::new`] and of [`Estimator::estimate`].
    pub fn candidates(&self, estimator: &mut Estimator, world: &World, frame: &Frame) -> Result<Vec<Candidate>> {
        let mut found: Vec<Candidate> = Vec::new();
        for prior in self.starts(estimator, world, frame)? {
            let estimate = estimator.refine(world, frame, &prior)?;
            let (pose, explained, odds) = (estimate.pose, estimate.explained, Odds::of(0.0, 0.0));
            found.push(Candidate { pose, log_likelihood: 0.0, explained, frames: 1, estimate, odds });
        }
        let logs = self.weigh(estimator, world, frame, &found)?;
        found.iter_mut().zip(logs).for_each(|(c, log)| c.log_likelihood = log);
        Ok(distinct(found))
    }

    /// The robot at the places and headings that fit a frame best, as wide as these are apart.
    fn starts(&self, estimator: &mut Estimator, world: &World, frame: &Frame) -> Result<Vec<PoseEstimate>> {
        let known = estimator.reflectors(world, frame);
        let SearchOptions { cell, candidates: most, .. } = self.options;
        let robot_from_sensor = self.likelihood.scanner().spec().mount.inverse();
        let arm = robot_from_sensor.translation.truncate().length();
        let prior = |sensor: Pose, turn: f64| {
            PoseEstimate::of_sigmas(RobotPose::new(sensor * robot_from_sensor), 0.5 * cell + turn * arm, turn)
        };
        let predictor = &mut estimator.predictor;
        match &self.views {
            Views::Level(panoramas) => {
                let headings = panoramas.headings();
                let turn = std::f64::consts::TAU / f64::from(headings.count());
                let Some(sensed) = self.likelihood.of(frame, PoseCell { side: cell, turn })? else {
                    return Ok(Vec::new());
                };
                let mut weights = predictor.weigh_panoramas(panoramas, &sensed)?;
                // A heading of the panorama is where the sensor's x axis points.
                let own = DQuat::from_rotation_z(-heading_of(self.level_from_sensor)) * self.level_from_sensor;
                if let Some(seen) = SeenReflectors::of(frame, own, &known)? {
                    let places = panoramas.places().par_iter().zip(weights.par_chunks_mut(headings.count() as usize));
                    let add = |(place, logs): (&DVec3, &mut [f32])| seen.add_to(logs, place.truncate(), cell);
                    predictor.on_threads(|| places.for_each(add))?;
                }
                let found = peaks(panoramas.places(), headings.count() as usize, &weights, most, cell);
                let pose = |(place, heading): (usize, u32)| {
                    let pose = headings.pose(panoramas.places()[place], heading);
                    Pose { rotation: pose.world_from_sensor().rotation * own, ..pose.world_from_sensor() }
                };
                Ok(found.into_iter().map(|peak| prior(pose(peak), turn)).collect())
            }
            Views::Round(views) => {
                let frame = self.likelihood.thinned(frame)?;
                if frame.ranges().iter().all(|r| !r.is_finite()) {
                    return Ok(Vec::new());
                }
                let sigma = self.likelihood.scanner().spec().noise.range_sigma;
                let weights = views.weigh(predictor, &frame, sigma, cell)?;
                let found = peaks(&views.places, HEADINGS, &weights, most, cell);
                Ok(found.into_iter().map(|(place, heading)| prior(views.pose(place, heading), STEP)).collect())
            }
        }
    }

    /// Log-likelihoods of a frame at candidates whose estimates are of this frame: by its ranges, and by the reflectors that they explain.
    fn weigh(
        &self,
        estimator: &mut Estimator,
        world: &World,
        frame: &Frame,
        candidates: &[Candidate],
    ) -> Result<Vec<f64>> {
        let poses = candidates.iter().map(|c| c.pose.world_from_robot);
        let logs = self.likelihood.at(&mut estimator.predictor, world, frame, poses)?;
        let of_reflectors = |c: &Candidate| ODDS * c.estimate.reflectors.0 as f64;
        Ok(logs.into_iter().zip(candidates).map(|(log, c)| log + of_reflectors(c)).collect())
    }
}

impl SearchOptions {
    fn check(&self) -> Result<()> {
        let positive = |x: f64| x > 0.0 && x.is_finite();
        let (above, finite) = ("give a finite number above 0", "give a finite number");
        for (name, value, is_sound, remedy) in [
            ("cell", self.cell, positive(self.cell), above),
            ("headings", f64::from(self.headings), self.headings > 0, above),
            ("floor", self.floor, self.floor.is_finite(), finite),
            ("floor_to", self.floor_to, self.floor_to.is_finite(), finite),
            ("margin", self.margin, self.margin == 0.0 || positive(self.margin), "give a finite number of at least 0"),
            ("lean", self.lean[0], self.lean[0].is_finite(), finite),
            ("lean", self.lean[1], self.lean[1].is_finite(), finite),
            ("clearance", self.clearance, positive(self.clearance), above),
            ("surrounded", self.surrounded, (0.0..=1.0).contains(&self.surrounded), "give a share of 0 to 1"),
            ("candidates", self.candidates as f64, self.candidates > 0, above),
            ("beam_dependence", self.beam_dependence, positive(self.beam_dependence), above),
        ] {
            if !is_sound {
                return Err(Error::usage(format!("`SearchOptions::{name}` is {value}"), remedy));
            }
        }
        Ok(())
    }

    fn lean(&self) -> Pose {
        Pose::from_xyz_rpy(DVec3::ZERO, self.lean[0], self.lean[1], 0.0)
    }

    /// True if nothing is too near, and something is met in enough directions.
    fn is_free(&self, range: &[f32]) -> bool {
        let met = range.iter().filter(|r| !(**r == f32::INFINITY)).count() as f64;
        let clear = range.iter().all(|r| f64::from(*r) >= self.clearance || r.is_nan());
        clear && met >= self.surrounded * range.len() as f64
    }
}

/// Looks round at the places of the sensor, at all heights of the robot.
fn round_views(
    estimator: &mut Estimator,
    world: &World,
    sensor: &Sensor,
    options: &SearchOptions,
    watch: &mut dyn FnMut(usize, usize),
) -> Result<RoundViews> {
    let level_from_sensor = options.lean() * sensor.spec().mount;
    let steps = ((options.floor_to - options.floor) / options.cell).max(0.0).floor();
    if !(steps < MOST_ROUND as f64) {
        return Err(Error::usage(format!("an unknown start at {steps} heights"), "give a wider cell"));
    }
    let mut places = Vec::new();
    for k in 0..=steps as u32 {
        let height = options.floor + f64::from(k) * options.cell + level_from_sensor.translation.z;
        places.extend(grid(world, height, options)?);
        if places.len() > MOST_ROUND {
            let what = format!("an unknown start among more than {MOST_ROUND} places");
            return Err(Error::usage(what, "give a wider cell, fewer heights, or a pose to start from"));
        }
    }
    let is_free = |range: &[f32]| options.is_free(range);
    RoundViews::new(&mut estimator.predictor, world, sensor, places, level_from_sensor.rotation, is_free, watch)
}

/// Candidates, the likeliest first, without those that came to rest where a likelier one did.
pub fn distinct(mut found: Vec<Candidate>) -> Vec<Candidate> {
    found.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in found {
        if kept.iter().all(|k| !is_same(&k.pose.world_from_robot, &candidate.pose.world_from_robot)) {
            kept.push(candidate);
        }
    }
    kept
}

/// Within what one estimate is off from the next.
pub fn is_same(a: &Pose, b: &Pose) -> bool {
    (a.translation - b.translation).length() < 0.3 && a.rotation.angle_between(b.rotation) < 0.1
}

/// The largest number of headings up to `most` that divides the beams of a full turn; `most` if that is less than half of it.
fn headings_of(sensor: &Sensor, most: u32) -> u32 {
    let Geometry::Scanner(scanner) = &sensor.spec().geometry else { return most };
    let beams = (360.0 / scanner.azimuth.mean_step().abs()).round().clamp(1.0, 1e6) as u32;
    let least = most.min(beams).div_ceil(2);
    (least..=most).rev().find(|n| beams.is_multiple_of(*n)).unwrap_or(most)
}

/// Places over the bounds of the world and the margin around them, a cell apart.
fn grid(world: &World, height: f64, options: &SearchOptions) -> Result<Vec<DVec3>> {
    let SearchOptions { cell, margin, .. } = *options;
    let bounds = world.environment().bounds();
    if bounds.is_empty() {
        return Err(Error::usage("an unknown start in a map without a polygon", "give a map"));
    }
    let least = bounds.min - DVec3::splat(margin);
    let size = bounds.max + DVec3::splat(margin) - least;
    let (nx, ny) = ((size.x / cell).ceil(), (size.y / cell).ceil());
    if !(nx * ny <= MOST_PLACES) {
        let what = format!("an unknown start among {nx} x {ny} places");
        return Err(Error::usage(what, "give a wider cell, or a pose to start from"));
    }
    let at = |i: u32, j: u32| {
        DVec3::new(least.x + (f64::from(i) + 0.5) * cell, least.y + (f64::from(j) + 0.5) * cell, height)
    };
    Ok((0..ny as u32).flat_map(|j| (0..nx as u32).map(move |i| at(i, j))).collect())
}

/// The best place and heading, then the best that is apart from it, and so on.
fn peaks(places: &[DVec3], count: usize, weights: &[f32], most: usize, cell: f64) -> Vec<(usize, u32)> {
    let at = |place: usize, heading: usize| weights[place * count + heading % count];
    let mut found: Vec<(f32, usize, usize)> = Vec::new();
    for place in 0..places.len() {
        for heading in 0..count {
            let here = at(place, heading);
            if here >= at(place, heading + 1) && here > at(place, heading + count - 1) {
                found.push((here, place, heading));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let mut kept: Vec<(usize, u32)> = Vec::new();
    for (_, place, heading) in found {
        if kept.len() == most {
            break;
        }
        let apart = |(p, h): &(usize, u32)| {
            let metres = (places[*p] - places[place]).length();
            let steps = (heading as i64 - i64::from(*h)).rem_euclid(count as i64);
            let degrees = 360.0 * steps.min(count as i64 - steps) as f64 / count as f64;
            metres > APART.0 * cell || degrees > APART.1
        };
        if kept.iter().all(apart) {
            kept.push((place, heading as u32));
        }
    }
    kept
}
