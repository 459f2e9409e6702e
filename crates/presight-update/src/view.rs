//! One view: what each kept pixel says of the first object on its ray, and what nothing explains.

use crate::joint::Terms;
use crate::priors::Priors;
use crate::pulled::Pulled;
use crate::register::Readings;
use crate::voxels::Spot;
use glam::DVec3;
use presight_localize::verdict::body_from_image;
use presight_model::caster::{RayCaster, RayHit};
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate};
use presight_model::matrix::{quadratic, scaled};
use presight_model::measured::{Frame, RangeNoise};
use presight_model::sensor::Sensor;
use presight_model::statistics::median;
use std::sync::Arc;

/// Noise explains differences up to this number of standard deviations: all but 1 in 1,000 Gaussian ones.
pub(crate) const BOUND: f64 = 3.3;
/// A surface that is met flatter than this says too little, cosine.
pub(crate) const FLATTEST: f64 = 0.1;
/// The median of absolute standard normal deviates.
const MEDIAN: f64 = 0.6745;
/// Residuals beyond this number of stated deviations are changes and say nothing of the pose.
const CHANGED: f64 = 20.0;
/// The error of a pose may be this number of times the stated one. The readings pull the pose no farther to the model.
const MOST_SPREAD: f64 = 4.0;
/// Most readings that a pose is estimated from.
const MOST_READINGS: usize = 2000;
/// No object: nothing is predicted.
pub(crate) const NOTHING: u32 = u32::MAX;
/// A reading beyond this share of the reach may be none.
const REACH: f64 = 0.95;

/// What a kept pixel says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Says {
    /// Nothing: no reading.
    Nothing,
    /// The first object is there, and without it another range would be measured.
    There,
    /// The ray passed through the first object.
    Through,
    /// Something else stands before all that is predicted.
    Before,
    /// About the same would be measured with and without the first object.
    Same,
    /// The ray went on, and runs near an edge of the first object, or flat along it.
    Edge,
}

/// The pixels of a sensor that are kept, with their rays in its image frame.
#[derive(Clone, Debug)]
pub(crate) struct Kept {
    pub sensor: Sensor,
    pub stride: u32,
    pub columns: u32,
    pub rays: Vec<DVec3>,
    /// Angle between neighbouring pixels of the sensor, radians.
    spacing: f64,
}

impl Kept {
    /// Keeps about `most` pixels: every n-th column, and row of a sensor with more than 64.
    pub fn new(sensor: &Sensor, most: usize) -> Self {
        let (width, height) = (sensor.distinct_columns(), sensor.height());
        let both = height > 64;
        let ratio = f64::from(width) * f64::from(height) / most.max(1) as f64;
        let stride = if both { ratio.sqrt().ceil() } else { ratio.ceil() }.max(1.0) as u32;
        let rows = if both { stride } else { 1 };
        let (columns, mut rays) = (width.div_ceil(stride), Vec::new());
        for row in (0..height).step_by(rows as usize) {
            rays.extend((0..width).step_by(stride as usize).map(|c| sensor.ray(c, row).unwrap_or(DVec3::NAN)));
        }
        let (c, r) = (width / 2, height / 2);
        let apart = |a: Option<DVec3>, b: Option<DVec3>| a.zip(b).map_or(0.0, |(a, b)| a.angle_between(b));
        let spacing = apart(sensor.ray(c, r), sensor.ray(c.saturating_sub(1), r));
        Self { sensor: sensor.clone(), stride, columns, rays, spacing }
    }

    fn rows(&self) -> u32 {
        if self.sensor.height() > 64 { self.stride } else { 1 }
    }

    /// The sensor's pixel of a kept one.
    pub fn pixel(&self, kept: usize) -> (u32, u32) {
        let (c, r) = (kept as u32 % self.columns, kept as u32 / self.columns);
        (c * self.stride, r * self.rows())
    }

    /// The kept pixel nearest to a direction of the image frame.
    pub fn nearest(&self, p_in_image: DVec3) -> Option<usize> {
        let (u, v) = self.sensor.project(p_in_image)?;
        let (u, v) = ((u / f64::from(self.stride)).round(), (v / f64::from(self.rows())).round());
        let at = (u >= 0.0 && v >= 0.0 && u < f64::from(self.columns))
            .then(|| (v as usize) * self.columns as usize + u as usize)?;
        (at < self.rays.len()).then_some(at)
    }
}

