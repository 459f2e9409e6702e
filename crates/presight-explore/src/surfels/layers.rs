//! Surfels of one surface whose points lie in two cubes: the side of a cube that runs along a surface parts its points by their noise.

use super::surfel::Surfel;
use rstar::RTree;
use rstar::primitives::GeomWithData;

/// Surfels of one surface lie this near along it, in sizes.
const ALONG: f64 = 0.5;
/// Least cosine between their normals: 25 degrees.
const ALIKE: f64 = 0.906;
/// The means of what a side of a cube parts are this far apart at most, in standard deviations of a range: where it parts one point
/// of a thousand, 3.3.
const PARTED: f64 = 3.3;

/// The surfels; two that noise parted become one. The smallest surfels have the size `least`, and their ranges the standard deviation
/// `noise`, metres.
pub(crate) fn joined(surfels: &[Surfel], least: f64, noise: f64) -> Vec<Surfel> {
    let points = surfels.iter().zip(0u32..).map(|(s, i)| GeomWithData::new(s.at.to_array(), i)).collect();
    let tree: RTree<GeomWithData<[f64; 3], u32>> = RTree::bulk_load(points);
    let mut order: Vec<u32> = (0..surfels.len() as u32).collect();
    order.sort_by(|a, b| surfels[*b as usize].weight.total_cmp(&surfels[*a as usize].weight));
    let mut is_in = vec![false; surfels.len()];
    let mut joined = Vec::new();
    for first in order {
        if std::mem::replace(&mut is_in[first as usize], true) {
            continue;
        }
        let s = surfels[first as usize];
        let (off, along) = (PARTED * noise * s.size / least, ALONG * s.size);
        let mut sum = Surfel { at: s.at * s.weight, normal: s.normal * s.weight, ..s };
        let mut near: Vec<u32> =
            tree.locate_within_distance(s.at.to_array(), off * off + along * along).map(|found| found.data).collect();
        near.sort_unstable();
        for other in near {
            let o = surfels[other as usize];
            let way = o.at - s.at;
            let above = way.dot(s.normal);
            let is_same = o.normal.dot(s.normal) > ALIKE
                && above.abs() < off
                && way.length_squared() - above * above < along * along;
            if is_same && !std::mem::replace(&mut is_in[other as usize], true) {
                sum.at += o.at * o.weight;
                sum.normal += o.normal * o.weight;
                sum.weight += o.weight;
            }
        }
        joined.push(Surfel { at: sum.at / sum.weight, normal: sum.normal.normalize_or(s.normal), ..sum });
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// By hand: 3 of 4 pixels lie 2 mm below the side of a cube, the fourth 6 mm above it. With a noise of 5 mm that is one surface at
    /// its mean; with one of 1 mm it is two.
    #[test]
    fn what_noise_parted_is_one_surface() {
        let surfel =
            |z: f64, weight: f64| Surfel { at: DVec3::new(0.003 * z, 0.0, z), normal: DVec3::Z, weight, size: 0.02 };
        let parted = [surfel(0.006, 1.0), surfel(-0.002, 3.0)];
        let one = joined(&parted, 0.02, 0.005);
        assert_eq!(one.len(), 1);
        assert!(one[0].at.z.abs() < 1e-12 && one[0].weight == 4.0, "{one:?}");
        assert_eq!(joined(&parted, 0.02, 0.001).len(), 2);
        let beside = Surfel { at: DVec3::new(0.02, 0.0, 0.0), ..parted[1] };
        assert_eq!(joined(&[parted[1], beside], 0.02, 0.005).len(), 2);
    }
}
