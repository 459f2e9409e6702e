//! Visibility of a contour's curves: each piece is a segment on the polygons around it.

use super::strategy::{FeatureQuery, decide};
use super::surface::FeatureSurface;
use super::tally::{Tally, share};
use super::worker::{FeatureResult, Worker, hidden_intervals};
use crate::{FeatureStats, Hidden, PlacedFeature, SeenFeature};
use glam::DMat3;
use presight_model::contour::{Curve, Surface};
use presight_model::environment::FeatureShape;

impl Worker<'_> {
    /// The visible parts of each curve, the longest in the image first. Empty if the surface has no silhouette here.
    pub(super) fn contour(&mut self, placed: &PlacedFeature, surface: &Surface) -> Vec<FeatureResult> {
        let frame = self.frame;
        let pose = frame.environment.objects()[surface.object as usize].world_from_object;
        let from = pose.rotation_matrix().transpose() * (frame.world_from_sensor.translation - pose.translation);
        let curves = surface.curves(from);
        let mut all: Vec<(Curve, Tally, FeatureStats)> = Vec::with_capacity(curves.len());
        for curve in curves {
            let (tally, stats) = self.curve(surface, &curve);
            all.push((curve, tally, stats));
        }
        all.sort_by(|a, b| b.1.inside[0].total_cmp(&a.1.inside[0]));
        let numbered = (0..).zip(all);
        let result = |(branch, (curve, mut tally, mut stats)): (u32, (Curve, Tally, FeatureStats))| {
            (stats.features, stats.asked) = (usize::from(branch == 0), usize::from(branch == 0));
            if frame.options.hidden == Hidden::Count && tally.is_unseen(false) {
                return FeatureResult { seen: None, stats, pixels: Vec::new() };
            }
            let visible = std::mem::take(&mut tally.visible);
            let hidden = hidden_intervals(frame, &tally.hidden, visible.is_empty());
            let seen = SeenFeature {
                branch: Some(branch),
                points_world: curve.points.iter().map(|p| pose.transform_point(*p)).collect(),
                visible_fraction: share(tally.seen, tally.inside),
                visible,
                hidden,
                range: tally.nearest.map(|(_, at)| at.length()),
                normal_world: None,
                ..SeenFeature::unseen(frame.environment, placed, frame.time)
            };
            FeatureResult { seen: Some(seen), stats, pixels: tally.pixels }
        };
        numbered.map(result).collect()
    }

    /// Decides all pieces of a curve and sums the results.
    fn curve(&mut self, surface: &Surface, curve: &Curve) -> (Tally, FeatureStats) {
        let (frame, workspace) = (self.frame, &mut self.workspace);
        let whole = curve.length();
        let (mut sum, mut stats) = (Tally::default(), FeatureStats::default());
        let reach = curve.points.iter().map(|p| p.length()).fold(0.0, f64::max);
        let rounding = frame.rounding(reach, Some(surface.object));
        let in_image = frame.in_image_of(&curve.points, Some(surface.object));
        let mut length = 0.0;
        for ((ends, slots), points) in curve.pieces(surface).zip(in_image.windows(2)) {
            let own = FeatureSurface::of_silhouette(frame, &mut workspace.polygons, slots, rounding);
            let shape = FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
            let query = FeatureQuery { frame, shape: &shape, points, own: &own, hints: None };
            let decision = decide(&query, workspace);
            stats.add(&decision.stats);
            let from = length / whole;
            length += ends[0].distance(ends[1]);
            sum.append(decision.tally, [from, length / whole]);
        }
        (sum, stats)
    }
}