/// A frame that counts as a view, compared with a world.
#[derive(Clone, Debug)]
pub(crate) struct View {
    pub stamp: f64,
    /// The number of the drive, from 0.
    pub drive: usize,
    pub world_from_image: Pose,
    pub kept: Arc<Kept>,
    pub noise: RangeNoise,
    /// Measured ranges of the kept pixels, metres.
    pub ranges: Vec<f32>,
    /// The first object on each ray.
    pub object: Vec<u32>,
    pub says: Vec<Says>,
    /// Standard deviations of the sensor's place and rotation, stated times the spread: metres, radians.
    pub off: (f64, f64),
    /// How far the readings pulled the pose.
    pub pulled: Pulled,
    /// What its readings say of how objects stand, if poses of objects are uncertain.
    pub terms: Option<Terms>,
    /// Points that nothing explains, world frame.
    pub news: Vec<DVec3>,
    /// Pixels with a reading where something is predicted, and the number of them that it explains.
    pub compared: (usize, usize),
}

/// A pixel's ray, and its first surface.
struct Ray {
    origin: DVec3,
    ray: DVec3,
    met: Option<RayHit>,
}

/// Compares frames with one world.
pub(crate) struct Observer<'a> {
    pub caster: &'a RayCaster,
    pub priors: &'a Priors,
    /// Views that may share one error of their poses.
    pub views: usize,
    /// Points nearer than this to a surface of the model belong to it, metres.
    pub known: f64,
}

/// How the range of a surface errs.
struct Errors<'a> {
    noise: RangeNoise,
    pose: &'a PoseEstimate,
    spread: f64,
    priors: &'a Priors,
}

impl Errors<'_> {
    /// Standard deviation by which the pose's error shifts a point across a ray, metres.
    fn aside(&self, x: DVec3, ray: DVec3) -> f64 {
        let u = ray.any_orthonormal_vector();
        let arm = x - self.pose.world_from_robot.translation;
        let variance = |u: DVec3| {
            let turned = arm.cross(u);
            quadratic(self.pose.covariance.as_rows(), &[u.x, u.y, u.z, turned.x, turned.y, turned.z]).max(0.0)
        };
        self.spread * (variance(u) + variance(ray.cross(u))).sqrt()
    }

    /// Standard deviation of a range on a surface, metres.
    fn sigma(&self, origin: DVec3, ray: DVec3, met: &RayHit) -> f64 {
        let x = origin + met.range * ray;
        let turned = (x - self.pose.world_from_robot.translation).cross(met.normal);
        let gradient = [met.normal.x, met.normal.y, met.normal.z, turned.x, turned.y, turned.z];
        let by_pose = quadratic(self.pose.covariance.as_rows(), &gradient).max(0.0) * self.spread.powi(2);
        let cos = met.normal.dot(ray).abs().max(FLATTEST);
        let across = met.range * self.noise.angle * (1.0 - cos * cos).max(0.0).sqrt() / cos;
        let along = self.noise.range_sigma(met.range);
        let surface = self.priors.variance(met.object, x, met.normal);
        (along * along + across * across + (by_pose + surface) / (cos * cos)).sqrt()
    }
}

/// What a frame holds, whatever its pose.
struct Shot<'a> {
    kept: &'a Kept,
    ranges: Vec<f32>,
    robot_from_image: Pose,
    noise: RangeNoise,
    reach: f64,
}

impl<'a> Shot<'a> {
    fn of(frame: &Frame, kept: &'a Kept) -> Self {
        let sensor = frame.sensor();
        let width = sensor.width() as usize;
        let range = |at: usize| {
            let (c, r) = kept.pixel(at);
            frame.ranges()[r as usize * width + c as usize]
        };
        Self {
            kept,
            ranges: (0..kept.rays.len()).map(range).collect(),
            robot_from_image: sensor.spec().mount * body_from_image(sensor),
            noise: RangeNoise::of(sensor),
            reach: sensor.spec().range_max.min(1e5),
        }
    }

    /// What every `step`-th ray meets from a pose.
    fn cast(&self, caster: &RayCaster, pose: &PoseEstimate, step: usize) -> Vec<Ray> {
        let world_from_image = pose.world_from_robot * self.robot_from_image;
        let cast = |ray: &DVec3| {
            let (origin, ray) = (world_from_image.translation, world_from_image.rotation * *ray);
            let met = if ray.is_nan() { None } else { caster.cast(origin, ray, self.reach, None) };
            Ray { origin, ray, met }
        };
        self.kept.rays.iter().step_by(step).map(cast).collect()
    }

    /// How many times the stated deviation of the pose explains the ranges.
    fn spread(&self, rays: &[Ray], step: usize, pose: &PoseEstimate, priors: &Priors) -> f64 {
        let errors = Errors { noise: self.noise, pose, spread: 1.0, priors };
        spread_of(rays, self.ranges.iter().step_by(step), &errors).min(MOST_SPREAD)
    }
}

