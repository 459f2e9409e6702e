//! Minor changes of objects: poses and their covariances, by Bayes from how the views of a run saw them.

use crate::decide::Findings;
use crate::joint::{Joint, Learnt};
use crate::learn::Learner;
use crate::priors::Priors;
use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::geometry::{InObject, InWorld, Pose, PoseCovariance};
use std::collections::{BTreeMap, BTreeSet};

/// Where an object stands that moved too little to be called moved.
#[derive(Clone, Debug, PartialEq)]
pub struct Refined {
    /// Its path.
    pub object: String,
    /// The class of sensors that saw it: its layer gets the covariance.
    pub class: String,
    /// The most likely pose.
    pub world_from_object: Pose,
    /// How far it may be off.
    pub covariance: PoseCovariance<InObject>,
    /// How far its middle is from where the model has it, metres.
    pub distance: f64,
    /// Views that saw it.
    pub views: u32,
}

impl Learner {
    /// Where the objects stand that are confirmed, by Bayes from what the model states: the covariances of the sensor's layer,
    /// or the deviation of surfaces. Empty for a model that states neither: it is exact. An object that sensors of several
    /// classes saw follows the class with the most views of it.
    pub fn refined(&self, environment: &Environment, findings: &Findings) -> Vec<Refined> {
        if findings.wrong.is_some() {
            return Vec::new();
        }
        let standing: BTreeSet<u32> = findings.confirmed.iter().filter_map(|n| environment.index_of(n).ok()).collect();
        let mut best: BTreeMap<u32, (&str, Learnt)> = BTreeMap::new();
        for (class, joint) in &self.joints {
            let Some(priors) = self.priors.get(class) else { continue };
            for (object, learnt) in self.solved(joint, class, priors, &standing) {
                if best.get(&object).is_none_or(|(_, known)| known.views < learnt.views) {
                    best.insert(object, (class, learnt));
                }
            }
        }
        let enough = best.into_iter().filter(|(_, (_, learnt))| learnt.views >= self.options.least_views);
        enough.filter_map(|(object, (class, learnt))| self.refine(environment, object, class, &learnt)).collect()
    }

    fn solved(&self, joint: &Joint, class: &str, priors: &Priors, standing: &BTreeSet<u32>) -> BTreeMap<u32, Learnt> {
        let own = self.views.iter().filter(|view| view.kept.sensor.spec().class == class);
        joint.solve(priors, standing, own.filter_map(|view| view.terms.as_ref()))
    }

    fn refine(&self, environment: &Environment, object: u32, class: &str, learnt: &Learnt) -> Option<Refined> {
        let prior = self.priors.get(class)?.get(object)?;
        let o = &environment.objects()[object as usize];
        let world_from_object = prior.moved(&o.world_from_object, &learnt.motion);
        let [x, y, z, ..] = learnt.motion;
        let shift = DVec3::new(x, y, z);
        let about_middle = PoseCovariance::<InWorld>::from_rows(learnt.covariance);
        let about_origin = about_middle.moved_by(world_from_object.translation - (prior.middle + shift));
        let covariance = about_origin.in_object(&world_from_object);
        let rows = covariance.as_rows();
        let even = std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (rows[i][j] + rows[j][i])));
        Some(Refined {
            object: o.name.clone(),
            class: class.to_owned(),
            world_from_object,
            covariance: PoseCovariance::from_rows(even),
            distance: shift.length(),
            views: learnt.views,
        })
    }
}
