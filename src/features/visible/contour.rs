//! What is seen of the curves of a contour: piece by piece, each as a segment on the polygons around it.

use super::strategy::{FeatureQuery, decide};
use super::surface::FeatureSurface;
use super::tally::{Tally, share};
use super::worker::{FeatureResult, Worker};
use crate::environment::{Feature, FeatureShape, Properties};
use crate::features::contour::{Curve, Surface};
use crate::features::{FeatureStats, Hidden, HiddenInterval, PlacedFeature, SeenFeature};
use glam::{DMat3, DVec3};
use std::sync::Arc;

impl Worker<'_> {
    /// What is seen of each curve of a contour, the longest in the image first. None of a surface that has no front beside a back.
    pub(super) fn contour(&mut self, placed: &PlacedFeature, surface: &Surface) -> Vec<FeatureResult> {
        let frame = self.frame;
        let pose = frame.environment.objects()[surface.object as usize].world_from_object;
        let from = pose.rotation_matrix().transpose() * (frame.world_from_sensor.translation - pose.translation);
        let curves = surface.curves(from);
        let mut all: Vec<(Curve, Tally, FeatureStats)> = Vec::with_capacity(curves.len());
        for curve in curves {
            let (tally, stats) = self.curve(placed, surface, &curve);
            all.push((curve, tally, stats));
        }
        all.sort_by(|a, b| b.1.inside[0].total_cmp(&a.1.inside[0]));
        let numbered = (0..).zip(all);
        let result = |(branch, (curve, mut tally, mut stats)): (u32, (Curve, Tally, FeatureStats))| {
            (stats.features, stats.asked) = (usize::from(branch == 0), usize::from(branch == 0));
            let (visible, mut hidden) = (std::mem::take(&mut tally.visible), std::mem::take(&mut tally.hidden));
            match frame.options.hidden {
                Hidden::Count if visible.is_empty() => return FeatureResult { seen: None, stats, pixels: Vec::new() },
                Hidden::Reason if visible.is_empty() => {
                    let last = hidden.iter().map(|h| h.reason).max();
                    let whole = last.map(|reason| HiddenInterval { t: [0.0, 1.0], reason, by: None });
                    hidden = whole.into_iter().collect();
                }
                _ => {}
            }
            let seen = SeenFeature {
                branch: Some(branch),
                points_world: curve.points.iter().map(|p| pose.transform_point(*p)).collect(),
                visible_fraction: share(tally.seen, tally.inside),
                visible,
                hidden,
                range: tally.nearest.map(|(_, at)| at.length()),
                existence: placed.feature.existence.at(frame.time),
                feature: placed.feature.clone(),
                ..SeenFeature::whole(&placed.feature)
            };
            FeatureResult { seen: Some(seen), stats, pixels: tally.pixels }
        };
        numbered.map(result).collect()
    }

    /// All pieces of a curve together.
    fn curve(&mut self, placed: &PlacedFeature, surface: &Surface, curve: &Curve) -> (Tally, FeatureStats) {
        let (frame, workspace) = (self.frame, &mut self.workspace);
        let whole = curve.length();
        let (mut sum, mut stats) = (Tally::default(), FeatureStats::default());
        let segment =
            |ends: [DVec3; 2]| FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
        let mut piece = PlacedFeature {
            feature: Arc::new(Feature {
                id: placed.feature.id,
                name: None,
                object: None,
                shape: segment([DVec3::ZERO; 2]),
                existence: placed.feature.existence,
                properties: Properties::default(),
            }),
            object: Some(surface.object),
            slots: Vec::new(),
        };
        let mut length = 0.0;
        for (ends, slots) in curve.pieces(surface) {
            Arc::make_mut(&mut piece.feature).shape = segment(ends);
            piece.slots.clear();
            piece.slots.extend_from_slice(slots);
            let in_image = frame.in_image(&piece);
            let mut own = FeatureSurface::new(frame, &mut workspace.polygons, (&piece, &piece.slots[..]), &in_image);
            // A silhouette is no place on a surface that is seen too flat: it is where the surface ends.
            own.forget_normals();
            let query =
                FeatureQuery { frame, shape: &piece.feature.shape, points: &in_image.0, own: &own, hints: None };
            let decision = decide(&query, workspace);
            stats.add(&decision.stats);
            let from = length / whole;
            length += ends[0].distance(ends[1]);
            sum.append(decision.tally, [from, length / whole]);
        }
        (sum, stats)
    }
}