impl Observer<'_> {
    /// The pose by a frame's readings, and their terms for the poses of objects.
    fn registered(&self, shot: &Shot<'_>, given: &PoseEstimate) -> (PoseEstimate, Option<Terms>) {
        // A part of the pixels knows the pose well enough.
        let step = shot.kept.rays.len().div_ceil(MOST_READINGS).max(1);
        let stated = shot.spread(&shot.cast(self.caster, given, step), step, given, self.priors);
        let covariance = PoseCovariance::from_rows(scaled(given.covariance.as_rows(), stated.powi(2)));
        let readings = Readings {
            caster: self.caster,
            robot_from_image: shot.robot_from_image,
            of: shot.kept.rays.iter().copied().zip(shot.ranges.iter().copied()).step_by(step).collect(),
            noise: shot.noise,
            reach: shot.reach,
            priors: self.priors,
        };
        let pose = readings.register(&PoseEstimate::new(given.robot(), covariance));
        let terms = (!self.priors.is_empty()).then(|| readings.terms(given, &pose, self.views));
        (pose, terms)
    }

    /// Compares a frame of a robot at a pose. Also returns what the rays of the kept pixels meet first.
    pub fn view(&self, frame: &Frame, kept: &Arc<Kept>, given: &PoseEstimate) -> (View, Vec<Option<RayHit>>) {
        let shot = Shot::of(frame, kept);
        let (pose, terms) = self.registered(&shot, given);
        let rays = shot.cast(self.caster, &pose, 1);
        let spread = shot.spread(&rays, 1, &pose, self.priors);
        let Shot { noise, reach, .. } = shot;
        let errors = Errors { noise, pose: &pose, spread, priors: self.priors };
        let sigmas = pose.covariance.sigmas();
        let norm = |of: &[f64]| spread * of.iter().map(|x| x * x).sum::<f64>().sqrt();
        let mut view = View {
            stamp: frame.stamp,
            drive: 0,
            world_from_image: pose.world_from_robot * shot.robot_from_image,
            kept: kept.clone(),
            noise,
            object: rays.iter().map(|ray| ray.met.map_or(NOTHING, |met| met.object)).collect(),
            says: vec![Says::Nothing; rays.len()],
            off: (norm(&sigmas[..3]), norm(&sigmas[3..])),
            pulled: Pulled::of(given, &pose),
            terms,
            news: Vec::new(),
            compared: (0, 0),
            ranges: shot.ranges,
        };
        for (at, ray) in rays.iter().enumerate() {
            let z = f64::from(view.ranges[at]);
            if ray.ray.is_nan() || z.is_nan() || z == f64::NEG_INFINITY {
                continue;
            }
            self.pixel(&mut view, at, ray, (z, reach), &errors);
            let is_news = matches!(view.says[at], Says::Before) && z.is_finite() && is_backed(frame, kept.pixel(at), z);
            let x = ray.origin + z * ray.ray;
            if is_news && self.caster.nearest(x, self.known.max(BOUND * errors.aside(x, ray.ray))).is_none() {
                view.news.push(x);
            } else if is_news {
                view.says[at] = Says::Nothing;
            }
        }
        (view, rays.into_iter().map(|ray| ray.met).collect())
    }

    fn pixel(&self, view: &mut View, at: usize, ray: &Ray, (z, reach): (f64, f64), errors: &Errors<'_>) {
        let Some(met) = &ray.met else {
            if z.is_finite() {
                view.says[at] = Says::Before;
            }
            return;
        };
        let sigma = errors.sigma(ray.origin, ray.ray, met);
        view.compared.0 += 1;
        if (z - met.range).abs() <= BOUND * sigma {
            view.compared.1 += 1;
            let second = self.caster.cast(ray.origin, ray.ray, reach, Some(met.object));
            if second.is_none_or(|s| s.range - met.range > 2.0 * BOUND * sigma + 0.05) {
                view.says[at] = Says::There;
            } else {
                view.says[at] = Says::Same;
            }
            return;
        }
        if z < met.range {
            view.says[at] = Says::Before;
            return;
        }
        // Nothing within reach says nothing of a surface near the end of the reach.
        let flat = met.normal.dot(ray.ray).abs() < FLATTEST;
        if z.is_infinite() && met.range > REACH * reach {
            return;
        }
        let aside = errors.aside(ray.origin + met.range * ray.ray, ray.ray) / met.range;
        let uncertain = BOUND * (aside + errors.noise.angle) + 1e-4;
        let before = z.min(reach) - BOUND * sigma;
        view.says[at] = Says::Edge;
        if flat || !self.is_whole(ray, met, uncertain, before) {
            return;
        }
        let second = self.caster.cast(ray.origin, ray.ray, reach, Some(met.object));
        if let Some(second) = second
            && z < second.range - BOUND * errors.sigma(ray.origin, ray.ray, &second)
        {
            // A beam that is split by an edge measures something in between, too.
            if self.is_whole(ray, met, uncertain.max(1.5 * view.kept.spacing), before) {
                view.says[at] = Says::Through;
                let x = ray.origin + z * ray.ray;
                if self.caster.nearest(x, self.known.max(BOUND * errors.aside(x, ray.ray))).is_none() {
                    view.news.push(x);
                }
            }
            return;
        }
        let is_apart = second.is_none_or(|s| s.range - met.range > 2.0 * BOUND * sigma);
        view.says[at] = if is_apart { Says::Through } else { Says::Same };
    }

    /// True if rays at an angle to this one, on four sides, meet the same object before `before` metres: then no error of the pose
    /// explains that the ray went on.
    fn is_whole(&self, ray: &Ray, met: &RayHit, angle: f64, before: f64) -> bool {
        let u = ray.ray.any_orthonormal_vector();
        let v = ray.ray.cross(u);
        [u, -u, v, -v].into_iter().all(|aside| {
            let beside = (ray.ray + angle.tan() * aside).normalize();
            let found = self.caster.cast(ray.origin, beside, before, None);
            found.is_some_and(|other| other.object == met.object)
        })
    }
}

