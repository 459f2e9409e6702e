//! Compares frames with a world, pixel by pixel.

use crate::observe::mount::PoseCorrections;
use crate::observe::pixels::SampledPixels;
use crate::observe::priors::Priors;
use crate::observe::register::Readings;
use crate::observe::terms::Terms;
use crate::observe::view::{KNOWN, MIN_COSINE, NO_OBJECT, PixelEvidence, SAFE_REACH, View, reach_of};
use glam::DVec3;
use presight_localize::verdict::{ObjectError, body_from_image};
use presight_model::caster::{RayCaster, RayHit};
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate};
use presight_model::matrix::{quadratic, scaled};
use presight_model::measured::{Frame, RangeNoise};
use presight_model::statistics::{NOISE_BOUND, median};
use std::sync::Arc;

/// Median of the absolute value of a standard normal variable.
const NORMAL_MEDIAN: f64 = 0.6745;
/// Readings beyond this number of stated deviations show changes, and do not affect the pose.
const CHANGED: f64 = 20.0;
/// Maximum ratio of a pose's error to the stated one. The readings move the pose no farther towards the model.
const MAX_SPREAD: f64 = 4.0;
/// Minimum number of readings from which that ratio is estimated.
const MIN_READINGS: usize = 20;
/// Maximum number of readings from which a pose is estimated.
const MAX_READINGS: usize = 2000;

/// The ray of a pixel, and the first surface on it.
struct PixelRay {
    origin: DVec3,
    ray: DVec3,
    hit: Option<RayHit>,
}

/// Compares frames with one world.
pub(crate) struct Observer<'a> {
    pub caster: &'a RayCaster,
    pub priors: &'a Priors,
    /// Number of views that may share one error of their poses.
    pub views: usize,
}

/// The error model of predicted ranges.
struct RangeErrors<'a> {
    noise: RangeNoise,
    pose: &'a PoseEstimate,
    spread: f64,
    priors: &'a Priors,
}

impl RangeErrors<'_> {
    /// Standard deviation by which the pose's error shifts a point across a ray, metres.
    fn across(&self, x: DVec3, ray: DVec3) -> f64 {
        let u = ray.any_orthonormal_vector();
        self.spread * (self.pose_variance(x, u) + self.pose_variance(x, ray.cross(u))).sqrt()
    }

    /// Variance of a point along a direction by the stated covariance of the pose, square metres.
    fn pose_variance(&self, x: DVec3, along: DVec3) -> f64 {
        let gradient = ObjectError::gradient(self.pose.world_from_robot.translation, x, along);
        quadratic(self.pose.covariance.as_rows(), &gradient).max(0.0)
    }

    /// Standard deviation of the range to a surface, metres.
    fn sigma(&self, PixelRay { origin, ray, .. }: &PixelRay, hit: &RayHit) -> f64 {
        let x = *origin + hit.range * *ray;
        let by_pose = self.pose_variance(x, hit.normal) * self.spread.powi(2);
        let cos = hit.normal.dot(*ray).abs().max(MIN_COSINE);
        let across = hit.range * self.noise.angle * (1.0 - cos * cos).max(0.0).sqrt() / cos;
        let along = self.noise.range_sigma(hit.range);
        let surface = self.priors.variance(hit.object, x, hit.normal);
        (along * along + across * across + (by_pose + surface) / (cos * cos)).sqrt()
    }

    /// Ratio of the residuals to their stated deviations, at least 1.
    fn spread_of<'a>(&self, rays: &[PixelRay], ranges: impl Iterator<Item = &'a f32>) -> f64 {
        let residual = |(ray, z): (&PixelRay, &f32)| {
            let hit = ray.hit?;
            let e = (f64::from(*z) - hit.range).abs() / self.sigma(ray, &hit);
            (e < CHANGED).then_some(e)
        };
        let mut all: Vec<f64> = rays.iter().zip(ranges).filter_map(residual).collect();
        if all.len() < MIN_READINGS {
            return 1.0;
        }
        (median(&mut all).unwrap_or(0.0) / NORMAL_MEDIAN).clamp(1.0, MAX_SPREAD)
    }
}

/// The part of a frame that does not depend on its pose.
struct Shot<'a> {
    pixels: &'a SampledPixels,
    ranges: Vec<f32>,
    robot_from_image: Pose,
    noise: RangeNoise,
    reach: f64,
}

