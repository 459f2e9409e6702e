//! The evidence and the model that findings are derived from.

use crate::decide::boxes::MIN_POINTS;
use crate::decide::findings::{Finding, FindingKind};
use crate::decide::fit::{Fitter, Score, Thing};
use crate::evidence::knowledge::Knowledge;
use crate::evidence::objects::MIN_DIVIDED;
use crate::evidence::voxels::joined;
use glam::DVec3;
use presight_model::caster::RayCaster;
use presight_model::environment::Environment;
use presight_model::geometry::Pose;
use std::collections::{BTreeMap, BTreeSet};

/// Minimum number of voxels of a new object.
const MIN_VOXELS: usize = 3;
/// Points nearer than this to an object belong to it, metres.
pub(crate) const OWN: f64 = 0.1;

/// The evidence and the model that findings are derived from.
#[derive(Clone, Copy)]
pub(crate) struct Decision<'a> {
    pub environment: &'a Environment,
    /// The world as the newest sensor class sees it.
    pub caster: &'a RayCaster,
    pub known: &'a Knowledge,
}

impl<'a> Decision<'a> {
    /// Returns `None` unless the world was prepared for the newest class of sensors.
    pub fn new(known: &'a Knowledge, environment: &'a Environment) -> Option<Self> {
        Some(Self { environment, caster: known.casters.get(&known.newest_class())?, known })
    }

    /// The objects that are not deleted.
    pub fn live(&self) -> impl Iterator<Item = u32> {
        (0..).zip(self.environment.objects()).filter(|(_, o)| !o.is_deleted()).map(|(object, _)| object)
    }

    pub fn fitter(&self) -> Fitter<'a> {
        Fitter { caster: self.caster, known: self.known }
    }

    /// True if the views decide that an object stands at a pose.
    pub fn is_decisive(&self, score: &Score) -> bool {
        let options = &self.known.options;
        score.l >= options.decisive
            && score.views >= options.min_views
            && score.share() >= options.min_agreeing
            && score.worst > -options.decisive
    }

    /// The points that objects at these poses do not explain.
    pub fn unexplained(&self, points: &[DVec3], by: &[(u32, Pose)]) -> Vec<DVec3> {
        let is_explained = |p: &DVec3| {
            by.iter().any(|(object, pose)| {
                self.caster.nearest_on(*object, pose.inverse().transform_point(*p), OWN).is_some()
            })
        };
        points.iter().filter(|p| !is_explained(p)).copied().collect()
    }

    /// True if points are enough for a new object.
    pub fn is_object(&self, points: &[DVec3]) -> bool {
        let voxels: BTreeSet<[i32; 3]> = points.iter().map(|p| self.known.voxels.key(*p)).collect();
        voxels.len() >= MIN_VOXELS && points.len() >= MIN_POINTS
    }

    /// The pieces of a group that are large enough for an object. The voxels of a piece touch.
    pub fn pieces(&self, points: &[DVec3]) -> Vec<Vec<DVec3>> {
        let voxels = &self.known.voxels;
        let keys = joined(points.iter().map(|p| voxels.key(*p)), 1);
        let of_voxel: BTreeMap<[i32; 3], usize> =
            keys.iter().enumerate().flat_map(|(piece, keys)| keys.iter().map(move |key| (*key, piece))).collect();
        let mut pieces = vec![Vec::new(); keys.len()];
        points.iter().for_each(|p| pieces[of_voxel[&voxels.key(*p)]].push(*p));
        pieces.retain(|piece| self.is_object(piece));
        pieces
    }

    /// The balls around small objects that are confirmed where the model has them. No other object stands there.
    pub fn standing(&self, doubted: &[u32]) -> Vec<(DVec3, f64)> {
        let stands = |object: &u32| {
            let is_confirmed = self.known.book.objects.get(object).is_some_and(|e| e.l >= self.known.options.decisive);
            is_confirmed && !doubted.contains(object)
        };
        let own = |object: u32| {
            Thing::new(self.environment, object).ball(&self.environment.objects()[object as usize].world_from_object)
        };
        self.live().filter(stands).map(own).filter(|(_, radius)| 2.0 * radius <= MIN_DIVIDED).collect()
    }
}

/// The new poses of moved objects, which explain points.
pub(crate) fn moved(findings: &[Finding], environment: &Environment) -> Vec<(u32, Pose)> {
    let of = |finding: &Finding| match finding.kind {
        FindingKind::Moved { world_from_object, .. } => {
            Some((environment.index_of(&finding.object).ok()?, world_from_object))
        }
        _ => None,
    };
    findings.iter().filter_map(of).collect()
}