/// By how much residuals are wider than stated, at least 1.
fn spread_of<'a>(rays: &[Ray], ranges: impl Iterator<Item = &'a f32>, stated: &Errors<'_>) -> f64 {
    let residual = |(ray, z): (&Ray, &f32)| {
        let met = ray.met?;
        let e = (f64::from(*z) - met.range).abs() / stated.sigma(ray.origin, ray.ray, &met);
        (e < CHANGED).then_some(e)
    };
    let mut all: Vec<f64> = rays.iter().zip(ranges).filter_map(residual).collect();
    if all.len() < 20 { 1.0 } else { (median(&mut all).unwrap_or(0.0) / MEDIAN).max(1.0) }
}

/// True if a neighbour has about the same range: a beam that is split by an edge stands alone. A post fills one column, a rail one row.
fn is_backed(frame: &Frame, (c, r): (u32, u32), z: f64) -> bool {
    let (width, height) = (frame.sensor().width(), frame.sensor().height());
    let range = |c: u32, r: u32| f64::from(frame.ranges()[r as usize * width as usize + c as usize]);
    let near = |c: u32, r: u32| c < width && r < height && (range(c, r) - z).abs() < 0.05 + 0.02 * z;
    near(c.wrapping_sub(1), r) || near(c + 1, r) || near(c, r.wrapping_sub(1)) || near(c, r + 1)
}

impl View {
    /// The measured point of a kept pixel, world frame; `None` without a finite reading.
    pub fn point(&self, at: usize) -> Option<DVec3> {
        let z = f64::from(self.ranges[at]);
        let ray = self.kept.rays[at];
        (z.is_finite() && !ray.is_nan()).then(|| self.world_from_image.transform_point(z * ray))
    }

    /// The measured points that no object but this one explains, world frame.
    pub fn unexplained(&self, object: u32) -> impl Iterator<Item = DVec3> {
        let explained =
            move |at: &usize| matches!(self.says[*at], Says::There | Says::Same) && self.object[*at] != object;
        (0..self.ranges.len()).filter(move |at| !explained(at)).filter_map(|at| self.point(at))
    }

    /// True if a ray passed through the place of a point of a voxel: it went on by more than the voxel, or it met what the model
    /// has behind that place, however near, such as the floor below somebody's feet.
    pub fn passed(&self, spot: &Spot, size: f64) -> bool {
        let p = self.world_from_image.inverse().transform_point(spot.mean);
        let distance = p.length();
        let Some(at) = self.kept.nearest(p) else { return false };
        let (ray, z) = (self.kept.rays[at], f64::from(self.ranges[at]));
        let aside = ray.dot(p) * ray - p;
        let is_known = matches!(self.says[at], Says::There | Says::Same);
        let beyond = if is_known { 0.0 } else { size };
        let margin = beyond + BOUND * (self.noise.range_sigma(distance) + self.off.0 + distance * self.off.1);
        let reach = REACH * self.kept.sensor.spec().range_max;
        z > distance + margin && distance < reach && spot.holds(self.world_from_image.rotation * aside)
    }
}
