//! Surfels with their neighbours.

use super::surfel::Surfel;
use glam::DVec3;
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

/// Radius of a neighbourhood, in sizes of the surfel.
const REACH: f64 = 1.8;
/// Minimum cosine between the normals of neighbours: 53 degrees.
const NEIGHBOURS: f64 = 0.6;

/// Surfels with their neighbours.
pub(crate) struct Surface {
    pub surfels: Vec<Surfel>,
    /// By surfel: the start of its list in `neighbours`, and the end of the last list.
    first: Vec<u32>,
    neighbours: Vec<u32>,
    tree: RTree<GeomWithData<[f64; 3], u32>>,
}

impl Surface {
    pub fn new(surfels: Vec<Surfel>) -> Self {
        let points = surfels.iter().zip(0..).map(|(s, i)| GeomWithData::new(s.at.to_array(), i)).collect();
        let tree = RTree::bulk_load(points);
        let lists = surfels.par_iter().map(|s| around(&tree, &surfels, s)).collect();
        Self::of(surfels, tree, lists)
    }

    /// Surfels with given lists of neighbours; [`Self::near`] finds none of them.
    pub fn with_neighbours(surfels: Vec<Surfel>, lists: Vec<Vec<u32>>) -> Self {
        Self::of(surfels, RTree::new(), lists)
    }

    fn of(surfels: Vec<Surfel>, tree: RTree<GeomWithData<[f64; 3], u32>>, lists: Vec<Vec<u32>>) -> Self {
        let mut first = vec![0];
        first.extend(lists.iter().scan(0, |sum, list| {
            *sum += list.len() as u32;
            Some(*sum)
        }));
        Self { surfels, first, neighbours: lists.concat(), tree }
    }

    /// Indices of the surfels around a surfel, including itself.
    pub fn neighbours(&self, surfel: usize) -> &[u32] {
        &self.neighbours[self.first[surfel] as usize..self.first[surfel + 1] as usize]
    }

    /// Indices of the surfels within a distance of a point, metres.
    pub fn near(&self, p: DVec3, distance: f64) -> impl Iterator<Item = u32> + '_ {
        self.tree.locate_within_distance(p.to_array(), distance * distance).map(|found| found.data)
    }
}

fn around(tree: &RTree<GeomWithData<[f64; 3], u32>>, surfels: &[Surfel], s: &Surfel) -> Vec<u32> {
    let reach = (REACH * s.size).powi(2);
    let near = tree.locate_within_distance(s.at.to_array(), reach).map(|found| found.data);
    let mut list: Vec<u32> = near.filter(|i| surfels[*i as usize].normal.dot(s.normal) > NEIGHBOURS).collect();
    list.sort_unstable();
    list
}
