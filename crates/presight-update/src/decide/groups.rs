//! Groups of measured points that no object explains.

use crate::evidence::knowledge::Knowledge;
use crate::evidence::voxels::OccupancyThreshold;
use glam::DVec3;
use presight_model::geometry::Aabb;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum share of views that see through most of a new object.
const MAX_ABSENT: f64 = 0.1;

/// A group of measured points that no object explains, world frame, metres.
pub(crate) struct Group {
    pub points: Vec<DVec3>,
    pub bounds: Aabb,
}

/// The groups of occupied voxels with the points in them. A person who passes repeatedly leaves voxels that are hit
/// more often than passed. Such a group is not an object, because in other views rays pass through most of its voxels.
pub(crate) fn groups(known: &Knowledge) -> Vec<Group> {
    let voxels = &known.voxels;
    let keys = voxels.groups(&OccupancyThreshold::default());
    let mut of_voxel = BTreeMap::new();
    for (group, keys) in keys.iter().enumerate() {
        of_voxel.extend(keys.iter().map(|key| (*key, group)));
    }
    let mut points: Vec<Vec<DVec3>> = vec![Vec::new(); keys.len()];
    // Views that see a part of a group, and views that see through most of it.
    let mut votes = vec![(0usize, 0usize); keys.len()];
    for view in &known.views {
        let mut seen = BTreeSet::new();
        for p in &view.new_points {
            if let Some(group) = of_voxel.get(&voxels.key(*p)) {
                points[*group].push(*p);
                seen.insert(*group);
            }
        }
        for (group, keys) in keys.iter().enumerate() {
            if seen.contains(&group) {
                votes[group].0 += 1;
            } else {
                let passed = |key: &&[i32; 3]| voxels.spot(**key).is_some_and(|spot| view.passed(&spot, voxels.size()));
                let through = keys.iter().filter(passed).count();
                votes[group].1 += usize::from(2 * through > keys.len());
            }
        }
    }
    let is_present = |(there, away): (usize, usize)| away as f64 <= MAX_ABSENT * (there + away) as f64;
    let group = |points: Vec<DVec3>| Group { bounds: Aabb::of(points.iter().copied()), points };
    let present = points.into_iter().zip(votes).filter(|(_, votes)| is_present(*votes)).map(|(points, _)| points);
    present.filter(|points| !points.is_empty()).map(group).collect()
}
