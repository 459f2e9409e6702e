//! The rivals of a pose: what a frame says of places of the map where the robot is not.
//!
//! Odds are differences of evidence in units of the scale of wrong places ([`Null::scale`]), by which each is tempered for
//! readings that depend on each other: the lead of a wrong map's best place over its next ones is exponential with it.

use super::evidence::{FrameEvidence, MapRanges, View};
use super::likelihood::{PoseLikelihood, heading_of};
use super::odds::{Details, Null, Piece, piece_at};
use super::search::is_same;
use crate::estimate::{Estimator, Freedom};
use glam::{DQuat, DVec3};
use presight_model::error::Result;
use presight_model::geometry::{Pose, PoseEstimate, RobotPose, SensorPose};
use presight_model::measured::Frame;
use presight_model::random::SplitMix64;
use presight_model::sensor::SensorSpec;
use presight_model::world::World;
use std::f64::consts::TAU;

/// Deviation by which places are distinguished, metres: the usual error of moved goods and old walls.
const PLACE: f64 = 0.06;
/// The same deviation for neighbouring minima: with more, moved goods drag the pose along.
const MINIMUM: f64 = 0.02;
/// Places of a level scanner of one row, each at all headings, and poses of other sensors, whose views take more time.
const RIVALS: (usize, usize) = (512, 192);
/// Beams that sort the headings of a place, headings, and bins of the ranges by which they are looked up.
const SORTED_BY: (usize, usize, usize) = (90, 90, 600);
/// Directions of a view all round.
const ROUND: usize = 360;
/// Draws for each rival: some are in walls or outside.
const DRAWS: usize = 4;
/// Rivals that are refined.
const REFINED: usize = 16;
/// What a place within reach of a refinement is off by: the deviation by which they are sorted, and the prior, metres
/// and radians.
const NEAR: (f64, f64, f64) = (0.3, 0.25, 0.1);
/// Rivals that are refined are farther apart, metres and radians.
const DISTINCT: (f64, f64) = (0.5, 0.2);
/// A place is free if nothing is nearer, metres, and inside if this share of the beams meets something.
const FREE: (f64, f64) = (0.15, 0.35);
/// Frames after which the rivals are renewed at the latest: a renewal costs as much as 30 updates, so 0.6 of an update a frame.
const LASTING: usize = 50;

/// Places of a map, drawn at random, as a sensor would see them.
#[derive(Clone, Debug)]
pub(super) struct Rivals {
    /// The sensor's.
    spec: SensorSpec,
    world: u64,
    evidence: FrameEvidence,
    map: MapRanges,
    /// Poses of the robot; for views all round, of the scanner at heading 0.
    poses: Vec<Pose>,
    views: Vec<View>,
    /// The views are all round: the robot in its scanner, and how the scanner stands at heading 0.
    round: Option<(Pose, DQuat)>,
    null: Option<Null>,
    age: usize,
}

impl Rivals {
    /// Draws places at the height and lean of a robot.
    ///
    /// # Errors
    /// Those of [`FrameEvidence::views`].
    pub fn new(estimator: &mut Estimator, world: &World, frame: &Frame, robot: &Pose) -> Result<Self> {
        let (sensor, model_sigma) = (frame.sensor(), estimator.options.model_sigma);
        let level_from_sensor = robot.rotation * sensor.spec().mount.rotation;
        let is_row = sensor.height() == 1 && !sensor.is_camera();
        let planar = is_row && estimator.options.freedom == Freedom::Planar;
        let pixels = if planar {
            PoseLikelihood::new(sensor, level_from_sensor, world, model_sigma, 1.0)?
        } else {
            PoseLikelihood::of_image(sensor, world, model_sigma, 1.0)?
        };
        let evidence = FrameEvidence::new(pixels, frame);
        let is_round = planar && evidence.pixels().is_level();
        let count = if is_round { RIVALS.0 } else { RIVALS.1 };
        let bounds = world.environment().bounds();
        let all_round = evidence.pixels().all_round(ROUND)?;
        let own = DQuat::from_rotation_z(-heading_of(level_from_sensor)) * level_from_sensor;
        let (height, mut random) = (
            evidence.pixels().of_sensor(std::iter::once(*robot))[0].world_from_sensor().translation.z,
            SplitMix64(0x71a1),
        );
        let leaning = DQuat::from_rotation_z(-heading_of(robot.rotation)) * robot.rotation;
        let mut draw = || {
            let [x, y, turn] = [random.unit(), random.unit(), random.unit()];
            let at = bounds.min + (bounds.max - bounds.min) * DVec3::new(x, y, 0.0);
            if is_round {
                return Pose { translation: at.with_z(height), ..Pose::IDENTITY };
            }
            let rotation = DQuat::from_rotation_z(TAU * turn) * leaning;
            Pose { translation: at.with_z(robot.translation.z), rotation }
        };
        let (mut poses, mut views, mut drawn) = (Vec::new(), Vec::new(), 0);
        while drawn < DRAWS * count && poses.len() < count && !bounds.is_empty() {
            let more: Vec<Pose> = (0..count - poses.len()).map(|_| draw()).collect();
            drawn += more.len();
            let seen = if is_round {
                let poses: Vec<SensorPose> = more.iter().copied().map(SensorPose::new).collect();
                estimator.predictor.range_views(world, &all_round, &poses)?
            } else {
                evidence.views(&mut estimator.predictor, world, &more)?
            };
            for (pose, view) in more.into_iter().zip(seen).filter(|(_, view)| is_free(&view[0])) {
                poses.push(pose);
                views.push(view);
            }
        }
        let round = is_round.then(|| (sensor.spec().mount.inverse(), own));
        let reach = evidence.pixels().scanner().spec().range_max;
        let map = MapRanges::new(views.iter().flat_map(|view| view[0].iter().copied()), reach);
        let spec = sensor.spec().clone();
        let world = world.stamp();
        Ok(Self { spec, world, evidence, map, poses, views, round, null: None, age: 0 })
    }

