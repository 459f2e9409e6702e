//! Parts of big objects that are gone: neighbouring cells of one side.

use crate::evidence::{Cell, Evidence};
use crate::learn::LearnOptions;
use glam::{DVec3, IVec3};
use presight_model::geometry::Aabb;
use std::collections::BTreeMap;

/// Fewest cells of a part.
const LEAST: usize = 2;

/// A part that is gone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Part {
    /// In the frame of the object, metres.
    pub bounds: Aabb,
    pub l: f64,
    pub views: u32,
}

/// The gone parts among the cells of one object, whose edge is `size` metres.
pub(crate) fn parts<'a>(
    cells: impl Iterator<Item = (&'a Cell, &'a Evidence)>,
    size: f64,
    options: &LearnOptions,
) -> Vec<Part> {
    let is_gone = |e: &Evidence| e.l <= -options.sure && e.against >= options.least_views;
    let mut left: BTreeMap<(u8, [i32; 3]), Evidence> =
        cells.filter(|(_, e)| is_gone(e)).map(|(cell, e)| ((cell.1, cell.2), *e)).collect();
    let mut found = Vec::new();
    while let Some(((side, first), evidence)) = left.pop_first() {
        let (mut next, mut count) = (vec![first], 0);
        let mut part = Part { bounds: Aabb::EMPTY, l: -evidence.l, views: evidence.views };
        while let Some(key) = next.pop() {
            count += 1;
            let least = size * IVec3::from_array(key).as_dvec3();
            part.bounds = part.bounds.with(least).with(least + DVec3::splat(size));
            for n in 0..27 {
                let [x, y, z] = key;
                let near = [x + n % 3 - 1, y + n / 3 % 3 - 1, z + n / 9 - 1];
                if let Some(e) = left.remove(&(side, near)) {
                    (part.l, part.views) = (part.l.min(-e.l), part.views.min(e.views));
                    next.push(near);
                }
            }
        }
        if count >= LEAST {
            found.push(part);
        }
    }
    found
}