impl<'a> Shot<'a> {
    fn of(frame: &Frame, pixels: &'a SampledPixels) -> Self {
        let sensor = frame.sensor();
        let width = sensor.width() as usize;
        let range = |at: usize| {
            let (c, r) = pixels.pixel(at);
            frame.ranges()[r as usize * width + c as usize]
        };
        Self {
            pixels,
            ranges: (0..pixels.rays.len()).map(range).collect(),
            robot_from_image: sensor.spec().mount * body_from_image(sensor),
            noise: RangeNoise::of(sensor),
            reach: reach_of(sensor.spec()),
        }
    }

    /// Casts every `step`-th ray from a pose.
    fn cast(&self, caster: &RayCaster, pose: &PoseEstimate, step: usize) -> Vec<PixelRay> {
        let world_from_image = pose.world_from_robot * self.robot_from_image;
        let cast = |ray: &DVec3| {
            let (origin, ray) = (world_from_image.translation, world_from_image.rotation * *ray);
            let hit = if ray.is_nan() { None } else { caster.cast(origin, ray, self.reach, None) };
            PixelRay { origin, ray, hit }
        };
        self.pixels.rays.iter().step_by(step).map(cast).collect()
    }

    /// Ratio of the pose's error to the stated one, by the readings of every `step`-th ray.
    fn spread(&self, rays: &[PixelRay], step: usize, pose: &PoseEstimate, priors: &Priors) -> f64 {
        let errors = RangeErrors { noise: self.noise, pose, spread: 1.0, priors };
        errors.spread_of(rays, self.ranges.iter().step_by(step))
    }
}

