//! One worker: decides which parts of a feature are seen, and builds the result.

use super::strategy::{Decision, FeatureQuery, Workspace, decide};
use super::surface::FeatureSurface;
use super::tally::{HiddenPart, share};
use super::windows::Windows;
use super::{QuerySamples, Visibility, VisibilityContext, area, samples::Samples, sheet};
use crate::sample::Piece;
use crate::{FeatureStats, Hidden, HiddenInterval, PlacedFeature, SeenFeature};
use glam::{DMat3, DVec2, DVec3};
use presight_model::environment::FeatureShape;

pub(super) struct FeatureResult {
    /// `None` if the feature is hidden and the results of hidden features are not requested.
    pub seen: Option<SeenFeature>,
    pub stats: FeatureStats,
    pub pixels: Vec<u32>,
}

/// One worker with its memory.
pub(super) struct Worker<'a> {
    pub(super) frame: &'a VisibilityContext<'a>,
    pub(super) workspace: Workspace,
}

impl Worker<'_> {
    /// The samples that only occlusion can still hide.
    pub fn query_samples(&mut self, placed: &PlacedFeature) -> QuerySamples {
        if placed.feature.shape.is_contour() {
            return Vec::new();
        }
        let (frame, workspace) = (self.frame, &mut self.workspace);
        let mut in_image = frame.in_image(placed);
        let slots = sheet::set_behind(frame, &mut workspace.polygons, placed, &mut in_image);
        let own = FeatureSurface::new(frame, &mut workspace.polygons, placed, &slots, &in_image);
        let query =
            FeatureQuery { frame, shape: &placed.feature.shape, points: &in_image.points, own: &own, hints: None };
        if frame.options.visibility == Visibility::Image && area::covers_many(&query) {
            return Vec::new();
        }
        let samples = Samples::of(&query, workspace);
        let queries = samples.queries(&query);
        workspace.samples = samples;
        queries
    }

    /// Predicts a feature. `hints` replace the images: the slots that may hide the undecided samples, in order.
    pub fn feature(&mut self, placed: &PlacedFeature, hints: Option<&[Option<u32>]>) -> FeatureResult {
        let (frame, workspace) = (self.frame, &mut self.workspace);
        let shape = &placed.feature.shape;
        let mut in_image = frame.in_image(placed);
        if let Some(reason) = frame.sampler.beside(&in_image.points) {
            let hidden = vec![HiddenInterval { t: [0.0, 1.0], reason, by: None }];
            let seen = (frame.options.hidden != Hidden::Count)
                .then(|| SeenFeature { hidden, ..SeenFeature::unseen(frame.environment, placed, frame.time) });
            let stats = FeatureStats { features: 1, asked: 1, ..FeatureStats::default() };
            return FeatureResult { seen, stats, pixels: Vec::new() };
        }
        let slots = sheet::set_behind(frame, &mut workspace.polygons, placed, &mut in_image);
        let own = FeatureSurface::new(frame, &mut workspace.polygons, placed, &slots, &in_image);
        let query = FeatureQuery { frame, shape, points: &in_image.points, own: &own, hints };
        let Decision { mut tally, mut stats } = decide(&query, workspace);
        stats.asked = 1;
        if frame.options.hidden == Hidden::Count && tally.is_unseen(shape.is_area()) {
            return FeatureResult { seen: None, stats, pixels: Vec::new() };
        }
        let (visible, hidden) = if shape.is_area() { tally.shares(frame) } else { (tally.visible, tally.hidden) };
        // Parts outside the image are not listed as hidden.
        let is_inside = |p: &DVec3| matches!(frame.sampler.point(*p), Piece::Inside(_));
        let is_whole = || hidden.is_empty() && in_image.points.iter().all(is_inside);
        let windows = tally.windows.take().filter(|_| !visible.is_empty() && !is_whole());
        let windows = windows.map(|windows| seen_in(windows, &query, workspace)).unwrap_or_default();
        let hidden = hidden_intervals(frame, &hidden, visible.is_empty());
        let seen = SeenFeature {
            visible_fraction: share(tally.seen, tally.inside),
            visible,
            hidden,
            range: tally.nearest.map(|(_, at)| at.length()),
            cos_incidence: tally.nearest.and_then(|(_, at)| own.cosine(at / at.length())),
            windows,
            ..SeenFeature::unseen(frame.environment, placed, frame.time)
        };
        FeatureResult { seen: Some(seen), stats, pixels: tally.pixels }
    }
}

/// The hidden parts to report: if all of the feature is hidden and only the reason is requested, the last reason alone.
pub(super) fn hidden_intervals(
    frame: &VisibilityContext<'_>,
    hidden: &[HiddenPart],
    is_unseen: bool,
) -> Vec<HiddenInterval> {
    if frame.options.hidden == Hidden::Reason && is_unseen {
        let last = hidden.iter().map(|h| h.reason).max();
        return last.map(|reason| HiddenInterval { t: [0.0, 1.0], reason, by: None }).into_iter().collect();
    }
    hidden.iter().map(|part| part.interval(frame)).collect()
}

/// The windows of a patch, grown along its visible sides: between samples, a patch is seen up to its outline.
fn seen_in(mut windows: Box<Windows>, query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Vec<[DVec2; 2]> {
    /// Pieces of the visible part of a side, whose image may be curved.
    const PIECES: u32 = 8;
    let (frame, middle) = (query.frame, windows.middle());
    let place = |p: DVec3| {
        let mut at = frame.sensor.project(p).map(DVec2::from)?;
        if let Some(turn) = frame.sampler.turn() {
            at.x += turn * ((middle.x - at.x) / turn).round();
        }
        Some(at)
    };
    for (k, a) in query.points.iter().enumerate() {
        let ends = [*a, query.points[(k + 1) % query.points.len()]];
        let side = FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
        let Decision { tally, .. } =
            decide(&FeatureQuery { shape: &side, points: &ends, hints: None, ..*query }, workspace);
        for part in tally.visible.iter().map(|v| v.t) {
            let at = |i: u32| ends[0].lerp(ends[1], part[0] + (part[1] - part[0]) * f64::from(i) / f64::from(PIECES));
            for i in 0..PIECES {
                if let Some((from, to)) = place(at(i)).zip(place(at(i + 1))) {
                    windows.reach(from, to);
                }
            }
        }
    }
    windows.into_seen()
}
