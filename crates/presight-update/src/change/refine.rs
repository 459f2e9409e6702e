//! Refined poses: poses of objects and their covariances, by Bayes from all views.

use crate::decide::findings::SiteFindings;
use crate::evidence::joint::ObjectMotion;
use crate::evidence::knowledge::Knowledge;
use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::geometry::{InObject, InWorld, Pose, PoseCovariance};
use std::collections::{BTreeMap, BTreeSet};

/// The pose of an object that moved too little for a finding.
#[derive(Clone, Debug, PartialEq)]
pub struct RefinedPose {
    /// Path of the object.
    pub object: String,
    /// The class of sensors that saw it; its layer gets the covariance.
    pub class: String,
    /// The most likely pose.
    pub world_from_object: Pose,
    /// Covariance of that pose.
    pub covariance: PoseCovariance<InObject>,
    /// Distance of its centre from its place in the model, metres.
    pub distance: f64,
    /// Number of views that saw it.
    pub views: u32,
}

/// As [`Learner::refined`](crate::Learner::refined).
pub(crate) fn refined(known: &Knowledge, environment: &Environment, findings: &SiteFindings) -> Vec<RefinedPose> {
    if findings.wrong.is_some() {
        return Vec::new();
    }
    let standing: BTreeSet<u32> = findings.confirmed.iter().filter_map(|n| environment.index_of(n).ok()).collect();
    let mut best: BTreeMap<u32, (&str, ObjectMotion)> = BTreeMap::new();
    for (class, joint) in &known.joints {
        let Some(priors) = known.priors.get(class) else { continue };
        let own = known.views.iter().filter(|view| view.class() == class);
        for (object, motion) in joint.solve(priors, &standing, own.filter_map(|view| view.terms.as_ref())) {
            if best.get(&object).is_none_or(|(_, other)| other.views < motion.views) {
                best.insert(object, (class, motion));
            }
        }
    }
    let enough = best.into_iter().filter(|(_, (_, motion))| motion.views >= known.options.min_views);
    enough.filter_map(|(object, (class, motion))| refine(known, environment, object, class, &motion)).collect()
}

fn refine(
    known: &Knowledge,
    environment: &Environment,
    object: u32,
    class: &str,
    moved: &ObjectMotion,
) -> Option<RefinedPose> {
    let prior = known.priors.get(class)?.get(object)?;
    let o = &environment.objects()[object as usize];
    let world_from_object = prior.moved(&o.world_from_object, &moved.motion);
    let [x, y, z, ..] = moved.motion;
    let shift = DVec3::new(x, y, z);
    let about_centre = PoseCovariance::<InWorld>::from_rows(moved.covariance);
    let about_origin = about_centre.moved_by(world_from_object.translation - (prior.middle + shift));
    let covariance = about_origin.in_object(&world_from_object);
    let rows = covariance.as_rows();
    let symmetric = std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (rows[i][j] + rows[j][i])));
    Some(RefinedPose {
        object: o.name.clone(),
        class: class.to_owned(),
        world_from_object,
        covariance: PoseCovariance::from_rows(symmetric),
        distance: shift.length(),
        views: moved.views,
    })
}
