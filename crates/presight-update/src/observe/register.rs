//! The pose of one view by its own readings. All pixels of a view share the error of its pose. It is estimated once per
//! view, so that it does not widen the error of each pixel.

use crate::observe::priors::Priors;
use crate::observe::terms::{AXES, ObjectTerms, Terms};
use crate::observe::view::MIN_COSINE;
use glam::DVec3;
use presight_localize::motion::{NormalEquations, motion_between, moved};
use presight_localize::verdict::ObjectError;
use presight_model::caster::RayCaster;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{add_to, apply, inverse, quadratic, scaled};
use presight_model::measured::RangeNoise;
use presight_model::statistics::NOISE_BOUND;
use std::collections::BTreeMap;

/// Gauss-Newton steps.
const STEPS: usize = 3;
/// Minimum standard deviation of a surface, metres. The pixels of one object share this error.
const MIN_SIGMA: f64 = 0.002;
/// Passes that select the readings on a displaced object.
const PASSES: usize = 3;

/// The readings of a view.
pub(crate) struct Readings<'a> {
    pub caster: &'a RayCaster,
    pub robot_from_image: Pose,
    /// Unit rays in the image frame, and their ranges, metres.
    pub of: Vec<(DVec3, f32)>,
    pub noise: RangeNoise,
    pub reach: f64,
    /// Stated errors of the objects' poses.
    pub priors: &'a Priors,
}

/// The distance of a reading from the surface on its ray.
struct Residual {
    object: u32,
    /// Intersection of ray and surface, world, metres.
    point: DVec3,
    /// Signed distance from the plane of the surface, metres.
    distance: f64,
    /// Variance of the distance by the sensor's noise, square metres.
    variance: f64,
    /// Derivative of the distance by a motion of the robot in world axes.
    gradient: [f64; 6],
}

impl Residual {
    fn normal(&self) -> DVec3 {
        DVec3::new(self.gradient[0], self.gradient[1], self.gradient[2])
    }
}

/// The numbers of a pose that are uncertain.
fn axes_of(pose: &PoseEstimate) -> Vec<usize> {
    let covariance = pose.covariance.as_rows();
    AXES.into_iter().filter(|i| covariance[*i][*i] > 0.0).collect()
}

