//! Missing parts of large objects: neighbouring cells on one side.

use crate::evidence::objects::{Cell, Evidence};
use crate::evidence::voxels::joined;
use crate::options::LearnOptions;
use glam::{DVec3, IVec3};
use presight_model::geometry::Aabb;
use std::collections::BTreeMap;

/// Minimum number of cells of a part.
const MIN_CELLS: usize = 2;

/// A missing part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Part {
    /// In the frame of the object, metres.
    pub bounds: Aabb,
    /// Minimum log-odds of its cells that they are gone.
    pub l: f64,
    /// Minimum number of views of its cells.
    pub views: u32,
}

/// The missing parts of one object, by its cells with an edge of `size` metres.
pub(crate) fn parts<'a>(
    cells: impl Iterator<Item = (&'a Cell, &'a Evidence)>,
    size: f64,
    options: &LearnOptions,
) -> Vec<Part> {
    let mut gone: BTreeMap<u8, BTreeMap<[i32; 3], Evidence>> = BTreeMap::new();
    for ((_, side, place), e) in cells {
        if e.l <= -options.decisive && e.against >= options.min_views {
            gone.entry(*side).or_default().insert(*place, *e);
        }
    }
    let part = |cells: &BTreeMap<[i32; 3], Evidence>, keys: &[[i32; 3]]| {
        let none = Part { bounds: Aabb::EMPTY, l: f64::INFINITY, views: u32::MAX };
        keys.iter().fold(none, |part, key| {
            let (corner, e) = (size * IVec3::from_array(*key).as_dvec3(), &cells[key]);
            let bounds = part.bounds.with(corner).with(corner + DVec3::splat(size));
            Part { bounds, l: part.l.min(-e.l), views: part.views.min(e.views) }
        })
    };
    let of_side = |cells: &BTreeMap<[i32; 3], Evidence>| {
        let groups = joined(cells.keys().copied(), 1).into_iter().filter(|keys| keys.len() >= MIN_CELLS);
        groups.map(|keys| part(cells, &keys)).collect::<Vec<_>>()
    };
    gone.values().flat_map(of_side).collect()
}
