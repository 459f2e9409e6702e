//! Stated errors of the poses of a model's objects.

use glam::DVec3;
use presight_localize::motion::moved;
use presight_localize::verdict::ObjectError;
use presight_model::environment::{Environment, Object};
use presight_model::geometry::{Aabb, InWorld, Pose, PoseCovariance};
use presight_model::matrix::{Matrix, quadratic};
use std::collections::BTreeMap;

/// The stated error of one object's pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Prior {
    /// The centre of its bounds, world, metres. The object turns about it.
    pub middle: DVec3,
    /// Covariance of a small motion, world axes: metres, radians.
    pub covariance: Matrix,
}

/// The stated errors of objects' poses for one class of sensors.
#[derive(Clone, Debug, Default)]
pub(crate) struct Priors {
    of: BTreeMap<u32, Prior>,
    /// True if the layer states the errors.
    is_stated: bool,
    /// Variance of other surfaces, square metres.
    surface: f64,
}

/// The bounds of an object in its own frame, metres.
pub(crate) fn own_bounds(object: &Object) -> Aabb {
    object.mesh.bounds().transformed(&object.object_from_mesh)
}

impl Priors {
    /// The covariances that the layer of a class states. If it states no covariance at all, surfaces have a standard
    /// deviation of `model_sigma` metres: an object moves by that, or turns by that at its farthest point. Without both
    /// the model is exact, and poses are not refined.
    pub fn of(environment: &Environment, class: &str, model_sigma: f64) -> Self {
        let listed = environment.layer(class).map_or(&[][..], |layer| &layer.pose_covariances);
        let mut of = BTreeMap::new();
        for (name, covariance) in listed {
            let Ok(index) = environment.index_of(name) else { continue };
            let object = &environment.objects()[index as usize];
            let pose = &object.world_from_object;
            let middle = pose.transform_point(own_bounds(object).center());
            let covariance = covariance.in_world(pose).moved_by(middle - pose.translation);
            of.insert(index, Prior { middle, covariance: *covariance.as_rows() });
        }
        let is_stated = !of.is_empty();
        if !is_stated && model_sigma > 0.0 {
            let live = (0..).zip(environment.objects()).filter(|(_, o)| !o.is_deleted());
            of.extend(live.map(|(index, object)| {
                let bounds = own_bounds(object);
                let middle = object.world_from_object.transform_point(bounds.center());
                let turn = model_sigma / (0.5 * bounds.size()).max(model_sigma);
                let s = model_sigma;
                let covariance = PoseCovariance::<InWorld>::from_sigmas([s, s, s, turn, turn, turn]);
                (index, Prior { middle, covariance: *covariance.as_rows() })
            }));
        }
        Self { of, is_stated, surface: model_sigma * model_sigma }
    }

    pub fn is_empty(&self) -> bool {
        self.of.is_empty()
    }

    pub fn get(&self, object: u32) -> Option<&Prior> {
        self.of.get(&object)
    }

    /// Variance of an object's surface along its normal at a point of the world, square metres.
    pub fn variance(&self, object: u32, p: DVec3, normal: DVec3) -> f64 {
        match self.of.get(&object).filter(|_| self.is_stated) {
            Some(prior) => quadratic(&prior.covariance, &prior.gradient(p, normal)).max(0.0),
            None => self.surface,
        }
    }
}

impl Prior {
    /// Derivative of a surface point's displacement along its normal by a small motion of the object.
    pub fn gradient(&self, p: DVec3, n: DVec3) -> [f64; 6] {
        ObjectError::gradient(self.middle, p, n)
    }

    /// A pose after a small motion about the centre.
    pub fn moved(&self, pose: &Pose, motion: &[f64; 6]) -> Pose {
        let middle = Pose { translation: self.middle, ..Pose::IDENTITY };
        moved(&middle, motion) * middle.inverse() * *pose
    }
}
