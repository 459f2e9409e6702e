//! How far the objects of a model may be from where it has them, before anything was seen.

use glam::DVec3;
use presight_localize::motion::moved;
use presight_localize::verdict::ObjectError;
use presight_model::environment::{Environment, Object};
use presight_model::geometry::{InWorld, Pose, PoseCovariance};
use presight_model::matrix::{Matrix, quadratic};
use std::collections::BTreeMap;

/// The stated error of one object's pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Prior {
    /// The middle of its bounds, world, metres: the object turns about it.
    pub middle: DVec3,
    /// Covariance of a small motion, world axes: metres, radians.
    pub covariance: Matrix,
}

/// The stated errors of objects' poses for one class of sensors.
#[derive(Clone, Debug, Default)]
pub(crate) struct Priors {
    of: BTreeMap<u32, Prior>,
    /// Objects whose error the layer states.
    stated: bool,
    /// Variance of other surfaces, square metres.
    surface: f64,
}

/// The middle of an object's bounds in its own frame.
pub(crate) fn middle_of(object: &Object) -> DVec3 {
    object.mesh.bounds().transformed(&object.object_from_mesh).center()
}

impl Priors {
    /// The layer of the class states covariances of poses. Where it has none at all, surfaces err by `model_sigma` metres: an
    /// object moves, or turns at its farthest point, by that. Without both a model is exact, and nothing is learnt of poses.
    pub fn of(environment: &Environment, class: &str, model_sigma: f64) -> Self {
        let listed = environment.layer(class).map_or(&[][..], |layer| &layer.pose_covariances);
        let mut of = BTreeMap::new();
        for (name, covariance) in listed {
            let Ok(index) = environment.index_of(name) else { continue };
            let object = &environment.objects()[index as usize];
            let pose = &object.world_from_object;
            let middle = pose.transform_point(middle_of(object));
            let covariance = covariance.in_world(pose).moved_by(middle - pose.translation);
            of.insert(index, Prior { middle, covariance: *covariance.as_rows() });
        }
        let stated = !of.is_empty();
        if !stated && model_sigma > 0.0 {
            let live = (0..).zip(environment.objects()).filter(|(_, o)| !o.is_deleted());
            of.extend(live.map(|(index, object)| {
                let bounds = object.mesh.bounds().transformed(&object.object_from_mesh);
                let middle = object.world_from_object.transform_point(bounds.center());
                let turn = model_sigma / (0.5 * bounds.size()).max(model_sigma);
                let s = model_sigma;
                let covariance = PoseCovariance::<InWorld>::from_sigmas([s, s, s, turn, turn, turn]);
                (index, Prior { middle, covariance: *covariance.as_rows() })
            }));
        }
        Self { of, stated, surface: model_sigma * model_sigma }
    }

    pub fn is_empty(&self) -> bool {
        self.of.is_empty()
    }

    pub fn get(&self, object: u32) -> Option<&Prior> {
        self.of.get(&object)
    }

    /// Variance of an object's surface along its normal at a point of the world, square metres.
    pub fn variance(&self, object: u32, p: DVec3, normal: DVec3) -> f64 {
        match self.of.get(&object).filter(|_| self.stated) {
            Some(prior) => quadratic(&prior.covariance, &prior.gradient(p, normal)).max(0.0),
            None => self.surface,
        }
    }
}

impl Prior {
    /// How a surface moves along its normal at a point of the world with a small motion of its object.
    pub fn gradient(&self, p: DVec3, n: DVec3) -> [f64; 6] {
        ObjectError::gradient(self.middle, p, n)
    }

    /// A pose after a small motion about the middle.
    pub fn moved(&self, pose: &Pose, motion: &[f64; 6]) -> Pose {
        let middle = Pose { translation: self.middle, ..Pose::IDENTITY };
        moved(&middle, motion) * middle.inverse() * *pose
    }
}
