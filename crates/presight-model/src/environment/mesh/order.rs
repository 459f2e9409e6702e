//! The order of polygons in a mesh, and the cuts between its clusters.

use super::polygon::PolygonOrder;
use crate::geometry::Aabb;
use crate::limits;
use crate::threads::parallel_or_here;
use glam::Vec3;

/// Halves the polygons at the median centre along the longest axis until each run fits a cluster; rising inside a run.
pub fn spatial_sequence(boxes: &[Aabb]) -> Vec<u32> {
    // Stores centres next to the indices, in f32: that is precise enough for ordering and keeps the loops in cache.
    let mut items: Vec<(Vec3, u32)> = boxes.iter().zip(0..).map(|(b, i)| (b.center().as_vec3(), i)).collect();
    if items.len() >= 2 * PARALLEL {
        parallel_or_here(|| halve(&mut items));
    } else {
        halve(&mut items);
    }
    items.iter().map(|item| item.1).collect()
}

/// Smaller tasks are not worth running in parallel.
const PARALLEL: usize = 4096;

fn halve(items: &mut [(Vec3, u32)]) {
    if items.len() <= limits::CLUSTER_POLYGONS {
        items.sort_unstable_by_key(|item| item.1);
        return;
    }
    let start = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (min, max) = items.iter().fold(start, |(min, max), (c, _)| (min.min(*c), max.max(*c)));
    let axis = (max - min).max_position();
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    let (left, right) = items.split_at_mut(middle);
    if left.len() >= PARALLEL {
        rayon::join(|| halve(left), || halve(right));
    } else {
        halve(left);
        halve(right);
    }
}

/// Start indices of the clusters of `count` polygons.
pub fn cuts_of(count: usize, order: PolygonOrder) -> Vec<usize> {
    let mut cuts = Vec::with_capacity(2 * count / limits::CLUSTER_POLYGONS + 2);
    match order {
        PolygonOrder::Spatial => halving_cuts(0, count, &mut cuts),
        PolygonOrder::Given => cuts.extend((0..count).step_by(limits::CLUSTER_POLYGONS)),
    }
    cuts
}

/// Start indices of the runs of [`halve`], which depend only on the count.
fn halving_cuts(start: usize, count: usize, cuts: &mut Vec<usize>) {
    if count <= limits::CLUSTER_POLYGONS {
        if count > 0 {
            cuts.push(start);
        }
        return;
    }
    let middle = count / 2;
    halving_cuts(start, middle, cuts);
    halving_cuts(start + middle, count - middle, cuts);
}
