//! Collects the polygons that may hide a feature, each once, from all sources.

use super::VisibilityContext;
use super::polygon::PolygonCache;
use super::strategy::FeatureQuery;
use super::surface::FeatureSurface;
use glam::DVec2;
use presight_model::index::{QueryResult, Region};

/// Distance between the blocks of 3 x 3 pixels that are searched along a feature, pixels. Nearly all occluders show up
/// in them; finding the rest by tiles is faster than searching more blocks.
pub(super) const BLOCKS_APART: f64 = 24.0;

/// A polygon that hides two places by more than this, after rounding, hides all places between them.
pub(super) const CLEARLY: f64 = 1e-12;

/// Stands for the number of a polygon where no polygon hides.
pub(super) const NONE: u32 = u32::MAX;

/// Number of recent ids to remember while pixels are searched.
const LATEST: usize = 4;

/// A list of polygons that cover rays, by their numbers in a [`PolygonCache`], except those under the feature.
#[derive(Default)]
pub(super) struct Candidates {
    numbers: Vec<u32>,
    /// By polygon number: the last list for which the polygon was proposed.
    asked: Vec<u32>,
    list: u32,
    /// The pixel around which polygons were last added.
    center: Option<(i64, i64)>,
    /// Ids added last, the latest first.
    latest: [u32; LATEST],
    found: QueryResult,
}

impl Candidates {
    /// Starts a new list.
    pub fn begin(&mut self) {
        self.list = self.list.checked_add(1).unwrap_or_else(|| {
            // The numbers start again, so marks of earlier lists would pass for marks of new ones.
            self.asked.fill(0);
            1
        });
        self.numbers.clear();
        self.center = None;
        self.latest = [0; LATEST];
    }

    /// Starts a list from a feature's hints; without hints, from the images around the places that `visit_places` adds.
    pub fn propose(
        &mut self,
        query: &FeatureQuery<'_>,
        polygons: &mut PolygonCache,
        visit_places: impl FnOnce(&mut dyn FnMut(DVec2)),
    ) {
        self.begin();
        match query.hints {
            Some(hints) => self.add_hints(query.frame, polygons, hints, query.own),
            None => visit_places(&mut |pixel| self.add_around(query.frame, polygons, pixel, query.own)),
        }
    }

    /// The numbers of the polygons in the cache.
    pub fn numbers(&self) -> &[u32] {
        &self.numbers
    }

    /// Returns true unless polygons were last added around this place.
    pub fn moves(&self, frame: &VisibilityContext<'_>, pixel: DVec2) -> bool {
        self.center != Some(frame.sampler.nearest_pixel(pixel))
    }

    /// Adds the polygons of the nine pixels around a place in the image.
    pub fn add_around(
        &mut self,
        frame: &VisibilityContext<'_>,
        polygons: &mut PolygonCache,
        pixel: DVec2,
        own: &FeatureSurface<'_>,
    ) {
        let (column, row) = frame.sampler.nearest_pixel(pixel);
        let before = self.center.replace((column, row));
        if before == Some((column, row)) {
            return;
        }
        let (w, h) = (i64::from(frame.images.width), i64::from(frame.images.height));
        // A step of one pixel brings in only one new column or row.
        let (mut columns, mut rows) = ([column - 1, column + 1], [(row - 1).max(0), (row + 1).min(h - 1)]);
        match before.map(|(c, r)| (column - c, row - r)) {
            Some((1, 0)) => columns[0] = column + 1,
            Some((-1, 0)) => columns[1] = column - 1,
            Some((0, 1)) => rows[0] = rows[1],
            Some((0, -1)) => rows[1] = rows[0],
            _ => {}
        }
        let (wraps, distinct) = (frame.sampler.turn().is_some(), i64::from(frame.sensor.distinct_columns()));
        for r in rows[0]..=rows[1] {
            let line = &frame.images.polygon_id[(r * w) as usize..((r + 1) * w) as usize];
            let inside = columns[0].max(0) as usize..(columns[1] + 1).clamp(0, w) as usize;
            for id in line.get(inside).into_iter().flatten() {
                self.add_id(frame, polygons, *id, own);
            }
            if wraps && columns[0] < 0 {
                self.add_id(frame, polygons, line[distinct as usize - 1], own);
            }
            if wraps && columns[1] >= distinct {
                self.add_id(frame, polygons, line[0], own);
            }
        }
    }

    /// Adds the polygons of hints.
    pub fn add_hints(
        &mut self,
        frame: &VisibilityContext<'_>,
        polygons: &mut PolygonCache,
        hints: &[Option<u32>],
        own: &FeatureSurface<'_>,
    ) {
        let mut last = None;
        for slot in hints.iter().flatten() {
            if last.replace(*slot) != Some(*slot) {
                self.add_slot(frame, polygons, *slot, own);
            }
        }
    }

    /// Adds the polygons that the index finds in a region.
    pub fn add_in(
        &mut self,
        frame: &VisibilityContext<'_>,
        polygons: &mut PolygonCache,
        region: &Region,
        own: &FeatureSurface<'_>,
    ) {
        let mut found = std::mem::take(&mut self.found);
        found.clear();
        frame.world.index().query(frame.environment, region, &mut found);
        found.all().for_each(|slot| self.add_slot(frame, polygons, slot, own));
        self.found = found;
    }

    /// Adds the polygon of an id, unless it is 0 or was just added.
    #[inline]
    fn add_id(
        &mut self,
        frame: &VisibilityContext<'_>,
        polygons: &mut PolygonCache,
        id: u32,
        own: &FeatureSurface<'_>,
    ) {
        // Compared separately because most pixels repeat the latest id.
        if id == self.latest[0] || self.latest.contains(&id) {
            return;
        }
        // Drops the oldest id.
        self.latest.rotate_right(1);
        self.latest[0] = id;
        if id != 0
            && let Some(slot) = frame.slot_of_id(id)
        {
            self.add_slot(frame, polygons, slot, own);
        }
    }

    fn add_slot(
        &mut self,
        frame: &VisibilityContext<'_>,
        polygons: &mut PolygonCache,
        slot: u32,
        own: &FeatureSurface<'_>,
    ) {
        let Some(number) = polygons.of_slot(frame, slot) else { return };
        let at = number as usize;
        if self.asked.len() <= at {
            self.asked.resize((at + 1).next_power_of_two(), 0);
        }
        if std::mem::replace(&mut self.asked[at], self.list) != self.list {
            let polygon = polygons.get(number);
            if polygon.covers && !own.holds(polygon.slot) {
                self.numbers.push(number);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn after_the_last_list_number_no_old_mark_counts() {
        let mut candidates = Candidates { asked: vec![1, 2, u32::MAX], list: u32::MAX - 1, ..Candidates::default() };
        candidates.begin();
        assert_eq!((candidates.list, &candidates.asked[..]), (u32::MAX, &[1, 2, u32::MAX][..]));
        for list in [1, 2] {
            candidates.begin();
            assert_eq!((candidates.list, candidates.asked.contains(&list)), (list, false));
        }
    }
}