impl Readings<'_> {
    /// The most likely pose by a prior and by the distances of the readings from the planes of their surfaces. Tukey's
    /// weights exclude readings that differ by more than noise and pose explain, because their surface has changed.
    pub fn register(&self, prior: &PoseEstimate) -> PoseEstimate {
        let stated = inverse(prior.covariance.as_rows(), &AXES);
        let axes = axes_of(prior);
        let mut pose = *prior;
        for _ in 0..STEPS {
            let residuals = self.residuals(&pose.world_from_robot);
            let mut count: BTreeMap<u32, f64> = BTreeMap::new();
            residuals.iter().for_each(|r| *count.entry(r.object).or_default() += 1.0);
            let mut equations = NormalEquations::default();
            for r in &residuals {
                let surface = self.surface(r);
                let spread = r.variance + surface + quadratic(pose.covariance.as_rows(), &r.gradient).max(0.0);
                let share = r.distance.powi(2) / (NOISE_BOUND.powi(2) * spread);
                if share >= 1.0 {
                    continue;
                }
                let weight = (1.0 - share).powi(2) / (r.variance + count[&r.object] * surface);
                equations.add(r.distance, &r.gradient, weight);
            }
            let off = motion_between(&prior.world_from_robot, &pose.world_from_robot);
            let (step, covariance) = equations.step(&stated, &off, &axes);
            pose = PoseEstimate::new(
                RobotPose::new(moved(&pose.world_from_robot, &step)),
                PoseCovariance::from_rows(covariance),
            );
        }
        pose
    }

    /// Variance of the surface that a reading is on, square metres.
    fn surface(&self, r: &Residual) -> f64 {
        self.priors.variance(r.object, r.point, r.normal()).max(MIN_SIGMA * MIN_SIGMA)
    }

    /// The terms of the readings for the poses of the objects and of the view, at the view's pose. The stated pose has
    /// the weight of one view in `views`, because all views may share its error.
    pub fn terms(&self, stated: &PoseEstimate, pose: &PoseEstimate, views: usize) -> Terms {
        let shared = scaled(stated.covariance.as_rows(), views.max(1) as f64);
        let information = inverse(&shared, &AXES);
        let off = motion_between(&stated.world_from_robot, &pose.world_from_robot);
        let mut terms =
            Terms { pull: apply(&information, &off), information, axes: axes_of(stated), objects: Vec::new() };
        let mut all: BTreeMap<u32, Vec<Residual>> = BTreeMap::new();
        for r in self.residuals(&pose.world_from_robot) {
            all.entry(r.object).or_default().push(r);
        }
        for (object, residuals) in &all {
            let of = self.on_object(*object, residuals, pose);
            if self.priors.get(*object).is_some_and(|prior| prior.covariance.iter().flatten().any(|x| *x != 0.0)) {
                terms.objects.push(of);
            } else {
                add_to(&mut terms.information, &of.view);
                (0..6).for_each(|i| terms.pull[i] += of.of_view[i]);
            }
        }
        terms
    }

    /// The sums over the readings on one object. Each pass selects readings near the object at its most likely motion
    /// so far. A gate about the object's place in the model would bias it towards that place.
    fn on_object(&self, object: u32, residuals: &[Residual], pose: &PoseEstimate) -> ObjectTerms {
        let prior = self.priors.get(object);
        let own = |r: &Residual| prior.map_or([0.0; 6], |prior| prior.gradient(r.point, r.normal()));
        let known = prior.map(|prior| inverse(&prior.covariance, &AXES));
        let (mut motion, mut of) = ([0.0; 6], ObjectTerms { object, ..ObjectTerms::default() });
        for pass in 0..PASSES {
            let surface = |r: &Residual| if pass == 0 { self.surface(r) } else { MIN_SIGMA * MIN_SIGMA };
            let on = residuals.iter().filter_map(|r| {
                let (j, by_pose) = (own(r), quadratic(pose.covariance.as_rows(), &r.gradient).max(0.0));
                let left = r.distance - j.iter().zip(&motion).map(|(a, b)| a * b).sum::<f64>();
                (left * left <= NOISE_BOUND * NOISE_BOUND * (r.variance + surface(r) + by_pose)).then_some((r, j))
            });
            let on: Vec<(&Residual, [f64; 6])> = on.collect();
            of = ObjectTerms { object, ..ObjectTerms::default() };
            for (r, j) in &on {
                // The error of a surface does not average out over its pixels.
                let weight = 1.0 / (r.variance + on.len() as f64 * MIN_SIGMA * MIN_SIGMA);
                let outer =
                    |a: &[f64; 6], b: &[f64; 6]| std::array::from_fn(|k| std::array::from_fn(|l| weight * a[k] * b[l]));
                add_to(&mut of.own, &outer(j, j));
                add_to(&mut of.mixed, &outer(j, &r.gradient));
                add_to(&mut of.view, &outer(&r.gradient, &r.gradient));
                (0..6).for_each(|i| of.of_object[i] += weight * j[i] * r.distance);
                (0..6).for_each(|i| of.of_view[i] += weight * r.gradient[i] * r.distance);
            }
            let Some(known) = known else { break };
            let mut information = of.own;
            add_to(&mut information, &known);
            motion = apply(&inverse(&information, &AXES), &of.of_object);
        }
        of
    }

    fn residuals(&self, world_from_robot: &Pose) -> Vec<Residual> {
        let world_from_image = *world_from_robot * self.robot_from_image;
        let origin = world_from_image.translation;
        let of = |(ray, z): &(DVec3, f32)| {
            let z = f64::from(*z);
            if ray.is_nan() || !z.is_finite() {
                return None;
            }
            let ray = world_from_image.rotation * *ray;
            let hit = self.caster.cast(origin, ray, self.reach, None)?;
            let cos = hit.normal.dot(ray);
            let (along, across) = (self.noise.range_sigma(hit.range) * cos, hit.range * self.noise.angle);
            (cos.abs() >= MIN_COSINE).then(|| Residual {
                object: hit.object,
                point: origin + hit.range * ray,
                distance: (z - hit.range) * cos,
                variance: along * along + across * across * (1.0 - cos * cos).max(0.0) + 1e-8,
                gradient: ObjectError::gradient(world_from_robot.translation, origin + z * ray, hit.normal),
            })
        };
        self.of.iter().filter_map(of).collect()
    }
}
