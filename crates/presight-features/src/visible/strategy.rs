//! What strategies share: the feature that is asked about, and the memory that one worker keeps from feature to feature.
//!
//! Each strategy is a function of one signature, [`Strategy`]. It decides about all of a feature, or says that it is not for
//! this one; the next is tried then. None keeps anything in the [`Workspace`] on which a later call depends: what polygons and tiles
//! it finds there only saves finding them again.

use super::candidates::Candidates;
use super::polygon::PolygonCache;
use super::runs::SampledSegment;
use super::samples::Samples;
use super::surface::FeatureSurface;
use super::tally::Tally;
use super::tiles::Tiles;
use super::{Visibility, VisibilityContext, area, rays, runs, samples, whole};
use crate::FeatureStats;
use glam::DVec3;
use presight_model::environment::FeatureShape;

/// Decides which parts of a feature are seen; `None` if it is not for that feature.
pub(super) type Strategy = fn(&FeatureQuery<'_>, &mut Workspace) -> Option<Decision>;

/// In the order in which they are tried. The last decides about every feature.
const BY_IMAGE: [Strategy; 4] = [whole::decide, runs::decide, area::decide, samples::decide];

/// A feature whose visibility is asked for.
pub(super) struct FeatureQuery<'q> {
    pub frame: &'q VisibilityContext<'q>,
    pub shape: &'q FeatureShape,
    /// Its points, image frame.
    pub points: &'q [DVec3],
    pub own: &'q FeatureSurface<'q>,
    /// For each sample left open, in order, the slot that may hide it: in place of the images.
    pub hints: Option<&'q [Option<u32>]>,
    /// It is a piece of a curve, of which the length in the image counts.
    pub is_piece: bool,
}

/// What was found of a feature.
pub(super) struct Decision {
    pub tally: Tally,
    pub stats: FeatureStats,
}

/// What one worker keeps from feature to feature.
pub(super) struct Workspace {
    pub polygons: PolygonCache,
    pub tiles: Tiles,
    pub candidates: Candidates,
    /// Memory for what [`Tiles::between`] finds.
    pub near: Vec<u32>,
    /// Memory for samples; empty while they are in use.
    pub samples: Samples,
    /// Memory for a segment; empty while it is in use.
    pub segment: SampledSegment,
}

impl Workspace {
    pub fn new(frame: &VisibilityContext<'_>) -> Self {
        Self {
            polygons: PolygonCache::new(frame),
            tiles: Tiles::of_sensor(frame),
            candidates: Candidates::default(),
            near: Vec::new(),
            samples: Samples::default(),
            segment: SampledSegment::default(),
        }
    }

    /// For another prediction, with the memory of the last.
    pub fn renew(&mut self, frame: &VisibilityContext<'_>) {
        self.polygons.renew(frame);
        self.tiles = Tiles::of_sensor(frame);
    }
}

/// Decides about a feature by the first strategy that is for it.
pub(super) fn decide(query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Decision {
    let decision = match query.frame.options.visibility {
        Visibility::Rays => rays::decide(query, workspace),
        Visibility::Image => BY_IMAGE.iter().find_map(|strategy| strategy(query, workspace)),
    };
    decision.unwrap_or_else(|| Decision { tally: Tally::default(), stats: FeatureStats::default() })
}
