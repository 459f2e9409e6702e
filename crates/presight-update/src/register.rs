//! The pose of one view by its own readings. All pixels of a view share one error of the pose: estimated once for the view, it
//! widens no pixel.

use crate::caster::Caster;
use crate::view::{BOUND, FLATTEST};
use glam::DVec3;
use presight_localize::motion::{motion_between, moved};
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate};
use presight_model::matrix::{add_to, apply, inverse, quadratic, scaled};
use presight_model::measured::RangeNoise;
use std::collections::BTreeMap;

/// Steps of Gauss and Newton.
const STEPS: usize = 3;
/// No model's surfaces are better known than this, metres. The pixels of one object share this error.
const LEAST_SIGMA: f64 = 0.002;
const AXES: [usize; 6] = [0, 1, 2, 3, 4, 5];

/// The readings of a view.
pub(crate) struct Readings<'a> {
    pub caster: &'a Caster,
    pub robot_from_image: Pose,
    /// Unit rays in the image frame, and their ranges, metres.
    pub of: Vec<(DVec3, f32)>,
    pub noise: RangeNoise,
    pub reach: f64,
    /// Deviation of the model's surfaces, metres.
    pub model_sigma: f64,
}

/// A reading against the surface that its ray meets.
struct Residual {
    object: u32,
    /// Signed distance from the plane of the surface, metres, and its variance by the sensor's noise.
    distance: f64,
    variance: f64,
    /// Derivative of the distance by a motion of the robot in world axes.
    gradient: [f64; 6],
}

impl Readings<'_> {
    /// The most likely pose by a prior and the readings, each against the plane of the surface it meets. Tukey's weights leave
    /// out what differs by more than noise and pose explain: that has changed.
    pub fn register(&self, prior: &PoseEstimate) -> PoseEstimate {
        let stated = inverse(prior.covariance.as_rows(), &AXES);
        let mut pose = *prior;
        for _ in 0..STEPS {
            let residuals = self.residuals(&pose.world_from_robot);
            let mut count: BTreeMap<u32, f64> = BTreeMap::new();
            residuals.iter().for_each(|r| *count.entry(r.object).or_default() += 1.0);
            let surface = self.model_sigma.max(LEAST_SIGMA).powi(2);
            let (mut information, mut gradient) = (stated, [0.0; 6]);
            let off = motion_between(&prior.world_from_robot, &pose.world_from_robot);
            apply(&stated, &off).iter().zip(&mut gradient).for_each(|(x, g)| *g -= x);
            for r in &residuals {
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
            let covariance = inverse(&information, &AXES);
            let step = apply(&covariance, &gradient);
            pose = PoseEstimate::new(moved(&pose.world_from_robot, &step), PoseCovariance::from_rows(covariance));
        }
        pose
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
            let met = self.caster.first(origin, ray, self.reach, None)?;
            let cos = met.normal.dot(ray);
            let (along, across) = (self.noise.range_sigma(met.range) * cos, met.range * self.noise.angle);
            let n = met.normal;
            let turned = (origin + z * ray - world_from_robot.translation).cross(n);
            (cos.abs() >= FLATTEST).then(|| Residual {
                object: met.object,
                distance: (z - met.range) * cos,
                variance: along * along + across * across * (1.0 - cos * cos).max(0.0) + 1e-8,
                gradient: [n.x, n.y, n.z, turned.x, turned.y, turned.z],
            })
        };
        self.of.iter().filter_map(of).collect()
    }
}
