//! Merging of surfels of one surface. Where the side of a cube runs along the surface, noise spreads its points over
//! two cubes.

use super::surfel::{SIMILAR, Surfel};
use rstar::RTree;
use rstar::primitives::GeomWithData;

/// Maximum distance along the surface between surfels that are merged, in sizes.
const ALONG: f64 = 0.5;
/// Maximum distance between the means of the two parts of one surface, in standard deviations of a range: 3.3 if the
/// side of the cube separates one point in a thousand.
const SEPARATION: f64 = 3.3;

/// The surfels after merging the ones that noise separated. The smallest surfels have the size `min_size`, and their
/// ranges the standard deviation `noise`, metres.
pub(crate) fn merged(surfels: &[Surfel], min_size: f64, noise: f64) -> Vec<Surfel> {
    let points = surfels.iter().zip(0u32..).map(|(s, i)| GeomWithData::new(s.at.to_array(), i)).collect();
    let tree: RTree<GeomWithData<[f64; 3], u32>> = RTree::bulk_load(points);
    let mut order: Vec<u32> = (0..surfels.len() as u32).collect();
    order.sort_by(|a, b| surfels[*b as usize].weight.total_cmp(&surfels[*a as usize].weight));
    let mut is_in = vec![false; surfels.len()];
    let mut merged = Vec::new();
    for first in order {
        if std::mem::replace(&mut is_in[first as usize], true) {
            continue;
        }
        let s = surfels[first as usize];
        let (off, along) = (SEPARATION * noise * s.size / min_size, ALONG * s.size);
        let mut sum = Surfel { at: s.at * s.weight, normal: s.normal * s.weight, ..s };
        let mut near: Vec<u32> =
            tree.locate_within_distance(s.at.to_array(), off * off + along * along).map(|found| found.data).collect();
        near.sort_unstable();
        for other in near {
            let o = surfels[other as usize];
            let from_s = o.at - s.at;
            let above = from_s.dot(s.normal);
            let is_same = o.normal.dot(s.normal) > SIMILAR
                && above.abs() < off
                && from_s.length_squared() - above * above < along * along;
            if is_same && !std::mem::replace(&mut is_in[other as usize], true) {
                sum.at += o.at * o.weight;
                sum.normal += o.normal * o.weight;
                sum.weight += o.weight;
            }
        }
        merged.push(Surfel { at: sum.at / sum.weight, normal: sum.normal.normalize_or(s.normal), ..sum });
    }
    merged
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// 3 of 4 pixels lie 2 mm below the side of a cube, the fourth lies 6 mm above it. With a noise of 5 mm they are
    /// one surface at their mean, with a noise of 1 mm two.
    #[test]
    fn a_surface_separated_by_noise_is_merged() {
        let surfel =
            |z: f64, weight: f64| Surfel { at: DVec3::new(0.003 * z, 0.0, z), normal: DVec3::Z, weight, size: 0.02 };
        let separated = [surfel(0.006, 1.0), surfel(-0.002, 3.0)];
        let one = merged(&separated, 0.02, 0.005);
        assert_eq!(one.len(), 1);
        assert!(one[0].at.z.abs() < 1e-12 && one[0].weight == 4.0, "{one:?}");
        assert_eq!(merged(&separated, 0.02, 0.001).len(), 2);
        let neighbour = Surfel { at: DVec3::new(0.02, 0.0, 0.0), ..separated[1] };
        assert_eq!(merged(&[separated[1], neighbour], 0.02, 0.005).len(), 2);
    }
}
