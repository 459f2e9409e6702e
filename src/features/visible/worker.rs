//! One worker: what is seen of a feature, and its report.

use super::strategy::{Decision, FeatureQuery, Workspace, decide};
use super::surface::FeatureSurface;
use super::tally::share;
use super::{QuerySamples, Visibility, VisibilityContext, area, samples::Samples, sheet};
use crate::features::{FeatureStats, Hidden, HiddenInterval, PlacedFeature, SeenFeature};
use glam::DVec3;

pub(super) struct FeatureResult {
    /// `None` if nothing is seen, and only what is seen is asked for.
    pub seen: Option<SeenFeature>,
    pub stats: FeatureStats,
    pub pixels: Vec<u32>,
}

/// One worker with its memory.
pub(super) struct Worker<'a> {
    pub(super) frame: &'a VisibilityContext<'a>,
    pub(super) workspace: Workspace,
}

impl<'a> Worker<'a> {
    pub fn new(frame: &'a VisibilityContext<'a>) -> Self {
        Self { frame, workspace: Workspace::new(frame) }
    }

    /// The samples that only what is in between decides.
    pub fn query_samples(&mut self, placed: &PlacedFeature) -> QuerySamples {
        if placed.feature.shape.is_contour() {
            return Vec::new();
        }
        let (frame, workspace) = (self.frame, &mut self.workspace);
        let mut in_image = frame.in_image(placed);
        let slots = sheet::set_behind(frame, &mut workspace.polygons, placed, &mut in_image);
        let own = FeatureSurface::new(frame, &mut workspace.polygons, (placed, &*slots), &in_image);
        let query = FeatureQuery { frame, shape: &placed.feature.shape, points: &in_image.0, own: &own, hints: None };
        if frame.options.visibility == Visibility::Image && area::pixels_of(&query).is_some() {
            return Vec::new();
        }
        let samples = Samples::of(&query, workspace);
        let queries = samples.queries(&query);
        workspace.samples = samples;
        queries
    }

    /// What is seen of a feature; `hints` are slots that may hide the samples left open, in order, in place of the images.
    pub fn feature(&mut self, placed: &PlacedFeature, hints: Option<&[Option<u32>]>) -> FeatureResult {
        let (frame, workspace) = (self.frame, &mut self.workspace);
        let shape = &placed.feature.shape;
        let mut in_image = frame.in_image(placed);
        let slots = sheet::set_behind(frame, &mut workspace.polygons, placed, &mut in_image);
        let own = FeatureSurface::new(frame, &mut workspace.polygons, (placed, &*slots), &in_image);
        let query = FeatureQuery { frame, shape, points: &in_image.0, own: &own, hints };
        let Decision { mut tally, mut stats } = decide(&query, workspace);
        let (visible, mut hidden) = if shape.is_area() { tally.shares(frame) } else { (tally.visible, tally.hidden) };
        stats.asked = 1;
        match frame.options.hidden {
            Hidden::Count if visible.is_empty() => return FeatureResult { seen: None, stats, pixels: Vec::new() },
            Hidden::Reason if visible.is_empty() => {
                let last = hidden.iter().map(|h| h.reason).max();
                hidden = last.map(|reason| HiddenInterval { t: [0.0, 1.0], reason, by: None }).into_iter().collect();
            }
            _ => {}
        }
        let world_from_object = placed.object.map(|o| frame.environment.objects()[o as usize].world_from_object);
        let in_world = |p: &DVec3| world_from_object.map_or(*p, |pose| pose.transform_point(*p));
        let seen = SeenFeature {
            points_world: shape.points().iter().map(in_world).collect(),
            normal_world: placed
                .feature
                .properties
                .normal
                .and_then(|n| world_from_object.map_or(n, |pose| pose.rotation * n).try_normalize()),
            visible_fraction: share(tally.seen, tally.inside),
            visible,
            hidden,
            range: tally.nearest.map(|(_, at)| at.length()),
            cos_incidence: tally.nearest.and_then(|(_, at)| own.cosine(at / at.length())),
            existence: placed.feature.existence.at(frame.time),
            feature: placed.feature.clone(),
            branch: None,
            roi: None,
            roi_flag: None,
            image_covariance: None,
        };
        FeatureResult { seen: Some(seen), stats, pixels: tally.pixels }
    }
}
