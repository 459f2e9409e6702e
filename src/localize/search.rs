//! Where a robot may be that nothing is known of: one scan weighed at all headings of all free places, and the best places refined.

use super::likelihood::PoseLikelihood;
use crate::batch::{Headings, Panoramas, PoseCell};
use crate::error::{Error, Result};
use crate::estimate::{Estimate, Estimator, Freedom, Prior};
use crate::frame::Frame;
use crate::geometry::Pose;
use crate::matrix::Matrix;
use crate::row::is_level;
use crate::sensor::{Geometry, Sensor};
use crate::verdict::Verdicts;
use crate::world::World;
use glam::DVec3;

/// How a [`Search`] looks for a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchOptions {
    /// Distance between neighbouring places, metres.
    pub cell: f64,
    /// Most headings of a place.
    pub headings: u32,
    /// Height of the robot's frame, metres.
    pub floor: f64,
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
            clearance: 0.25,
            surrounded: 0.5,
            candidates: 40,
            beam_dependence: 20.0,
        }
    }
}

/// A place where the robot may be.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// world_from_robot.
    pub pose: Pose,
    /// x y z, then rotation about fixed x y z, world axes; metres and radians.
    pub covariance: Matrix,
    /// Log-likelihood of all frames so far, tempered for beams that depend on each other. Only differences mean something.
    pub log_likelihood: f64,
    /// Share of the readings that end where they should, within 3.3 standard deviations of range and model together, in the mean
    /// over the frames.
    pub explained: f64,
    /// Frames that it was compared with.
    pub frames: usize,
    /// What the estimator said of the latest frame.
    pub(crate) estimate: Estimate,
}

/// The free places of one version of a world, and what a scanner sees from them.
#[derive(Clone, Debug)]
pub struct Search {
    options: SearchOptions,
    panoramas: Panoramas,
    likelihood: PoseLikelihood,
}

/// A reading is explained up to so many standard deviations.
const EXPLAINED: f64 = 3.3;
/// Most places of a search: 16 hectares in cells of 0.25 m, before those that are not free are left out.
const MOST_PLACES: f64 = 2.5e6;
/// Two peaks are one within so many cells, and so many degrees.
const APART: (f64, f64) = (2.0, 8.0);

impl Search {
    /// Looks round at all free places of a world. The sensor is a level scanner, `estimator` the one that refines.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] if the sensor is no level scanner in equal steps, if the world has no free place or too many;
    /// those of [`crate::Predictor::panoramas`].
    pub fn new(estimator: &mut Estimator, world: &World, sensor: &Sensor, options: SearchOptions) -> Result<Self> {
        options.check()?;
        if !is_level(&sensor.spec().mount) {
            return Err(Error::usage("an unknown start with a sensor that leans", "give a pose to start from"));
        }
        if estimator.options.freedom != Freedom::Planar {
            return Err(Error::usage("an unknown start with six numbers", "give an estimator of Freedom::Planar"));
        }
        let likelihood = PoseLikelihood::new(sensor, estimator.options.model_sigma, options.beam_dependence)?;
        let headings = Headings::new(likelihood.scanner(), headings_of(sensor, options.headings))?;
        let places = grid(world, options.floor + sensor.spec().mount.translation.z, options.cell)?;
        let mut panoramas = estimator.predictor.panoramas(world, &headings, places)?;
        panoramas.retain(|range| {
            let met = range.iter().filter(|r| !(**r == f32::INFINITY)).count() as f64;
            let clear = range.iter().all(|r| f64::from(*r) >= options.clearance || r.is_nan());
            clear && met >= options.surrounded * range.len() as f64
        });
        if panoramas.places().is_empty() {
            let what = format!("the map has no free place at {} m", options.floor + sensor.spec().mount.translation.z);
            return Err(Error::usage(what, "give the height of the floor, or a pose to start from"));
        }
        Ok(Self { options, panoramas, likelihood })
    }

    /// Free places of the sensor.
    pub fn places(&self) -> &[DVec3] {
        self.panoramas.places()
    }

    /// The best distinct places for a frame, refined, the likeliest first. None if the frame has no reading.
    ///
    /// # Errors
    /// Those of [`RangeLikelihood::new`] and of [`Estimator::estimate`].
    pub fn candidates(&self, estimator: &mut Estimator, world: &World, frame: &Frame) -> Result<Vec<Candidate>> {
        let headings = self.panoramas.headings();
        let turn = std::f64::consts::TAU / f64::from(headings.count());
        let cell = PoseCell { side: self.options.cell, turn };
        let Some(sensed) = self.likelihood.of(frame, cell)? else { return Ok(Vec::new()) };
        let weights = estimator.predictor.weigh_panoramas(&self.panoramas, &sensed)?;
        let robot_from_sensor = self.likelihood.scanner().spec().mount.inverse();
        let mut found: Vec<Candidate> = Vec::new();
        for (place, heading) in peaks(&self.panoramas, &weights, self.options.candidates, self.options.cell) {
            let pose = headings.pose(self.panoramas.places()[place], heading) * robot_from_sensor;
            let arm = robot_from_sensor.translation.truncate().length();
            let prior = Prior::of_sigmas(pose, 0.5 * self.options.cell + turn * arm, turn);
            let estimate = estimator.refine(world, frame, &prior)?;
            let (pose, covariance, explained) = (estimate.pose, estimate.covariance, self.explained(frame, &estimate));
            found.push(Candidate { pose, covariance, log_likelihood: 0.0, explained, frames: 1, estimate });
        }
        let logs = self.weigh(estimator, world, frame, found.iter().map(|c| c.pose))?;
        found.iter_mut().zip(logs).for_each(|(c, log)| c.log_likelihood = log);
        Ok(distinct(found))
    }