    /// True if they serve for a frame.
    pub fn serve(&self, world: &World, frame: &Frame) -> bool {
        self.world == world.stamp() && &self.spec == frame.sensor().spec()
    }

    /// Evidence of a frame at poses of the robot, as places.
    ///
    /// # Errors
    /// Those of [`FrameEvidence::views`].
    pub fn of_places(
        &self,
        estimator: &mut Estimator,
        world: &World,
        frame: &Frame,
        poses: &[Pose],
    ) -> Result<Vec<f64>> {
        self.weigh(estimator, world, frame, poses, [MINIMUM, PLACE])
    }

    /// What a frame says of poses of the robot, as places.
    ///
    /// # Errors
    /// Those of [`FrameEvidence::views`].
    pub fn details(
        &self,
        estimator: &mut Estimator,
        world: &World,
        frame: &Frame,
        poses: &[Pose],
    ) -> Result<Vec<Details>> {
        let readings = self.evidence.pixels().readings(frame)?;
        let views = self.evidence.views(&mut estimator.predictor, world, poses)?;
        let sigmas = [MINIMUM, PLACE].map(|sigma| sigma.max(estimator.model_sigma()));
        let of = |readings: &[f32], view: &View| -> Vec<f64> {
            self.evidence.of_readings(&self.map, readings, view, sigmas).collect()
        };
        let one = |(pose, view): (&Pose, &View)| {
            let (logs, full) = (of(&readings, view), of(&view[0], view));
            let pieces = self.pieces(pose, view).zip(&logs).filter_map(|(piece, log)| Some((piece?, *log)));
            Details { evidence: logs.iter().sum(), full: full.iter().sum(), pieces: pieces.collect() }
        };
        Ok(poses.iter().zip(&views).map(one).collect())
    }

    /// The piece of the map that each reading should meet from a pose of the robot.
    fn pieces<'a>(&'a self, pose: &Pose, view: &'a View) -> impl Iterator<Item = Option<Piece>> + 'a {
        let scanner = self.evidence.pixels().scanner();
        let sensor = self.evidence.pixels().of_sensor(std::iter::once(*pose))[0].world_from_sensor();
        let (width, body) = (scanner.width() as usize, scanner.body_from_image());
        view[0].iter().enumerate().map(move |(i, range)| {
            let ray = scanner.ray((i % width) as u32, (i / width) as u32).filter(|_| range.is_finite())?;
            Some(piece_at(sensor.transform_point(body * ray * f64::from(*range))))
        })
    }

    /// Evidence of a frame at poses of the robot that are neighbouring minima.
    ///
    /// # Errors
    /// Those of [`FrameEvidence::views`].
    pub fn of_minima(
        &self,
        estimator: &mut Estimator,
        world: &World,
        frame: &Frame,
        poses: &[Pose],
    ) -> Result<Vec<f64>> {
        self.weigh(estimator, world, frame, poses, [MINIMUM; 2])
    }

    fn weigh(
        &self,
        estimator: &mut Estimator,
        world: &World,
        frame: &Frame,
        poses: &[Pose],
        least: [f64; 2],
    ) -> Result<Vec<f64>> {
        let readings = self.evidence.pixels().readings(frame)?;
        let views = self.evidence.views(&mut estimator.predictor, world, poses)?;
        let sigmas = least.map(|sigma| sigma.max(estimator.model_sigma()));
        Ok(self.evidence.of_views(&self.map, &readings, &views, sigmas))
    }