impl Observer<'_> {
    /// The pose by a frame's readings, and their terms for the poses of objects.
    fn registered(&self, shot: &Shot<'_>, given: &PoseEstimate) -> (PoseEstimate, Option<Terms>) {
        // A sample of the pixels determines the pose well enough.
        let step = shot.pixels.rays.len().div_ceil(MAX_READINGS).max(1);
        let stated = shot.spread(&shot.cast(self.caster, given, step), step, given, self.priors);
        let covariance = PoseCovariance::from_rows(scaled(given.covariance.as_rows(), stated.powi(2)));
        let readings = Readings {
            caster: self.caster,
            robot_from_image: shot.robot_from_image,
            of: shot.pixels.rays.iter().copied().zip(shot.ranges.iter().copied()).step_by(step).collect(),
            noise: shot.noise,
            reach: shot.reach,
            priors: self.priors,
        };
        let pose = readings.register(&PoseEstimate::new(given.robot(), covariance));
        let terms = (!self.priors.is_empty()).then(|| readings.terms(given, &pose, self.views));
        (pose, terms)
    }

    /// Compares a frame of a robot at a pose. Also returns the first surface on the ray of each sampled pixel.
    pub fn view(
        &self,
        frame: &Frame,
        pixels: &Arc<SampledPixels>,
        given: &PoseEstimate,
    ) -> (View, Vec<Option<RayHit>>) {
        let shot = Shot::of(frame, pixels);
        let (pose, terms) = self.registered(&shot, given);
        let rays = shot.cast(self.caster, &pose, 1);
        let spread = shot.spread(&rays, 1, &pose, self.priors);
        let errors = RangeErrors { noise: shot.noise, pose: &pose, spread, priors: self.priors };
        let sigmas = pose.covariance.sigmas();
        let norm = |of: &[f64]| spread * of.iter().map(|x| x * x).sum::<f64>().sqrt();
        let mut view = View {
            stamp: frame.stamp,
            drive: 0,
            world_from_image: pose.world_from_robot * shot.robot_from_image,
            pixels: pixels.clone(),
            noise: shot.noise,
            objects: rays.iter().map(|ray| ray.hit.map_or(NO_OBJECT, |hit| hit.object)).collect(),
            evidence: vec![PixelEvidence::Unknown; rays.len()],
            pose_sigma: (norm(&sigmas[..3]), norm(&sigmas[3..])),
            correction: PoseCorrections::of(given, &pose),
            terms,
            new_points: Vec::new(),
            compared: (0, 0),
            ranges: shot.ranges,
        };
        for (at, ray) in rays.iter().enumerate() {
            let z = f64::from(view.ranges[at]);
            if ray.ray.is_nan() || z.is_nan() || z == f64::NEG_INFINITY {
                continue;
            }
            self.compare(&mut view, at, ray, z, &errors);
            if view.evidence[at] == PixelEvidence::Covered && z.is_finite() && is_backed(frame, pixels.pixel(at), z) {
                let is_new = self.add_new_point(&mut view, ray, z, &errors);
                if !is_new {
                    view.evidence[at] = PixelEvidence::Unknown;
                }
            }
        }
        (view, rays.into_iter().map(|ray| ray.hit).collect())
    }

    /// Adds a measured point to a view's new points, unless a surface of the model is near.
    fn add_new_point(&self, view: &mut View, ray: &PixelRay, z: f64, errors: &RangeErrors<'_>) -> bool {
        let x = ray.origin + z * ray.ray;
        let is_new = self.caster.nearest(x, KNOWN.max(NOISE_BOUND * errors.across(x, ray.ray))).is_none();
        if is_new {
            view.new_points.push(x);
        }
        is_new
    }

    /// Compares a pixel's reading `z` with the first surface on its ray.
    fn compare(&self, view: &mut View, at: usize, ray: &PixelRay, z: f64, errors: &RangeErrors<'_>) {
        let reach = view.reach();
        let Some(hit) = &ray.hit else {
            if z.is_finite() {
                view.evidence[at] = PixelEvidence::Covered;
            }
            return;
        };
        let second = || self.caster.cast(ray.origin, ray.ray, reach, Some(hit.object));
        let sigma = errors.sigma(ray, hit);
        view.compared.0 += 1;
        if (z - hit.range).abs() <= NOISE_BOUND * sigma {
            view.compared.1 += 1;
            let is_apart = second().is_none_or(|s| s.range - hit.range > 2.0 * NOISE_BOUND * sigma + 0.05);
            view.evidence[at] = if is_apart { PixelEvidence::Present } else { PixelEvidence::Ambiguous };
            return;
        }
        if z < hit.range {
            view.evidence[at] = PixelEvidence::Covered;
            return;
        }
        // A ray without a return does not contradict a surface near the end of the reach.
        if z.is_infinite() && hit.range > SAFE_REACH * reach {
            return;
        }
        let aside = errors.across(ray.origin + hit.range * ray.ray, ray.ray) / hit.range;
        let uncertain = NOISE_BOUND * (aside + errors.noise.angle) + 1e-4;
        let before = z.min(reach) - NOISE_BOUND * sigma;
        if hit.normal.dot(ray.ray).abs() < MIN_COSINE || !self.is_covered(ray, hit, uncertain, before) {
            return;
        }
        let second = second();
        if let Some(second) = second
            && z < second.range - NOISE_BOUND * errors.sigma(ray, &second)
        {
            // A beam that an edge splits also measures a range between two surfaces.
            if self.is_covered(ray, hit, uncertain.max(1.5 * view.pixels.spacing), before) {
                view.evidence[at] = PixelEvidence::SeenThrough;
                self.add_new_point(view, ray, z, errors);
            }
            return;
        }
        let is_apart = second.is_none_or(|s| s.range - hit.range > 2.0 * NOISE_BOUND * sigma);
        view.evidence[at] = if is_apart { PixelEvidence::SeenThrough } else { PixelEvidence::Ambiguous };
    }

    /// True if rays at an angle to this one, on four sides, meet the same object before `before` metres. Then no error
    /// of the pose explains that the ray went on.
    fn is_covered(&self, ray: &PixelRay, hit: &RayHit, angle: f64, before: f64) -> bool {
        let u = ray.ray.any_orthonormal_vector();
        let v = ray.ray.cross(u);
        [u, -u, v, -v].into_iter().all(|aside| {
            let neighbour = (ray.ray + angle.tan() * aside).normalize();
            let found = self.caster.cast(ray.origin, neighbour, before, None);
            found.is_some_and(|other| other.object == hit.object)
        })
    }
}

/// True if a neighbouring pixel has about the same range. A beam that an edge splits has no such neighbour; a post
/// fills one column, a rail one row.
fn is_backed(frame: &Frame, (c, r): (u32, u32), z: f64) -> bool {
    let (width, height) = (frame.sensor().width(), frame.sensor().height());
    let range = |c: u32, r: u32| f64::from(frame.ranges()[r as usize * width as usize + c as usize]);
    let near = |c: u32, r: u32| c < width && r < height && (range(c, r) - z).abs() < 0.05 + 0.02 * z;
    near(c.wrapping_sub(1), r) || near(c + 1, r) || near(c, r.wrapping_sub(1)) || near(c, r + 1)
}
