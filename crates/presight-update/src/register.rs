//! The pose of one view by its own readings. All pixels of a view share one error of the pose: estimated once for the view, it
//! widens no pixel.

use crate::joint::{AXES, OnObject, Terms};
use crate::priors::Priors;
use crate::view::{BOUND, FLATTEST};
use glam::DVec3;
use presight_localize::motion::{motion_between, moved};
use presight_model::caster::RayCaster;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{add_to, apply, inverse, quadratic, scaled};
use presight_model::measured::RangeNoise;
use std::collections::BTreeMap;

/// Steps of Gauss and Newton.
const STEPS: usize = 3;
/// No model's surfaces are better known than this, metres. The pixels of one object share this error.
const LEAST_SIGMA: f64 = 0.002;
/// Passes that settle which readings are on an object that is off.
const PASSES: usize = 3;

/// The readings of a view.
pub(crate) struct Readings<'a> {
    pub caster: &'a RayCaster,
    pub robot_from_image: Pose,
    /// Unit rays in the image frame, and their ranges, metres.
    pub of: Vec<(DVec3, f32)>,
    pub noise: RangeNoise,
    pub reach: f64,
    /// How far objects may be off.
    pub priors: &'a Priors,
}

/// A reading against the surface that its ray meets.
struct Residual {
    object: u32,
    /// Where the ray meets the surface, world, metres.
    point: DVec3,
    /// Signed distance from the plane of the surface, metres, and its variance by the sensor's noise.
    distance: f64,
    variance: f64,
    /// Derivative of the distance by a motion of the robot in world axes.
    gradient: [f64; 6],
}

impl Residual {
    fn normal(&self) -> DVec3 {
        DVec3::new(self.gradient[0], self.gradient[1], self.gradient[2])
    }
}

/// The numbers of a pose that are not known exactly.
fn axes_of(pose: &PoseEstimate) -> Vec<usize> {
    let covariance = pose.covariance.as_rows();
    AXES.into_iter().filter(|i| covariance[*i][*i] > 0.0).collect()
}

impl Readings<'_> {
    /// The most likely pose by a prior and the readings, each against the plane of the surface it meets. Tukey's weights leave
    /// out what differs by more than noise and pose explain: that has changed.
    pub fn register(&self, prior: &PoseEstimate) -> PoseEstimate {
        let stated = inverse(prior.covariance.as_rows(), &AXES);
        let axes = axes_of(prior);
        let mut pose = *prior;
        for _ in 0..STEPS {
            let residuals = self.residuals(&pose.world_from_robot);
            let mut count: BTreeMap<u32, f64> = BTreeMap::new();
            residuals.iter().for_each(|r| *count.entry(r.object).or_default() += 1.0);
            let (mut information, mut gradient) = (stated, [0.0; 6]);
            let off = motion_between(&prior.world_from_robot, &pose.world_from_robot);
            apply(&stated, &off).iter().zip(&mut gradient).for_each(|(x, g)| *g -= x);
            for r in &residuals {
                let surface = self.surface(r);
                let spread = r.variance + surface + quadratic(pose.covariance.as_rows(), &r.gradient).max(0.0);
                let share = r.distance.powi(2) / (BOUND.powi(2) * spread);
                if share >= 1.0 {
                    continue;
                }
                let weight = (1.0 - share).powi(2) / (r.variance + count[&r.object] * surface);
                let outer = std::array::from_fn(|i| std::array::from_fn(|j| r.gradient[i] * r.gradient[j]));
                add_to(&mut information, &scaled(&outer, weight));
                (0..6).for_each(|i| gradient[i] -= weight * r.distance * r.gradient[i]);
            }
            let covariance = inverse(&information, &axes);
            let step = apply(&covariance, &gradient);
            pose = PoseEstimate::new(
                RobotPose::new(moved(&pose.world_from_robot, &step)),
                PoseCovariance::from_rows(covariance),
            );
        }
        pose
    }

    /// Variance of the surface that a reading is on, square metres.
    fn surface(&self, r: &Residual) -> f64 {
        self.priors.variance(r.object, r.point, r.normal()).max(LEAST_SIGMA * LEAST_SIGMA)
    }

    /// What the readings say at the view's own pose of how objects stand, and of that pose. The stated one counts once in `views` views.
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

    /// The sums over the readings on one object. Which of them are on it is settled at the motion of the object that they make most
    /// likely: a gate about the object's place in the model would hold it there.
    fn on_object(&self, object: u32, residuals: &[Residual], pose: &PoseEstimate) -> OnObject {
        let prior = self.priors.get(object);
        let own = |r: &Residual| prior.map_or([0.0; 6], |prior| prior.gradient(r.point, r.normal()));
        let known = prior.map(|prior| inverse(&prior.covariance, &AXES));
        let (mut motion, mut of) = ([0.0; 6], OnObject { object, ..OnObject::default() });
        for pass in 0..PASSES {
            let surface = |r: &Residual| if pass == 0 { self.surface(r) } else { LEAST_SIGMA * LEAST_SIGMA };
            let on = residuals.iter().filter_map(|r| {
                let (j, by_pose) = (own(r), quadratic(pose.covariance.as_rows(), &r.gradient).max(0.0));
                let left = r.distance - j.iter().zip(&motion).map(|(a, b)| a * b).sum::<f64>();
                (left * left <= BOUND * BOUND * (r.variance + surface(r) + by_pose)).then_some((r, j))
            });
            let on: Vec<(&Residual, [f64; 6])> = on.collect();
            of = OnObject { object, ..OnObject::default() };
            for (r, j) in &on {
                // One surface is known no better than this, however many pixels see it.
                let weight = 1.0 / (r.variance + on.len() as f64 * LEAST_SIGMA * LEAST_SIGMA);
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
            let met = self.caster.cast(origin, ray, self.reach, None)?;
            let cos = met.normal.dot(ray);
            let (along, across) = (self.noise.range_sigma(met.range) * cos, met.range * self.noise.angle);
            let n = met.normal;
            let turned = (origin + z * ray - world_from_robot.translation).cross(n);
            (cos.abs() >= FLATTEST).then(|| Residual {
                object: met.object,
                point: origin + met.range * ray,
                distance: (z - met.range) * cos,
                variance: along * along + across * across * (1.0 - cos * cos).max(0.0) + 1e-8,
                gradient: [n.x, n.y, n.z, turned.x, turned.y, turned.z],
            })
        };
        self.of.iter().filter_map(of).collect()
    }
}
