//! Shared by the two cell schemes: boxes by id, and filtering a cell.

use super::QueryResult;
use super::boxes::{Box32, Boxes8, LANES, Shift};
use super::shapes::Shape;
use crate::geometry::Aabb;
use glam::DVec3;

/// Boxes by id, relative to an origin.
#[derive(Clone, Debug)]
pub(super) struct Boxes {
    pub origin: DVec3,
    /// Contains every box since the last build.
    pub reach: Box32,
    pub count: usize,
    /// EMPTY for ids without a box.
    by_id: Vec<Box32>,
}

impl Boxes {
    pub fn new(boxes: &[(u32, Aabb)]) -> Self {
        let whole = boxes.iter().fold(Aabb::EMPTY, |all, (_, b)| all.union(*b));
        let origin = if whole.is_empty() { DVec3::ZERO } else { whole.center() };
        let mut all = Self { origin, reach: Box32::EMPTY, count: 0, by_id: Vec::new() };
        all.by_id.reserve_exact(boxes.iter().map(|(id, _)| *id as usize + 1).max().unwrap_or(0));
        for (id, b) in boxes {
            all.set(*id, b);
        }
        all
    }

    pub fn set(&mut self, id: u32, b: &Aabb) -> Box32 {
        let b = Box32::around(b, self.origin);
        if self.by_id.len() <= id as usize {
            self.by_id.resize(id as usize + 1, Box32::EMPTY);
        }
        let old = std::mem::replace(&mut self.by_id[id as usize], b);
        self.count += usize::from(old == Box32::EMPTY);
        self.reach = self.reach.union(&b);
        b
    }

    pub fn get(&self, id: u32) -> Option<Box32> {
        self.by_id.get(id as usize).copied().filter(|b| *b != Box32::EMPTY)
    }

    pub fn take(&mut self, id: u32) -> Option<Box32> {
        let b = self.get(id)?;
        self.by_id[id as usize] = Box32::EMPTY;
        self.count -= 1;
        Some(b)
    }

    /// Every id with its box.
    pub fn iter(&self) -> impl Iterator<Item = (u32, Box32)> + '_ {
        (0..).zip(self.by_id.iter().copied()).filter(|(_, b)| *b != Box32::EMPTY)
    }

    /// Shrinks `reach` to the current boxes.
    pub fn tighten(&mut self) {
        self.reach = self.iter().fold(Box32::EMPTY, |all, (_, b)| all.union(&b));
    }

    /// Appends the ids of a cell that meet the shape, eight at a time.
    #[inline(always)]
    pub fn filter<S: Shape>(&self, ids: &[u32], shape: &S, shift: &Shift, found: &mut QueryResult) {
        found.tested += ids.len();
        for ids in ids.chunks(LANES) {
            let mut eight = Boxes8::EMPTY;
            for (lane, id) in ids.iter().enumerate() {
                eight.set(lane, &self.by_id[*id as usize]);
            }
            let mut met = eight.meet(shape, shift) & ((1 << ids.len()) - 1);
            while met != 0 {
                found.ids.push(ids[met.trailing_zeros() as usize]);
                met &= met - 1;
            }
        }
    }

    pub fn bytes(&self) -> usize {
        self.by_id.capacity() * size_of::<Box32>()
    }
}
