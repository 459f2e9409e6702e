//! Voxels: hits and passes, by hand.

use glam::DVec3;
use presight_update::{OccupancyThreshold, Voxels};

fn p(x: f64) -> DVec3 {
    DVec3::new(x, 0.05, 0.05)
}

/// By hand: three hits and one pass are occupied, three hits and two passes are not (2 of 5 is over a third).
#[test]
fn hits_and_passes_count_once_a_view() {
    let mut voxels = Voxels::new(0.1);
    for view in 0..3 {
        // Two points in one voxel are one hit; the second voxel is hit in two views and passed in the third.
        let points = if view < 2 { vec![p(0.01), p(0.05), p(0.11)] } else { vec![p(0.01)] };
        voxels.add(&points, |_| true);
    }
    let counts: Vec<_> = voxels.iter().map(|(_, v)| (v.hits, v.passes)).collect();
    assert_eq!(counts, [(3, 0), (2, 1)]);
    let occupied = OccupancyThreshold::default();
    voxels.add(&[], |_| true);
    assert_eq!(voxels.groups(&occupied), [[[0, 0, 0]]]);
    voxels.add(&[], |middle| middle.x < 0.1);
    assert!(voxels.groups(&occupied).is_empty());
}

#[test]
fn groups_have_small_gaps() {
    let mut voxels = Voxels::new(0.1);
    let points = [p(0.05), DVec3::new(0.25, 0.15, 0.05), p(0.55), p(-0.05)];
    let new: Vec<usize> = (0..3).map(|_| voxels.add(&points, |_| false).len()).collect();
    assert_eq!(new, [4, 0, 0]);
    let groups = voxels.groups(&OccupancyThreshold::default());
    assert_eq!(groups, [vec![[-1, 0, 0], [0, 0, 0], [2, 1, 0]], vec![[5, 0, 0]]]);
}

#[test]
fn points_that_are_none_and_points_far_off_do_no_harm() {
    let mut voxels = Voxels::new(0.1);
    voxels.add(&[DVec3::NAN, DVec3::splat(1e30), DVec3::splat(-1e30)], |_| false);
    assert_eq!(voxels.iter().len(), 2);
    let most = OccupancyThreshold { hits: 1, passes: 1.0 };
    assert_eq!(voxels.groups(&most).len(), 2);
}