    /// Log-likelihoods of a frame at poses of the robot.
    pub(crate) fn weigh(
        &self,
        estimator: &mut Estimator,
        world: &World,
        frame: &Frame,
        poses: impl Iterator<Item = Pose>,
    ) -> Result<Vec<f64>> {
        self.likelihood.at(&mut estimator.predictor, world, frame, poses)
    }

    /// Share of the readings of a frame that end where an estimate's prediction does.
    pub(crate) fn explained(&self, frame: &Frame, estimate: &Estimate) -> f64 {
        let within = EXPLAINED * self.likelihood.scanner().spec().noise.range_sigma;
        let near = |v: &Verdicts| v.difference.iter().filter(|d| f64::from(d.abs()) <= within).count();
        let readings = frame.ranges().iter().filter(|r| r.is_finite()).count();
        estimate.verdicts.iter().map(near).sum::<usize>() as f64 / readings.max(1) as f64
    }
}

impl SearchOptions {
    fn check(&self) -> Result<()> {
        let lengths = [self.cell, self.clearance, self.beam_dependence];
        let sound = lengths.iter().all(|l| *l > 0.0 && l.is_finite()) && self.floor.is_finite();
        if !sound || self.headings == 0 || self.candidates == 0 || !(0.0..=1.0).contains(&self.surrounded) {
            return Err(Error::usage(format!("{self:?}"), "give lengths and numbers above 0 and a share of 0 to 1"));
        }
        Ok(())
    }
}

/// Candidates, the likeliest first, without those that came to rest where a likelier one did.
pub(crate) fn distinct(mut found: Vec<Candidate>) -> Vec<Candidate> {
    found.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in found {
        if kept.iter().all(|k| !is_same(&k.pose, &candidate.pose)) {
            kept.push(candidate);
        }
    }
    kept
}

/// Within what one estimate is off from the next.
pub(crate) fn is_same(a: &Pose, b: &Pose) -> bool {
    (a.translation - b.translation).length() < 0.3 && a.rotation.angle_between(b.rotation) < 0.1
}

/// As many headings as divide the beams of a full turn, but no more than asked for. A scanner without such beams has one, and
/// [`Headings::new`] tells why that will not do.
fn headings_of(sensor: &Sensor, most: u32) -> u32 {
    let step = match &sensor.spec().geometry {
        Geometry::Scanner(scanner) if scanner.azimuth.len() > 1 => {
            scanner.azimuth.degrees(1) - scanner.azimuth.degrees(0)
        }
        _ => 360.0,
    };
    let beams = (360.0 / step.abs()).round().clamp(1.0, 1e6) as u32;
    (1..=most.min(beams)).rev().find(|n| beams.is_multiple_of(*n)).unwrap_or(1)
}

/// Places over the bounds of the world, a cell apart.
fn grid(world: &World, height: f64, cell: f64) -> Result<Vec<DVec3>> {
    let bounds = world.environment().bounds();
    if bounds.is_empty() {
        return Err(Error::usage("an unknown start in a map without a polygon", "give a map"));
    }
    let size = bounds.max - bounds.min;
    let (nx, ny) = ((size.x / cell).ceil(), (size.y / cell).ceil());
    if !(nx * ny <= MOST_PLACES) {
        let what = format!("an unknown start among {nx} x {ny} places");
        return Err(Error::usage(what, "give a wider cell, or a pose to start from"));
    }
    let at = |i: u32, j: u32| {
        DVec3::new(bounds.min.x + (f64::from(i) + 0.5) * cell, bounds.min.y + (f64::from(j) + 0.5) * cell, height)
    };
    Ok((0..ny as u32).flat_map(|j| (0..nx as u32).map(move |i| at(i, j))).collect())
}

/// The best place and heading, then the best that is apart from it, and so on.
fn peaks(panoramas: &Panoramas, weights: &[f32], most: usize, cell: f64) -> Vec<(usize, u32)> {
    let count = panoramas.headings().count() as usize;
    let at = |place: usize, heading: usize| weights[place * count + heading % count];
    let mut found: Vec<(f32, usize, usize)> = Vec::new();
    for place in 0..panoramas.places().len() {
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
            let metres = (panoramas.places()[*p] - panoramas.places()[place]).length();
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