    /// Readings of a frame that count.
    ///
    /// # Errors
    /// Those of [`PoseLikelihood::readings`].
    pub fn readings(&self, frame: &Frame) -> Result<usize> {
        let told = |z: &&f32| !z.is_nan() && **z != f32::NEG_INFINITY;
        Ok(self.evidence.pixels().readings(frame)?.iter().filter(told).count())
    }

    /// What wrong places reach, without those where the robot is believed to be. It is looked at again if it is
    /// older than `oldest` frames.
    ///
    /// # Errors
    /// Those of [`Estimator::estimate`].
    pub fn null(
        &mut self,
        estimator: &mut Estimator,
        world: &World,
        frame: &Frame,
        own: &[Pose],
        oldest: usize,
    ) -> Result<Null> {
        self.age += 1;
        if let Some(null) = &self.null
            && self.age < LASTING.min(oldest)
        {
            return Ok(null.clone());
        }
        self.age = 0;
        let thin = self.evidence.pixels().thinned(frame)?;
        let mut ends: Vec<Pose> = Vec::new();
        for pose in self.promising(frame, estimator.model_sigma())? {
            let prior = PoseEstimate::of_sigmas(RobotPose::new(pose), NEAR.1, NEAR.2);
            ends.push(estimator.refine(world, &thin, &prior)?.pose.world_from_robot);
        }
        let logs = self.of_places(estimator, world, frame, &ends)?;
        let mut found: Vec<(f64, Pose)> = logs.into_iter().zip(ends).collect();
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut distinct: Vec<(f64, Pose)> = Vec::new();
        for (log, pose) in found {
            if own.iter().chain(distinct.iter().map(|(_, pose)| pose)).all(|other| !is_same(other, &pose)) {
                distinct.push((log, pose));
            }
        }
        let logs: Vec<f64> = distinct.iter().map(|(log, _)| *log).collect();
        let mut null = Null::new(&logs, self.readings(frame)?, self.null.as_ref());
        null.best_at = distinct.first().filter(|(log, _)| *log > 0.0).map(|(_, pose)| pose.translation);
        self.null = Some(null.clone());
        Ok(null)
    }

    /// The scale of wrong places, as they were looked at last.
    pub fn scale(&self) -> Option<f64> {
        self.null.as_ref().map(|null| null.scale)
    }

    /// Poses of the robot among the drawn ones that fit a frame best, apart from one another.
    fn promising(&self, frame: &Frame, model_sigma: f64) -> Result<Vec<Pose>> {
        let readings = self.evidence.pixels().readings(frame)?;
        let sigma = model_sigma.max(NEAR.0);
        let mut all: Vec<(f64, Pose)> = match &self.round {
            None => {
                let logs = self.evidence.of_views(&self.map, &readings, &self.views, [sigma; 2]);
                logs.into_iter().zip(self.poses.iter().copied()).collect()
            }
            Some((robot_from_scanner, own)) => {
                let headings = SORTED_BY.1;
                let logs = self.evidence.of_headings(&self.map, &readings, &self.views, sigma, SORTED_BY);
                let pose = |(i, log): (usize, f64)| {
                    let turn = TAU * (i % headings) as f64 / headings as f64;
                    let at = self.poses[i / headings].translation;
                    (log, Pose { translation: at, rotation: DQuat::from_rotation_z(turn) * *own } * *robot_from_scanner)
                };
                // Not all of them need a pose. A map without free places has none.
                let mut order: Vec<(usize, f64)> = logs.into_iter().enumerate().collect();
                let most = (64 * REFINED).min(order.len());
                if let Some(last) = most.checked_sub(1) {
                    order.select_nth_unstable_by(last, |a, b| b.1.total_cmp(&a.1));
                }
                order.into_iter().take(most).map(pose).collect()
            }
        };
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut found: Vec<Pose> = Vec::new();
        for (_, pose) in all {
            let apart = |other: &Pose| {
                (other.translation - pose.translation).length() > DISTINCT.0
                    || other.rotation.angle_between(pose.rotation) > DISTINCT.1
            };
            if found.len() < REFINED && found.iter().all(apart) {
                found.push(pose);
            }
        }
        Ok(found)
    }

    /// Replaces what wrong places reach by what a search of the whole map found, the best first.
    pub fn searched(&mut self, wrong: &[f64], readings: usize) -> Null {
        let null = Null::new(wrong, readings, self.null.as_ref());
        self.age = 0;
        self.null = Some(null.clone());
        null
    }
}

/// True if nothing is too near, and something is met in enough directions.
fn is_free(range: &[f32]) -> bool {
    let met = range.iter().filter(|r| r.is_finite()).count() as f64;
    let clear = range.iter().all(|r| f64::from(*r) >= FREE.0 || r.is_nan());
    clear && met >= FREE.1 * range.len() as f64
}
