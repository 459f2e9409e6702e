//! Makes findings: adds the view that shows a finding best, and the growth of its odds.

use crate::decide::decision::Decision;
use crate::decide::findings::{BestView, Finding, FindingKind};
use crate::decide::fit::Thing;
use crate::observe::spot::Spot;
use crate::observe::view::{NO_OBJECT, PixelEvidence, View};
use glam::DVec3;

/// A ball: centre in the world and radius, metres.
type Ball = (DVec3, f64);

impl Decision<'_> {
    /// A finding with its best view and the growth of its odds.
    pub(crate) fn finding(&self, object: String, kind: FindingKind, l: f64, views: u32) -> Finding {
        let index = self.environment.index_of(&object).ok();
        let region = self.region(index, &kind);
        let growth = match (index, region) {
            (None, Some(region)) => self.growth_of_new(region),
            (index, _) => index.and_then(|index| self.known.book.growth.get(&index)).cloned().unwrap_or_default(),
        };
        let shows = |view: &&View| {
            let through =
                |at: &usize| Some(view.objects[*at]) == index && view.evidence[*at] == PixelEvidence::SeenThrough;
            let near = |p: &&DVec3| region.is_some_and(|(middle, radius)| p.distance(middle) <= radius);
            (0..view.evidence.len()).filter(through).count() + view.new_points.iter().filter(near).count()
        };
        let best = self.known.views.iter().max_by_key(shows).filter(|view| shows(view) > 0);
        let best_view = best.map(|view| BestView {
            drive: view.drive,
            sensor: view.sensor_name().to_owned(),
            stamp: view.stamp,
            pose: view.sensor_pose(&view.world_from_image),
        });
        Finding { object, kind, l, views, best_view, growth }
    }

    /// The ball around the place of a new or moved object.
    fn region(&self, object: Option<u32>, kind: &FindingKind) -> Option<Ball> {
        match kind {
            FindingKind::New(found) => Some((found.pose.translation, 0.5 * found.size.length())),
            FindingKind::Recognized(known) => {
                Some(Thing::of_bounds(NO_OBJECT, &known.shape.bounds()).ball(&known.world_from_object))
            }
            FindingKind::Moved { world_from_object, .. } => {
                object.map(|object| Thing::new(self.environment, object).ball(world_from_object))
            }
            FindingKind::Gone | FindingKind::Part(_) | FindingKind::SeenThrough(_) | FindingKind::ComesAndGoes => None,
        }
    }

    /// Growth of the odds of a new object, view by view. A view adds the number of its points in a ball around the
    /// object, or subtracts the maximum of a view if its rays pass through the centre.
    fn growth_of_new(&self, (middle, radius): Ball) -> Vec<f32> {
        let max = self.known.options.max_per_view;
        let odds = |view: &View| {
            let hits = view.new_points.iter().filter(|p| p.distance(middle) <= radius).count() as f64;
            if hits == 0.0 && view.passed(&Spot::cube(middle, radius), radius) { -max } else { hits.min(max) }
        };
        let sums = self.known.views.iter().map(odds).filter(|odds| *odds != 0.0).scan(0.0, |sum, odds| {
            *sum += odds;
            Some(*sum as f32)
        });
        sums.collect()
    }
}
